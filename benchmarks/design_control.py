"""What of the demo's gain comes from the threshold alone, and from threshold and voltage: nothing else is changed.

The thesis's rig is asked the same question as by `make design-demo`: thresholds and voltages on a grid by the search's
own draws; then the best of each kind, and the best unsaturated design of the search, on the rigs drawn anew that the
demo's base and winners were measured on, and by the reference.

    python benchmarks/design_control.py --demo outputs/design-demo/result.json --json outputs/design_control.json
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from evanesce.design.evaluate import evaluate
from evanesce.design.question_file import read_question
from evanesce.design.verify import verified
from evanesce.design.winner import assessed

THRESHOLDS = (0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.65)
VOLTAGES = (9.0, 9.5, 10.0, 10.5)
UNSATURATED = 1e-4
"""Largest share of the contact at full scale that counts as none: hot pixels and specks have some."""


def unsaturated_trial(path: Path) -> tuple[str, dict[str, float]]:
    """Return name and values of the demo's design with the smallest error of those without saturation."""
    if not path.is_file():
        raise SystemExit(f"{path}: no such file; run `make design-demo` first, or name it with --demo")
    trials = json.loads(path.read_text(encoding="utf-8"))["trials"]
    able = [t for t in trials if t["feasible"] and t["figures"]["saturation"] <= UNSATURATED]
    found = min(able, key=lambda t: t["figures"]["area_error"])
    return f"all six, unsaturated (trial {found['number']})", found["values"]


def demo_job() -> dict[str, Any]:
    """Return the question of `make design-demo`."""
    plan, _ = read_question("same_cost")
    return plan.job


def grid(job: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return error and saturation of the given rig at each voltage and threshold, by the search's own draws."""
    rows = []
    for voltage in VOLTAGES:
        for threshold in THRESHOLDS:
            values = {"leds.voltage_V": voltage, "measurement.threshold": threshold}
            found = evaluate(job, values)
            figures = found["figures"]
            rows.append(
                {
                    "values": values, "error_percent": figures["area_error"],
                    "standard_percent": found["standard_percent"], "saturation": figures["saturation"],
                }
            )  # fmt: skip
            print(f"{voltage:5.1f} V  {threshold:.2f}  {figures['area_error']:7.2f} ± {found['standard_percent']:.2f} %"
                  f"  saturated {figures['saturation']:.4f}", flush=True)  # fmt: skip
    return rows


def named(
    rows: list[dict[str, Any]], base_voltage: float, unsaturated: tuple[str, dict[str, float]]
) -> dict[str, dict[str, float]]:
    """Return the designs that are assessed."""
    name, values = unsaturated

    def best(able: list[dict[str, Any]]) -> dict[str, float]:
        return dict(min(able, key=lambda row: row["error_percent"])["values"])

    return {
        "as given": {},
        "threshold alone": best([r for r in rows if r["values"]["leds.voltage_V"] == base_voltage]),
        "threshold and voltage": best(rows),
        "threshold and voltage, unsaturated": best([r for r in rows if r["saturation"] <= UNSATURATED]),
        name: values,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=24)
    parser.add_argument("--renderings", type=int, default=2)
    parser.add_argument("--samples", type=int, default=8)
    parser.add_argument("--demo", type=Path, default=Path("outputs/design-demo/result.json"))
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    unsaturated = unsaturated_trial(arguments.demo)
    job, began, load = demo_job(), time.process_time(), os.getloadavg()
    rows = grid(job)
    designs = {}
    for name, values in named(rows, job["scene"]["leds"]["voltage_V"], unsaturated).items():
        known = next((d for d in designs.values() if d["values"] == values), None)
        if known is not None:
            designs[name] = known
            continue
        own = assessed(job, values, arguments.rigs)
        check = None
        if arguments.renderings:
            options = {"count": arguments.renderings, "samples": arguments.samples}
            check = verified(job, values, case=1, seed=1 + 1000, **options)
        designs[name] = {"values": values, "assessed": own, "verified": check}
        print(f"{name}: {own['error_percent']:.1f} ± {own['standard_percent']:.1f} % on rigs drawn anew, saturated "
              f"{own['saturated_share']:.4f}, blur {own['figures']['motion_blur']:.3f} mm", flush=True)  # fmt: skip
        if check is not None:
            error = f"{check['reference_mean_percent']:+.3f} ± {check['reference_standard_percent']:.3f} %"
            print(f"    at 3 N as drawn: reference {error}, fast {check['fast_percent']:+.3f} %", flush=True)
    print(f"{time.process_time() - began:.0f} s of processor time, load {load} to {os.getloadavg()}")
    if arguments.json is not None:
        result = {"grid": rows, "designs": designs, "processor_s": time.process_time() - began}
        arguments.json.write_text(json.dumps(result, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
