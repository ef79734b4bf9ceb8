"""Strict TOML -> Scene, every error one line that names file, key, value and what is allowed."""

from __future__ import annotations

import difflib
import re
import tomllib
import types
import typing
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import BaseModel, ValidationError

from evanesce.core.errors import InputError
from evanesce.core.quantities import UNIT_SUFFIXES, Quantity, Strict, quantity_of
from evanesce.core.resources import resource
from evanesce.rig import height_map, spectrum_file
from evanesce.rig.finger import Contact
from evanesce.rig.scene import Scene

MAX_SCENE_BYTES = 1_000_000


def scene_path(name: str | Path) -> Path:
    """Return the file of a scene given as a path, or as the name of a scene that ships (``thesis``).

    Parameters
    ----------
    name : str or Path
        Path of a TOML file, or name of a scene that ships.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If neither exists.
    """
    path = Path(name)
    if path.is_file():
        return path
    if path.suffix == "" and path.parent == Path("."):
        shipped = resource("scenes", f"{path.name}.toml")
        if shipped.is_file():
            return shipped
    known = ", ".join(sorted(p.stem for p in resource("scenes").glob("*.toml")))
    raise InputError("no such scene file", file=path, allowed=f"a TOML file, or a shipped scene: {known}")


def load_scene(name: str | Path, overrides: dict[str, Any] | None = None) -> Scene:
    """Read and check a scene.

    Parameters
    ----------
    name : str or Path
        TOML file, or the name of a shipped scene.
    overrides : dict, optional
        Dotted keys to replace before checking, e.g. ``{"leds.voltage_V": 10.0}``.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        With file, key, value and allowed range of the first thing wrong.
    """
    path = scene_path(name)
    if path.stat().st_size > MAX_SCENE_BYTES:
        raise InputError(f"scene of {path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_SCENE_BYTES} bytes")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:  # TOMLDecodeError and UnicodeDecodeError are ValueErrors
        raise InputError(f"not valid TOML: {error}", file=path) from None
    for dotted, value in (overrides or {}).items():
        if dotted.endswith(".law"):
            _forget_other_law(data, dotted, value, overrides or {})
        _set(data, dotted, value, path)
        if isinstance(value, dict):
            _forget_replaced(data, dotted, value)
    return spectrum_file.located(height_map.located(validate(Scene, data, path), path), path)


def _forget_other_law(data: dict[str, Any], dotted: str, law: Any, overrides: dict[str, Any]) -> None:
    """Take out the file's keys of a law that another one, which is asked for, does not have, and what is said of them.

    Parameters
    ----------
    data : dict
        Of the file.
    dotted : str
        Of the law.
    law : object
        Asked for.
    overrides : dict
        Keys that are asked for as well: those stay, to be refused by name if the law does not have them.
    """
    *parents, _ = dotted.split(".")
    models: list[type[BaseModel]] = [Scene]
    table: Any = data
    for part in parents:
        fields = [m.model_fields[part].annotation for m in models if part in m.model_fields]
        models = [found for annotation in fields for found in _models(annotation)]
        table = table.get(part) if isinstance(table, dict) else None
    if not isinstance(table, dict) or not isinstance(law, str):
        return
    before, after = _pick(models, table), _pick(models, {**table, "law": law})
    if before is None or after is None:
        return
    gone = {key for key in table if key in before.model_fields and key not in after.model_fields}
    at = ".".join(parents)
    gone = {f"{at}.{key}" for key in gone} - set(overrides)
    for key in gone:
        del table[key.rpartition(".")[2]]
    for name in ("sources", "assumptions"):
        sentences = data.get(name)
        if isinstance(sentences, dict):
            data[name] = {key: text for key, text in sentences.items() if key not in gone}


def _forget_replaced(data: dict[str, Any], dotted: str, table: dict[str, Any]) -> None:
    """Take out the sentences about keys that the table in their place does not have."""
    for name in ("sources", "assumptions"):
        sentences = data.get(name)
        if isinstance(sentences, dict):
            inside = {key: key[len(dotted) + 1 :].split(".")[0] for key in sentences if key.startswith(f"{dotted}.")}
            data[name] = {key: text for key, text in sentences.items() if key not in inside or inside[key] in table}


def _set(data: dict[str, Any], dotted: str, value: Any, path: Path) -> None:
    *parents, last = dotted.split(".")
    table = data
    for part in parents:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise InputError("is not a table", file=path, key=dotted)
    table[last] = value


ModelT = typing.TypeVar("ModelT", bound=Strict)


def validate(model: type[ModelT], data: dict[str, Any], file: Path | str) -> ModelT:
    """Validate plain data against a strict model; every failure becomes one :class:`InputError`.

    Parameters
    ----------
    model : type
        Strict model.
    data : dict
    file : Path or str
        Named in errors.

    Returns
    -------
    object
        Instance of the model.
    """
    _check_bounds(model, data, (), file)
    try:
        return model.model_validate(_tuples(data))
    except ValidationError as error:
        raise _as_input_error(model, error, data, file) from None


def _tuples(value: Any) -> Any:
    """TOML arrays as tuples: strict pydantic takes a list for a tuple only from JSON."""
    if isinstance(value, dict):
        return {k: (v if k in _LIST_TABLES else _tuples(v)) for k, v in value.items()}
    if isinstance(value, list):
        return tuple(_tuples(v) for v in value)
    return value


_LIST_TABLES = {"effects"}


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Return the models inside an annotation (a union, an Annotated, a dict's values)."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    origin = typing.get_origin(annotation)
    if origin is dict:
        return []
    if origin is typing.Annotated or origin is typing.Union or isinstance(annotation, types.UnionType):
        return [m for arg in typing.get_args(annotation) for m in _models(arg)]
    return []


def _mapping_value(annotation: Any) -> list[type[BaseModel]]:
    if typing.get_origin(annotation) is dict:
        return _models(typing.get_args(annotation)[1])
    return []


def _pick(models: list[type[BaseModel]], value: dict[str, Any]) -> type[BaseModel] | None:
    """Choose among a discriminated union's members by ``law``."""
    if len(models) == 1:
        return models[0]
    for model in models:
        tag = model.model_fields.get("law")
        if tag is not None and value.get("law") in typing.get_args(tag.annotation):
            return model
    return None


def _check_bounds(model: type[BaseModel], data: dict[str, Any], at: tuple[str, ...], file: Path | str) -> None:
    """Refuse unknown keys and values out of bounds, named as declared."""
    for key, value in data.items():
        where = ".".join((*at, key))
        info = model.model_fields.get(key)
        if info is None:
            raise _unknown_key(model, key, where, file)
        quantity = quantity_of(info)
        if quantity is not None:
            _check_value(value, quantity, where, file)
            continue
        if isinstance(value, dict):
            inner = _models(info.annotation)
            chosen = _pick(inner, value) if inner else None
            if chosen is not None:
                _check_bounds(chosen, value, (*at, key), file)
            for mapped in _mapping_value(info.annotation)[:1]:
                for name, entry in value.items():
                    if isinstance(entry, dict):
                        _check_bounds(mapped, entry, (*at, key, name), file)


def _check_value(value: Any, quantity: Quantity, where: str, file: Path | str) -> None:
    values = value if isinstance(value, list | tuple) else [value]
    lo, hi = quantity.bounds
    for number in values:
        if isinstance(number, bool) or not isinstance(number, int | float):
            hint = " (the unit stands in the key, not in the value)" if isinstance(number, str) else ""
            raise InputError(f"{number!r} is not a number{hint}", file=file, key=where, allowed=str(quantity))
        if not lo <= number <= hi:  # NaN fails this, too
            raise InputError(f"{number!r} is out of range", file=file, key=where, allowed=str(quantity))


def _stem(key: str) -> str:
    for suffix in sorted(UNIT_SUFFIXES, key=len, reverse=True):
        if key.endswith("_" + suffix):
            return key[: -len(suffix) - 1]
    return key


def _unknown_key(model: type[BaseModel], key: str, where: str, file: Path | str) -> InputError:
    names = list(model.model_fields)
    for name in names:
        if _stem(name) == _stem(key):
            found = quantity_of(model.model_fields[name])
            if found is not None:
                return InputError(f"wrong unit: write {name} instead", file=file, key=where, allowed=f"{name}: {found}")
    close = difflib.get_close_matches(key, names, n=1, cutoff=0.0)
    nearest = f"; nearest key: {close[0]}" if close else ""
    return InputError(f"unknown key{nearest}", file=file, key=where, allowed=", ".join(names))


def _as_input_error(model: type[BaseModel], error: ValidationError, data: Any, file: Path | str) -> InputError:
    first = error.errors(include_url=False)[0]
    # A discriminated union puts its tag into the location; the user's file has no such key.
    parts: list[str] = []
    value: Any = data
    for part in first["loc"]:
        if isinstance(value, dict) and part not in value and first["type"] not in ("missing", "extra_forbidden"):
            continue
        if isinstance(value, float | int | str):
            continue  # a union names the type that it tried
        parts.append(str(part))
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            value = None
    key = ".".join(parts) or None
    kind, context = first["type"], first.get("ctx", {})
    if kind == "missing":
        return InputError("missing", file=file, key=key, allowed="this key is required")
    if kind in ("literal_error", "union_tag_invalid"):
        allowed = context.get("expected") or context.get("expected_tags")
        found = first.get("input")
        if kind == "union_tag_invalid" and isinstance(found, dict):
            found, key = found.get("law"), f"{key}.law"
        return InputError(f"{found!r} is not known", file=file, key=key, allowed=str(allowed))
    if kind == "union_tag_not_found":
        return InputError("'law' is missing", file=file, key=f"{key}.law", allowed=", ".join(_laws()))
    if kind == "value_error":
        text = str(context.get("error", first["msg"]))
        told = re.fullmatch(rf"({re.escape(key or '-')}\.\w+) ((?:names|draws) .*)", text, re.DOTALL)
        if told:  # a section tells of one of its keys
            key, text = told[1], told[2]
        return InputError(text, file=file, key=key)
    if kind in ("too_short", "too_long", "tuple_type"):
        size = context.get("min_length", context.get("max_length"))
        bound = "at least" if kind == "too_short" else "at most"
        allowed = f"{bound} {size} entries" if size is not None else "a list"
        return InputError(_shown(_plain(first.get("input"))), file=file, key=key, allowed=allowed)
    if kind == "int_type" or kind == "int_from_float":
        return InputError(f"{first.get('input')!r} is not a whole number", file=file, key=key, allowed="whole numbers")
    if kind in ("greater_than_equal", "less_than_equal"):
        bound = f"at least {context['ge']:g}" if "ge" in context else f"at most {context['le']:g}"
        return InputError(f"{first.get('input')!r} is out of range", file=file, key=key, allowed=bound)
    return InputError(f"{_shown(first.get('input'))}: {first['msg'].lower()}", file=file, key=key)


def _shown(value: object) -> str:
    """Return a value in a few words: a long list would fill the message."""
    text = repr(value)
    return text if len(text) < 80 else text[:77] + "..."


def _laws() -> list[str]:
    """Return the names of all contact laws."""
    models = typing.get_args(typing.get_args(Contact)[0])
    return [str(law) for model in models for law in typing.get_args(model.model_fields["law"].annotation)]


def _plain(value: Any) -> Any:
    """Tuples as the lists that the file has."""
    return [_plain(v) for v in value] if isinstance(value, tuple) else value


def dump_scene(scene: Scene) -> str:
    """Return a scene as TOML text that :func:`load_scene` reads back equal.

    Height map and spectrum are named as :func:`~evanesce.rig.copy_scene_files` names their copies, which belong beside
    the text.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    str
        TOML.
    """
    return tomli_w.dumps(spectrum_file.relative(height_map.relative(scene)).as_dict())
