"""How much of a hidden cause the critic can see, and how much of that lies along the library's own signature.

Every cause of the challenge is given strength 7 by the injector's ruler (development set, first pose). Its change is
measured in the critic's metric, its nuisances taken off, and along the signature of the effect of the same name: what a
score test could gain at most. No noise is drawn but that of one null, about which the critic stands.

    python -m benchmarks.critic_reach
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from tests.challenge.cases import cases
from tests.challenge.chain import rig_of
from tests.challenge.library import NAMED, make_cause
from tests.challenge.make import write_case
from tests.challenge.strength import OutOfReach, amplitude_for, departure, ruler

from evanesce.bundle import read_bundle
from evanesce.criticism.case import prepare
from evanesce.criticism.observe import observe
from evanesce.criticism.signatures import signatures_of

STRENGTH = 7.0


def main() -> None:
    """Print a table."""
    spec = next(
        c for c in sorted(cases("dev"), key=lambda c: c.id) if c.group == "null" and c.noise == "plain" and c.pose == 0
    )
    with tempfile.TemporaryDirectory() as folder:
        path, _ = write_case(spec, Path(folder))
        case = prepare(observe(read_bundle(path)), 0)
    metric = case.base.metric(case.base.parameters)
    signatures = {s.id: s for s in signatures_of(case.problem, case.base, case.candidates)}
    rig, measure = rig_of("dev", 0), ruler("dev", 0)
    print(f"| hidden at strength {STRENGTH:g} | in the critic's metric | along its signature |\n|---|---|---|")
    for name in NAMED:
        cause = make_cause(name, rig, 7, 0)
        try:
            change = departure(rig, measure, [(cause, amplitude_for(rig, measure, cause, STRENGTH))])
        except OutOfReach:
            print(f"| {name} | out of reach | |")
            continue
        row = case.problem.whitened(change)
        seen = np.sqrt(max(float(metric.project(row) @ row), 0.0))
        signature = signatures.get(name)
        along = "places from data"
        if signature is not None and len(signature.rows) and not signature.note:
            rows = metric.project(signature.rows)
            information, gradient = rows @ signature.rows.T, rows @ row
            if signature.joint:
                along = f"{np.sqrt(max(gradient @ np.linalg.pinv(information, rcond=1e-9) @ gradient, 0.0)):.1f}"
            else:
                along = f"{np.max(gradient / np.sqrt(np.maximum(np.diag(information), 1e-300))):.1f}"
        print(f"| {name} | {seen:.1f} | {along} |", flush=True)


if __name__ == "__main__":
    main()
