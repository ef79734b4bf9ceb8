"""Criticism of one photograph of a checkerboard: what its believed picture lacks, by name, and what naming it gains.

Half of the blocks are locked. On the others every candidate is tried by the same rule, in alphabetical order: fitted
robustly, scored by the log density of blocks left out of its fit; the best is taken if it gains more than two standard
errors over blocks with its numbers off their bounds, and all are tried again. A smooth light field, which is no effect
of the library, is offered only when no effect gains any more. Then the locked blocks are opened, once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core import rng
from evanesce.criticism.photograph_fit import FLEXIBLE, NUISANCES, Bench, Fit, Free, candidates, flexible
from evanesce.criticism.photograph_light import Photograph
from evanesce.criticism.photograph_tails import HIGH, LOW, TAILS, speck_pattern
from evanesce.effects import all_effects

Array = NDArray[np.float64]

ERRORS = 2.0
"""Standard errors over blocks by which a candidate has to gain."""

BOOTSTRAPS = 4000
MOST_STEPS = 10
LIGHT = ("ambient_light", FLEXIBLE, "vignetting")
"""Causes that shade a single still frame smoothly."""

SHOTS = {
    "light": "The same card, once with the card turned by 180 degrees in its plane and once with the camera turned by "
    "180 degrees about its axis: what turns with the card is paper and print, what turns with the camera is the lens "
    "(vignetting), what stays is the illumination. A lens-cap and an LED-off frame then split added from multiplied "
    "light.",
    "points": "The plate wiped and photographed again, and a lens-cap frame: specks go with the cloth, hot pixels stay "
    "under the cap.",
    "reflection": "The same card with the LEDs off under another lamp: reflections of the edge LEDs vanish, a film of "
    "residue stays where it is.",
}


@dataclass(frozen=True)
class Trial:
    """One candidate at one step.

    Attributes
    ----------
    step : int
    id : str
    gain, error : float
        Held-out log density over the model so far, and its standard error over blocks [nats].
    at_bound : bool
        Whether a number of it was pushed to a bound, which rules it out.
    accepted : bool
    """

    step: int
    id: str
    gain: float
    error: float
    at_bound: bool
    accepted: bool


@dataclass
class PhotographCritique:
    """What the critic found.

    Attributes
    ----------
    believed, extended : Fit
    trials : list of Trial
        Every candidate at every step, in the order tried.
    rivals : dict of str to list of str
        Accepted effect -> candidates that gained as much within two standard errors when it was chosen.
    without : dict of str to Fit
        The extension refitted with one cause left out.
    answer : dict
        The JSON.
    """

    believed: Fit
    extended: Fit
    trials: list[Trial]
    rivals: dict[str, list[str]]
    without: dict[str, Fit] = field(default_factory=dict)
    answer: dict[str, Any] = field(default_factory=dict)


def error_of(difference: Array) -> float:
    """Return the standard error of a sum over blocks."""
    return float(np.sqrt(difference.size) * difference.std(ddof=1))


def interval(difference: Array, seed: int) -> list[float]:
    """Return the sum over blocks with the 95 % interval of its block bootstrap."""
    draw = rng.generator(seed, "photograph", "bootstrap")
    picked = draw.integers(0, difference.size, (BOOTSTRAPS, difference.size))
    low, high = np.quantile(difference[picked].sum(axis=1), (0.025, 0.975))
    return [float(difference.sum()), float(low), float(high)]


def criticise_photograph(
    photograph: Photograph, *, seed: int = 0, tick: Callable[[str], None] = lambda _: None
) -> tuple[PhotographCritique, Bench]:
    """Find what the believed picture of a photographed board lacks.

    Parameters
    ----------
    photograph : Photograph
    seed : int
        Of folds and bootstrap.
    tick : callable
        Told of each step.
    """
    bench = Bench(photograph, seed)
    tick("believed picture")
    believed = bench.fit((), NUISANCES, bench.start, ())
    extended, trials, rivals = _forward(bench, believed, tick)
    found = PhotographCritique(believed, extended, trials, rivals)
    for name in _causes(extended.ids):
        tick(f"without {name}")
        found.without[name] = _without(bench, extended, _members(name, extended.ids))
    tick("locked blocks")
    found.answer = _answer(bench, found, seed)
    return found, bench


def _forward(
    bench: Bench, fit: Fit, tick: Callable[[str], None]
) -> tuple[Fit, list[Trial], dict[str, list[str]]]:  # fmt: skip
    trials: list[Trial] = []
    rivals: dict[str, list[str]] = {}
    library = candidates()
    asleep: set[str] = set()  # did not pass at the last try; woken before anything is concluded
    for step in range(1, MOST_STEPS + 1):
        tried = {}
        for name in library:
            if name not in fit.ids and name not in asleep:
                tick(f"step {step}: {name}")
                tried[name] = _try(bench, fit, name, library[name])
        best = _best(tried, fit)
        for name in sorted(asleep) if best is None else ():
            tick(f"step {step}: {name}")
            tried[name] = _try(bench, fit, name, library[name])
        best = best or _best(tried, fit)
        if best is None and FLEXIBLE not in fit.ids:
            tick(f"step {step}: {FLEXIBLE}")
            tried[FLEXIBLE] = _try(bench, fit, FLEXIBLE, flexible())
            best = _best({FLEXIBLE: tried[FLEXIBLE]}, fit)
        for name, one in tried.items():
            d = one.held_out - fit.held_out
            trials.append(Trial(step, name, float(d.sum()), error_of(d), at_bound(one, fit), name == best))
        if best is None:
            break
        asleep = {n for n, one in tried.items() if n in library and not _passes(one, fit)} | (asleep - tried.keys())
        lead = {n: tried[best].held_out - one.held_out for n, one in tried.items() if n != best}
        rivals[best] = [n for n, d in lead.items() if _passes(tried[n], fit) and d.sum() < ERRORS * error_of(d)]
        fit = bench.refit(tried[best]) if tried[best].tails else tried[best]
    return fit, trials, rivals


def _passes(one: Fit, fit: Fit) -> bool:
    """Tell whether a trial gains enough over the model so far, with its own numbers off their bounds."""
    difference = one.held_out - fit.held_out
    return bool(difference.sum() > max(ERRORS * error_of(difference), 0.0)) and not at_bound(one, fit)


def at_bound(one: Fit, fit: Fit) -> bool:
    """Tell whether a number that a trial added was pushed to a bound that is not its null."""
    for tail in one.tails[len(fit.tails) :]:
        low, high = np.array(LOW[tail.id]), np.array(HIGH[tail.id])
        if (tail.theta <= low + 0.02).any() or (tail.theta >= high - 0.02).any():
            return True
    added = [f for f in one.free if f.name not in fit.values]
    return any(one.values[f.name] >= f.high or (f.low != 0.0 and one.values[f.name] <= f.low) for f in added)


def _best(tried: dict[str, Fit], fit: Fit) -> str | None:
    passed = {name: one.held_out.sum() for name, one in tried.items() if _passes(one, fit)}
    return max(passed, key=lambda name: passed[name]) if passed else None


def _try(bench: Bench, fit: Fit, name: str, free: tuple[Free, ...]) -> Fit:
    if name in TAILS:
        return bench.add_tail(fit, name)
    start = {**fit.values, **_start(bench, fit, name)}
    return bench.fit((*fit.ids, name), (*fit.free, *free), start, fit.tails)


def _start(bench: Bench, fit: Fit, name: str) -> dict[str, float]:
    """Return where a local haze is looked for: the open blocks' brightest smooth residual, specks cut off."""
    if name != "residue_film":
        return {}
    from scipy.ndimage import gaussian_filter

    from evanesce.optics.projection import Projection

    one = bench.photograph
    limit = 4.0 * fit.scale * bench.deviation
    left = np.where(one.opened, np.clip(one.data - bench.model(fit.values), -limit, limit), 0.0)
    width = 1.0 * one.scene.camera.scale_px_per_mm
    smooth = gaussian_filter(left, width) / np.maximum(gaussian_filter(one.opened.astype(float), width), 0.1)
    row, col = np.unravel_index(int(np.argmax(np.where(one.opened, smooth, -np.inf))), smooth.shape)
    x, y = Projection.of(one.scene.camera, one.scene.plate).to_plate(np.array([float(col)]), np.array([float(row)]))
    return {"residue_film.middle_x_mm": float(x[0]), "residue_film.middle_y_mm": float(y[0])}


def _causes(ids: tuple[str, ...]) -> list[str]:
    """Return what is dropped in turn: each effect, and all smooth light together where there is more than one."""
    shades = [name for name in ids if name in LIGHT]
    return [*sorted(ids), *(["all smooth light"] if len(shades) > 1 else [])]


def _members(cause: str, ids: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(name for name in ids if name in LIGHT) if cause == "all smooth light" else (cause,)


def _without(bench: Bench, fit: Fit, gone: tuple[str, ...]) -> Fit:
    """Refit the extension without some causes."""
    ids = tuple(name for name in fit.ids if name not in gone)
    free = tuple(f for f in fit.free if f.name.split(".")[0] not in gone)
    values = {k: v for k, v in fit.values.items() if k.split(".")[0] not in gone}
    tails = tuple(t for t in fit.tails if t.id not in gone)
    return bench.refit(replace(fit, ids=ids, free=free, values=values, tails=tails))


def _answer(bench: Bench, found: PhotographCritique, seed: int) -> dict[str, Any]:
    """Open the locked blocks, once, and put everything into the answer."""
    one = bench.photograph
    locked = one.locked & (one.block >= 0)
    names, block = np.unique(one.block[locked], return_inverse=True)

    def by_block(fit: Fit) -> Array:
        return np.asarray(np.bincount(block, weights=bench.density(fit, locked), minlength=len(names)), float)

    before, after = by_block(found.believed), by_block(found.extended)
    rmse = [_rmse(bench, fit, locked) for fit in (found.believed, found.extended)]
    losses = {}
    for name, fit in found.without.items():
        lost = after - by_block(fit)
        losses[name] = {"loss": interval(lost, seed), "rmse_dn": _rmse(bench, fit, locked)}
    effects = [_effect(bench, found.extended, name) for name in sorted(found.extended.ids)]
    return {
        "verdict": "named" if found.extended.ids else "none",
        "effects": effects,
        "gain": {
            "log_score": interval(after - before, seed),
            "rmse_dn": rmse,
            "blocks": len(names),
            "bins": int(locked.sum()),
        },
        "dropped": losses,
        "rivals": found.rivals,
        "ranking": [vars(trial) for trial in found.trials],
        "next_measurement": _next(found),
        "absorbed": [
            {"id": "ambient_light's even part", "by": "the level of dark print, which is fitted"},
            {"id": "defocus on the axis", "by": "the constant blur, which is fitted"},
            {"id": "distortion_drift, plate_tilt", "by": "the geometry, fitted to the corners of the open blocks"},
        ],
        "noise_dn": bench.noise_DN,
        "core_over_noise": {"believed": found.believed.scale, "extended": found.extended.scale},
        "corner_error_px": one.corner_error_px * one.bin_px,
        "not_tried": sorted(set(all_effects()) - set(candidates())),
        "blocks": {"open": bench.blocks, "locked": len(names)},
        "bin_px": one.bin_px,
        "seed": seed,
    }


def _rmse(bench: Bench, fit: Fit, where: NDArray[np.bool_]) -> float:
    return float(np.sqrt(np.mean((bench.photograph.data - bench.model(fit.values))[where] ** 2)))


def _effect(bench: Bench, fit: Fit, name: str) -> dict[str, Any]:
    """Return one accepted effect with its numbers."""
    numbers = {
        f.name.split(".")[1]: {"value": fit.values[f.name], "unit": f.unit}
        for f in fit.free
        if f.name.split(".")[0] == name
    }
    for tail in fit.tails:
        if tail.id == name:
            share = [1.0 / (1.0 + float(np.exp(-t))) for t in tail.theta[:2]]
            numbers["share_of_bins"] = {"value": share[0], "unit": "1"}
            numbers["share_beside_another"] = {"value": share[1], "unit": "1"}
        if tail.id == name == "specks":
            camera = bench.photograph.scene.camera
            _, covered = speck_pattern(bench.model, fit.values)
            weight = float(tail.weight(bench.seen(fit.values, fit.scale)).mean())
            numbers["per_cm2"] = {"value": 100.0 * weight / covered * camera.scale_px_per_mm**2, "unit": "1/cm^2"}
            numbers["median_light_mm2"] = {"value": float(np.exp(tail.theta[2])), "unit": "mm^2"}
            numbers["log_spread"] = {"value": float(np.exp(tail.theta[3])), "unit": "1"}
    return {"id": name, "library": name in all_effects(), "parameters": numbers}


def _next(found: PhotographCritique) -> list[dict[str, Any]]:
    """Return the shots that would tell apart what one frame cannot."""
    ids = set(found.extended.ids)
    shots = []
    if ids & set(LIGHT):
        shots.append({"what": SHOTS["light"], "separates": sorted({*LIGHT, *(ids & set(LIGHT))})})
    if ids & {"specks", "hot_pixels"}:
        shots.append({"what": SHOTS["points"], "separates": ["hot_pixels", "specks"]})
    if ids & {"led_edge_reflections", "residue_film"}:
        shots.append(
            {"what": SHOTS["reflection"], "separates": ["ambient_light", "led_edge_reflections", "residue_film"]}
        )
    return shots
