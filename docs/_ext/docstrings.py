"""Fit docstrings to Sphinx: bars that mean absolute values, names that a module imports or does not document."""

from __future__ import annotations

import importlib
import inspect
import re
from pathlib import Path
from types import GenericAlias
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util.nodes import get_node_source, make_refnode

DOCSTRING = re.compile(r"docstring of ([\w.]+)")
LITERAL = re.compile(r"(``.*?``|`[^`]*`)")


def escape_bars(app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Take ``|x|`` in a docstring for an absolute value and not for a substitution."""
    for number, line in enumerate(lines):
        parts = LITERAL.split(line)
        parts[::2] = [part.replace("|", r"\|") for part in parts[::2]]
        lines[number] = "".join(parts)


def imported_name(
    app: Sphinx, env: BuildEnvironment, node: nodes.Element, contnode: nodes.Element
) -> nodes.Element | None:
    """Resolve a name as Python does in the docstring's module: an import, or a constant without a page.

    Returns
    -------
    Element or None
        A link to the place where an imported name is defined; the plain text of a constant; None, and so a warning,
        for a name that does not exist.
    """
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    found = next((found for start in _scopes(node) if (found := _find(start, target)) is not None), None)
    if found is None:
        return None
    home, value = found
    domain = env.domains.python_domain
    names = [f"{getattr(value, '__module__', None)}.{getattr(value, '__qualname__', None)}", home]
    for name in names:
        if (entry := domain.objects.get(name)) is not None:
            return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, [contnode], name)
    return contnode


def _scopes(node: nodes.Element) -> list[str]:
    """Return where a name is looked up: the docstring's object and all that holds it, then the top."""
    source = str(get_node_source(node) or "")
    parts = (found[1] if (found := DOCSTRING.search(source)) else node.get("py:module") or "evanesce").split(".")
    return [".".join(parts[:end]) for end in range(len(parts), -1, -1)]


def _find(module: str, target: str) -> tuple[str, Any] | None:
    """Import what a dotted name means, in a module or by itself."""
    parts = [*filter(None, module.split(".")), *target.split(".")]
    for end in range(len(parts), 0, -1):
        try:
            value = importlib.import_module(".".join(parts[:end]))
        except ImportError:
            continue
        for part in parts[end:]:
            fields = {**getattr(value, "__dataclass_fields__", {}), **getattr(value, "__annotations__", {})}
            if hasattr(value, part):
                value = getattr(value, part)
            elif part in fields:
                value = fields[part]
            else:
                return None
        return ".".join(parts), value
    return None


def skip_foreign_class(app: Sphinx, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Leave out a class that a module has from elsewhere, and an alias of a built-in one: they have no page here."""
    foreign = inspect.isclass(obj) and not str(obj.__module__).startswith("evanesce")
    return True if what == "module" and (foreign or isinstance(obj, GenericAlias)) else None


def drop_stale_pages(app: Sphinx, config: Any) -> None:
    """Remove generated pages of modules and names that are gone."""
    for page in (Path(app.srcdir) / "reference" / "api").glob("*.rst"):
        if _find("", page.stem) is None:
            page.unlink()


def setup(app: Sphinx) -> dict[str, bool]:
    """Register all of them."""
    app.connect("config-inited", drop_stale_pages)
    app.connect("autodoc-skip-member", skip_foreign_class)
    app.connect("autodoc-process-docstring", escape_bars)
    app.connect("missing-reference", imported_name)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
