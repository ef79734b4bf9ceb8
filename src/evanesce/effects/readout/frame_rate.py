"""Frame interval that departs from the nominal one: time stamps run too fast or too slow."""

from __future__ import annotations

from dataclasses import replace

from evanesce.core.quantities import Strict, field
from evanesce.core.states import Frame
from evanesce.effects.protocol import Context, Effect, Stage


class Parameters(Strict):
    """Departure of the interval."""

    departure: float = field(
        0.0,
        unit="1",
        bounds=(-0.8, 4.0),
        null=0.0,
        doc="true over nominal frame interval, less 1; 0.2: taken at 25 Hz, nominally 30 Hz",
    )


def apply(frame: Frame, parameters: Parameters, context: Context) -> Frame:
    """Stamp the frame with its true time over 1 + departure, counted from the run's time 0; the image is kept.

    Parameters
    ----------
    frame : Frame
    parameters : Parameters
    context : Context

    Returns
    -------
    Frame
    """
    return replace(frame, time=frame.time / (1.0 + parameters.departure))


EFFECT = Effect(
    id="frame_rate",
    stage=Stage.FRAME,
    parameters=Parameters,
    amplitudes=("departure",),
    apply=apply,
    pointwise=True,
    # The thesis's video is read as 25 and as 30 frames a second: 0.2 apart.
    fitted={"departure": 0.1},
    needs=("time",),
    scaling="stretches every series over time by one factor; images, voltage and force are unchanged",
)
