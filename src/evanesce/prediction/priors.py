"""Prior standard deviations of what every fit varies beside the causes, with what sets each.

===================  ======  ==========================================================================================
``LEVEL``            1.0     logarithm of the level of frames: exposure, gain, LEDs and lens are stated to a factor
``LIGHT``            0.3     logarithm of the light behind a series without frames: LEDs of one type differ so
``BLACK_DN``         0.3     black level [raw DN]: rounding of what a data sheet states
``POSE_MM``          1.0     place of finger and cards [mm]: set by hand
``LOAD``             0.003   logarithm of the load of a single frame: accuracy class of a small load cell
``LEAST_FLICKER``    0.0005  logarithm of the light of a single frame, at least: some replicates know it no better
``FLICKER``          0.002   the same where there are no replicates
``CARD_TURN_DEG``    2.0     turn of a card laid on the plate [deg]
``CARD_LIGHT``       1.0     logarithm of the room's light on it
``CARD_SLOPE``       0.1     its relative change from the frame's middle to its border
``CARD_VEIL``        0.04    light from ink over what falls on a card: glass mirrors 0.08 of an even room and nothing of
                             dark surroundings, ink reflects 0.02 to 0.1
``SCALE_CLOSE``      0.01    logarithm of real over modelled noise where scatter and dark level agree on it
``SCALE_LOOSE``      0.1     the same where one of them alone is known
``SCALE_CODEC``      0.1     the same where a codec hides it
===================  ======  ==========================================================================================
"""

from __future__ import annotations

LEVEL = 1.0
LIGHT = 0.3
BLACK_DN = 0.3
POSE_MM = 1.0
LOAD = 0.003
LEAST_FLICKER = 0.0005
FLICKER = 0.002
CARD_TURN_DEG = 2.0
CARD_LIGHT = 1.0
CARD_SLOPE = 0.1
CARD_VEIL = 0.04
SCALE_CLOSE = 0.01
SCALE_LOOSE = 0.1
SCALE_CODEC = 0.1
