"""Frames that came through a lossy codec: what it makes of the nominal frames, as a mean change and a noise.

Replicates show what a codec leaves of the noise of a state. What it makes of the state itself is the same in all of
them: weak contrasts that vanish, dark levels that settle elsewhere. So predicted frames are given the camera's noise,
filmed and read again, many times, by codecs and cameras that differ by what is not known of them: their mean change
goes into the prediction, their scatter is the noise of the data. Its power is largest at low frequencies, where whole
blocks err together, and a video hands it on from view to view.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.rng import generator
from evanesce.inference.data import DataVector, step_sd, stepped
from evanesce.inference.model import AnchoredModel
from evanesce.prediction import priors
from evanesce.prediction.codec_search import codec_of
from evanesce.prediction.codecs import Codec, Likely
from evanesce.prediction.colour import expected_grey
from evanesce.prediction.noise_scale import noise_scale_of
from evanesce.prediction.recoded import DRAWS, Recoded, Shooting, recoded

Array = NDArray[Any]

SCALE_STEP = 0.5 * priors.SCALE_CODEC
"""Of the logarithm of the noise's scale: no codec lets it be known better, and forms are kept by it."""
FIRST_DRAWS = 8
"""Of the first film, which serves to fit the nominal rig about which the second is drawn."""


@dataclass(frozen=True)
class Filmed:
    """What a codec does to the frames.

    Attributes
    ----------
    made : Recoded
    scale : float
        Real over modelled noise before the tone curve.
    """

    made: Recoded
    scale: float

    def data(self, before: DataVector, left: Array) -> DataVector:
        """Return the data with the codec's noise, which hangs together over places and views.

        Parameters
        ----------
        before : DataVector
        left : ndarray (views, rows, cols)
            Data less the nominal prediction in the open views, the mean change included [DN]. Combinations of views
            in which its bins scatter more than the draws do get that variance. A weak cause adds next to nothing to the
            mean square of thousands of bins; a misfit far above the noise does, and weaker causes beside it are lost.
        """
        made = self.made
        parts = (made.sd, made.rounding[:, None, None], step_sd(before.cube))
        variance = np.sum(np.broadcast_arrays(*(part**2 for part in parts)), axis=0)
        shares = [np.broadcast_to(part**2, variance.shape).mean((1, 2)) / variance.mean((1, 2)) for part in parts]
        correlation = made.correlation(*shares[:2])
        data = replace(
            before, sd=np.sqrt(variance), correlation=correlation, scale=self.scale, scale_deviation=priors.SCALE_CODEC
        )
        opened, known = list(data.open), data.valid[list(data.open)].all(axis=0)
        left = data.over_noise(np.nan_to_num(left))[:, known]
        return replace(data, correlation=correlation.scaled(opened, left @ left.T / max(int(known.sum()), 1)))

    def draws(self, model: AnchoredModel) -> Array:
        """Return whitened draws (n, d) of the codec's noise by a model of the frames."""
        rows = np.array([model.data.whitened(one.astype(float)) for one in self.made.fields], np.float32)
        return np.pad(rows, ((0, 0), (0, model.observed.size - rows.shape[1])))


def codec_behind(model: AnchoredModel, point: Mapping[str, float]) -> Likely | None:
    """Return the codecs that the frames may have come through, and noise before them; None where they show none.

    Parameters
    ----------
    model : AnchoredModel
    point : mapping
    """
    observation, data = model.observation, model.data
    tone_of = partial(expected_grey, observation.believed)
    size = noise_scale_of(tone_of, observation.scatter, coded=observation.coded)
    place = next((k for k, view in enumerate(data.views) if view.kind == "replicate"), None)
    known = None if observation.jpeg is None else Codec("jpeg", observation.jpeg)
    if place is None or not (size.codec or known):
        return None

    def picture(number: int) -> Array:
        return model.coarse.image(point, number).repeat(model.factor, 0).repeat(model.factor, 1)

    before = [partial(picture, k) for k, view in enumerate(data.views) if view.kind == "press"]
    held, scatter = observation.held["replicate"], observation.scatter["replicate"]
    shooting, rng = _shooting(model, size.value), generator(0, "codec")
    found = codec_of(shooting, picture(place), before, held, scatter, rng, known)
    return replace(found, scales=tuple(stepped(scale, SCALE_STEP) for scale in found.scales))


def filmed(model: AnchoredModel, point: Mapping[str, float], likely: Likely, most: int = DRAWS) -> Filmed:
    """Return what a codec does to the frames predicted at a point.

    Parameters
    ----------
    model : AnchoredModel
    point : mapping
    likely : Likely
        What the frames may have come through.
    most : int
        Draws at the most.
    """
    picture = model.fine(point).picture
    made = recoded(_shooting(model, likely.scale), picture, model.data.views, likely, generator(1, "codec"), most)
    return Filmed(made, likely.scale)


def _shooting(model: AnchoredModel, scale: float) -> Shooting:
    data = model.data
    return Shooting(model.observation.believed, scale, model.factor, data.scale, data.noise.flicker)
