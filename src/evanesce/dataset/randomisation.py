"""Section ``randomisation`` of a dataset's configuration: which effects act in which share of the rigs."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from evanesce.core.quantities import Strict, field
from evanesce.effects import all_effects

MOVES_PIXELS = {
    "distortion_drift": "labels would not follow: draw camera.lens.distortion.k1 instead",
}
"""Effects that displace the image, and why they are not drawn."""
ACTS_TWICE = {
    "friction": "friction.friction_coefficient draws it, trial by trial",
    "shear_area_loss": "friction.area_left takes the area, by each trial's own force: draw that",
}
"""Effects whose physics every trial has, and where it is set."""
NOT_DRAWN = {
    **MOVES_PIXELS,
    **ACTS_TWICE,
    "card_offset": "not observable: no printed card is in a frame",
    "frame_rate": "not observable: it changes the time stamps of a camera; time_s is the true time",
    "square_size": "not observable: no printed card is in a frame",
}
"""Effects that are never drawn, and why."""


class EffectShare(Strict):
    """Probability and strength of one effect, in place of those of all."""

    probability: float | None = field(None, unit="1", bounds=(0.0, 1.0), doc="of the effect in a rig")
    strength: float | None = field(None, unit="1", bounds=(0.0, 10.0))


class Randomisation(Strict):
    """Domain randomisation: each effect of the library acts in a share of the rigs.

    The standard deviation of a parameter is ``strength`` times the one that its effect states; one-sided amplitudes are
    folded. ``only`` restricts to the named effects, ``without`` excludes some, ``effects`` gives some figures of their
    own.
    """

    probability: float = field(0.25, unit="1", bounds=(0.0, 1.0), doc="of each effect in a rig")
    strength: float = field(1.0, unit="1", bounds=(0.0, 10.0))
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    effects: dict[str, EffectShare] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _known(self) -> Self:
        known = all_effects()
        for name in (*self.only, *self.without):
            if name not in known:
                raise ValueError(f"randomisation names {name!r} (allowed: {', '.join(known)})")
        for name in self.only:
            if name in NOT_DRAWN:
                raise ValueError(f"randomisation.only names {name!r} (not drawn: {NOT_DRAWN[name]})")
        for name in self.effects:
            if name not in known or name in self.left_out:
                why = self.left_out.get(name, f"allowed: {', '.join(known)}")
                raise ValueError(f"randomisation.effects names {name!r} ({why})")
            if self.only and name not in self.only:
                raise ValueError(f"randomisation.effects names {name!r} (allowed: those of randomisation.only)")
        return self

    def probability_of(self, name: str) -> float:
        """Return the probability of an effect in a rig."""
        own = self.effects.get(name, EffectShare()).probability
        return self.probability if own is None else own

    def strength_of(self, name: str) -> float:
        """Return an effect's strength."""
        own = self.effects.get(name, EffectShare()).strength
        return self.strength if own is None else own

    @property
    def candidates(self) -> tuple[str, ...]:
        """Effects that may be drawn, in the library's order."""
        named = (e for e in all_effects() if (not self.only or e in self.only) and e not in self.left_out)
        return tuple(e for e in named if self.probability_of(e) > 0.0 and self.strength_of(e) > 0.0)

    @property
    def left_out(self) -> dict[str, str]:
        """Effects that are not drawn, and why; those that ``only`` does not name are not among them."""
        asked = dict.fromkeys((e for e in all_effects() if e in self.without), "by this configuration")
        return dict(sorted({**asked, **NOT_DRAWN}.items()))
