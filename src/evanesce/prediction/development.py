"""The way from light to the grey of a colour camera's mean frame, computed once for each level of light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.prediction.colour_noise import GREY, ExpectedColour, demosaiced
from evanesce.rig import Camera
from evanesce.rig.colour import Mosaic
from evanesce.sensor.colour import CHANNELS, ImageProcessor
from evanesce.sensor.response import Response

Array = NDArray[np.float64]

SITE_SPREAD_PX2 = (0.5, 0.25, 0.5)
"""By which bilinear demosaicing widens light along each axis, in the mean over the mosaic [px^2]."""

NODES = 800
"""Light levels at which the way from light to grey is computed where each pixel goes it by itself."""

EVEN = 0.01
"""Step between neighbours, over their light, up to which demosaicing shows in none of them."""

BEYOND = 4.0
"""Times the light that fills the most sensitive filter: what the others tell from there on is followed so far."""


@dataclass(frozen=True)
class Development:
    """The way from light to a frame's grey.

    Attributes
    ----------
    colour : ExpectedColour
    levels_e : ndarray (n,)
        Light at which the way is computed where each pixel goes it alone: charge of a pixel that lets all through [e-].
    read : callable
        ``read(light_e (rows, cols)) -> ndarray (3, rows, cols)``: the filters' mean signals [raw DN].
    finish : callable
        What follows on mean developed colour (rows, cols, 3) [DN].
    plain : callable, optional
        ``read`` without what makes a pixel's signal depend on its neighbours'.
    finish_alone : bool
        Whether what follows depends on each pixel's own light alone.
    pattern : {"RGGB", "BGGR", "GRBG", "GBRG"}, optional
        Of the mosaic, where pixels are the camera's own; by default demosaicing widens the light.
    """

    colour: ExpectedColour
    levels_e: Array
    read: Callable[[Array], Array]
    finish: Callable[[Array], Array]
    plain: Callable[[Array], Array] | None = None
    finish_alone: bool = True
    pattern: Mosaic | None = None

    def way(self) -> Way:
        """Return the way at :attr:`levels_e`: it serves all frames of the same settings."""
        signals = (self.plain or self.read)(self.levels_e[None])
        colour = self.colour.mean_of(signals)[0]
        grey = (self.finish(colour[None]) @ GREY)[0] if self.finish_alone else np.zeros(0)
        spread = self.colour.spread(signals)[:, 0]
        nearly = self.colour.nearly(signals)[0]
        return Way(self.levels_e, grey, colour, nearly, self.colour.balanced(signals)[:, 0], spread)

    def grey(self, light_e: Array, way: Way) -> Array:
        """Return the mean grey (rows, cols) of light (rows, cols) [DN].

        Parameters
        ----------
        light_e : ndarray (rows, cols)
            [e-].
        way : Way
        """
        uneven, mixed = self._demosaiced(light_e, way)
        if self.plain is not None or not self.finish_alone:
            colour = way.at(light_e, way.colour)
            colour[uneven] = mixed
            if self.plain is not None:
                # By the change alone: what the two ways differ by would be found in the data.
                after, before = (self.colour.nearly(read(light_e), self.pattern) for read in (self.read, self.plain))
                colour += after - before
            return np.asarray(self.finish(colour) @ GREY)
        found = np.interp(light_e, way.levels_e, way.grey)
        if len(mixed):
            found[uneven] = (self.finish(mixed[None]) @ GREY)[0]
        return found

    def _demosaiced(self, light_e: Array, way: Way) -> tuple[NDArray[np.bool_], Array]:
        """Return which pixels have neighbours of other light, (rows, cols), and their mean colour (n, 3) [DN]."""
        if self.pattern is None:
            return np.zeros(light_e.shape, bool), np.zeros((0, 3))
        around = np.ones((3, 3), np.uint8)
        high = cv2.dilate(light_e, around)
        uneven = high - cv2.erode(light_e, around) > EVEN * high + way.levels_e[1]
        own = np.empty(light_e.shape)
        for place, letter in enumerate(self.pattern):
            here = np.s_[place // 2 :: 2, place % 2 :: 2]
            own[here] = np.interp(light_e[here], way.levels_e, way.balanced[CHANNELS.index(letter)])
        light = light_e[uneven]
        linear = demosaiced(own, self.pattern, self.colour.demosaicing)[uneven] @ self.colour.matrix.T
        spread = np.array([np.interp(light, way.levels_e, part) for part in way.spread])
        developed = self.colour.developed_at(linear.T, spread).T
        return uneven, way.at(light, way.colour - way.nearly) + developed


@dataclass(frozen=True)
class Way:
    """What a development makes of levels of light.

    Attributes
    ----------
    levels_e : ndarray (n,)
        [e-].
    grey : ndarray (n,)
        [DN]; empty where pixels are not finished alone.
    colour, nearly : ndarray (n, 3)
        Mean colour, and as :meth:`ExpectedColour.nearly` has it [DN].
    balanced, spread : ndarray (3, n)
        Filters' mean balanced values, and standard deviation of linear output, full scale 1.
    """

    levels_e: Array
    grey: Array
    colour: Array
    nearly: Array
    balanced: Array
    spread: Array

    def at(self, light_e: Array, colour: Array) -> Array:
        """Return colours (..., 3) at light (...) of those at the levels (n, 3)."""
        return np.stack([np.interp(light_e, self.levels_e, part) for part in colour.T], axis=-1)


def light_levels(camera: Camera, response: Response) -> Array:
    """Return levels of light in units of a raw number of a pixel that lets all of it through (NODES,) [raw DN].

    From nothing to where the most sensitive filter is full and on: the others still tell of light.

    Parameters
    ----------
    camera : Camera
    response : tuple of float
        Of red, green and blue pixels [1].
    """
    return np.asarray(BEYOND * filled(camera, response) * np.linspace(0.0, 1.0, NODES) ** 2)


def filled(camera: Camera, response: Response) -> float:
    """Return the light that fills the most sensitive filter [raw DN]."""
    first = int(np.argmax(response))
    codes = 2**camera.pixel.bits - 1 - camera.pixel.black_level_DN
    return float(codes / (response[first] * ImageProcessor.of(camera).gains[first]))


def widened(light: Array, camera: Camera, response: Response, pixels: float) -> Array:
    """Return light widened by bilinear demosaicing, by the mean of the filters, weighted by what they see.

    Parameters
    ----------
    light : ndarray (rows, cols)
    camera : Camera
    response : tuple of float
        Of red, green and blue pixels [1].
    pixels : float
        Real pixels along one of these.
    """
    weight = np.array(response) * ImageProcessor.of(camera).gains
    spread = float(weight @ SITE_SPREAD_PX2 / weight.sum()) / pixels**2
    taps = np.array([0.5 * spread, 1.0 - spread, 0.5 * spread])
    return np.asarray(cv2.sepFilter2D(light, cv2.CV_64F, taps, taps, borderType=cv2.BORDER_REFLECT_101))
