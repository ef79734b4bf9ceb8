"""Control of a grip as a Gymnasium environment (extra ``grip``): hold an object that slips with the least force."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from evanesce.dataset.about import about
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.grip_model import GripModel, GripStep, GripTask
from evanesce.rig import Scene, load_scene
from evanesce.rig.load import validate

EFFORT = 1.0
"""Cost of the greatest grip force, a second [1/s]."""
SLIDING = 4.0
"""Cost of a millimetre of slide [1/mm]."""
LOSS = 10.0
"""Cost of the object."""

DEFAULT: Mapping[str, Any] = {
    "camera": {"size_px": (80, 60), "region_mm": (4.8, 3.6)},
    "labels": {"grid_samples": 256, "grid_size_mm": 8.0},
    "finger": {"count": 6, "ridged_share": 1.0, "ridge_pitch_um": {"uniform": (600.0, 900.0)}},
}
"""Configuration of fingers and camera: a ridge is 10 to 15 pixels."""


class GripEnv(gymnasium.Env[NDArray[np.uint8], NDArray[np.float32]]):
    """Hold an object whose weight grows at an unknown moment, by what the camera sees of its contact.

    Observation: the frame, uint8 (rows, cols, 1) [DN]. Action: grip force, float32 (1,) [N]. Reward of a step: minus
    :data:`EFFORT` times the share of the greatest force and the time, minus :data:`SLIDING` times the slide; minus
    :data:`LOSS` where the object is lost, which ends the episode. ``info`` has what no controller sees: force, weight,
    friction and slide.

    Parameters
    ----------
    scene : Scene or str
    config : DatasetConfig or mapping, optional
        :data:`DEFAULT`.
    task : GripTask, optional
    rig_seed : int
        Of fingers and rig.

    Notes
    -----
    ``reset(seed=n)`` begins episode ``n``: the same seed is the same object, friction, weights and noise.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 30}  # noqa: RUF012

    def __init__(
        self,
        scene: Scene | str = "thesis",
        config: DatasetConfig | Mapping[str, Any] | None = None,
        task: GripTask | None = None,
        rig_seed: int = 0,
    ) -> None:
        if config is None or isinstance(config, Mapping):
            config = validate(DatasetConfig, dict(config or DEFAULT), "config")
        seen = load_scene(scene) if isinstance(scene, str) else scene
        config = about(config, seen)
        self.model = GripModel(seen, config, task or GripTask(), rig_seed)
        cols, rows = config.camera.size_px or seen.camera.resolution_px
        low, high = self.model.task.force_N
        self.observation_space = gymnasium.spaces.Box(0, 255, (rows, cols, 1), np.uint8)
        self.action_space = gymnasium.spaces.Box(np.float32(low), np.float32(high), (1,), np.float32)
        self.render_mode = "rgb_array"
        self._frame = np.zeros((rows, cols), np.uint8)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        """Begin an episode."""
        super().reset(seed=seed)
        episode = int(self.np_random.integers(2**31)) if seed is None else seed
        found = self.model.reset(episode)
        return self._seen(), self._info(found)

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        """Ask for a grip force for the time of one frame."""
        found = self.model.step(float(np.asarray(action).ravel()[0]))
        return self._seen(), reward(found, self.model.task), found.lost, self.model.done, self._info(found)

    def render(self) -> NDArray[np.uint8]:
        """Return the last frame, (rows, cols, 3)."""
        return np.repeat(self._frame[..., None], 3, axis=2)

    def _seen(self) -> NDArray[np.uint8]:
        self._frame = self.model.frame()
        return self._frame[..., None]

    def _info(self, found: GripStep) -> dict[str, Any]:
        return {**vars(found), "friction_coefficient": self.model.friction_coefficient}


def reward(step: GripStep, task: GripTask) -> float:
    """Return the reward of a step: see :class:`GripEnv`."""
    effort = EFFORT * step.force_N / task.force_N[1] / task.frame_rate_hz
    return -effort - SLIDING * abs(step.slid_now_mm) - (LOSS if step.lost else 0.0)
