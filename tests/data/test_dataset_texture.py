"""The data card and the audit count the same trials as textured; what of a scene is not taken is told."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.dataset.audit_checks import TEXTURED, open_core
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.data_card import _keeps_texture
from evanesce.dataset.design import trial_plan
from evanesce.dataset.planar_trial import trial_of
from evanesce.dataset.rigs import plate_grid, replaced_warning, rig_scene, rig_with_effects
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


def test_what_a_data_set_leaves_of_a_scene_is_told(tmp_path):
    assert replaced_warning(load_scene("thesis")) == ""
    told = replaced_warning(load_scene("soft_slide"))
    assert all(word in told for word in ("law = fem", "[slide]", "[environment]"))
    own = load_scene("thesis", {"finger.material": "own", "finger.modulus_MPa": 0.3, "assumptions": {}})
    assert "finger.modulus_MPa" in replaced_warning(own)
    done = CliRunner().invoke(
        app,
        ["dataset", "make", "soft_slide", "--n", "80", "--size", "320x240", "--dry-run", "--out", str(tmp_path / "d")],
    )
    assert done.exit_code == 0, done.output
    assert "law = fem" in " ".join(done.stderr.split())
