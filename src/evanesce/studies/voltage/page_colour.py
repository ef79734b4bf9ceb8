"""Sections of the voltage study's page that a scene with a colour camera has besides."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from evanesce.report.html import Section, Table
from evanesce.studies.voltage.colour_unknowns import SETTINGS
from evanesce.studies.voltage.in_colour import APPEARS_DN, FULL_DN, InColour
from evanesce.studies.voltage.unknowns import Unknown


def range_labels(unknown: Unknown, borders: Sequence[float]) -> list[str]:
    """Return labels of the parts of an unknown's range.

    Parameters
    ----------
    unknown : Unknown
    borders : sequence of float
        Of the parts, in the unknown's unit.

    Returns
    -------
    list of str
        For filters the responses of green.
    """
    if unknown.name == "filters":
        borders = [SETTINGS[int(b)][1] for b in borders]
    if unknown.choices and unknown.choices < len(borders):
        return [f"{k}" for k in range(unknown.choices)]
    return [f"{a:.2g}–{b:.2g}" for a, b in itertools.pairwise(borders)]


def share_rows(found: InColour) -> list[tuple[str, ...]]:
    """Return the table of shares: reading, vanishes, rises, converged, all three, usable, all three of the usable.

    Parameters
    ----------
    found : InColour

    Returns
    -------
    list of tuple of str
    """
    return [(name, *(str(share) for share in row.values())) for name, row in found.shares.items()]


SHARE_COLUMNS = (
    "reading", "vanishes near 8 V", "rises", "converged by 9 V", "all three", "usable at 9 V", "all three, of these",
)  # fmt: skip


def shares_section(found: InColour) -> Section:
    """Return the shares with and without colour.

    Parameters
    ----------
    found : InColour

    Returns
    -------
    Section
    """
    text = (
        "The same independent rigs, read in several ways; in brackets 95 % intervals of the share (Wilson). Usable: at "
        "9 V the segmentation finds neither nothing nor the whole finger, as it must where a threshold is chosen by "
        "eye. Without colour: a monochrome sensor as sensitive as the red pixels. Automatic exposure: the "
        "published control of libcamera, up to the longest exposure of a frame's time and its highest gain."
    )
    rows = [(f"{r['threshold']:g}", f"{100 * r['up_to_9_V']:.0f}", f"{100 * r['at_all']:.0f}") for r in found.agreement]
    columns = ("threshold", "up to 9 V [%]", "at any voltage [%]")
    title = "Reduced rig against the full colour chain: largest difference, over the larger of area and truth"
    return Section(
        "With and without colour", [text],
        tables=[Table(SHARE_COLUMNS, share_rows(found)), Table(columns, rows, title)],
    )  # fmt: skip


def states_section(found: InColour) -> Section:
    """Return what contact and flank look like by voltage, and how often the hypothesis of clipped red holds.

    Parameters
    ----------
    found : InColour

    Returns
    -------
    Section
    """
    text = (
        "Hypothesis: below 8 V contact and flank are both clipped red, from 8 V green appears in the contact, from 9 V "
        f"it is full. Green appears from {APPEARS_DN} DN, a channel is full from {FULL_DN} DN. First force; the light "
        "is that of the contact's mean."
    )
    rows = [
        (r["exposure"], f"{r['voltage_V']:g}", *(f"{100 * r[k]:.0f}" for k in (
            "red_not_full", "red_full", "green_appears", "green_full", "contact_and_flank_red_full")))
        for r in found.states
    ]  # fmt: skip
    columns = ("exposure", "voltage [V]", "red not full [%]", "red full, no green [%]", "some green [%]",
               "green full [%]", "contact and flank both full of red, no green [%]")  # fmt: skip
    held = [(name, str(share)) for name, share in found.hypothesis.items()]
    return Section(
        "Clipped red, then green, then full?", [text],
        tables=[Table(columns, rows, "Share of rigs"), Table(("what, at every force", "rigs"), held)],
    )  # fmt: skip
