"""A finger that slides takes its body along: what is seen beside the contact is that of a finger pressed there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from evanesce.contact.solve import contact_sequence, contact_state
from evanesce.optics.carried import carried_by, carried_finger
from evanesce.render.fast.transport import render_fast
from evanesce.rig import load_scene

SLIDE = {
    "contact": {"law": "hertz", "reduced_modulus_MPa": 0.4}, "grid.size_mm": 30.0, "grid.samples": 256,
    "camera.resolution_px": [200, 150], "camera.scale_px_per_mm": 5.8, "press.frame_rate_hz": 10.0,
    "slide.direction_deg": 35.0, "slide.shaft": "rigid", "slide.distance_mm": 4.0,
}  # fmt: skip


@pytest.mark.slow
def test_light_beside_a_contact_that_slid_is_that_of_a_finger_put_there() -> None:
    scene = load_scene("thesis_slide", SLIDE)
    last = contact_sequence(scene)[-1]
    dx, dy = carried_by(scene, last)
    assert np.hypot(dx, dy) == pytest.approx(4.0, abs=0.05)
    seen = render_fast(scene, last).radiance
    # The same rig with its finger there from the start: its own light, no slide.
    put = carried_finger(scene, last).model_copy(update={"slide": None})
    there = render_fast(put, replace(last, parameters={})).radiance
    beside = (there > 0) & (there < 0.02 * there.max())
    assert beside.sum() > 500
    # light from the plate's edges on the body is that of where it began: up to 17 % off after 4 mm
    np.testing.assert_allclose(seen[beside], there[beside], rtol=0.2, atol=2e-3 * there[beside].max())
    # and not where it began
    began = render_fast(scene.model_copy(update={"slide": None}), replace(last, parameters={})).radiance
    assert np.abs(began - there)[beside].max() > 0.5 * there[beside].max()


def test_what_has_not_moved_changes_no_bit() -> None:
    scene = load_scene("thesis_slide", SLIDE)
    first = contact_sequence(scene)[0]
    assert carried_finger(scene, first) is scene
    drawn = load_scene("thesis_slide", SLIDE | {"slide.glass_moves": True})
    assert carried_finger(drawn, contact_sequence(drawn)[-1]) is drawn
    press = load_scene("thesis", {"grid.samples": 128})
    assert carried_finger(press, contact_state(press, 1.0)) is press
