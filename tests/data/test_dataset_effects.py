"""What effects of the library leave in the members of a dataset's frames."""

from __future__ import annotations

import functools
import json
from typing import Any

import numpy as np
import pytest

from evanesce.core.states import Frame
from evanesce.dataset.config import KINDS, NOT_DRAWN
from evanesce.dataset.design import draw_effect
from evanesce.dataset.encode import decode_exr
from evanesce.dataset.job import Job, new_job
from evanesce.dataset.produce import Producer
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
    return new_job(small_rig().model_copy(update={"effects": effects}), config, frames=6, seed=11)


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
QUICK = ("creep", "led_warmup", "modulus", "shear_area_loss", "vignetting")


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


def test_areas_in_the_numbers_are_those_that_an_effect_of_the_contact_left():
    """Sahli's law: alpha Q^2 less than without it, Q = 0.3 N while nothing pulls; as much as the plate's labels say."""
    alpha = 20.0
    with_loss = made({"shear_area_loss": {"loss_mm2_per_N2": alpha}}, ridged=False)
    for one, other in zip(with_loss, plain(ridged=False), strict=True):
        s, t = (json.loads(members["json"])["scalars"] for members in (one, other))
        assert s["Fz_N"] == t["Fz_N"] > 0.3
        shear = np.hypot(s["Fx_N"], s["Fy_N"]) or 0.3 * s["Fz_N"]
        # mask samples are shares of cells: some 1e-3 of the area
        tolerance = 1e-3 * t["nominal_area_mm2"]
        assert t["nominal_area_mm2"] - s["nominal_area_mm2"] == pytest.approx(alpha * shear**2, abs=tolerance)
        assert alpha * shear**2 > 20 * tolerance
        box = decode_exr(one["plate.exr"])[0]
        seen = float(box.channels["contact_mask"].sum()) * (12.0 / 96) ** 2
        assert s["nominal_area_mm2"] == pytest.approx(seen, rel=2e-3)  # half precision
        assert s["real_area_mm2"] == pytest.approx(s["nominal_area_mm2"], rel=1e-9)  # no roughness
