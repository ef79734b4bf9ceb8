"""Frames that came through a lossy codec: what it makes of the nominal frames, as a mean change and its uncertainty.

Replicates show what a codec leaves of the noise of a state. What it makes of the state itself is the same in all of
them: weak contrasts that vanish, dark levels that settle elsewhere. So predicted frames are given the camera's noise,
filmed and read again; the mean change goes into the prediction. Which codec it was is known roughly, so that the change
may be off: as a whole in each kind of view, and from place to place.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.core.rng import generator
from evanesce.inference.data import DataVector
from evanesce.inference.model import AnchoredModel
from evanesce.prediction.noise_scale import noise_scale_of
from evanesce.prediction.recoded import Codec, Shooting, codec_of, recoded

Array = NDArray[Any]

OFF = 0.25
"""Standard deviation of the share by which a codec's mean change may be off: neighbouring qualities differ by that."""
SECOND = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0
"""Second differences both ways."""


@dataclass(frozen=True)
class Filmed:
    """What a codec does to the frames.

    Attributes
    ----------
    codec : Codec
    bias : ndarray (views, rows, cols)
        Mean change of the bins [DN].
    uneven : ndarray of float32 (maps, views, rows, cols)
        What that may be off by from place to place, each map as likely as it is large [DN].
    """

    codec: Codec
    bias: Array
    uneven: Array

    def rows(self, data: DataVector) -> Array:
        """Return whitened rows (k, bins) whose outer products add up to the covariance of what the bias is off by."""
        kinds = [view.kind for view in data.views]
        found = []
        for kind in dict.fromkeys(kinds[k] for k in data.open):
            own = np.array([k == kind for k in kinds])[:, None, None]
            found.append(data.whitened(OFF * self.bias * own))
        found += [data.whitened(one.astype(float)) for one in self.uneven]
        return np.array(found, np.float32)


def filmed(model: AnchoredModel, point: Mapping[str, float]) -> Filmed | None:
    """Return what a codec does to the frames predicted at a point; None where the noise gives none away.

    Parameters
    ----------
    model : AnchoredModel
    point : mapping
    """
    observation, data = model.observation, model.data
    size = noise_scale_of(observation.believed.camera, observation.scatter)
    place = next((k for k, view in enumerate(data.views) if view.kind == "replicate"), None)
    if not size.codec or place is None:
        return None

    def picture(number: int) -> Array:
        return model.coarse.image(point, number).repeat(model.factor, 0).repeat(model.factor, 1)

    camera = observation.believed.camera
    before = [partial(picture, k) for k, view in enumerate(data.views) if view.kind == "press"]
    held, scatter = observation.held["replicate"], observation.scatter["replicate"]
    shooting, rng = Shooting(camera, size.value, model.factor), generator(0, "codec")
    codec, scale = codec_of(shooting, picture(place), before, held, scatter, rng)
    fine = model.fine(point)
    shooting = Shooting(camera, scale, model.factor)
    made = recoded(shooting, fine.picture, data.views, codec, fine.cube(), rng, OFF)
    return Filmed(codec, made.bias, made.uneven)


def with_roughness(data: DataVector, residual: Array) -> DataVector:
    """Return the data with the noise of each open view as its own bins show it, where that is more.

    From second differences between neighbouring bins, of unit variance for white noise: no smooth cause is seen by
    them. Scatter about the mean of replicates does not hold what a codec made of a single state.

    Parameters
    ----------
    data : DataVector
    residual : ndarray (bins,)
        Whitened, of the nominal fit.
    """
    cube, sd = data.unwhitened(residual), data.sd.copy()
    excess = []
    for place, k in enumerate(data.open):
        inner = ndimage.binary_erosion(data.valid[k], np.ones((3, 3)))
        square = ndimage.convolve(cube[place], SECOND)[inner] ** 2
        excess.append(max(1.0, float(square.mean())) if square.size else 1.0)
        sd[k] *= np.sqrt(excess[-1])
    for k in data.held_out:
        sd[k] *= np.sqrt(float(np.mean(excess)))
    return replace(data, sd=sd)
