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
        JSON-able; its keys stand in docs/reference/criticism-json.md.
    scene : str
        The nominal scene with the causes at their fitted values, as TOML text.
    pictures : object
        What the HTML report shows.
    """

    result: Mapping[str, Any]
    scene: str
    pictures: Any

    def __repr__(self) -> str:
        return f"Criticism({self.verdict!r}, causes {[cause['id'] for cause in self.causes]})"

    @property
    def verdict(self) -> str:
        """``"none"``, ``"causes"``, ``"causes and unknown"`` or ``"unknown"``."""
        return str(self.result["verdict"])

    @property
    def first_line(self) -> str:
        """What was found, in a sentence for who reads one only."""
        return str(self.result["first_line"])

    @property
    def causes(self) -> list[Mapping[str, Any]]:
        """Causes with fitted values and 90 % intervals, units beside them, and what each does to the area [mm^2, %]."""
        return list(self.result["causes"])

    @property
    def probabilities(self) -> Mapping[str, float]:
        """Probability of each cause to be in the rig."""
        found: Mapping[str, float] = self.result["posterior"]["inclusion"]
        return found

    @property
    def next_measurement(self) -> str | None:
        """What to measure next to tell causes apart; None where nothing is in doubt."""
        found = self.result["next_measurement"]
        return None if found is None or found["what"] is None else str(found["what"])

    @property
    def extended_scene(self) -> str:
        """The scene with the causes switched on, as TOML text."""
        return self.scene


def criticise(
    bundle: Bundle | str | Path,
    *,
    seed: int = 0,
    tick: Callable[[str], None] = lambda step: None,
    workers: int = 1,
) -> Criticism:
    """Find what the nominal model of a rig gets wrong about a lab's measurement.

    Parameters
    ----------
    bundle : Bundle, str or Path
        With frames, or with series of figures alone.
    seed : int
        Of the draws of noise and of the bootstrap.
    tick : callable
        ``tick(step)``, called when a step begins; with frames the whole takes minutes.
    workers : int
        Processes that share the work on frames. More than one import the calling script anew: it has to keep what it
        does under ``if __name__ == "__main__"``.

    Returns
    -------
    Criticism

    Raises
    ------
    InputError
        If the bundle is broken, with the exact location.
    GrossDifference
        If the frames are another rig's (:mod:`evanesce.inference.gate`).

    Examples
    --------
    >>> import evanesce as ev
    >>> found = ev.criticise("bundle")  # doctest: +SKIP
    >>> found.verdict, found.next_measurement  # doctest: +SKIP
    """
    from evanesce.inference.critic import criticise_frames
    from evanesce.inference.series.critic import criticise_series

    if not isinstance(bundle, Bundle):
        bundle = read_bundle(bundle)
    if bundle.has_frames:
        frames = criticise_frames(bundle, seed=seed, tell=tick, workers=workers)
        return Criticism(result=frames.result, scene=frames.scene, pictures=frames.pictures)
    series = criticise_series(bundle, seed=seed, tell=tick)
    return Criticism(result=series.result, scene=series.scene, pictures=series.pictures)
