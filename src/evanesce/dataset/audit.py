"""Audit a dataset: identities between its maps, numbers and frames, leaks between its splits, and its composition.

An identity must hold in every frame; the composition (texture, balance of stick and slip, size of the contact) is what
a detector of slip needs. Frames are read one after another; two of them are in memory.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.core.errors import InputError
from evanesce.dataset import layout
from evanesce.dataset.audit_checks import FRAME_CHECKS, TEXTURED, AuditFrame, contact_share, open_core
from evanesce.dataset.read import Dataset

NAMED = 5
"""Maximum number of frames that a finding names."""


@dataclass(frozen=True)
class Finding:
    """A row of the audit.

    Attributes
    ----------
    name : str
    value : float
        Of an identity the largest error, NaN where no frame has it.
    wanted : str
    good : bool
    identity : bool
        Whether it must hold; otherwise it describes the composition.
    wrong, of : int
        Frames (groups, trials) that miss, of those that were looked at.
    unit : str
        What ``wrong`` and ``of`` count.
    examples : tuple of str
        The first few that miss: keys of frames, or names of groups.
    """

    name: str
    value: float
    wanted: str
    good: bool
    identity: bool
    wrong: int
    of: int
    unit: str = "frames"
    examples: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """``good``, ``wrong`` (an identity fails), ``low`` (the composition is not as wanted) or ``none``."""
        if self.of == 0:
            return "none"
        return "good" if self.good else "wrong" if self.identity else "low"


@dataclass
class _Errors:
    """Running errors of one identity."""

    worst: float = math.nan
    wrong: int = 0
    of: int = 0
    examples: list[str] = field(default_factory=list)

    def add(self, error: float, tolerance: float, key: str) -> None:
        if math.isnan(error):
            return
        self.of += 1
        self.worst = error if math.isnan(self.worst) else max(self.worst, error)
        if error > tolerance:
            self.wrong += 1
            self.examples += [key] if len(self.examples) < NAMED else []


@dataclass
class _Trial:
    """What the composition needs of a trial."""

    kind: str = ""
    force: float = 0.0
    open_core: float = 0.0
    contact_share: float = 0.0
    gross: bool = False


def audit(
    folder: Path, advance: Callable[[int], None] = lambda _: None, *, any_versions: bool = False
) -> list[Finding]:
    """Check a dataset, finished or not.

    Parameters
    ----------
    folder : Path
    advance : callable
        Called with the number of frames checked since the last call.
    any_versions : bool
        Make maps that are not stored again although packages changed.

    Returns
    -------
    list of Finding

    Raises
    ------
    InputError
        If the folder holds no dataset, one of another version, no frames, or a frame cannot be decoded.
    """
    errors = [_Errors() for _ in FRAME_CHECKS]
    groups: dict[tuple[str, int], set[str]] = defaultdict(set)
    trials: dict[int, _Trial] = defaultdict(_Trial)
    phases = dict.fromkeys(("stick", "partial", "gross"), 0)
    with Dataset(folder, any_versions=any_versions) as data:
        if not len(data):
            raise InputError("no frames", file=folder, allowed="a dataset with at least one finished shard")
        first_slip = data.job.config.labels.first_slip_share
        before: AuditFrame | None = None
        for i in range(len(data)):
            frame = _frame(data, i)
            if before is not None and (before.row["trial"], before.row["frame"] + 1) != (
                frame.row["trial"], frame.row["frame"],
            ):  # fmt: skip
                before = None
            for name in ("finger", "rig"):
                groups[name, int(frame.meta[name]["index"])].add(frame.row["split"])
            _count(trials[frame.row["trial"]], phases, frame, first_slip)
            if frame.held:
                for check, found in zip(FRAME_CHECKS, errors, strict=True):
                    found.add(check.error(frame, before), check.tolerance, frame.key)
            before = frame
            advance(1)
    identities = [
        Finding(c.name, e.worst, _at_most(c.tolerance), e.wrong == 0, True, e.wrong, e.of, examples=tuple(e.examples))
        for c, e in zip(FRAME_CHECKS, errors, strict=True)
    ]
    return [*identities, _leakage(groups), *_composition(list(trials.values()), phases)]


def _at_most(tolerance: float) -> str:
    return f"<= {tolerance:g}" if tolerance else "0"


def _frame(data: Dataset, i: int) -> AuditFrame:
    sample = data[i]
    try:
        return AuditFrame(sample)
    except (ValueError, KeyError, TypeError) as error:
        file = data.folder / layout.SHARDS / layout.shard_name(sample.row["shard"])
        raise InputError(f"cannot be decoded: {error}", file=file, key=sample.key) from None


def _count(trial: _Trial, phases: dict[str, int], frame: AuditFrame, first_slip: float) -> None:
    trial.kind = frame.meta["kind"]
    if not frame.held:
        return
    force, ratio = frame.scalars["Fz_N"], frame.scalars["stick_ratio"]
    if force > trial.force:
        trial.force, trial.open_core = force, open_core(frame)
    trial.contact_share = max(trial.contact_share, contact_share(frame.pixel_labels, frame.pixels))
    trial.gross |= ratio == 0.0
    phases["gross" if ratio == 0.0 else "partial" if ratio < 1.0 - first_slip else "stick"] += 1


def _leakage(groups: dict[tuple[str, int], set[str]]) -> Finding:
    shared = [f"{name} {index}" for (name, index), splits in sorted(groups.items()) if len(splits) > 1]
    return Finding(
        "fingers and rigs that are in two splits", float(len(shared)), "0", not shared, True, len(shared), len(groups),
        "groups", tuple(shared[:NAMED]),
    )  # fmt: skip


def _composition(trials: list[_Trial], phases: dict[str, int]) -> list[Finding]:
    textured = sum(trial.open_core >= TEXTURED for trial in trials)
    slides = [trial for trial in trials if trial.kind == "slide"]
    gross = sum(trial.gross for trial in slides)
    frames = sum(phases.values())
    found = [
        _share("trials with texture inside the contact", textured, len(trials), 0.6, "trials"),
        _share("slides that reach gross slip", gross, len(slides), 0.95, "trials"),
    ]
    found += [_share(f"frames in {name}", count, frames, 0.2, "frames") for name, count in phases.items()]
    shares = [trial.contact_share for trial in trials]
    small = sum(share < 0.2 for share in shares)
    median = float(np.median(shares))
    return [
        *found,
        Finding("median share of pixels within the contact", median, ">= 0.2", median >= 0.2, False, small, len(shares),
                "trials"),
    ]  # fmt: skip


def _share(name: str, count: int, of: int, wanted: float, unit: str) -> Finding:
    value = count / of if of else math.nan
    return Finding(name, value, f">= {wanted:g}", value >= wanted, False, of - count, of, unit)


def as_dict(finding: Finding) -> dict[str, Any]:
    """Return JSON-able data; NaN is None."""
    return {
        "name": finding.name,
        "value": None if math.isnan(finding.value) else finding.value,
        "wanted": finding.wanted,
        "verdict": finding.verdict,
        "identity": finding.identity,
        "wrong": finding.wrong,
        "of": finding.of,
        "unit": finding.unit,
        "examples": list(finding.examples),
    }
