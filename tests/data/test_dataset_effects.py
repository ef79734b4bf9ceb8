"""What effects of the library leave in the members of a dataset's frames."""

from __future__ import annotations

import functools
import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from evanesce.contact.analytic.hertz import hertz_contact
from evanesce.contact.patch import axisymmetric_state
from evanesce.core.errors import InputError
from evanesce.core.states import Frame, PlateGrid
from evanesce.dataset.config import KINDS
from evanesce.dataset.design import draw_effect
from evanesce.dataset.job import Job, new_job
from evanesce.dataset.produce import Producer
from evanesce.dataset.randomisation import NOT_DRAWN
from evanesce.effects import Context, all_effects
from support.datasets import tiny_config
from support.rigs import small_rig

FRAMES = (2, 5)
LABELS = {"labels.exr", "plate.exr", "mask.png"}


def job_of(effects: dict[str, Any], ridged: bool) -> Job:
    """Return a slide of a rig whose scene has these effects."""
    config = tiny_config(
        kinds={kind: float(kind == "slide") for kind in KINDS},
        finger={"ridged_share": float(ridged)},
        rig={"count": 1, "draw": {}},
    )
    # A frame that is full nearly everywhere would show no light that is added.
    rig = small_rig(camera__exposure_ms=0.04).model_copy(update={"effects": effects})
    return new_job(rig, config, frames=6, seed=11)


def made(effects: dict[str, Any], ridged: bool) -> list[dict[str, bytes]]:
    producer = Producer(job_of(effects, ridged))
    return [producer.record(frame).members for frame in FRAMES]


@functools.cache
def plain(ridged: bool) -> list[dict[str, bytes]]:
    return made({}, ridged)


def trace(name: str) -> set[str]:
    """Return which members an effect changes, on the first finger and draw of it that it does not refuse."""
    for k in range(8):
        ridged = k % 2 == 0
        found = made({name: draw_effect(all_effects()[name], 2.0, np.random.default_rng([3, k]))}, ridged)
        if json.loads(found[0]["json"])["rig"]["left_out"]:
            continue
        assert json.loads(found[0]["json"])["rig"]["effects"].keys() == {name}
        pairs = zip(found, plain(ridged), strict=True)
        changed = {member for one, other in pairs for member in one if one[member] != other[member]} - {"json"}
        if changed:
            return changed
    return set()


DRAWN = sorted(set(all_effects()) - set(NOT_DRAWN))
QUICK = ("creep", "led_warmup", "modulus", "vignetting")


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in DRAWN])
def test_every_effect_that_is_drawn_leaves_a_trace(name):
    found = trace(name)
    assert "frame.png" in found
    if name == "creep":
        assert found >= {"labels.exr", "plate.exr"}  # labels follow what acts on the finger
    if name == "led_warmup":
        assert found == {"frame.png"}  # and know nothing of the light


@pytest.mark.parametrize("name", ["card_offset", "square_size"])
def test_effects_of_cards_leave_none(name):
    assert trace(name) == set()


def test_a_false_frame_rate_changes_nothing_that_is_kept():
    effect = all_effects()["frame_rate"]
    frame = Frame(data=np.arange(12, dtype=np.uint8).reshape(3, 4), time=1.5)
    parameters = effect.with_values({"departure": 0.2})
    found = effect.apply(frame, parameters, Context(small_rig(), 1, 1.5, 3))
    np.testing.assert_array_equal(found.data, frame.data)
    assert found.time == pytest.approx(1.25)
    assert not trace("frame_rate") & LABELS


def test_area_is_lost_under_shear_once_and_only_under_shear():
    """Sahli's law, A = A0 - alpha Q^2: A0 = pi a^2 (Hertz) without shear, ``area_left`` of it under full slip."""
    config = tiny_config(
        kinds={kind: float(kind == "slide") for kind in KINDS},
        finger={"ridged_share": 0.0},
        friction={"levels": 1, "area_left": {"constant": 0.8}, "dynamic_ratio": {"constant": 1.0},
                  "adhesive_share": {"constant": 0.0}},
        programme={"reversals": {"constant": 0.0}},
        trial={"frames": 30, "frame_rate_hz": 10.0},
        rig={"count": 1, "draw": {}},
    )  # fmt: skip
    job = new_job(small_rig(), config, frames=30, seed=11)
    producer = Producer(job)
    whole = None
    seen = set()
    for frame in range(30):
        s = json.loads(producer.record(frame).members["json"])["scalars"]
        plan = producer.trial(0).plan
        if s["Fz_N"] < 0.999 * plan.programme["normal_force_N"]:
            continue
        modulus = producer.trial(0).trial._modulus
        whole = np.pi * (0.75 * s["Fz_N"] * 7.5 / modulus) ** (2 / 3)
        share = np.hypot(s["Fx_N"], s["Fy_N"]) / (plan.friction.friction_coefficient * s["Fz_N"])
        assert s["nominal_area_mm2"] == pytest.approx(whole * (1 - 0.2 * share**2), rel=3e-3)
        seen.add(round(float(share), 1))
    assert {0.0, 1.0} <= seen


def test_an_effect_whose_physics_every_trial_has_is_refused():
    assert "shear_area_loss" not in tiny_config(randomisation={"probability": 1.0}).randomisation.candidates
    with pytest.raises(InputError, match=r"effects\.shear_area_loss: friction\.area_left takes the area"):
        job_of({"shear_area_loss": {"loss_mm2_per_N2": 2.0}}, ridged=False)


def test_a_slide_without_force_loses_no_area():
    """Of a press it is not known what pulls, so that a share of the normal force does; a slide has its own force."""
    grid = PlateGrid((40, 40), 0.1)
    state = axisymmetric_state(grid, (0.0, 0.0), hertz_contact(0.5, 7.0, 0.8), law="hertz")
    still = replace(state, traction=np.zeros((2, 40, 40)))
    effect = all_effects()["shear_area_loss"]
    parameters = effect.with_values({"loss_mm2_per_N2": 5.0})
    context = Context(small_rig(), 1)
    assert effect.apply(still, parameters, context) is still
    assert effect.apply(state, parameters, context).nominal_contact_area < state.nominal_contact_area
