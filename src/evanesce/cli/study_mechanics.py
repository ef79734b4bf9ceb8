"""``evanesce study mechanics``: contact area, sliding and ridges as they follow from the thesis's inputs."""

from __future__ import annotations

from typing import Any

import typer
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    handles_errors,
    out_dir,
    working,
    write_figure,
    write_json,
)


def register(group: typer.Typer) -> None:
    """Add the command to the group of studies."""

    @group.command()
    @handles_errors
    def mechanics(json_file: JsonOption = None, out: OutOption = None) -> None:
        """Predict areas, ridges and sliding from the thesis's inputs alone, by stored finite-element solutions."""
        from evanesce.core import provenance
        from evanesce.studies.mechanics.page import mechanics_figure
        from evanesce.studies.mechanics.study import as_json, predictions

        check_json_target(json_file)
        folder = out_dir(out, "study-mechanics")
        with working("ridges on solved contacts: some seconds"):
            found = predictions()
            result = as_json(found)
        result["provenance"] = dict(provenance.record())
        write_figure(folder / "mechanics.png", mechanics_figure(result))
        write_json(folder / "mechanics.json", result)
        write_json(json_file, result)
        _show(result)
        console.print(f"the basis of each figure is in the JSON; written to {folder}", highlight=False, soft_wrap=True)


def _show(result: dict[str, Any]) -> None:
    table = Table(title="Predicted from the thesis's inputs alone")
    table.add_column("figure")
    for heading in ("value", "low", "high"):
        table.add_column(heading, justify="right")
    for key in result["basis"]:
        entry = result[key]
        rows = entry.items() if isinstance(entry, dict) else (("", entry),)
        for sub, values in rows:
            table.add_row(f"{key} {sub}".strip(), *(f"{value:.3f}" for value in values))
    console.print(table)
