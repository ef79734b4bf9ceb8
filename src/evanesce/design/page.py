"""Pages of a design search: one with the Pareto front, one for each winner."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup, escape

from evanesce.design.assessment import BASE, Chosen, change, ranked
from evanesce.design.parts import parts_of
from evanesce.design.picture import Shot
from evanesce.design.plots import cases_figure, frame_figure, label, pareto_figure, tolerance_figure
from evanesce.design.search import Plan, Trial, pareto
from evanesce.design.secondary import OBJECTIVES
from evanesce.design.uncertainty import Uncertainty
from evanesce.design.variables import design_at, value_of
from evanesce.report.html import Page, Picture, Section, Table, figure_png
from evanesce.rig import dump_scene

Found = Mapping[str, Mapping[str, Any]]


def number(value: float) -> str:
    """Return a figure with four digits; a dash where there is none."""
    return "–" if not math.isfinite(value) else f"{value:.4g}"


def _percent(found: Mapping[str, Any]) -> str:
    return f"{found['error_percent']:.1f} ± {found['standard_percent']:.1f} %"


def half_or_not(plan: Plan, chosen: Sequence[Chosen], found: Found) -> str:
    """Return a sentence: whether a rig within the base's cost has half its error, on rigs drawn anew."""
    base = found[BASE]["assessed"]
    rest = [c for c in chosen if c.name != BASE]
    if plan.parts is not None:
        most = base["figures"]["cost"] * (1 + 1e-9)
        rest = [c for c in rest if found[c.name]["assessed"]["figures"]["cost"] <= most]
    if not rest:
        return "No feasible rig costs as little as the one given."
    best = min(rest, key=lambda c: found[c.name]["assessed"]["error_percent"])
    own = found[best.name]["assessed"]
    ratio = own["error_percent"] / base["error_percent"]
    spread = ratio * math.hypot(own["standard_percent"] / own["error_percent"],
                                base["standard_percent"] / base["error_percent"])  # fmt: skip
    price = "at no higher cost" if plan.parts is not None else "(no prices given)"
    verdict = "half or less" if ratio + 2 * spread <= 0.5 else "less, but not surely half" if ratio < 1 else "no less"
    return (
        f"On {own['rigs']} rigs drawn anew the rig as given has a 95 % area error of {_percent(base)}, the best found"
        f" {price} ({best.name}) {_percent(own)}: {ratio:.2f} ± {spread:.2f} of it, {verdict}."
    )


def search_page(
    plan: Plan, trials: Sequence[Trial], chosen: Sequence[Chosen], found: Found, uncertainty: Uncertainty,
    base_figures: Mapping[str, float], provenance: Mapping[str, Any],
) -> Page:  # fmt: skip
    """Return the page of a finished search.

    Parameters
    ----------
    plan : Plan
    trials : sequence of Trial
    chosen : sequence of Chosen
    found : mapping
        Of :func:`evanesce.design.assessment.study`.
    uncertainty : Uncertainty
    base_figures : mapping
        Objectives of the base by the search's own draws.
    provenance : mapping
    """
    front = pareto(trials, plan.objectives)
    picture = Picture(
        figure_png(pareto_figure(plan, trials, chosen, base_figures)),
        f"{len(trials)} designs by predicted error on the search's own {plan.question.rigs} drawn rigs; bars: one"
        " standard error by bootstrap. The star is the scene as given.",
    )
    return Page(
        title=f"Design search: {plan.base.scene.title or 'a scene'}",
        lead=half_or_not(plan, chosen, found),
        sections=[
            Section("Pareto front", [_asked(plan)], [picture], [_front_table(plan, front)]),
            _winners(plan, chosen, found),
            _limits(chosen, found),
            _impossible(plan, trials),
            _uncertainty(uncertainty),
        ],
        provenance=provenance,
    )


def _asked(plan: Plan) -> str:
    q = plan.question
    ranges = "; ".join(
        f"{v.key} {v.low:g} to {v.high:g}{'' if v.unit == '1' else ' ' + v.unit}"
        f"{f' in steps of {v.step:g}' if v.step else ''}{' (logarithmic)' if v.log else ''}"
        for v in plan.variables
    )
    cases = (
        f"{', '.join(f'{f:g}' for f in q.forces_N)} N at {len(q.positions_mm)} position(s), {', '.join(q.materials)}"
    )
    chain = "the reference segmentation" if q.estimator == "reference" else "the refined estimator"
    coarse = f", on pixels {q.pixel_factor} times as large as the camera's" if q.pixel_factor > 1 else ""
    return (
        f"Measured by {chain}{coarse}, cropped to ±{q.crop_mm:g} mm about the finger: {cases}. Varied: {ranges}."
        f" Sampler: {plan.sampler}."
    )


def _front_table(plan: Plan, front: Sequence[Trial]) -> Table:
    names = list(dict.fromkeys([*plan.objectives, *OBJECTIVES]))
    names = [n for n in names if n != "cost" or plan.parts is not None]
    rows = [
        [f"trial-{t.number}", *(number(t.values[v.key]) for v in plan.variables),
         *(number(t.figures.get(n, math.nan)) + (f" ± {t.standard_percent:.1f}" if n == "area_error" else "")
           for n in names)]
        for t in front
    ]  # fmt: skip
    columns = ["design", *(f"{v.key}{'' if v.unit == '1' else f' [{v.unit}]'}" for v in plan.variables),
               *(label(n, plan) for n in names)]  # fmt: skip
    return Table(columns, rows, "Designs that no other dominates.")


def _winners(plan: Plan, chosen: Sequence[Chosen], found: Found) -> Section:
    rows = []
    links = []
    for c in chosen:
        own = found[c.name]["assessed"]
        checked = ""
        for v in found[c.name].get("verified", []):
            checked += ("; " if checked else "") + verified_words(v)
        price = number(own["figures"]["cost"]) if plan.parts is not None else "–"
        rows.append([c.name, c.why, _percent(own), price, checked or "not computed"])
        links.append(Markup('<a href="{0}.html">{0}</a> (<a href="{0}.toml">scene</a>)').format(escape(c.name)))
    table = Table(
        [
            "design",
            "why",
            "95 % area error, rigs drawn anew",
            label("cost", plan),
            "error of the nominal rig, path tracer",
        ],
        rows,
        "Rigs drawn anew were not used by the search; each measures every case. Nominal: no error of the build.",
    )
    widget = Markup("<p>Pages: {}</p>").format(Markup(", ").join(links))
    return Section("Winners", tables=[table], widget=widget)


def verified_words(v: Mapping[str, Any]) -> str:
    """Return the path tracer's and the fast renderer's error of one case, for tables."""
    standard = v["reference_standard_percent"]
    noise = f" ± {standard:.2f}" if standard is not None and math.isfinite(standard) else ""
    return f"{v['case']}: {v['reference_mean_percent']:+.2f}{noise} %, fast {v['fast_percent']:+.2f} %"


def _limits(chosen: Sequence[Chosen], found: Found) -> Section:
    """Return the section on what limits the best design."""
    best = next((c for c in chosen if c.trial is not None), None)
    if best is None:
        return Section("What limits it", ["No design is feasible."])
    own = found[best.name]
    rows = ranked(own["tolerances"]["rows"])
    words = [f"{r['name']} ({change(r):.2f} % of the area)" for r in rows[:4]]
    paragraphs = [
        f"Of {best.name}, one measurement ({own['tolerances']['case']}), each parameter alone by one standard"
        f" deviation: the largest change is by {words[0]}, then {', '.join(words[1:])}."
    ]
    if own["without"]:
        base = own["assessed"]["error_percent"]
        parts = ", ".join(f"{w['error_percent']:.1f} % without {w['effect']}" for w in own["without"])
        paragraphs.append(
            f"Its 95 % error is {base:.1f} % with all effects drawn. Without one effect, all else drawn"
            f" as before: {parts}."
        )
    tables = []
    if "sensitivity" in own:
        tables.append(
            Table(
                ["key", "from", "to", "unit", "mu* [%]", "±", "mu [%]", "sigma [%]"],
                [
                    [s["key"], number(s["low"]), number(s["high"]), s["unit"], f"{s['mu_star_percent']:.2f}",
                     _known(s["half_width_percent"]), f"{s['mu_percent']:+.2f}", _known(s["sigma_percent"])]
                    for s in own["sensitivity"]
                ],
                "Morris' elementary effects on the 95 % area error in a box of a tenth of each range about the winner:"
                " mean absolute effect over the whole box (with its 95 % half-width), mean, spread."
                + (SINGLE if _known(own["sensitivity"][0]["sigma_percent"]) == "–" else ""),
            )
        )  # fmt: skip
    elif "sensitivity_reason" in own:
        paragraphs.append(f"No sensitivity: a rig in the box about it is infeasible ({own['sensitivity_reason']}).")
    return Section("What limits the winner", paragraphs, tables=tables)


SINGLE = (
    " One trajectory: each variable was changed once, at one point of the box. That is one effect each, not a mean; its"
    " noise is that of two predicted errors, and how much it depends on the other variables is not known."
)


def _known(value: float | None) -> str:
    """Return a figure for tables; a dash where one trajectory does not determine it."""
    return "–" if value is None or math.isnan(value) else f"{value:.2f}"


def _impossible(plan: Plan, trials: Sequence[Trial]) -> Section:
    rows = []
    for t in trials:
        if not t.feasible:
            why = t.reason or "violates " + ", ".join(
                f"{limit.name} {number(t.figures[limit.name])} (limit {limit.value:g})"
                for limit in plan.limits
                if limit.name in t.violated
            )
            rows.append([f"trial-{t.number}", why, *(number(t.values[v.key]) for v in plan.variables)])
    if not rows:
        return Section("Infeasible designs", ["Every evaluated design is feasible."])
    columns = ["design", "reason", *(v.key for v in plan.variables)]
    return Section("Infeasible designs", tables=[Table(columns, rows, f"{len(rows)} of {len(trials)} designs.")])


def _uncertainty(u: Uncertainty) -> Section:
    rows = [[d.name, number(d.candidate.null), number(d.candidate.deviation), d.candidate.unit] for d in u.parameters]
    out = [[name, why] for name, why in u.left_out.items() if why != "not among the stated uncertainties"]
    out += [[name, "in tolerances only: each draw would need new fields of light"]
            for name in dict.fromkeys(d.effect for d in u.new_fields)]  # fmt: skip
    tables = [Table(["parameter", "nominal", "standard deviation", "unit"], rows,
                    "Drawn for every rig, normal about the nominal figure and truncated at its bounds; errors of the"
                    " calibration's cards beside them.")]  # fmt: skip
    if out:
        tables.append(Table(["effect", "reason why it is not drawn"], out))
    return Section("Uncertainty of a built rig", tables=tables)


def scene_text(plan: Plan, chosen: Chosen) -> str:
    """Return a chosen design as a scene's TOML text; what has no key in a scene is a comment above it."""
    design = design_at(plan.base, chosen.values)
    lines = [f"{chosen.name} of a design search: {chosen.why}."]
    if plan.question.estimator == "reference":
        options = f"--threshold {design.threshold!r} --min-blob {design.min_blob_px} --calibration CALIBRATION"
        lines += [
            f"Its errors are those of the reference segmentation with threshold {design.threshold:.4g},"
            f" minimum blob size {design.min_blob_px} px:",
            f"evanesce measure VIDEO {options}",
            "evanesce render THIS --fast, then",
            f"evanesce compare FOLDER {options}",
        ]
    else:
        lines += [
            "Its errors are those of the refined estimator, which has no threshold:",
            "evanesce measure VIDEO --estimator refined --calibration CALIBRATION",
        ]
    return "".join(f"# {line}\n" for line in lines) + "\n" + dump_scene(design.scene)


def winner_page(plan: Plan, chosen: Chosen, found: Found, shots: Sequence[Shot], provenance: Mapping[str, Any]) -> Page:
    """Return the page of an assessed design.

    Parameters
    ----------
    plan : Plan
    chosen : Chosen
    found : mapping
        Of :func:`evanesce.design.assessment.study`.
    shots : sequence of Shot
    provenance : mapping
    """
    own, base = found[chosen.name], found[BASE]["assessed"]
    design = design_at(plan.base, chosen.values)
    threshold = design.threshold if plan.question.estimator == "reference" else None
    frames = [(s.title, s.crop, (s.true_lines, s.measured_lines)) for s in shots]
    sections = [
        Section(
            "Frame",
            pictures=[
                Picture(
                    figure_png(frame_figure(frames, threshold)),
                    "Nominal rig, fast renderer, the camera's full resolution: true outline blue,"
                    " measured outline orange.",
                )
            ],
        ),
        _errors(plan, chosen, own["assessed"], base),
    ]
    if "tolerances" in own:
        sections.append(_tolerances(own["tolerances"], own["assessed"]))
    if "verified" in own:
        sections.append(_verified(own["verified"]))
    sections.append(_figures(plan, chosen, own["assessed"], base))
    if plan.parts is not None:
        sections.append(_parts(plan, design))
    text = Markup("<pre>{}</pre>").format(scene_text(plan, chosen))
    sections.append(Section("Scene", widget=text))
    return Page(
        title=chosen.name,
        lead=f"{chosen.why[:1].upper()}{chosen.why[1:]}. 95 % area error on {own['assessed']['rigs']} rigs drawn anew:"
        f" {_percent(own['assessed'])}.",
        sections=sections,
        provenance=provenance,
    )


def _errors(plan: Plan, chosen: Chosen, own: Mapping[str, Any], base: Mapping[str, Any]) -> Section:
    figure = cases_figure(own, None if chosen.name == BASE else base)
    rows = [
        [f"{r['force_N']:g}", f"{r['position_mm'][0]:g}, {r['position_mm'][1]:g}", r["material"], str(r["rigs"]),
         f"{r['mean_percent']:+.2f}", "–" if r["standard_deviation_percent"] is None
         else f"{r['standard_deviation_percent']:.2f}", f"{r['error_95_percent']:.2f}"]
        for r in own["by_case"]
    ]  # fmt: skip
    columns = ["force [N]", "position [mm]", "material", "rigs", "mean error [%]", "standard deviation [%]", "95 % [%]"]
    caption = "Area error by load, position and material; boxes: quartiles, whiskers: 95 %."
    return Section("Error by load and position", pictures=[Picture(figure_png(figure), caption)],
                   tables=[Table(columns, rows)])  # fmt: skip


def _tolerances(found: Mapping[str, Any], own: Mapping[str, Any]) -> Section:
    rows = ranked(found["rows"])
    allowed = own["error_percent"]
    lines = [
        [r["name"], number(r["low"]), number(r["high"]), r["unit"], f"{r['low_percent']:+.2f}",
         f"{r['high_percent']:+.2f}",
         f"{allowed / change(r):.1f}" if change(r) > 0.005 * allowed else "over 200"]
        for r in rows
    ]  # fmt: skip
    lines += [[r["name"], number(r["low"]), number(r["high"]), r["unit"], "–", "–", r["reason"]]
              for r in found["rows"] if "reason" in r]  # fmt: skip
    columns = ["parameter", "down", "up", "unit", "error, down [%]", "error, up [%]", "equal at [standard deviations]"]
    caption = (
        f"{found['case']}: area error less that of the nominal rig ({found['error_percent']:+.2f} %), one parameter at"
        " a time. Last: at how many standard deviations, in proportion, it alone equals the predicted error of"
        f" {allowed:.1f} %."
    )
    picture = Picture(figure_png(tolerance_figure(rows)), "Change of one measurement by each parameter.")
    return Section("Tolerances", pictures=[picture], tables=[Table(columns, lines, caption)])


def _verified(found: Sequence[Mapping[str, Any]]) -> Section:
    rows = []
    for v in found:
        s = v["reference_standard_percent"]
        known = s is not None and math.isfinite(s)
        rows.append(
            [v["case"], f"{v['true_mm2']:.3f}", str(len(v["reference_percent"])), str(v["samples_per_pixel"]),
             f"{v['reference_mean_percent']:+.2f}", f"{s:.2f}" if known else "–", f"{v['fast_percent']:+.2f}"]
        )  # fmt: skip
    columns = ["case", "true area [mm²]", "renderings", "paths per pixel", "error, path tracer [%]",
               "standard error [%]", "error, fast renderer [%]"]  # fmt: skip
    text = "The nominal rig at the camera's full resolution, by the path tracer with its own seeds."
    return Section("Verified by the path tracer", [text], tables=[Table(columns, rows)])


def _figures(plan: Plan, chosen: Chosen, own: Mapping[str, Any], base: Mapping[str, Any]) -> Section:
    names = [n for n in OBJECTIVES if n != "cost" or plan.parts is not None]
    rows = [
        [label(n, plan), number(own["figures"][n]), number(base["figures"][n]), OBJECTIVES[n].doc] for n in names
    ]  # fmt: skip
    changed = []
    for v in plan.variables:
        before = value_of(plan.base, v.key)
        after = chosen.values.get(v.key, before)
        unit = "" if v.unit == "1" else f" [{v.unit}]"
        changed.append([v.key + unit, *("–" if x is None else number(x) for x in (after, before))])
    return Section(
        "Figures",
        tables=[
            Table(["varied", "this design", "as given"], changed),
            Table(["", "this design", "as given", ""], rows),
        ],
    )


def _parts(plan: Plan, design: Any) -> Section:
    assert plan.parts is not None
    bought = parts_of(plan.parts, design)
    rows = [[p.name, number(p.count), p.unit, number(p.price), f"{p.cost:.2f}"] for p in bought]
    rows.append(["all", "", "", "", f"{sum(p.cost for p in bought):.2f}"])
    columns = ["part", "count", "of", f"price [{plan.parts.currency}]", f"cost [{plan.parts.currency}]"]
    return Section("Parts", tables=[Table(columns, rows)])
