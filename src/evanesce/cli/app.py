"""The command ``evanesce``; each command module registers itself on ``app``."""

from __future__ import annotations

import importlib
import os
import warnings
from typing import Annotated

import typer

from evanesce import __version__

app = typer.Typer(
    name="evanesce",
    help="Simulate an FTIR tactile rig physically and verify its measurement pipeline against the truth.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)

# One module a command (or group); each has `register(app)`.
COMMANDS = (
    "init",
    "scene",
    "demo",
    "render",
    "simulate",
    "bundle",
    "calibrate",
    "measure",
    "compare",
    "twin",
    "bench",
    "fem",
    "study",
    "design",
    "dataset",
    "doctor",
    "fit",
    "criticise",
    "criticise_photo",
    "serve",
)


def _version(value: bool) -> None:
    if value:
        print(f"evanesce {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Options before the command."""


for _name in COMMANDS:
    importlib.import_module(f"evanesce.cli.{_name}").register(app)


def main() -> None:
    """Entry point of the console script."""
    os.environ.setdefault("MPLBACKEND", "Agg")
    # a division inside a library tells its user nothing; what is wrong with a result is a warning of ours
    warnings.simplefilter("ignore", RuntimeWarning)
    os.environ.setdefault("PYTHONWARNINGS", "ignore::RuntimeWarning")  # of worker processes
    app()
