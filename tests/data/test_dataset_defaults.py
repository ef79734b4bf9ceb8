"""What the default distributions draw: ridges that stay open, slides that reach gross slip, frames of every phase."""

from __future__ import annotations

import math
from collections import Counter

import pytest

from evanesce.contact.analytic.hertz import hertz_contact
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.design import trial_plan
from evanesce.dataset.mechanics import reach
from evanesce.dataset.rigs import plate_grid, rig_scene, rig_with_effects
from evanesce.dataset.trial import Trial
from evanesce.materials import material
from evanesce.materials.friction import coulomb
from evanesce.rig import load_scene


def test_ridges_of_most_default_trials_stay_open_within_the_contact():
    """Westergaard: furrows of a sinusoid of height H close at pi E* H/(2 pitch); Hertz: p = p0 sqrt(1 - (r/a)^2)."""
    config, open_trials, count = DatasetConfig(), 0, 400
    for index in range(count):
        plan = trial_plan(config, 5, index)
        finger, force = plan.finger, plan.programme["normal_force_N"]
        if not finger.pattern:
            continue
        modulus = float(material(finger.material).reduced_modulus(force))
        radius = (0.75 * force * finger.tip_radius_mm / modulus) ** (1 / 3)
        half_way = 1.5 * force / (math.pi * radius**2) * math.sqrt(0.75)
        closes = math.pi * modulus * finger.ridge_height_um / (2 * finger.ridge_pitch_um)
        open_trials += half_way < closes
    assert open_trials / count >= 0.6


def test_the_way_to_gross_slip_is_mindlins():
    """A sphere under Coulomb's law slips as a whole after mu (E*/G*) a^2/R; the shaft bends by mu N/k besides."""
    force, radius, modulus, shear, mu, shaft = 1.1, 7.3, 0.7, 0.45, 0.8, 5.0
    contact = hertz_contact(force, radius, modulus)
    a2 = (0.75 * force * radius / modulus) ** (2 / 3)
    wanted = mu * modulus / shear * a2 / radius + mu * force / shaft
    assert reach(contact, coulomb(mu), shear, shaft) == pytest.approx(wanted, rel=1e-4)


@pytest.mark.slow
def test_slides_reach_gross_slip_and_frames_are_of_every_phase():
    config, scene = DatasetConfig(), load_scene("thesis")
    phases: Counter[str] = Counter()
    slides = gross = 0
    for index in range(40):
        plan = trial_plan(config, 6, index)
        rig = rig_with_effects(rig_scene(scene, plan.rig, plan.finger, config), plan.rig.seed)
        trial = Trial(plan, config, rig.scene, plate_grid(rig.scene, config))
        ratios = [trial.truth(i).scalars["stick_ratio"] for i in range(1, len(trial), 8) if trial.truth(i).state]
        phases.update("gross" if r == 0 else "partial" if r < 0.95 else "stick" for r in ratios)
        if plan.kind == "slide":
            slides, gross = slides + 1, gross + (not math.isnan(trial.onset_gross_slip_s))
    assert gross >= 0.95 * slides
    assert min(phases[name] for name in ("stick", "partial", "gross")) >= 0.2 * phases.total()
