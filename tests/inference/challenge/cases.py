"""Which cases there are: development and scored ones."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from .library import NAMED, NOT_IN_LIBRARY
from .rig import POSES

STRENGTHS = (5.0, 7.0, 10.0, 20.0, 40.0)
PLAIN = ("plain", "lowpass")
COMPRESSED = ("h264", "h264-strong", "jpeg")
NULLS = {"dev": 5, "scored": 20}
"""Of each noise class."""

RIGS = {"dev": ("dev", "thin"), "scored": ("soft", "thick", "wide")}
"""Nominal rigs of the group with many causes."""
COUNT = {"dev": 12, "scored": 60}
"""Of its cases."""
MANY, LOUD = (5, 10), (30.0, 300.0)
"""Number of causes in each, and range of their strengths, even in the logarithm."""

# Cause, its decoy, and the shot that tells them apart.
DECOYS = (
    ("black_level", "ambient_light", "lens_cap"),
    ("ambient_light", "black_level", "lens_cap"),
    ("defocus", "lateral_glow", "checkerboard"),
    ("lateral_glow", "defocus", "checkerboard"),
    ("square_size", "card_offset", "checkerboard"),
    ("card_offset", "square_size", "checkerboard"),
    ("vignetting", "led_imbalance", "square"),
    ("led_imbalance", "vignetting", "square"),
)
# The shots that would separate a decoy together with the one named: without them all, the two are one.
SEPARATES = {
    "lens_cap": ("lens_cap", "checkerboard", "square"),
    "checkerboard": ("checkerboard", "square"),
    "square": ("square", "checkerboard"),
}

DOUBLES = (
    ("vignetting", "black_level"), ("defocus", "supply_sag"), ("ambient_light", "led_imbalance"),
    ("hot_pixels", "force_offset"), ("scratch", "led_warmup"), ("off_axis_load", "tone_curve"),
    ("residue_film", "plate_tilt"), ("square_size", "creep"), ("specks", "distortion_drift"),
    ("rolling_shutter", "adhesion"), ("defocus", "lateral_glow"),
)  # fmt: skip
CANCELLING = (
    ("led_dead", "led_imbalance"), ("adhesion", "modulus"), ("card_offset", "distortion_drift"),
    ("glass_absorption", "tone_curve"), ("ambient_light", "black_level"), ("bone_stiffening", "force_offset"),
)  # fmt: skip
"""Pairs whose second, of free sign or side, is drawn until it takes from the first."""

REMOVED = ("vignetting", "black_level", "hot_pixels", "rolling_shutter", "residue_film", "off_axis_load")


@dataclass(frozen=True, kw_only=True)
class CaseSpec:
    """One case.

    Attributes
    ----------
    set : str
        ``dev`` or ``scored``.
    group : str
        ``single``, ``null``, ``decoy``, ``double``, ``unknown``, ``removed``, ``rig``.
    causes : tuple of str
    strengths : tuple of float
        One to each cause.
    noise : str
    number : int
        Within its group; all randomness comes from the case's own words.
    rig : str
        Nominal rig; that of the set's name where it is empty.
    drop : tuple of str
        Shots that the bundle lacks.
    exclude : tuple of str
        Members that are taken out of the critic's library.
    decoy : str
        What a decoy case is to be mistaken for.
    cancelling : bool
    """

    set: str
    group: str
    causes: tuple[str, ...] = ()
    strengths: tuple[float, ...] = ()
    noise: str = "plain"
    number: int = 0
    rig: str = ""
    drop: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    decoy: str = ""
    cancelling: bool = False

    @property
    def id(self) -> str:
        """Name in results; no bundle bears it."""
        return hashlib.sha256(repr(self).encode()).hexdigest()[:16]

    @property
    def seed(self) -> int:
        """Seed of shapes, nuisances and noise."""
        return int.from_bytes(hashlib.sha256(f"{self!r} {2026}".encode()).digest()[:6], "big")

    @property
    def pose(self) -> int:
        return self.seed % POSES

    @property
    def nominal(self) -> str:
        """Name of the nominal rig."""
        return self.rig or self.set

    @property
    def form(self) -> int:
        """Of the families: development and scored cases have different ones."""
        return 0 if self.set == "dev" else 1

    def recipe(self, number: int) -> bool:
        """Tell whether a cause has its form from the recipes and not from the families: one in two, at random."""
        return bool((self.seed >> (20 + number)) & 1)

    def as_dict(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.__dataclass_fields__} | {"id": self.id}


def cases(name: str) -> list[CaseSpec]:
    """Return all cases of a set, ``dev`` or ``scored``, in an order by which every beginning is a fair sample."""
    repeats = 1 if name == "dev" else 2
    found: list[CaseSpec] = []
    found += _singles(name)
    found += _nulls(name)
    found += _decoys(name, repeats)
    found += _doubles(name)
    found += _unknowns(name, repeats)
    found += _rigs(name)
    return sorted(found, key=lambda spec: spec.id)


def _singles(name: str) -> Iterator[CaseSpec]:
    for cause in NAMED:
        for k, strength in enumerate(STRENGTHS):
            # One in three is compressed, in turn.
            kinds = COMPRESSED if (k + len(cause)) % 3 == 0 else PLAIN
            noise = kinds[(k + ord(cause[-1])) % len(kinds)]
            yield CaseSpec(set=name, group="single", causes=(cause,), strengths=(strength,), noise=noise)


def _nulls(name: str) -> Iterator[CaseSpec]:
    for noise in (*PLAIN, *COMPRESSED):
        for number in range(NULLS[name]):
            yield CaseSpec(set=name, group="null", noise=noise, number=number)


def _decoys(name: str, repeats: int) -> Iterator[CaseSpec]:
    for number in range(repeats):
        for k, (cause, decoy, shot) in enumerate(DECOYS):
            for drop in ((), SEPARATES[shot]):
                yield CaseSpec(
                    set=name, group="decoy", causes=(cause,), strengths=((7.0, 10.0)[(k + number) % 2],), decoy=decoy,
                    noise=PLAIN[number % 2], number=number, drop=tuple(d for d in drop if d != cause_shot(cause)),
                )  # fmt: skip


def cause_shot(cause: str) -> str:
    """Return the shot without which a cause leaves no trace at all; it is never dropped."""
    return {"square_size": "square", "card_offset": "square"}.get(cause, "")


def _doubles(name: str) -> Iterator[CaseSpec]:
    for pairs, cancelling in ((DOUBLES, False), (CANCELLING, True)):
        for k, pair in enumerate(pairs):
            strengths = ((10.0, 10.0), (10.0, 20.0), (20.0, 12.0))[k % 3]
            yield CaseSpec(
                set=name, group="double", causes=pair, strengths=strengths, noise=PLAIN[k % 2], cancelling=cancelling
            )


def _unknowns(name: str, repeats: int) -> Iterator[CaseSpec]:
    for number in range(repeats):
        for cause in NOT_IN_LIBRARY:
            yield CaseSpec(
                set=name, group="unknown", causes=(cause,), strengths=(15.0,), noise=PLAIN[number % 2], number=number
            )
    for k, cause in enumerate(REMOVED):
        yield CaseSpec(
            set=name, group="removed", causes=(cause,), strengths=(15.0,), noise=PLAIN[k % 2], exclude=(cause,)
        )


def _rigs(name: str) -> Iterator[CaseSpec]:
    """Yield cases of many causes; every second has an unknown among them, the last of its causes."""
    rng = np.random.default_rng([31, *name.encode()])
    for number in range(COUNT[name]):
        count = int(rng.integers(MANY[0], MANY[1] + 1))
        some = [str(c) for c in rng.choice(sorted(NAMED), count, replace=False)]
        if number % 2:
            some[-1] = str(rng.choice(sorted(NOT_IN_LIBRARY)))
        strengths = np.exp(rng.uniform(*np.log(LOUD), count))
        yield CaseSpec(
            set=name, group="rig", causes=tuple(some), strengths=tuple(round(float(s), 1) for s in strengths),
            noise=PLAIN[(number // 4) % 2], number=number, rig=RIGS[name][(number // 2) % len(RIGS[name])],
        )  # fmt: skip
