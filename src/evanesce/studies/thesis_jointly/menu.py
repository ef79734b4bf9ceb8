"""Measurements that a lab could make next, and by how much each is expected to lessen the doubt among the sets left.

The doubt is the entropy of the sets' probabilities. What a measurement would show under each set is Gaussian, with mean
and covariance of the set's posterior draws and the noise of the measurement; readings are drawn, judged, and the
entropy that is left is averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.rng import generator
from evanesce.inference.next_shot import DRAWN, entropy
from evanesce.studies.thesis_jointly import tables
from evanesce.studies.thesis_jointly.data import Conditions, Outcome, Row
from evanesce.studies.thesis_jointly.judge import Judged, Verdict
from evanesce.studies.thesis_jointly.mechanisms import MechanismSet
from evanesce.studies.thesis_jointly.predict import RADIUS_MM, Fingers

Array = NDArray[Any]

DISC_MM2 = 60.0
AT_035 = -1.48
"""Logarithm of linear light at threshold 0.15 over that at 0.35, by the tone curve of BT.709."""
LEAST_SHARE = 0.01
"""Probability below which a set is no rival."""


@dataclass(frozen=True)
class Measurement:
    """One entry of the menu.

    Attributes
    ----------
    what : str
    minutes : float
        What it costs a lab.
    sd : float
        Standard deviation of a reading, as :attr:`shown` counts.
    shown : callable
        ``shown(fingers) -> readings (points, k)``.
    """

    what: str
    minutes: float
    sd: float
    shown: Callable[[Fingers], Array]


def _row(name: str, kind: str, force: float) -> Row:
    at = Conditions.model_validate({"force_N": force})
    one = Outcome.model_validate(
        {"id": kind, "kind": kind, "unit": "1", "value": 1.0, "sd": 1.0, "at": at, "source": "-", "uncertainty": "-"}
    )
    return Row(name, one)


def _of(what: str, *states: tuple[str, float]) -> Callable[[Fingers], Array]:
    """Return true (``area``) or read (``read``) areas of fingers at forces."""
    rows = [_row(name, "read_area", force) for name, force in states]

    def shown(fingers: Fingers) -> Array:
        own = fingers.with_rows(rows)
        return np.stack([own.at(what, row) for row in rows], axis=-1)

    return shown


def _at_035(fingers: Fingers) -> Array:
    """Return what another threshold makes of both fingers' areas at 1 and 5 N, over those at 0.15."""
    found = []
    for name in ("silskin_0", "silskin_20"):
        rows = [_row(name, "read_area", force) for force in (1.0, 5.0)]
        own = fingers.with_rows(rows)
        area = own.at_all("area", name)
        found.append(own.read(name, area, AT_035) - own.read(name, area))
    return np.concatenate(found, axis=-1)


def _disc(name: str) -> Callable[[Fingers], Array]:
    """Return the read over the true area of a disc of known size glued to the plate."""

    def shown(fingers: Fingers) -> Array:
        share, length = fingers.scattering(name)
        log_area = fingers.zero + np.log(DISC_MM2)
        scale = fingers.get("scale:area") if "scale" in fingers.on else fingers.zero
        return (tables.log_read_over_true(log_area, share, length, fingers.level(name)) + scale)[:, None]

    return shown


def _growth(fingers: Fingers) -> Array:
    rows = [_row(name, "growth", 1.0) for name in ("silskin_0", "silskin_20")]
    fixed = MechanismSet(fingers.on - {"exposure_control"})
    own = Fingers(fingers.points, fixed, rows)
    return np.stack([own.row(row) for row in rows], axis=-1)


def _pull_off(fingers: Fingers) -> Array:
    """Return the force [mN] that parts JKR's contact, both fingers."""
    on = "adhesion" in fingers.on
    work = [np.exp(fingers.get(f"adhesion:{m}")) if on else fingers.zero for m in ("silskin_0", "silskin_20")]
    return 1.5 * np.pi * RADIUS_MM * np.stack(work, axis=-1)


def _pixels(fingers: Fingers) -> Array:
    return (fingers.get("scale:area") if "scale" in fingers.on else fingers.zero)[:, None]


MENU: Sequence[Measurement] = (
    Measurement("15 mm square counted again with the chapter 5 settings, 1 %", 10, 0.01, _pixels),
    Measurement("voltage 9 to 12 V at fixed exposure, both fingers at 1 N, 3 %", 10, 0.03, _growth),
    Measurement("both fingers at thresholds 0.15 and 0.35, 1 and 5 N, 3 %", 10, 0.03, _at_035),
    Measurement("pull-off force of both fingers, 1 mN", 20, 1.0, _pull_off),
    Measurement("glued disc of Silskin 20 %, 60 mm2, read by the waveguide, 3 %", 30, 0.03, _disc("silskin_20")),
    Measurement("glued disc of Silskin 0 %, 60 mm2, read by the waveguide, 3 %", 30, 0.03, _disc("silskin_0")),
    Measurement("ink print of Silskin 20 % at 1 and 5 N, 3 %", 30, 0.03,
                _of("area", ("silskin_20", 1.0), ("silskin_20", 5.0))),
    Measurement("waveguide areas of Silskin 0 % at 1 and 5 N, printed with their sign, 3 %", 10, 0.03,
                _of("read", ("silskin_0", 1.0), ("silskin_0", 5.0))),
)  # fmt: skip


def ranked(verdict: Verdict, menu: Sequence[Measurement] = MENU, seed: int = 0) -> list[dict[str, Any]]:
    """Return the menu by the information that each measurement is expected to bring, most first.

    Parameters
    ----------
    verdict : Verdict
    menu : sequence of Measurement
    seed : int

    Returns
    -------
    list of dict
        ``what``, ``minutes``, ``information_nats`` and ``doubt_nats``, the entropy before; ``about`` tells for each
        question (a mechanism) the expected information about it alone.
    """
    likely = [(s, p) for s, p in zip(verdict.sets, verdict.probability, strict=True) if p > LEAST_SHARE]
    sets, prior = [s for s, _ in likely], np.array([p for _, p in likely])
    prior = prior / prior.sum()
    found = []
    for one in menu:
        posterior = _posteriors(sets, prior, one, generator(seed, "next", one.what))
        about = {
            name: _information(prior, posterior, np.array([name in s.chosen.ids for s in sets]))
            for name in dict.fromkeys(i for s in sets for i in sorted(s.chosen.ids))
        }
        whole = entropy(prior) - float(np.mean([entropy(p) for p in posterior]))
        found.append(
            {
                "what": one.what, "minutes": one.minutes, "information_nats": max(whole, 0.0),
                "doubt_nats": entropy(prior), "about": {k: v for k, v in about.items() if v > 0.02},
            }
        )  # fmt: skip
    return sorted(found, key=lambda row: -float(row["information_nats"]))


def _posteriors(sets: Sequence[Judged], prior: Array, one: Measurement, rng: np.random.Generator) -> Array:
    """Return the probabilities (readings, sets) after readings drawn from the sets."""
    shown = [one.shown(Fingers(s.points, s.chosen)) for s in sets]
    spreads = [np.cov(x.T).reshape(x.shape[1], -1) + one.sd**2 * np.eye(x.shape[1]) for x in shown]
    means, factors = [x.mean(axis=0) for x in shown], [np.linalg.cholesky(s) for s in spreads]
    found = []
    for number in range(DRAWN):
        truth = min(int(np.searchsorted(np.cumsum(prior), (number + 0.5) / DRAWN)), len(sets) - 1)
        reading = shown[truth][rng.integers(len(shown[truth]))] + one.sd * rng.standard_normal(len(means[truth]))
        log = np.log(prior)
        for k, (mean, factor) in enumerate(zip(means, factors, strict=True)):
            off = np.linalg.solve(factor, reading - mean)
            log[k] += -0.5 * off @ off - np.log(np.diag(factor)).sum()
        probability = np.exp(log - log.max())
        found.append(probability / probability.sum())
    return np.array(found)


def _information(prior: Array, posterior: Array, member: Array) -> float:
    """Return the expected information about whether a mechanism is there [nats]."""

    def doubt(probability: Array) -> float:
        return entropy(np.array([probability[member].sum(), probability[~member].sum()]))

    return max(doubt(prior) - float(np.mean([doubt(p) for p in posterior])), 0.0)


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the advice in a sentence."""
    best = rows[0]
    share = 100.0 * best["information_nats"] / best["doubt_nats"] if best["doubt_nats"] else 0.0
    return f"{best['what']}: {best['information_nats']:.2f} of {best['doubt_nats']:.2f} nats of doubt ({share:.0f} %)"
