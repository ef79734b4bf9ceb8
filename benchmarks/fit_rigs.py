"""``evanesce fit`` on rigs with many departures: ``PYTHONPATH=. python benchmarks/fit_rigs.py --rigs 10``.

Each rig has five to ten causes at once, of forms that are not the library's own, all of which `fit` has a figure for.
Read are the errors of held-out areas, how many figures with a known true value lie in their 90 % interval, and time.
Each rig is a line of ``outputs/challenge/<run>.jsonl``; a run that is started again goes on where it stopped.
"""

from __future__ import annotations

import argparse
import gzip
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from tests.inference.challenge.cases import LOUD, MANY, PLAIN, RIGS, CaseSpec
from tests.inference.challenge.library import NAMED
from tests.inference.challenge.make import write_case

from evanesce.bundle import read_bundle
from evanesce.inference.calibration.answer import result_of
from evanesce.inference.calibration.figures import FIGURES
from evanesce.inference.calibration.fit import fit_rig

GOOD_PERCENT = 0.5
"""Error of a held-out area that is aimed at [%]."""


def fit_cases(name: str, count: int) -> Iterator[CaseSpec]:
    """Yield rigs whose causes `fit` has figures for."""
    rng = np.random.default_rng([51, *name.encode()])
    known = sorted(set(NAMED) & set(FIGURES))
    for number in range(count):
        some = [str(c) for c in rng.choice(known, int(rng.integers(MANY[0], MANY[1] + 1)), replace=False)]
        strengths = np.exp(rng.uniform(np.log(LOUD[0]), np.log(LOUD[1]), len(some)))
        yield CaseSpec(
            set=name, group="rig", causes=tuple(some), strengths=tuple(round(float(s), 1) for s in strengths),
            noise=PLAIN[number % 2], number=1000 + number, rig=RIGS[name][number % len(RIGS[name])],
        )  # fmt: skip


def one_rig(spec: CaseSpec, workers: int = 1) -> dict[str, Any]:
    """Make, fit and delete one rig; predict by so many processes."""
    with tempfile.TemporaryDirectory(prefix="challenge-") as folder:
        path, truth = write_case(spec, Path(folder))
        began = time.monotonic()
        bundle = read_bundle(path)
        answer = result_of(fit_rig(bundle, workers=workers, tell=lambda line: print("   ", line, file=sys.stderr)))
    return {"truth": truth, "answer": answer, "seconds": time.monotonic() - began}


def read(line: dict[str, Any]) -> dict[str, Any]:
    """Return errors of held-out areas [%], and of each figure with a known true value whether its interval holds it."""
    truth, answer = line["truth"], line["answer"]
    areas = [r for r in answer["areas"] if r["held_out"] and r["measured_mm2"] > 0]
    planted = {
        f"effects.{cause}.{known[0]}": float(known[1])
        for cause, known in zip(truth["causes"], truth["parameters"], strict=True)
        if known is not None
    }
    told = {r["key"]: r for r in answer["figures"] if r["told"]}
    absent = {key: r for key, r in told.items() if key.split(".")[1] not in truth["causes"]}
    return {
        "before": [100.0 * abs(r["nominal_mm2"] / r["measured_mm2"] - 1.0) for r in areas],
        "after": [100.0 * abs(r["calibrated_mm2"] / r["measured_mm2"] - 1.0) for r in areas],
        "planted": {k: (v, told[k]["lo"], told[k]["hi"]) for k, v in planted.items() if k in told},
        "absent": {k: (r["nominal"], r["lo"], r["hi"]) for k, r in absent.items()},
        "good": answer["good"],
    }


def inside(rows: dict[str, tuple[float, float, float]]) -> list[bool]:
    """Return which true values lie in their intervals."""
    return [low <= value <= high for value, low, high in rows.values()]


def main() -> None:
    """Run and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--set", choices=("dev", "scored"), default="dev")
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--run", default="fit")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--read", type=Path, help="Only print the table of this run, *.jsonl.gz.")
    options = parser.parse_args()
    if options.read is not None:
        with gzip.open(options.read, "rt", encoding="utf-8") as file:
            print(table([json.loads(text) for text in file]))
        return
    path = Path("outputs/challenge") / f"{options.run}.jsonl"
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.loads(text) for text in path.read_text().splitlines()] if path.exists() else []
    done = {line["id"] for line in lines}
    for spec in fit_cases(options.set, options.rigs):
        if spec.id not in done:
            print(spec.causes, spec.noise, spec.nominal, file=sys.stderr)
            lines.append({"id": spec.id, **one_rig(spec, options.workers)})
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(lines[-1]) + "\n")
    print(table(lines))


def table(lines: list[dict[str, Any]]) -> str:
    """Return the table of all rigs, and the sums below it."""
    rows = ["| causes | area error, nominal, % | calibrated, % | planted inside | others inside | good | s |"]
    rows.append("|---|---|---|---|---|---|---|")
    found = [read(line) for line in lines]
    for line, one in zip(lines, found, strict=True):
        held, others = inside(one["planted"]), inside(one["absent"])
        rows.append(
            f"| {', '.join(line['truth']['causes'])} | {np.mean(one['before']):.2f} | {np.mean(one['after']):.2f} |"
            f" {sum(held)} of {len(held)} | {sum(others)} of {len(others)} | {'yes' if one['good'] else 'no'} |"
            f" {line['seconds']:.0f} |"
        )
    after = np.concatenate([one["after"] for one in found])
    planted, absent = ([ok for one in found for ok in inside(one[key])] for key in ("planted", "absent"))
    every = planted + absent
    rows.append(
        f"\n{np.sum(after <= GOOD_PERCENT)} of {after.size} held-out areas within {GOOD_PERCENT} %,"
        f" {np.sum(after > 1.0)} over 1 %, the worst {after.max():.2f}; intervals hold {sum(every)} of {len(every)}"
        f" figures, {sum(planted)} of {len(planted)} planted ones among them"
    )
    return "\n".join(rows)


if __name__ == "__main__":
    main()
