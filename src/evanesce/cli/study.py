"""``evanesce study``: the group of the studies; every module ``study_<name>`` beside this one adds its command."""

from __future__ import annotations

import importlib
import pkgutil

import typer

from evanesce import cli


def register(app: typer.Typer) -> None:
    """Add the group ``study``."""
    group = typer.Typer(help="What follows from the thesis's inputs: predictions with intervals.", no_args_is_help=True)

    @group.callback()
    def _root() -> None:
        """Keep the group a group, also while it has one command."""

    for found in sorted(module.name for module in pkgutil.iter_modules(cli.__path__)):
        if found.startswith("study_"):
            importlib.import_module(f"evanesce.cli.{found}").register(group)
    app.add_typer(group, name="study")
