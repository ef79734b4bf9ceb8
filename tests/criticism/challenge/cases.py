"""Which cases there are: development and scored ones, and the slice that runs with every change."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from .library import NAMED, NOT_IN_LIBRARY
from .rig import POSES

STRENGTHS = (4.0, 5.0, 7.0, 10.0, 20.0, 40.0)
PLAIN = ("plain", "lowpass")
COMPRESSED = {"dev": ("h264", "jpeg"), "scored": ("h264", "h264-strong", "jpeg")}
FORM = {"dev": 0, "scored": 1}

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
        ``single``, ``null``, ``decoy``, ``double``, ``unknown``, ``removed``.
    causes : tuple of str
    strengths : tuple of float
        One to each cause.
    noise : str
    number : int
        Within its group; all randomness comes from set, group and number.
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

    def as_dict(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.__dataclass_fields__} | {"id": self.id}


def cases(name: str) -> list[CaseSpec]:
    """Return all cases of a set, ``dev`` or ``scored``."""
    repeats = 1 if name == "dev" else 2
    found: list[CaseSpec] = []
    found += _singles(name, repeats)
    found += _nulls(name, 60 if name == "dev" else 200)
    found += _decoys(name, repeats)
    found += _doubles(name, 1 if name == "dev" else 2)
    found += _unknowns(name, 2 if name == "dev" else 5)
    return found


def _singles(name: str, repeats: int) -> Iterator[CaseSpec]:
    for number in range(repeats):
        for cause in NAMED:
            for k, strength in enumerate(STRENGTHS):
                # One in three is compressed, in turn.
                kinds = COMPRESSED[name] if (k + number + len(cause)) % 3 == 0 else PLAIN
                noise = kinds[(k + number) % len(kinds)]
                yield CaseSpec(
                    set=name, group="single", causes=(cause,), strengths=(strength,), noise=noise, number=number
                )


def _nulls(name: str, count: int) -> Iterator[CaseSpec]:
    for number in range(count):
        kinds = COMPRESSED[name] if number % 2 else PLAIN
        yield CaseSpec(set=name, group="null", noise=kinds[(number // 2) % len(kinds)], number=number)


def _decoys(name: str, repeats: int) -> Iterator[CaseSpec]:
    for number in range(repeats):
        for cause, decoy, shot in DECOYS:
            for strength in (7.0, 10.0):
                for drop in ((), SEPARATES[shot]):
                    yield CaseSpec(
                        set=name, group="decoy", causes=(cause,), strengths=(strength,), decoy=decoy,
                        noise=PLAIN[number % 2], number=number, drop=tuple(d for d in drop if d != cause_shot(cause)),
                    )  # fmt: skip


def cause_shot(cause: str) -> str:
    """Return the shot without which a cause leaves no trace at all; it is never dropped."""
    return {"square_size": "square", "card_offset": "square"}.get(cause, "")


def _doubles(name: str, repeats: int) -> Iterator[CaseSpec]:
    for number in range(repeats):
        for pairs, cancelling in ((DOUBLES, False), (CANCELLING, True)):
            for k, pair in enumerate(pairs):
                strengths = ((10.0, 10.0), (10.0, 20.0), (20.0, 12.0))[(k + number) % 3]
                yield CaseSpec(
                    set=name, group="double", causes=pair, strengths=strengths, noise=PLAIN[(k + number) % 2],
                    number=number, cancelling=cancelling,
                )  # fmt: skip


def _unknowns(name: str, repeats: int) -> Iterator[CaseSpec]:
    for number in range(repeats):
        for cause in NOT_IN_LIBRARY:
            yield CaseSpec(
                set=name, group="unknown", causes=(cause,), strengths=(15.0,), noise=PLAIN[number % 2], number=number
            )
        for cause in REMOVED:
            yield CaseSpec(
                set=name, group="removed", causes=(cause,), strengths=(15.0,), noise=PLAIN[number % 2], number=number,
                exclude=(cause,),
            )  # fmt: skip


def slice_of(name: str = "dev", count: int = 14) -> list[CaseSpec]:
    """Return a few cases of every group: quick enough for every change."""
    every = cases(name)

    def pick(group: str, wanted: int, **only: Any) -> list[CaseSpec]:
        members = [c for c in every if c.group == group and all(getattr(c, k) == v for k, v in only.items())]
        members.sort(key=lambda c: c.id)
        return members[:wanted]

    clear = [c for c in pick("single", 10_000) if c.strengths[0] >= 20 and c.noise in PLAIN]
    chosen = clear[: max(4, count - 10)]
    chosen += pick("null", 2, noise="plain") + pick("null", 2, noise="h264")
    chosen += [c for c in pick("decoy", 100) if c.drop][:1] + [c for c in pick("decoy", 100) if not c.drop][:1]
    return chosen + pick("double", 1, cancelling=False) + pick("unknown", 2) + pick("removed", 2)
