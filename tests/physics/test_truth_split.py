"""The split of an area error: parts that sum exactly, and parts that mean what they say."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from scipy.optimize import brentq

from evanesce.chain.simulate import expose
from evanesce.core.states import PlateLight
from evanesce.evaluation.error_split import SOURCES, MeasuredArea, Viewing, half_level_mask, split
from evanesce.evaluation.labels import RectifiedView
from evanesce.optics.projection import Projection
from evanesce.rig import Camera, Distortion, Plate, Scene, load_scene
from evanesce.rig.camera import Lens, Pixel
from evanesce.sensor.tone import CURVES

SUBSETS = [frozenset(c) for n in range(6) for c in itertools.combinations(SOURCES, n)]


@given(st.lists(st.floats(-1e3, 1e3), min_size=len(SUBSETS), max_size=len(SUBSETS)), st.floats(0.1, 500.0))
def test_parts_sum_to_the_total_whatever_the_measurement(areas: list[float], true_area: float) -> None:
    table = dict(zip(SUBSETS, areas, strict=True))
    result = split(lambda without: table[without], true_area)
    *parts, (_, total, percent) = result.rows()
    assert sum(value for _, value, _ in parts) == pytest.approx(total, abs=1e-9)
    assert total == pytest.approx(table[frozenset()] - true_area)
    assert percent == pytest.approx(100 * total / true_area)


def test_independent_sources_are_returned_as_they_were_put_in() -> None:
    adds = dict(zip(SOURCES, (1.5, -0.7, 2.25, 0.125, -3.0), strict=True))
    result = split(lambda without: 40.5 + sum(v for k, v in adds.items() if k not in without), 40.0)
    assert result.parts_mm2 == pytest.approx(adds)
    assert result.residual_mm2 == pytest.approx(0.5)
    assert result.interaction_mm2 == pytest.approx(0.0, abs=1e-12)


def test_two_sources_that_need_each_other_interact() -> None:
    """A low threshold displaces nothing without blur: each switched off removes the whole, so one is given back."""
    result = split(lambda without: 10.0 + (2.0 if not {"blur", "threshold"} & without else 0.0), 10.0)
    assert (result.parts_mm2["blur"], result.parts_mm2["threshold"]) == (2.0, 2.0)
    assert result.interaction_mm2 == -2.0


def test_no_contact_has_no_percent() -> None:
    result = split(lambda without: 0.3, 0.0)
    assert all(np.isnan(percent) for *_, percent in result.rows())


# --- half level ------------------------------------------------------------------------------------------------------


def test_half_level_finds_a_blurred_disc_in_uneven_light() -> None:
    v, u = np.indices((260, 300))
    r = np.hypot(v - 121.3, u - 143.8)
    disc = np.clip(83.0 - r + 0.5, 0, 1)
    light = gaussian_filter(disc * (1.0 + 0.004 * (u - 143.8)) + 0.1 + 0.0005 * v, 2.0)
    low = light > 0.25
    assert low.sum() > 1.02 * np.pi * 83.0**2
    found = half_level_mask(light, low)
    # Curvature displaces the half level by sigma^2/(2 R) = 0.024 px, 0.06 % of the area; counting pixels, 0.05 %.
    assert found.sum() == pytest.approx(np.pi * 83.0**2, rel=2e-3)


def test_half_level_leaves_a_line_too_thin_for_it_alone() -> None:
    light = np.zeros((80, 90))
    light[:, 40:47] = 1.0
    mask = light > 0.5
    np.testing.assert_array_equal(half_level_mask(light, mask), mask)


# --- the whole chain -------------------------------------------------------------------------------------------------

CENTRE, RADIUS = (0.6, -0.4), 3.1
THRESHOLD, LEVEL, GROUND = 0.32, 3.2e-7, 0.06


def scene() -> Scene:
    camera = Camera(
        resolution_px=(640, 480),
        scale_px_per_mm=41.0,
        exposure_ms=5.0,
        tone_curve="srgb",
        lens=Lens(focal_length_mm=4.6, defocus_um=45.0, distortion=Distortion(k1=-0.25, k2=0.05)),
        pixel=Pixel(),
    )
    plate = Plate(size_mm=(90.0, 70.0), thickness_mm=5.3, refractive_index=1.48)
    return load_scene("thesis").model_copy(update={"camera": camera, "plate": plate})


def light(rig: Scene) -> PlateLight:
    """An even disc on an even ground, anti-aliased at the pinhole's own pixels."""
    view = Projection.of(rig.camera, rig.plate).ideal_view()
    px, py = view.principal_point
    u, v = np.meshgrid(np.arange(view.shape[1]) - px, np.arange(view.shape[0]) - py)
    x, y = Projection.of(rig.camera, rig.plate).ray_to_plate(u / view.focal_px, v / view.focal_px)
    disc = np.clip((RADIUS - np.hypot(x - CENTRE[0], y - CENTRE[1])) * 41.0 + 0.5, 0, 1)
    radiance = LEVEL * (GROUND + (1 - GROUND) * disc)
    return PlateLight(
        radiance=radiance, variance=0 * radiance, focal_px=view.focal_px, principal_point=view.principal_point
    )


def measured(scale_error: float) -> MeasuredArea:
    rig = scene()
    plate_light = light(rig)
    p = Projection.of(rig.camera, rig.plate)
    view = RectifiedView(p.matrix, np.array(p.distortion), p.matrix, (470, 630), origin=(5, 5))
    return MeasuredArea(
        expose=lambda without: expose(rig, plate_light, seed=3, without=without)[1],
        segment=lambda image: image > THRESHOLD * 255,
        mm2_per_px=(1 + scale_error) / 41.0**2,
        viewing=Viewing.of(p, view),
        straight=Viewing.of(replace(p, distortion=(0.0,) * 5)),
    )


def test_split_of_a_simulated_measurement() -> None:
    true_area = np.pi * RADIUS**2
    area = measured(scale_error=0.03)
    result = split(area, true_area)
    parts = result.parts_mm2
    *rows, (_, total, _) = result.rows()
    assert sum(value for _, value, _ in rows) == pytest.approx(total, abs=1e-12)

    print(
        "\n" + "\n".join(f"{name:12s} {value:+8.4f} mm^2 {percent:+7.3f} %" for name, value, percent in result.rows())
    )

    # Scale: 3 % of what was measured, less what refraction in the glass makes of the scale off the axis (below 0.5 %).
    full = area(frozenset())
    assert parts["scale"] == pytest.approx(0.03 / 1.03 * full, abs=0.005 * full)

    # Threshold: the edge of a disc of light, 45 um off focus, met at the linear light of grey level 0.32 instead of
    # at one half; that displacement goes round the whole circle. The peak level stands for both sides' light.
    magnification = 41.0 * 3.1e-3
    diameter = 45.0 / (2.8 * (1 + magnification)) / 3.1
    frame = area.expose(frozenset({"noise"}))  # type: ignore[arg-type]
    assert frame.raw is not None
    top = (np.median(frame.raw[200:260, 300:380]) - 256) / (4095 - 256)
    cut = brentq(lambda s: float(CURVES["srgb"](s)) - THRESHOLD, 0, 1) / top

    def edge(s: float) -> float:
        t = np.clip(2 * s / diameter, -1, 1)
        return GROUND + (1 - GROUND) * (0.5 - (np.arcsin(t) + t * np.sqrt(1 - t * t)) / np.pi)

    outwards = brentq(lambda s: edge(s) - cut, -diameter / 2, diameter / 2) / 41.0
    expected = 2 * np.pi * RADIUS * outwards * 1.03
    # Pixel widths (1/12 px^2 each) and diffraction widen a disc of 4.6 px by a tenth, and so does the displacement.
    print(f"threshold by the disc's edge: {expected:+.4f} mm^2")
    assert outwards > 0.01
    assert parts["threshold"] == pytest.approx(expected, rel=0.2)

    # Distortion: the view is rectified by the true coefficients, so only resampling and rim pixels remain of it.
    # Rectifying a frame that needs none would add 2 k1 r^2 = 1 % at this disc.
    assert abs(parts["distortion"]) < 2e-3 * true_area

    # Noise moves single pixels of the rim (1.3e-3 of the area each per mille): it must be the smallest part by far.
    assert abs(parts["noise"]) < 0.1 * parts["threshold"]
    # With everything left out only counting pixels remains: 0.29 px on 800 independent rim pixels.
    assert abs(result.residual_mm2) < 1e-3 * true_area
    # Blur and threshold act together only, so the split gives the shared part back once.
    assert result.interaction_mm2 == pytest.approx(-parts["blur"], rel=0.35)


def test_raw_numbers_are_needed_for_the_half_level() -> None:
    area = measured(0.0)
    blind = replace(area, expose=lambda without: replace(area.expose(without), raw=None))
    with pytest.raises(ValueError, match="raw"):
        blind(frozenset({"threshold"}))
