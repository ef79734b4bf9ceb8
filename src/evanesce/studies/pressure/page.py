"""Page of the pressure study."""

from __future__ import annotations

from matplotlib.figure import Figure

from evanesce.report.html import Page, Picture, Section, Table, figure_png
from evanesce.studies.pressure.study import PressureStudy


def number(value: float | None) -> str:
    """Return a correlation for a table."""
    return "none" if value is None else f"{value:.3f}"


def maps_figure(study: PressureStudy) -> Figure:
    """Draw true pressure, both maps and their errors [MPa]."""
    figure = Figure(figsize=(11.0, 6.2), layout="constrained")
    axes = figure.subplots(2, 3)
    true = study.maps["true"]
    top = float(true.max())
    for k, (name, title) in enumerate((("true", "true"), ("model", "roughness model"), ("reference", "author's map"))):
        shown = axes[0, k].imshow(study.maps[name], vmin=0, vmax=top, cmap="viridis")
        axes[0, k].set_title(title)
        if name != "true":
            error = axes[1, k].imshow(study.maps[name] - true, vmin=-0.5 * top, vmax=0.5 * top, cmap="RdBu_r")
            axes[1, k].set_title(f"{title} less true")
    figure.colorbar(shown, ax=axes[0], label="pressure [MPa]")
    figure.colorbar(error, ax=axes[1], label="error [MPa]")
    row = true.shape[0] // 2
    for name in ("true", "model", "reference"):
        axes[1, 0].plot(study.maps[name][row], label=name)
    axes[1, 0].set_xlabel("column [px]")
    axes[1, 0].set_ylabel("pressure [MPa]")
    axes[1, 0].legend(fontsize=8)
    for axis in (*axes[0], *axes[1, 1:]):
        axis.set_xlabel("[px]")
    return figure


def page(study: PressureStudy) -> Page:
    """Return the report of the pressure study."""
    pictures = []
    if study.maps:
        pictures.append(
            Picture(
                figure_png(maps_figure(study)),
                "Light grows less than pressure does: read as pressure, grey levels are too flat, and the tone curve "
                "and the dilated rim make them flatter.",
                alt="maps of pressure",
            )
        )
    table = Table(
        (
            "RMS slope", "force [N]", "voltage [V]", "true peak [MPa]", "saturated", "RMS error [% of peak]",
            "author's [%]", "correlation", "author's", "force beside the contact [%]", "author's [%]", "factor",
        ),
        [
            (
                f"{r.rms_slope:g}", f"{r.force_N:g}", f"{r.voltage_V:g}", f"{r.peak_MPa:.3f}",
                f"{r.saturated_share:.2f}", f"{r.rms_percent:.1f}", f"{r.reference_rms_percent:.1f}",
                number(r.correlation), number(r.reference_correlation), f"{r.halo_percent:.1f}",
                f"{r.reference_halo_percent:.1f}", f"{r.factor:.3f}",
            )
            for r in study.rows
        ],
        "Both maps carry the measured force.",
    )  # fmt: skip
    return Page(
        title="Pressure from grey levels",
        lead="The roughness model turned round, with the force as its scale, beside the author's map. The model is the "
        "simulation's own: what remains is noise, blur, uneven light and saturation.",
        sections=[Section("Maps and errors", pictures=pictures, tables=[table])],
        provenance=study.provenance,
    )
