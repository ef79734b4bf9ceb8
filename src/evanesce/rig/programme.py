"""The loading programme: which normal forces, when, seen at which frame rate; and a slide at one of them."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from evanesce.core.quantities import Strict, field


class Ramp(Strict):
    """Load from ``start_N`` to ``stop_N`` at one of two rates."""

    start_N: float = field(0.0, unit="N", bounds=(0.0, 1000.0))
    stop_N: float = field(unit="N", bounds=(0.0, 1000.0))
    rate_N_per_s: float | None = field(None, unit="N/s", bounds=(1e-4, 1e4))
    rate_mm_per_min: float | None = field(None, unit="mm/min", bounds=(1e-3, 1e5))

    @model_validator(mode="after")
    def _one_rate(self) -> Self:
        if (self.rate_N_per_s is None) == (self.rate_mm_per_min is None):
            raise ValueError("give exactly one of rate_N_per_s and rate_mm_per_min")
        if self.stop_N == self.start_N:
            raise ValueError("stop_N equals start_N")
        return self


class Press(Strict):
    """Either a list of held forces, one frame each, or a ramp sampled at the frame rate."""

    forces_N: tuple[float, ...] | None = field(
        None, unit="N", bounds=(0.0, 1000.0), doc="held normal forces", min_length=1, max_length=100_000
    )
    ramp: Ramp | None = None
    rate_mm_per_min: float | None = field(
        None, unit="mm/min", bounds=(1e-3, 1e5), doc="at which each held force was approached; none: 5 mm/min"
    )
    dwell_s: float | None = field(
        None, unit="s", bounds=(0.0, 1e6), doc="for which each force is held before its frame"
    )
    frame_rate_hz: float = field(30.0, unit="Hz", bounds=(0.01, 10000.0), source="thesis, chapter 5")
    max_frames: int = Field(10_000, ge=1, le=1_000_000)

    @model_validator(mode="after")
    def _one_programme(self) -> Self:
        if (self.forces_N is None) == (self.ramp is None):
            raise ValueError("give exactly one of forces_N and ramp")
        if self.ramp is not None and (self.rate_mm_per_min is not None or self.dwell_s is not None):
            raise ValueError(
                "press.rate_mm_per_min and press.dwell_s belong to forces_N (allowed: the ramp's own rate)"
            )
        return self


class Slide(Strict):
    """The thesis's friction programme: preload, press to the held force, rest, slide, perhaps back."""

    speed_mm_per_s: float = field(1.0, unit="mm/s", bounds=(1e-3, 1000.0), source="thesis, chapter 6: 1 to 25 mm/s")
    distance_mm: float = field(unit="mm", bounds=(1e-3, 500.0), doc="of the finger's top over the glass")
    direction_deg: float = field(0.0, unit="deg", bounds=(-180.0, 180.0), doc="of the finger, from x towards y")
    friction_coefficient: float | None = field(
        None, unit="1", bounds=(1e-3, 10.0), doc="Coulomb's; none: tau0/p + alpha of the material"
    )
    friction_factor: float | None = field(
        None, unit="1", bounds=(0.05, 20.0), null=1.0, doc="over the friction of material or coefficient; not published"
    )
    speed_exponent: float | None = field(
        None, unit="1", bounds=(0.0, 1.0), doc="friction grows as (speed/1 mm/s)^exponent; none: 0; not published"
    )
    drive_stiffness_N_per_mm: float | None = field(
        None,
        unit="N/mm",
        bounds=(1e-3, 1e6),
        doc="of the machine along the slide, in series with the shaft; none: rigid",
    )
    spin_deg_per_s: float | None = field(
        None,
        unit="deg/s",
        bounds=(-3600.0, 3600.0),
        null=0.0,
        doc="of the sliding finger about the plate's normal, from x towards y",
    )
    ridge_friction_ratio: float | None = field(
        None,
        unit="1",
        bounds=(0.1, 10.0),
        null=1.0,
        doc="friction along the ridges over that across; not published",
    )
    stick_slip_drop: float | None = field(
        None,
        unit="1",
        bounds=(0.0, 0.45),
        null=0.0,
        doc="share of friction lost once the whole contact slips: stick-slip; not published",
    )
    contact_angle_deg: float = field(0.0, unit="deg", bounds=(0.0, 45.0), source="thesis, chapter 6: 0 and 45 deg")
    preload_N: float = field(0.05, unit="N", bounds=(0.0, 1000.0), source="thesis, chapter 6")
    press_time_s: float = field(2.0, unit="s", bounds=(1e-3, 1e4), doc="from preload to the held force")
    hold_time_s: float = field(0.0, unit="s", bounds=(0.0, 1e4), null=0.0)
    reciprocate: bool = False
    shaft: Literal["silicone", "rigid"] = "silicone"
    glass_moves: bool = False
    area_under_shear: Literal["physics", "constant"] = "physics"
    area_loss_mm2_per_N2: float = field(
        0.0, unit="mm^2/N^2", bounds=(0.0, 1e4), null=0.0, doc="Sahli's alpha_A, in place of physics"
    )
