"""Write what the thesis published of each finger as ``outcomes.toml`` of its bundle, with source and uncertainty.

Run: python docs/validation/thesis_bundles.py [BUNDLES]

Published figures come from ``bundles/thesis_facts.toml`` and ``src/evanesce/materials/silicones.toml``. No scatter is
printed with any of them: each standard deviation says whether it is stated, read off or assumed.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from evanesce.materials.tables import Material, material
from evanesce.studies.thesis.figures import published_depth

BUNDLES = Path(__file__).resolve().parents[2] / "bundles"
AREAS_N = (0.5, 1.5, 2.5, 5.0)  # two in each power law: a law of two constants holds two independent areas
DEPTHS_N = (1.0, 5.0)  # a line E*(F) holds two
PRESS_N = 5.0
TITLES = {"silskin_0": "Silskin 0 %", "silskin_20": "Silskin 20 %"}


def outcome(name: str, kind: str, unit: str, value: Any, sd: float, source: str, uncertainty: str, **at: Any) -> dict:
    """Return one outcome; ``value`` is a list where the text leaves two readings."""
    several = isinstance(value, list)
    figures = {"either": [float(f"{v:.5g}") for v in value]} if several else {"value": float(f"{value:.5g}")}
    return {"id": name, "kind": kind, "unit": unit, **figures, "sd": float(f"{sd:.3g}"), "at": at, "source": source,
            "uncertainty": uncertainty}  # fmt: skip


def contact(name: str, silicone: Material, facts: dict[str, Any]) -> list[dict]:
    """Return areas, depths on glass and under the steel cylinder."""
    found = []
    if silicone.measured_area is not None:
        for force in AREAS_N:
            area = float(silicone.measured_area.area(force))
            found.append(outcome(f"area_{force:g}N", "read_area", "mm2", area, 0.05 * area,
                                 silicone.measured_area.source, "assumed 5 %; no scatter is printed",
                                 force_N=force))  # fmt: skip
        if silicone.fe_area_scale is not None:
            own = area / silicone.fe_area_scale.value  # the last: of the largest force
            found.append(outcome(f"fe_area_{force:g}N", "fe_area", "mm2", own, 0.05 * own,
                                 f"{silicone.fe_area_scale.source}, {silicone.fe_area_scale.value:g}",
                                 "assumed 5 %; one factor is printed for all forces", force_N=force))  # fmt: skip
    if silicone.area_deviation is not None:
        off = silicone.area_deviation
        hertz = float(np.pi * 7.5 * published_depth(name, off.force_N))
        found.append(outcome(f"area_{off.force_N:g}N", "read_area", "mm2",
                             [hertz * (1 - off.value), hertz * (1 + off.value)], 0.05 * hertz,
                             f"{off.source}: {100 * off.value:g} % from Hertz's {hertz:.1f} mm2, sign not printed",
                             "assumed 5 %; both signs are possible", force_N=off.force_N))  # fmt: skip
    for force in DEPTHS_N:
        depth = published_depth(name, force)
        found.append(outcome(f"depth_{force:g}N", "depth", "mm", depth, 0.05 * depth,
                             silicone.flat_reduced_modulus.source, "assumed 5 %; a line through unprinted scatter",
                             force_N=force))  # fmt: skip
    indenter, law = facts["indenter"], silicone.indenter_reduced_modulus
    for force in DEPTHS_N:
        modulus = law.intercept_MPa + law.slope_MPa_per_N * force
        depth = indenter["deformation_scale_mm"] * (force / modulus) ** (2 / 3)
        found.append(outcome(f"cylinder_depth_{force:g}N", "cylinder_depth", "mm", depth, 0.1 * depth,
                             f"{law.source}; {indenter['source']}",
                             "assumed 5 %, and 8 % for carrying a flat plate's press to a cylinder",
                             force_N=force))  # fmt: skip
    return found


def others(name: str, silicone: Material, facts: dict[str, Any]) -> list[dict]:
    """Return modulus at the rate of the press, friction and its change with angle."""
    dma = silicone.dma
    seconds = 60.0 * published_depth(name, PRESS_N) / facts["youngs_modulus_10_Hz"]["press_rate_mm_per_min"]
    slope = np.log1p(dma.rise_1_to_80_hz) / np.log(80.0)
    modulus = silicone.youngs_modulus_MPa * (1.0 / (4.0 * seconds) / 10.0) ** slope
    friction, tilt = silicone.friction, facts["static_coefficient_rise_0_to_45_deg"]
    return [
        outcome("youngs_modulus", "youngs_modulus", "MPa", modulus, 0.25 * modulus,
                facts["youngs_modulus_10_Hz"]["source"],
                f"assumed 25 %: a power law over three decades, to a quarter period of {seconds:.0f} s"),
        outcome("friction_1N", "friction", "1", friction.static_coefficient_smooth,
                0.1 * friction.static_coefficient_smooth, friction.source, "assumed 10 %; three repeats",
                force_N=1.0),
        *ridged_friction(name, silicone),
        outcome("tilt_friction", "tilt_friction", "1", tilt[name], 0.05, tilt["source"], "assumed 0.05"),
    ]  # fmt: skip


def ridged_friction(name: str, silicone: Material) -> list[dict]:
    """Return the ridged finger's friction over the smooth one's, where both are published."""
    law = silicone.friction
    if law.static_coefficient_ridged is None:
        return []
    ratio = law.static_coefficient_ridged / law.static_coefficient_smooth
    return [outcome("ridged_friction_1N", "ridged_friction", "1", ratio, 0.14 * ratio, law.source,
                    "assumed 14 %: two figures of 10 % each, three repeats", force_N=1.0)]  # fmt: skip


def reported(facts: dict[str, Any]) -> list[dict]:
    """Return what chapter 6 reports of Silskin 0 % and chapter 5 of the voltage."""
    figures = facts["reported"]
    found = []
    ridged = figures["ridged_over_smooth_max_area_1N"]
    found.append(
        outcome(
            "ridged_area",
            "ridged_over_smooth",
            "1",
            ridged["value"],
            0.05 * ridged["value"],
            ridged["source"],
            "assumed 5 %: place of the tip among the ridges, elements of 0.5 mm",
        )
    )
    deeper = figures["ridged_and_smooth_force_displacement"]
    found.append(
        outcome(
            "ridged_depth",
            "ridged_depth",
            "1",
            deeper["value"],
            0.05,
            deeper["source"],
            "assumed 0.05: what an eye calls minimal",
            force_N=1.0,
        )
    )
    over = figures["normal_force_overshoot_mu_1p13"]
    for mu in (1.13, 0.82, 0.67):
        found.append(
            outcome(
                f"overshoot_mu_{mu:g}",
                "overshoot",
                "1",
                over["value"] * mu / 1.13,
                0.1,
                over["source"],
                "assumed 0.1; below mu 1.13 by proportion",
                friction=mu,
            )
        )
    for key, kind in (
        ("length_25_over_7p5", "length_change"),
        ("diameter_20_over_15", "diameter_change"),
        ("bone", "bone_change"),
    ):
        one = figures[f"area_change_{key}_1N"]
        found.append(
            outcome(
                kind,
                kind,
                "1",
                one["value"],
                0.03,
                one["source"],
                "assumed 0.03: their elements of 0.5 mm are 1.2 % off, ours 1.8 %",
                force_N=1.0,
            )
        )
    return found + voltages(facts["voltage"])


def voltages(volts: dict[str, Any]) -> list[dict]:
    """Return what chapter 5 says of the LED voltage, of the ridged finger."""
    lost, settled = volts["patch_lost_below_V"], volts["converged_from_V"]
    step, eye = (
        "assumed 0.25 V: half a step of the eye",
        "assumed 0.05: growth that an eye calls converged; modelled smooth",
    )
    return [
        outcome("lost_below", "lost_below", "V", lost["value"], 0.25, lost["source"], step),
        *(
            outcome(f"growth_9_to_12V_{force:g}N", "growth", "1", 0.0, 0.05, settled["source"], eye, force_N=force)
            for force in (1.0, 5.0)
        ),
    ]


def main() -> None:
    """Write both files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bundles", type=Path, nargs="?", default=BUNDLES)
    given = parser.parse_args()
    facts = tomllib.loads((BUNDLES / "thesis_facts.toml").read_text(encoding="utf-8"))
    for name, title in TITLES.items():
        silicone = material(name)
        every = contact(name, silicone, facts) + others(name, silicone, facts)
        every += reported(facts) if name == "silskin_0" else []
        folder = given.bundles / f"thesis_{name}"
        head = f"# What the thesis published of {title}. Made by docs/validation/thesis_bundles.py; do not edit.\n"
        text = tomli_w.dumps({"schema_version": 1, "material": name, "outcome": every})
        (folder / "outcomes.toml").write_text(head + text, encoding="utf-8")


if __name__ == "__main__":
    main()
