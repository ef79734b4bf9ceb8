"""How a cause is named where others stand in for it or make up for it: the same in every adapter, table and page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from evanesce.inference.groups import group_of


def told_of(name: str, credible_set: Sequence[str]) -> str:
    """Return a cause with those that stand in for it, and their group; those alone where it is none of them.

    Parameters
    ----------
    name : str
        Of the cause that was fitted.
    credible_set : sequence of str
        Of its place.
    """
    likely = sorted(credible_set, key=lambda other: other != name)
    group = group_of(likely) if len(likely) > 1 else ""
    words = " or ".join(likely) + (f" ({group})" if group else "")
    return words if name in likely else f"{words}, fitted as {name}"


def partner_of(cause: Mapping[str, Any]) -> str:
    """Return which cause of the answer makes up for another; empty if none does.

    Parameters
    ----------
    cause : mapping
        In the answer's form.
    """
    together = cause.get("together")
    return str(together["with"]) if together else ""


def label_of(cause: Mapping[str, Any]) -> str:
    """Return the name of a cause of the answer for a table, in which those that stand in for it have a column.

    Parameters
    ----------
    cause : mapping
        In the answer's form.
    """
    name = cause["id"] if cause["id"] in cause["credible_set"] else cause["told"]
    partner = partner_of(cause)
    return f"{name} (with {partner})" if partner else str(name)
