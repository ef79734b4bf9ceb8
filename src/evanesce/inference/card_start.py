"""Where a calibration card lies and how bright the room is, roughly, for the fit to begin from, and what of it counts.

A card that is predicted as white as the scale goes has no derivative by its light, and one that lies beside its place
by more than its lines are wide none by its place that leads there: a fit from the nominal values would stay there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import brentq

from evanesce.inference.constants import FAR
from evanesce.optics.projection import Projection
from evanesce.prediction import priors
from evanesce.prediction.observe import Observation, model_factor
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import BIN_PX
from evanesce.render.cards import checkerboard_of, square_of

Array = NDArray[Any]

LIGHT_ERROR = 0.05
"""Of the logarithm of the light found."""
NEARER = 0.05
"""Correlation by which a place at the end of the reach has to be better than the believed one."""
BETTER = 0.5
"""Share of the variance left by which a board printed the other way round has to explain a frame better."""
SMOOTH_PX = 2.0
"""Blur under which places are compared: a lens out of focus moves nothing."""


def card_start(observation: Observation, coarse: Predictor) -> dict[str, float]:
    """Return light and place of each kind of card that the frames show, as a point of the fit.

    Parameters
    ----------
    observation : Observation
    coarse : Predictor
        Of the nominal model.

    Returns
    -------
    dict of str to float
        Only what makes the prediction nearer to the frame than the nominal values do.
    """
    found: dict[str, float] = {}
    for kind in dict.fromkeys(view.kind for view in observation.views if view.is_card):
        place = next(k for k, view in enumerate(observation.views) if view.kind == kind)
        measured = np.asarray(observation.images[place], float)
        point = {f"@card_light[{kind}]": _light(coarse, place, kind, float(measured.mean()))}
        shift = _shift_mm(observation, measured, coarse.image(point, place))
        poses = {f"@pose_{axis}[{kind}]": value for axis, value in zip("xy", shift, strict=True)}
        tried: tuple[dict[str, float], ...] = ({}, point, point | poses)
        off = [_off(coarse.image(one, place), measured) for one in tried]
        found |= tried[int(np.argmin(off))]
    return found


def _light(coarse: Predictor, place: int, kind: str, level_DN: float) -> float:
    """Return the logarithm of the room's light at which a card's frame has a mean level."""
    limit = FAR * priors.CARD_LIGHT

    def surplus(log_light: float) -> float:
        return float(coarse.image({f"@card_light[{kind}]": log_light}, place).mean()) - level_DN

    if surplus(-limit) >= 0.0:
        return -limit
    return limit if surplus(limit) <= 0.0 else float(brentq(surplus, -limit, limit, xtol=LIGHT_ERROR))


def _shift_mm(observation: Observation, measured: Array, predicted: Array) -> tuple[float, float]:
    """Return how far a card lies from where it is predicted, to a pixel [mm].

    Of places that look alike, as on a board larger than the frame, the nearest.
    """
    camera = observation.scene.camera
    rows, cols = measured.shape
    reach = [min(int(FAR * priors.POSE_MM * camera.scale_px_per_mm), size // 4) for size in (rows, cols)]
    inner = measured[reach[0] : rows - reach[0], reach[1] : cols - reach[1]]
    whole, part = (ndimage.gaussian_filter(image, SMOOTH_PX).astype(np.float32) for image in (predicted, inner))
    alike = np.asarray(cv2.matchTemplate(whole, part, cv2.TM_CCOEFF_NORMED))
    y, x = np.indices(alike.shape)
    away = np.hypot((y - reach[0]) / max(reach[0], 1), (x - reach[1]) / max(reach[1], 1))
    down, right = np.unravel_index(int(np.argmax(alike - NEARER * away**2)), alike.shape)
    projection = Projection.of(camera, observation.scene.plate)
    middle = np.array([(cols - 1) / 2, (rows - 1) / 2])
    # What is found to the right in the prediction lies to the left in the frame.
    there = middle + np.array([reach[1] - right, reach[0] - down])
    (x0, x1), (y0, y1) = projection.to_plate(*np.stack([middle, there], axis=1))
    return float(x1 - x0), float(y1 - y0)


def on_prints(observation: Observation, point: Mapping[str, float]) -> NDArray[np.bool_]:
    """Return which bins (views, rows, cols) may count: on a card those up to the middle of the margin about its print.

    Nobody measures how paper was cut, and its edges would tell a card's height from the size of its print.

    Parameters
    ----------
    observation : Observation
    point : mapping
        Where cards lie, as :func:`card_start` says.
    """
    camera, cards = observation.scene.camera, observation.scene.card
    rows, cols = (int(size) for size in observation.cube.shape[1:])
    middle = (BIN_PX - 1) / 2
    col, row = np.meshgrid(BIN_PX * np.arange(cols) + middle, BIN_PX * np.arange(rows) + middle)
    x, y = Projection.of(camera, observation.scene.plate).to_plate(col, row)
    found = np.ones(observation.cube.shape, bool)
    for kind, card in (("checkerboard", checkerboard_of(cards)), ("square", square_of(cards))):
        shift = (float(point.get(f"@pose_{axis}[{kind}]", 0.0)) for axis in "xy")
        reach = (0.5 * (size + card.margin) for size in card.size)
        inside = [np.abs(at - s) < half for at, s, half in zip((x, y), shift, reach, strict=True)]
        for k, view in enumerate(observation.views):
            if view.kind == kind:
                found[k] = np.logical_and(*inside)
    return found


def board_inverted(observation: Observation) -> bool:
    """Return whether the checkerboard is black where the scene's is white: whether that explains its frame far better.

    Parameters
    ----------
    observation : Observation
    """
    place = next((k for k, view in enumerate(observation.views) if view.kind == "checkerboard"), None)
    if place is None:
        return False
    shown = replace(observation, views=(observation.views[place],), images=observation.images[[place]])
    off, factor = [], model_factor(observation.believed)
    for inverted in (observation.scene.card.checkerboard_inverted, not observation.scene.card.checkerboard_inverted):
        card = observation.scene.card.model_copy(update={"checkerboard_inverted": inverted})
        coarse = Predictor(observation.scene.model_copy(update={"card": card}), shown.views, pixels=factor)
        off.append(_unlike(coarse.image(card_start(shown, coarse), 0), np.asarray(shown.images[0], float)))
    return off[1] < BETTER * off[0]


def _unlike(predicted: Array, measured: Array) -> float:
    """Return the share of a frame's variance [1] that a prediction leaves, whatever its light, black or contrast."""
    return 1.0 - float(np.corrcoef(predicted.ravel(), measured.ravel())[0, 1]) ** 2


def _off(predicted: Array, measured: Array) -> float:
    """Return the mean square of what is left [DN^2]."""
    return float(np.mean((predicted - measured) ** 2))
