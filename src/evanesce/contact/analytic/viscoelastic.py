"""A viscoelastic sphere pressed on glass, held and released: radius, depth, force, pressure and gap as they change.

While the contact grows, the elastic solution holds with the modulus turned into an operator (Lee and Radok). While it
shrinks, what counts is the time t1 at which the growing contact last had the present radius (Ting): every elastic
quantity X(a) becomes the history integral of its changes up to t1,

    value(t) = integral_0^t1 Psi(t - s) dX(a(s)),

with X = 4 a^3/(3 R) for the force, the Hertz pressure for the pressure. Displacements are the same integral of
Hertz's displacements, followed by the creep operator.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.contact.patch import AxisymmetricContact, axisymmetric_state
from evanesce.core.states import ContactState, PlateGrid
from evanesce.materials.prony import PronySeries

Floats = NDArray[np.float64]
MAX_STEPS = 6000


def reduced_series(youngs: PronySeries, poisson_ratio: float) -> PronySeries:
    """Return the reduced relaxation modulus E(t)/(1 - nu^2) of a body with constant Poisson ratio on rigid glass.

    Parameters
    ----------
    youngs : PronySeries
        Young's relaxation modulus [MPa].
    poisson_ratio : float

    Returns
    -------
    PronySeries
    """
    return youngs.scaled(1.0 / (1.0 - poisson_ratio**2))


@dataclass(frozen=True)
class ViscoelasticHistory:
    """One press, dwell and release.

    Attributes
    ----------
    time : ndarray (n,)
        [s].
    force, radius, depth : ndarray (n,)
        [N], [mm], [mm].
    growing_until : ndarray (n,)
        t1: time at which the growing contact had the present radius [s]; equals ``time`` while it grows.
    weights : ndarray (n, n - 1)
        Weight of each growth step's change in every later value [MPa].
    creep_weights : ndarray (n, n - 1)
        The same for the creep operator [1/MPa].
    tip_radius : float
        [mm].
    growth_radius : ndarray (n + 1,)
        Radii of the growth steps' ends, the rest state in front [mm].
    """

    time: Floats
    force: Floats
    radius: Floats
    depth: Floats
    growing_until: Floats
    weights: Floats
    creep_weights: Floats
    tip_radius: float
    growth_radius: Floats

    def _changes(self, shape: Callable[[Floats, Floats], Floats], r: Floats) -> Floats:
        """Return the changes of an elastic quantity over the growth steps, shape (n - 1, len(r))."""
        return np.diff(shape(self.growth_radius[:, None], r[None, :]), axis=0)

    def pressure(self, index: int, r: ArrayLike) -> Floats:
        """Return the pressure [MPa] at radii [mm] at one time index.

        Parameters
        ----------
        index : int
            Of the time.
        r : array_like
            [mm].

        Returns
        -------
        ndarray
            [MPa].
        """
        return self.weights[index] @ self._changes(self._pressure_shape, np.atleast_1d(np.asarray(r, dtype=float)))

    def force_within(self, index: int, r: ArrayLike) -> Floats:
        """Return the force inside radii [mm] at one time index [N].

        Parameters
        ----------
        index : int
            Of the time.
        r : array_like
            [mm].

        Returns
        -------
        ndarray
            [N].
        """
        return self.weights[index] @ self._changes(self._force_shape, np.atleast_1d(np.asarray(r, dtype=float)))

    def gap(self, index: int, r: ArrayLike) -> Floats:
        """Return the gap at radii [mm] at one time index [mm]; 0 in contact.

        Parameters
        ----------
        index : int
            Of the time.
        r : array_like
            [mm].

        Returns
        -------
        ndarray
            [mm].
        """
        radii = np.atleast_1d(np.asarray(r, dtype=float))
        loads = self.weights[: index + 1] @ self._changes(self._displacement_shape, radii)
        rest = np.zeros((1, len(radii)))  # before the first time nothing is loaded
        displaced = self.creep_weights[index, : index + 1] @ np.diff(np.vstack([rest, loads]), axis=0)
        gap = radii**2 / (2.0 * self.tip_radius) - self.depth[index] + displaced
        # Inside, the two operators undo each other only to the order of the time step; contact is contact.
        return np.where(radii <= self.radius[index], 0.0, np.maximum(gap, 0.0))

    def contact(self, index: int, samples: int = 1024) -> AxisymmetricContact:
        """Return one instant in the form every axisymmetric law has, tabulated on ``samples`` radii.

        Parameters
        ----------
        index : int
            Of the time.
        samples : int
            Radii of the table.

        Returns
        -------
        AxisymmetricContact
        """
        a = float(self.radius[index])
        reach = max(4.0 * float(self.radius.max()), 1e-6)
        # Spacing from the edge outwards is quadratic for the steep start of the gap, inwards sine for the pressure's.
        inner = a * np.sin(np.linspace(0.0, np.pi / 2, samples))
        outer = a + (reach - a) * np.linspace(0.0, 1.0, samples) ** 2
        carried, gap = self.force_within(index, inner), self.gap(index, outer)

        def far_gap(r: Floats) -> Floats:
            # Beyond the table the displaced surface has died down to the load's 1/r.
            tail = r**2 / (2.0 * self.tip_radius) - self.depth[index]
            end = (gap[-1] - (reach**2 / (2.0 * self.tip_radius) - self.depth[index])) * reach
            return np.where(r <= reach, np.interp(r, outer, gap), tail + end / np.maximum(r, reach))

        return AxisymmetricContact(
            contact_radius=a,
            normal_force=float(self.force[index]),
            depth=float(self.depth[index]),
            force_within=lambda r: np.interp(r, inner, carried) if a > 0 else np.zeros_like(r),
            gap=far_gap,
            shape_exponent=None,
        )

    def _force_shape(self, b: Floats, r: Floats) -> Floats:
        return 4.0 / (3.0 * self.tip_radius) * (b**3 - np.clip(b**2 - r**2, 0.0, None) ** 1.5)

    def _pressure_shape(self, b: Floats, r: Floats) -> Floats:
        return 2.0 / (np.pi * self.tip_radius) * np.sqrt(np.clip(b**2 - r**2, 0.0, None))

    def _displacement_shape(self, b: Floats, r: Floats) -> Floats:
        """Hertz's surface displacement per unit load operator (Johnson 1985, eq 3.42)."""
        ratio = np.divide(r, b, out=np.full(np.broadcast_shapes(b.shape, r.shape), np.inf), where=b > 0)
        outside = np.maximum(ratio, 1.0)
        with np.errstate(invalid="ignore"):
            far = ((2.0 - outside**2) * np.arcsin(1.0 / outside) + np.sqrt(outside**2 - 1.0)) / np.pi
        # The two terms cancel far out; there the series 4/(3 pi) b/r takes over.
        far = np.where(outside > 1e3, 4.0 / (3.0 * np.pi) / outside, far)
        return b**2 / self.tip_radius * np.where(ratio <= 1.0, 1.0 - 0.5 * ratio**2, far)


def viscoelastic_states(
    grid: PlateGrid,
    centre: tuple[float, float],
    history: ViscoelasticHistory,
    times: ArrayLike,
    parameters: Mapping[str, Any] | None = None,
) -> Iterator[ContactState]:
    """Yield the contact states of the computed instants nearest to the wanted times [s].

    Parameters
    ----------
    grid : PlateGrid
    centre : tuple of float
        (x, y) of the tip on the plate [mm].
    history : ViscoelasticHistory
    times : array_like
        Frame times [s]; the time in each state is that of the instant computed.
    parameters : mapping, optional
        Recorded in each state.

    Yields
    ------
    ContactState

    Raises
    ------
    InputError
        If a contact leaves the grid.
    """
    for wanted in np.atleast_1d(np.asarray(times, dtype=float)):
        i = int(np.argmin(np.abs(history.time - wanted)))
        found = {**(parameters or {}), "grown_until_s": float(history.growing_until[i])}
        now = float(history.time[i])
        contact = history.contact(i)
        yield axisymmetric_state(grid, centre, contact, law="viscoelastic_hertz", parameters=found, time=now)


def press_by_force(time: ArrayLike, force: ArrayLike, tip_radius: float, series: PronySeries) -> ViscoelasticHistory:
    """Return the contact under a prescribed force that rises, dwells and falls once.

    Parameters
    ----------
    time : array_like (n,)
        [s], not descending; a repeated time is a sudden change. At most 6000.
    force : array_like (n,)
        [N], >= 0, piecewise linear between the times; the first value acts suddenly at the first time.
    tip_radius : float
        [mm].
    series : PronySeries
        Reduced relaxation modulus E*(t) [MPa], see :func:`reduced_series`.

    Returns
    -------
    ViscoelasticHistory

    Raises
    ------
    ValueError
        For bad input, or where the contact grows again after it shrank: Ting's solution covers one maximum.

    References
    ----------
    E. H. Lee and J. R. M. Radok, J. Appl. Mech. 27 (1960) 438; T. C. T. Ting, J. Appl. Mech. 33 (1966) 845.
    """
    t, f = _checked(time, force, "force", tip_radius)
    relax, creep = _weights(t, series)
    grown = 0.75 * tip_radius * (creep @ np.diff(f))  # a^3 by Lee and Radok
    last = _turning_point(grown)
    cubes = np.where(np.arange(len(t)) <= last, grown, grown[last])
    wanted = 0.75 * tip_radius * f
    history = _finish(t, cubes, last, wanted, cubes, relax, creep, tip_radius)
    # The prescribed force is exact; the reconstructed one carries the error of the time step.
    return replace(history, force=f[1:])


def press_by_depth(time: ArrayLike, depth: ArrayLike, tip_radius: float, series: PronySeries) -> ViscoelasticHistory:
    """Return the contact under a prescribed depth [mm] that rises, dwells and falls once; as :func:`press_by_force`.

    The force vanishes before the depth does: the surface cannot follow (Ting 1966).

    Parameters
    ----------
    time : array_like (n,)
        [s], ascending.
    depth : array_like (n,)
        [mm].
    tip_radius : float
        [mm].
    series : PronySeries
        Reduced relaxation modulus [MPa].

    Returns
    -------
    ViscoelasticHistory
    """
    t, d = _checked(time, depth, "depth", tip_radius)
    relax, creep = _weights(t, series)
    last = _turning_point(d)
    held = np.where(np.arange(len(t)) <= last, d, d[last])
    history = _finish(t, (tip_radius * held) ** 1.5, last, relax @ np.diff(d), held, relax, creep, tip_radius)
    return replace(history, depth=d[1:])


def _checked(time: ArrayLike, values: ArrayLike, name: str, tip_radius: float) -> tuple[Floats, Floats]:
    """Return (time, values) with a rest state put in front, so that a first value above zero is a step."""
    t, v = (np.asarray(a, dtype=float).ravel() for a in (time, values))
    if len(t) != len(v) or not 2 <= len(t) <= MAX_STEPS:
        raise ValueError(f"{len(t)} times and {len(v)} values of {name}; 2 to {MAX_STEPS} of each are needed")
    if not (np.isfinite(t).all() and np.isfinite(v).all()) or np.any(np.diff(t) < 0) or v.min() < 0:
        raise ValueError(f"time must not descend and {name} not be negative, both finite")
    if v.max() <= 0 or tip_radius <= 0:
        raise ValueError(f"{name} is zero throughout, or the tip radius is not positive")
    return np.concatenate([t[:1], t]), np.concatenate([[0.0], v])


def _turning_point(values: Floats) -> int:
    """Return the last index before values first fall (by more than rounding)."""
    falls = np.flatnonzero(np.diff(values) < -1e-12 * values.max())
    return int(falls[0]) if len(falls) else len(values) - 1


def _weights(t: Floats, series: PronySeries) -> tuple[Floats, Floats]:
    """Return the mean of E*(t_n - s) and of its creep compliance over each earlier step, both (n, n - 1).

    With these means the history integral of a quantity that is piecewise linear in time is exact.
    """
    compliance = series.creep()
    return (
        _means(t, series.relaxation, series.relaxation_integral),
        _means(t, compliance.creep, compliance.creep_integral),
    )


def _means(t: Floats, kernel: Callable[[Floats], Floats], integral: Callable[[Floats], Floats]) -> Floats:
    age = np.clip(t[:, None] - t[None, :], 0.0, None)
    whole = integral(age)
    step = np.diff(t)
    sudden = step == 0.0
    mean = (whole[:, :-1] - whole[:, 1:]) / np.where(sudden, 1.0, step)
    if sudden.any():
        mean[:, sudden] = kernel(age[:, 1:][:, sudden])
    past = np.arange(len(t))[:, None] > np.arange(len(t) - 1)[None, :]
    return np.where(past, mean, 0.0)


def _finish(
    t: Floats,
    cubes: Floats,
    last: int,
    wanted: Floats,
    driven: Floats,
    relax: Floats,
    creep: Floats,
    tip_radius: float,
) -> ViscoelasticHistory:
    """Find t1 for the release and gather the history.

    For t beyond the turning point, ``integral_0^t1 Psi(t - s) d driven = wanted(t)`` fixes t1: under force control
    ``driven`` is a^3 and ``wanted`` (3R/4) F; under depth control it is the depth, and ``wanted`` the integral over
    all of it.
    """
    n = len(t)
    share = np.ones((n, n - 1))  # of each growth step that lies before t1
    t1, cube = t.copy(), cubes.copy()
    previous = float(last)
    steps = np.diff(driven)[:last]
    for i in range(last + 1, n):
        reached = np.concatenate([[0.0], np.cumsum(relax[i, :last] * steps)])
        position = float(np.interp(wanted[i], *_ascending(reached)))
        if position > previous + 1e-6 * max(1, last):
            raise ValueError(f"the contact grows again at {t[i]:g} s; Ting's solution covers a single maximum")
        previous = min(position, previous)
        k = min(int(position), last - 1)
        fraction = position - k
        t1[i] = t[k] + fraction * (t[k + 1] - t[k])
        cube[i] = cubes[k] + fraction * (cubes[k + 1] - cubes[k])
        share[i, :k], share[i, k], share[i, k + 1 :] = 1.0, fraction, 0.0
    weights = relax * share
    force = 4.0 / (3.0 * tip_radius) * (weights @ np.diff(np.where(np.arange(n) <= last, cubes, cubes[last])))
    growth = np.cbrt(np.maximum(np.where(np.arange(n) <= last, cubes, cubes[last]), 0.0))
    depth = creep @ np.diff(weights @ np.diff(growth**2 / tip_radius))
    keep = slice(1, None)  # the rest state in front was ours
    return ViscoelasticHistory(
        time=t[keep],
        force=force[keep],
        radius=np.cbrt(np.maximum(cube, 0.0))[keep],
        depth=depth[keep],
        growing_until=t1[keep],
        weights=weights[keep],
        creep_weights=creep[keep],
        tip_radius=tip_radius,
        growth_radius=growth,
    )


def _ascending(reached: Floats) -> tuple[Floats, Floats]:
    """Return (values, positions) with flat stretches (dwell) thinned to their last point, as interpolation needs."""
    rising = np.maximum.accumulate(reached)
    kept = np.concatenate([np.diff(rising) > 0.0, [True]])
    return rising[kept], np.flatnonzero(kept).astype(float)
