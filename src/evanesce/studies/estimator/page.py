"""Pages of the estimator and of the uncertainty budget."""

from __future__ import annotations

from matplotlib.figure import Figure

from evanesce.report.html import Page, Picture, Section, Table, figure_png
from evanesce.studies.budget.study import BudgetStudy
from evanesce.studies.estimator.study import EstimatorStudy

FACTOR_PARTS = (
    "card print", "card height", "lens distance", "scale fit", "threshold on the card", "scale over the view",
)  # fmt: skip
"""Components that the conversion factor owes its uncertainty to; the others are the contact's boundary."""


def estimator_figure(study: EstimatorStudy) -> Figure:
    """Draw the error of both estimators against voltage, one panel a finger."""
    fingers = list(dict.fromkeys(row.finger for row in study.rows))
    columns = min(3, len(fingers))
    lines = -(-len(fingers) // columns)
    figure = Figure(figsize=(4.2 * columns, 3.1 * lines), layout="constrained")
    axes = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for axis, finger in zip(axes, fingers, strict=False):
        for place, marker in (("centre", "o"), ("corner", "s")):
            for force in dict.fromkeys(row.force_N for row in study.rows):
                own = [r for r in study.rows if (r.finger, r.place, r.force_N) == (finger, place, force)]
                volts = [r.voltage_V for r in own]
                style = {"marker": marker, "ms": 4, "lw": 0.8, "alpha": 0.8}
                axis.plot(volts, [r.reference_percent for r in own], color="C1", **style)
                axis.plot(volts, [r.refined_percent for r in own], color="C0", **style)
        axis.axhspan(-2, 2, color="C0", alpha=0.12)
        axis.set_yscale("symlog", linthresh=5)
        axis.set_title(finger, fontsize=10)
        axis.set_xlabel("LED voltage [V]")
        axis.set_ylabel("area error [%]")
        axis.label_outer()
    for axis in axes[len(fingers) :]:
        axis.set_axis_off()
    axes[0].plot([], [], color="C1", label=f"reference segmentation, threshold {study.threshold:g}")
    axes[0].plot([], [], color="C0", label="refined")
    axes[0].legend(fontsize=7, loc="upper left")
    return figure


def estimator_page(study: EstimatorStudy) -> Page:
    """Return the report of the estimator study."""
    picture = Picture(
        figure_png(estimator_figure(study)),
        "The author's error follows the light; the refined estimator's hardly does. Circles: centre, squares: corner; "
        "one line a force. The band is 2 %.",
        alt="area error against voltage for both estimators",
    )
    summary = Table(
        ("finger", "place", "frames", "refined RMS [%]", "refined worst [%]", "author RMS [%]", "author worst [%]"),
        [
            (
                w["finger"], w["place"], str(w["frames"]), f"{w['refined_rms_percent']:.2f}",
                f"{w['refined_worst_percent']:+.2f}", f"{w['reference_rms_percent']:.1f}",
                f"{w['reference_worst_percent']:+.1f}",
            )
            for w in study.worst()
        ],
        "Over voltages and forces.",
    )  # fmt: skip
    rows = Table(
        ("finger", "place", "force [N]", "voltage [V]", "true [mm²]", "author [%]", "refined [%]", "saturated"),
        [
            (
                r.finger, r.place, f"{r.force_N:g}", f"{r.voltage_V:g}", f"{r.true_mm2:.3f}",
                f"{r.reference_percent:+.2f}", f"{r.refined_percent:+.2f}", f"{r.saturated_share:.2f}",
            )
            for r in study.rows
        ],
        "Every frame.",
    )  # fmt: skip
    return Page(
        title="The refined estimator beside the reference segmentation",
        lead="Area errors of both, blind: they see frames and a calibration only. Glow is the renderer's own model, "
        "whose inverse the refined estimator uses; on a real finger that part will be less exact.",
        sections=[
            Section("Error against voltage", pictures=[picture], tables=[summary]),
            Section("Frames", tables=[rows]),
        ],
        provenance=study.provenance,
    )


def budget_page(study: BudgetStudy) -> Page:
    """Return the report of the uncertainty budget."""
    names = list(study.classes[0].contributions_percent)
    figure = Figure(figsize=(7.0, 0.5 + 0.45 * len(names)), layout="constrained")
    axis = figure.subplots()
    height = 0.8 / len(study.classes)
    for k, found in enumerate(study.classes):
        at = [n + (k - (len(study.classes) - 1) / 2) * height for n in range(len(names))]
        axis.barh(at, [found.contributions_percent[n] for n in names], height, label=f"{found.finger}, {found.place}")
    axis.set_yticks(range(len(names)), names)
    axis.invert_yaxis()
    axis.set_xlabel("standard uncertainty of the area [%]")
    axis.legend(fontsize=8)
    picture = Picture(
        figure_png(figure), "What the refined area's uncertainty is made of.", alt="contributions to the uncertainty"
    )
    table = Table(
        (
            "finger", "place", "measurements", "covered [%]", "linear [%]", "half-width [%]", "mean error [%]",
            "author covered [%]", "author half-width [%]", "author mean error [%]",
        ),
        [
            (
                c.finger, c.place, str(c.measurements), f"{100 * c.refined_covered:.1f}",
                f"{100 * c.refined_linear_covered:.1f}", f"{c.refined_half_width_percent:.2f}",
                f"{c.refined_bias_percent:+.2f}", f"{100 * c.reference_covered:.1f}",
                f"{c.reference_half_width_percent:.2f}", f"{c.reference_bias_percent:+.2f}",
            )
            for c in study.classes
        ],
        "Share of measurements whose stated 95 % interval holds the true area.",
    )  # fmt: skip
    return Page(
        title="Uncertainty of an area",
        lead="Cards and corners are drawn anew for each measurement, and one of each class's "
        f"{study.classes[0].frames} frames; the interval must hold the truth. Print, height and edges of the cards are "
        "drawn from the distributions that the budget assumes: this tests the propagation and the estimators, not what "
        "is assumed of cards.",
        sections=[Section("Budget and coverage", pictures=[picture], tables=[table, *_budgets(study)])],
        provenance=study.provenance,
    )


def _budgets(study: BudgetStudy) -> list[Table]:
    """Return the contributions of each class, a table for each chain; what enters the conversion factor is marked."""
    heads = ("component", "in the conversion factor", *(f"{c.finger}, {c.place} [%]" for c in study.classes))
    tables = []
    for chain, shares in (
        ("Refined", [c.contributions_percent for c in study.classes]),
        ("Author's chain", [c.reference_contributions_percent for c in study.classes]),
    ):
        names = list(dict.fromkeys(name for share in shares for name in share))
        lines = [
            (name, "yes" if name in FACTOR_PARTS else "", *(f"{share.get(name, 0.0):.3f}" for share in shares))
            for name in names
        ]
        factor = [sum(share.get(n, 0.0) ** 2 for n in FACTOR_PARTS) ** 0.5 for share in shares]
        lines.append(("conversion factor, together", "yes", *(f"{value:.3f}" for value in factor)))
        if names:
            tables.append(Table(heads, lines, f"{chain}: median standard uncertainty of the area by component."))
    return tables
