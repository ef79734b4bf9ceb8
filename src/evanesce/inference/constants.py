"""Main constants of the critic, with what sets each.

=====================  ======  ========================================================================================
``LEAST_AREA``         0.002   relative change of the measured area below which a cause is listed, not named; the
                               repeatability of the thesis's area readings is of that size
``OWN_LIGHT``          0.01    standard deviation of the nominal model's light at low spatial frequencies: LED fluxes
                               are sorted to some per cent, and sums over tens of LEDs vary by a third of that or less
``TIED_SHARE``         0.02    least standard deviation of a cause's own change by which its form may be off; more where
                               the coarse and the fine model differ by more
``WAVES``              3       cosines along each side of the frame in which such errors of form vary: a third of the
                               frame is the shortest, below it errors count as noise does
``STEP_SHARE``         0.002   standard deviation of a bin over the step to its neighbours, for what coarse pixels leave
                               when a fit has moved an edge; extrapolated to fine pixels about an anchor a prediction is
                               off by 0.0005 to 0.0013 alone (benchmarks/critic_pixels.py)
``EXTRAPOLATED``       0.5     standard deviation of what extrapolation to finer pixels adds, as a share of it: that is
                               what orders of convergence between 1.5 and 4 make of it
``FAR``                3.0     standard deviations of its prior within which a nuisance has to stay
``DETECTED``           0.01    p-value, against noise, above which no further cause is sought
``DETECTED_BESIDE``    0.0025  that of localised defects and of bands, which are sought beside smooth causes: all three
                               together raise a false alarm in 1.5 % of data sets
``LEFT``               1e-4    p-value, against noise, below which what is left of all views together is told: what the
                               fine model's pixels leave came to 4e-4 on a rig whose causes were all found
``LEAST_SHARE``        3e-5    share of the misfit that was there, below which nothing is taken: half a per cent in
                               amplitude of what all causes do, by which fine models themselves differ
``WORTH``              0.01    share of what the causes taken before removed, below which a further one is taken only if
                               it moves the area by more than ``LEAST_AREA``: forms are off by per cents
``TRIED``              3       causes that are entered in each round: those of most evidence with the discrepancy, and
                               as many of those without
``FITTED``             2       of them, causes that are fitted: those that would remove most of the misfit
``SUBSTITUTE``         0.5     share of a cause's evidence by which another may fall short and still be tried in its
                               place: forms drawn about the nominal rig are some to tens of per cent off; of its
                               variance, and of its area, that one has to make up for to be told together with it
``STRENGTHS``          3..500  standard deviations by which a cause may show, evenly in the logarithm: below 3 nothing
                               can be told, above 500 the form's own error decides
``NONE_PRIOR``         0.5     prior probability that a place of the sum of causes holds none
``CREDIBLE``           0.95    probability of a credible set of causes
``CERTAIN``            0.75    most that is told of a probability: of what was given 0.7 and more, unknown among it, 84
                               of 113 were there in the first round of the challenge, codecs left out; its cases are
                               scored no more (docs/criticism/challenge.md)
``LEAST_PROBABLE``     0.02    probability below which a cause is no rival that a further shot has to rule out
``DRAWS``              12      forms drawn of each cause; more change evidences by less than a nat
``UNKNOWN_WAVES``      12      half waves along the frame's longer side up to which an unknown field varies: 2 to 3 mm
``GROSS_AREA``         1.35    ratio of measured to predicted area of contact beyond which the finger is another one: a
                               modulus off by three standard deviations of its prior changes it by a third
``GROSS_AXES``         1.2     ratio of the contact's axes beyond the predicted one: three deviations of the prior of an
                               oval load at 5 N are 0.3, one is 0.1
``GROSS_FIELD``        0.05    relative error of the field of view beyond which it is another camera, lens or distance;
                               calibration targets are printed to one per cent
``ODD_LIGHT``          2.0     ratio of real to nominal light that the first line names: a stop of exposure
=====================  ======  ========================================================================================
"""

from __future__ import annotations

import numpy as np

LEAST_AREA = 0.002
OWN_LIGHT = 0.01
TIED_SHARE = 0.02
WAVES = 3
STEP_SHARE = 0.002
EXTRAPOLATED = 0.5
FAR = 3.0
DETECTED = 0.01
DETECTED_BESIDE = 0.0025
LEFT = 1e-4
LEAST_SHARE = 3e-5
WORTH = 0.01
TRIED = 3
FITTED = 2
SUBSTITUTE = 0.5
STRENGTHS = np.geomspace(3.0, 500.0, 8)
NONE_PRIOR = 0.5
CREDIBLE = 0.95
CERTAIN = 0.75
LEAST_PROBABLE = 0.02
DRAWS = 12
UNKNOWN_WAVES = 12
GROSS_AREA = 1.35
GROSS_AXES = 1.2
GROSS_FIELD = 0.05
ODD_LIGHT = 2.0
