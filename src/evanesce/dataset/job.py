"""Specification of a dataset: scene, configuration, seed and count; read from and written to ``dataset.json``."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evanesce.core import provenance
from evanesce.core.errors import InputError
from evanesce.dataset import layout
from evanesce.dataset.about import about
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.design import ITS_TRIALS_MOTION
from evanesce.dataset.limits import require_count, require_frame, resolution
from evanesce.dataset.randomisation import ACTS_TWICE, MOVES_PIXELS
from evanesce.effects import active_effects
from evanesce.rig import Scene

CONTACT_MARGIN = 1.1
"""Margin for contacts that effects of the finger enlarge."""


NAMED = 8
"""Maximum number of keys that an error names."""


@dataclass(frozen=True)
class Job:
    """Specification of a dataset.

    Attributes
    ----------
    scene : Scene
    config : DatasetConfig
    seed : int
    frames : int
        Number of frames, a multiple of the trial's.
    recorded : str
        :attr:`digest` of a stored description when it was written; a later version may have more keys.
    """

    scene: Scene
    config: DatasetConfig
    seed: int
    frames: int
    recorded: str = ""

    @property
    def trials(self) -> int:
        """Count of trials."""
        return self.frames // self.config.trial.frames

    @property
    def shards(self) -> int:
        """Count of shards."""
        return math.ceil(self.trials / self.config.trials_per_shard)

    def trials_of(self, shard: int) -> range:
        """Return the trials of a shard."""
        per = self.config.trials_per_shard
        return range(shard * per, min((shard + 1) * per, self.trials))

    def frames_of(self, trial: int) -> range:
        """Return the frames of a trial."""
        per = self.config.trial.frames
        return range(trial * per, (trial + 1) * per)

    @property
    def digest(self) -> str:
        """SHA-256 of everything that determines the bytes of a frame, versions excepted."""
        return self.recorded or _frames_digest(self.scene.as_dict(), self.config.as_dict(), self.seed)

    @property
    def request(self) -> str:
        """SHA-256 of everything that determines the dataset: :attr:`digest`, count of frames, trials per shard."""
        return provenance.digest([self.digest, self.frames, self.config.trials_per_shard])

    @property
    def resolution(self) -> tuple[int, int]:
        """(columns, rows) of a frame."""
        return resolution(self.scene.camera.resolution_px, self.config.camera.scale, self.config.camera.size_px)

    def describe(self) -> dict[str, Any]:
        """Return the content of ``dataset.json``."""
        return {
            "format": layout.FORMAT,
            "format_version": layout.FORMAT_VERSION,
            "title": self.config.title or self.scene.title,
            "frames": self.frames,
            "trials": self.trials,
            "shards": self.shards,
            "seed": self.seed,
            "config_sha256": self.digest,
            "request_sha256": self.request,
            "scene": self.scene.as_dict(),
            "config": self.config.as_dict(),
            "provenance": dict(provenance.record(seed=self.seed)),
        }


def _frames_digest(scene: dict[str, Any], config: dict[str, Any], seed: int) -> str:
    config = {key: value for key, value in config.items() if key != "trials_per_shard"}
    return provenance.digest({"scene": scene, "config": config, "seed": seed})


MOST_SAMPLES = 1024
"""Along a side of the sampled plane, up to which it grows by itself: ten times the samples of the default."""


def new_job(scene: Scene, config: DatasetConfig, *, frames: int, seed: int) -> Job:
    """Check a request and round its frames up to complete trials.

    Raises
    ------
    InputError
        For a request beyond any disk or memory; nothing is allocated before.
    """
    if not 0 <= seed < 2**63:
        raise InputError(f"{seed}", key="--seed", allowed="0 to 2^63 - 1")
    require_count(frames)
    config = _with_plane(about(config, scene))
    if scene.finger.height_map is not None:
        raise InputError("a height map does not slide", key="finger.height_map", allowed="finger.ridges, or neither")
    refused = MOVES_PIXELS | ACTS_TWICE
    for name in sorted(refused.keys() & scene.effects.keys()):
        raise InputError(refused[name], key=f"effects.{name}", allowed="a scene without it")
    for entry in active_effects(scene):
        if entry.effect.id in ITS_TRIALS_MOTION and not entry.effect.is_null(entry.parameters):
            raise InputError(
                "the motion is each trial's own", key=f"effects.{entry.effect.id}", allowed="readout_ms alone"
            )
    per = config.trial.frames
    if config.camera.size_px is not None and config.camera.region_mm is None:
        from evanesce.dataset.region import fitted_region

        region = fitted_region(scene, config, seed)
        config = config.model_copy(update={"camera": config.camera.model_copy(update={"region_mm": region})})
    job = Job(scene, config, seed, math.ceil(frames / per) * per)
    require_frame(*job.resolution, config.labels.grid_samples)
    _contact_fits(job)
    _ways_fit(job)
    _rigs_are_possible(job)
    return job


def _rigs_are_possible(job: Job, sampled: int = 16) -> None:
    """Build the scenes of both ends of what is drawn, and the first rigs: an error shows before the first frame."""
    from evanesce.dataset.design import RigPlan, finger_plan, rig_plan
    from evanesce.dataset.rigs import rig_scene, rig_with_effects

    finger = finger_plan(job.config, job.seed, 0)
    for key, drawn in job.config.rig.draw.items():
        for edge in dict.fromkeys(drawn.support()):
            try:
                rig_scene(job.scene, RigPlan(0, 0, {key: edge}, {}), finger, job.config)
            except InputError as error:
                raise InputError(
                    f"may draw {edge if isinstance(edge, str) else f'{edge:g}'}: {error.what}",
                    file=error.file,
                    key=f"rig.draw.'{key}'",
                    allowed=error.allowed,
                ) from None
    for index in range(min(job.config.rig.count, sampled)):
        plan = rig_plan(job.config, job.seed, index)
        rig_with_effects(rig_scene(job.scene, plan, finger, job.config), plan.seed)


def _ways_fit(job: Job) -> None:
    """Refuse paths that leave the sampled plane, and tilts that leave the tip, by the first trials."""
    from evanesce.dataset.config_motion import MOTIONS
    from evanesce.dataset.region import MARGIN, SAMPLED_TRIALS, reaches

    config = job.config
    moves = config.kinds.regrasp + sum(getattr(config.motion, name) for name in MOTIONS)
    if not (moves or float(config.finger.tilt_deg.support()[1])):
        return
    need = 2.0 * MARGIN * float(reaches(job.scene, config, job.seed, SAMPLED_TRIALS).max())
    if need > config.labels.grid_size_mm:
        raise InputError(
            f"contacts and their ways of up to {need:.3g} mm leave the sampled plane", key="labels.grid_size_mm",
            allowed=f"at least {need:.4g} mm (with more labels.grid_samples), or smaller forces and distances",
        )  # fmt: skip


def _with_plane(config: DatasetConfig) -> DatasetConfig:
    """Return a configuration whose sampled plane holds its contacts, at the same pitch, unless it states a plane."""
    labels = config.labels
    if {"grid_size_mm", "grid_samples"} & labels.model_fields_set:
        return config
    pitch = labels.grid_size_mm / labels.grid_samples
    samples = math.ceil(_reach_of(config).plane_mm(pitch) / pitch)
    if not labels.grid_samples < samples <= MOST_SAMPLES:
        return config
    plane = {"grid_size_mm": samples * pitch, "grid_samples": samples}
    return config.model_copy(update={"labels": labels.model_copy(update=plane)})


@dataclass(frozen=True)
class _Reach:
    """Largest radius of a tip, of a contact, and way of a contact from its place [mm]."""

    tip: float
    widest: float
    travel: float

    def plane_mm(self, pitch: float) -> float:
        """Return the least side of the sampled plane [mm] by its pitch [mm]."""
        return 2.0 * (self.widest + self.travel) * 1.02 + 4 * pitch


def _reach_of(config: DatasetConfig) -> _Reach:
    """Return how far contacts reach, by the bounds of the distributions."""
    from evanesce.contact.analytic.hertz import hertz_radius
    from evanesce.materials import material

    force = _largest_force(config)
    radius = float(config.finger.tip_radius_mm.support()[1])
    names = [str(name) for name in config.finger.material.support()]
    widest = max(float(hertz_radius(force, radius, float(material(n).reduced_modulus(force)))) for n in names)
    widest *= CONTACT_MARGIN
    shift = max(abs(float(v)) for v in config.programme.shift_mm.support())
    travel = max(shift, 0.5 * float(config.programme.distance_mm.support()[1]) + _stick_reach(config, force, radius))
    return _Reach(radius, widest, travel)


def _largest_force(config: DatasetConfig) -> float:
    force = float(config.programme.normal_force_N.support()[1])
    return force * max(1.0, float(config.programme.second_force_share.support()[1]))


def _contact_fits(job: Job) -> None:
    """Refuse contacts that would leave the sampled plane, by the bounds of the distributions."""
    config, reach = job.config, _reach_of(job.config)
    need = reach.plane_mm(config.labels.grid_size_mm / config.labels.grid_samples)
    if need > config.labels.grid_size_mm:
        raise InputError(
            f"contacts of up to {reach.widest:.3g} mm radius that travel {reach.travel:.3g} mm leave the sampled plane",
            key="labels.grid_size_mm", allowed=f"at least {need:.4g} mm, or smaller forces and distances",
        )  # fmt: skip
    if reach.widest >= reach.tip:
        raise InputError(
            f"{_largest_force(config):g} N presses {reach.widest:.3g} mm of a tip of {reach.tip:g} mm",
            key="programme.normal_force_N", allowed="a contact smaller than the tip",
        )  # fmt: skip


def _stick_reach(config: DatasetConfig, force_N: float, radius_mm: float) -> float:
    """Return half of the tip's largest way to gross slip [mm]: mu (E*/G*) a^2/R, and tau0 adds a third at most."""
    from evanesce.contact.analytic.hertz import hertz_radius
    from evanesce.contact.analytic.partial_slip import tangential_modulus
    from evanesce.materials import material

    if config.kinds.wiggle == config.kinds.slide == 0:
        return 0.0
    f = config.friction
    highest, ratio, exponent, speed = (
        float(drawn.support()[1])
        for drawn in (f.friction_coefficient, f.ridge_friction_ratio, f.speed_exponent, config.programme.speed_mm_per_s)
    )
    friction = highest * max(ratio, 1.0) * max(speed, 1.0) ** exponent
    ways = []
    for name in config.finger.material.support():
        silicone = material(str(name))
        modulus = float(silicone.reduced_modulus(force_N))
        shear = float(tangential_modulus(modulus, silicone.poisson_ratio))
        depth = float(hertz_radius(force_N, radius_mm, modulus)) ** 2 / radius_mm
        ways.append(0.5 * friction * modulus / shear * depth)
    return max(ways)


def save_job(folder: Path, job: Job) -> None:
    """Write ``dataset.json``; accept an existing equal one.

    Raises
    ------
    InputError
        If the folder holds another dataset, or one begun by other versions.
    """
    path = folder / layout.DESCRIPTION
    if path.exists():
        if load_job(folder, check_versions=True).request != job.request:
            there, asked = (
                {name: data[name] for name in ("scene", "config", "seed", "frames")}
                for data in (layout.read_json(path), job.describe())
            )
            names = ", ".join(differences(there, asked)[:NAMED])
            raise InputError(
                f"the folder holds another dataset: {names} differ", file=folder, key="--out",
                allowed="the same request, or an empty folder",
            )  # fmt: skip
        return
    layout.write_json(path, job.describe())


def differences(a: Any, b: Any, name: str = "") -> list[str]:
    """Return the dotted keys whose values differ between two nested tables."""
    if isinstance(a, dict) and isinstance(b, dict):
        keys = sorted(a.keys() | b.keys())
        return [
            found for key in keys for found in differences(a.get(key), b.get(key), f"{name}.{key}" if name else key)
        ]
    return [] if a == b else [name]


def load_job(folder: Path, *, check_versions: bool = False) -> Job:
    """Read ``dataset.json``.

    Raises
    ------
    InputError
        If it is absent, broken or of another format; with ``check_versions``, if made by other versions.
    """
    path = folder / layout.DESCRIPTION
    data = layout.read_json(path)
    try:
        _require_format(path, data["format"], data["format_version"])
        scene = Scene.model_validate_json(json.dumps(data["scene"]))
        config = DatasetConfig.model_validate_json(json.dumps(data["config"]))
        recorded = _frames_digest(data["scene"], data["config"], data["seed"])
        job = Job(scene, config, int(data["seed"]), int(data["frames"]), recorded)
        written = data["config_sha256"], data["request_sha256"]
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"not a dataset's description: {str(error).splitlines()[0]}", file=path) from None
    if written != (recorded, job.request):
        raise InputError("config_sha256 or request_sha256 does not match the description", file=path)
    if check_versions:
        _require_versions(path, data.get("provenance", {}))
    return job


def _require_format(path: Path, name: object, version: object) -> None:
    if name == layout.FORMAT and version == layout.FORMAT_VERSION:
        return
    allowed = f"{layout.FORMAT} version {layout.FORMAT_VERSION}"
    found = f"{name!r} version {version!r}"
    if name == layout.FORMAT and isinstance(version, int):
        if version in layout.EARLIER:
            found += f", of an earlier evanesce: {layout.EARLIER[version]}"
            allowed += "; make it again in another folder: scene, config and seed are in this file"
        elif version > layout.FORMAT_VERSION:
            found += ", of a later evanesce"
            allowed += "; install that one to read it"
    raise InputError(found, file=path, allowed=allowed)


def _require_versions(path: Path, recorded: dict[str, Any]) -> None:
    before, now = _versions(recorded), _versions(provenance.record())
    names = differences(before, now)
    if names:
        changed = ", ".join(f"{name} {before.get(name, 'missing')} (here {now.get(name, 'missing')})" for name in names)
        raise InputError(
            f"begun with {changed}: frames made on {platform.node()} might differ",
            file=path,
            allowed="the same versions, or --any-versions",
        )


def _versions(record: Mapping[str, Any]) -> dict[str, str]:
    return {name: str(record.get(name)) for name in ("evanesce", "python", "platform")} | dict(
        record.get("packages", {})
    )
