"""Contact area against force: offset of the two clocks, and Hertz's and a power law fitted.

A finger's area depends on force alone while it loads, so that of all offsets the right one makes area a smooth rising
function of force, and area and force begin together. The offset is the one that leaves least of a power law
``A = c F^p`` over the frames of loading, unloaded frames included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar
from scipy.stats import t as student

from evanesce.core.errors import InputError
from evanesce.measurement.io.force import ForceLog
from evanesce.measurement.reference.area import AreaRow
from evanesce.measurement.warnings import Warning

Floats = NDArray[np.float64]

HERTZ = 2.0 / 3.0
"""Exponent of area against force of a sphere on a plane (H. Hertz, J. reine angew. Math. 92, 156-171, 1882)."""

STEPS = 401
LEAST_POINTS = 6
LEAST_SHARE = 1e-3
"""Share of the greatest force below which there is no contact: a load cell's noise is no force."""

PIECES = 6
"""Of a film that are left out in turn."""

REACH = (10, 6)
"""Frames about a first offset within which the best is looked for, of the film and without a piece of it."""

NO_FORCE = 3.0
"""Standard deviations of the log's noise up to which a force is none."""

LEAST_RATIO = 1.1
"""Largest over smallest force from which an exponent is fitted: a choice."""

NORMAL_95 = 1.959963984540054
POOR_FIT = 0.05
"""RMS that a power law leaves, of the greatest area, from which areas and forces hardly belong together: of a press
that only loads it leaves less than 0.02."""

LEAST_REACHED = 0.1
"""Share of the log's greatest force that a film of the press reaches at least."""

UNTARED, LEAST_FREE = 0.02, 3
"""Force of frames without contact, of the log's greatest, from which its zero moves an exponent by 0.02 or more; and
how many such frames say so."""

PLAUSIBLE_POWERS = (0.3, 1.2)
"""Exponents of area against force: 2/3 of a smooth elastic sphere, to 1 of rough skin."""

MOST_MOVED_S = 1.0
"""Offset's standard uncertainty up to which it is carried into the fits [s]: beyond it is not determined at all."""


@dataclass(frozen=True, kw_only=True)
class Fit:
    """``A = factor F^exponent`` [mm^2, N], with 95 % intervals from the scatter of the frames.

    Attributes
    ----------
    factor, exponent : float
    factor_low, factor_high, exponent_low, exponent_high : float
    rms_mm2 : float
        Of what the fit leaves.
    """

    factor: float
    factor_low: float
    factor_high: float
    exponent: float
    exponent_low: float
    exponent_high: float
    rms_mm2: float


@dataclass(frozen=True, kw_only=True)
class AreaForce:
    """Areas with their forces.

    Attributes
    ----------
    offset_s, offset_standard_s : float
        What is added to a frame's time to get the load cell's, and its standard uncertainty (0 of a given one): 1.96 of
        it make the 95 % interval [s].
    rows : tuple of AreaRow
        Frames within the log.
    force_N : tuple of float
        Of those frames.
    hertz, power : Fit
        With the exponent 2/3, and with it free.
    most_N : float
        Greatest force of the whole log.
    """

    offset_s: float
    offset_standard_s: float
    rows: tuple[AreaRow, ...]
    force_N: tuple[float, ...]
    hertz: Fit
    power: Fit
    most_N: float

    @property
    def offset_interval_s(self) -> tuple[float, float]:
        """95 % interval of the offset [s]; without width where it was given."""
        half = NORMAL_95 * self.offset_standard_s
        return self.offset_s - half, self.offset_s + half

    def warnings(self) -> list[Warning]:
        """Return what speaks against areas and forces of the same press.

        Returns
        -------
        list of Warning
        """
        most = max(row.area_mm2 for row in self.rows)
        share, power = self.power.rms_mm2 / most, self.power.exponent
        low, high = PLAUSIBLE_POWERS
        if max(self.force_N) < LEAST_REACHED * self.most_N:
            text = (
                f"the film's frames reach {max(self.force_N):.3g} N of the log's {self.most_N:.3g} N: is its clock in"
                " seconds, and of this film?"
            )
            return [Warning("area_force_at_odds", text)]
        free = np.array([force for row, force in zip(self.rows, self.force_N, strict=True) if not row.area_mm2 > 0])
        if len(free) >= LEAST_FREE and abs(float(np.median(free))) > UNTARED * self.most_N:
            text = (
                f"the load cell shows {float(np.median(free)):.3g} N in {len(free)} frames without contact: take it off"
                " the forces, or the law is that of another finger"
            )
            return [Warning("force_not_tared", text)]
        if share <= POOR_FIT and low <= power <= high:
            return []
        text = (
            f"a power law leaves {100 * share:.0f} % of the greatest area (usual: below {100 * POOR_FIT:.0f} %), with"
            f" the exponent {power:.2f} (usual: {low:g} to {high:g}): forces of this press, with its clock and unit?"
        )
        return [Warning("area_force_at_odds", text)]

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, units in the keys."""
        frames = [
            {"index": r.index, "time_s": r.time_s, "force_N": f, "area_mm2": r.area_mm2,
             "area_low_mm2": r.area_low_mm2, "area_high_mm2": r.area_high_mm2}
            for r, f in zip(self.rows, self.force_N, strict=True)
        ]  # fmt: skip
        return {
            "offset_s": self.offset_s, "offset_standard_s": self.offset_standard_s, "frames": frames,
            "hertz": asdict(self.hertz), "power_law": asdict(self.power),
        }  # fmt: skip


def area_force(rows: Sequence[AreaRow], log: ForceLog, offset_s: float | None = None) -> AreaForce:
    """Join areas and forces and fit both laws.

    Parameters
    ----------
    rows : sequence of AreaRow
        With times.
    log : ForceLog
    offset_s : float, optional
        Added to a frame's time to get the load cell's [s]; found if not given.

    Returns
    -------
    AreaForce

    Raises
    ------
    InputError
        If forces are negative, frames have no times, fewer than six with contact lie within the log, or their forces
        are all alike.
    """
    time, area = np.array([r.time_s for r in rows]), np.array([r.area_mm2 for r in rows])
    if not np.isfinite(time).all():
        raise InputError("the frames have no times", key="--force", allowed="a video with time stamps, or --fps")
    if -float(log.force_N.min()) > float(log.force_N.max()):
        raise InputError(
            f"forces fall to {log.force_N.min():.4g} N and reach {log.force_N.max():.4g} N: is their sign turned?",
            key="--force", allowed="forces that are positive where the finger presses",
        )  # fmt: skip
    standard = 0.0
    if offset_s is None:
        offset_s, standard = _offset(time, area, log)
    force = log.at(time + offset_s)
    known = np.isfinite(force)
    good = known & (force > 0) & (area > 0)
    if good.sum() < LEAST_POINTS:
        raise InputError(
            f"{int(good.sum())} frame(s) with contact and force at an offset of {offset_s:.3f} s; the log lasts"
            f" {np.ptp(log.time_s):.4g} s, the film {np.ptp(time):.4g} s: is its clock in seconds?", key="--offset-s",
            allowed=f"one at which at least {LEAST_POINTS} have both, or auto",
        )  # fmt: skip
    low, high = float(force[good].min()), float(force[good].max())
    if high < LEAST_RATIO * low:
        raise InputError(
            f"frames with contact have forces of {low:.4g} to {high:.4g} N, and no law of force shows in them",
            key="--force", allowed=f"a log in which they rise by {100 * (LEAST_RATIO - 1):.0f} % or more",
        )  # fmt: skip
    fitted = []
    for exponent in (HERTZ, None):
        moved = []
        for sign in (-1.0, 1.0):
            other = log.at(time + offset_s + sign * min(standard, MOST_MOVED_S))
            both = good & np.isfinite(other) & (other > 0)
            moved.append(_fit(other[both], area[both], exponent) if both.sum() >= LEAST_POINTS else None)
        fitted.append(_widened(_fit(force[good], area[good], exponent), moved))
    return AreaForce(
        offset_s=offset_s, offset_standard_s=standard,
        rows=tuple(row for row, k in zip(rows, known, strict=True) if k), force_N=tuple(map(float, force[known])),
        hertz=fitted[0], power=fitted[1], most_N=float(log.force_N.max()),
    )  # fmt: skip


def _widened(fit: Fit, moved: Sequence[Fit | None]) -> Fit:
    """Return a fit whose intervals hold the offset's standard uncertainty as well, by fits at one either side of it."""
    if any(other is None for other in moved):
        return fit
    low, high = (other for other in moved if other is not None)
    factor = 0.5 * NORMAL_95 * abs(float(np.log(high.factor / low.factor)))
    power = 0.5 * NORMAL_95 * abs(high.exponent - low.exponent)
    half = float(np.hypot(np.log(fit.factor_high / fit.factor), factor))
    wide = float(np.hypot(fit.exponent_high - fit.exponent, power))
    return replace(
        fit, factor_low=fit.factor * float(np.exp(-half)), factor_high=fit.factor * float(np.exp(half)),
        exponent_low=fit.exponent - wide, exponent_high=fit.exponent + wide,
    )  # fmt: skip


def _left(time: Floats, area: Floats, log: ForceLog, offset: float) -> tuple[float, int]:
    """Return the mean square that a power law leaves at an offset [mm^4], and the number of frames."""
    force = log.at(time + offset)
    known = np.isfinite(force)
    if known.sum() < max(LEAST_POINTS, 0.5 * len(time)) or not (area[known] > 0).any():
        return float("inf"), 0
    pressed = np.clip(force[known], 0.0, None)
    if not pressed.max() > 0:
        return float("inf"), 0

    factor, power = _law(pressed, area[known])
    return float(np.mean((area[known] - factor * pressed**power) ** 2)), int(known.sum())


def _law(force: Floats, area: Floats) -> tuple[float, float]:
    """Return factor and exponent of the power law that leaves least of areas, those without force included."""

    def factor(power: float) -> float:
        shape = force**power
        return float((shape @ area) / (shape @ shape))

    def misfit(power: float) -> float:
        return float(np.mean((area - factor(power) * force**power) ** 2))

    best = minimize_scalar(misfit, bounds=(0.2, 1.5), method="bounded", options={"xatol": 1e-3})
    return factor(float(best.x)), float(best.x)


def _offset(time: Floats, area: Floats, log: ForceLog) -> tuple[float, float]:
    """Return the offset that leaves least, and its standard uncertainty [s]."""
    low, high = float(log.time_s[0] - time[-1]), float(log.time_s[-1] - time[0])
    tried = np.linspace(low, high, STEPS)
    left = np.array([_left(time, area, log, offset)[0] for offset in tried])
    if not np.isfinite(left).any():
        raise InputError("no offset brings areas and forces together", key="--offset-s", allowed="a number of seconds")
    middle, step = float(tried[int(left.argmin())]), float(tried[1] - tried[0])
    best = minimize_scalar(
        lambda offset: _left(time, area, log, offset)[0] if np.isfinite(_left(time, area, log, offset)[0]) else 1e12,
        bounds=(middle - 1.5 * step, middle + 1.5 * step), method="bounded", options={"xatol": 1e-4},
    )  # fmt: skip
    return _refined_offset(time, area, log, float(best.x))


def _refined_offset(time: Floats, area: Floats, log: ForceLog, start: float) -> tuple[float, float]:
    """Return an offset near a first one, and its standard uncertainty: a 1.96th of its interval's half-width [s].

    No finger obeys a power law exactly, and what it leaves moves the offset: the law may bend with the logarithm of the
    force. What is left still is not independent from frame to frame, since codec and law err for many frames alike, and
    a few frames, those of the landing, may fix the offset alone. So the film is cut into pieces, each is left out in
    turn, and the offsets of the rest differ by what any of that does: the jackknife by blocks (H. R. Kuensch, Annals of
    Statistics 17, 1217-1241, 1989), with Student's quantile for so few.
    """
    known = np.isfinite(log.at(time + start))
    times, seen = time[known], area[known]
    pressed = np.clip(log.at(times + start), 0.0, None)
    power, unit = _law(pressed, seen)[1], float(pressed.max())
    noise = float(np.median(np.abs(np.diff(log.force_N, 2)))) / (0.6745 * 6**0.5) if len(log.force_N) > 2 else 0.0
    step = max(float(np.median(np.diff(time))), 1e-3)

    def left(offset: float, chosen: NDArray[np.bool_]) -> float:
        force = np.interp(times + offset, log.time_s, log.force_N)
        share = np.where(force > NO_FORCE * noise, force, 0.0) / unit
        bend = np.log(np.maximum(share, LEAST_SHARE))
        terms = (share**power)[:, None] * np.stack([np.ones_like(bend), bend, bend**2], axis=1)
        solved = np.linalg.lstsq(terms[chosen], seen[chosen], rcond=1e-10)[0]
        return float(np.mean((seen - terms @ solved)[chosen] ** 2))

    def best(chosen: NDArray[np.bool_], near: float, reach: int) -> float:
        tried = near + step * np.linspace(-reach, reach, 8 * reach + 1)
        k = int(np.argmin([left(offset, chosen) for offset in tried]))
        bounds = tried[max(k - 1, 0)], tried[min(k + 1, len(tried) - 1)]
        found = minimize_scalar(left, bounds=bounds, args=(chosen,), method="bounded", options={"xatol": 1e-5})
        return float(found.x)

    offset = best(np.ones(len(seen), np.bool_), start, REACH[0])
    pieces = np.array_split(np.arange(len(seen)), PIECES)
    if len(pieces[-1]) < 2:
        return offset, float("inf")
    others = np.array([best(~np.isin(np.arange(len(seen)), piece), offset, REACH[1]) for piece in pieces])
    standard = float(np.sqrt((PIECES - 1) / PIECES * ((others - others.mean()) ** 2).sum()))
    return offset, standard * float(student.ppf(0.975, PIECES - 1)) / NORMAL_95


def _fit(force: Floats, area: Floats, exponent: float | None) -> Fit:
    """Fit a power law in area, by least squares, with Student's intervals of its linearised scatter."""

    def residual(x: Floats) -> Floats:
        return np.asarray(np.exp(x[0]) * force ** (x[1] if exponent is None else exponent) - area)

    start = [float(np.log(np.median(area / force**HERTZ)))] + ([HERTZ] if exponent is None else [])
    solved = least_squares(residual, start)
    free = max(len(area) - len(start), 1)
    variance = float((solved.fun**2).sum() / free)
    wide = float(student.ppf(0.975, free)) * np.sqrt(np.diag(np.linalg.inv(solved.jac.T @ solved.jac)) * variance)
    power = exponent if exponent is not None else float(solved.x[1])
    half = float(wide[1]) if exponent is None else 0.0
    return Fit(
        factor=float(np.exp(solved.x[0])), factor_low=float(np.exp(solved.x[0] - wide[0])),
        factor_high=float(np.exp(solved.x[0] + wide[0])), exponent=power, exponent_low=power - half,
        exponent_high=power + half, rms_mm2=float(np.sqrt(np.mean(solved.fun**2))),
    )  # fmt: skip
