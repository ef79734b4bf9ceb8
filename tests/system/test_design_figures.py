"""Each objective of a design against a closed form, a count of photons or the camera's own geometry."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import stats
from scipy.constants import c as light_speed
from scipy.constants import h as planck
from scipy.constants import k as boltzmann
from scipy.optimize import brentq

from evanesce.core.errors import InputError
from evanesce.design import secondary
from evanesce.design.evaluate import contact_irradiance, evaluate, plain_job
from evanesce.design.measurement import CalibratedMeasurement
from evanesce.design.objective import Prediction, measured, prepare_fields, prepared
from evanesce.design.question import Design
from evanesce.design.secondary import figures, plate_deflection_um
from evanesce.optics.projection import Projection
from evanesce.render.kept import forget
from evanesce.rig import Scene
from support.design_rig import PERFECT, camera_rig, question

NOTHING = Prediction(samples=(), error_percent=3.0, standard_percent=0.5, saturated_share=0.25)


def figures_of(scene: Scene, irradiance: float = 1e-6, **asked: object) -> dict[str, float]:
    return figures(Design(scene=scene), question(**asked), NOTHING, irradiance, None)


def test_motion_blur_is_the_way_of_a_point_in_the_picture():
    """A point of the plate sliding at 7.3 mm/s for 11 ms: its way in pixels over pixels per millimetre."""
    scene = camera_rig(camera__exposure_ms=11.0, camera__centre_mm=(3.1, -2.4))
    found = figures_of(scene, speed_mm_per_s=7.3)
    # On the axis the scale is the scene's own; glass and perspective change it by less than 1e-4 over this way.
    x, y = 3.1 + np.array([0.0, 7.3 * 11e-3]), np.full(2, -2.4)
    u, v = Projection.of(scene.camera, scene.plate).to_image(x, y)
    way_px = float(np.hypot(np.diff(u), np.diff(v))[0])
    assert way_px == pytest.approx(1.445, rel=1e-3)
    assert found["motion_blur"] == pytest.approx(way_px / 18.0, rel=1e-4)
    assert found["exposure"] == 11.0


def test_field_of_view_is_what_the_picture_shows():
    """Where the middles of opposite edges look at on the plate, by the camera's rays through the glass."""
    scene = camera_rig()
    projection = Projection.of(scene.camera, scene.plate)
    cols, rows = scene.camera.resolution_px
    middle = np.array([3.0, -1.5])

    def edge(axis: int, pixel: float) -> float:
        """Plate coordinate that appears at a pixel coordinate, along an axis through the camera's middle."""

        def off(value: float) -> float:
            at = [float(scene.camera.centre_mm[0]), float(scene.camera.centre_mm[1])]
            at[axis] = value
            return float(projection.to_image(np.array(at[0]), np.array(at[1]))[axis]) - pixel

        return float(brentq(off, middle[axis] - 20, middle[axis] + 20))

    wide, high = (edge(axis, n - 0.5) - edge(axis, -0.5) for axis, n in ((0, cols), (1, rows)))
    seen = secondary.field_of_view_mm(scene.camera)
    # Off the axis the glass bends rays, by some t (n^2 - 1)/(2 n^3) tan^3 of the angle: 3e-3 here.
    assert seen == (pytest.approx(wide, rel=4e-3), pytest.approx(high, rel=4e-3))
    assert figures_of(scene)["field_of_view"] == pytest.approx(180 / 18.0)


def test_depth_of_field_is_kingslakes_by_the_hyperfocal_distance():
    """near = s (H - f)/(H + s - 2 f), far = s (H - f)/(H - s), H = f^2/(N c) + f, all from the lens."""
    lens = {"focal_length_mm": 6.3, "f_number": 2.2}
    scene = camera_rig(camera__lens=lens, camera__pixel={"pitch_um": 3.1}, camera__scale_px_per_mm=40.0)
    f, number, c = 6.3, 2.2, 3.1e-3
    m = 40.0 * 3.1e-3
    s, hyperfocal = f * (1 + 1 / m), f * f / (number * c) + f
    near, far = s * (hyperfocal - f) / (hyperfocal + s - 2 * f), s * (hyperfocal - f) / (hyperfocal - s)
    # The figure leaves out (s/H)^2, 1e-4 here.
    assert figures_of(scene)["depth_of_field"] == pytest.approx(far - near, rel=2 * (s / hyperfocal) ** 2)


def test_deflection_is_the_thin_plates():
    """Timoshenko, table 23: a point load in the middle of a supported square plate bends it by 0.01160 P a^2/D."""
    a, t, force = 140.0, 3.7, 2.3
    scene = camera_rig(
        plate__size_mm=(a, a), plate__thickness_mm=t, finger__position_mm=(0.0, 0.0),
        leds__edge={"top": {"voltage_V": 9.0}},
    )  # fmt: skip
    rigidity = 70e3 * t**3 / (12 * (1 - 0.2**2))  # soda-lime glass, EN 572-1: 70 GPa, 0.2
    wanted = 1e3 * 0.01160 * force * a**2 / rigidity
    # A contact of 4.5 mm on 140 mm is no point: the middle gives way less, by a few times (side/a)^2, 1e-3.
    found = plate_deflection_um(scene, question(positions_mm=((0.0, 0.0),)))
    assert found == pytest.approx(wanted, rel=6e-3)
    assert found < wanted
    # The largest force counts, and half the thickness bends eight times as far.
    assert plate_deflection_um(scene, question(positions_mm=((0.0, 0.0),), forces_N=(2.3, 0.1))) == found
    thin = camera_rig(
        plate__size_mm=(a, a), plate__thickness_mm=t / 2, finger__position_mm=(0.0, 0.0),
        leds__edge={"top": {"voltage_V": 9.0}}, leds__emitting_height_mm=1.5,
    )  # fmt: skip
    assert plate_deflection_um(thin, question(positions_mm=((0.0, 0.0),))) == pytest.approx(8 * found, rel=1e-9)


@pytest.mark.parametrize("position", [(30.9, -2.1), (3.3, 22.4), (-30.999999, 0.0)])
def test_a_contact_over_the_plates_edge_is_a_reason(position):
    """The tip is on the plate, a part of its contact is not: one line with the position, no error of a series."""
    asked = question(positions_mm=(position,))
    with pytest.raises(InputError, match="reaches over the plate's edge") as error:
        plate_deflection_um(camera_rig(), asked)
    assert f"{position[0]:g}, {position[1]:g}" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_plate_too_small_for_the_contact_is_no_rig():
    """In a search: 10.5 mm of glass about a tip 3.3 mm off its middle is a constraint with its reason."""
    job = plain_job(Design(scene=camera_rig(), threshold=0.35, min_blob_px=20), question(), None)
    found = evaluate(job, {"plate.size_mm[0]": 10.5})
    assert "figures" not in found
    assert "reaches over the plate's edge" in found["reason"]
    # 2.3 N: a radius of some 2.6 mm needs 3.3 + 2.6 mm on that side.
    wide = camera_rig(plate__size_mm=(13.0, 47.0), leds__edge={})
    assert plate_deflection_um(wide, question()) > 0


def lit(exposure_ms: float) -> tuple[Scene, CalibratedMeasurement]:
    """Return a rig with a linear tone curve, its light known, and its measuring."""
    scene = camera_rig(camera__exposure_ms=exposure_ms, camera__tone_curve="linear")
    ready = prepared(scene, question())
    prepare_fields(ready, question())
    return ready, CalibratedMeasurement.of(Design(scene=scene, threshold=0.35, min_blob_px=20), question(), ready)


@pytest.fixture(scope="module", autouse=True)
def _forgotten():
    yield
    forget()


def test_saturation_is_what_a_shorter_exposure_foretells():
    """A linear sensor: the mean level of each pixel in a frame without saturation, times the factor, and shot noise."""
    case, short_ms = question().cases[1], 0.13
    scene, measuring = lit(short_ms)
    dark, shot = measured(measuring, scene, PERFECT, 0, case)
    level = shot.frame.data.astype(float)
    assert dark.saturated_share == 0.0
    inside = (level > 0.85 * level.max()).astype(float)
    # Of lit neighbours only: the rim's own light does not count. A tenth of the noise is left.
    mean = (
        inside * cv2.GaussianBlur(level * inside, (0, 0), 3.0) / np.maximum(cv2.GaussianBlur(inside, (0, 0), 3.0), 0.1)
    )
    pixel = scene.camera.pixel
    # Electrons of one DN of the frame's eight bits.
    electrons = (4095 - pixel.black_level_DN) / 255 * pixel.conversion_gain_e_per_DN
    noise = np.sqrt(255 / electrons)
    shares = []
    for factor in (1.30, 1.33, 1.36):
        scene, measuring = lit(factor * short_ms)
        bright, _ = measured(measuring, scene, PERFECT, 0, case)
        pixels = bright.true_mm2 * 18.0**2
        likely = stats.norm.sf(254.5, factor * mean, noise)
        shares.append((float(likely.sum() / pixels), bright.saturated_share))
        # Binomial: sqrt(p (1 - p)/pixels) is below 0.006; a tenth of a DN in the mean turns 0.014.
        assert shares[-1][1] == pytest.approx(shares[-1][0], abs=0.04)
    assert shares[0][0] < 0.3 < 0.7 < shares[-1][0]
    scene, measuring = lit(20 * short_ms)
    # All of the contact is full, and so is some of its rim: no more than all of it is reported.
    assert measured(measuring, scene, PERFECT, 0, case)[0].saturated_share == 1.0


def test_light_per_watt_counts_photons_and_amperes():
    """Irradiance from the electrons of a frame, E = n_e h c/(lambda eta A t); power by Kirchhoff's law."""
    exposure_ms, case = 0.13, question().cases[0]
    scene, measuring = lit(exposure_ms)
    design = Design(scene=camera_rig(camera__exposure_ms=exposure_ms, camera__tone_curve="linear"))
    irradiance = contact_irradiance(design, question())
    frame = measured(measuring, scene, PERFECT, 0, case)[1].frame.data.astype(float)
    pixel = scene.camera.pixel
    # 8 bits of the 12 less the black level, at the sensor's own gain.
    electrons = frame * ((4095 - pixel.black_level_DN) / 255) * pixel.conversion_gain_e_per_DN
    bright = electrons[frame > 0.5 * frame.max()].mean()
    area_mm2 = (pixel.pitch_um * 1e-3) ** 2 * pixel.fill_factor
    energy = planck * light_speed / (scene.camera.wavelength_nm * 1e-9)
    counted = bright * energy / (pixel.quantum_efficiency * area_mm2 * exposure_ms * 1e-3)
    # Noise lifts the brightest pixel, half of which is the limit, by some 2 %, and the mean above it by less.
    assert irradiance == pytest.approx(counted, rel=0.02)

    c = scene.leds.circuit
    thermal = c.ideality * boltzmann / 1.602176634e-19 * c.temperature_K
    rated = c.rated_current_mA * 1e-3
    saturation = rated / np.expm1((c.forward_voltage_V - rated * c.led_resistance_ohm) / thermal)
    resistor = (c.rated_voltage_V - c.leds_per_segment * c.forward_voltage_V) / rated

    def power(leds: int, voltage: float) -> float:
        def missing(i: float) -> float:
            diode = thermal * np.log1p(i / saturation) + i * c.led_resistance_ohm
            return float(c.leds_per_segment * diode + i * resistor - voltage)

        return leds / c.leds_per_segment * voltage * float(brentq(missing, 0.0, 1.0, xtol=1e-15))

    watts = power(8, 10.0) + power(5, 9.0)  # 4 on left and right each, 5 on top at its own voltage
    found = figures(design, question(), NOTHING, irradiance, None)
    assert found["light_per_watt"] == pytest.approx(1e9 * counted / watts, rel=0.02)
    assert found["power"] == pytest.approx(watts, rel=1e-8)
    assert found["saturation"] == 0.25
    assert found["area_error"] == 3.0
