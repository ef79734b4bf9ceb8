"""The bands of a rippling light in frames read row by row: their frequency and phase, from what a model leaves.

Rows tell the frequency to some hertz, frames that are minutes apart tell it to millihertz; other frequencies that agree
at all frames' times do as well. Nothing but the data can say which, so they choose, and the choice is paid for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.causes import Cause
from evanesce.inference.constants import DETECTED_BESIDE
from evanesce.inference.form_noise import widening
from evanesce.inference.listing import Listed, enlarged, placed
from evanesce.inference.model import AnchoredModel
from evanesce.prediction.parameters import derivative

Array = NDArray[Any]

RANGE_HZ = (40.0, 440.0)
"""Of frequencies that are tried: one period over a frame's rows to ten; wider bands are slopes, narrower ones bins."""
FINER = 4
"""Trial frequencies for each that rows, and that the whole time, tell apart."""
LEAST_LEFT = 0.02
"""Of a ripple that an exposure must leave: a light that is averaged out cannot be seen, whatever it does."""
SMOOTH = 3
"""Powers of the row by which light may vary in a frame by itself: what a smooth cause leaves."""
APART = 1.5
"""Periods more or fewer over a frame's rows, from which on another wave's power is noise and not the ripple's own."""
MOVING = 0.3
"""Least share of the bands' power that moves from frame to frame: with less they are a pattern that stands."""


@dataclass(frozen=True)
class Ripple:
    """A ripple of the light.

    Attributes
    ----------
    frequency_hz : float
    phase_deg : float
        Of the crest at time 0.
    amplitude : float
        Of the rows' light over its mean.
    log_bayes : float
        Over nothing, the choice of frequency and phase paid for [nats].
    """

    frequency_hz: float
    phase_deg: float
    amplitude: float
    log_bayes: float


def ripple_of(
    model: AnchoredModel, point: Mapping[str, float], cause: Cause, left: Array, weight: Array
) -> tuple[Listed, float] | None:
    """Return a cause with the ripple that stands out and its log Bayes factor; None if there is none.

    Parameters
    ----------
    model : AnchoredModel
    point : mapping
    cause : Cause
        Of an effect that modulates rows.
    left, weight : ndarray (open views, rows, cols)
        Data less prediction [DN]; one over the standard deviation.
    """
    bands, scene, data = cause.candidate.effect.bands, model.observation.scene, model.data
    assert bands is not None
    views = [data.views[k] for k in data.open]
    single = [n for n, view in enumerate(views) if view.touches and view.frames == 1]
    if not single:
        return None
    measured = model.observation.images[list(data.open)][single]
    light = data.noise.tone.slope_by_light(measured) * weight[single]
    exposure_s = scene.camera.exposure_ms * 1e-3
    readout_s = getattr(cause.candidate.effect.parameters(), bands.readout) * 1e-3
    drawn = None
    if model.recoded is not None:
        fields = model.recoded.fields[:, [data.open[n] for n in single]]
        shape = (left.shape[1], left.shape[2])
        drawn = np.array(
            [_row_sums(np.array([enlarged(bins, shape) for bins in one]) * weight[single], light) for one in fields]
        )
    found = brightest_ripple(
        left[single] * weight[single],
        light,
        np.array([views[n].time_s for n in single]),
        row_times(left.shape[1], readout_s),
        lambda frequency_hz: abs(bands.share(frequency_hz, exposure_s)) > LEAST_LEFT,
        _of_load(model, point, single, left.shape[1:]) * weight[single][:, None],
        drawn,
    )
    if found is None:
        return None
    share = bands.share(found.frequency_hz, exposure_s)
    phase = found.phase_deg if share > 0 else found.phase_deg + 180.0
    settings = {bands.frequency: found.frequency_hz, bands.phase: (phase + 180.0) % 360.0 - 180.0}
    own = next(p for p in cause.parameters if p.name == f"{cause.id}:{bands.amount}")
    return placed(cause, own, settings, found.amplitude / abs(share)), found.log_bayes


def _of_load(model: AnchoredModel, point: Mapping[str, float], views: Sequence[int], shape: tuple[int, ...]) -> Array:
    """Return what a frame's own load changes, by open views (views, 1, rows, cols) [DN]."""
    found = np.zeros((len(views), 1, *shape), np.float32)
    for parameter in model.nuisances():
        own = [n for n, k in enumerate(views) if parameter.views == (model.data.open[k],)]
        if parameter.linear and own and parameter.name.startswith("@force"):
            change = derivative(model.coarse, point, parameter, model.data.open)[model.data.open[views[own[0]]]]
            found[own[0], 0] = enlarged(change, (shape[0], shape[1]))
    return found


def row_times(rows: int, readout_s: float) -> Array:
    """Return when each row is exposed, after the frame's middle one [s]."""
    return np.asarray((np.arange(rows) - (rows - 1) / 2) / rows * readout_s)


def brightest_ripple(
    residual: Array,
    light: Array,
    times_s: Array,
    late_s: Array,
    possible: Callable[[float], bool] = lambda f: True,
    beside: Array | None = None,
    drawn: Array | None = None,
) -> Ripple | None:
    """Return the ripple that explains most, None where that is not worth its choice.

    Parameters
    ----------
    residual, light : ndarray (frames, rows, cols)
        Whitened; the second is what a rise of all light changes, per unit of its logarithm.
    times_s : ndarray (frames,)
    late_s : ndarray (rows,)
        When a row is exposed, after its frame's time.
    possible : callable
        Whether a ripple of a frequency [Hz] could be seen at all.
    beside : ndarray (frames, k, rows, cols), optional
        What else may vary from frame to frame, whitened.
    drawn : ndarray (draws, frames, rows), optional
        Sums over the columns of draws of the noise, times the light, both whitened.
    """
    product, weight = (_row_sums(a, light) for a in (residual, light))
    # Rows that are brighter in all frames alike are no ripple's, or of one whose rate nobody could tell from that.
    product = product - _standing(product, weight)
    if drawn is not None:
        drawn = np.array([one - _standing(one, weight) for one in drawn])
    powers = (late_s / max(float(np.ptp(late_s)), 1e-12)) ** np.arange(SMOOTH)[:, None]
    own = weight[:, None, :] * powers
    if beside is not None:
        own = np.concatenate([own, np.einsum("vkrc,vrc->vkr", beside, light, dtype=float)], axis=1)
    readout, span = float(np.ptp(late_s)), float(np.ptp(times_s))
    coarse = np.arange(RANGE_HZ[0], RANGE_HZ[1], 1.0 / (FINER * readout))
    # No finer than a frame's rows tell where there is no other frame.
    step = 1.0 / (FINER * max(span, readout))
    offsets = np.arange(0.0, coarse[1] - coarse[0], step)

    def along(tried: Array, sums: Array, size: Array) -> tuple[Array, Array]:
        """Return complex sums over all frames, and how large what moves from frame to frame can make them."""
        turn = np.exp(-2j * np.pi * np.outer(tried, times_s))
        moving = size.sum() - np.abs(turn @ size) ** 2 / max(float(size.sum()), 1e-300)
        return turn @ sums, np.where(moving > MOVING * size.sum(), moving, np.inf)

    def best_of(product: Array, drawn: Array | None) -> tuple[float, complex, float, float]:
        """Return the frequency that explains most of row sums, its sum and information, and its square over noise."""
        rows = _Rows.of(product, weight, late_s, own, drawn)
        best, at = 0.0, 0.0
        for start in coarse:
            tried = start + offsets
            sums, moving = along(tried, *rows.sums(start + 0.5 * offsets[-1]))
            squares = 2.0 * np.abs(sums) ** 2 / moving
            k = int(np.argmax(squares))
            if squares[k] > best and possible(float(tried[k])):
                best, at = float(squares[k]), float(tried[k])
        (whole,), (size,) = along(np.array([at]), *rows.sums(at))
        # Noise is known as well as the other waves show it: Student's law instead of the normal one.
        known = 2.0 * max(int(rows.far(at).sum()), 1) * len(product)
        return at, complex(whole), float(size), known * float(np.log1p(2.0 * abs(whole) ** 2 / size / known))

    # One frequency among those that can be told apart, and a phase that may as well have been another one.
    number = (RANGE_HZ[1] - RANGE_HZ[0]) * max(span, readout)

    def worth(square: float) -> float:
        return 0.5 * square - float(np.log(number) + 0.5 * np.log1p(square))

    at, whole, size, square = best_of(product, drawn)
    if number * np.exp(-0.5 * square) > DETECTED_BESIDE:
        return None
    if drawn is not None:
        # A codec hands errors on from frame to frame, and only whole draws show how they add up.
        noise = [best_of(one, np.delete(drawn, k, axis=0))[3] for k, one in enumerate(drawn)]
        square /= widening(lambda times: [worth(one / times) for one in noise])
        if number * np.exp(-0.5 * square) > DETECTED_BESIDE:
            return None
    # The sums hold exp(-i phase) of a crest: cos(2 pi f t + phase) has the sum's own angle.
    return Ripple(at, float(np.degrees(np.angle(whole))), 2.0 * abs(whole) / size, worth(square))


def _row_sums(residual: Array, light: Array) -> Array:
    """Return sums over the columns (frames, rows) of a residual times the light (frames, rows, cols)."""
    return np.asarray(np.einsum("vrc,vrc->vr", residual, light, dtype=float))


def _standing(product: Array, weight: Array) -> Array:
    """Return the part of row sums (frames, rows) that is alike in all frames."""
    return np.asarray(weight * (product.sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-300)))


@dataclass(frozen=True)
class _Rows:
    """Rows of frames, each over its noise, without what else may vary from frame to frame.

    Attributes
    ----------
    left, root : ndarray (frames, rows)
        Sums over the columns; square root of the information of a row.
    late_s : ndarray (rows,)
    basis : ndarray (frames, rows, k)
        Of what is projected out.
    hertz : ndarray (waves,)
        A period over a frame's rows apart.
    power : ndarray (waves, frames)
        Of those waves, 1 for noise that knows nothing of other rows.
    usual : ndarray (waves, frames)
        The same of draws of the noise; 0 where there are none.
    """

    left: Array
    root: Array
    late_s: Array
    basis: Array
    hertz: Array
    power: Array
    usual: Array

    @classmethod
    def of(cls, product: Array, weight: Array, late_s: Array, beside: Array, drawn: Array | None = None) -> _Rows:
        """Project ``beside`` (frames, k, rows) out of rows, and measure the power of all waves that are tried."""
        root = np.sqrt(np.maximum(weight, 1e-300))
        basis = np.linalg.qr(np.moveaxis(beside / root[:, None, :], 1, 2))[0]
        hertz = np.arange(*RANGE_HZ, 1.0 / max(float(np.ptp(late_s)), 1e-12))
        nothing = np.zeros((len(hertz), len(root)))
        bare = cls(_without(product / root, basis), root, late_s, basis, hertz, nothing, nothing)
        waves = [bare._wave(frequency) for frequency in hertz]

        def power(left: Array) -> Array:
            return np.array([np.abs((left * w).sum(axis=1)) ** 2 / (np.abs(w) ** 2).sum(axis=1) for w in waves])

        if drawn is None:
            return replace(bare, power=power(bare.left))
        usual = np.mean([power(_without(one / root, basis)) for one in drawn], axis=0)
        return replace(bare, power=power(bare.left), usual=usual * (len(drawn) + 1) / (len(drawn) - 1))

    def _wave(self, frequency_hz: float) -> Array:
        return _without(self.root * np.exp(-2j * np.pi * frequency_hz * self.late_s), self.basis)

    def far(self, frequency_hz: float) -> NDArray[np.bool_]:
        """Return which waves' power is not that of a ripple of some frequency."""
        return np.asarray(np.abs(self.hertz - frequency_hz) * float(np.ptp(self.late_s)) >= APART)

    def sums(self, frequency_hz: float) -> tuple[Array, Array]:
        """Return each frame's complex sum (frames,) and twice what noise makes of its square.

        Rows of a frame hang together where a sensor smooths its noise, a codec works in blocks or a model leaves
        something: as much as other waves of about this length show.
        """
        about = self._wave(frequency_hz)
        far = self.far(frequency_hz)
        power = self.power[far] if far.any() else np.ones((1, len(self.left)))
        # A frame's own few waves, and those of a usual frame: one that the model misses says nothing of the others.
        own = power.mean(axis=0)
        excess = np.maximum(np.maximum(own, np.median(own)), 1.0)
        excess = np.maximum(excess, [np.interp(frequency_hz, self.hertz, one) for one in self.usual.T])
        return (self.left * about).sum(axis=1) / excess, (np.abs(about) ** 2).sum(axis=1) / excess


def _without(rows: Array, basis: Array) -> Array:
    """Return rows (frames, rows) less their projection on a basis (frames, rows, k)."""
    return np.asarray(rows - np.einsum("vrk,vk->vr", basis, np.einsum("vrk,vr->vk", basis, rows)))
