"""Candidate mechanisms, their parameters with priors, and the sets of them that are judged.

Every number that is fitted stands here with its prior. A mechanism has probability one half, except where several
exclude each other (laws of contact; ways in which the fingers scatter): those share it evenly.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

from evanesce.prediction import priors
from evanesce.prediction.parameters import Parameter

FINGERS = ("silskin_0", "silskin_20")


def _parameter(name: str, unit: str, null: float, deviation: float, low: float, high: float) -> Parameter:
    return Parameter(
        name=name, unit=unit, null=null, deviation=deviation, bounds=(low, high), step=0.02 * deviation
    )  # fmt: skip


def _scattering(which: str) -> tuple[Parameter, ...]:
    """Return share and length with the prior that the effect ``lateral_glow`` has; PDMS phantoms have 0.5 to 2 mm."""
    return (
        _parameter(f"{which}:share", "1", 0.0, 0.3, 0.0, 1.0),
        _parameter(f"{which}:length_mm", "mm", 0.0, 0.7, 0.0, 2.2),
    )


@dataclass(frozen=True)
class Mechanism:
    """What may be true of the fingers, the rig or the reading of the text.

    Attributes
    ----------
    id, title : str
    parameters : tuple of Parameter
        Empty where it is one way or the other.
    prior : str
        Where the parameters' priors come from.
    """

    id: str
    title: str
    parameters: tuple[Parameter, ...] = ()
    prior: str = ""
    costly: bool = False
    """No mechanism is: predictions are interpolated."""


LAWS = (
    Mechanism("hertz", "Hertz's contact (small strain, solid finger)"),
    Mechanism("finite_strain", "large strain of a solid finger (finite elements, table 6)"),
    Mechanism(
        "bone", "large strain over a rigid bone", (_parameter("bone:share", "1", 0.4, 0.25, 0.0, 0.8),),
        "radius over the shaft's, 0.4 +- 0.25: cast in, size not printed",
    ),
)  # fmt: skip
SCATTERING = (
    Mechanism("clear", "neither finger scatters"),
    Mechanism("scatter_alike", "both scatter alike", _scattering("scatter"), "that of effect lateral_glow"),
    Mechanism("scatter_0", "Silskin 0 % alone scatters", _scattering("scatter_0"), "that of effect lateral_glow"),
    Mechanism("scatter_20", "Silskin 20 % alone scatters", _scattering("scatter_20"), "that of effect lateral_glow"),
    Mechanism(
        "scatter_each", "both scatter, each in its way", (*_scattering("scatter_0"), *_scattering("scatter_20")),
        "that of effect lateral_glow",
    ),
)  # fmt: skip
SWITCHES = (
    Mechanism(
        "modulus", "moduli other than table 6",
        tuple(_parameter(f"modulus:{m}", "ln", 0.0, 0.5, -1.5, 1.5) for m in FINGERS),
        "factor 1.6 either way for each material: DMA and compression differ by 2.3",
    ),
    Mechanism(
        "adhesion", "adhesion (JKR)",
        tuple(
            _parameter(f"adhesion:{m}", "ln J/m2", math.log(0.05), 1.5, math.log(5e-4), math.log(20)) for m in FINGERS
        ),
        "0.05 J/m2, a factor 4.5 either way, each material: silicone on glass; the thesis tried 1 to 10 J/m2",
    ),
    Mechanism(
        "threshold", "another threshold for each finger",
        tuple(_parameter(f"threshold:{m}", "ln", 0.0, 1.0, -2.5, 2.5) for m in FINGERS),
        "factor e of linear light: 0.0375 to 0.6 were in use, picked by eye",
    ),
    Mechanism(
        "scale", "areas of both fingers read off by one factor", (_parameter("scale:area", "ln", 0.0, 0.1, -1.0, 1.0),),
        "10 %: the square target changes by some per cent; scripts hold three figures",
    ),
    Mechanism("friction_by_read_area", "tau0/p + alpha takes the area that was read, not the true one"),
    Mechanism("exposure_control", "the camera's automatic exposure acts from 9 V on"),
)  # fmt: skip
RIDGES = Mechanism("ridges_as_drawn", "finite elements had ridges of 100 um as drawn, not 48 um as moulded")
"""Touches the ridged finite elements alone: judged by itself, with what else acts on their ratio to smooth ones at the
nominal model's."""
NUISANCES = (
    _parameter("@light", "ln", 0.0, priors.LIGHT, -0.9, 0.9),
    _parameter("@forward_voltage", "V", 2.95, 0.15, 2.6, 3.4),
    _parameter("@pitch", "ln mm", 0.0, 0.1, -0.3, 0.3),
)
"""Always free: light over threshold (both fingers), the LEDs' bin, the pitch of the ridges (1 mm)."""
MECHANISMS = {m.id: m for m in (*LAWS, *SCATTERING, *SWITCHES, RIDGES)}
EXCLUSIVE = (LAWS, SCATTERING)
NULLS = frozenset({"hertz", "clear"})
"""The nominal model's."""


@dataclass(frozen=True)
class MechanismSet:
    """One member of each exclusive family, and any of the switches.

    Attributes
    ----------
    ids : frozenset of str
    """

    ids: frozenset[str]

    @property
    def mechanisms(self) -> tuple[Mechanism, ...]:
        """In the order of the tables."""
        return tuple(m for name, m in MECHANISMS.items() if name in self.ids)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Of its mechanisms."""
        return tuple(p for m in self.mechanisms for p in m.parameters)

    @property
    def log_prior(self) -> float:
        """Logarithm of its prior probability [nats]."""
        return -sum(math.log(len(family)) for family in EXCLUSIVE) - len(SWITCHES) * math.log(2.0)

    @property
    def title(self) -> str:
        """Names of what it adds to the nominal model."""
        return " + ".join(m.id for m in self.mechanisms if m.id not in NULLS) or "nominal"


def all_sets() -> Iterator[MechanismSet]:
    """Yield every set, the nominal model first."""
    for law, scattering in itertools.product(LAWS, SCATTERING):
        for count in range(len(SWITCHES) + 1):
            for chosen in itertools.combinations(SWITCHES, count):
                yield MechanismSet(frozenset({law.id, scattering.id, *(m.id for m in chosen)}))


NOMINAL = MechanismSet(NULLS)
RIDGE_SETS = (NOMINAL, MechanismSet(NULLS | {RIDGES.id}))
