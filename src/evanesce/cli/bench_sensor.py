"""``evanesce bench sensor``: tables and stacks of frames -> EMVA 1288 figures, plots, keys for a scene."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evanesce.cli import bench_output as output
from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    out_dir,
    progress,
    write_figure,
    write_text,
)
from evanesce.core.errors import InputError

if TYPE_CHECKING:
    from evanesce.bench.sensor import SensorFigures, Transfer
    from evanesce.rig import Scene


def sensor(
    paths: Annotated[
        list[Path],
        typer.Argument(help="Tables mean_DN,variance_DN2[,class] and exposure_s,variance_DN2; or a folder of frames."),
    ],
    black_level: Annotated[
        float | None,
        typer.Option(
            "--black-level-DN",
            min=0.0,
            help="Of tables, and of stacks without covered frames; the scene's, 256 without one.",
        ),
    ] = None,
    bits: Annotated[
        int | None, typer.Option("--bits", min=8, max=16, help="Of the converter; the scene's, 12 without one.")
    ] = None,
    analogue_gain: Annotated[
        list[float] | None, typer.Option("--analogue-gain", help="Of all files, or one for each; 1 by default.")
    ] = None,
    mosaic: Annotated[str | None, typer.Option("--mosaic", help="Of frames: BGGR, RGGB, GRBG or GBRG.")] = None,
    raw_size: Annotated[str | None, typer.Option("--raw-size", help="COLSxROWS of headerless .raw frames.")] = None,
    temperature: Annotated[
        list[float] | None, typer.Option("--temperature-C", help="One for each dark table, in their order.")
    ] = None,
    gain: Annotated[
        float | None,
        typer.Option("--gain-e-per-DN", help="At analogue gain 1; for dark tables alone, to give electrons."),
    ] = None,
    scene: Annotated[
        str | None, typer.Option("--scene", help="Scene with this camera: its keys are written with these figures.")
    ] = None,
    terms: Annotated[
        bool, typer.Option("--terms", help="Also: what the sensor model of the scene (or the default one) lacks.")
    ] = False,
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Conversion gain, read noise, PRNU, dark current with its temperature law and linearity, by EMVA 1288."""
    check_json_target(json_file)
    if mosaic is not None and mosaic.upper() not in ("BGGR", "RGGB", "GRBG", "GBRG"):
        raise InputError(f"{mosaic!r}", key="--mosaic", allowed="BGGR, RGGB, GRBG, GBRG")
    if gain is not None and not 0.0 < gain < 1e4:
        raise InputError(f"{gain:g}", key="--gain-e-per-DN", allowed="above 0, to 10000")
    from evanesce.rig.camera import Pixel

    loaded, nominal = None, Pixel()
    if scene is not None:
        from evanesce.rig import load_scene

        loaded = load_scene(scene)
        nominal = loaded.camera.pixel
    bits = nominal.bits if bits is None else bits
    black_level = nominal.black_level_DN if black_level is None else black_level
    if black_level >= 2**bits:
        raise InputError(f"{black_level:g}", key="--black-level-DN", allowed=f"below {2**bits} DN")
    gains = _gains(analogue_gain, len(paths))
    figures, each = _figures(
        paths, gains, black_level, bits, mosaic and mosaic.upper(), _size(raw_size), temperature or []
    )
    result = _summary(figures, each, gain)
    _print(figures, result)
    if terms:
        from evanesce.cli.bench_sensor_terms import lacking_terms

        result["lacking"] = lacking_terms(figures.transfers, each, figures.dark, nominal)
    folder = out_dir(out, "bench-sensor")
    _write(figures, folder)
    if loaded is not None:
        result["keys"] = _write_scene(loaded, result, folder)
    output.finish({"files": [path.name for path in paths], **result}, json_file, folder)


def _gains(given: Sequence[float] | None, files: int) -> list[float]:
    """Return the analogue gain of each file."""
    given = given or [1.0]
    if any(not 1.0 <= g <= 64.0 for g in given):
        raise InputError(f"{', '.join(f'{g:g}' for g in given)}", key="--analogue-gain", allowed="1 to 64")
    if len(given) not in (1, files):
        raise InputError(f"{len(given)} for {files} files", key="--analogue-gain", allowed="one, or one for each file")
    return list(given) * (files if len(given) == 1 else 1)


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    found = re.fullmatch(r"\s*(\d{1,5})\s*[xX]\s*(\d{1,5})\s*", text)
    if found is None or min(map(int, found.groups())) < 8:
        raise InputError(f"{text!r}", key="--raw-size", allowed="COLSxROWS, each 8 at least, such as 4056x3040")
    return int(found.group(1)), int(found.group(2))


def _figures(
    paths: Sequence[Path], gains: Sequence[float], black_DN: float, bits: int, mosaic: str | None,
    raw_size: tuple[int, int] | None, temperatures: Sequence[float],
) -> tuple[SensorFigures, list[float]]:  # fmt: skip
    """Read and reduce every file; a folder is a stack. Return also the analogue gain of each photon transfer."""
    from evanesce.bench import sensor as bench
    from evanesce.bench import sensor_tables
    from evanesce.bench.frame_stack import reduce_stack

    folders = [path for path in paths if path.is_dir()]
    if folders and len(paths) > 1:
        raise InputError("a folder of frames with other files", file=folders[0], allowed="one folder, or tables")
    if folders:
        with progress() as bar:
            task = bar.add_task("frames", total=None)
            rows = reduce_stack(
                folders[0], bits=bits, mosaic=mosaic, raw_size=raw_size,
                seen=lambda done, of: bar.update(task, completed=done, total=of),
            )  # fmt: skip
        with output.names_file(folders[0]):
            figures = bench.of_stack(rows, black_DN)
        dark = bench.of_dark([replace(one, analogue_gain=gains[0]) for one in figures.dark.series])
        return replace(figures, dark=dark), [gains[0]] * len(figures.transfers)
    transfers, each, series, left = [], [], [], list(temperatures)
    for path, gain in zip(paths, gains, strict=True):
        if sensor_tables.is_transfer(path):
            for table in sensor_tables.read_transfer(path, 2**bits - 1).values():
                with output.names_file(path):
                    one = bench.of_table(table, black_DN)
                transfers.append(_renamed(one, path, len(paths)))
                each.append(gain)
        else:
            found = sensor_tables.read_dark(path, left.pop(0) if left else None)
            series += [replace(one, analogue_gain=gain) for one in found]
    if left:
        raise InputError(f"{len(left)} more than dark tables", key="--temperature-C", allowed="one for each dark table")
    seen = {(one.name, one.temperature_C) for one in series}
    if len(seen) < len(series):
        raise InputError("two dark tables of one temperature", key="--temperature-C", allowed="one table for each")
    with output.names_file(paths[-1]):
        return bench.SensorFigures(tuple(transfers), bench.of_dark(series)), each


def _renamed(one: Transfer, path: Path, files: int) -> Transfer:
    if files == 1:
        return one
    return replace(one, name=path.stem if one.name == "all" else f"{path.stem}: {one.name}")


def _summary(figures: SensorFigures, gains: Sequence[float], gain: float | None) -> dict[str, Any]:
    """Return the figures for JSON; electrons where the gain is known."""
    mean_gain = gain
    if figures.transfers:
        own = [t.fit.gain_e_per_DN * g for t, g in zip(figures.transfers, gains, strict=True)]
        mean_gain = sum(own) / len(own) if gain is None else gain
    scale = math.nan if mean_gain is None else mean_gain
    transfers = [
        {
            "pixels": t.name, **asdict(t.fit), "saturation_e": t.fit.saturation_e, "prnu": t.prnu, "prnu_se": t.prnu_se,
            "analogue_gain": g, "gain_1_e_per_DN": t.fit.gain_e_per_DN * g, "dsnu_e": t.dsnu_e,
            "linearity": None if t.line is None else asdict(t.line), "noise_correlation": t.correlation,
            "doubts": t.doubts,
        }
        for t, g in zip(figures.transfers, gains, strict=True)
    ]  # fmt: skip
    dark = [
        {
            "pixels": s.name, "temperature_C": s.temperature_C, "analogue_gain": s.analogue_gain, **asdict(f),
            "dark_current_from_mean_e_per_s": f.current_DN_per_s * scale / s.analogue_gain,
            "dark_current_from_variance_e_per_s": f.shot_DN2_per_s * (scale / s.analogue_gain) ** 2,
            "nonuniformity_e_per_s": f.nonuniformity_DN_per_s * scale / s.analogue_gain,
        }
        for s, f in zip(figures.dark.series, figures.dark.fits, strict=True)
    ]  # fmt: skip
    law = figures.dark.law
    factors = [
        asdict(a) | {"activation_energy_eV": a.activation_energy_eV, "doubling_K": a.doubling_K}
        for a in figures.dark.factors
    ]
    return _finite(
        {
            "test": "sensor", "photon_transfer": transfers, "dark": dark,
            "black_level_DN": figures.black_DN, "notes": list(figures.notes),
            "temperature_factors": factors, "temperature_law": None if law is None else asdict(law),
        }
    )  # fmt: skip


def _finite(value: Any) -> Any:
    """Return a copy with null for what is not finite, which JSON does not hold."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _print(figures: SensorFigures, result: dict[str, Any]) -> None:
    for t in figures.transfers:
        fit = t.fit
        rows = [
            ("conversion gain K", f"{fit.gain_e_per_DN:.4g} +- {fit.gain_se:.2g} e-/DN"),
            ("read noise", f"{fit.read_noise_e:.3g} +- {fit.read_noise_se:.2g} e-"),
            ("PRNU", f"{100 * t.prnu:.3g} +- {100 * t.prnu_se:.2g} %"),
            ("residual of the curve", f"{100 * fit.residual:.2g} % RMS of {fit.rows} rows to {fit.limit_DN:.4g} DN"),
        ]
        if fit.saturation_DN is not None:
            rows.append(("saturation", f"{fit.saturation_DN:.4g} DN above black, {fit.saturation_e:.4g} e-"))
        if math.isfinite(t.dsnu_e):
            rows.append(("DSNU", f"{t.dsnu_e:.3g} e-"))
        if t.line is not None:
            worst = f"{100 * t.line.worst:+.2g} % at {t.line.worst_DN:.4g} DN"
            rows.append(("linearity error", f"{100 * t.line.error:.2g} %; {worst}"))
        if math.isfinite(t.correlation[0]):
            text = f"{t.correlation[0]:+.4f}, {t.correlation[1]:+.4f} (+- {t.correlation_se:.1g})"
            rows.append(("noise correlation along rows, columns", text))
        output.print_table(f"photon transfer: {t.name}", rows)
    for doubt in dict.fromkeys(doubt for t in figures.transfers for doubt in t.doubts):
        names = ", ".join(t.name for t in figures.transfers if doubt in t.doubts)
        console.print(f"note: {names}: {doubt}", highlight=False)
    for note in figures.notes:
        console.print(f"note: {note}", highlight=False)
    rows = []
    for entry in result["dark"]:
        what = f"{entry['pixels']}, {entry['temperature_C']:g} degC"
        parts = [
            f"shot {entry['shot_DN2_per_s']:.3g} DN2/s", f"non-uniformity {entry['nonuniformity_DN_per_s']:.3g} DN/s"
        ]  # fmt: skip
        if entry["dark_current_from_mean_e_per_s"] is not None:
            parts.append(f"D from mean {entry['dark_current_from_mean_e_per_s']:.4g} e-/s")
        if entry["dark_current_from_variance_e_per_s"] is not None:
            parts.append(f"D from variance {entry['dark_current_from_variance_e_per_s']:.4g} e-/s")
        rows.append((what, "; ".join(parts)))
    law = figures.dark.law
    for a in figures.dark.factors:
        name = f"{a.name}, {a.low_C:g} to {a.high_C:g} degC"
        rows.append((name, f"{a.factor:.3g} times as fast (levels' scatter {100 * a.scatter:.2g} %)"))
    if law is not None:
        spread = f"95 %: {law.low_eV:.3g} to {law.high_eV:.3g}" if law.estimates > 1 else "no spread to judge it by"
        rows.append(("activation energy", f"{law.activation_energy_eV:.3g} eV ({spread})"))
    if rows:
        output.print_table("dark signal", rows)


def _write(figures: SensorFigures, folder: Path) -> None:
    from evanesce.bench import sensor_plots

    if figures.transfers:
        write_figure(folder / "photon_transfer.png", sensor_plots.transfer_figure(figures.transfers))
        lines = [
            f"{t.name},{x:.8g},{v:.8g},{w:.8g}"
            for t in figures.transfers
            for x, v, w in zip(t.signal_DN, t.variance_DN2, t.fit.variance(t.signal_DN), strict=True)
        ]
        heading = "pixels,signal_DN,variance_DN2,fitted_variance_DN2"
        write_text(folder / "photon_transfer.csv", "\n".join([heading, *lines]) + "\n")
    if figures.dark.series:
        write_figure(folder / "dark.png", sensor_plots.dark_figure(figures.dark))


def _write_scene(scene: Scene, result: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Write the pixel's keys that these figures give, and the scene with them in place of its own."""
    import tomli_w

    from evanesce.rig import copy_scene_files, dump_scene

    keys = pixel_keys(result)
    data = scene.as_dict()
    data["camera"] = {**data["camera"], "pixel": {**data["camera"].get("pixel", {}), **keys}}
    changed = type(scene).from_dict(data)
    text = tomli_w.dumps({"camera": {"pixel": keys}})
    write_text(folder / "pixel.toml", text)
    copy_scene_files(changed, folder)
    write_text(folder / "scene.toml", dump_scene(changed))
    console.print("keys for the scene (pixel.toml; scene.toml has them in place):", highlight=False)
    console.print(text.rstrip(), markup=False, highlight=False)
    return keys


def pixel_keys(result: dict[str, Any]) -> dict[str, float]:
    """Return the keys of ``[camera.pixel]``: means over the kinds of pixels, dark figures at the warmest temperature.

    Parameters
    ----------
    result : dict
        Of the command.

    Returns
    -------
    dict of str to float
    """

    def mean(values: list[float | None]) -> float | None:
        known = [v for v in values if v is not None]
        return sum(known) / len(known) if known else None

    transfers, dark, law = result["photon_transfer"], result["dark"], result["temperature_law"]
    warm = max((d["temperature_C"] for d in dark), default=None)
    hot = [d for d in dark if d["temperature_C"] == warm]
    hot = [d for d in hot if d["pixels"] != "all"] or hot  # "all" consists of the others
    found = {
        "black_level_DN": result.get("black_level_DN"),
        "conversion_gain_e_per_DN": mean([t["gain_1_e_per_DN"] for t in transfers]),
        "read_noise_e": mean([t["read_noise_e"] for t in transfers]),
        "prnu": mean([t["prnu"] for t in transfers]),
        "dsnu_e": mean([t["dsnu_e"] for t in transfers]),
        "full_well_capacity_e": mean([t["saturation_e"] for t in transfers if t["analogue_gain"] == 1]),
        "dark_current_e_per_s": mean(
            [d["dark_current_from_mean_e_per_s"] or d["dark_current_from_variance_e_per_s"] for d in hot]
        ),
    }
    if found["dark_current_e_per_s"]:
        found["dark_nonuniformity_e_per_s"] = mean([d["nonuniformity_e_per_s"] for d in hot])
        if law is not None and warm is not None:
            found |= {"dark_activation_energy_eV": law["activation_energy_eV"], "dark_reference_C": warm}
    return {key: float(f"{value:.5g}") for key, value in found.items() if value is not None}
