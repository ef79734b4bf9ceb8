"""Saturation below the nominal full well; overflow may bloom along the column."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Camera

Array = NDArray[np.float64]


class Parameters(Strict):
    """Loss of full well, and where the overflow goes."""

    well_loss: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 0.99),
        null=0.0,
        doc="share of the nominal range (well or converter, what is full first) that is missing",
    )
    knee: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 0.5),
        doc="softness of the ceiling: 1/p of the p-norm by which a pixel's charge approaches it; 0: at once",
    )
    bloom: float = field(0.0, unit="1", bounds=(0.0, 1.0), doc="share of the overflow that leaves along the column")
    bloom_length_um: float = field(
        20.0, unit="um", bounds=(0.1, 2000.0), doc="mean distance it goes; what meets a full pixel there is drained"
    )


def overflow_kernel(length_px: float) -> Array:
    """Return the shares of a charge that arrive in the pixels along its column: exp(-|x|/length)/(2 length) [px].

    Integrated over the receiving pixels, so that pixels of any size receive the same; sum 1.

    Parameters
    ----------
    length_px : float

    Returns
    -------
    ndarray (n,)
    """
    reach = max(1, math.ceil(8.0 * length_px))
    edges = np.arange(-reach, reach + 2) - 0.5
    share = np.where(edges < 0, 0.5 * np.exp(edges / length_px), 1.0 - 0.5 * np.exp(-np.abs(edges) / length_px))
    kernel = np.diff(share)
    return np.asarray(kernel / kernel.sum())


def nominal_range_DN(camera: Camera) -> float:
    """Return the signal above black at which a pixel is nominally full: its well or the converter's last code.

    Parameters
    ----------
    camera : Camera

    Returns
    -------
    float
        [DN].
    """
    pixel = camera.pixel
    well = pixel.full_well_capacity_e * camera.analogue_gain / pixel.conversion_gain_e_per_DN
    return min(well, 2.0**pixel.bits - 1.0 - pixel.black_level_DN)


def softened(signal: Array, ceiling: float, knee: float) -> Array:
    """Return a signal that approaches a ceiling smoothly: (signal^-p + ceiling^-p)^(-1/p) with p = 1/knee.

    Parameters
    ----------
    signal : ndarray
        Above black, of the unit of ``ceiling``.
    ceiling : float
    knee : float
        Above 0 [1].

    Returns
    -------
    ndarray
        In the shape of ``signal``.
    """
    share = np.maximum(signal, 0.0) / ceiling
    small, large = np.minimum(share, 1.0), np.maximum(share, 1.0)
    # The smaller of share and 1/share to a power stays finite for any knee.
    return np.asarray(ceiling * small * (1.0 + (small / large) ** (1.0 / knee)) ** -knee)


def apply(signal_DN: Array, parameters: Parameters, context: Context) -> Array:
    """Clip the signal at the real ceiling; it acts on the charge that came, shot noise included.

    With a knee the signal stays a little below the ceiling. Overflow is counted up to the nominal ceiling only. Read
    noise above the real ceiling is clipped with it.

    Parameters
    ----------
    signal_DN : ndarray (rows, cols)
        [DN].
    parameters : Parameters
    context : Context

    Returns
    -------
    ndarray (rows, cols)
        [DN].
    """
    if parameters.well_loss == 0.0:
        return signal_DN
    camera = context.scene.camera
    pixel = camera.pixel
    level = pixel.black_level_DN + nominal_range_DN(camera) * (1.0 - parameters.well_loss)
    kept = np.minimum(signal_DN, level)
    if parameters.knee > 0.0:
        black = pixel.black_level_DN
        kept = np.where(signal_DN > black, black + softened(signal_DN - black, level - black, parameters.knee), kept)
    if parameters.bloom == 0.0:
        return kept
    over = signal_DN - kept
    kernel = overflow_kernel(parameters.bloom_length_um / pixel.pitch_um)
    spilt = cv2.sepFilter2D(over, cv2.CV_64F, np.ones(1), kernel, borderType=cv2.BORDER_CONSTANT)
    return np.minimum(kept + parameters.bloom * spilt, level)


EFFECT = Effect(
    id="saturation",
    stage=Stage.READOUT,
    parameters=Parameters,
    amplitudes=("well_loss",),
    apply=apply,
    # No data sheet states the binned pixel's well; a gain or binning mode that was mistaken halves it.
    fitted={"well_loss": 0.3, "knee": 0.05},
    scaling="a ceiling constant in DN: only the brightest pixels, so with voltage and exposure",
    # Nothing happens until the ceiling reaches the brightest pixel.
    start={"well_loss": (0.3, 0.5, 0.7), "knee": (0.01, 0.06)},
)
