"""Configuration of a dataset: strict TOML of distributions, group counts, label options and splits."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.dataset.config_contact import PRINT_LIMITS_UM, PRINT_PATTERNS, RIDGE_PATTERNS, Wet
from evanesce.dataset.config_motion import Motion
from evanesce.dataset.distributions import Bounds, Distribution, Drawn, choice, constant, log_uniform, uniform
from evanesce.dataset.limits import MAX_CONFIG_BYTES, MAX_SHARD_FRAMES, MAX_SIDE_PX, MIN_SIDE_PX
from evanesce.dataset.markers import Markers
from evanesce.dataset.randomisation import Randomisation
from evanesce.materials import material_names
from evanesce.rig.load import validate

KINDS = ("slide", "load_stop", "wiggle", "rotation", "ramp", "release", "change", "spin", "regrasp")
"""Kinds of trial."""
SLIDING = ("slide", "spin", "regrasp")
"""Kinds in which the whole contact slides; the others are negatives."""
LIFT, AWAY = 0.5, 0.3
"""Time in which a finger is lifted, and until it is pressed on again elsewhere, over that of a press."""


class Kinds(Strict):
    """Relative weights of the kinds of trial."""

    slide: float = field(0.7, unit="1", bounds=(0.0, 1e6))
    load_stop: float = field(0.04, unit="1", bounds=(0.0, 1e6))
    wiggle: float = field(0.08, unit="1", bounds=(0.0, 1e6))
    rotation: float = field(0.08, unit="1", bounds=(0.0, 1e6))
    ramp: float = field(0.03, unit="1", bounds=(0.0, 1e6))
    release: float = field(0.04, unit="1", bounds=(0.0, 1e6))
    change: float = field(0.03, unit="1", bounds=(0.0, 1e6))
    spin: float = field(0.0, unit="1", bounds=(0.0, 1e6))
    regrasp: float = field(0.0, unit="1", bounds=(0.0, 1e6))

    @model_validator(mode="after")
    def _some(self) -> Self:
        if sum(self.weights) <= 0:
            raise ValueError("all weights are 0 (allowed: at least one kind with a weight above 0)")
        return self

    @property
    def weights(self) -> tuple[float, ...]:
        """In the order of :data:`KINDS`."""
        return tuple(getattr(self, kind) for kind in KINDS)


class Programme(Drawn):
    """Loading programme of a trial; drawn for each.

    A slide drives the finger to and fro: up to gross slip, ``distance_mm`` on, and back, ``reversals`` times, at
    ``speed_mm_per_s`` or as much faster as gross slip within the trial needs. Long distances and few reversals give
    more frames of gross slip, short ones and many more of partial slip; press and hold times give those of stick.
    """

    SECTION: ClassVar[str] = "programme"
    BOUNDS: ClassVar[Bounds] = {
        "normal_force_N": (0.02, 100.0, "N"),
        "preload_N": (0.001, 10.0, "N"),
        "press_time_s": (0.005, 1000.0, "s"),
        "hold_time_s": (0.0, 1000.0, "s"),
        "speed_mm_per_s": (0.01, 1000.0, "mm/s"),
        "distance_mm": (0.01, 100.0, "mm"),
        "reversals": (0.0, 10_000.0, ""),
        "direction_deg": (-180.0, 180.0, "deg"),
        "contact_angle_deg": (0.0, 45.0, "deg"),
        "wiggle_share": (0.01, 0.98, "of the sliding force"),
        "wiggle_frequency_hz": (0.1, 15.0, "Hz"),
        "rotation_share": (0.01, 0.98, "of the sliding torque"),
        "second_force_share": (0.05, 10.0, "of the first force"),
        "shift_mm": (-20.0, 20.0, "mm"),
    }

    normal_force_N: Distribution = uniform(0.5, 1.5)
    preload_N: Distribution = constant(0.05)
    press_time_s: Distribution = uniform(0.2, 0.4)
    hold_time_s: Distribution = uniform(0.05, 0.2)
    speed_mm_per_s: Distribution = log_uniform(0.5, 6.0)
    distance_mm: Distribution = uniform(0.5, 1.1)
    reversals: Distribution = choice(0.0, 100.0, 100.0)
    direction_deg: Distribution = uniform(-180.0, 180.0)
    contact_angle_deg: Distribution = choice(0.0, 45.0)
    wiggle_share: Distribution = uniform(0.3, 0.9)
    wiggle_frequency_hz: Distribution = uniform(1.0, 4.0)
    rotation_share: Distribution = uniform(0.3, 0.95)
    second_force_share: Distribution = uniform(0.4, 1.25)
    shift_mm: Distribution = uniform(-0.6, 0.6)


class Friction(Drawn):
    """Interfaces: ``levels`` of them are drawn; a trial has one."""

    SECTION: ClassVar[str] = "friction"
    BOUNDS: ClassVar[Bounds] = {
        "friction_coefficient": (0.01, 10.0, ""),
        "adhesive_share": (0.0, 1.0, "of the strength at the held force"),
        "dynamic_ratio": (0.05, 1.0, ""),
        "weakening_distance_mm": (1e-4, 10.0, "mm"),
        "area_left": (0.35, 1.0, "of the area, under full sliding"),
        "ridge_friction_ratio": (0.1, 10.0, "along parallel ridges, of that across them"),
        "speed_exponent": (0.0, 1.0, "of slides: friction goes as (speed / 1 mm/s)^exponent"),
    }

    levels: int = field(16, unit="1", bounds=(1, 100_000))
    friction_coefficient: Distribution = log_uniform(0.3, 1.2)
    adhesive_share: Distribution = uniform(0.0, 0.6)
    dynamic_ratio: Distribution = uniform(0.7, 1.0)
    weakening_distance_mm: Distribution = log_uniform(0.02, 0.2)
    area_left: Distribution = uniform(0.75, 1.0)
    ridge_friction_ratio: Distribution = constant(1.0)
    speed_exponent: Distribution = constant(0.0)


class Fingers(Drawn):
    """Fingers: ``count`` of them are drawn; a trial has one."""

    SECTION: ClassVar[str] = "finger"
    BOUNDS: ClassVar[Bounds] = {
        "tip_radius_mm": (0.5, 100.0, "mm"),
        "ridge_pitch_um": (20.0, 20000.0, "um"),
        "ridge_width_share": (0.05, 0.95, "of the pitch"),
        "ridge_height_um": (0.1, 5000.0, "um"),
        "ridge_orientation_deg": (-180.0, 180.0, "deg"),
        "shaft_stiffness_N_per_mm": (0.05, 1e5, "N/mm"),
        "axial_over_bending": (0.1, 1e4, ""),
        "tilt_deg": (0.0, 45.0, "deg"),
        "tilt_direction_deg": (-180.0, 180.0, "deg"),
    }

    count: int = field(12, unit="1", bounds=(1, 100_000))
    material: Distribution = constant("silskin_0")
    tip_radius_mm: Distribution = constant(7.5)
    ridged_share: float = field(0.75, unit="1", bounds=(0.0, 1.0), doc="share of fingers that have ridges")
    pattern: Distribution = choice("parallel", "concentric", "loop", "whorl")
    ridge_pitch_um: Distribution = uniform(500.0, 1200.0)
    ridge_width_share: Distribution = uniform(0.4, 0.6)
    ridge_height_um: Distribution = uniform(100.0, 200.0)
    ridge_orientation_deg: Distribution = uniform(-90.0, 90.0)
    shaft_stiffness_N_per_mm: Distribution = log_uniform(2.0, 30.0)
    axial_over_bending: Distribution = log_uniform(2.0, 10.0)
    tilt_deg: Distribution = constant(0.0)
    tilt_direction_deg: Distribution = uniform(-180.0, 180.0)

    @model_validator(mode="after")
    def _bounds(self) -> Self:
        self.material.require_words("finger.material", material_names())
        self.pattern.require_words("finger.pattern", (*RIDGE_PATTERNS, *PRINT_PATTERNS))
        if any(name in PRINT_PATTERNS for name in self.pattern.support()):
            for key, (low, high) in PRINT_LIMITS_UM.items():
                getattr(self, key).require_within(f"finger.{key}", low, high, "um, of a print")
        return self


class Rigs(Strict):
    """Rigs: ``count`` of them are drawn, each a change of the scene and a set of effects; a trial has one.

    ``draw`` maps dotted keys of the scene to distributions; left out, it is about the scene's own figures, as the
    finger's material and tip radius are the scene's.
    """

    count: int = field(8, unit="1", bounds=(1, 100_000))
    trials_in_a_row: int = field(2, unit="1", bounds=(1, 10_000), doc="trials before the rig changes")
    draw: dict[str, Distribution] = Field(
        default_factory=lambda: {
            "leds.voltage_V": uniform(8.6, 10.0),
            "camera.exposure_ms": uniform(4.0, 8.0),
            "camera.pixel.read_noise_e": uniform(2.0, 6.0),
            "camera.lens.distortion.k1": uniform(-0.42, -0.36),
        }
    )


class Trial(Strict):
    """A trial in frames."""

    frames: int = field(80, unit="1", bounds=(4, 100_000))
    frame_rate_hz: float = field(30.0, unit="Hz", bounds=(1.0, 1000.0), source="thesis, chapter 5")


CHANNELS: dict[str, str] = {
    "contact_mask": "1",
    "state": "0 none, 1 near, 2 stick, 3 slip",
    "pressure": "MPa",
    "gap": "mm",
    "traction.x": "MPa",
    "traction.y": "MPa",
    "strength": "MPa",
    "slip.x": "mm",
    "slip.y": "mm",
    "slip_velocity.x": "mm/s",
    "slip_velocity.y": "mm/s",
}
"""Channels of the labels and their units. Traction: of the finger on the glass; strength: the traction
at which it slips; slip: of its skin over the glass."""
ALL = "all"
MAPS: tuple[Literal["frame", "plate"], ...] = ("frame", "plate")
"""Where labels may be stored: in the distorted frame, on the plate plane."""


class Labels(Strict):
    """Label options; ``frame`` and ``plate`` name the channels that are stored of each frame, or ``all``.

    Those that are not stored are computed again where a frame is read.
    """

    frame: tuple[str, ...] = ()
    plate: tuple[str, ...] = ()
    precision: Literal["half", "float"] = "half"
    raw: bool = False
    grid_size_mm: float = field(10.0, unit="mm", bounds=(1.0, 200.0), doc="side of the contact plane that is sampled")
    grid_samples: int = field(320, unit="1", bounds=(32, 8192), doc="along that side, of the labels on the plate plane")
    margin_mm: float = field(0.5, unit="mm", bounds=(0.0, 50.0), doc="around the contact, in which the gap is kept")
    near_gap_mm: float = field(0.01, unit="mm", bounds=(1e-6, 1.0), doc="below which a surface counts as near")
    first_slip_share: float = field(0.05, unit="1", bounds=(1e-4, 0.9), doc="slipping share of area: first slip")

    @field_validator("frame", "plate", mode="before")
    @classmethod
    def _one(cls, value: Any) -> Any:
        """Take one name for a list of it, and lists from JSON as they are from TOML."""
        return (value,) if isinstance(value, str) else tuple(value) if isinstance(value, list) else value

    @model_validator(mode="after")
    def _known(self) -> Self:
        for key in ("frame", "plate"):
            for name in getattr(self, key):
                if name not in (*CHANNELS, ALL):
                    raise ValueError(f"labels.{key} names {name!r} (allowed: {ALL}, {', '.join(CHANNELS)})")
        return self

    def channels(self, key: Literal["frame", "plate"]) -> tuple[str, ...]:
        """Return the stored channels, in their order."""
        asked = getattr(self, key)
        return tuple(name for name in CHANNELS if ALL in asked or name in asked)


class CameraOptions(Strict):
    """Camera options: the camera's whole view, on ``scale`` times as many pixels a side, or a region about the finger.

    ``size_px`` (columns, rows) reads out ``region_mm`` (width, height) about the finger's position, by default the
    smallest region that holds the contacts of the dataset.
    """

    scale: float = field(1.0, unit="1", bounds=(0.01, 2.0))
    size_px: tuple[int, int] | None = None
    region_mm: tuple[float, float] | None = None
    backend: Literal["numpy", "llvm"] = "numpy"

    @model_validator(mode="after")
    def _one_view(self) -> Self:
        if self.size_px is None:
            if self.region_mm is not None:
                raise ValueError("camera.region_mm without camera.size_px (allowed: both, or neither)")
            return self
        if self.scale != 1.0:
            raise ValueError("camera.size_px and camera.scale (allowed: one of them)")
        if not all(MIN_SIDE_PX <= side <= MAX_SIDE_PX for side in self.size_px):
            raise ValueError(f"camera.size_px = {list(self.size_px)} (allowed: {MIN_SIDE_PX} to {MAX_SIDE_PX} a side)")
        if self.region_mm is not None:
            (cols, rows), (width, height) = self.size_px, self.region_mm
            if not (0.1 <= width <= 1000.0 and abs(height * cols / (width * rows) - 1.0) < 0.01):
                raise ValueError(
                    f"camera.region_mm = {list(self.region_mm)} (allowed: 0.1 to 1000 mm wide, with square pixels)"
                )
        return self


class Split(Strict):
    """Shares of the trials; no finger and no rig is in two splits, with ``finger_rig_friction`` no friction level."""

    by: Literal["finger_rig", "finger_rig_friction"] = "finger_rig"
    validation: float = field(0.15, unit="1", bounds=(0.0, 0.9))
    test: float = field(0.25, unit="1", bounds=(0.0, 0.9))

    @model_validator(mode="after")
    def _leaves_some(self) -> Self:
        if self.validation + self.test >= 1.0:
            raise ValueError("split.validation + split.test leave nothing to train on (allowed: below 1)")
        return self


class DatasetConfig(Strict):
    """Configuration of a dataset, without scene, seed and count."""

    schema_version: int = Field(default=1, ge=1, le=1)
    title: str = Field(default="", max_length=200)
    trial: Trial = Trial()
    trials_per_shard: int = field(2, unit="1", bounds=(1, 10_000))
    kinds: Kinds = Kinds()
    programme: Programme = Programme()
    motion: Motion = Motion()
    friction: Friction = Friction()
    finger: Fingers = Fingers()
    liquid: Wet = Wet()
    rig: Rigs = Rigs()
    randomisation: Randomisation = Randomisation()
    labels: Labels = Labels()
    markers: Markers = Markers()
    camera: CameraOptions = CameraOptions()
    split: Split = Split()

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.shard_frames > MAX_SHARD_FRAMES:
            raise ValueError(
                f"{self.shard_frames} frames a shard: trials_per_shard times trial.frames"
                f" (allowed: at most {MAX_SHARD_FRAMES}; longer trials need trial.frames <= {MAX_SHARD_FRAMES})"
            )
        self._require_time()
        pitch_um = 1e3 * self.labels.grid_size_mm / self.labels.grid_samples
        self.markers.require_resolved(1e-3 * pitch_um)
        if self.finger.ridged_share > 0:
            smallest = float(self.finger.ridge_pitch_um.support()[0])
            if smallest < 6 * pitch_um:
                raise ValueError(
                    f"ridges {smallest:g} um apart on a grid of {pitch_um:.3g} um a sample"
                    f" (allowed: labels.grid_samples of at least {int(6e3 * self.labels.grid_size_mm / smallest) + 1})"
                )
        return self

    def _require_time(self) -> None:
        """Refuse trials that end before the finger slides, or slides again."""
        press, hold = (float(d.support()[1]) for d in (self.programme.press_time_s, self.programme.hold_time_s))
        again = bool(self.kinds.regrasp)
        least = press + hold + again * (LIFT + AWAY + 1.0) * press
        lasts = (self.trial.frames - 1) / self.trial.frame_rate_hz
        if sum(getattr(self.kinds, kind) for kind in SLIDING) > 0 and lasts <= least:
            raise ValueError(
                f"trial.frames = {self.trial.frames} at {self.trial.frame_rate_hz:g} Hz last {lasts:.3g} s, press and"
                f" hold{' and a second press' if again else ''} up to {least:.3g} s (allowed: more than"
                f" {least * self.trial.frame_rate_hz + 1:.0f} frames, or shorter programme.press_time_s, hold_time_s)"
            )

    @property
    def shard_frames(self) -> int:
        """Frames of a full shard."""
        return self.trials_per_shard * self.trial.frames

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON-able data, None left out."""
        return self.model_dump(mode="json", exclude_none=True)

    def given(self) -> dict[str, Any]:
        """Return :meth:`as_dict` of the keys alone that were given."""
        return self.model_dump(mode="json", exclude_none=True, exclude_unset=True)


def load_config(path: Path | None) -> DatasetConfig:
    """Read a dataset's TOML, or return the defaults.

    Raises
    ------
    InputError
        One line with file, key and what is allowed.
    """
    if path is None:
        return DatasetConfig()
    if not path.is_file():
        raise InputError("no such file", file=path, key="--config", allowed="a TOML file")
    if path.stat().st_size > MAX_CONFIG_BYTES:
        raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_CONFIG_BYTES} bytes")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid TOML: {error}", file=path) from None
    return validate(DatasetConfig, data, path)


def with_size(config: DatasetConfig, size: str) -> DatasetConfig:
    """Return a configuration whose frames have a size, ``320x240``; empty: as it is.

    Raises
    ------
    InputError
        If it is no size, or one that the configuration does not go with.
    """
    if not size:
        return config
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", size)
    if found is None:
        raise InputError(repr(size), key="--size", allowed="COLSxROWS, e.g. 320x240")
    camera = {**config.camera.model_dump(exclude_none=True), "size_px": (int(found[1]), int(found[2]))}
    camera.pop("region_mm", None)
    return config.model_copy(update={"camera": validate(CameraOptions, camera, "--size")})
