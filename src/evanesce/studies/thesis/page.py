"""Findings of the thesis study: a table per figure, charts and verdict."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.contact.analytic.hertz import hertz_depth
from evanesce.contact.fem.library import library_press
from evanesce.materials.tables import material
from evanesce.report.charts import Chart, Panel, Series
from evanesce.report.html import Table
from evanesce.rig import Scene
from evanesce.studies.mechanics.curves import slide_curves
from evanesce.studies.mechanics.runs import BONES
from evanesce.studies.mechanics.study import modulus_at_ridges
from evanesce.studies.registry import Findings, Progress, Study
from evanesce.studies.thesis.figures import FORCES, RADIUS, Reproduced, area_laws, observations, published_depth
from evanesce.studies.thesis.outcomes import Outcome
from evanesce.studies.thesis.study import ThesisStudy, compute


def findings(found: ThesisStudy) -> Findings:
    """Return tables, charts and verdict.

    Parameters
    ----------
    found : ThesisStudy

    Returns
    -------
    Findings
    """
    stated, entries, seen, volts = found.stated, found.entries, found.seen, found.volts
    simulated = [entry for entry in entries if entry.simulated]
    agreed, published = (
        f"{sum(entry.agrees for entry in some)} of {len(some)}"
        for some in (simulated, [entry for entry in entries if not entry.simulated])
    )
    far = Counter(entry.figure for entry in entries if not entry.agrees)
    counted = [one for one in found.outcomes if one.counted]
    agreeing = sum(one.agrees for one in counted)
    verdict = [
        f"{agreed} of the thesis's figures that were simulated lie in the interval that its own inputs leave; of those"
        f" that only compare the thesis's own laws, without simulation, {published}. Intervals are no"
        " 95 % intervals: they are the hull of what the thesis leaves open, the bone's size above all, and many are"
        " wide.",
        f"Outside lie: {'; '.join(f'{figure} ({count})' for figure, count in far.items())}. Reasons are in the tables."
        if far
        else "None lies outside.",
        _scattering_sentence(seen),
        f"Textured against smooth, short against long, the larger tip and the bone are predictions: {agreeing} of"
        f" {len(counted)} of the figures that sections 6.4 to 6.6 report lie in their interval.",
    ]
    tables = [_outcome_table(found.outcomes), _prediction_table(stated)]
    for figure in dict.fromkeys(entry.figure for entry in entries):
        tables.append(_figure_table(figure, [entry for entry in entries if entry.figure == figure]))
    tables.append(
        Table(
            columns=("the thesis says", "here", "verdict"),
            rows=observations(slide_curves()),
            caption="Observations that the thesis states in words.",
        )
    )
    tables += [_law_table(name) for name in ("silskin_0", "silskin_20")]
    tables.append(_seen_table(seen))
    return Findings(
        verdict=verdict,
        charts=[_area_chart(seen), _depth_and_voltage(volts)],
        pictures=[found.picture],
        tables=tables,
        data={
            "predictions": {key: dict(one) for key, one in stated.items()},
            "outcomes": [asdict(one) | {"agrees": one.agrees} for one in found.outcomes],
            "figures": [asdict(entry) | {"agrees": entry.agrees, "wide": entry.wide} for entry in entries],
            "seen": [dict(row) for row in seen],
            "voltage": dict(volts),
        },
    )


def _scattering_sentence(seen: Sequence[Mapping[str, Any]]) -> str:
    law = material("silskin_20").measured_area
    assert law is not None  # in the tables
    some = [row for row in seen if row["material"] == "silskin_20"]
    areas = "; ".join(
        f"{r['force_N']:g} N: true {r['true_area_mm2']:.0f}, reported {r['scattering_mm2']:.0f}, thesis"
        f" {float(law.area(r['force_N'])):.0f}"
        for r in some
    )
    return (
        "With the assumed subsurface scattering the reference segmentation at a threshold of 0.15 reports areas of the"
        " size of the thesis's from a"
        f" finite-element contact that is much smaller (Silskin 20 %, mm²: {areas}): scattering is a candidate for the"
        " factor of 1.8, beside adhesion."
    )


def _outcome_table(reported: Sequence[Outcome]) -> Table:
    return Table(
        columns=("reported", "thesis", "from its inputs", "interval", "moved most by", "from to", "verdict", "note"),
        rows=[
            (
                f"{one.what} [{one.unit}]",
                f"{one.thesis:.3g}",
                f"{one.value:.3g}",
                f"{one.low:.3g} to {one.high:.3g}",
                one.moved_by,
                f"{one.moves[0]:.3g} to {one.moves[1]:.3g}",
                "within" if one.agrees else "outside",
                one.note,
            )
            for one in reported
        ],
        caption="What sections 6.4 to 6.6 report of the thesis's own finger, beside what follows from its inputs alone:"
        " nothing is fitted. Value: a bone of half the radius; interval: solid to that bone, and other open inputs.",
    )


def _prediction_table(stated: Mapping[str, Mapping[str, Any]]) -> Table:
    return Table(
        columns=("predicted", "value", "interval", "basis"),
        rows=[
            (key.replace("_", " "), f"{p['value']:.3g}", f"{p['low']:.3g} to {p['high']:.3g}", p["basis"])
            for key, p in stated.items()
        ],
        caption="Predictions, stated before anyone compares: ratios, or changes over 1.",
    )


def _figure_table(figure: str, entries: Sequence[Reproduced]) -> Table:
    return Table(
        columns=(
            "quantity",
            "basis",
            "thesis",
            "computed",
            "computed over thesis",
            "hull of the open inputs",
            "verdict",
        ),
        rows=[
            (
                f"{e.what} [{e.unit}]",
                "simulated" if e.simulated else "the thesis's own laws",
                f"{e.thesis:.4g}",
                f"{e.value:.4g}",
                f"{e.value / e.thesis:.2f}",
                f"{e.low:.4g} to {e.high:.4g}" + (f" ({e.high / e.low:.1f} times)" if e.wide else ""),
                ("within" + (" a wide hull" if e.wide else "")) if e.agrees else f"outside: {e.reason}",
            )
            for e in entries
        ],
        caption=figure[0].upper() + figure[1:] + ".",
    )


def _law_table(name: str) -> Table:
    laws = area_laws(name)
    title = "Silskin 0 %" if name == "silskin_0" else "Silskin 20 %"
    return Table(
        columns=("force [N]", *(f"{law} [mm²]" for law in laws)),
        rows=[(f"{f:g}", *(f"{laws[law][k]:.2f}" for law in laws)) for k, f in enumerate(FORCES)],
        caption=f"{title}: area against force by every law.",
    )


def _seen_table(seen: Sequence[Mapping[str, Any]]) -> Table:
    return Table(
        columns=(
            "material",
            "force [N]",
            "true area [mm²]",
            "reported, clear [mm²]",
            "reported, scattering and specks [mm²]",
        ),
        rows=[
            (
                r["material"],
                f"{r['force_N']:g}",
                f"{r['true_area_mm2']:.2f}",
                f"{r['clear_mm2']:.2f}",
                f"{r['scattering_mm2']:.2f}",
            )
            for r in seen
        ],
        caption="The same presses of the solid finger (finite elements) after light, camera and reference segmentation"
        " at a threshold of 0.15: what a waveguide would have reported.",
    )


def _area_chart(seen: Sequence[Mapping[str, Any]]) -> Chart:
    panels = []
    for name, title in (("silskin_0", "Silskin 0 %"), ("silskin_20", "Silskin 20 %")):
        laws = area_laws(name)
        some = [r for r in seen if r["material"] == name]
        fe = [laws["finite elements, no bone"], laws["finite elements, bone"]]
        series = [
            Series(label=law, x=FORCES, y=area.tolist(), points=law.startswith("measured"))
            for law, area in laws.items()
            if not law.startswith("finite") and "1 J" not in law and "10 J" not in law
        ]
        series.append(
            Series(label="finite elements, no bone to bone", x=FORCES, y=fe[0].tolist(),
                   low=np.minimum(*fe).tolist(), high=np.maximum(*fe).tolist())
        )  # fmt: skip
        for key, label in (
            ("clear_mm2", "reported by the rig, clear"),
            ("scattering_mm2", "reported, scattering and specks"),
        ):
            series.append(Series(label=label, x=[r["force_N"] for r in some], y=[r[key] for r in some], points=True))
        panels.append(Panel(title=title, x_label="normal force [N]", y_label="contact area [mm²]", series=series))
    return Chart(
        panels=panels,
        caption="Finite elements, bone or none, fall short of the waveguide's areas of Silskin 20 %; what the simulated"
        " rig reports of their smaller contact comes near those areas up to 3 N once scattering is assumed.",
    )


def _depth_and_voltage(volts: Mapping[str, Any]) -> Chart:
    series = []
    for name, title in (("silskin_0", "Silskin 0 %"), ("silskin_20", "Silskin 20 %")):
        presses = [library_press(name, bone) for bone in BONES]
        force = np.linspace(0.2, 5.0, 25)
        depth = [np.interp(force, press.force, press.depth) for press in presses]
        series += [
            Series(label=f"{title}, finite elements", x=force.tolist(), y=depth[0].tolist(),
                   low=np.minimum(*depth).tolist(), high=np.maximum(*depth).tolist()),
            Series(label=f"{title}, thesis's E*(F)", x=force.tolist(),
                   y=[published_depth(name, float(f)) for f in force], points=True),
            Series(label=f"{title}, Hertz, E* = 4 G", x=force.tolist(),
                   y=hertz_depth(force, RADIUS, modulus_at_ridges(name)).tolist()),
        ]  # fmt: skip
    shown = [
        Series(label=key, x=volts["voltage_V"], y=[a / volts[key]["true_area_mm2"] for a in volts[key]["area_mm2"]])
        for key in ("1 N", "5 N")
    ]
    return Chart(
        panels=[
            Panel(title="force and displacement on glass", x_label="normal force [N]", y_label="depth [mm]",
                  series=series),
            Panel(title="ridged finger, threshold 0.15", x_label="LED voltage [V]",
                  y_label="estimated over true area [1]", series=shown),
        ],
        caption="The published material sinks deeper than the published modulus says unless a bone stiffens it (bands:"
        " no bone to bone), and with assumed scattering the estimated area grows with voltage instead of settling.",
    )  # fmt: skip


def run(scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
    """Compute the study and return its findings.

    Parameters
    ----------
    scene, out, progress, quick, seed
        As for :meth:`evanesce.studies.registry.Study.run`.

    Returns
    -------
    Findings
    """
    return findings(compute(scene, out, progress, quick=quick, seed=seed))


STUDY = Study("thesis", "The thesis's experiments in simulation", 60, run)
