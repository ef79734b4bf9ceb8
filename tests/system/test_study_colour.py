"""Studies in colour: closed forms of grey and resolution, readings against the monochrome rig, reduced against full."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.stats import binom
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.evaluation.calibrated_rig import calibrated
from evanesce.measurement.reference.segment import Chain
from evanesce.measurement.refined.estimator import Estimator
from evanesce.rig import dump_scene, load_scene
from evanesce.sensor.colour import ImageProcessor, colour_of_level
from evanesce.sensor.response import led_response
from evanesce.studies.budget.colour import ORIGINS, camera_components, deviations, radiometry_of
from evanesce.studies.budget.study import run_study
from evanesce.studies.estimator.study import LitPress
from evanesce.studies.mosaic import as_red, edge_transfer, narrowest_groove, pixel_transfer, red_transfer
from evanesce.studies.pressure.colour import run_colour
from evanesce.studies.scenes import Finger
from evanesce.studies.voltage.colour_rig import APERTURE, FILTERS, FLANK, ColourRig, Reading
from evanesce.studies.voltage.colour_unknowns import SETTINGS, colour_unknowns
from evanesce.studies.voltage.grey import GREY, GreyTable, bilinear
from evanesce.studies.voltage.in_colour import Share, hypothesis, states
from evanesce.studies.voltage.press import Press
from evanesce.studies.voltage.reduced_rig import ReducedRig
from evanesce.studies.voltage.samples import run_samples
from evanesce.studies.voltage.study import scene_values
from evanesce.studies.voltage.unknowns import Plan

VOLTS = (8.0, 8.5, 9.0)
SCATTERING = {"effects": {"lateral_glow": {"length_mm": 0.5}}}


@pytest.fixture(scope="module")
def scene():
    return load_scene("thesis_ridged_red", SCATTERING)


@pytest.fixture(scope="module")
def rig(scene):
    return ColourRig(scene, Plan((1.0,), VOLTS, 2, 1, colour_unknowns(scene)))


@pytest.fixture(scope="module")
def lit(rig, scene):
    return rig.light(scene_values(scene, 0.35))


# --- grey and mosaic -------------------------------------------------------------------------------------------------


def test_grey_by_table_is_that_of_the_developed_colour() -> None:
    processor, response = ImageProcessor.imx477(2700), (1.0, 0.12, 0.03)
    level = np.geomspace(1e-4, 80.0, 777)
    expected = colour_of_level(level, response, processor) @ GREY / 255.0
    # one step of the table is 0.25 % of light; the curve's steepest part makes 1.2 DN of it
    np.testing.assert_allclose(GreyTable(response, processor)(level), expected, atol=1.5 / 255)


def test_green_is_zero_until_the_matrix_balances_clipped_red() -> None:
    """Green is -m0 + m1 g L + m2 w b L with red full: its zero stands in closed form."""
    processor, green, blue = ImageProcessor.imx477(3250), 0.15, 0.05
    m0, m1, m2 = processor.matrix[1]
    zero = -m0 / (m1 * green + m2 * processor.blue_gain * blue)
    found = GreyTable((1.0, green, blue), processor).first(1, 1)
    assert zero < found < 1.01 * zero


def test_bilinear_is_opencvs_and_keeps_a_plane() -> None:
    raw = np.random.default_rng(3).integers(0, 65536, (31, 46)).astype(np.uint16)
    expected = cv2.cvtColor(raw, cv2.COLOR_BayerBG2RGB)
    # OpenCV rounds to whole numbers
    assert np.abs(bilinear(raw.astype(float), "RGGB") - expected)[1:-1, 1:-1].max() <= 0.5
    rows, cols = np.indices((20, 26))
    plane = 3.0 * rows - 0.7 * cols + 11
    np.testing.assert_allclose(bilinear(plane, "GBRG")[2:-2, 2:-2], np.repeat(plane[2:-2, 2:-2, None], 3, axis=2))


def test_edge_has_the_transfer_of_pixel_and_kernel() -> None:
    f = np.array([0.03, 0.11, 0.19, 0.24])
    # the fine samples of the light and the phases of the edge are steps of 1/32 and 1/16 px
    np.testing.assert_allclose(edge_transfer(f, red=False), pixel_transfer(f), atol=3e-3)
    np.testing.assert_allclose(edge_transfer(f, red=True), red_transfer(f), atol=3e-3)
    assert red_transfer(0.25) == pytest.approx(np.sqrt(2) / np.pi, rel=1e-12)  # sinc(1/4)/2


def test_a_groove_must_hold_a_sample_of_each_grid() -> None:
    """Without blur a groove of half depth holds a whole pixel of either sampling: 1 px and 2 px, plus half a pixel."""
    widths = np.arange(0.5, 4.0, 0.125)
    mono, red = (narrowest_groove(seen, 0.5, 0.0, widths) for seen in (lambda m: m, as_red))
    assert mono == pytest.approx(1.0, abs=0.13)  # the worst phase shares the groove between two pixels
    assert red == pytest.approx(2.0, abs=0.13)


# --- reduced rig -----------------------------------------------------------------------------------------------------


def test_reading_without_colour_is_the_monochrome_reduced_rig(scene, rig, lit) -> None:
    values = scene_values(scene, 0.35)
    red = led_response(scene)[0]  # of the quantum efficiency: the monochrome sensor is as sensitive as the red pixels
    pixel = scene.camera.pixel.model_copy(update={"quantum_efficiency": red * scene.camera.pixel.quantum_efficiency})
    plain = scene.model_copy(
        update={"camera": scene.camera.model_copy(update={"colour": None, "analogue_gain": 1.0, "pixel": pixel})}
    )
    mono = ReducedRig(plain, Plan((1.0,), VOLTS, 2))
    expected = mono.areas(mono.light(values[:6]), values[:6])[0, :, -1]
    reading = Reading("", colour=False, surroundings=False, control=False)
    found = rig.read(rig.lights(lit), values, reading, (0.35,))[0][0, :, 0]
    # the monochrome rig blurs by the lens after the tone curve, this one before it: half a pixel along the rim
    np.testing.assert_allclose(found, expected, rtol=0.02)


def test_reduced_rig_finds_the_full_colour_chains_area(scene, rig, lit) -> None:
    """At thresholds above what clipped red gives; below, the rendered flank lies near the threshold."""
    press, values = Press.of(scene, 1.0), scene_values(scene, 0.35)
    for threshold in (0.35, 0.6):
        found = rig.read(rig.lights(lit), values, Reading("", control=False), (threshold,))[0][0, :, 0]
        full = [press.area(v, Chain(threshold=threshold)) for v in VOLTS]
        np.testing.assert_allclose(found, full, rtol=0.04, atol=0.3)


def test_without_saturation_green_never_appears(scene) -> None:
    """Unclipped, green is a fixed negative multiple of red, so that grey stays what red alone gives."""
    press = Press.of(scene, 1.0)
    assert press.levels(9.0).shape[2] == 3
    assert press.levels(9.0)[..., 1].max() > 200
    # noise at gain 16 lifts the green of a few pixels
    assert np.quantile(press.levels(9.0, saturation=False), 0.999) <= np.ceil(255 * (GREY[0] + GREY[2]))


def test_flank_and_ground_are_taken_in_where_their_grey_exceeds_the_threshold(scene, rig, lit) -> None:
    values = scene_values(scene, 0.15)
    values[FLANK] = 0.1, 0.005
    area = rig.read(rig.lights(lit), values, Reading("", control=False), (0.15, 0.35))[0][0, -1]
    finger = np.pi / 4 * scene.finger.diameter_mm**2
    assert area[0] == pytest.approx(finger, rel=2e-3)  # cells of 0.032 mm
    assert area[1] < finger / 3


def test_control_holds_the_light_until_its_longest_exposure(scene, rig, lit) -> None:
    values = scene_values(scene, 0.35)
    values[FILTERS], values[FLANK] = SETTINGS.index((3250, 0.15, 0.05)), (0.07, 0.005)
    values[APERTURE] /= 4.0  # sixteen times the light: enough at 8.5 V
    level = rig.read(rig.lights(lit), values, Reading("", control=True), (0.35,))[1][0]
    fixed = rig.read(rig.lights(lit), values, Reading("", control=False), (0.35,))[1][0]
    assert level[1] == level[2]  # 8.5 and 9 V
    longest = rig.longest_ms / (scene.camera.exposure_ms * scene.camera.analogue_gain)
    assert level[0] == pytest.approx(min(level[1], longest * fixed[0]), rel=1e-3)
    # even light: its green alone decides, and is to reach 0.3
    even = rig.settled(np.full(lit.images[0].shape, 5.0, np.float32), 5.0, 5.0, rig.camera_of(int(values[FILTERS])))
    assert even == pytest.approx(0.3 / 0.15, rel=2e-3)


# --- samples ---------------------------------------------------------------------------------------------------------


def test_samples_in_colour_resume_and_their_states_add_up(scene, tmp_path: Path) -> None:
    plan = Plan((1.0,), (7.75, 8.0, 9.0), base=2, seed=4, unknowns=colour_unknowns(scene))
    keep = tmp_path / "samples.npz"
    first = run_samples(scene, plan, keep=keep)
    ticks: list[int] = []
    again = run_samples(scene, plan, keep=keep, tick=lambda done, total: ticks.append(done))
    assert not ticks
    np.testing.assert_array_equal(first.own, again.own)
    assert len(first.independent) == 4
    for name, own in first.other.items():
        assert np.all(np.diff(own[first.independent], axis=-1) >= -1e-9), name  # more volts, no less light
    for row in states(first):
        parts = ("red_not_full", "red_full", "green_appears", "green_full")
        assert sum(row[part] for part in parts) == pytest.approx(1.0)
    assert all(share.rigs == 4 for share in hypothesis(first).values())


def test_interval_of_a_share_holds_the_truth_as_often_as_it_says() -> None:
    """Wilson's interval, averaged over shares from 5 to 95 %, by the binomial distribution itself."""
    rigs, covered = 60, []
    for truth in np.linspace(0.05, 0.95, 31):
        hits = np.arange(rigs + 1)
        limits = [Share.of(np.arange(rigs) < k) for k in hits]
        inside = np.array([s.low <= truth <= s.high for s in limits])
        covered.append(float(binom.pmf(hits, rigs, truth) @ inside))
    assert np.mean(covered) == pytest.approx(0.95, abs=0.01)
    assert str(Share.of(np.zeros(0, bool))) == "none"


@pytest.mark.parametrize(
    ("scenes", "says"),
    [(["thesis", "thesis_ridged_red"], "the other is not"), (["AUTO"], "fixed exposure and white balance")],
)
def test_the_budget_needs_one_rig_whose_colours_are_fixed(tmp_path: Path, scenes: list[str], says: str) -> None:
    automatic = load_scene("thesis_ridged_red", {"camera.colour.white_balance": "automatic"})
    file = tmp_path / "auto.toml"
    file.write_text(dump_scene(automatic), encoding="utf-8")
    names = [str(file) if name == "AUTO" else name for name in scenes]
    result = CliRunner().invoke(app, ["study", "budget", *names, "--out", str(tmp_path / "o")])
    assert result.exit_code == 2
    assert "camera.colour" in result.output
    assert says in " ".join(result.output.split())
    assert not (tmp_path / "o").exists()


SMALL = {"camera.resolution_px": [1000, 750], "camera.scale_px_per_mm": 29.2, "camera.pixel.pitch_um": 6.2,
         "grid.samples": 640, "grid.size_mm": 12.8}  # fmt: skip


@pytest.mark.slow  # 40 s
def test_budget_of_a_colour_rig_has_the_cameras_terms() -> None:
    """They add in squares with the rest, and are the changes of the area that a wrong camera model makes."""
    scene = load_scene("thesis_ridged_red", SMALL | {"camera.exposure_ms": 8.25})
    fingers = [Finger(scene.finger.material, ridged, scattering=False).on(scene) for ridged in (False, True)]
    found = run_study(
        *fingers, measurements=60, forces=(1.7,), voltages=(9.0,), fingers=("smooth",), positions=("centre",), seed=2
    ).classes[0]
    assert set(ORIGINS) <= set(found.contributions_percent)
    # rectangular and small beside the cards, so that medians add as the parts of each do
    together = 1.96 * np.sqrt(sum(u**2 for u in found.contributions_percent.values()))
    assert found.refined_half_width_percent == pytest.approx(together, rel=0.15)
    assert abs(found.refined_bias_percent) < found.refined_half_width_percent


@pytest.mark.slow  # 20 s
def test_without_clipping_a_wrong_green_response_moves_no_edge() -> None:
    """Red alone is read then: a twentieth of what the same error does where red is full and green shows the level."""
    changes = []
    for exposure in (8.25, 8.25 / 60):
        scene = load_scene("thesis_ridged_red", SMALL | {"camera.exposure_ms": exposure})
        calibration = calibrated(scene, np.random.default_rng(2))
        press = LitPress.of(scene, 1.7, 1)
        estimator = Estimator.of(calibration, radiometry_of(scene, calibration), blur_px=1.0)
        area = estimator.area(press.frame(9.0, 3).data).area_mm2
        assert area == pytest.approx(press.true_mm2, rel=0.03)
        changes.append(deviations(press, 9.0, 3, estimator, area))
    clipped, unclipped = (abs(change["green response"]) for change in changes)
    assert clipped > 0.02
    assert unclipped < 0.05 * clipped + 0.003
    moved = camera_components({"green response": 0.5, "demosaicing": -0.4}, estimator.area(press.frame(9.0, 3).data))
    assert moved[0].low == -moved[0].high
    assert (moved[1].low < 0, moved[1].high) == (True, 0.0)


@pytest.mark.slow  # the whole study: 10 s
@pytest.mark.system
def test_voltage_study_prints_both_readings(tmp_path: Path) -> None:
    file = tmp_path / "r.json"
    arguments = ["study", "voltage", "thesis_ridged_red", "--volts", "7.5:9:0.75", "--forces", "1", "--samples", "2"]
    arguments += ["--threshold", "0.35", "--out", str(tmp_path / "o"), "--json", str(file)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "With and without colour" in result.output
    colour = json.loads(file.read_text())["colour"]
    assert {"without colour", "with colour, automatic exposure"} <= set(colour["shares"])
    assert colour["shares"]["without colour"]["all"]["rigs"] == 4
    assert max(row["at_all"] for row in colour["reduced_against_full"] if row["threshold"] > 0.3) < 0.3
    assert "Clipped red, then green, then full?" in (tmp_path / "o" / "report.html").read_text()


# --- pressure --------------------------------------------------------------------------------------------------------


def test_raw_red_that_does_not_clip_follows_pressure_and_clipped_red_does_not(scene) -> None:
    small = load_scene(
        "thesis_ridged_red", {"camera.resolution_px": [500, 376], "camera.scale_px_per_mm": 20.0,
                              "camera.lens.focal_length_mm": 2.0, "grid.size_mm": 12.8, "grid.samples": 320},
    )  # fmt: skip
    finger = small.finger.model_copy(update={"ridges": None})
    found = run_colour(small.model_copy(update={"finger": finger}), slopes=(0.3,), forces=(1.0,))
    rows = {row.what: row for row in found.rows}
    model = rows["raw red at less exposure, roughness model"]
    assert model.correlation > 0.98
    assert model.rms_percent < 5
    clipped = rows["raw red, of the frame"]
    assert clipped.full_share > 0.8
    assert clipped.correlation is None or clipped.correlation < 0.8
    assert rows["raw red, at less exposure"].full_share < 0.01
