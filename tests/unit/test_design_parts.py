"""Objectives beside the area error: deflection, depth of field, power, cost; and design variables."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from evanesce.core.errors import InputError
from evanesce.design import bending, secondary, variables
from evanesce.design.parts import cost, parts_of, read_parts
from evanesce.design.question import Design, coarser_camera
from support.rigs import small_rig

# Timoshenko and Woinowsky-Krieger (1959): deflection of the middle under a force there, over P a^2/D.
SUPPORTED_POINT = {1.0: 0.01160, 1.2: 0.01353, 1.4: 0.01484, 1.6: 0.01570, 1.8: 0.01620, 2.0: 0.01651, 3.0: 0.01690}
CLAMPED_POINT = {1.0: 0.00560, 1.2: 0.00647, 1.4: 0.00691, 1.6: 0.00712, 1.8: 0.00720, 2.0: 0.00722}
# The same under a load q over the whole plate, over q a^4/D.
SUPPORTED_WHOLE = {1.0: 0.00406, 1.5: 0.00772, 2.0: 0.01013}
CLAMPED_WHOLE = {1.0: 0.00126, 1.5: 0.00220, 2.0: 0.00254}


@pytest.mark.parametrize(
    ("table", "support", "whole"),
    [
        (SUPPORTED_POINT, "simply supported", False),
        (CLAMPED_POINT, "clamped", False),
        (SUPPORTED_WHOLE, "simply supported", True),
        (CLAMPED_WHOLE, "clamped", True),
    ],
)
def test_deflection_is_timoshenkos(table, support, whole):
    """Their own series were cut off in the third or fourth digit: half a unit of the fifth decimal, or 0.5 %."""
    a, bend, force = 83.0, 1.7e5, 2.3
    for ratio, coefficient in table.items():
        b = ratio * a
        patch = (a, b) if whole else (0.004 * a, 0.004 * a)
        found = bending.deflection(force, (0.0, 0.0), patch, (a, b), bend, support)
        unit = force / (a * b) * a**4 / bend if whole else force * a**2 / bend
        assert found / unit == pytest.approx(coefficient, rel=5e-3, abs=5e-6)


def test_a_long_plate_bends_as_a_strip():
    """Under q everywhere a strip has 5/384 q a^4/D between supports and 1/384 between clamps."""
    a, b, bend = 40.0, 640.0, 3.1e4
    for support, coefficient in (("simply supported", 5 / 384), ("clamped", 1 / 384)):
        found = bending.deflection(1.0, (0.0, 0.0), (a, b), (a, b), bend, support)
        assert found == pytest.approx(coefficient / (a * b) * a**4 / bend, rel=2e-3)


def test_bending_is_symmetric_and_softest_in_the_middle():
    size, patch, bend = (120.0, 80.0), (4.3, 3.1), bending.rigidity(6.0)
    for support in ("simply supported", "clamped"):
        at = {
            p: bending.deflection(5.0, p, patch, size, bend, support) for p in ((17.0, -9.0), (-17.0, 9.0), (0.0, 0.0))
        }
        assert at[17.0, -9.0] == pytest.approx(at[-17.0, 9.0], rel=1e-9)
        assert 0 < at[17.0, -9.0] < at[0.0, 0.0]
    with pytest.raises(ValueError, match="does not lie within"):
        bending.deflection(5.0, (59.0, 0.0), patch, size, bend)


def test_depth_of_field_is_that_of_the_lens_equation():
    """Distances whose image lies so far behind or before the sensor that the cone is a pixel wide there."""
    camera = small_rig().camera.model_copy(update={"scale_px_per_mm": 20.0})
    pixel_mm, f, number = camera.pixel.pitch_um * 1e-3, camera.lens.focal_length_mm, camera.lens.f_number
    m = camera.scale_px_per_mm * pixel_mm
    sensor = f * (1 + m)

    def cone(distance: float) -> float:
        image = 1 / (1 / f - 1 / distance)
        return f / number * abs(image - sensor) / image - pixel_mm

    focus = f * (1 + 1 / m)
    ends = []
    for low, high in ((0.9 * focus, focus), (focus, 1.1 * focus)):
        grid = np.linspace(low, high, 400_001)
        values = np.array([cone(d) for d in grid[::4000]])
        assert values.max() > 0 > values.min()
        fine = grid[np.argmin(np.abs([cone(d) for d in grid[::40]])) * 40]
        ends.append(fine)
    # The formula leaves out terms of (N c / (m f))^2, here 1e-3.
    assert secondary.depth_of_field_mm(camera) == pytest.approx(ends[1] - ends[0], rel=5e-3)


def test_electrical_power_keeps_kirchhoffs_law():
    """Segment by segment: the current at which three diodes and the resistor take the supply's voltage, by brentq."""
    scene = small_rig()
    c, total = scene.leds.circuit, 0.0
    thermal = c.ideality * 8.617333262e-5 * c.temperature_K
    rated = c.rated_current_mA * 1e-3
    saturation = rated / math.expm1((c.forward_voltage_V - rated * c.led_resistance_ohm) / thermal)
    resistor = (c.rated_voltage_V - c.leds_per_segment * c.forward_voltage_V) / rated

    def missing(current: float, voltage: float) -> float:
        diode = thermal * math.log1p(current / saturation) + current * c.led_resistance_ohm
        return c.leds_per_segment * diode + current * resistor - voltage

    # 47 mm: 4 LEDs at 11 mm on left and right; 62 mm: 6 on top at its own 9 V, of which the shift carries one off.
    for count, voltage in ((4, 10.0), (4, 10.0), (5, 9.0)):
        current = brentq(missing, 0.0, 1.0, args=(voltage,), xtol=1e-15)
        total += count / c.leds_per_segment * voltage * current
    assert secondary.electrical_power_W(scene) == pytest.approx(total, rel=1e-8)


def test_a_coarser_camera_sees_the_same_field():
    scene = small_rig(camera__pixel={"pitch_um": 13.0})
    coarse = coarser_camera(scene, 2)
    assert secondary.field_of_view_mm(coarse.camera) == secondary.field_of_view_mm(scene.camera)
    one, other = (s.camera.pixel for s in (scene, coarse))
    assert other.full_well_capacity_e / other.pitch_um**2 == pytest.approx(one.full_well_capacity_e / one.pitch_um**2)


PARTS = """
currency = "CHF"
[[part]]
name = "thin glass"
price = 0.2
per = "plate_cm2"
key = "plate.thickness_mm"
high = 5.0
[[part]]
name = "thick glass"
price = 0.5
per = "plate_cm2"
key = "plate.thickness_mm"
low = 5.0
[[part]]
name = "LED"
price = 0.3
per = "led"
[[part]]
name = "channel"
price = 0.11
per = "edge_cm"
[[part]]
name = "camera"
price = 61.5
"""


def test_cost_by_hand(tmp_path):
    (tmp_path / "parts.toml").write_text(PARTS)
    scene = small_rig()
    table = read_parts(tmp_path / "parts.toml", scene)
    # 6.2 x 4.7 cm of thick glass (5 mm is in it), 13 LEDs, edges of 47 + 62 + 47 mm, a camera.
    by_hand = 0.5 * 6.2 * 4.7 + 0.3 * 13 + 0.11 * 15.6 + 61.5
    assert cost(table, Design(scene=scene)) == pytest.approx(by_hand, rel=1e-12)
    thin = variables.design_at(Design(scene=scene), {"plate.thickness_mm": 4.9})
    assert [p.name for p in parts_of(table, thin)] == ["thin glass", "LED", "channel", "camera"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[[part]]\nname = 'x'\n", "price"),
        ("[[part]]\nname = 'x'\nprice = 1\nper = 'kg'\n", "per"),
        ("[[part]]\nname = 'x'\nprice = 1.0\nkey = 'plate.colour'\nlow = 1.0\n", "plate.colour"),
        ("[[part]]\nname = 'x'\nprice = 1.0\nlow = 1.0\n", "'key' goes with"),
        ("part = 3", "part"),
        ("\x00", "not valid TOML"),
    ],
)
def test_bad_parts_are_named(tmp_path, text, says):
    (tmp_path / "parts.toml").write_text(text)
    with pytest.raises(InputError, match=says):
        read_parts(tmp_path / "parts.toml", small_rig())


def test_design_variables_have_their_ranges():
    found = variables.design_variables(
        {
            "plate.thickness_mm": {"low": 3, "high": 9, "step": 1.5},
            "camera.exposure_ms": {"low": 1, "high": 20, "log": True},
            "plate.size_mm[1]": {"low": 40, "high": 90},
            "measurement.threshold": {"low": 0.1, "high": 0.6},
            "measurement.min_blob_px": {"low": 100, "high": 4000},
        },
        small_rig(),
    )
    assert [(v.low, v.high, v.step, v.log, v.whole) for v in found] == [
        (3, 9, 1.5, False, False), (1, 20, None, True, False), (40, 90, None, False, False),
        (0.1, 0.6, None, False, False), (100, 4000, None, False, True),
    ]  # fmt: skip
    assert found[0].clip(4.1) == 4.5
    assert found[0].clip(100.0) == 9.0
    values = {"plate.size_mm[1]": 55.5, "measurement.threshold": 0.33, "leds.pitch_mm": 12.25}
    design = variables.design_at(Design(scene=small_rig()), values)
    assert design.scene.plate.size_mm == (62.0, 55.5)
    assert {key: variables.value_of(design, key) for key in values} == values


@pytest.mark.parametrize(
    ("key", "span", "says"),
    [
        ("plate.thicknes_mm", {"low": 3, "high": 9}, "nearest: plate.thickness_mm"),
        ("plate.thickness_mm", {"low": 3, "high": 90}, "allowed: 0.1 to 50 mm"),
        ("plate.thickness_mm", {"low": -1, "high": 9}, "allowed: 0.1 to 50 mm"),
        ("plate.thickness_mm", {"low": 9, "high": 3}, "low < high within 0.1 to 50 mm"),
        ("plate.thickness_mm", {"low": 3, "high": 3}, "low < high"),
        ("plate.thickness_mm", {"low": math.nan, "high": 3}, "0.1 to 50 mm"),
        ("plate.thickness_mm", {"low": 3, "high": 9, "step": -1}, "step"),
        ("plate.thickness_mm", {"low": 3, "high": 9, "step": 1, "log": True}, "one of the two"),
        ("camera.lens.defocus_um", {"low": -5, "high": 5, "log": True}, "above 0"),
        ("measurement.min_blob_px", {"low": 1.5, "high": 9}, "whole numbers"),
        ("press.forces_N", {"low": 1, "high": 2}, "no such number"),
        ("__import__('os')", {"low": 1, "high": 2}, "no such number"),
    ],
)
def test_bad_ranges_are_named(key, span, says):
    with pytest.raises(InputError) as error:
        variables.design_variables({key: span}, small_rig())
    assert says in str(error.value)
    assert key in str(error.value)


def test_no_range_at_all_is_refused():
    with pytest.raises(InputError, match="variables: nothing to vary"):
        variables.design_variables({}, small_rig())


def test_an_infeasible_rig_says_why():
    base = Design(scene=small_rig())
    with pytest.raises(InputError, match="taller than the plate"):
        variables.design_at(base, {"plate.thickness_mm": 2.0})
    with pytest.raises(InputError, match="overlaps its neighbour"):
        variables.design_at(base, {"leds.pitch_mm": 3.0})


def test_sources_of_changed_figures_are_dropped():
    scene = small_rig()
    known = scene.model_copy(update={"sources": {"plate.thickness_mm": "a book", "plate.size_mm": "a ruler"}})
    changed = variables.design_at(Design(scene=known), {"plate.thickness_mm": 6.5}).scene
    assert changed.sources == {"plate.size_mm": "a ruler"}
    assert math.isclose(changed.plate.thickness_mm, 6.5)
