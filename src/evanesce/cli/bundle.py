"""``evanesce bundle``: look at a measurement bundle before anything is made of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from evanesce.cli import bundle_make
from evanesce.cli.common import JsonOption, check_json_target, console, handles_errors, write_json


def register(app: typer.Typer) -> None:
    """Add the group."""
    group = typer.Typer(no_args_is_help=True, help="Measurement bundles: the measurements of a rig in one folder.")
    app.add_typer(group, name="bundle")

    bundle_make.register(group)

    @group.command()
    @handles_errors
    def check(
        folder: Annotated[Path, typer.Argument(help="The bundle, see docs/reference/bundle.md.")],
        json_file: JsonOption = None,
    ) -> None:
        """Check every table and frame; say what is there, and what cannot be named without what is missing.

        The board in the pictures is compared with the scene's card.
        """
        from evanesce.bundle import read_bundle
        from evanesce.bundle.board import nominal_plane
        from evanesce.bundle.check import contents
        from evanesce.bundle.make import check_boards

        check_json_target(json_file)
        bundle = read_bundle(folder)
        unseen = check_boards(bundle.files("checkerboard"), bundle.scene, nominal_plane(bundle.scene))
        found = contents(bundle) | {"no_board_in": unseen}
        write_json(json_file, found)
        show(found)


def show(found: dict[str, Any]) -> None:
    """Print the contents of a bundle."""
    from evanesce.bundle.check import MISSING
    from evanesce.bundle.layout import REPLICATES_FOLDER, REPLICATES_TABLE

    cols, rows = found["resolution_px"]
    table = Table(title=f"{found['path']}: {cols} x {rows} px")
    for column in ("what", "there"):
        table.add_column(column)
    for kind, count in found["frames"].items():
        table.add_row(kind, f"{count} frame(s)" if count else "none")
    press = found["press"]
    if found["frames"]["press"]:
        for name, key, unit in (("force", "force_N", "N"), ("voltage", "voltage_V", "V"), ("time", "time_s", "s")):
            lo, hi = press[key]
            table.add_row(escape(f"{name} [{unit}]"), f"{lo:g} to {hi:g}")
        for name, (lo, hi) in press["chosen_by_camera"].items():
            words = name.removesuffix("_ms").replace("_", " ") + (" [ms]" if name.endswith("_ms") else "")
            table.add_row(escape(f"{words}, chosen by the camera"), f"{lo:.4g} to {hi:.4g}")
        table.add_row("conditions, sessions", f"{press['conditions']}, {press['sessions']}")
        table.add_row(escape("longest hold [s]"), f"{press['longest_hold_s']:g}")
    for name, entry in found["series"].items():
        table.add_row(f"series {name}", escape(f"{entry['points']} points, {entry['y']} against {entry['x']}"))
    console.print(table)
    for doubt in found["doubts"]:
        console.print(escape(f"warning: {doubt}"), highlight=False, style="yellow")
    for name in found["missing"]:
        console.print(f"missing: {name} ({MISSING[name]})", highlight=False)
    for name in found["not_read"]:
        place = (
            f"its place is {REPLICATES_FOLDER}/{name}"
            if name == REPLICATES_TABLE
            else "folders that are read are listed in docs/reference/bundle.md"
        )
        console.print(escape(f"not read: {name} ({place})"), highlight=False)
    if found.get("no_board_in"):
        names = ", ".join(found["no_board_in"])
        console.print(escape(f"no checkerboard is found in: {names}"), highlight=False)
    if not any(found["frames"].values()):
        console.print("series alone: which effects they feel shows when `evanesce criticise` predicts them")
    if found["cannot_be_named"]:
        blind = Table(title="Cannot be named from this bundle")
        blind.add_column("effect")
        blind.add_column("for want of")
        for name, needs in found["cannot_be_named"].items():
            blind.add_row(name, ", ".join(needs))
        console.print(blind)
