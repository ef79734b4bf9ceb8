"""``evanesce scene``: what the keys of a scene are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.markup import escape
from rich.table import Table

from evanesce.cli.common import JsonOption, check_json_target, console, handles_errors, working, write_json
from evanesce.core.errors import InputError

if TYPE_CHECKING:
    from evanesce.rig.explain import Key

EFFECTS = "effects."


def register(app: typer.Typer) -> None:
    """Add the group."""
    group = typer.Typer(no_args_is_help=True, help="Scenes: what their keys are.")
    app.add_typer(group, name="scene")
    group.command()(handles_errors(explain))


def explain(
    name: Annotated[str, typer.Argument(metavar="KEY", help="Key or table of a scene, e.g. plate.thickness_mm, leds.")],
    scene: Annotated[
        str | None, typer.Option("--scene", help="Scene file or name: its value; with --simulate, what it does there.")
    ] = None,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="Change the key by 10 % and print what happens to the frame.")
    ] = False,
    json_file: JsonOption = None,
) -> None:
    """Tell unit, range, default, source, and what a key does to the frame."""
    from evanesce.rig import load_scene
    from evanesce.rig.explain import explained

    check_json_target(json_file)
    if simulate and (scene is None or name.startswith(EFFECTS)):
        raise InputError("needs a key and --scene", key="--simulate", allowed="e.g. plate.thickness_mm --scene thesis")
    keys = _effect(name) if name.startswith(EFFECTS) else explained(name)
    loaded = None if scene is None else load_scene(scene)
    rows = [key.as_dict() for key in keys]
    if loaded is not None:
        from evanesce.api.key_change import value_at

        for row in rows:
            row["value"] = value_at(loaded, row["key"])
    change: Any = None
    if simulate and loaded is not None:
        from evanesce.api.key_change import change_of

        if len(keys) != 1:
            raise InputError(f"'{name}' is a table", key="--simulate", allowed=f"one of its keys, e.g. {keys[0].name}")
        with working("two frames, by simulation"):
            change = change_of(loaded, name)
    write_json(json_file, {"keys": rows, "change": None if change is None else change.as_dict()})
    _show(name, rows, loaded is not None)
    if change is not None:
        console.print(change.sentence(), highlight=False, markup=False, soft_wrap=True)


def _effect(name: str) -> tuple[Key, ...]:
    """Return the parameters of an effect, or one of them."""
    import inspect

    from evanesce.core.quantities import quantity_of
    from evanesce.effects import all_effects
    from evanesce.rig.explain import Key, words_of

    effect_id, _, parameter = name.removeprefix(EFFECTS).partition(".")
    effects = all_effects()
    if effect_id not in effects:
        raise InputError(f"no effect '{effect_id}'", key="KEY", allowed=", ".join(effects))
    effect = effects[effect_id]
    told = (inspect.getdoc(inspect.getmodule(effect.apply)) or "").splitlines()[0]
    found = []
    for own, info in effect.parameters.model_fields.items():
        q = quantity_of(info)
        meaning = (q.doc if q is not None else info.description) or ""
        words = words_of(info.annotation)
        found.append(
            Key(f"{EFFECTS}{effect_id}.{own}", q, info.get_default(), info.is_required(), meaning, told, words)
        )
    chosen = tuple(key for key in found if not parameter or key.name.endswith(f".{parameter}"))
    if not chosen:
        raise InputError(
            f"effect '{effect_id}' has no '{parameter}'", key="KEY", allowed=", ".join(effect.parameters.model_fields)
        )
    return chosen


def _show(name: str, rows: list[dict[str, Any]], with_value: bool) -> None:
    if len(rows) == 1:
        row = rows[0]
        console.print(
            f"{row['key']}: {row['meaning'] or row['in_frame']}", highlight=False, markup=False, soft_wrap=True
        )
        table = Table(box=box.SIMPLE_HEAD, show_header=False)
        table.add_column("what")
        table.add_column("is")
        for what, text in _lines(row, with_value):
            table.add_row(what, escape(text))
        console.print(table)
        return
    table = Table(title=escape(f"[{name}]"), box=box.SIMPLE_HEAD)
    for heading in ("key", "unit", "range", *(("value",) if with_value else ("default",)), "what it does to the frame"):
        table.add_column(heading)
    for row in rows:
        value = row.get("value") if with_value else row["default"]
        cells = (
            row["key"],
            row["unit"] or "",
            _range(row) or ", ".join(row["choices"]),
            text_of(value),
            row["in_frame"] or row["meaning"],
        )
        table.add_row(*(escape(cell) for cell in cells))
    console.print(table)


def _lines(row: dict[str, Any], with_value: bool) -> list[tuple[str, str]]:
    found = [("one of", ", ".join(row["choices"]))] if row["choices"] else [("unit", row["unit"] or "none")]
    if row["range"] is not None:
        found.append(("range", _range(row)))
    found.append(("default", "none: required" if row["required"] else text_of(row["default"])))
    if row["null"] is not None:
        found.append(("absent at", text_of(row["null"])))
    if row["source"]:
        found.append(("source of the default", row["source"]))
    if row["in_frame"] and row["meaning"]:
        found.append(("in the frame", row["in_frame"]))
    if with_value:
        found.append(("value in the scene", text_of(row["value"])))
    return found


def _range(row: dict[str, Any]) -> str:
    return "" if row["range"] is None else f"{row['range'][0]:g} to {row['range'][1]:g}"


def text_of(value: Any) -> str:
    """Return a value of a scene as words."""
    if value is None:
        return "none"
    if hasattr(value, "model_dump"):
        return str(value.model_dump(exclude_none=True))
    if isinstance(value, list | tuple):
        return ", ".join(text_of(v) for v in value) or "empty"
    return f"{value:g}" if isinstance(value, float) else str(value)
