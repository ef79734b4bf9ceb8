"""Black level that departs from the one that the camera's processing subtracts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage


class Parameters(Strict):
    """Offset of the black level."""

    offset_DN: float = field(
        0.0, unit="DN", bounds=(-2048.0, 2048.0), null=0.0, doc="real minus nominal black level, raw numbers"
    )


def apply(signal_DN: NDArray[np.float64], parameters: Parameters, context: Context) -> NDArray[np.float64]:
    """Add the offset to the signal before it is quantised.

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
    return signal_DN + parameters.offset_DN


EFFECT = Effect(
    id="black_level",
    stage=Stage.READOUT,
    parameters=Parameters,
    amplitudes=("offset_DN",),
    apply=apply,
    pointwise=True,
    # A measured unit's level moves by 1.3 DN over its gains; temperature and binning add some.
    fitted={"offset_DN": 5.0},
    scaling="constant in raw DN, at every voltage, force and exposure; largest in grey levels where it is dark",
)
