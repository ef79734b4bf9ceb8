"""How much of a hidden cause the critic can see, and how much of that lies along the library's own signature.

Every cause of the challenge is given strength 7 by the injector's ruler (development set, first pose), those outside
the library 15. Its change is measured in the critic's metric, its nuisances taken off, and along the signature of the
effect of the same name, or of the one that takes most of it: what a score test could gain at most. No noise is drawn
but that of one null, about which the critic stands.

    python -m benchmarks.criticism.critic_reach
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tests.criticism.challenge.cases import cases
from tests.criticism.challenge.chain import rig_of
from tests.criticism.challenge.library import NAMED, NOT_IN_LIBRARY, make_cause
from tests.criticism.challenge.make import write_case
from tests.criticism.challenge.strength import OutOfReach, amplitude_for, departure, ruler

from evanesce.bundle import read_bundle
from evanesce.criticism.case import prepare
from evanesce.criticism.signatures import Signature, signatures_of
from evanesce.prediction.linear import Metric
from evanesce.prediction.observe import observe

STRENGTH, OUTSIDE = 7.0, 15.0


def along(metric: Metric, signature: Signature, row: NDArray[np.float64]) -> float:
    """Return how much of a whitened change lies along a signature, nuisances taken off [standard deviations]."""
    rows = metric.project(signature.rows)
    information, gradient = rows @ signature.rows.T, rows @ row
    if signature.joint:
        return float(np.sqrt(max(gradient @ np.linalg.pinv(information, rcond=1e-9) @ gradient, 0.0)))
    return float(np.max(gradient / np.sqrt(np.maximum(np.diag(information), 1e-300))))


def main() -> None:
    """Print two tables."""
    spec = next(
        c for c in sorted(cases("dev"), key=lambda c: c.id) if c.group == "null" and c.noise == "plain" and c.pose == 0
    )
    with tempfile.TemporaryDirectory() as folder:
        path, _ = write_case(spec, Path(folder))
        case = prepare(observe(read_bundle(path)), 0)
    metric = case.base.metric(case.base.parameters)
    signatures = {
        s.id: s
        for s in signatures_of(case.problem, case.base, case.candidates)
        if len(s.rows) and not s.note and not s.candidate.penalty  # places that a null's noise chose say nothing
    }
    rig, measure = rig_of("dev", 0), ruler("dev", 0)
    for names, strength in ((NAMED, STRENGTH), (NOT_IN_LIBRARY, OUTSIDE)):
        print(f"| hidden at strength {strength:g} | in the critic's metric | along its signature | along another's |")
        print("|---|---|---|---|")
        for name in names:
            cause = make_cause(name, rig, 7, 0)
            try:
                change = departure(rig, measure, [(cause, amplitude_for(rig, measure, cause, strength))])
            except OutOfReach:
                print(f"| {name} | out of reach | | |")
                continue
            row = case.problem.whitened(change)
            seen = np.sqrt(max(float(metric.project(row) @ row), 0.0))
            told = {other: along(metric, signature, row) for other, signature in signatures.items()}
            own = f"{told.pop(name):.1f}" if name in told else "places from data" if names is NAMED else ""
            other, most = max(told.items(), key=lambda item: item[1])
            print(f"| {name} | {seen:.1f} | {own} | {other} {most:.1f} |", flush=True)
        print()


if __name__ == "__main__":
    main()
