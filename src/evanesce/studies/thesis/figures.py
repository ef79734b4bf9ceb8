"""Figures and observations of the thesis beside what its own inputs give: areas, depths, friction, voltages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bench.indentation import elliptic_geometry
from evanesce.contact.analytic.hertz import hertz_radius
from evanesce.contact.analytic.jkr import jkr_radius
from evanesce.contact.fem.library import FAR_SLIDES, library_press, library_slide
from evanesce.materials.tables import material
from evanesce.studies.mechanics.runs import BONES
from evanesce.studies.mechanics.study import mesh_error, modulus_at_ridges

Floats = NDArray[np.float64]

RADIUS = 7.5  # [mm]
FORCES = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0)  # [N]
SURFACE_ENERGIES = (0.001, 0.005, 0.01)  # [N/mm]
POSSIBLE = ("measured", "Hertz, ", "finite")
"""Laws whose areas may be those of the friction rig, by the beginning of their names."""


@dataclass(frozen=True, kw_only=True)
class Reproduced:
    """A figure of the thesis beside the one computed from its inputs.

    Attributes
    ----------
    figure : str
    what, unit : str
    thesis : float
    value, low, high : float
    reason : str
        Why they would differ; shown where they do.
    """

    figure: str
    what: str
    unit: str
    thesis: float
    value: float
    low: float
    high: float
    reason: str
    simulated: bool = True
    """False where both sides are the thesis's own laws or closed forms."""

    @property
    def wide(self) -> bool:
        """Whether the interval's ends are more than half as far apart again as its lower end."""
        return self.low > 0 and self.high > 1.5 * self.low

    @property
    def agrees(self) -> bool:
        """Whether the thesis's figure lies in the interval."""
        return self.low <= self.thesis <= self.high


def spanning(
    figure: str, what: str, unit: str, thesis: float, values: Sequence[float], reason: str, *, simulated: bool = True
) -> Reproduced:
    """Return an entry whose value is the first of several and whose interval holds them all.

    Parameters
    ----------
    figure, what, unit : str
    thesis : float
        The thesis's figure.
    values : sequence of float
        Computed ones, the preferred first.
    reason : str
        Of a disagreement.
    simulated : bool

    Returns
    -------
    Reproduced
    """
    low, high = float(min(values)), float(max(values))
    return Reproduced(figure=figure, what=what, unit=unit, thesis=thesis, value=float(values[0]), low=low, high=high,
                      reason=reason, simulated=simulated)  # fmt: skip


def area_laws(name: str) -> dict[str, Floats]:
    """Return the contact area of a material by every law at :data:`FORCES` [mm^2].

    Parameters
    ----------
    name : str
        Of the material.

    Returns
    -------
    dict of str to ndarray (forces,)
        [mm^2].
    """
    force, silicone = np.array(FORCES), material(name)
    modulus = silicone.reduced_modulus(force)
    hertz = np.pi * hertz_radius(force, RADIUS, modulus) ** 2
    laws: dict[str, Floats] = {}
    if silicone.measured_area is not None:
        laws["measured (power laws)"] = silicone.measured_area.area(force)
    laws["Hertz, E* on glass"] = hertz
    if silicone.hertz_area_scale is not None:
        laws[f"Hertz times {silicone.hertz_area_scale.value:g}"] = silicone.hertz_area_scale.value * hertz
    for energy in SURFACE_ENERGIES:
        laws[f"JKR, {1000 * energy:g} J/m²"] = np.pi * jkr_radius(force, RADIUS, modulus, energy) ** 2
    laws["Hertz, E* = 4 G"] = np.pi * hertz_radius(force, RADIUS, modulus_at_ridges(name)) ** 2
    for bone in BONES:
        press = library_press(name, bone)
        title = "finite elements, " + ("no bone" if bone == "none" else "bone")
        laws[title] = np.array([press.area(float(f)) for f in force])
    return laws


def published_depth(name: str, force: float) -> float:
    """Return the depth behind the published E*(F) on glass, delta^1.5 = (3/4) F/(sqrt(R) E*) [mm].

    Parameters
    ----------
    name : str
        Of the material.
    force : float
        [N].

    Returns
    -------
    float
        [mm].
    """
    return float((0.75 * force / (np.sqrt(RADIUS) * material(name).reduced_modulus(force))) ** (2 / 3))


def fe_interval(name: str, force: float, of: str) -> list[float]:
    """Return area [mm^2] or depth [mm] by finite elements: without bone, then with one, each with its mesh error.

    Parameters
    ----------
    name : str
        Of the material.
    force : float
        [N].
    of : {"area", "depth"}

    Returns
    -------
    list of float
        [mm^2] or [mm].
    """
    error = mesh_error(name)
    found = []
    for bone in BONES:
        press = library_press(name, bone)
        value = press.area(force) if of == "area" else float(press.at(force).depth)
        found += [value, value * (1 - error), value * (1 + error)]
    return found


def area_figures() -> Iterator[Reproduced]:
    """Yield area against force and the factors between laws and waveguide.

    Yields
    ------
    Reproduced
    """
    measured, laws = material("silskin_20").measured_area, area_laws("silskin_20")
    assert measured is not None  # in the tables
    reason = "no adhesion and no creep in the finite elements; the waveguide's patch may hold scattered light beside it"
    for force in FORCES:
        yield spanning("area against force, Silskin 20 %", f"area at {force:g} N", "mm²", float(measured.area(force)),
                       fe_interval("silskin_20", force, "area"), reason)  # fmt: skip
    hertz = laws["measured (power laws)"] / laws["Hertz, E* on glass"]
    yield spanning("area against force, Silskin 20 %", "measured over Hertz area", "1", 1.66,
                   [float(hertz.mean()), *hertz.tolist()], "the ratio depends on force", simulated=False)  # fmt: skip
    fe = np.concatenate([laws["measured (power laws)"] / laws[f"finite elements, {b}"] for b in ("no bone", "bone")])
    yield spanning("area against force, Silskin 20 %", "measured over finite-element area", "1", 1.8,
                   [float(fe[: len(FORCES)].mean()), *fe.tolist()], "the ratio depends on force and bone")  # fmt: skip
    glass = material("silskin_0").area_deviation
    assert glass is not None  # in the tables
    hertz_5N = float(np.pi * hertz_radius(5.0, RADIUS, material("silskin_0").reduced_modulus(5.0)) ** 2)
    away = [abs(area / hertz_5N - 1.0) for area in fe_interval("silskin_0", 5.0, "area")]
    yield spanning("area against force, Silskin 0 %", "deviation from Hertz at 5 N", "1", glass.value, away,
                   "the sign is not printed; the bone's size is not, and decides this area")  # fmt: skip


def depth_figures() -> Iterator[Reproduced]:
    """Yield force against displacement on glass, and the two constants of the indenter's formula.

    Yields
    ------
    Reproduced
    """
    reason = (
        "table 6's material is about half as stiff in small strain as the flat-plate fit says, and the shaft's own"
        " shortening is part of the finite elements' depth; the bone's size is not printed"
    )
    for name, title in (("silskin_0", "Silskin 0 %"), ("silskin_20", "Silskin 20 %")):
        for force in (1.0, 2.0, 5.0):
            yield spanning(f"force against displacement, {title}", f"depth at {force:g} N", "mm",
                           published_depth(name, force), fe_interval(name, force, "depth"), reason)  # fmt: skip
    for radius, thesis, who in ((8.2, 0.5881, "human"), (7.5, 0.5988, "synthetic")):
        # the thesis defines its modulus as twice the usual E*
        exact = float(elliptic_geometry(radius, 12.725).depth(1.0, 0.5))
        yield spanning("stiffness by indenter, eqs 3.4 and 3.7", f"delta (E'/F)^(2/3), {who}", "1", thesis, [exact],
                       "Brewe and Hamrock's regressions stand for the elliptic integrals: 2 % of depth",
                       simulated=False)  # fmt: skip


def friction_figures() -> Iterator[Reproduced]:
    """Yield static friction at 1 N from the published rheology, over the areas that are possible.

    Yields
    ------
    Reproduced
    """
    for name, title in (("silskin_0", "Silskin 0 %"), ("silskin_20", "Silskin 20 %")):
        silicone = material(name)
        assert silicone.friction is not None  # in the tables
        laws = area_laws(name)
        areas = [float(area[FORCES.index(1.0)]) for law, area in laws.items() if law.startswith(POSSIBLE)]
        mu = [silicone.friction.tau0_MPa * a + silicone.friction.alpha for a in areas]
        usual = silicone.friction.tau0_MPa * float(laws["Hertz, E* on glass"][1]) + silicone.friction.alpha
        yield spanning("static friction at 1 N, 1 mm/s", title, "1", silicone.friction.static_coefficient_smooth,
                       [usual, *mu], "the law's fit over all forces does not pass through this point",
                       simulated=False)  # fmt: skip


def voltage_figures(volts: Mapping[str, Any]) -> Iterator[Reproduced]:
    """Yield where the patch is lost and where its area settles.

    Parameters
    ----------
    volts : mapping
        Of :attr:`~evanesce.studies.thesis.study.ThesisStudy.volts`.

    Yields
    ------
    Reproduced
    """
    some = [volts[f"{force:g} N"] for force in (1.0, 5.0)]
    step = 0.25
    lost = [entry["onset_V"] for entry in some]
    yield spanning("estimated area against voltage", "patch lost below", "V", 8.0,
                   [*lost, min(lost) - step, max(lost) + step],
                   "exposure and the LEDs' bin are not published and decide it")  # fmt: skip
    settled = [entry["converged_V"] for entry in some]
    yield spanning("estimated area against voltage", "converged from", "V", 9.0,
                   [*settled, min(settled) - step, max(settled) + step],
                   "at a fixed exposure scattered light grows with voltage; with exposure control it would settle"
                   " (docs/background/voltage.md)")  # fmt: skip


def observations(curves: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, str, str]]:
    """Return the thesis's observations in words, what follows from its inputs, and a verdict.

    Parameters
    ----------
    curves : mapping
        Of the solved slides (:func:`evanesce.studies.mechanics.study.slide_curves`).

    Returns
    -------
    list of tuple of str
    """
    held = [one for one in curves.values() if one["held"] == "force"]
    soft, stiff = (library_slide(FAR_SLIDES[name, "none"][0]).scalars for name in ("silskin_20", "silskin_0"))
    changes = 100 * (soft["area"] / soft["area"][0] - 1)
    slips = float(stiff["slide"][int(np.argmax(stiff["tangential_force"] > 0.99 * stiff["tangential_force"].max()))])
    boned = library_slide(FAR_SLIDES["silskin_0", "half"][0]).scalars
    swing = np.percentile((boned["tangential_force"] / boned["normal_force"])[boned["slide"] > 5.0], (5, 95))
    pull = float(soft["tangential_force"][-1] / soft["normal_force"][-1])
    ends = [100 * (float(one["area_ratio"][-1]) - 1) for one in held]
    friction = material("silskin_0").friction
    assert friction is not None  # in the tables
    force = np.array(FORCES)
    area = np.pi * hertz_radius(force, RADIUS, material("silskin_0").reduced_modulus(force)) ** 2
    mu = friction.tau0_MPa * area / force + friction.alpha
    return [
        (
            "under rising shear the area shrinks, then stays in gross slip",
            f"{min(ends):+.0f} to {max(ends):+.0f} % at 1 N held, by bending alone",
            "agrees in sign" if max(ends) < 0 else "does not follow",
        ),
        (
            "static friction falls as the normal force rises",
            f"{mu[0]:.2f} at {force[0]:g} N to {mu[-1]:.2f} at {force[-1]:g} N (Silskin 0 %, Hertz's area)",
            "follows from the published law" if (np.diff(mu) < 0).all() else "does not follow",
        ),
        (
            "static friction rises with speed",
            "the published law has no speed in it; slide.speed_exponent sets a power of it",
            "not reproduced: no figure to compute it from",
        ),
        (
            "Silskin 20 % first gains area, then loses it, and sticks far longer",
            f"solid, 1 N, mu 1.75: {max(changes):+.0f} % at most, {changes[-1]:+.0f} % after"
            f" {soft['slide'][-1]:.0f} mm, where it pulls {pull:.2f} of its load; Silskin 0 % at mu 1.13 slips from"
            f" {slips:.0f} mm",
            "agrees" if max(changes) > 0 > changes[-1] and pull < 1.7 else "does not follow",
        ),
        (
            "micro stick-slip in gross slip of Silskin 0 %",
            f"over a bone at mu 1.13 skin folds and slips by turns, {swing[0]:.2f} to {swing[1]:.2f} of the load"
            " (elements of 0.8 mm may make some of it); or a falling friction law on a compliant drive",
            "possible: stiffness of the drive and fall of friction are not published",
        ),
    ]
