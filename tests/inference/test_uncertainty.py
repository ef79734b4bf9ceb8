"""The budget against closed forms, and its intervals against simulated measurements."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from evanesce.core.states import Frame
from evanesce.evaluation.calibrated_rig import CardErrors, calibrated
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.reference.area import measure_frame
from evanesce.measurement.reference.segment import Chain
from evanesce.measurement.refined.plate import PlateMap
from evanesce.measurement.uncertainty.area import lens_distance, reference_uncertainty
from evanesce.measurement.uncertainty.budget import Component, Reading, propagate
from evanesce.measurement.uncertainty.components import FILM, card_components, nearness_component, refined_components
from evanesce.measurement.uncertainty.table import budget_table
from evanesce.rig import load_scene

READING = Reading(area_mm2=11.7, perimeter_mm=12.9, distance_mm=33.1)


def part(role, low, high, shape="rectangular", name=None) -> Component:
    return Component(name=name or role, role=role, low=low, high=high, shape=shape, origin="test")


def test_linear_propagation_is_the_closed_form():
    """Relative: twice the print, twice height over distance; boundary by the perimeter."""
    parts = [part("print", -0.003, 0.003), part("height", 0.0, 0.08), part("boundary", -0.004, 0.004, "normal")]
    found = propagate(READING, parts, np.random.default_rng(1))
    root3 = math.sqrt(3)
    mean = (1 - 0.04 / 33.1) ** 2
    expected = {
        "print": 2 * 11.7 * mean * 0.003 / root3,
        "height": 2 * 11.7 * (1 - 0.04 / 33.1) * 0.04 / root3 / 33.1,
        "boundary": 12.9 * 0.004,
    }
    assert found.contributions_mm2 == pytest.approx(expected, rel=1e-6)
    assert found.standard_mm2 == pytest.approx(math.sqrt(sum(u * u for u in expected.values())), rel=1e-9)
    assert found.corrected_mm2 == pytest.approx(11.7 * mean, rel=1e-12)


def test_monte_carlo_of_two_rectangles_is_a_triangle():
    """The 95 % interval of a triangular distribution of half-width w is w (1 - sqrt(0.05)); the linear one is wider."""
    parts = [part("noise", -0.2, 0.2, name="one"), part("noise", -0.2, 0.2, name="two")]
    draws = 200_000
    found = propagate(READING, parts, np.random.default_rng(2), draws)
    half = 0.4 * (1 - math.sqrt(0.05))
    # a quantile's standard error: sqrt(p (1 - p)/n) over the density there
    density = (0.4 - half) / 0.4**2
    error = 5 * math.sqrt(0.025 * 0.975 / draws) / density
    assert found.interval_mm2 == pytest.approx((11.7 - half, 11.7 + half), abs=error)
    assert found.linear_mm2[1] - 11.7 == pytest.approx(1.959964 * 0.4 / math.sqrt(6), rel=1e-6)


def test_scatter_of_the_corners_carried_to_an_area():
    """The analytic standard uncertainty against areas from calibrations with scatter drawn anew."""
    scene = load_scene("thesis")
    circle = np.linspace(0, 2 * np.pi, 200)
    polygon = np.stack([1621.0 + 110.3 * np.cos(circle), 1202.0 + 97.2 * np.sin(circle)], axis=-1)
    polygon[-1] = polygon[0]
    rng = np.random.default_rng(6)
    errors = CardErrors(corner_noise_px=0.3)
    first = calibrated(scene, rng, errors)
    found, stated = [], []
    for _ in range(60):
        rows = [
            r | {k: r[k] + rng.normal(0, 0.3) for k in ("image_x_px", "image_y_px")} for r in first.details["corners"]
        ]
        plate = PlateMap.of(replace(first, details={"corners": rows}))
        found.append(plate.area([polygon]))
        stated.append(plate.area_standard([polygon]))
    # the first calibration's own scatter is in every one of them, so that theirs is sqrt(1/2) of what they state
    low, high = np.sqrt(stats.chi2.ppf([0.0005, 0.9995], 59) / 59)
    assert low < np.std(found, ddof=1) / (np.mean(stated) / np.sqrt(2)) < high


def test_width_of_the_edge_tells_where_the_boundary_runs():
    """A widening that a sharp contact does not show moves the expected area inwards by half the law times the
    boundary's length, since it need not be a film's, and widens a rectangle whose limits are no film and the law's.
    Without the width the limits are those of any film: wider than those of a sharp edge."""
    results = []
    for spread in (0.0006, 0.0046):
        parts = refined_components(1 / 58.37, 0.0, spread_mm=spread)
        results.append(propagate(READING, parts, np.random.default_rng(4)))
    sharp, wide = results
    assert sharp.corrected_mm2 - wide.corrected_mm2 == pytest.approx(12.9 * FILM.per_spread * 0.002, rel=1e-9)
    for found, spread in ((sharp, 0.0006), (wide, 0.0046)):
        width = FILM.per_spread * spread + FILM.offset_mm + 4 * FILM.standard_mm
        assert found.standard_mm2 == pytest.approx(12.9 * width / math.sqrt(12), rel=1e-6)
    blind = propagate(READING, refined_components(1 / 58.37, 0.0), np.random.default_rng(4))
    assert blind.standard_mm2 > 3 * sharp.standard_mm2


def test_card_errors_act_as_the_model_says():
    """A larger print and a card that lies higher, through glass and projection, against the model's own factors."""
    scene = load_scene("thesis")
    square = np.array([[1500.0, 300], [1700, 300], [1700, 480], [1500, 480], [1500, 300]])

    def area(**errors) -> float:
        calibration = calibrated(scene, np.random.default_rng(1), CardErrors(corner_noise_px=0.0, **errors))
        return PlateMap.of(calibration).area([square])

    plain = area()
    # other corners fall into the frame, which the polynomial's own truncation answers with some 5e-5
    assert area(board_scale=1.004) / plain == pytest.approx(1.004**-2, rel=2e-4)
    distance = 6000 / 3.1 / 58.37
    assert area(height_mm=0.2) / plain == pytest.approx((1 - 0.2 / distance) ** -2, rel=1e-3)


def traced_radius(angle: float, thicknesses_mm: tuple[float, ...], indices: tuple[float, ...]) -> float:
    """Return how far from the axis a ray ends that leaves the lens at an angle in air, layer by layer after Snell."""
    return sum(
        t * math.tan(math.asin(math.sin(angle) / n)) for t, n in zip(thicknesses_mm, indices, strict=True)
    )  # fmt: skip


def test_lens_distance_is_the_one_that_rays_through_the_glass_give():
    """Rationale: a card that lies higher looks smaller by height over distance. Two ray traces through air, glass and
    the gap under the card, by Snell's law alone, give that distance; the calibration's, from the lens's label and the
    scale, must agree. The lens is not the thesis's, so that the frame's longer side is far from its focal length."""
    scene = load_scene("thesis")
    lens = scene.camera.lens.model_copy(update={"focal_length_mm": 11.3})
    scene = scene.model_copy(update={"camera": scene.camera.model_copy(update={"lens": lens})})
    index, thickness = scene.plate.refractive_index, scene.plate.thickness_mm
    pixels, pitch = scene.camera.scale_px_per_mm, scene.camera.pixel.pitch_um * 1e-3
    clearance = 11.3 / pitch / pixels - thickness / index
    angle, height = 1e-3, 0.2
    flat = traced_radius(angle, (clearance, thickness), (1.0, index))
    above = traced_radius(angle, (clearance, thickness, height), (1.0, index, 1.0))
    traced = height / (above / flat - 1.0)
    found = calibrated(scene, np.random.default_rng(3))
    assert found.mm2_per_px is not None
    distance, nearness = lens_distance(found, math.sqrt(found.mm2_per_px))
    assert distance == pytest.approx(traced, rel=2e-3)  # the square's mean scale differs a little from the axis's
    assert nearness.origin.endswith("drawing")
    # the corners themselves: a board that lies higher gives a smaller scale in just that ratio
    square = np.array([[1100.0, 700], [1290, 700], [1290, 880], [1100, 880], [1100, 700]])
    areas = [
        PlateMap.of(
            calibrated(scene, np.random.default_rng(1), CardErrors(corner_noise_px=0.0, height_mm=h))
        ).area([square])
        for h in (0.0, height)
    ]  # fmt: skip
    assert areas[0] / areas[1] == pytest.approx((1 - height / distance) ** 2, rel=1e-4)


def test_a_focal_length_that_a_flat_board_does_not_determine_is_not_accepted():
    """The distance counts for what it is worth: found to its standard error, by a label to 5 %, else by 60 %. Closed
    form: twice the area by mean height over distance, times the standard deviation."""
    plain = calibrated(load_scene("thesis"), np.random.default_rng(3))
    assert plain.mm2_per_px is not None
    side = math.sqrt(plain.mm2_per_px)
    for damaged in ([], {"fx": None}, {"fx": -1.0}, {"fx": 1e9}, None):
        odd = replace(plain, details={"focal_length_identified": True, "standard_errors": damaged})
        assert lens_distance(odd, side)[1] == nearness_component("drawing")
    stated = {
        "found": {"focal_length_identified": True, "standard_errors": {"fx": 19.3548}},
        "label": {"focal_length_identified": False, "focal_length_given": True},
        "nothing": {},
    }
    parts = {name: lens_distance(replace(plain, details=details), side)[1] for name, details in stated.items()}
    assert parts["found"].standard == pytest.approx(0.01, rel=1e-3)
    assert parts["label"].standard == pytest.approx(0.05 / math.sqrt(3))
    assert parts["nothing"] == lens_distance(None, side)[1] == nearness_component("assumed")
    budget = propagate(READING, [*card_components(), parts["nothing"]], np.random.default_rng(1), 4000)
    expected = 2 * 11.7 * (1 - 0.05 / 33.1) * 0.05 / 33.1 * 0.6 / math.sqrt(3)
    assert budget.contributions_mm2["lens distance"] == pytest.approx(expected, rel=1e-6)
    # fields of view of 23 and 77 degrees along the longer side are its limits
    for view_deg, limit in ((22.6, parts["nothing"].low), (77.3, parts["nothing"].high)):
        assert 2 * math.tan(math.radians(view_deg / 2)) - 1 == pytest.approx(limit, abs=0.005)


def test_interval_of_the_reference_segmentation_covers_a_blurred_disc():
    """A threshold far from half-way: the area is wrong by 2 %, and its interval says so."""
    rows, cols, radius = 300, 341, 83.4
    y, x = np.mgrid[:rows, :cols]
    distance = np.hypot(x - 166.3, y - 151.8) - radius
    light = 0.45 / (1 + np.exp(1.5 * distance))
    frame = np.floor(255 * np.where(light < 0.018, 4.5 * light, 1.099 * np.maximum(light, 0.018) ** 0.45 - 0.099) + 0.5)
    calibration = Calibration(
        image_size=(cols, rows), camera_matrix=np.array([[1900.0, 0, 170], [0, 1900, 150], [0, 0, 1]]),
        distortion=np.zeros(5), mm2_per_px=58.37**-2, details={"scale_spread_undistorted": 0.001},
    )  # fmt: skip
    measured = measure_frame(Frame(data=frame.astype(np.uint8)), Chain(threshold=0.1), 58.37**-2)
    true = np.pi * (radius / 58.37) ** 2
    assert measured.estimate.area > 1.03 * true
    found = reference_uncertainty(measured, 58.37**-2, calibration, np.random.default_rng(1))
    low, high = found.interval_mm2
    assert low < true < high
    assert max(found.contributions_mm2, key=found.contributions_mm2.get) == "threshold on the contact"
    # a lossy video adds its line: a tenth of a pixel of boundary, rectangular, on some 2 pi r of it
    coded = reference_uncertainty(measured, 58.37**-2, calibration, np.random.default_rng(1), video=True)
    added = 2 * np.pi * radius * 0.1 / np.sqrt(3) / 58.37**2
    assert coded.contributions_mm2["codec"] == pytest.approx(added, rel=0.05)
    assert coded.standard_mm2**2 == pytest.approx(found.standard_mm2**2 + coded.contributions_mm2["codec"] ** 2)
    factor = {row["name"] for row in budget_table(coded)["components"] if row["factor_percent"] is not None}
    assert factor == {"card print", "card height", "lens distance", "threshold on the card", "scale over the view"}


def test_coverage_where_the_model_is_true():
    """Rationale: 2,000 measurements drawn from the budget's own model; the count is binomial. With normal and
    rectangular parts the Monte Carlo interval must hold its 95 %."""
    rng = np.random.default_rng(3)
    parts = [*card_components(), *refined_components(1 / 58.37, 0.0007)]
    true, perimeter, hits, count = 11.838, 12.2, 0, 2000
    for _ in range(count):
        drawn = {c.role: 0.0 for c in parts}
        for c in parts:
            drawn[c.role] += float(c.draw(rng, 1)[0])
        scale = (1 + drawn["print"]) ** 2 * (1 - drawn["height"] / 33.1) ** 2 * (1 + drawn["scale"])
        read = (true + perimeter * drawn["boundary"]) / scale
        reading = Reading(area_mm2=read, perimeter_mm=perimeter, distance_mm=33.1)
        low, high = propagate(reading, parts, rng, draws=1000).interval_mm2
        hits += low < true < high
    assert abs(hits / count - 0.95) < 4 * math.sqrt(0.95 * 0.05 / count)
