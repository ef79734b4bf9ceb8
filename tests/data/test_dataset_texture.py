"""The data card and the audit count the same trials as textured."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from evanesce.dataset.audit_checks import TEXTURED, open_core
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.data_card import _keeps_texture
from evanesce.dataset.design import trial_plan
from evanesce.dataset.planar_trial import trial_of
from evanesce.dataset.rigs import plate_grid, rig_scene, rig_with_effects
from evanesce.rig import load_scene


@pytest.mark.parametrize(("number", "textured"), [(4, False), (8, False), (13, False), (10, True), (15, True)])
def test_the_cards_closed_form_counts_as_the_maps_do(number, textured):
    # Of the shipped default: no ridges, ridges that close in the core, and concentric ones and a whorl that do not.
    config = DatasetConfig()
    plan = trial_plan(config, 0, number)
    rig = rig_with_effects(rig_scene(load_scene("thesis"), plan.rig, plan.finger, config, plan.liquid), plan.rig.seed)
    found = trial_of(plan, config, rig.scene, plate_grid(rig.scene, config))
    held = max((found.truth(i) for i in range(0, len(found), 8)), key=lambda truth: truth.scalars["Fz_N"])
    measured = open_core(SimpleNamespace(map=lambda name: np.asarray(getattr(held.state, name))))
    assert (measured >= TEXTURED) is textured
    assert _keeps_texture(plan) is textured
