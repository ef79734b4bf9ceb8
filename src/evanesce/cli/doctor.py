"""``evanesce doctor``: what works on this machine, what is missing and how to get it."""

from __future__ import annotations

import platform
import shutil
from pathlib import Path
from typing import Any

import typer
from rich.table import Table

from evanesce.cli.common import JsonOption, OutOption, check_json_target, console, handles_errors, out_dir, write_json

MINIMUM_DISK_MB = 500.0


def _advice(family: str) -> str:
    """Return how to make a family work."""
    from evanesce.render.variant import LLVM_HELP

    if family == "llvm":
        return LLVM_HELP
    if family == "cuda":
        return "optional: needs an NVIDIA GPU with a current driver"
    return "reinstall the packages mitsuba and drjit of constraints.txt"


def _families() -> list[dict[str, Any]]:
    """Probe every family in a subprocess, remembered answers set aside."""
    from evanesce.render.variant import FAMILIES, attempts, llvm_source

    found = []
    for family, name in FAMILIES.items():
        tried = attempts(family, fresh=True)
        works = bool(tried) and tried[-1].works
        libraries = [
            {
                "library": Path(a.llvm_path).name,
                "from": llvm_source(a.llvm_path),
                "works": a.works,
                "version": a.backend_version,
                "error": a.error,
            }
            for a in tried
            if a.llvm_path
        ]
        error = "" if works else (tried[-1].error if tried else "no libLLVM found")
        entry: dict[str, Any] = {
            "family": family,
            "variant": name,
            "works": works,
            "version": tried[-1].backend_version if works else "",
            "error": error,
            "advice": "" if works else _advice(family),
        }
        if libraries:
            entry["libraries"] = libraries
        found.append(entry)
    return found


def _extras() -> dict[str, dict[str, Any]]:
    """Return, for each extra, what it is for, the versions of its packages, and in words which are missing."""
    from evanesce.core.extras import EXTRAS, PURPOSES, distribution_name, listed, missing
    from evanesce.core.provenance import package_versions

    return {
        extra: {
            "purpose": PURPOSES[extra],
            "packages": package_versions(tuple(distribution_name(name) for name in modules)),
            "missing": listed(absent) if (absent := missing(modules)) else "",
        }
        for extra, modules in EXTRAS.items()
    }


def diagnose() -> dict[str, Any]:
    """Return the whole report as JSON-able data.

    ``ok`` says whether everything that is not optional works: one CPU variant, all required packages, some disk.
    """
    from evanesce import __version__
    from evanesce.core.provenance import package_versions

    packages, extras = package_versions(), _extras()
    families = _families()
    free_mb = shutil.disk_usage(Path.cwd()).free / 1e6
    missing = [
        f"package {name}: install evanesce anew (pip install evanesce; in a checkout: make install)"
        for name, version in packages.items()
        if version == "missing"
    ]
    cpu = [f for f in families if f["family"] in ("llvm", "scalar")]
    if not any(f["works"] for f in cpu):
        missing += [f"{f['variant']}: {f['error']}; {f['advice']}" for f in cpu]
    if free_mb < MINIMUM_DISK_MB:
        missing.append(f"disk space: {free_mb:.0f} MB free here, a demo needs {MINIMUM_DISK_MB:.0f} MB")
    notes = [f"{f['variant']}: {f['error']}; {f['advice']}" for f in families if not f["works"]]
    if absent := [extra for extra, found in extras.items() if found["missing"]]:
        notes.append(f"extras that are not installed: {', '.join(absent)}; to add one: pip install 'evanesce[NAME]'")
    return {
        "ok": not missing,
        "evanesce": __version__,
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "variants": families,
        "auto": next((f["variant"] for f in cpu if f["works"]), None),
        "packages": packages,
        "extras": extras,
        "free_disk_MB": round(free_mb),
        "missing": missing,
        "notes": notes,
    }


def _show(report: dict[str, Any]) -> None:
    table = Table("what", "version", "state")
    table.add_row("evanesce", report["evanesce"], "")
    table.add_row("Python", report["python"], report["platform"])
    for family in report["variants"]:
        state = "works" if family["works"] else "does not work"
        if family["variant"] == report["auto"]:
            state += ", taken by --variant auto"
        table.add_row(family["variant"], family["version"], state)
        for library in family.get("libraries", []):
            state = "works" if library["works"] else "fails"
            table.add_row(f"  {library['library']}", library["version"], f"{state}, from {library['from']}")
    for name, version in report["packages"].items():
        table.add_row(name, "" if version == "missing" else version, "missing" if version == "missing" else "")
    for extra, found in report["extras"].items():
        state = f"{found['missing']} not installed" if found["missing"] else "installed"
        table.add_row(f"extra '{extra}'", "", f"{state} ({found['purpose']})")
    console.print(table)
    for line in report["missing"]:
        console.print(f"missing: {line}", markup=False, highlight=False, soft_wrap=True)
    for line in report["notes"]:
        console.print(f"note: {line}", markup=False, highlight=False, soft_wrap=True)


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def doctor(json_file: JsonOption = None, out: OutOption = None) -> None:
        """Say which variants, LLVM and packages work here, what is missing and how to get it.

        Tries every variant afresh, each in a process of its own. Exit code 1 if nothing can render or a package is
        missing; --out writes doctor.json there.
        """
        check_json_target(json_file)
        report = diagnose()
        _show(report)
        write_json(json_file, report)
        if out is not None:
            write_json(out_dir(out, "doctor") / "doctor.json", report)
        if not report["ok"]:
            raise typer.Exit(1)
