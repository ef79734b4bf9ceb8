"""Data sets of one's own rig: what a configuration leaves open lies about the scene's own figures."""

from __future__ import annotations

import pytest

import evanesce as ev
from evanesce.dataset.about import about
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.job import new_job
from evanesce.rig import load_scene


def test_the_defaults_are_those_of_the_thesis_rig() -> None:
    assert about(DatasetConfig(), load_scene("thesis")).as_dict() == DatasetConfig().as_dict()


@pytest.mark.parametrize("name", ["gripper", "pmma_infrared", "prism_reader", "human_print"])
def test_rigs_and_fingers_are_the_scenes(name: str) -> None:
    scene = load_scene(name)
    found = new_job(scene, DatasetConfig(), frames=80, seed=1).config
    low, high = found.rig.draw["camera.exposure_ms"].support()
    assert low < scene.camera.exposure_ms < high < 2 * low + 1e-3
    assert found.finger.tip_radius_mm.support()[0] == scene.finger.tip_radius_mm
    k1 = scene.camera.lens.distortion.k1
    drawn = found.rig.draw.get("camera.lens.distortion.k1")
    assert (drawn is None) if k1 == 0 else (drawn is not None and drawn.support()[0] <= k1 <= drawn.support()[1])


def test_what_is_named_stays() -> None:
    config = DatasetConfig.model_validate({
        "finger": {"tip_radius_mm": 6.0, "material": "silskin_20"}, "rig": {"draw": {"leds.voltage_V": 9.0}},
    })  # fmt: skip
    found = about(config, load_scene("gripper"))
    assert found.finger.tip_radius_mm.support()[0] == 6.0
    assert found.finger.material.support()[0] == "silskin_20"
    assert list(found.rig.draw) == ["leds.voltage_V"]


def test_a_change_of_another_key_names_nothing_else() -> None:
    scene = load_scene("gripper")
    samples = ev.make_dataset(scene, trials=1, seed=1, trial__frames=40, camera__size_px=(96, 72))
    assert samples.job.config.finger.tip_radius_mm.support()[0] == scene.finger.tip_radius_mm


def test_a_distortion_that_folds_over_is_not_drawn() -> None:
    """The lens is as distorted as its frame allows: what is drawn ends at the scene's own figure."""
    scene = load_scene("thesis")
    low, high = -0.398, -2.0
    while low - high > 1e-4:  # the strongest coefficient that is still allowed
        middle = 0.5 * (low + high)
        try:
            load_scene("thesis", {"camera.lens.distortion.k1": middle})
            low = middle
        except ev.InputError:
            high = middle
    scene = load_scene("thesis", {"camera.lens.distortion.k1": low})
    first, last = about(DatasetConfig(), scene).rig.draw["camera.lens.distortion.k1"].support()
    assert first == low
    assert low < last < 0


def test_the_sampled_plane_holds_the_contacts_of_a_soft_finger() -> None:
    default = DatasetConfig().labels
    plane = new_job(load_scene("soft_slide"), DatasetConfig(), frames=80, seed=1).config.labels
    assert plane.grid_size_mm > 1.5 * default.grid_size_mm
    assert plane.grid_size_mm / plane.grid_samples == pytest.approx(default.grid_size_mm / default.grid_samples)
    assert new_job(load_scene("thesis"), DatasetConfig(), frames=80, seed=1).config.labels == default
    stated = DatasetConfig.model_validate({"labels": {"grid_size_mm": 10.0}})
    with pytest.raises(ev.InputError, match=r"labels\.grid_size_mm.*leave the sampled plane"):
        new_job(load_scene("soft_slide"), stated, frames=80, seed=1)
