"""The loading programme: which normal forces, when, seen at which frame rate."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from evanesce.quantities import Strict, field


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
    frame_rate_hz: float = field(30.0, unit="hz", bounds=(0.01, 10000.0), source="thesis, chapter 5")
    max_frames: int = Field(10_000, ge=1, le=1_000_000)

    @model_validator(mode="after")
    def _one_programme(self) -> Self:
        if (self.forces_N is None) == (self.ramp is None):
            raise ValueError("give exactly one of forces_N and ramp")
        return self
