"""The mechanics study: its keys and intervals, and its figures recomputed from the stored runs by other means."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.contact.fem.library import FOLDER as LIBRARY
from evanesce.studies.mechanics.ridges import GRID, LIKELY_PITCH, Ridging, pressed, ridged_area
from evanesce.studies.mechanics.runs import FOLDER, SLIDES, SlideCase, solved_slide
from evanesce.studies.mechanics.study import (
    as_json,
    modulus_at_ridges,
    overshoot,
    power_law,
    predictions,
    spanned,
)

KEYS = {
    "area_ratio_ridged_1N": None,
    "area_change_length_25_vs_7p5_1N": None,
    "area_change_radius_10_vs_7p5_1N": None,
    "area_change_bone_1N": None,
    "silskin_20_measured_over_fe": ("0.5", "1", "2", "5"),
    "normal_force_overshoot": ("0.67", "0.82", "1.13"),
    "steady_area_ratio_ridged_sliding": None,
}


@lru_cache(maxsize=1)
def result() -> dict[str, Any]:
    return as_json(predictions())


def raw(folder: Path, name: str) -> dict[str, np.ndarray]:
    with np.load(folder / f"{name}.npz", allow_pickle=False) as data:
        return {key: data[key] for key in data.files}


def area_at(folder: Path, name: str, force: float) -> float:
    data = raw(folder, name)
    return float(np.pi * np.interp(force, data["force"], data["contact_radius"]) ** 2)


@pytest.mark.slow  # 7 s
def test_every_key_is_there_and_every_interval_holds_its_value() -> None:
    found = result()
    for key, subs in KEYS.items():
        entries = [found[key]] if subs is None else [found[key][sub] for sub in subs]
        assert subs is None or tuple(found[key]) == subs
        for value, low, high in entries:
            assert np.isfinite([value, low, high]).all()
            assert low <= value <= high
            assert low < high
        bases = found["basis"][key]
        assert all("Value" in text or "Interval" in text or "largest" in text for text in np.ravel(list(
            [bases] if subs is None else bases.values())))  # fmt: skip


@pytest.mark.parametrize(
    ("force", "scale", "exponent"),
    [(0.5, 79.03, 0.4025), (1.0, 79.03, 0.4025), (2.0, 96.073, 0.0984), (5.0, 96.073, 0.0984)],
)
def test_measured_over_finite_elements_from_the_stored_radii(force: float, scale: float, exponent: float) -> None:
    by_hand = scale * force**exponent / area_at(LIBRARY, "silskin_20_none", force)
    assert result()["silskin_20_measured_over_fe"][f"{force:g}"][0] == pytest.approx(by_hand, rel=1e-6)


@pytest.mark.parametrize(
    ("key", "top", "base"),
    [
        ("area_change_length_25_vs_7p5_1N", "silskin_0_standard_none", "silskin_0_short_none"),
        ("area_change_radius_10_vs_7p5_1N", "silskin_0_large20_none", "silskin_0_standard_none"),
        ("area_change_radius_10_vs_7p5_1N", "silskin_0_large15_half", "silskin_0_standard_half"),
    ],
)
def test_changes_of_shape_hold_the_raw_areas(key: str, top: str, base: str) -> None:
    _, low, high = result()[key]
    # single areas scatter with the edge among the nodes; that scatter is part of the interval
    assert low <= area_at(FOLDER, top, 1.0) / area_at(FOLDER, base, 1.0) - 1.0 <= high


def test_a_larger_tip_follows_hertz_roughly() -> None:
    value, _, _ = result()["area_change_radius_10_vs_7p5_1N"]
    hertz = (10.0 / 7.5) ** (2.0 / 3.0) - 1.0
    # strain of the order a/R = 0.3 and the shaft: a few percent of area
    assert value == pytest.approx(hertz, abs=0.06)


def test_overshoot_is_read_from_the_stored_forces() -> None:
    for mu in (0.67, 0.82, 1.13):
        data = raw(FOLDER, f"silskin_0_none_mu{round(100 * mu):03d}_depth")
        force = data["normal_force"] / data["normal_force"][0]
        signed = max(force.max() - 1.0, 1.0 - force.min())
        assert abs(result()["normal_force_overshoot"][f"{mu:g}"][0]) == pytest.approx(signed, rel=1e-9)
        assert force[0] * data["normal_force"][0] == pytest.approx(1.0, rel=1e-6)


def test_a_bone_pushes_the_force_up_where_the_solid_finger_lets_it_fall() -> None:
    solid, boned = (overshoot(solved_slide(SlideCase(0.67, bone, "depth"))) for bone in ("none", "half"))
    assert solid < 0 < boned


def test_slides_obey_coulomb() -> None:
    for case in SLIDES:
        found = solved_slide(case)
        share = found.scalars["tangential_force"] / found.scalars["normal_force"]
        assert share.max() <= case.friction * (1 + 1e-3)
        last = found.fields["touching"][-1].astype(bool)
        if found.fields["slipping"][-1].astype(bool)[last].all():
            # softened onset of slip: 1 %
            assert share[-1] == pytest.approx(case.friction, rel=0.01)


def test_soft_ridges_close_and_hard_ones_stand() -> None:
    smooth, modulus = pressed("none", 1.0), modulus_at_ridges("silskin_0")
    assert modulus == pytest.approx(8.0 * (3693.2 + 49474.0) * 1e-6, rel=1e-12)
    ridges = Ridging(LIKELY_PITCH, furrow_at_tip=True, direction=0.4).heights()
    assert ridges.max() == pytest.approx(0.04767, rel=1e-3)
    plain = ridged_area(smooth, modulus, np.zeros(GRID.shape))
    assert plain == pytest.approx(smooth.nominal_contact_area, rel=5e-3)
    flat = ridged_area(smooth, modulus, 1e-3 * ridges)
    low = ridged_area(smooth, modulus, ridges)
    high = ridged_area(smooth, modulus, 4.0 * ridges)
    assert flat == pytest.approx(plain, rel=5e-3)
    assert high < low < flat


def test_the_direction_of_ridges_is_free_where_the_contact_is_round() -> None:
    smooth, modulus = pressed("half", 1.0), modulus_at_ridges("silskin_0")
    areas = [
        ridged_area(smooth, modulus, Ridging(LIKELY_PITCH, False, turn).heights()) for turn in (0.0, 0.7, np.pi / 2)
    ]
    # a crest on the border of some cells, 35 um on a radius of 2.3 mm
    assert np.ptp(areas) < 0.02 * np.mean(areas)


def test_power_law_returns_what_it_was_made_of() -> None:
    force = np.array([0.7, 0.9, 1.3])
    value, misfit = power_law(force, 17.3 * force**0.61)
    assert value == pytest.approx(17.3, rel=1e-12)
    assert misfit < 1e-12


def test_an_interval_spans_all_that_may_be_and_the_error() -> None:
    one = spanned(1.0, [0.7, 0.9], 0.05, "basis")
    assert one.as_list() == pytest.approx([1.0, 0.65, 1.05])


@pytest.mark.slow  # the whole study: 8 s
@pytest.mark.system
def test_the_command_prints_writes_and_plots(tmp_path: Path) -> None:
    file = tmp_path / "found.json"
    ran = CliRunner().invoke(app, ["study", "mechanics", "--json", str(file), "--out", str(tmp_path / "out")])
    assert ran.exit_code == 0, ran.output
    found = json.loads(file.read_text(encoding="utf-8"))
    assert set(KEYS) <= set(found)
    assert {"press", "slide", "basis", "provenance"} <= set(found)
    assert set(found["press"]) == {"silskin_0", "silskin_20"}
    assert {one["friction"] for one in found["slide"].values()} == {0.67, 0.82, 1.13}
    assert (tmp_path / "out" / "mechanics.png").stat().st_size > 10_000
    assert "area_ratio_ridged_1N" in ran.output


def test_a_folder_for_json_is_refused_before_any_work(tmp_path: Path) -> None:
    ran = CliRunner().invoke(app, ["study", "mechanics", "--json", str(tmp_path)])
    assert ran.exit_code == 2
