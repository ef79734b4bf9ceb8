"""What every fit varies, because no lab knows it exactly: pose, light, and the jitter of light and load cell.

=================  ==========================================  ==========================================
``@pose_x[s]``     finger beside its believed place, session s  uniform enough: 1 mm
``@light``         LEDs, exposure and gain together             log, 1
``@black``         black level within its rounding              0.3 raw DN
``@noise``         noise before the tone curve                  log, as scatter and dark level show it
``@flicker[v]``    light of one view                            log, as the replicates show it
``@force[v]``      load cell's error in one view                log, 0.3 %
``@pose_x[card]``  place of a printed card; also ``@turn``      1 mm, 2 degrees
``@card_light``    the room's light on a card, and its slope    log 1; 0.1 over half the frame
``@card_veil``     what ink and glass send of it                0.04
=================  ==========================================  ==========================================

What they absorb cannot be found.
"""

from __future__ import annotations

from collections.abc import Sequence

from evanesce.prediction import priors
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.views import View


def nuisance_parameters(views: Sequence[View], flicker: float, noise: float = 0.0) -> tuple[Parameter, ...]:
    """Return the nuisances of some views.

    Parameters
    ----------
    views : sequence of View
    flicker : float
        Standard deviation of the light's logarithm from frame to frame.
    noise : float
        Prior standard deviation of the logarithm of the noise's size before the tone curve; 0: known.
    """
    lit = [k for k, v in enumerate(views) if v.touches]
    found: list[Parameter] = []
    if lit:
        found.append(Parameter(name="@light", deviation=priors.LEVEL, step=0.01, views=tuple(lit)))
    found.append(Parameter(name="@black", unit="DN", deviation=priors.BLACK_DN, step=0.1))
    if noise > 0:
        found.append(Parameter(name="@noise", deviation=noise, step=0.02, linear=True))
    for session in sorted({views[k].session for k in lit}):
        own = tuple(k for k in lit if views[k].session == session)
        for axis in "xy":
            name = f"@pose_{axis}[{session}]"
            found.append(Parameter(name=name, unit="mm", deviation=priors.POSE_MM, step=0.02, views=own))
    for k in lit:
        # Not less for the mean of many frames: they share what their state's light is.
        jitter = max(flicker, priors.LEAST_FLICKER)
        found.append(Parameter(name=f"@flicker[{k}]", deviation=jitter, step=0.01, views=(k,), linear=True))
        found.append(Parameter(name=f"@force[{k}]", deviation=priors.LOAD, step=0.01, views=(k,), linear=True))
    for kind in sorted({v.kind for v in views if v.is_card}):
        own = tuple(k for k, v in enumerate(views) if v.kind == kind)
        for name, unit, deviation, step in (
            (f"@pose_x[{kind}]", "mm", priors.POSE_MM, 0.03),
            (f"@pose_y[{kind}]", "mm", priors.POSE_MM, 0.03),
            (f"@turn[{kind}]", "deg", priors.CARD_TURN_DEG, 0.1),
            (f"@card_light[{kind}]", "1", priors.CARD_LIGHT, 0.02),
            (f"@card_slope_x[{kind}]", "1", priors.CARD_SLOPE, 0.02),
            (f"@card_slope_y[{kind}]", "1", priors.CARD_SLOPE, 0.02),
            (f"@card_veil[{kind}]", "1", priors.CARD_VEIL, 0.005),
        ):
            found.append(Parameter(name=name, unit=unit, deviation=deviation, step=step, views=own))
    return tuple(found)
