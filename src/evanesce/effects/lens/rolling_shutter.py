"""Rolling shutter under LEDs whose light ripples: bright and dark bands that drift.

The supply's ripple is a sinusoid; a dimmer switches the light on and off (pulse-width modulation).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.quantities import Strict, field
from evanesce.core.states import SensorLight
from evanesce.effects.inference_hints import Bands
from evanesce.effects.protocol import Context, Effect, Stage

Array = NDArray[np.float64]


class Parameters(Strict):
    """Ripple of the light, and readout time."""

    ripple: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 1.0),
        null=0.0,
        doc="amplitude over the mean of the light; of a switched light the share that is switched",
    )
    frequency_hz: float = field(
        100.0, unit="Hz", bounds=(1.0, 100_000.0), doc="of the ripple; rectified mains 100 or 120, dimmers 200 to 5000"
    )
    phase_deg: float = field(0.0, unit="deg", bounds=(-180.0, 180.0), doc="at time 0, 0: at the crest or switching on")
    duty: float = field(
        0.0, unit="1", bounds=(0.0, 1.0), doc="share of the period in which a switched light is on; 0: a sinusoid"
    )
    readout_ms: float = field(
        22.75,
        unit="ms",
        bounds=(0.0, 1000.0),
        source="IMX477, 2028 x 1520 mode: lines of 12740 clocks at 840 MHz, 1500 of them",
        doc="from the first row's exposure to the last row's",
    )


def mean_light(
    time_s: ArrayLike, exposure_s: float, *, ripple: float, frequency_hz: float, phase_rad: float, duty: float
) -> Array:
    """Return the mean over an exposure of a light whose mean over time is 1.

    Parameters
    ----------
    time_s : array_like
        Middle of the exposures [s].
    exposure_s : float
        [s].
    ripple, frequency_hz, phase_rad, duty : float
        See :class:`Parameters`; duty 0 means 1 + ripple cos(2 pi f t + phase), else 1 - ripple + ripple s/duty with
        s = 1 during the first ``duty`` of each period and 0 else.

    Returns
    -------
    ndarray
        In the shape of ``time_s``.
    """
    cycles = frequency_hz * np.asarray(time_s, np.float64) + phase_rad / (2.0 * math.pi)
    width = frequency_hz * exposure_s
    if duty == 0.0:
        return np.asarray(1.0 + ripple * np.sinc(width) * np.cos(2.0 * math.pi * cycles))

    def on_until(x: Array) -> Array:
        whole = np.floor(x)
        return whole * duty + np.minimum(x - whole, duty)

    on = (on_until(cycles + width / 2) - on_until(cycles - width / 2)) / width
    return np.asarray(1.0 - ripple + ripple * on / duty)


def apply(light: SensorLight, parameters: Parameters, context: Context) -> SensorLight:
    """Multiply each row by the mean light of its own exposure; the middle row is exposed about the frame's time.

    Parameters
    ----------
    light : SensorLight
    parameters : Parameters
    context : Context

    Returns
    -------
    SensorLight
    """
    if parameters.ripple == 0.0:
        return light
    rows = light.irradiance.shape[0]
    # Row pitch over readout, so that the same frame in fewer rows has the same bands.
    late_s = (np.arange(rows) - (rows - 1) / 2) / rows * parameters.readout_ms * 1e-3
    gain = mean_light(
        context.time_s + late_s,
        context.scene.camera.exposure_ms * 1e-3,
        ripple=parameters.ripple,
        frequency_hz=parameters.frequency_hz,
        phase_rad=math.radians(parameters.phase_deg),
        duty=parameters.duty,
    )
    return SensorLight(irradiance=light.irradiance * gain[:, None])


EFFECT = Effect(
    id="rolling_shutter",
    stage=Stage.SENSOR_LIGHT,
    parameters=Parameters,
    amplitudes=("ripple",),
    apply=apply,
    # Assumed: some per cent, near twice the mains' frequency or a dimmer's.
    fitted={"ripple": 0.05, "frequency_hz": 10.0, "phase_deg": 90.0},
    scaling="follows LED power; horizontal bands whose phase moves with time, or stands at equal rates",
    # Without ripple neither frequency nor phase has a derivative.
    start={"ripple": (0.05,), "frequency_hz": (100.0, 120.0), "phase_deg": (0.0, 90.0)},
    bands=Bands(
        amount="ripple",
        frequency="frequency_hz",
        phase="phase_deg",
        readout="readout_ms",
        share=lambda frequency_hz, exposure_s: float(np.sinc(frequency_hz * exposure_s)),
    ),
)
