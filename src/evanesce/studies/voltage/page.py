"""The page of ``evanesce study voltage``."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from skimage.measure import find_contours

from evanesce.measurement.reference.segment import Chain, segment
from evanesce.report.html import Page, Picture, Section, Table, figure_png
from evanesce.studies.voltage.analysis import CONVERGED_V, ONSET_V, RISE
from evanesce.studies.voltage.page_colour import range_labels, shares_section, states_section
from evanesce.studies.voltage.sources import SOURCES
from evanesce.studies.voltage.study import VoltageStudy
from evanesce.studies.voltage.unknowns import FLAT, SEEN, THRESHOLDS

COLOURS = {"subsurface scattering": "tab:orange", "blur": "tab:blue", "saturation": "tab:red", "specks": "tab:green"}
OUTPUTS = {
    "onset_V": "voltage at which the patch appears",
    "converged_V": "voltage from which the estimate is within 5 % of its last",
    "excess_at_9V": "log of estimate over truth (plus 1) at 9 V",
}


def page(found: VoltageStudy) -> Page:
    """Return the report of one study.

    Parameters
    ----------
    found : VoltageStudy

    Returns
    -------
    Page
    """
    held = found.shares(found.main)
    onsets = ", ".join(f"{found.scene_voltages(f)[0]:.2f} V at {f:g} N" for f in found.forces)
    lead = (
        f"At a fixed threshold of {found.threshold:g} this scene's patch appears at {onsets} and its estimated area "
        f"goes on rising with voltage. Over all that is not published about the rig, {_percent(held['vanishes'])} of "
        f"the possible rigs lose their patch near 8 V, {_percent(held['rises'])} see the estimate rise, "
        f"{_percent(held['settles'])} have converged by 9 V, and {_percent(held['all'])} show all three. Cut at "
        f"{found.best.ratio:g} of the contact's own light instead of at a fixed grey level, the median error is "
        f"{100 * found.best.ratio_error:.1f} %."
    )
    sections = [_curves(found), _frames(found), _grooves(found), _bins(found), _observation(found)]
    if found.colour is not None:
        sections += [shares_section(found.colour), states_section(found.colour)]
    return Page(
        f"Voltage study of {found.scene.title or 'a scene'}",
        lead,
        [*sections, _sensitivity(found), _best(found), _method(found)],
        found.provenance,
    )


def _plain(value: float) -> str:
    """Return two decimals, without the sign of a zero."""
    return f"{round(value, 2) + 0.0:.2f}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _figure(cols: int = 1, width: float = 9.0, height: float = 4.2) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(1, cols, squeeze=False)[0]


def curves_figure(found: VoltageStudy) -> Figure:
    """Return estimated and true area against voltage, and what each source adds, one panel a force.

    Parameters
    ----------
    found : VoltageStudy

    Returns
    -------
    Figure
    """
    figure, axes = _figure(len(found.forces), 5.0 * len(found.forces), 4.4)
    for panel, force in zip(axes, found.forces, strict=True):
        rows = found.curves[force]
        v = [row.voltage_V for row in rows]
        panel.plot(v, [row.area_mm2 for row in rows], "k-o", markersize=3, label="estimated")
        panel.axhline(rows[0].true_area_mm2, color="k", linestyle="--", label="true")
        for source in SOURCES:
            added = [row.parts_mm2[source] for row in rows]
            panel.plot(v, added, color=COLOURS[source], label=f"added by {source}")
        panel.plot(v, [row.residual_mm2 for row in rows], color="0.6", linestyle=":", label="excess without the four")
        panel.plot(v, [row.interaction_mm2 for row in rows], color="0.6", linestyle="-.", label="interaction")
        panel.set_title(f"{force:g} N, threshold {found.threshold:g}")
        panel.set_xlabel("LED voltage [V]")
        panel.set_ylabel("area [mm²]")
    axes[0].legend(fontsize=8)
    return figure


def _curves(found: VoltageStudy) -> Section:
    tables = []
    for force, rows in found.curves.items():
        shown = [row for row in rows if abs(2 * row.voltage_V - round(2 * row.voltage_V)) < 1e-6]
        lines = []
        for row in shown:
            excess = row.area_mm2 - row.true_area_mm2
            scattered = row.parts_mm2["subsurface scattering"]
            share = f"{100 * scattered / excess:.0f}" if excess > 0.01 * row.true_area_mm2 else "-"
            parts = [_plain(row.parts_mm2[s]) for s in SOURCES]
            lines.append(
                (f"{row.voltage_V:g}", f"{row.area_mm2:.2f}", f"{row.true_area_mm2:.2f}", f"{excess:.2f}", *parts,
                 _plain(row.residual_mm2), _plain(row.interaction_mm2), share)
            )  # fmt: skip
        columns = ("voltage [V]", "estimated [mm²]", "true [mm²]", "excess [mm²]", *(f"{s} [mm²]" for s in SOURCES),
                   "residual [mm²]", "interaction [mm²]", "scattering / excess [%]")  # fmt: skip
        tables.append(Table(columns, lines, f"{force:g} N"))
    text = (
        "Each source is switched off in turn; its part is what it adds while the others are present. Without "
        "subsurface scattering the contact also keeps the light that would leave sideways, so that its part may be "
        "negative where the patch is barely bright enough. Saturation clips the contact, not its rim, so that a "
        "threshold below full scale is insensitive to it. Residual is the excess with all "
        "four switched off. Parts, residual and interaction add up to the excess."
    )
    caption = "Estimated area against voltage at a fixed threshold, the true area, and what each source adds."
    return Section("Area against voltage", [text], [Picture(figure_png(curves_figure(found)), caption)], tables)


def frames_figure(found: VoltageStudy) -> Figure:
    """Return frames at some voltages with the estimate outlined.

    Parameters
    ----------
    found : VoltageStudy

    Returns
    -------
    Figure
    """
    figure, axes = _figure(len(found.frames), 2.6 * len(found.frames), 2.9)
    for panel, (volts, frame) in zip(axes, found.frames.items(), strict=True):
        panel.imshow(frame, cmap="gray", vmin=0, vmax=255)
        mask = segment(frame, Chain(threshold=found.threshold)).mask
        for line in find_contours(mask.astype(float), 0.5):
            panel.plot(line[:, 1], line[:, 0], color="tab:red", linewidth=0.7)
        panel.set_title(f"{volts:g} V", fontsize=10)
        panel.axis("off")
    return figure


def _frames(found: VoltageStudy) -> Section:
    caption = f"{found.forces[0]:g} N: frames, and in red the contact by threshold {found.threshold:g}."
    return Section("What the camera sees", pictures=[Picture(figure_png(frames_figure(found)), caption)])


def _grooves(found: VoltageStudy) -> Section:
    rows = [
        (f"{g.force_N:g}", f"{g.reduced_modulus_MPa:.3f}", f"{g.peak_pressure_MPa:.3f}",
         f"{g.closure_pressure_MPa:.3f}", "open" if g.open_middle else "closed", f"{100 * g.contact_share:.0f}")
        for g in found.grooves
    ]  # fmt: skip
    closed = [g for g in found.grooves if not g.open_middle]
    text = "Grooves are open in the middle of the contact at every force of the study."
    if closed:
        shares = found.samples.open_middle[found.samples.independent].mean(axis=0)
        sampled = ", ".join(f"{_percent(s)} at {f:g} N" for f, s in zip(found.forces, shares, strict=True))
        text = (
            f"At {', '.join(f'{g.force_N:g}' for g in closed)} N the pressure in the middle exceeds what closes the "
            "grooves: the silicone fills them and no groove is left for light. Light that enters still lights "
            "open grooves near the rim, and the skin around the contact. Grooves that stay open to the middle at "
            "these forces need stiffer, higher or closer ridges than the published figures give (or air shut in "
            f"under them, which is not modelled): among the sampled rigs they are open in {sampled}. If the thesis "
            "saw bright lines in the middle at 5 N, its ridges were stiffer than its own modulus says."
        )
    columns = ("force [N]", "E* [MPa]", "peak pressure [MPa]", "pressure that closes [MPa]", "grooves in the middle",
               "true area / smooth finger's [%]")  # fmt: skip
    return Section("Are there grooves at all?", [text], tables=[Table(columns, rows)])


def _bins(found: VoltageStudy) -> Section:
    figure, axes = _figure(1, 7.5, 4.0)
    for k, entry in enumerate(found.bins):
        shade = str(0.75 * k / len(found.bins))
        axes[0].plot(found.voltages, entry["area_over_true"][0], color=shade, label=f"{entry['forward_voltage_V']:g} V")
    axes[0].axhline(1.0, color="tab:red", linestyle="--")
    axes[0].set_xlabel("LED voltage [V]")
    axes[0].set_ylabel(f"estimated / true area, {found.forces[0]:g} N")
    axes[0].legend(title="bin", fontsize=8)
    rows = [
        (f"{e['forward_voltage_V']:g}", *(f"{v:.2f}" for v in e["onset_V"]), *(f"{v:.2f}" for v in e["converged_V"]))
        for e in found.bins
    ]
    columns = (
        "forward voltage at 20 mA [V]",
        *(f"appears, {f:g} N [V]" for f in found.forces),
        *(f"converged, {f:g} N [V]" for f in found.forces),
    )
    text = (
        "Below its knee an LED's current falls by a factor of ten in a few tenths of a volt, so that the patch "
        "vanishes within such a span, at a voltage that depends on the bin. Exposure and threshold move it as "
        "well, but only with their logarithm."
    )
    picture = Picture(figure_png(figure), "The same finger, exposure and threshold with LEDs of other bins.")
    return Section("The LEDs' bin", [text], [picture], [Table(columns, rows)])


def holds_figure(found: VoltageStudy) -> Figure:
    """Return where in each unknown's range the patch vanishes near 8 V, converges by 9 V, and all is seen.

    Parameters
    ----------
    found : VoltageStudy

    Returns
    -------
    Figure
    """
    unknowns = found.samples.plan.unknowns
    figure, axes = _figure(len(unknowns), 2.4 * len(unknowns), 3.2)
    last = "all, exposure control from 9 V" if found.colour is None else "all three"
    series = {
        "vanishes near 8 V": ("vanishes", "tab:blue"),
        "converged by 9 V": ("settles", "tab:orange"),
        last: ("exposure control from 9 V" if found.colour is None else found.main, "k"),
    }
    for k, panel in enumerate(axes):
        for j, (label, (key, colour)) in enumerate(series.items()):
            entry = found.holds[key][k]
            place = np.arange(len(entry["share"])) + 0.27 * (j - 1)
            panel.bar(place, 100 * np.nan_to_num(entry["share"]), 0.25, color=colour, label=label)
        borders = entry["borders"]
        panel.set_xticks(range(len(entry["share"])), range_labels(unknowns[k], borders), fontsize=6)
        unit = "" if entry["unit"] == "1" else f" [{entry['unit']}]"
        panel.set_title(entry["unknown"].replace("_", " ") + unit, fontsize=9)
        panel.set_ylim(0, 100)
    axes[0].set_ylabel("rigs [%]")
    axes[0].legend(fontsize=6)
    return figure


def _observation(found: VoltageStudy) -> Section:
    rows = [
        (name, *(_percent(v) for v in found.shares(name).values()))
        for name in found.readings
    ]  # fmt: skip
    plain = found.readings[found.main]
    some = found.samples.independent
    near = some[(plain.vanishes & plain.rises)[some]]
    settled = (
        f"Among the {near.size} rigs that lose the patch near 8 V and see it rise, the voltage of convergence is "
        f"{_span(plain.settled[near])} V (5, 50 and 95 %)."
        if near.size >= 10
        else f"Only {near.size} rigs of the sample lose the patch near 8 V and see it rise."
    )
    text = [
        f"A rig shows what the thesis saw if, at every force, the patch appears (at {100 * SEEN:g} % of its true area) "
        f"between {ONSET_V[0]:g} and {ONSET_V[1]:g} V; if the estimate then grows by at least {100 * RISE:g} % of the "
        f"truth and never falls; and if from {CONVERGED_V:g} V at the latest it stays within {100 * FLAT:g} % of its "
        "value at the last voltage. " + settled,
        "From 9 to 12 V the LEDs still become several times brighter, and light beside the contact falls off "
        "gradually, so that a fixed threshold at a fixed exposure goes on taking in more of it. A plateau so needs "
        "something that stops the light from growing. A camera that controls its own exposure does just that; "
        "whether the thesis's did is not published, and the last reading supposes it from 9 V on. It makes the "
        "plateau true by construction: what it leaves to be explained is the other two.",
    ]
    if found.colour is not None:
        text = text[:1]
    columns = ("reading", "vanishes near 8 V", "rises", "converged by 9 V", "all three")
    picture = Picture(
        figure_png(holds_figure(found)), "Share of the sampled rigs in each third of an unknown's range, all else free."
    )
    unknowns = [
        (u.name.replace("_", " "), f"{u.low:g} to {u.high:g}", u.unit, "log" if u.logarithmic else "even", u.why)
        for u in found.samples.plan.unknowns
    ]
    return Section(
        "For which rigs does the thesis's observation follow?",
        text,
        [picture],
        [Table(columns, rows), Table(("unknown", "range", "unit", "spread", "why"), unknowns)],
    )


def _span(values: Any) -> str:
    return " / ".join(f"{v:.2f}" for v in np.percentile(values, (5, 50, 95)))


def _sensitivity(found: VoltageStudy) -> Section:
    figure, axes = _figure(len(OUTPUTS), 4.2 * len(OUTPUTS), 3.6)
    tables = []
    for panel, (key, words) in zip(axes, OUTPUTS.items(), strict=True):
        entries = found.indices[key]
        place = np.arange(len(entries))
        for offset, kind, colour in ((-0.2, "first", "tab:blue"), (0.2, "total", "tab:orange")):
            panel.barh(
                place + offset, [e[kind] for e in entries], 0.38, color=colour, label=kind,
                xerr=[e[f"{kind}_95"] for e in entries], ecolor="0.4",
            )  # fmt: skip
        panel.set_yticks(place, [e["unknown"].replace("_", " ") for e in entries], fontsize=8)
        panel.set_title(words, fontsize=8)
        rows = [
            (e["unknown"].replace("_", " "), f"{e['first']:.2f} ± {e['first_95']:.2f}",
             f"{e['total']:.2f} ± {e['total_95']:.2f}")
            for e in entries
        ]  # fmt: skip
        tables.append(Table(("unknown", "first order", "total"), rows, f"Sobol' indices: {words}"))
    axes[0].legend(fontsize=8)
    text = (
        f"{len(found.samples.values)} rigs (Saltelli's scheme), each with contact, light, exposure and threshold of "
        "its own. First order: share of the variance that this unknown explains alone; total: with all that it does "
        "together with others. ± is a 95 % half-width by bootstrap."
    )
    return Section(
        "Sensitivity", [text], [Picture(figure_png(figure), "First-order and total Sobol' indices.")], tables
    )


def best_figure(found: VoltageStudy) -> Figure:
    """Return the scene's area error by voltage and threshold, and the rigs' errors by cutting ratio.

    Parameters
    ----------
    found : VoltageStudy

    Returns
    -------
    Figure
    """
    figure, axes = _figure(1, 7.5, 4.4)
    shown = axes[0].pcolormesh(
        found.voltages, THRESHOLDS, 100 * np.minimum(found.error_map, 1.0).T, cmap="viridis_r", shading="nearest"
    )
    volts, level, _ = found.scene_best
    axes[0].plot(volts, level, "r+", markersize=12, label=f"minimum: {volts:g} V, {level:g}")
    axes[0].set_xlabel("LED voltage [V]")
    axes[0].set_ylabel("threshold")
    axes[0].legend(loc="upper left", fontsize=8)
    figure.colorbar(shown, ax=axes[0], label="area error, RMS over forces [%], cut at 100")
    return figure


def _best(found: VoltageStudy) -> Section:
    b, (volts, level, error) = found.best, found.scene_best

    def three(values: tuple[float, float, float], scale: float = 1.0) -> str:
        return " / ".join(f"{scale * v:.3g}" for v in values)

    def two(values: tuple[float, float], scale: float = 1.0) -> str:
        return " to ".join(f"{scale * v:.3g}" for v in values)

    rows = [
        ("this scene, full chain", f"{volts:g}", f"{level:g}", f"{100 * error:.1f}"),
        ("each rig at its own best (5 / 50 / 95 %)", three(b.own_voltage_V), three(b.own_threshold),
         three(b.own_error, 100)),
        ("one setting for all rigs", f"{b.voltage_V:g} ({two(b.voltage_interval_V)})",
         f"{b.threshold:g} ({two(b.threshold_interval)})", f"{100 * b.error:.0f} ({two(b.error_interval, 100)})"),
        ("cut at a share of the contact's own light", "any, unsaturated", f"{b.ratio:g} ({two(b.ratio_interval)})",
         f"{100 * b.ratio_error:.1f} ({two(b.ratio_error_interval, 100)})"),
    ]  # fmt: skip
    text = [
        "Voltage, exposure and threshold are confounded: what matters is where the threshold lies between the light of "
        "the contact and that of its surroundings. So the setting of smallest error is a valley, not a point, and a "
        "voltage without an exposure cannot be transferred to another rig. In brackets: 5 to 95 % by bootstrap over "
        f"{b.rigs} independent rigs; errors are medians over the rigs.",
        f"A cut at {b.ratio:g} of the mean linear light of the contact itself needs no voltage: its error is "
        f"{three(b.ratio_errors, 100)} % (5, 50 and 95 % of the rigs). It asks for raw or linearised frames that do "
        "not saturate.",
    ]
    columns = ("what is set", "voltage [V]", "threshold, or share of light", "area error [%]")
    picture = Picture(figure_png(best_figure(found)), "This scene: area error by voltage and threshold, full chain.")
    return Section("Voltage and threshold of smallest error", text, [picture], [Table(columns, rows)])


def _method(found: VoltageStudy) -> Section:
    text = [
        "Rendered by the fast renderer once per force and source switched off; light is linear in LED power, so other "
        "voltages are scaled, exposed with the same noise and segmented anew. Lens distortion is taken as undone. The "
        "sampled rigs are seen on the contact grid with one Gaussian for lens and chain and without noise, rounding, "
        "specks or removal of blobs; on this scene that differs from the full chain by at most "
        f"{100 * found.reduced_difference[0]:.0f} % up to 9 V and {100 * found.reduced_difference[1]:.0f} % at any "
        "voltage: above, the estimate takes in the finger's flank and its outline, which the sampled rigs do not have. "
        "Rigs whose estimate has reached the border of their skin do not count as converged.",
        "Not varied: the body's reflectance and the plate's losses, which act like exposure to first order; "
        "roughness; droop and warming of the LEDs.",
    ]
    if found.notes:
        text.append("Added where the scene states nothing: " + "; ".join(found.notes) + ".")
    return Section("How it was computed", text)
