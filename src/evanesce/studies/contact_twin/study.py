"""The twin of a contact frame from end to end: outline, press, causes one by one, what is lost without each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.core.errors import InputError
from evanesce.rig import Scene
from evanesce.sensor.response import led_response
from evanesce.studies.contact_twin.fit import BLOCK, Fit, fit, log_score, response_of, streak_start
from evanesce.studies.contact_twin.light import PressLight, press_of
from evanesce.studies.contact_twin.model import CAUSES, Believed, Model
from evanesce.studies.contact_twin.picture import LUMA, Outline, Picture, outline_of, picture_of, regions

Array = NDArray[np.float64]
Tick = Callable[[str, int, int], None]

BELIEVED_LEVEL = 0.5
"""Contact over full scale that a lab aims at, and the thesis scene has."""
ORDER = tuple(cause for cause in CAUSES if cause != "place")
NEEDED_SD = 2.0
"""A cause stays in the twin where the score on held-out blocks falls by so many standard errors without it."""
DRAWS = 60
LEAST_INSIDE = 4
"""Pixels within a contact, its rim left out, whose grey has a distribution."""
PER_CENT = (5, 25, 50, 75, 95)
PEAKS, PEAK_WIDTH = 3, 0.01
"""How many peaks of the grey histogram are compared, and the width of its classes [1]."""


@dataclass(frozen=True)
class Step:
    """One model of a frame.

    Attributes
    ----------
    cause : str
        What was added, or left out.
    fit : Fit
    rms_DN : ndarray (3,)
        Residual of each channel on held-out blocks [DN].
    score : float
        Logarithm of the predictive density on held-out blocks [nat].
    gain : float
        Score over that of the model it is compared with [nat].
    gain_error : float
        Its standard error, by the variance of whole blocks [nat].
    """

    cause: str
    fit: Fit
    rms_DN: Array
    score: float
    gain: float
    gain_error: float


@dataclass(frozen=True)
class ContactTwin:
    """A contact frame and its simulation.

    Attributes
    ----------
    picture : Picture
    outline : Outline
    scene : Scene
    force_N : float
        Under which this finger makes a contact of this size [N].
    light : PressLight
    model : Model
    added : tuple of Step
        From the believed rig on, each with one cause more; gains over the model before.
    without : tuple of Step
        The full model without each cause; gains over the full model, negative where the cause is needed.
    final : Step
        With the causes that are needed; gain over the believed rig.
    """

    picture: Picture
    outline: Outline
    scene: Scene
    force_N: float
    light: PressLight
    model: Model
    added: tuple[Step, ...]
    without: tuple[Step, ...]
    final: Step


def contact_twin(
    frame: NDArray[np.uint8], scene: Scene, name: str = "frame", tick: Tick = lambda step, done, of: None
) -> ContactTwin:
    """Fit the simulation to a contact frame.

    Parameters
    ----------
    frame : ndarray of uint8 (rows, cols, 3)
        Of a colour camera [DN].
    scene : Scene
        Plate, LEDs, finger and colour camera as they are believed.
    name : str
        Of the frame, for errors.
    tick : callable
        Called with what is done, how many steps are done, and of how many.

    Returns
    -------
    ContactTwin

    Raises
    ------
    InputError
        If the frame is grey or shows no contact, the scene has no colour camera, or no force gives such a contact.
    """
    response = led_response(scene)
    if response is None:
        raise InputError("a monochrome camera", file="scene", key="camera.colour", allowed="a scene with this table")
    picture = picture_of(frame, name)
    outline = outline_of(picture, name)
    steps = 2 * len(ORDER) + 3
    tick("light by cause", 0, steps)
    force, light = press_of(scene, outline.contact_radius / outline.finger_radius)
    model = Model(picture, light, Believed(scene.camera, response, BELIEVED_LEVEL), outline)

    added: list[Step] = []
    causes: tuple[str, ...] = ("place",)
    added.append(_step(model, "place", fit(model, causes), None))
    for number, cause in enumerate(ORDER):
        tick(CAUSES[cause], 1 + number, steps)
        causes += (cause,)
        added.append(_step(model, cause, fit(model, causes, _starts(model, cause, added[-1].fit)), added[-1]))
    full = added[-1]
    without = []
    for number, cause in enumerate(ORDER):
        tick(f"without {cause}", 1 + len(ORDER) + number, steps)
        without.append(_step(model, cause, _without(model, full.fit, cause), full))
    needed = ("place", *(s.cause for s in without if s.gain < -NEEDED_SD * s.gain_error))
    tick("with what is needed", steps - 1, steps)
    last = (
        full
        if set(needed) == set(full.fit.causes)
        else _step(model, "", fit(model, needed, [full.fit.value]), added[0])
    )
    final = _step(model, "", last.fit, added[0])
    tick("done", steps, steps)
    return ContactTwin(picture, outline, scene, force, light, model, tuple(added), tuple(without), final)


def _starts(model: Model, cause: str, before: Fit) -> list[dict[str, float]]:
    """Return where a fit with one cause more begins: at the fit before, and where that had gone astray, anew."""
    table = model.table
    held = {name: value for name, value in before.value.items() if table[name].cause in before.causes}
    starts = [held, {}]
    if cause == "response":
        return [{**held, **response_of(model)}]
    if cause == "streak":
        return [{**held, **streak_start(model, before)}]
    if cause in ("clouds", "led_edge_reflections"):
        return [held]
    if "response" in before.causes:
        starts = [held, {name: held[name] for name in ("temperature", "green", "blue")}]
    return starts if any(table[n].cause != "place" for n in held) else [{}]


def _without(model: Model, full: Fit, cause: str) -> Fit:
    """Return the full model's fit without a cause and what makes no sense without it."""
    gone = {cause} | ({"clouds"} if cause == "plate_haze" else set()) | ({"response"} if cause == "colour" else set())
    return fit(model, tuple(c for c in full.causes if c not in gone), [full.value])


def _step(model: Model, cause: str, found: Fit, against: Step | None) -> Step:
    """Judge a fit on held-out blocks."""
    held = model.picture.held_out
    rms = np.sqrt(((found.predicted - model.picture.data)[held] ** 2).mean(axis=0))
    score = log_score(model, found)
    gain = np.zeros(score.shape) if against is None else score - log_score(model, against.fit)
    return Step(cause, found, rms, float(score[held].sum()), float(gain[held].sum()), _error(gain, held))


def _error(gain: Array, held: NDArray[np.bool_]) -> float:
    """Return the standard error of a sum over blocks that vary independently."""
    rows, cols = np.indices(held.shape) // BLOCK
    number = (rows * (cols.max() + 1) + cols)[held]
    sums = np.bincount(number, weights=gain[held])
    sums = sums[np.bincount(number) > 0]
    return float(np.sqrt(sums.size) * sums.std(ddof=1)) if sums.size > 1 else 0.0


def medians(twin: ContactTwin) -> dict[str, tuple[Array, Array]]:
    """Return each region's median colour in the frame and in the twin, held-out blocks alone [DN].

    Parameters
    ----------
    twin : ContactTwin

    Returns
    -------
    dict of (ndarray (3,), ndarray (3,))
        By region; those without pixels are left out.
    """
    held, data, simulated = twin.picture.held_out, twin.picture.data, twin.final.fit.predicted
    found = {}
    for name, mask in regions(data).items():
        here = mask & held
        if here.any():
            found[name] = np.median(data[here], axis=0), np.median(simulated[here], axis=0)
    return found


def peaks(grey: Array) -> list[float]:
    """Return where a grey image's histogram has its highest peaks [1], highest first.

    Parameters
    ----------
    grey : ndarray
        [1].

    Returns
    -------
    list of float
        Means of the pixels about each peak.
    """
    count, edges = np.histogram(grey, bins=np.arange(0.0, 1.0 + 2 * PEAK_WIDTH, PEAK_WIDTH))
    found: list[float] = []
    left = count.astype(float)
    while len(found) < PEAKS and left.max() > 0:
        k = int(left.argmax())
        low, high = edges[max(0, k - 1)], edges[min(len(edges) - 1, k + 2)]
        found.append(float(grey[(grey >= low) & (grey < high)].mean()))
        left[max(0, k - 5) : k + 6] = 0.0
    return found


def within_contact(twin: ContactTwin, draws: int = DRAWS) -> dict[str, Any]:
    """Return the distribution of grey within the contact that the twin predicts, and what each channel adds to it.

    Parameters
    ----------
    twin : ContactTwin
    draws : int
        Of the fitted numbers, for the intervals.

    Returns
    -------
    dict
        ``quantiles``: by per cent, grey with a 90 % interval, filters and white balance held [1]; of the contact
        without its rim of one pixel. ``variance_share``: of red, green and blue [1]. Both empty without such a contact.
    """
    fit, generator = twin.final.fit, np.random.default_rng(0)
    at = np.array([fit.value[name] for name in fit.free])
    low_end, high_end = (np.array([getattr(twin.model.table[n], end) for n in fit.free]) for end in ("low", "high"))
    inside = ndimage.binary_erosion(regions(fit.predicted)["contact"])
    if inside.sum() < LEAST_INSIDE:
        return {"quantiles": {}, "variance_share": []}
    found = []
    drawn = generator.multivariate_normal(at, fit.covariance, draws, method="svd")
    for vector in [at, *np.clip(drawn, low_end, high_end)]:
        value = {**fit.value, **dict(zip(fit.free, vector.tolist(), strict=True))}
        found.append(
            np.quantile(twin.model.predict(value, fit.causes)[inside] @ LUMA / 255.0, np.array(PER_CENT) / 100)
        )
    low, high = np.quantile(np.array(found), (0.05, 0.95), axis=0)
    spread = np.cov((fit.predicted[inside] * LUMA / 255.0).T)
    return {
        "quantiles": {
            f"{p}": [float(v), float(a), float(b)] for p, v, a, b in zip(PER_CENT, found[0], low, high, strict=True)
        },
        "variance_share": (spread.sum(axis=1) / max(float(spread.sum()), 1e-30)).tolist(),
    }
