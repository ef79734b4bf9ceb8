"""What the voltage study finds in colour: shares of rigs, contact and flank by voltage, reduced against full."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from evanesce.sensor.colour import ImageProcessor
from evanesce.studies.voltage.analysis import CONVERGED_V, FILLED_MM2, ONSET_V, Claims
from evanesce.studies.voltage.colour_rig import CONTROL, FILTERS, FLANK
from evanesce.studies.voltage.colour_unknowns import SETTINGS
from evanesce.studies.voltage.grey import GreyTable
from evanesce.studies.voltage.press import Press
from evanesce.studies.voltage.unknowns import SEEN, THRESHOLDS, Samples

Array = NDArray[np.float64]

SHOWN_THRESHOLDS = (0.0375, 0.15, 0.35, 0.6)
NEAR_V = 9.0
APPEARS_DN, FULL_DN = 16, 250
"""From these values on a channel is taken to be there, and to be full [DN]."""
STATES_V = (7.5, 7.75, 8.0, 8.25, 8.5, 9.0, 10.0, 12.0)
BELOW_V = 7.75
"""Voltage that stands for "below 8 V"."""


@dataclass(frozen=True, kw_only=True)
class Share:
    """A number of rigs among others.

    Attributes
    ----------
    hits, rigs : int
    low, high : float
        95 % interval of the share, by Wilson [1].
    """

    hits: int
    rigs: int
    low: float
    high: float

    @classmethod
    def of(cls, holds: NDArray[np.bool_]) -> Share:
        """Return the share of a flag.

        Parameters
        ----------
        holds : ndarray of bool (rigs,)

        Returns
        -------
        Share
            NaN limits without rigs.
        """
        hits, rigs = int(np.count_nonzero(holds)), int(holds.size)
        if not rigs:
            return cls(hits=0, rigs=0, low=float("nan"), high=float("nan"))
        found = binomtest(hits, rigs).proportion_ci(0.95, method="wilson")
        return cls(hits=hits, rigs=rigs, low=float(found.low), high=float(found.high))

    def __str__(self) -> str:
        if not self.rigs:
            return "none"
        return f"{100 * self.hits / self.rigs:.0f} % ({100 * self.low:.0f} to {100 * self.high:.0f})"


@dataclass(frozen=True, kw_only=True)
class InColour:
    """Findings of a scene with a colour camera.

    Attributes
    ----------
    shares : dict of dict of Share
        By reading: each observation and all, over all independent rigs (``vanishes`` ...) and, under ``all, usable``,
        over those whose segmentation at 9 V finds neither nothing nor the whole finger at any force.
    states : list of dict
        By voltage and exposure: shares of rigs by what the contact's red and green do (:func:`states`).
    hypothesis : dict of Share
        Of :func:`hypothesis`.
    agreement : list of dict
        By threshold: largest difference of the reduced rig from the full colour chain.
    """

    shares: Mapping[str, Mapping[str, Share]]
    states: Sequence[Mapping[str, Any]]
    hypothesis: Mapping[str, Share]
    agreement: Sequence[Mapping[str, Any]]

    def as_dict(self) -> dict[str, Any]:
        """Return plain data.

        Returns
        -------
        dict
        """
        return {
            "shares": {name: {k: asdict(v) for k, v in row.items()} for name, row in self.shares.items()},
            "states": [dict(row) for row in self.states],
            "hypothesis": {name: asdict(v) for name, v in self.hypothesis.items()},
            "reduced_against_full": [dict(row) for row in self.agreement],
        }


def usable(samples: Samples, own: Array) -> NDArray[np.bool_]:
    """Return which samples' estimate at 9 V is neither nothing nor the whole finger, at every force.

    Parameters
    ----------
    samples : Samples
    own : ndarray (samples, forces, voltages)
        Estimates [mm^2].

    Returns
    -------
    ndarray of bool (samples,)
    """
    near = own[..., int(np.argmin(np.abs(np.asarray(samples.plan.voltages) - NEAR_V)))]
    return np.asarray(((near >= SEEN * samples.true_area) & (near < FILLED_MM2)).all(axis=1))


def shares_of(
    samples: Samples, readings: Mapping[str, Claims], own: Mapping[str, Array]
) -> dict[str, dict[str, Share]]:
    """Return the shares of independent rigs that agree with the thesis, by reading.

    Parameters
    ----------
    samples : Samples
    readings : mapping of Claims
    own : mapping of ndarray (samples, forces, voltages)
        Estimates of the same readings [mm^2].

    Returns
    -------
    dict of dict of Share
    """
    some = samples.independent
    found = {}
    for name, claims in readings.items():
        kept = some[usable(samples, own[name])[some]]
        parts = {"vanishes": claims.vanishes, "rises": claims.rises, "settles": claims.settles, "all": claims.all}
        found[name] = {k: Share.of(v[some]) for k, v in parts.items()} | {
            "usable": Share.of(np.isin(some, kept)),
            "all, usable": Share.of(claims.all[kept]),
        }
    return found


def landmarks() -> Array:
    """Return the light levels of each setting at which red is full, green appears and green is full (settings, 3).

    Returns
    -------
    ndarray
        Over what fills a raw red pixel [1].
    """
    rows = []
    for temperature, green, blue in SETTINGS:
        table = GreyTable((1.0, green, blue), ImageProcessor.imx477(temperature))
        rows.append([table.first(0, FULL_DN), table.first(1, APPEARS_DN), table.first(1, FULL_DN)])
    return np.array(rows)


def states(
    samples: Samples, volts: Sequence[float] = (7.5, 7.75, 8.0, 8.25, 8.5, 9.0, 10.0, 12.0)
) -> list[dict[str, Any]]:
    """Return what contact and flank look like at some voltages, over the independent rigs and the first force.

    Parameters
    ----------
    samples : Samples
        With ``contact``.
    volts : sequence of float
        Those of the plan are used [V].

    Returns
    -------
    list of dict
        By exposure and voltage: shares [1] of rigs whose contact's red is not full; full, without green; with some
        green; full of green; and whose contact and flank are both full of red without green.
    """
    assert samples.contact is not None
    some, marks = samples.independent, landmarks()
    rows = []
    for control, word in ((0, "fixed"), (1, "automatic")):
        mine = some[samples.values[some, CONTROL] == control]
        red, green, full = marks[samples.values[mine, FILTERS].astype(int)].T
        for v in volts:
            if not mine.size or v not in samples.plan.voltages:
                continue
            level = samples.contact[mine, 0, samples.plan.voltages.index(v)]
            flank = level * samples.values[mine, FLANK.start]
            alike = (level >= red) & (level < green) & (flank >= red)
            parts = (
                level < red,
                (level >= red) & (level < green),
                (level >= green) & (level < full),
                level >= full,
                alike,
            )
            names = ("red_not_full", "red_full", "green_appears", "green_full", "contact_and_flank_red_full")
            row = {name: float(part.mean()) for name, part in zip(names, parts, strict=True)}
            rows.append({"exposure": word, "voltage_V": v, "rigs": int(mine.size)} | row)
    return rows


def hypothesis(samples: Samples) -> dict[str, Share]:
    """Return how many independent rigs do what "clipped red below 8 V, green from 8 V, full from 9 V" says, each force.

    Parameters
    ----------
    samples : Samples
        With ``contact``.

    Returns
    -------
    dict of Share
        Contact (and contact and flank) full of red without green at 7.75 V; green appears between the voltages of
        :data:`~evanesce.studies.voltage.analysis.ONSET_V`; green full at 9.25 V; all of these; and, of any voltage,
        whose flank is full of red before the contact turns green.
    """
    assert samples.contact is not None
    some, marks, v = samples.independent, landmarks(), np.asarray(samples.plan.voltages)
    red, green, full = marks[samples.values[some, FILTERS].astype(int)].T[:, :, None]
    flank = samples.values[some, FLANK.start][:, None]

    def at(volts: float) -> Array:
        assert samples.contact is not None
        return samples.contact[some][..., int(np.argmin(np.abs(v - volts)))]

    below = at(BELOW_V)
    contact_red = ((below >= red) & (below < green)).all(axis=1)
    both = contact_red & (flank * below >= red).all(axis=1)
    appears = ((at(ONSET_V[0]) < green) & (at(ONSET_V[1]) >= green)).all(axis=1)
    filled = (at(CONVERGED_V) >= full).all(axis=1)
    before = (flank * green >= red).all(axis=1)
    return {
        f"contact full of red, no green, at {BELOW_V:g} V": Share.of(contact_red),
        f"contact and flank full of red, no green, at {BELOW_V:g} V": Share.of(both),
        f"green appears from {ONSET_V[0]:g} to {ONSET_V[1]:g} V": Share.of(appears),
        f"green full at {CONVERGED_V:g} V": Share.of(filled),
        "contact red, then green, then full, at these voltages": Share.of(contact_red & appears & filled),
        "contact and flank red, then green, then full": Share.of(both & appears & filled),
        "flank full of red before the contact turns green, at any voltage": Share.of(before),
    }


def agreement(reduced: Array, full: Array, true_area: Array, voltages: Sequence[float]) -> list[dict[str, Any]]:
    """Return the largest difference of reduced rig and full chain by threshold.

    Parameters
    ----------
    reduced, full : ndarray (forces, voltages, THRESHOLDS)
        Areas [mm^2].
    true_area : ndarray (forces,)
        [mm^2].
    voltages : sequence of float
        [V].

    Returns
    -------
    list of dict
        Difference over the larger of full chain's area and truth, up to 9 V and at all [1].
    """
    apart = np.abs(reduced - full) / np.maximum(full, true_area[:, None, None])
    low = np.asarray(voltages) <= NEAR_V
    return [
        {
            "threshold": t,
            "up_to_9_V": float(apart[:, low, THRESHOLDS.index(t)].max(initial=0.0)),
            "at_all": float(apart[:, :, THRESHOLDS.index(t)].max()),
        }
        for t in SHOWN_THRESHOLDS
    ]


def flank_share(press: Press) -> float:
    """Return the flank's light over the contact's in a press rendered in full.

    Median between 0.75 and 0.85 of the finger's radius, where little scattered light arrives, over the mean of pixels
    brighter than half of the brightest percentile.

    Parameters
    ----------
    press : Press

    Returns
    -------
    float
        [1].
    """
    scene, image = press.rig, press.irradiance
    cols, rows = scene.camera.resolution_px
    scale, centre = scene.camera.scale_px_per_mm, scene.camera.centre_mm
    x = (np.arange(image.shape[1]) + press.window.c0 + 0.5 - cols / 2) / scale + centre[0] - scene.finger.position_mm[0]
    y = (np.arange(image.shape[0]) + press.window.r0 + 0.5 - rows / 2) / scale + centre[1] - scene.finger.position_mm[1]
    radius = np.hypot(x[None, :], y[:, None]) / (scene.finger.diameter_mm / 2)
    ring = (radius > 0.75) & (radius < 0.85)
    bright = image > 0.5 * np.percentile(image, 99.0)
    return float(np.median(image[ring]) / image[bright].mean()) if ring.any() and bright.any() else 0.0


def in_colour(samples: Samples, readings: Mapping[str, Claims], agreed: Sequence[Mapping[str, Any]]) -> InColour:
    """Return the findings in colour.

    Parameters
    ----------
    samples : Samples
    readings : mapping of Claims
        The first of the samples themselves, then those of ``samples.other``.
    agreed : sequence of mapping
        Of :func:`agreement`.

    Returns
    -------
    InColour
    """
    own = {next(iter(readings)): samples.own} | dict(samples.other)
    return InColour(
        shares=shares_of(samples, readings, own), states=states(samples), hypothesis=hypothesis(samples),
        agreement=agreed,
    )  # fmt: skip
