"""Tables, plots and files of ``evanesce bench``: one function a test, from a bench file to its figures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.table import Table

from evanesce.cli.common import console, out_dir, write_figure, write_json, write_text
from evanesce.core.errors import InputError, WorkError

if TYPE_CHECKING:
    from evanesce.rig import Scene

Result = tuple[dict[str, Any], Path]
"""Figures of a test, and the folder with its files."""


def print_table(title: str, rows: list[tuple[str, str]]) -> None:
    """Print a table of two columns."""
    shown = Table(title=title, show_header=False)
    for name, value in rows:
        shown.add_row(name, value)
    console.print(shown)


@contextmanager
def names_file(file: Path) -> Iterator[None]:
    """Name the file in errors of an analysis: a file without such a test is bad input."""
    try:
        yield
    except InputError as error:
        raise InputError(error.what, file=error.file or file, key=error.key, allowed=error.allowed) from None
    except WorkError as error:
        raise InputError(str(error), file=file) from None


def finish(result: dict[str, Any], json_file: Path | None, folder: Path) -> None:
    """Write the result of a test as JSON and print its folder."""
    from evanesce.core import provenance

    result = {**result, "provenance": dict(provenance.record())}
    write_json(json_file, result)
    write_json(folder / "result.json", result)
    console.print(f"written to {folder}")


def _csv(path: Path, headings: str, columns: list[Any]) -> None:
    rows = (",".join(f"{v:.8g}" for v in row) for row in zip(*columns, strict=True))
    write_text(path, "\n".join([headings, *rows]) + "\n")


def write_indentation(file: Path, finger: float, indenter: float, nu: float, out: Path | None) -> Result:
    """Reduce an indentation test: radii of finger and indenter [mm], Poisson's ratio of the finger."""
    from evanesce.bench import indentation
    from evanesce.bench.plots import indentation_figure

    force, position = indentation.read_indentation(file)
    geometry = indentation.elliptic_geometry(finger, indenter)
    with names_file(file):
        r = indentation.analyse(force, position, geometry, nu)
    folder = out_dir(out, "bench-stiffness")
    write_figure(folder / "indentation.png", indentation_figure(r))
    headings = (
        "force_N,depth_mm,reduced_modulus_MPa,youngs_modulus_MPa,semi_major_mm,semi_minor_mm,"
        "mean_pressure_MPa,peak_pressure_MPa"
    )
    columns = [
        r.force, r.depth, r.reduced_modulus, r.youngs_modulus, r.semi_major, r.semi_minor,
        r.mean_pressure, r.peak_pressure,
    ]  # fmt: skip
    _csv(folder / "indentation.csv", headings, columns)
    print_table(
        "stiffness: elliptical Hertz",
        [
            ("E*(F)", f"{r.intercept:.4g} +- {r.intercept_se:.2g} MPa + ({r.slope:.4g} +- {r.slope_se:.2g}) MPa/N F"),
            ("Young's modulus", f"{r.youngs_modulus.min():.4g} to {r.youngs_modulus.max():.4g} MPa"),
            ("first contact at", f"{r.touch:.4g} mm; depth residual {r.depth_rms:.2g} mm RMS"),
            ("largest mean / peak pressure", f"{r.mean_pressure.max():.4g} / {r.peak_pressure.max():.4g} MPa"),
        ],
    )
    result = {
        "test": "indentation",
        "effective_radius_mm": geometry.effective_radius,
        "axis_ratio": geometry.axis_ratio,
        "force_range_N": [float(r.force.min()), float(r.force.max())],
        "reduced_modulus_intercept_MPa": r.intercept,
        "reduced_modulus_intercept_se_MPa": r.intercept_se,
        "reduced_modulus_slope_MPa_per_N": r.slope,
        "reduced_modulus_slope_se_MPa_per_N": r.slope_se,
        "first_contact_mm": r.touch,
        "depth_rms_mm": r.depth_rms,
        "youngs_modulus_MPa": [float(r.youngs_modulus.min()), float(r.youngs_modulus.max())],
        "mean_pressure_max_MPa": float(r.mean_pressure.max()),
        "peak_pressure_max_MPa": float(r.peak_pressure.max()),
    }
    return result, folder


def write_compression(file: Path, height: float | None, area: float | None, terms: int, out: Path | None) -> Result:
    """Fit Mooney-Rivlin to a compression test: undeformed height [mm] and section [mm^2], if the file has forces."""
    from evanesce.bench import compression
    from evanesce.bench.plots import compression_figure

    stretch, stress = compression.read_compression(file, height=height, area=area)
    try:
        fit = compression.fit_mooney_rivlin(stretch, stress, terms=terms)
    except ValueError as error:
        raise InputError(str(error), file=file) from None
    folder = out_dir(out, "bench-stiffness")
    write_figure(folder / "compression.png", compression_figure(stretch, stress, fit))
    names = ("C10", "C01", "C11")
    values = (fit.material.c10, fit.material.c01, fit.material.c11)
    rows = [
        (name, f"{v * 1e6:.5g} +- {se * 1e6:.2g} Pa")
        for name, v, se in zip(names, values, fit.standard_error, strict=True)
    ]
    limits = asdict(fit.limits)
    rows += [
        ("small-strain Young's modulus", f"{fit.material.youngs_modulus:.4g} MPa"),
        ("residual", f"{fit.rms:.3g} MPa; condition {fit.condition:.3g}"),
        *(
            (f"stable in {k.replace('_', ' ')} until", "beyond 8" if v is None else f"{v:.3f}")
            for k, v in limits.items()
        ),
    ]
    print_table("stiffness: Mooney-Rivlin", rows)
    result = {
        "test": "compression",
        **{f"{n}_Pa": v * 1e6 for n, v in zip(names, values, strict=True)},
        **{f"{n}_se_Pa": se * 1e6 for n, se in zip(names, fit.standard_error, strict=True)},
        "youngs_modulus_MPa": fit.material.youngs_modulus,
        "rms_MPa": fit.rms,
        "condition": fit.condition,
        "stretch_range": fit.stretch_range,
        "stability_limits": limits,
    }
    return result, folder


def write_finger(scene: Scene, result: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Write and print the finger's keys that a stiffness test gives, and the scene with them in place of its material.

    Raises
    ------
    InputError
        If a scene with them is not valid.
    """
    import tomli_w

    from evanesce.rig import copy_scene_files, dump_scene
    from evanesce.rig.finger import OWN, OWN_FIGURES

    if result["test"] == "indentation":
        intercept, slope = result["reduced_modulus_intercept_MPa"], result["reduced_modulus_slope_MPa_per_N"]
        forces = [float(f"{force:.4g}") for force in result["force_range_N"]]
        moduli = [float(f"{intercept + slope * force:.5g}") for force in forces]
        keys: dict[str, Any] = {"reduced_modulus": {"force_N": forces, "modulus_MPa": moduli}}
    else:
        keys = {"mooney_rivlin": {name: float(f"{result[name]:.6g}") for name in ("C10_Pa", "C01_Pa", "C11_Pa")}}
    keys = {"material": OWN} | keys
    data = scene.as_dict()
    data["finger"] = {key: value for key, value in data["finger"].items() if key not in OWN_FIGURES} | keys
    for name in ("assumptions", "sources"):
        data[name] = {key: why for key, why in data.get(name, {}).items() if not key.startswith("finger.material")}
    if "reduced_modulus_MPa" in data["contact"]:
        data["contact"] = {k: v for k, v in data["contact"].items() if not k.startswith("reduced_modulus")}
    changed = type(scene).from_dict(data)
    text = tomli_w.dumps({"finger": keys})
    write_text(folder / "finger.toml", text)
    copy_scene_files(changed, folder)
    write_text(folder / "scene.toml", dump_scene(changed))
    console.print("keys for the scene (finger.toml; scene.toml has them in place):", highlight=False)
    console.print(text.rstrip(), markup=False, highlight=False)
    if result["test"] == "indentation":
        console.print(
            "note: E* under an indenter; on flat glass the thesis's Silskin 0 % was less than half as stiff (5.5.1)",
            highlight=False,
        )
    return {"finger": keys}


def write_dma(file: Path, reference: float | None, out: Path | None) -> Result:
    """Fit a Prony series to a dynamic mechanical analysis at a reference temperature [degC]."""
    from evanesce.bench import dma, prony_fit
    from evanesce.bench.plots import dma_figure

    table = dma.read_dma(file)
    temperature = float(np.median(table.temperature)) if reference is None else reference
    shift: dict[str, Any] = {}
    reduced = table.frequency
    rows = []
    if np.ptp(table.temperature) > 0:
        master = prony_fit.fit_arrhenius(table.frequency, table.temperature, table.storage, temperature)
        reduced = master.reduced_frequency
        shift = {
            "activation_energy_kJ_per_mol": master.activation_energy_kJ_per_mol,
            "activation_energy_se_kJ_per_mol": master.activation_energy_se,
        }
        rows.append(
            (
                "activation energy",
                f"{master.activation_energy_kJ_per_mol:.4g} +- {master.activation_energy_se:.2g} kJ/mol",
            )
        )
    with names_file(file):
        fit = prony_fit.fit_prony(reduced, table.storage, table.loss_factor)
    folder = out_dir(out, "bench-dma")
    write_figure(folder / "dma.png", dma_figure(table, fit.series, reduced))
    _csv(folder / "prony.csv", "relaxation_time_s,modulus_MPa", [fit.series.times, fit.series.moduli])
    rows += [
        ("equilibrium / instantaneous modulus", f"{fit.series.equilibrium:.4g} / {fit.series.instantaneous:.4g} MPa"),
        ("terms", f"{len(fit.series.times)}, {min(fit.series.times):.2g} to {max(fit.series.times):.2g} s"),
        ("relative residual of E', E''", f"{fit.storage_rms:.2%}, {fit.loss_rms:.2%}"),
    ]
    print_table(f"DMA at {temperature:g} degC", rows)
    result = {
        "test": "dma",
        "reference_temperature_C": temperature,
        **shift,
        "equilibrium_MPa": fit.series.equilibrium,
        "moduli_MPa": list(fit.series.moduli),
        "times_s": list(fit.series.times),
        "storage_rms": fit.storage_rms,
        "loss_rms": fit.loss_rms,
    }
    return result, folder


def write_friction(
    files: list[Path], groups: list[str], smoothing: float | None, speeds: list[float], out: Path | None
) -> Result:
    """Reduce slides, one file each, and compare their groups; smoothing of the static peak [s], speeds [mm/s]."""
    from evanesce.bench import friction, friction_lines, statistics
    from evanesce.bench import plots as bench_plots

    traces = [friction.read_trace(file) for file in files]
    # files in two folders may have one name
    names = [file.stem for file in files]
    names = [str(file) if names.count(file.stem) > 1 else file.stem for file in files]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError("given twice", file=twice, allowed="each slide once")
    results, stable, spectra, lines = [], {}, [], []
    for file, name, trace in zip(files, names, traces, strict=True):
        with names_file(file):
            result = friction.analyse(trace, smoothing_s=smoothing)
        results.append(result)
        inside = (trace.time >= result.stable[0]) & (trace.time <= result.stable[1])
        coefficient = friction.coefficient_of_friction(trace)[inside]
        known = np.isfinite(coefficient)
        stable[name] = coefficient[known]
        spectra.append(friction.spectrum(trace.time[inside][known], coefficient[known]))
        lines.append(friction_lines.line_of(trace.time[inside][known], coefficient[known]))
    folder = out_dir(out, "bench-friction")
    write_figure(folder / "friction.png", bench_plots.friction_figure(traces, results, names))
    write_figure(
        folder / "histogram.png", bench_plots.histogram_figure(stable, "coefficient of friction, stable region [1]")
    )
    write_figure(folder / "spectrum.png", bench_plots.spectrum_figure(spectra[0], "1", lines[0]))
    slides = [
        {
            "file": file.name if name == file.stem else name,
            "group": group,
            **asdict(result),
            "mode": statistics.kernel_density_mode(stable[name]),
            "peak_frequency_hz": spectrum.peak,
            "peak_share": spectrum.peak_share,
            "line": {
                "frequency_hz": line.frequency, "over_background": line.over_background, "p_value": line.p_value,
                "found": line.found,
            },
        }
        for file, name, group, result, spectrum, line in zip(
            files, names, groups, results, spectra, lines, strict=True
        )
    ]  # fmt: skip
    _print_slides(slides)
    return {
        "test": "friction", "slides": slides, "line_source": _line_source(lines, speeds), **_compare(groups, results)
    }, folder  # fmt: skip


def _print_slides(slides: list[dict[str, Any]]) -> None:
    table = Table(title="friction", caption="dynamic: median +- robust spread over the stable region")
    for heading in ("file", "group", "static", "dynamic", "mode", "strongest frequency", "line [Hz]", "p of noise"):
        table.add_column(heading)
    for slide in slides:
        line = slide["line"]
        table.add_row(
            slide["file"], slide["group"], f"{slide['static']:.4f}",
            f"{slide['dynamic']:.4f} +- {slide['dynamic_spread']:.4f}",
            f"{slide['mode']:.4f}", f"{slide['peak_frequency_hz']:.4g} Hz ({slide['peak_share']:.0%})",
            f"{line['frequency_hz']:.4g}" if line["found"] else "-", f"{line['p_value']:.2g}",
        )  # fmt: skip
    console.print(table)


def _line_source(lines: list[Any], speeds: list[float]) -> dict[str, Any] | None:
    """Return, and say, whether lines go with the speed of the drive; None where that cannot be told."""
    from evanesce.bench.friction_lines import source_of

    found = source_of(lines, speeds) if speeds else None
    if found is None:
        if speeds:
            console.print("lines at fewer than two speeds: neither stick-slip nor the machine can be told")
        return None
    said = {
        "interface": "stick-slip of the interface (1)", "machine": "the machine's own vibration (0)",
        "open": "open: neither stick-slip (1) nor the machine (0) alone",
    }[found.verdict]  # fmt: skip
    console.print(
        f"lines go with speed to the power {found.exponent:.2f} (95 %: {found.low:.2f} to {found.high:.2f}): {said}"
    )
    return {**asdict(found), "verdict": found.verdict}


def _compare(groups: list[str], results: list[Any]) -> dict[str, Any]:
    """Return repeatability, and the analysis of variance where there are repeats in several groups."""
    from evanesce.bench import statistics

    compared: dict[str, Any] = {}
    for name in ("static", "dynamic"):
        sets: dict[str, list[float]] = {}
        for group, result in zip(groups, results, strict=True):
            sets.setdefault(group, []).append(getattr(result, name))
        entry: dict[str, Any] = {}
        if len(results) > len(sets):
            entry["repeatability"] = asdict(statistics.repeatability(sets))
            console.print(f"{name}: repeatability limit {entry['repeatability']['limit']:.3g}")
        if len(sets) > 1 and min(map(len, sets.values())) > 1:
            anova = statistics.one_way_anova(sets)
            entry["anova"] = asdict(anova)
            verdict = "differ" if anova.significant else "do not differ significantly"
            console.print(f"{name}: groups {verdict} (F = {anova.f_statistic:.4g}, p = {anova.p_value:.3g})")
            for pair in anova.pairs:
                console.print(
                    f"  {pair.first} - {pair.second}: {pair.difference:.4g} [{pair.low:.4g}, {pair.high:.4g}],"
                    f" p = {pair.p_value:.3g}"
                )
        if entry:
            compared[name] = entry
    return compared


def write_profile(
    file: Path, pitch: float | None, unit: str, form: int, design: dict[str, float], out: Path | None
) -> Result:
    """Reduce a ridge profile or height map: sample distance and design figures [mm]."""
    from evanesce.bench import plots as bench_plots
    from evanesce.bench import profile, relief, surface_files

    if file.suffix.lower() == ".csv" and not surface_files.is_matrix(file):
        x, z = surface_files.read_profile(file)
        with names_file(file):
            result = profile.analyse_profile(x, z, form)
        flat = profile.remove_form(z, form)
        folder = out_dir(out, "bench-profile")
        write_figure(folder / "profile.png", bench_plots.profile_figure(x, flat, result))
        step = float(np.median(np.diff(x)))
        samples = min(2048, max(64, round(float(np.ptp(x)) / step)))
        with names_file(file):
            tiled = result.pitch.count > 0
            surface = relief.height_map_of_profile(x, z, (samples, samples), step, form) if tiled else None
    else:
        if pitch is None:
            raise InputError(
                "a height map needs its sample distance", file=file, key="--pitch-um", allowed="in um, > 0"
            )
        scan = surface_files.read_map(file, pitch, unit)
        with names_file(file):
            result = profile.analyse_map(scan.height, scan.pitch, form_degree=form)
            surface = relief.height_map_of_scan(scan.height, scan.pitch, form)
        folder = out_dir(out, "bench-profile")
        write_figure(folder / "map.png", bench_plots.map_figure(surface.height, scan.pitch, result))
    against = profile.against_design(result, design)
    rows = []
    for name in ("height", "width", "pitch", "edge", "crest_radius"):
        spread = getattr(result, name)
        text = f"{1e3 * spread.mean:.2f} +- {1e3 * spread.std:.2f} um (n = {spread.count})" if spread.count else "-"
        if name in against:
            text += f"; design {1e3 * design[name]:.4g} um: {against[name]['relative_deviation']:+.1%}"
        rows.append((name.replace("_", " "), text))
    print_table("ridges", rows)
    if surface is not None:
        temporary = folder / ".height_map.part.npz"
        np.savez_compressed(temporary, distance_mm=surface.distance, pitch_mm=surface.pitch)
        temporary.replace(folder / "height_map.npz")
    summary = {
        "test": "profile",
        **{f"{k}_mm": asdict(getattr(result, k)) for k in ("height", "width", "pitch", "edge", "crest_radius")},
        "orientation_deg": float(np.degrees(result.orientation)),
        "lines": result.lines,
        "against_design": against,
        "height_map": None if surface is None else "height_map.npz",
    }
    return summary, folder
