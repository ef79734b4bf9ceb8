"""The thesis's figures: published numbers against hand calculations, and what an interval says."""

from __future__ import annotations

import json

import numpy as np
import pytest

from evanesce.report.charts import CaptionedImage
from evanesce.studies.thesis import page as thesis_page
from evanesce.studies.thesis.figures import (
    FORCES,
    Reproduced,
    area_figures,
    area_laws,
    depth_figures,
    friction_figures,
    observations,
    published_depth,
    spanning,
    voltage_figures,
)
from evanesce.studies.thesis.study import ThesisStudy


def test_measured_areas_are_the_published_power_laws() -> None:
    measured = area_laws("silskin_20")["measured (power laws)"]
    by_hand = [79.03 * 0.5**0.4025, 79.03, 96.073 * 2**0.0984, *(96.073 * f**0.0984 for f in (3, 4, 5))]
    np.testing.assert_allclose(measured, by_hand, rtol=1e-12)
    assert "measured (power laws)" not in area_laws("silskin_0")


def test_laws_meet_where_they_must() -> None:
    laws = area_laws("silskin_20")
    np.testing.assert_allclose(laws["Hertz times 1.66"], 1.66 * laws["Hertz, E* on glass"])
    # adhesion adds area, more of it adds more; the bone takes area away
    assert (laws["JKR, 1 J/m²"] > laws["Hertz, E* on glass"]).all()
    assert (laws["JKR, 10 J/m²"] > laws["JKR, 5 J/m²"]).all()
    assert (laws["finite elements, bone"] < laws["finite elements, no bone"]).all()
    assert all(area.shape == (len(FORCES),) for area in laws.values())


def test_published_depth_gives_the_published_modulus_back() -> None:
    for name, modulus in (("silskin_0", 0.7686 + 3 * 0.0004), ("silskin_20", 0.0558 + 3 * 0.0396)):
        depth = published_depth(name, 3.0)
        assert 0.75 * 3.0 / (7.5**0.5 * depth**1.5) == pytest.approx(modulus, rel=1e-12)


def test_an_entry_agrees_only_inside_its_interval() -> None:
    entry = spanning("area", "at 1 N", "mm²", 3.0, [2.0, 1.5, 3.1], "why")
    assert (entry.value, entry.low, entry.high, entry.agrees) == (2.0, 1.5, 3.1, True)
    assert not spanning("area", "at 1 N", "mm²", 3.2, [2.0, 1.5, 3.1], "why").agrees


def test_what_was_not_simulated_is_counted_apart_and_wide_hulls_are_named() -> None:
    entries: list[Reproduced] = [*area_figures(), *depth_figures(), *friction_figures()]
    by_law = {(e.figure, e.what) for e in entries if not e.simulated}
    assert by_law == {
        ("area against force, Silskin 20 %", "measured over Hertz area"),
        ("stiffness by indenter, eqs 3.4 and 3.7", "delta (E'/F)^(2/3), human"),
        ("stiffness by indenter, eqs 3.4 and 3.7", "delta (E'/F)^(2/3), synthetic"),
        ("static friction at 1 N, 1 mm/s", "Silskin 0 %"),
        ("static friction at 1 N, 1 mm/s", "Silskin 20 %"),
    }
    law = spanning("law", "ratio", "1", 2.0, [1.9, 2.1], "why", simulated=False)
    wide = spanning("area", "at 5 N", "mm²", 4.0, [5.0, 2.0], "why")
    far = spanning("area", "at 1 N", "mm²", 9.0, [5.0, 4.9], "why")
    seen = [{"material": name, "force_N": 1.0, "true_area_mm2": 30.0, "clear_mm2": 31.0, "scattering_mm2": 60.0}
            for name in ("silskin_0", "silskin_20")]  # fmt: skip
    volts = {"voltage_V": [8.0, 9.0]} | {key: {"area_mm2": [1.0, 2.0], "true_area_mm2": 2.0} for key in ("1 N", "5 N")}
    empty = CaptionedImage(image=np.zeros((3, 3), np.uint8), caption="")
    study = ThesisStudy(outcomes=(), stated={}, entries=[law, wide, far], seen=seen, volts=volts, picture=empty)
    found = thesis_page.findings(study)
    assert found.verdict[0].startswith("1 of 2 of the thesis's figures that were simulated")
    assert "without simulation, 1 of 1." in found.verdict[0]
    cells = {row[0]: row for table in found.tables for row in table.rows if "computed over thesis" in table.columns}
    assert cells["at 5 N [mm²]"][4:] == ("1.25", "2 to 5 (2.5 times)", "within a wide hull")
    assert cells["at 1 N [mm²]"][4:6] == ("0.56", "4.9 to 5")
    assert cells["ratio [1]"][1] == "the thesis's own laws"


def test_every_entry_is_finite_and_has_a_reason() -> None:
    entries: list[Reproduced] = [*area_figures(), *depth_figures(), *friction_figures()]
    assert len({(e.figure, e.what) for e in entries}) == len(entries)
    for entry in entries:
        assert np.isfinite([entry.thesis, entry.value, entry.low, entry.high]).all()
        assert entry.low <= entry.value <= entry.high
        assert entry.reason
    by_name = {(e.figure, e.what): e for e in entries}
    # 0.0606 MPa over the mean pressure of Hertz's contact at 1 N, plus alpha
    area = np.pi * (0.75 * 7.5 / 0.769) ** (2 / 3)
    friction = by_name["static friction at 1 N, 1 mm/s", "Silskin 0 %"]
    assert friction.value == pytest.approx(0.0606 * area + 0.2324, rel=1e-6)
    regressions = by_name["stiffness by indenter, eqs 3.4 and 3.7", "delta (E'/F)^(2/3), human"]
    assert regressions.value / regressions.thesis == pytest.approx(1.024, abs=5e-4)


def test_voltages_are_known_to_a_step() -> None:
    entry = {"onset_V": 7.8, "converged_V": 12.0}
    lost, settled = voltage_figures({"1 N": entry, "5 N": entry | {"onset_V": 7.9}})
    assert (lost.low, lost.high) == pytest.approx((7.55, 8.15))
    assert lost.agrees
    assert not settled.agrees


def test_verdicts_on_words_follow_from_the_runs() -> None:
    shrinking = {"a": {"held": "force", "area_ratio": [1.0, 0.9]}, "b": {"held": "depth", "area_ratio": [1.0, 1.3]}}
    assert observations(shrinking)[0][2] == "agrees in sign"
    growing = {"a": {"held": "force", "area_ratio": [1.0, 1.1]}}
    assert observations(growing)[0][2] == "does not follow"
    assert json.dumps(observations(shrinking))
