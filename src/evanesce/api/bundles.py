"""Read a lab's measurement bundle, and find where the simulation departs from it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evanesce.bundle import Bundle, read_bundle


@dataclass(frozen=True, kw_only=True, repr=False)
class Criticism:
    """What a measurement says about the nominal model of its rig.

    Attributes
    ----------
    result : mapping
        JSON-able; its keys stand in docs/criticism/index.md.
    evidence : object
        What the HTML report shows: residuals, tests, ranking of the candidates.
    """

    result: Mapping[str, Any]
    evidence: Any

    def __repr__(self) -> str:
        return f"Criticism({self.verdict!r}, effects {[effect['id'] for effect in self.effects]})"

    @property
    def verdict(self) -> str:
        """``"none"``, ``"named"``, ``"ambiguous"`` or ``"unknown"``."""
        return str(self.result["verdict"])

    @property
    def effects(self) -> list[Mapping[str, Any]]:
        """Effects that are named, with fitted values and 90 % intervals, units beside them."""
        return list(self.result["causes" if "causes" in self.result else "effects"])

    @property
    def probabilities(self) -> Mapping[str, float]:
        """Probability of each candidate."""
        joint = "posterior" in self.result
        found: Mapping[str, float] = self.result["posterior"]["inclusion"] if joint else self.result["probabilities"]
        return found

    @property
    def next_measurement(self) -> str | None:
        """What to measure next to separate the candidates; None where one remains."""
        found = self.result["next_measurement"]
        return None if found is None else str(found["what"])

    @property
    def extended_scene(self) -> str:
        """The scene with the named effects switched on, as TOML text."""
        return str(self.evidence.scene if "posterior" in self.result else self.evidence.scene_after)


def criticise(
    bundle: Bundle | str | Path, *, seed: int = 0, tick: Callable[[str], None] = lambda step: None
) -> Criticism:
    """Find what the nominal model of a rig gets wrong about a lab's measurement.

    Parameters
    ----------
    bundle : Bundle, str or Path
        With frames, or with series of figures alone.
    seed : int
        Of the draws of noise.
    tick : callable
        ``tick(step)``, called when a step begins; with frames the whole takes minutes.

    Returns
    -------
    Criticism

    Raises
    ------
    InputError
        If the bundle is broken, with the exact location.

    Examples
    --------
    >>> import evanesce as ev
    >>> found = ev.criticise("bundle")  # doctest: +SKIP
    >>> found.verdict, found.next_measurement  # doctest: +SKIP
    """
    from evanesce.criticism.critic import criticise as by_frames
    from evanesce.inference.series.critic import criticise_series

    if not isinstance(bundle, Bundle):
        bundle = read_bundle(bundle)
    if not bundle.has_frames:
        found = criticise_series(bundle, tell=tick)
        return Criticism(result=found.result, evidence=found)
    result, evidence = by_frames(bundle, seed=seed, tick=tick)
    return Criticism(result=result, evidence=evidence)
