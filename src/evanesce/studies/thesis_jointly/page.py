"""The page of a joint judgement: a picture per outcome, and tables of mechanisms, figures, alternatives, advice."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from evanesce.report.html import Page, Picture, Section, Table, figure_png
from evanesce.studies.thesis_jointly.pictures import groups_of, mechanism_figure, outcome_figure, title_of


def page(result: Mapping[str, Any], provenance: Mapping[str, Any]) -> Page:
    """Return the report.

    Parameters
    ----------
    result : mapping
        Of :func:`evanesce.studies.thesis_jointly.answer.criticise_thesis`.
    provenance : mapping

    Returns
    -------
    Page
    """
    bars = Picture(figure_png(mechanism_figure(result)), "Probability of each mechanism given all outcomes.")
    pictures = [
        Picture(figure_png(outcome_figure(group, rows)), _caption(group, rows))
        for group, rows in groups_of(result).items()
    ]
    sections = [
        Section("Mechanisms", [_other_bundle(result)], [bars], [mechanism_table(result), set_table(result)]),
        Section("What was fitted", tables=[parameter_table(result)]),
        Section("Outcome by outcome", pictures=pictures, tables=[outcome_table(result)]),
        Section("What is excluded, and by which outcome", tables=[alternative_table(result)]),
        Section("What to measure next", [result["next_measurement"]["advice"]], tables=[menu_table(result)]),
    ]
    return Page("Both fingers of the thesis, judged jointly", result["first_line"], sections, provenance)


def _caption(group: str, rows: Sequence[Mapping[str, Any]]) -> str:
    far = max((abs(r["residual_sd"]) for r in rows), default=0.0)
    outside = rows[0]["unexplained"]
    miss = f" Missed by {far:.1f} standard deviations." if far > 2 else ""
    aside = f" Not explained (probability {outside:.2f}): set aside." if outside > 0.5 else ""
    return f"{title_of(group)}.{miss}{aside} {rows[0]['source']}."


def _other_bundle(result: Mapping[str, Any]) -> str:
    own = result["scattering_of_the_other_bundle"]
    low, high = own["published_mm2"]
    return (
        f"Scattering of share {own['share']:g} and length {own['length_mm']:g} mm, which explains Silskin 20 % alone,"
        f" would make {own['read_mm2']:.1f} mm² of Silskin 0 % at {own['force_N']:g} N; published: {low:.1f} or"
        f" {high:.1f} mm² (Hertz {own['hertz_mm2']:.1f} mm² less or plus 16.5 %). For both fingers it is refuted."
    )


def mechanism_table(result: Mapping[str, Any]) -> Table:
    """Return the mechanisms with probability, verdict and prior."""
    rows = [(r["id"], r["title"], f"{r['probability']:.3f}", r["verdict"], r["prior"]) for r in result["mechanisms"]]
    return Table(
        ("mechanism", "what", "probability", "verdict", "prior of its parameters"), rows,
        "Prior: laws of contact and ways of scattering evenly, one half for each of the others.",
    )  # fmt: skip


def set_table(result: Mapping[str, Any]) -> Table:
    """Return the most probable sets."""
    rows = [
        (r["set"], f"{r['probability']:.3f}", f"{r['log_evidence_nats']:.1f}", f"{r['misfit']:.1f}", str(r["rows"]))
        for r in result["sets"]
    ]
    columns = ("set", "probability", "log evidence [nats]", "misfit, priors included", "rows")
    return Table(columns, rows, f"Most probable of {result['sets_judged']} sets.")


def parameter_table(result: Mapping[str, Any]) -> Table:
    """Return all fitted figures."""
    rows = [
        (
            r["name"], f"{r['value']:.3g}", f"{r['low']:.3g} to {r['high']:.3g}", r["unit"], f"{r['probability']:.2f}",
            f"{r['prior'][1]:.3g} to {r['prior'][2]:.3g}",
        )
        for r in result["parameters"]
    ]  # fmt: skip
    return Table(
        ("parameter", "median", "90 % interval", "unit", "probability of its mechanism", "prior, 68 %"), rows,
        "Over all sets that have the parameter.",
    )  # fmt: skip


def outcome_table(result: Mapping[str, Any]) -> Table:
    """Return published, believed, extended and left-out figures."""
    rows = []
    for r in result["outcomes"]:
        extended, others, gain = r["extended"], r["from_others"], r["gain_nats"]
        rows.append(
            (
                f"{r['material']}:{r['id']} [{r['unit']}]", " or ".join(f"{v:.3g}" for v in r["published"]),
                f"{r['sd']:.2g}", f"{r['believed']:.3g}", f"{extended[0]:.3g} ({extended[1]:.3g} to {extended[2]:.3g})",
                "" if others is None else f"{others[0]:.3g} ({others[1]:.3g} to {others[2]:.3g})",
                f"{r['residual_sd']:+.1f}", "" if gain is None else f"{gain:+.1f}", f"{r['unexplained']:.2f}",
                r["uncertainty"],
            )
        )  # fmt: skip
    columns = (
        "outcome", "published", "sd", "believed", "extended (90 %)", "from all others (90 %)", "off by [sd]",
        "gain left out [nats]", "unexplained", "origin of sd",
    )  # fmt: skip
    text = "Gain: log score of the group predicted from all others, over the nominal model's."
    return Table(columns, rows, text)


def alternative_table(result: Mapping[str, Any]) -> Table:
    """Return what each family of sets costs, and by which outcomes."""
    rows = [
        (
            r["title"], f"{r['probability']:.2g}", "" if r["loss_nats"] is None else f"{r['loss_nats']:.1f}",
            "; ".join(f"{a['group']} ({a['misfit']:+.0f})" for a in r["against"]),
        )
        for r in result["alternatives"]
    ]  # fmt: skip
    columns = ("alternative", "probability", "best set loses [nats]", "outcomes against it (misfit more)")
    return Table(columns, rows, "Against the best set outside the alternative.")


def menu_table(result: Mapping[str, Any]) -> Table:
    """Return the measurements by what they would tell."""
    rows = [
        (
            r["what"], f"{r['minutes']:g}", f"{r['information_nats']:.2f} of {r['doubt_nats']:.2f}",
            ", ".join(f"{k} {v:.2f}" for k, v in sorted(r["about"].items(), key=lambda kv: -kv[1])[:3]),
        )
        for r in result["next_measurement"]["menu"]
    ]  # fmt: skip
    columns = ("measurement", "minutes", "information [nats]", "most about [nats]")
    return Table(columns, rows, "Expected information about which set is right.")
