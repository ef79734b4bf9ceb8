"""The voltage study: scaling against rendering anew, the split's sums, the claims, Sobol' indices, command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.cli.study_voltage import parse_forces, parse_volts
from evanesce.core.errors import InputError
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.optics.led_circuit import radiant_power
from evanesce.render.fast.fields import fields_of
from evanesce.render.fast.patch import patch_radiance
from evanesce.rig import load_scene
from evanesce.studies.voltage.analysis import best_setting, claims, converged, held_from, onset, sensitivity, up_to
from evanesce.studies.voltage.curve import excess_parts
from evanesce.studies.voltage.press import Press, power_ratio, segment_levels, unclipped_levels
from evanesce.studies.voltage.reduced_rig import ReducedRig, grey_levels, middle_open, with_length
from evanesce.studies.voltage.samples import run_samples
from evanesce.studies.voltage.sources import SOURCES, at_voltage, study_scene, without_sources
from evanesce.studies.voltage.unknowns import RATIOS, THRESHOLDS, UNKNOWNS, Plan, Samples
from support.rigs import need

# An ugly camera: small, off centre, the finger beside its axis.
CHANGES = {
    "camera.resolution_px": [400, 330],
    "camera.scale_px_per_mm": 23.0,
    "camera.centre_mm": [0.7, -0.4],
    "camera.lens.distortion": {"k1": 0.0, "k2": 0.0},
    "camera.lens.defocus_um": 40.0,
    "finger.position_mm": [1.1, 0.3],
    "grid.size_mm": 12.8,
    "grid.samples": 320,
}
VOLTS = (7.0, 8.0, 8.5, 9.0, 10.0, 12.0)


@pytest.fixture(scope="module")
def scene():
    return study_scene(load_scene("thesis_ridged", CHANGES))[0]


@pytest.fixture(scope="module")
def press(scene):
    return Press.of(scene, 1.5)


# --- light and voltage -----------------------------------------------------------------------------------------------


def test_scaled_light_is_that_rendered_anew(scene, press) -> None:
    for volts in (8.1, 11.3):
        anew = Press.of(at_voltage(scene, volts), 1.5)
        # single precision of the renderer, summed over its convolutions
        np.testing.assert_allclose(press.at(volts), anew.irradiance, rtol=2e-4, atol=1e-6 * anew.irradiance.max())


def test_power_ratio_is_that_of_the_led_and_absent_where_edges_differ(scene) -> None:
    circuit = scene.leds.circuit
    expected = float(radiant_power(circuit, 8.4) / radiant_power(circuit, scene.leds.voltage_V))
    assert power_ratio(scene, 8.4) == pytest.approx(expected, rel=1e-12)
    own = load_scene("thesis_ridged", CHANGES | {"leds.edge": {"left": {"voltage_V": 8.0}}})
    assert power_ratio(own, 8.4) is None


def test_what_no_led_made_does_not_scale(scene) -> None:
    veil = {"radiance_W_per_mm2_sr": 1e-9, "gradient": [0.3, -0.2]}
    lit = scene.model_copy(update={"effects": {**scene.effects, "ambient_light": veil}})
    both = Press.of(lit, 1.5)
    dark = np.asarray(both.dark)
    assert dark.max() > 0
    anew = Press.of(at_voltage(lit, 8.2), 1.5)
    np.testing.assert_allclose(both.at(8.2), anew.irradiance, rtol=2e-4, atol=1e-6 * anew.irradiance.max())


def test_scene_without_scattering_or_specks_gets_them_and_loses_them_again() -> None:
    plain = load_scene("thesis_ridged")
    scene, notes = study_scene(plain)
    assert len(notes) == 2
    assert set(scene.effects) == {"lateral_glow", "specks"}
    assert without_sources(scene, frozenset(SOURCES)) == plain
    own = load_scene("thesis_ridged", {"finger.scattering_length_mm": 1.2})
    scene, notes = study_scene(own)
    assert "lateral_glow" not in scene.effects
    assert len(notes) == 1
    assert without_sources(scene, frozenset({"subsurface scattering"})).finger.scattering_length_mm == 0


# --- the split -------------------------------------------------------------------------------------------------------


def test_parts_of_an_additive_area_are_what_was_put_in_and_products_interact() -> None:
    worth = {"subsurface scattering": 3.0, "blur": 0.5, "saturation": -0.2, "specks": 0.1}

    def added(without):
        return 10.0 + sum(v for k, v in worth.items() if k not in without)

    parts, residual, interaction = excess_parts(added, 9.5)
    assert parts == pytest.approx(worth)
    assert residual == pytest.approx(0.5)
    assert interaction == pytest.approx(0.0, abs=1e-12)

    def multiplied(without):
        return float(np.prod([1 + v for k, v in worth.items() if k not in without]))

    parts, residual, interaction = excess_parts(multiplied, 1.0)
    assert sum(parts.values()) + residual + interaction == pytest.approx(multiplied(frozenset()) - 1.0)
    assert abs(interaction) > 0.1


def test_unclipped_segmentation_is_the_reference_where_nothing_saturates(press) -> None:
    chain = Chain(threshold=0.2, min_blob=500)
    volts = 8.4
    assert int(press.levels(volts).max()) < 255
    np.testing.assert_array_equal(press.levels(volts), press.levels(volts, saturation=False))
    assert press.area(volts, chain) == press.area(volts, chain, saturation=False)
    levels = np.random.default_rng(4).integers(0, 256, (60, 50)).astype(np.uint8)
    loose = Chain(threshold=0.51, min_blob=30, radius=1, blur=0.8)
    np.testing.assert_array_equal(segment_levels(levels.astype(float), loose), segment(levels, loose).mask)


def test_levels_beyond_white_follow_the_tone_curve_on(scene) -> None:
    pixel = scene.camera.pixel
    top = 2**pixel.bits - 1
    levels = unclipped_levels(
        np.array([[pixel.black_level_DN - 9.0, top, pixel.black_level_DN + 4 * (top - 256)]]), scene.camera
    )
    assert levels[0, 0] == 0
    assert levels[0, 1] == 255
    assert levels[0, 2] == np.floor(255 * (1.099 * 4**0.45 - 0.099) + 0.5)  # BT.709 by its definition


def test_estimate_rises_with_voltage_and_scattering_is_most_of_its_excess(scene) -> None:
    chain = Chain(threshold=0.15, min_blob=300)
    with_scattering, without = Press.of(scene, 1.5), Press.of(scene, 1.5, frozenset({"subsurface scattering"}))
    areas = [with_scattering.area(v, chain) for v in VOLTS]
    assert areas[0] == 0.0
    assert np.all(np.diff(areas) >= 0)
    assert areas[-1] > 1.5 * with_scattering.true_area_mm2
    excess = areas[3] - with_scattering.true_area_mm2
    assert areas[3] - without.area(9.0, chain) > 0.5 * excess


# --- judgements ------------------------------------------------------------------------------------------------------


def test_onset_and_convergence_of_drawn_curves() -> None:
    v = (7.0, 8.0, 9.0, 10.0, 11.0)
    area = np.array([[0, 0, 5, 10, 10.1], [2, 3, 4, 5, 6.0], [0, 0, 0, 0, 0], [0, 9.8, 9.9, 10, 10]])
    first = onset(v, area, np.full(4, 10.0))
    # 5 % of 10 is crossed a tenth of the way from 8 to 9 V; at once; never; 0.5/9.8 of the way from 7 to 8 V
    np.testing.assert_allclose(first, [8.1, 7.0, 12.0, 7 + 0.5 / 9.8])
    np.testing.assert_allclose(converged(v, area), [10.0, 11.0, 7.0, 8.0])


def drawn(own: np.ndarray, volts=VOLTS, area=None) -> Samples:
    """Samples whose areas at their own threshold are given, one force, true area 10."""
    count = len(own)
    own = np.asarray(own, float)[:, None, :]
    if area is None:
        area = np.repeat(own[..., None], len(THRESHOLDS), axis=-1)
    ratio = np.full((count, 1, len(RATIOS)), 10.0)
    truth = np.full((count, 1), 10.0)
    return Samples(
        Plan((1.0,), tuple(volts)), np.zeros((count, 6)), truth, own, area, ratio, np.zeros((count, 1), bool)
    )


def test_claims_tell_a_plateau_from_a_ramp_and_exposure_control_makes_one() -> None:
    plateau, ramp, always = [0, 1, 8, 10, 10.1, 10.2], [0, 1, 8, 10, 13, 16], [9, 10, 11, 12, 13, 14]
    found = claims(drawn([plateau, ramp, always]))
    assert found.vanishes.tolist() == [True, True, False]
    assert found.rises.tolist() == [True, True, True]
    assert found.settles.tolist() == [True, False, False]
    assert found.all.tolist() == [True, False, False]
    assert found.excess.tolist() == pytest.approx([0.0, 0.0, 0.2])
    assert claims(held_from(drawn([ramp]), 9.0)).all.tolist() == [True]
    assert up_to(drawn([ramp]), 10.0).plan.voltages == VOLTS[:5]


def test_best_setting_finds_the_one_that_was_put_in() -> None:
    rng = np.random.default_rng(6)
    count, volts = 64, (8.0, 9.0, 10.0)
    error = np.abs(np.array(volts)[:, None] - 9.0) + np.abs(np.array(THRESHOLDS)[None, :] - 0.35)
    area = 10 * (1 + error[None, None] + 0.02 * rng.standard_normal((count, 1, 1, 1)))
    samples = drawn(np.full((count, 3), 10.0), volts, area)
    ratio = 10 * (1 + np.abs(np.array(RATIOS) - 0.6))[None, None] * np.ones((count, 1, 1))
    found = best_setting(replace(samples, by_ratio=ratio), np.ones(count, bool), bootstraps=50)
    assert (found.voltage_V, found.threshold, found.ratio) == (9.0, 0.35, 0.6)
    assert found.voltage_interval_V == (9.0, 9.0)
    assert found.error_interval[0] <= found.error <= found.error_interval[1]
    assert found.rigs == 16  # two of each block of eight
    with pytest.raises(ValueError, match="no sample"):
        best_setting(samples, np.zeros(count, bool))


def test_sobol_indices_are_those_of_a_function_whose_indices_are_known() -> None:
    """y = 2 a + b: a explains 4/5 of the variance, b 1/5, the rest nothing."""
    shares = Plan((1.0,), VOLTS, base=512, seed=3).shares()
    rows = sensitivity(2 * shares[:, 1] + shares[:, 4], 5)
    first = [row["first"] for row in rows]
    # twice the stated 95 % half-widths
    for row, expected in zip(rows, [0, 0.8, 0, 0, 0.2, 0], strict=True):
        assert row["first"] == pytest.approx(expected, abs=2 * row["first_95"] + 1e-6)
        assert row["total"] == pytest.approx(expected, abs=2 * row["total_95"] + 1e-6)
    assert len(first) == len(UNKNOWNS)
    assert all(row["total"] == 0 for row in sensitivity(np.ones(len(shares)), 5))


# --- reduced rigs ----------------------------------------------------------------------------------------------------


def test_fields_with_no_length_are_those_without_scattering(scene) -> None:
    from evanesce.render.fast.fields import fields_of
    from evanesce.studies.voltage.reduced_rig import with_length

    plain = scene.model_copy(update={"finger": scene.finger.model_copy(update={"scattering_length_mm": 0.0})})
    scattering = scene.model_copy(update={"finger": scene.finger.model_copy(update={"scattering_length_mm": 0.4})})
    found, expected = with_length(fields_of(scattering), 0.6, 0.0, 0.02), fields_of(plain)
    assert found.subsurface is None
    assert expected.subsurface is None
    np.testing.assert_array_equal(found.coupling * found.response, expected.coupling * expected.response)


def test_fields_with_another_length_are_those_computed_for_it() -> None:
    lengths = (1.0, 0.4)
    base = {"grid.size_mm": 12.8, "grid.samples": 400}
    scenes = [load_scene("thesis_ridged", base | {"finger.scattering_length_mm": n}) for n in lengths]
    from evanesce.contact.solve import contact_state

    state = contact_state(scenes[0], 2.0)
    swapped = with_length(fields_of(scenes[0]), 0.6, lengths[1], 12.8 / 400)
    anew, _ = patch_radiance(fields_of(scenes[1]), state, refine=1)
    found, _ = patch_radiance(swapped, state, refine=1)
    # the kernel may reach a cell more or less
    np.testing.assert_allclose(found, anew, rtol=1e-3, atol=1e-4 * float(anew.max()))


def test_reduced_rig_finds_the_full_chains_area() -> None:
    """On the thesis's own camera, without specks; its pixels are half the reduced rig's cells."""
    scene = load_scene("thesis_ridged", {"effects": {"lateral_glow": {"length_mm": 0.5}}})
    press = Press.of(scene, 1.0)
    rig = ReducedRig(scene, Plan((1.0,), (8.5, 9.5), base=2))
    values = np.array([0.5, 1.0, 0.769, 2.95, 6.0, 0.15])
    lit = rig.light(values)
    reduced = rig.areas(lit, values)[0, :, -1]
    full = [press.area(v, Chain(threshold=0.15)) for v in (8.5, 9.5)]
    # The full chain has the light on the finger's flank as well, which the reduced one leaves out: some 4 % of the
    # light out here, where an e-fold of light is worth 15 mm^2.
    np.testing.assert_allclose(reduced, full, atol=0.06 * 15.0)
    assert lit.true_area[0] == pytest.approx(press.true_area_mm2, rel=1e-3)


def test_grey_levels_follow_the_curve_and_clip(scene) -> None:
    camera = scene.camera
    scale = camera.pixel.conversion_gain_e_per_DN * (2**camera.pixel.bits - 1 - camera.pixel.black_level_DN)
    light = np.array([0.0, 0.004, 0.05, 0.5, 3.0])
    expected = np.where(light < 0.018, 4.5 * light, 1.099 * np.minimum(light, 1) ** 0.45 - 0.099)
    well = camera.pixel.full_well_capacity_e / scale
    expected = np.where(light > well, 1.099 * min(well, 1.0) ** 0.45 - 0.099, expected)
    np.testing.assert_allclose(grey_levels(light * scale, camera), expected, atol=2e-4)


def test_middle_is_open_where_a_groove_lies_within_a_period() -> None:
    share = np.ones((80, 80))
    assert not middle_open(share, 12.0)
    share[:, 44:47] = 0.0
    assert middle_open(share, 12.0)


def test_an_interrupted_run_goes_on_and_a_foreign_file_is_not_used(tmp_path: Path) -> None:
    scene = load_scene("thesis_ridged")
    plan, keep = Plan((1.0,), (8.0, 9.0, 10.0), base=2, seed=4), tmp_path / "samples.npz"
    first = run_samples(scene, plan, keep=keep)
    ticks: list[int] = []
    again = run_samples(scene, plan, keep=keep, tick=lambda done, total: ticks.append(done))
    assert not ticks  # all was kept
    np.testing.assert_array_equal(first.area, again.area)
    keep.write_bytes(b"not an archive")
    np.testing.assert_array_equal(run_samples(scene, plan, keep=keep).own, first.own)
    other = run_samples(scene, replace(plan, voltages=(8.0, 9.0, 11.0)), keep=keep)
    assert not np.array_equal(other.own, first.own)
    # a brighter plate shows no less at the same threshold
    assert np.all(np.diff(first.area, axis=2) >= 0)
    assert np.all(np.diff(first.area, axis=3) <= 0)


# --- command line ----------------------------------------------------------------------------------------------------


def test_ranges_and_forces_are_read() -> None:
    assert parse_volts("7:12:0.25")[:3] == (7.0, 7.25, 7.5)
    assert len(parse_volts("7:12:0.25")) == 21
    assert parse_forces("1,5") == (1.0, 5.0)
    for text in ("7:12", "12:7:1", "7:12:0", "7:12:nan", "a:b:c", "7:8:1", "7:12:0.001"):
        with pytest.raises(InputError):
            parse_volts(text)
    for text in ("", "1,1", "0", "-1", "nan", "1,x", "inf"):
        with pytest.raises(InputError):
            parse_forces(text)


@pytest.mark.parametrize(
    "arguments",
    [["thesis_ridged", "--volts", "9"], ["thesis_ridged", "--samples", "3"], ["thesis", "--samples", "2"],
     ["thesis_ridged", "--threshold", "2"], ["thesis_ridged", "--reference", "--variant", "metal"], ["nowhere"]],
)  # fmt: skip
def test_bad_input_ends_in_one_line(arguments, tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["study", "voltage", *arguments, "--out", str(tmp_path / "o")])
    assert result.exit_code == 2
    assert "Traceback" not in result.output
    assert not (tmp_path / "o" / "result.json").exists()


def test_the_reference_states_that_it_has_no_lateral_scattering(tmp_path: Path) -> None:
    result = CliRunner().invoke(
        app, ["study", "voltage", "thesis_ridged", "--reference", "--samples", "2", "--out", str(tmp_path / "o")]
    )
    assert result.exit_code == 2
    assert "finger.scattering_length_mm" in result.output


@pytest.mark.slow
def test_study_by_the_reference_without_scattering(tmp_path: Path) -> None:
    """A path-traced scene: no scattering, and areas near those of the fast renderer (coarse pixels, few paths)."""
    need("llvm")
    areas = {}
    for way in ("--reference", "--fast"):
        file = tmp_path / f"{way}.json"
        arguments = ["study", "voltage", "thesis_ridged", way, "--volts", "8.2:8.6:0.2", "--forces", "1"]
        arguments += ["--samples", "2", "--out", str(tmp_path / way), "--json", str(file)]
        for key, value in {"effects.lateral_glow.length_mm": "0.0", "render.samples_per_pixel": "48",
                           "camera.resolution_px": "[500, 375]", "camera.scale_px_per_mm": "14.6",
                           "camera.lens.focal_length_mm": "1.5"}.items():  # fmt: skip
            arguments += ["--set", f"{key}={value}"]
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, result.output
        data = json.loads(file.read_text())
        assert all(row["parts_mm2"]["subsurface scattering"] == 0.0 for row in data["curves"])
        assert data["provenance"]["renderer"] == ("path" if way == "--reference" else "transport")
        areas[way] = [row["area_mm2"] for row in data["curves"]]
    # Noise of some 10 % a pixel at the rim. At higher voltages the noise of the dim flank passes the threshold, too.
    np.testing.assert_allclose(areas["--reference"], areas["--fast"], rtol=0.05)


@pytest.mark.slow  # the whole study: 10 s
@pytest.mark.system
def test_study_ends_with_a_report_page(tmp_path: Path) -> None:
    out, file = tmp_path / "o", tmp_path / "r.json"
    result = CliRunner().invoke(
        app,
        ["study", "voltage", "thesis_ridged", "--volts", "7.5:12:0.75", "--forces", "1", "--samples", "2",
         "--out", str(out), "--json", str(file)],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    data = json.loads(file.read_text())
    assert len(data["curves"]) == 7
    for row in data["curves"]:
        total = sum(row["parts_mm2"].values()) + row["residual_mm2"] + row["interaction_mm2"]
        assert total == pytest.approx(row["excess_mm2"], abs=1e-9)
    assert data["curves"][0]["area_mm2"] == 0.0
    assert data["grooves"][0]["open_middle"] is False
    page = (out / "report.html").read_text()
    assert "data:image/png;base64," in page
    assert "http" not in page.replace("http://www.w3.org", "")
