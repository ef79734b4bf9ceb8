"""A declaration as commented TOML: every key with its value, range and meaning."""

from __future__ import annotations

import inspect
import json
import textwrap
from collections.abc import Mapping
from typing import Any, Literal, get_args, get_origin

from evanesce.core.quantities import Strict, quantity_of
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.config_contact import PRINT_PATTERNS, RIDGE_PATTERNS
from evanesce.dataset.distributions import Distribution, Drawn
from evanesce.materials import material_names

WIDTH = 118


def declaration(config: DatasetConfig) -> str:
    """Return the TOML of a configuration; keys that are not set stand in comments.

    Parameters
    ----------
    config : DatasetConfig

    Returns
    -------
    str
        What ``--config`` reads.
    """
    lines = ["# Figures are distributions: a plain one, { uniform = [0.5, 1.5] }, { log_uniform = ... },", "# "]
    lines[1] += "{ normal = [mean, deviation] } or { choice = [...] }."
    sections = {}
    for name in type(config).model_fields:
        value = getattr(config, name)
        if isinstance(value, Strict):
            sections[name] = value
        else:
            lines.append(_line(config, name, value))
    for name, section in sections.items():
        lines += ["", *_comment(type(section)), f"[{name}]"]
        tables = {}
        for key in type(section).model_fields:
            value = getattr(section, key)
            if isinstance(value, Mapping):
                tables[key] = value
            else:
                lines.append(_line(section, key, value))
        for key, table in tables.items():
            lines += ["", f"[{name}.{key}]", *(f"{json.dumps(k)} = {_value(v)}" for k, v in table.items())]
    return "\n".join(lines) + "\n"


def _comment(section: type[Strict]) -> list[str]:
    text = " ".join((inspect.getdoc(section) or "").replace("``", "").split())
    return [f"# {line}" for line in textwrap.wrap(text, WIDTH - 2)]


def _line(section: Strict, key: str, value: Any) -> str:
    line = f"{key} = {_value(value)}" if value is not None else f"# {key} ="
    return f"{line}{_told(section, key)}"


def _told(section: Strict, key: str) -> str:
    """Return the comment of a key: range, unit, meaning."""
    bounds = section.BOUNDS.get(key) if isinstance(section, Drawn) else None
    if bounds is not None:
        return f"  # {bounds[0]:g} to {bounds[1]:g} {bounds[2]}".rstrip()
    info = type(section).model_fields[key]
    quantity = quantity_of(info)
    if quantity is None:
        words = {"material": material_names(), "pattern": (*RIDGE_PATTERNS, *PRINT_PATTERNS)}.get(key)
        words = words or (get_args(info.annotation) if get_origin(info.annotation) is Literal else ())
        return f"  # {', '.join(map(str, words))}" if words else ""
    low, high = quantity.bounds
    unit = "" if quantity.unit == "1" else f" {quantity.unit}"
    doc = f", {quantity.doc}" if quantity.doc else ""
    return f"  # {low:g} to {high:g}{unit}{doc}"


def _value(value: Any) -> str:
    """Return a value as TOML."""
    if isinstance(value, Distribution):
        (form, figures), *_ = value.model_dump(mode="json", exclude_none=True).items()
        return json.dumps(figures) if form == "constant" else f"{{ {form} = {json.dumps(figures)} }}"
    if isinstance(value, Strict):
        inner = ", ".join(f"{k} = {_value(getattr(value, k))}" for k in type(value).model_fields)
        return f"{{ {inner} }}"
    return json.dumps(list(value) if isinstance(value, tuple) else value)
