"""LED light of another spectrum than white: closed forms, limits, and every way to a frame against figures by hand."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy import integrate
from test_fast_agreement import check, differences

from evanesce.api.camera import Camera
from evanesce.bundle.layout import Shot
from evanesce.bundle.write import Rig
from evanesce.chain.fast import FastCamera
from evanesce.chain.simulate import simulate, simulate_card, solve_contact
from evanesce.core.states import PlateLight
from evanesce.dataset.rigs import RigCamera, rig_with_effects
from evanesce.effects.protocol import Context
from evanesce.effects.rig import glass_dispersion
from evanesce.evaluation.agreement import cases, coarser
from evanesce.live.engine import Engine
from evanesce.optics.glass import soda_lime_absorption
from evanesce.optics.interface import critical_angle, decay_constant, fresnel_reflectance
from evanesce.optics.projection import Projection
from evanesce.optics.seen import at_wavelength, seen_at, under_lamp
from evanesce.optics.spectrum import (
    LINES,
    Spectrum,
    led_line,
    luminous_efficiency,
    pdms_index,
    soda_lime_index,
    spectrum_of,
    white_bands,
)
from evanesce.prediction.point import Nuisances
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import View
from evanesce.render.bands import banded, bands_of, in_band
from evanesce.render.fast.transport import render_fast
from evanesce.render.reference.path import render
from evanesce.rig import Scene, load_scene
from evanesce.sensor.lens import lens_blur
from evanesce.sensor.pixel import photon_count
from evanesce.studies.estimator.study import LitPress
from evanesce.studies.voltage.press import Press
from evanesce.studies.voltage.reduced_rig import ReducedRig
from evanesce.studies.voltage.unknowns import Plan
from support.rigs import hard_contact, need, small_rig

PLANCK_LIGHT_SPEED_J_NM = 6.62607015e-34 * 2.99792458e8 * 1e9

# A coarse camera on a rig of two lit edges: seconds for the light of one index.
COARSE: dict[str, Any] = {
    "camera.resolution_px": [120, 90],
    "camera.scale_px_per_mm": 5.9,
    "camera.pixel.pitch_um": 31.0,
    "camera.lens.distortion": {},
    "camera.tilt_x_deg": 1.3,
    "camera.exposure_ms": 0.1,
    "finger.position_mm": [0.4, -0.3],
    "grid.samples": 256,
    "grid.size_mm": 12.8,
    "leds.edges": ["left", "top"],
    "leds.edge": {},
    "plate.size_mm": [62.0, 47.0],
    "plate.absorption_coefficient_per_mm": 0.002,
    "leds.circuit": {},
    "leds.voltage_V": 11.5,
}


def red_scene(name: str = "thesis", **changes: Any) -> Scene:
    return load_scene(name, COARSE | {"leds.spectrum": "red"} | changes)


def by_hand(scene: Scene, wavelength: float = 634.0) -> Scene:
    """Return a white scene whose figures are those of one wavelength, written out from the published formulas."""
    um = 1e-3 * wavelength

    def glass(at: float) -> float:
        return 1.5130 - 0.003169 * at**2 + 0.003962 / at**2

    def silicone(at: float) -> float:
        return float(np.sqrt(1 + 1.0093 * at**2 / (at**2 - 0.013185)))

    plate, camera = scene.plate, scene.camera
    index = plate.refractive_index + (glass(um) - glass(0.5893))
    # The pinhole stays: its distance from the plate's apparent depth changes by as much as that depth does.
    nearer = plate.thickness_mm * (1.0 / index - 1.0 / plate.refractive_index)
    focal_px = camera.lens.focal_length_mm * 1e3 / camera.pixel.pitch_um
    tilt = np.deg2rad(camera.tilt_x_deg)
    along = nearer / np.cos(tilt)
    axis = Projection.of(camera, plate).axes[:, 2]
    assert axis[2] == pytest.approx(np.cos(tilt), rel=1e-12)  # no other tilt in these scenes
    centre = tuple(float(c + along * a) for c, a in zip(camera.centre_mm, axis[:2], strict=True))
    return scene.model_copy(
        update={
            "leds": scene.leds.model_copy(update={"spectrum": "white"}),
            "plate": plate.model_copy(
                update={
                    "refractive_index": index,
                    "absorption_coefficient_per_mm": plate.absorption_coefficient_per_mm
                    * float(soda_lime_absorption(wavelength)),
                }
            ),
            "finger": scene.finger.model_copy(
                update={"refractive_index": scene.finger.refractive_index + silicone(um) - silicone(0.5893)}
            ),
            "camera": camera.model_copy(
                update={
                    "wavelength_nm": wavelength,
                    "scale_px_per_mm": focal_px / (focal_px / camera.scale_px_per_mm + along),
                    "centre_mm": centre,
                }
            ),
        }
    )


def close(found: Any, expected: Any) -> None:
    """Compare frames or light of two scenes whose figures agree to the last digits."""
    found, expected = np.asarray(found, float), np.asarray(expected, float)
    assert expected.max() > 1.3 * np.median(expected)  # there is a contact to be seen
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * expected.max())


# --- the spectrum itself


def test_a_line_has_its_peak_and_width_and_moves_with_the_junction() -> None:
    for kind, line in LINES.items():
        for warming in (0.0, 33.0):
            scene = load_scene("thesis", {"leds.spectrum": kind, "leds.circuit": {"warming_K": warming}})
            found = spectrum_of(scene.leds)
            top = found.wavelength_nm[np.argmax(found.power)]
            assert top == pytest.approx(line.peak_nm + line.shift_nm_per_K * warming, abs=1e-9)
            w = np.linspace(found.wavelength_nm[0], found.wavelength_nm[-1], 40_001)
            half = w[led_line(w, top, line.width_nm) >= 0.5]
            assert half[-1] - half[0] == pytest.approx(line.width_nm, abs=0.01)
            assert found.power[0] < 1e-6  # nothing is cut off


def test_red_leds_sold_as_625_nm_have_that_dominant_wavelength() -> None:
    """The data sheet names 634 nm for the peak and 620 to 630 nm, usually 625, for the dominant wavelength.

    By the colour matching functions of Wyman et al. (2013), which this code does not have: the wavelength whose
    chromaticity lies on the line from equal energy through the LED's.
    """

    def lobe(w: Any, peak: float, low: float, high: float) -> Any:
        return np.exp(-0.5 * ((w - peak) * np.where(w < peak, low, high)) ** 2)

    def xyz(w: Any) -> Any:
        x = 0.362 * lobe(w, 442.0, 0.0624, 0.0374) + 1.056 * lobe(w, 599.8, 0.0264, 0.0323)
        x = x - 0.065 * lobe(w, 501.1, 0.0490, 0.0382)
        y = 0.821 * lobe(w, 568.8, 0.0213, 0.0247) + 0.286 * lobe(w, 530.9, 0.0613, 0.0322)
        z = 1.217 * lobe(w, 437.0, 0.0845, 0.0278) + 0.681 * lobe(w, 459.0, 0.0385, 0.0725)
        return np.stack([x, y, z])

    found = spectrum_of(load_scene("thesis", {"leds.spectrum": "red"}).leds)
    colour = np.trapezoid(xyz(found.wavelength_nm) * found.power, found.wavelength_nm)
    pure = xyz(np.linspace(600.0, 650.0, 501))

    def bearing(c: Any) -> Any:
        return np.arctan2(c[1] / c.sum(axis=0) - 1 / 3, c[0] / c.sum(axis=0) - 1 / 3)

    order = np.argsort(bearing(pure))
    dominant = np.interp(bearing(colour), bearing(pure)[order], np.linspace(600.0, 650.0, 501)[order])
    assert 620.0 < dominant < 630.0


def test_photons_of_a_joule_are_those_of_the_mean_wavelength() -> None:
    """N = int P(w) w dw / (h c int P dw), by a quadrature of its own on a lopsided spectrum."""
    w, p = np.array([560.0, 601.0, 640.0, 700.0]), np.array([0.0, 3.0, 0.7, 0.2])
    spectrum = Spectrum(w, p)

    def power(at: float) -> float:
        return float(np.interp(at, w, p))

    def integral(f: Callable[[float], float]) -> float:
        return sum(integrate.quad(f, a, b, epsabs=1e-11)[0] for a, b in itertools.pairwise(w))

    joule = integral(power)
    photons = integral(lambda at: power(at) * at) / (PLANCK_LIGHT_SPEED_J_NM * joule)
    one = photon_count(
        np.ones(1), pitch_um=1e3, fill_factor=1.0, exposure_s=1.0, wavelength_nm=spectrum.mean_wavelength_nm
    )  # 1 W/mm^2 on 1 mm^2 for 1 s
    assert float(one[0]) == pytest.approx(photons, rel=1e-10)
    weighted = integral(lambda at: power(at) * at * at**2) / integral(lambda at: power(at) * at)
    assert spectrum.photon_mean(lambda at: at**2) == pytest.approx(weighted, rel=1e-6)


def test_bands_conserve_photons_and_their_mean() -> None:
    spectrum = Spectrum(np.array([560.0, 601.0, 640.0, 660.0, 700.0]), np.array([0.0, 3.0, 0.0, 0.0, 0.2]))
    for count in (1, 4, 7):
        bands = spectrum.bands(count)
        assert sum(b.weight for b in bands) == pytest.approx(1.0, abs=1e-12)
        mean = sum(b.weight * b.wavelength for b in bands)
        assert mean == pytest.approx(spectrum.photon_mean(lambda w: w), abs=2e-3)
        assert all(a.wavelength < b.wavelength for a, b in itertools.pairwise(bands))


def test_a_line_without_width_is_one_wavelength(tmp_path: Any) -> None:
    """A file of one narrow line: all bands lie within it, and the scene is seen at its middle."""
    (tmp_path / "line.csv").write_text("wavelength_nm,power\n624.9,0\n625,1\n625.1,0\n")
    leds = red_scene().with_(leds__spectrum=str(tmp_path / "line.csv")).leds
    assert spectrum_of(leds).mean_wavelength_nm == pytest.approx(625.0, abs=1e-9)
    scene = red_scene().model_copy(update={"leds": leds})
    for band in bands_of(scene, 3):
        narrow, seen = in_band(scene, band), seen_at(scene)
        assert narrow.plate.refractive_index == pytest.approx(seen.plate.refractive_index, abs=1e-5)
        assert narrow.camera.wavelength_nm == pytest.approx(seen.camera.wavelength_nm, abs=0.1)


# --- the scene as its light sees it


def test_white_light_leaves_the_very_scene_and_its_bytes() -> None:
    scene = load_scene("thesis", COARSE)
    assert seen_at(scene) is scene
    assert under_lamp(scene) is scene
    assert [in_band(scene, b).plate.absorption_coefficient_per_mm for b in white_bands(2)] == [0.002, 0.002]
    assert "figures_at_nm" not in scene.as_dict()
    # of a version in which the renderer asks for no spectrum, but for where its flank is looked up
    frame = FastCamera(scene, "numpy").press(2.1, seed=3).data
    assert hashlib.sha256(frame.tobytes()).hexdigest() == (
        "3167aa3449eb2b576a3e392b0b53841bfff39ffd56eb0d9f6226398a232953e0"
    )


def test_a_seen_scene_is_seen_once_and_survives_a_file() -> None:
    scene = red_scene()
    seen = seen_at(scene)
    assert seen_at(seen) is seen
    assert seen.figures_at_nm == 634.0
    assert seen_at(Scene.from_dict(seen.as_dict())) == seen
    # and from there another wavelength is the same as from the scene itself
    twice, once = at_wavelength(seen, 850.0), at_wavelength(scene, 850.0)
    for a, b in ((twice.plate, once.plate), (twice.finger, once.finger)):
        for name in ("refractive_index", "absorption_coefficient_per_mm"):
            if hasattr(a, name):
                assert getattr(a, name) == pytest.approx(getattr(b, name), rel=1e-12)
    assert twice.camera.scale_px_per_mm == pytest.approx(once.camera.scale_px_per_mm, rel=1e-12)


@pytest.mark.parametrize("wavelength", [450.0, 634.0, 850.0])
def test_the_camera_does_not_move_when_the_light_changes(wavelength: float) -> None:
    scene = red_scene(**{"camera.tilt_y_deg": -2.1, "camera.roll_deg": 11.0})
    seen = at_wavelength(scene, wavelength)
    before, after = (Projection.of(s.camera, s.plate) for s in (scene, seen))
    np.testing.assert_allclose(after.pinhole, before.pinhole, atol=1e-11)
    # what it sees of the contact plane is Snell's: a ray through the bottom face at the same angle
    tan = np.array([0.21])
    air = tan * before.clearance
    sine = np.sin(np.arctan(tan)) / seen.plate.refractive_index
    expected = air + seen.plate.thickness_mm * np.tan(np.arcsin(sine))
    level = red_scene(**{"camera.tilt_x_deg": 0.0})
    flat = at_wavelength(level, wavelength)
    x, _ = Projection.of(flat.camera, flat.plate).ray_to_plate(tan, 0.0 * tan)
    own = Projection.of(level.camera, level.plate)
    np.testing.assert_allclose(x - own.pinhole[0], expected - air + tan * own.clearance, rtol=1e-9)


def test_figures_at_the_red_line_are_the_published_ones() -> None:
    """Indices at 634 nm; sin(critical) = 1/n; normal reflectance ((n-1)/(n+1))^2; the evanescent field's decay."""
    seen, hand = seen_at(red_scene()), by_hand(red_scene())
    for part in ("plate", "finger"):
        assert getattr(seen, part).refractive_index == pytest.approx(getattr(hand, part).refractive_index, abs=1e-12)
    n = seen.plate.refractive_index
    assert n == pytest.approx(1.523 - 0.00173, abs=2e-5)
    assert float(np.sin(critical_angle(n))) == pytest.approx(1 / n, rel=1e-12)
    assert float(fresnel_reflectance(1.0, n, 1.0)) == pytest.approx(((n - 1) / (n + 1)) ** 2, rel=1e-12)
    # at 45 degrees: 2 pi/wavelength sqrt(n^2/2 - 1), longer than at the former 550 nm by the ratio of wavelengths
    deep = float(decay_constant(np.cos(np.pi / 4), seen.camera.wavelength_nm, n))
    assert deep == pytest.approx(2e6 * np.pi / 634.0 * np.sqrt(n**2 / 2 - 1), rel=1e-9)


def test_iron_takes_the_red_as_two_published_glasses_do() -> None:
    """Rubin's clear glass to 1 %, as refractiveindex.info tabulates it; Vogt's other clear glass within a third."""
    k = {450.0: 1.925e-7, 550.0: 2.200e-7, 630.0: 6.913e-7, 850.0: 3.150e-6}
    for w, value in k.items():
        expected = (value / w) / (k[550.0] / 550.0)
        assert float(soda_lime_absorption(w)) == pytest.approx(expected, rel=0.01)
    vogt = {630.0: 5.370e-7, 850.0: 2.380e-6, 550.0: 2.430e-7}
    for w in (630.0, 850.0):
        ratio = (vogt[w] / w) / (vogt[550.0] / 550.0)
        assert 0.65 < ratio / float(soda_lime_absorption(w)) < 1.5
    seen = seen_at(red_scene())
    assert seen.plate.absorption_coefficient_per_mm == pytest.approx(0.002 * float(soda_lime_absorption(634.0)))
    assert seen_at(red_scene(**{"plate.absorption_coefficient_per_mm": 0.0})).plate.absorption_coefficient_per_mm == 0


def test_silicone_scatters_less_of_longer_light_and_stays_where_no_power_is_given() -> None:
    milky = {"finger.scattering_length_mm": 1.0, "finger.diffuse_reflectance": 1.0}
    assert seen_at(red_scene(**milky)).finger.scattering_length_mm == 1.0
    rayleigh = seen_at(red_scene(**milky, **{"finger.scattering_power": 4.0})).finger
    assert rayleigh.scattering_length_mm == pytest.approx((634.0 / 550.0) ** 4, rel=1e-9)


def test_diffraction_grows_with_the_wavelength() -> None:
    """The lens's blur of a scene in focus is Airy's: its spread in pixels goes as the wavelength."""
    fine = {"camera.pixel.pitch_um": 0.5, "camera.scale_px_per_mm": 450.0, "camera.tilt_x_deg": 0.0}
    widths = []
    for kind in ("white", "infrared"):
        seen = seen_at(red_scene(**fine, **{"leds.spectrum": kind}))
        blur = lens_blur(seen.camera, seen.plate)
        assert blur is not None
        kernel = np.asarray(blur.kernels[0], float)
        middle = kernel.shape[0] // 2
        widths.append(1.0 / np.sqrt(kernel[middle, middle]))  # Airy's peak goes as 1/wavelength^2
    assert widths[1] / widths[0] == pytest.approx(850.0 / 550.0, rel=0.02)


def test_warm_red_leds_are_seen_at_a_longer_wavelength() -> None:
    warm = red_scene(**{"leds.circuit": {"warming_K": 40.0}})
    assert seen_at(warm).camera.wavelength_nm == 640.0  # 634 + 0.14 x 40 = 639.6


def test_dispersion_as_an_effect_is_beyond_that_of_the_light_itself() -> None:
    def index(strength: float, **changes: Any) -> float:
        scene = red_scene(**changes, **{"effects.glass_dispersion.strength": strength})
        return solve_contact(scene, None, seed=0)[0].plate.refractive_index

    shift = float(soda_lime_index(634.0)) - float(soda_lime_index(589.3))
    assert index(0.0) - 1.523 == pytest.approx(shift, abs=1e-9)
    assert index(0.7) - 1.523 == pytest.approx(1.7 * shift, abs=2e-5)
    scene = load_scene("thesis", COARSE)
    same = glass_dispersion.apply(scene, glass_dispersion.Parameters(strength=0.7), Context(scene, 0))
    assert index(0.7, **{"leds.spectrum": "white"}) == same.plate.refractive_index


def test_pdms_at_850_nm_is_that_of_the_resonance_continued() -> None:
    """Against measured PDMS: n falls by 0.0046 from 632.8 to 850 nm within 0.002 for one resonance at 115 nm."""
    fall = float(pdms_index(632.8)) - float(pdms_index(850.0))
    assert 0.0026 < fall < 0.0066


# --- every way to a frame


@pytest.fixture(scope="module")
def lit() -> tuple[Scene, Scene]:
    scene = red_scene()
    return scene, by_hand(scene)


WAYS: dict[str, Callable[[Scene], Any]] = {
    "simulate": lambda s: simulate(s, 2.1, seed=3, render=render_fast).frame.raw,
    "fast camera": lambda s: FastCamera(s, "numpy").press(2.1, seed=3).data,
    "api camera": lambda s: Camera(s).shoot(2.1, seed=3).raw,
    "api camera, given contact": lambda s: Camera(s).expose(solve_contact(s, 2.1, seed=0)[1], seed=3).raw,
    "retuned camera": lambda s: FastCamera(s.with_(leds__voltage_V=10.9), "numpy").retuned(s).press(2.1, seed=3).data,
    "general chain of the fast camera": lambda s: (
        FastCamera(s.with_(camera__pixel__prnu=0.001), "numpy").press(2.1, seed=3).data
    ),
    "bundle": lambda s: Rig(s, 3).press(Shot(index=1, force_N=2.1, voltage_V=11.5, time_s=0.0))[0],
    "critic": lambda s: Predictor(s, ()).picture(
        s, View(kind="press", force_N=2.1, voltage_V=11.5, time_s=0.0), Nuisances()
    ),
    "data set": lambda s: (
        RigCamera(rig_with_effects(s, 3), 3)
        .frame(solve_contact(s, 2.1, seed=0)[1], index=2, time_s=0.0, with_raw=True)
        .data
    ),
    "live page": lambda s: Engine(s, backend="numpy").prepare(coarser=1).frame,
    "voltage study": lambda s: Press.of(s, 2.1, seed=3).levels(11.5),
    "estimator study": lambda s: LitPress.of(s, 2.1, 3).frame(11.5, 3).data,
}


@pytest.mark.parametrize("way", WAYS)
def test_every_way_to_a_frame_sees_red_at_its_wavelength(way: str, lit: tuple[Scene, Scene]) -> None:
    red, hand = lit
    close(WAYS[way](red), WAYS[way](hand))


def test_the_figures_at_the_lights_wavelength_matter(lit: tuple[Scene, Scene]) -> None:
    """The comparison above can fail: the same strips, taken for white, give another frame."""
    red, hand = lit
    white = red.model_copy(update={"leds": hand.leds})
    assert np.abs(WAYS["simulate"](white).astype(float) - WAYS["simulate"](hand)).max() > 20.0


def test_sampled_rigs_of_the_voltage_study_are_seen_too() -> None:
    red = red_scene("thesis_ridged", **{"camera.tilt_x_deg": 0.0})
    found, hand = (ReducedRig(s, Plan(forces=(2.0,), voltages=(11.5,))) for s in (red, by_hand(red)))
    assert found.charge == pytest.approx(hand.charge, rel=1e-9)
    assert found.sigma == pytest.approx(hand.sigma, rel=1e-9)
    np.testing.assert_allclose(found.fields.coupling, hand.fields.coupling, rtol=1e-9)


@pytest.mark.parametrize("kind", ["checkerboard", "square"])
def test_cards_are_seen_in_a_lamps_white_light(kind: Any, lit: tuple[Scene, Scene]) -> None:
    """LEDs off: frames of cards do not depend on what light the LEDs have."""
    red, hand = lit
    white = red.model_copy(update={"leds": hand.leds})
    np.testing.assert_array_equal(Camera(red).shoot_target(kind, seed=2), Camera(white).shoot_target(kind, seed=2))
    np.testing.assert_array_equal(Rig(red, 2).card(kind, 5), Rig(white, 2).card(kind, 5))
    view = View(kind=kind)
    shown = [Predictor(s, ()).picture(s, view, Nuisances()) for s in (red, white)]
    np.testing.assert_array_equal(*shown)
    assert shown[0].max() > 20


def test_bands_of_a_line_are_each_seen_at_their_own_wavelength() -> None:
    """A renderer that records its scenes: each band's figures are those of the nominal scene at that wavelength."""
    shown: list[Scene] = []

    def record(scene: Scene, state: Any, *, seed: int, view: Any) -> PlateLight:
        shown.append(scene)
        flat = np.full(view.shape, scene.plate.refractive_index)
        return PlateLight(radiance=flat, variance=0 * flat, focal_px=1.0, principal_point=(0.0, 0.0))

    red = red_scene()
    light = banded(record, 3)(seen_at(red), None, seed=7)
    assert np.mean([s.camera.wavelength_nm for s in shown]) == pytest.approx(634.2, abs=0.1)  # photons, not power
    for scene in shown:
        alone = at_wavelength(red, scene.camera.wavelength_nm)
        assert scene.plate.refractive_index == pytest.approx(alone.plate.refractive_index, abs=1e-12)
        assert scene.plate.absorption_coefficient_per_mm == pytest.approx(
            alone.plate.absorption_coefficient_per_mm, rel=1e-9
        )
        assert scene.camera.scale_px_per_mm == pytest.approx(alone.camera.scale_px_per_mm, rel=1e-12)
    # dispersion is nearly linear over the line: the mean of the bands is the line's middle
    np.testing.assert_allclose(light.radiance, seen_at(red).plate.refractive_index, atol=1e-5)


@pytest.mark.slow
def test_path_tracer_and_fast_renderer_agree_on_a_red_scene() -> None:
    need("llvm")
    red = seen_at(small_rig(leds__spectrum="red", leds__voltage_V=12.0, leds__edge={"top": {"offset_mm": 1.7}}))
    assert red.plate.absorption_coefficient_per_mm > 0.005
    check(differences(red, hard_contact(), samples=64))


def test_the_path_tracer_takes_figures_of_the_chain() -> None:
    """The chain hands the path tracer the seen scene: the same rays as by hand."""
    need("llvm")
    red = small_rig(leds__spectrum="red", leds__voltage_V=12.0)
    found = [
        simulate(s, 1.0, seed=4, contact=lambda *_, **__: hard_contact(), render=render, samples_per_pixel=4, passes=2)
        for s in (red, by_hand(red))
    ]
    np.testing.assert_allclose(found[0].plate_light.radiance, found[1].plate_light.radiance, rtol=1e-3)
    assert simulate_card(red, "square", seed=1, samples_per_pixel=1, passes=2).data.max() > 20


def test_infrared_light_is_lost_in_the_plate_and_to_the_filter() -> None:
    """At 850 nm a clear plate absorbs nine times as much as in green: the far end of a lit strip's field is darker."""
    seen = seen_at(red_scene(**{"leds.spectrum": "infrared"}))
    assert seen.camera.wavelength_nm == 850.0
    assert seen.plate.absorption_coefficient_per_mm == pytest.approx(0.002 * 9.265, rel=0.01)
    assert float(luminous_efficiency(850.0)) < 1e-5


def test_cases_of_the_renderers_agreement_are_seen() -> None:
    assert all(seen_at(case.scene) is case.scene for case in cases(coarser(16)))
