"""A scene of one's own rig: presets, parts, answers, comments, explanations."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

import evanesce as ev
from evanesce.api.key_change import change_of
from evanesce.api.own_camera import calibrated_camera
from evanesce.api.own_exposure import exposed, figures
from evanesce.api.own_rig import PRESETS, RigAnswers, own_rig, preset_heading, voltage_of
from evanesce.core.errors import InputError
from evanesce.optics.glass import soda_lime_absorption
from evanesce.optics.led_circuit import segment_current
from evanesce.optics.spectrum import soda_lime_index
from evanesce.rig import Scene, load_scene
from evanesce.rig.catalogue import CAMERAS, MATERIALS, PACKAGES
from evanesce.rig.commented import commented
from evanesce.rig.explain import explained, frame_effects, scene_keys

SMALL = {"leds.pitch_mm": 12.0, "grid.samples": 160, "grid.size_mm": 12.8}


def small(preset: str) -> Scene:
    scene = load_scene(preset)
    cols, rows = scene.camera.resolution_px
    factor = max(1, min(cols // 100, int(50.0 / scene.camera.pixel.pitch_um)))
    cut = {"camera.resolution_px": [cols - cols % factor, rows - rows % factor]}
    if scene.finger.fingerprint is None:
        cut |= {"grid.samples": 160}
    return ev.coarser(scene.with_(cut), factor)


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_shows_a_contact_on_a_dark_frame(preset: str) -> None:
    scene = small(preset)
    shot = ev.Camera(scene).shoot(max(scene.press.forces_N or ()), seed=1)
    mask = shot.truth.mask
    raw = shot.raw.astype(float) - scene.camera.pixel.black_level_DN
    full = 2.0**scene.camera.pixel.bits - 1.0 - scene.camera.pixel.black_level_DN
    assert mask.sum() > 20
    assert 0.05 < np.percentile(raw[mask], 99) / full < 0.9
    assert np.median(raw[~mask]) < 0.1 * np.median(raw[mask])


def test_what_is_simulated_in_place_of_a_prism_is_said() -> None:
    assert "NOT simulated" in preset_heading("prism_reader")
    assert "NOT simulated" in commented(load_scene("prism_reader"), preset_heading("prism_reader"))


@pytest.mark.parametrize("name", ev.shipped_scenes())
def test_a_commented_scene_is_the_scene(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    path = tmp_path / "commented.toml"
    path.write_text(commented(scene, "A heading\n\nof lines"), encoding="utf-8")
    assert load_scene(path) == scene


def test_a_key_behind_a_comment_sign_holds_as_it_stands_there(tmp_path: Path) -> None:
    """Taking the signs off all keys with a value changes nothing."""
    scene = load_scene("gripper")
    lines = commented(scene).splitlines()
    uncommented = [
        line[2:] if line.startswith("# ") and " = " in line and line[2:].split(" = ")[0].isidentifier() else line
        for line in lines
    ]
    assert uncommented != lines
    path = tmp_path / "all.toml"
    path.write_text("\n".join(uncommented), encoding="utf-8")
    assert tomllib.loads(path.read_text(encoding="utf-8"))["camera"]["pixel"]["bits"] == 12
    assert load_scene(path).as_dict() == scene.as_dict()


def test_soda_lime_of_the_catalogue_is_that_of_the_optics() -> None:
    for wavelength in (480.0, 550.0, 634.0, 850.0):
        glass = MATERIALS["glass"]
        assert glass.index(wavelength) == pytest.approx(float(soda_lime_index(wavelength)), abs=1e-3)
    for wavelength in (450.0, 550.0, 634.0, 850.0):
        rubin = 4e6 * math.pi * 1.769e-7 / 550.0 * float(soda_lime_absorption(wavelength))
        assert glass.absorption_per_mm(wavelength) == pytest.approx(rubin, rel=0.02)


@pytest.mark.parametrize(("material", "published"), [("pmma", 1.4905), ("pc", 1.5846)])
def test_plastics_have_their_published_index_at_the_sodium_line(material: str, published: float) -> None:
    assert MATERIALS[material].index(589.3) == pytest.approx(published, abs=2e-4)


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("package", ["2835", "0603"])
def test_every_part_makes_a_valid_scene(camera: str, package: str) -> None:
    part = CAMERAS[camera]
    rig = own_rig(RigAnswers(camera=camera, package=package, field_mm=40.0, distance_mm=None))
    assert rig.scene.camera.resolution_px == part.resolution_px
    assert rig.scene.camera.scale_px_per_mm == pytest.approx(part.resolution_px[0] / 40.0, rel=1e-4)
    assert rig.scene.leds.emitting_width_mm == PACKAGES[package].width_mm
    assert any("distortion" in note for note in rig.notes)


def test_distance_and_scale_are_the_same_by_the_projection() -> None:
    rig = own_rig(
        RigAnswers(thickness_mm=8.0, material="pmma", camera="usb", distance_mm=70.0, pixel_um=3.0, focal_mm=4.0)
    )
    assert figures(rig.scene).distance_mm == pytest.approx(70.0, abs=2e-3)


def test_a_plastic_plate_in_infrared_is_not_dispersed_as_glass() -> None:
    scene = own_rig(RigAnswers(material="pmma", spectrum="infrared")).scene
    assert scene.figures_at_nm == scene.camera.wavelength_nm == 850.0
    assert scene.plate.refractive_index == pytest.approx(1.4835, abs=1e-4)
    assert scene.leds.circuit.forward_voltage_V == 1.46
    with pytest.raises(InputError, match="material"):
        own_rig(RigAnswers(spectrum="red"), "pmma_infrared")


def test_a_current_in_place_of_the_voltage() -> None:
    scene = load_scene("thesis")
    voltage = voltage_of(scene, 7.0)
    assert float(segment_current(scene.leds.circuit, voltage)) == pytest.approx(7e-3, rel=1e-3)
    assert own_rig(RigAnswers(current_mA=7.0)).scene.leds.voltage_V == voltage


def test_exposure_brings_the_contact_to_half_of_full_scale() -> None:
    rig = own_rig(RigAnswers(tip_radius_mm=6.0, forces_N=(0.5,), settings={"camera.exposure_ms": 0.01}), "gripper")
    scene, level = exposed(rig.scene)
    assert level == pytest.approx(0.5, abs=0.02)
    assert figures(scene).level == pytest.approx(0.5, abs=0.03)
    assert not figures(scene).warnings()


def test_a_dark_rig_is_told() -> None:
    dark = own_rig(RigAnswers(voltage_V=7.0), "gripper").scene
    assert any("full scale" in line for line in figures(dark).warnings())


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ({"thickness_mm": 80.0}, ["plate.thickness_mm", "80", "0.1 to 50 mm"]),
        ({"index": math.nan}, ["plate.refractive_index", "nan"]),
        ({"material": "wood"}, ["material", "wood", "pmma"]),
        ({"package": "9999"}, ["package", "2835"]),
        ({"package": "5050", "thickness_mm": 3.0}, ["leds.emitting_height_mm", "3.5", "3 mm"]),
        ({"camera": "pi_9"}, ["camera", "pi_hq"]),
        ({"edges": ("left", "up")}, ["leds.edges", "up", "right"]),
        ({"current_mA": 1.0, "voltage_V": 9.0}, ["current_mA", "voltage"]),
        ({"current_mA": 1e6}, ["current_mA", "60 V"]),
        ({"field_mm": 0.0}, ["field_mm", "4e+03 mm"]),
        ({"field_mm": 30.0, "distance_mm": 30.0}, ["distance_mm", "field_mm"]),
        ({"finger": "toe"}, ["finger", "ridged"]),
        ({"ridge_pitch_um": 500.0}, ["ridge_height_um", "without ridges"]),
        ({"finger": "ridged", "ridge_pitch_um": 300.0}, ["width_um", "pitch"]),
        ({"silicone": "silskin_0", "modulus_MPa": 0.2}, ["silicone", "modulus"]),
        ({"noir": True}, ["noir", "colour"]),
        ({"camera": "machine_vision", "colour": True}, ["colour", "monochrome"]),
        ({"settings": {"plate.thick_mm": 3.0}}, ["plate.thick_mm", "thickness_mm"]),
    ],
)
def test_wrong_answers_are_one_line(answers: dict[str, object], words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        own_rig(RigAnswers(**answers))
    line = str(caught.value)
    assert "\n" not in line
    assert all(word in line for word in words), line


def test_a_calibration_loses_the_plates_refraction() -> None:
    """The lens's own distortion comes back from a calibration through the plate."""
    truth = load_scene("thesis").with_({"plate.thickness_mm": 10.0, "camera.lens.distortion": {"k1": -0.2, "k2": 0.05}})
    from evanesce.evaluation.calibrated_rig import CardErrors, calibrated

    made = calibrated(truth, np.random.default_rng(1), CardErrors(corner_noise_px=0.001))
    found, left = calibrated_camera(made, truth.camera, truth.plate)
    assert left < 0.05
    assert found["scale_px_per_mm"] == pytest.approx(truth.camera.scale_px_per_mm, rel=2e-3)
    assert found["distortion"]["k1"] == pytest.approx(-0.2, abs=0.01)
    assert calibrated_camera(made, truth.camera, truth.plate.model_copy(update={"thickness_mm": 0.1}))[0]["distortion"][
        "k1"
    ] != pytest.approx(-0.2, abs=0.01)


def test_every_key_of_a_scene_is_explained() -> None:
    assert set(frame_effects()) == set(scene_keys())
    assert all(frame_effects().values())


def test_a_key_tells_unit_range_and_source() -> None:
    (key,) = explained("plate.thickness_mm")
    assert key.as_dict() | {"in_frame": ""} == {
        "key": "plate.thickness_mm", "unit": "mm", "range": [0.1, 50.0], "default": 6.0, "required": False,
        "null": None, "meaning": "thickness", "source": "thesis, chapter 5", "in_frame": "",
            "choices": [],
    }  # fmt: skip
    assert len(explained("leds.circuit")) == 13
    assert explained("leds.edge.left.voltage_V")[0].name == "leds.edge.EDGE.voltage_V"
    with pytest.raises(InputError, match=r"plate\.thickness_mm"):
        explained("thicknes")


@pytest.mark.parametrize(
    ("key", "area", "signal"),
    [
        ("camera.exposure_ms", 0.0, 0.10),
        ("camera.lens.f_number", 0.0, 1.1**-2 - 1),
        ("leds.circuit.efficacy_W_per_A", 0.0, 0.10),
        ("finger.modulus_factor", 1.1 ** (-2 / 3) - 1, None),
        ("finger.tip_radius_mm", 1.1 ** (2 / 3) - 1, None),
        ("plate.thickness_mm", 0.0, 1 / 1.1 - 1),
    ],
)
def test_what_a_key_is_said_to_do_is_what_it_does(key: str, area: float, signal: float | None) -> None:
    scene = small("gripper").with_({"camera.exposure_ms": 0.2, "press.forces_N": [1.0]})
    found = change_of(scene, key)
    assert not found.full
    assert found.area_mm2[1] / found.area_mm2[0] - 1 == pytest.approx(area, abs=0.01)
    if signal is not None:
        assert found.contact[1] / found.contact[0] - 1 == pytest.approx(signal, abs=0.02)
