"""Automatic exposure, gain and white balance, as libcamera settles them on a scene that stands still.

Rules and settings are those of the libcamera sources (src/ipa/rpi/controller/rpi/agc_channel.cpp and awb_bayes.cpp,
src/ipa/rpi/vc4/vc4.cpp and vc4/data/imx477.json; metering weights from src/ipa/rpi/pisp/data/imx477.json, whose zones
are a plain 15 x 15 grid; github.com/raspberrypi/libcamera, commit 26bfadc66e8d7f727a993fe58174217b8a96f7f9). What the
controls do over time, digital gain, the avoidance of flicker and the search off the curve of white points are left out.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from evanesce.rig import Camera
from evanesce.sensor.colour import CHANNELS, ImageProcessor
from evanesce.sensor.tuning import white_imx477

Array = NDArray[np.float64]

LUMA = np.array([0.299, 0.587, 0.114])
"""ITU-R BT.601, of red, green and blue [1]."""

MEAN_TARGET, MEAN_OFFSET = 0.16, 0.001
"""Metered mean luma that is sought in dim light, and what is added to the mean before the two are compared [1]."""
BRIGHT_SHARE, BRIGHT_TARGET = 0.98, 0.3
"""The mean of the brightest 2 % of the *green* raw values is to reach this at least [1]."""
TARGET_LIMIT = 0.9
"""No target is raised beyond this [1]."""
STAGES: dict[str, tuple[tuple[float, float], ...]] = {
    "normal": ((0.1, 1.0), (10.0, 2.0), (30.0, 4.0), (60.0, 6.0), (66.666, 16.0)),
    "short": ((0.1, 1.0), (5.0, 2.0), (10.0, 4.0), (20.0, 6.0), (66.666, 16.0)),
    "long": ((0.1, 1.0), (10.0, 2.0), (30.0, 4.0), (60.0, 6.0), (120.0, 16.0)),
}
"""Exposure [ms] and gain [1] at the end of each stage, within which first the exposure rises, then the gain."""

METERING_ZONES = 15
# A quarter of the symmetric grid from its middle zone on; rows: zones down, columns: zones across.
_CENTRE_WEIGHTED = np.array(
    [
        (4, 4, 3, 3, 2, 2, 1, 1),
        (4, 3, 3, 3, 2, 2, 1, 1),
        (3, 3, 3, 2, 2, 2, 1, 1),
        (3, 3, 2, 2, 2, 2, 1, 1),
        (2, 2, 2, 2, 2, 2, 1, 1),
        (2, 2, 2, 2, 1, 1, 1, 1),
        (2, 2, 1, 1, 1, 1, 1, 0),
        (1, 1, 1, 1, 1, 1, 0, 0),
    ]
)

WHITE_ZONES = (12, 16)
"""Rows and columns of the zones of the white balance."""
WARMEST_K, COOLEST_K = 2500.0, 8000.0
"""Ends of the search in mode "auto" [K]."""
STEP = 0.02
"""From one colour temperature that is tried to the next [of the temperature]."""
DELTA_LIMIT = 0.2
"""Largest squared departure from grey that a zone counts with: those of strong colour say nothing [1]."""
SENSITIVITY = 1.05
"""Of red and blue of this sensor to those of the one that the curve was measured with [1]."""
LEAST_GREEN, LEAST_ZONES = 32 / 65536, 10
"""Zones whose mean green is lower are left out [1]; the balance stays as it is with no more zones than this."""
DIM_PRIOR = ((2000.0, 3000.0, 13000.0), (1.0, 0.0, 0.0))
"""Logarithm of a colour temperature's prior [K], [1] in dim light. A dark rig has no other."""

_MOST_PIXELS = 250_000  # of the statistics: zones of some thousand pixels each


def settle(charge_e: Array, camera: Camera) -> tuple[Camera, ImageProcessor | None]:
    """Return the camera with the exposure, gain and white balance on which its automatic controls settle.

    Parameters
    ----------
    charge_e : ndarray (rows, cols)
        Mean charge of each pixel at the camera's own exposure, before the full well [e-].
    camera : Camera
        Where it has no automatic exposure its exposure and gain stay.

    Returns
    -------
    camera : Camera
        Without automatic exposure.
    processor : ImageProcessor or None
        None for a monochrome camera.
    """
    colour, control = camera.colour, camera.auto_exposure
    planes = _planes(charge_e, camera) / camera.exposure_ms
    processor = None if colour is None else ImageProcessor.of(camera)
    balancing = colour is not None and colour.white_balance == "automatic"
    # Exposure looks at balanced light, the balance at what is not clipped: three rounds are enough for both.
    for _ in range(3 if balancing else 1):
        if control is not None:
            gains = np.ones(3) if processor is None else processor.gains
            camera = _exposed(planes, camera, gains)
        if balancing and processor is not None:
            raw = _raw(planes, camera, camera.exposure_ms, camera.analogue_gain)
            processor = _balanced(raw, processor)
    return camera.model_copy(update={"auto_exposure": None}), processor


def is_automatic(camera: Camera) -> bool:
    """Return whether exposure or white balance depend on the light.

    Parameters
    ----------
    camera : Camera
    """
    balancing = camera.colour is not None and camera.colour.white_balance == "automatic"
    return balancing or camera.auto_exposure is not None


def metering_weights(metering: str) -> Array:
    """Return the weight of each zone of the metered mean.

    Parameters
    ----------
    metering : {"centre-weighted", "spot", "matrix"}

    Returns
    -------
    ndarray (15, 15)
        [1].
    """
    down, across = np.abs(np.indices((METERING_ZONES, METERING_ZONES)) - METERING_ZONES // 2)
    if metering == "matrix":
        return np.ones(down.shape)
    if metering == "spot":
        return np.maximum(3.0 - down - across, 0.0)
    return _CENTRE_WEIGHTED[down, across].astype(np.float64)


def stage_of(total: float, mode: str) -> tuple[float, float]:
    """Return exposure [ms] and gain [1] whose product is ``total`` [ms], as near to it as the mode allows.

    Parameters
    ----------
    total : float
        Exposure times gain [ms].
    mode : {"normal", "short", "long"}

    Returns
    -------
    exposure_ms, gain : float
    """
    (exposure, gain), *stages = STAGES[mode]
    for longest, highest in stages:
        if total <= longest * gain:
            return max(exposure, total / gain), gain
        exposure = longest
        if total <= exposure * highest:
            return exposure, total / exposure
        gain = highest
    return exposure, gain


def _planes(charge_e: Array, camera: Camera) -> Array:
    """Return red, green (the mean of two) and blue of each 2 x 2 pixels (3, rows, cols), thinned out [e-]."""
    rows, cols = (n // 2 * 2 for n in charge_e.shape)
    step = max(1, int(np.sqrt(rows * cols / 4 / _MOST_PIXELS)))
    block = {(i, j): charge_e[i:rows:2, j:cols:2][::step, ::step] for i in (0, 1) for j in (0, 1)}
    if camera.colour is None:
        return np.repeat(np.mean(list(block.values()), axis=0)[None], 3, axis=0)
    letters = camera.colour.mosaic
    return np.array(
        [
            np.mean([block[divmod(place, 2)] for place, own in enumerate(letters) if own == letter], axis=0)
            for letter in CHANNELS
        ]
    )


def _raw(planes: Array, camera: Camera, exposure_ms: float, gain: float) -> Array:
    """Return raw values over full scale of charges per millisecond."""
    pixel = camera.pixel
    top = 2**pixel.bits - 1 - pixel.black_level_DN
    collected = np.minimum(planes * exposure_ms, pixel.full_well_capacity_e)
    return np.asarray(np.minimum(collected * (gain / pixel.conversion_gain_e_per_DN / top), 1.0))


def _exposed(planes: Array, camera: Camera, gains: Array) -> Camera:
    """Return the camera at the least exposure at which both targets are met, or its longest."""
    control = camera.auto_exposure
    if control is None:
        return camera
    weights = metering_weights(control.metering)
    mean_target, bright_target = (min(TARGET_LIMIT, t * control.compensation) for t in (MEAN_TARGET, BRIGHT_TARGET))
    stages = STAGES[control.mode]
    low, high = np.log(stages[0][0] * stages[0][1]), np.log(stages[-1][0] * stages[-1][1])

    def meets(log_total: float) -> bool:
        raw = _raw(planes, camera, *stage_of(float(np.exp(log_total)), control.mode))
        zones = np.array([_zone_means(plane, METERING_ZONES, METERING_ZONES) for plane in raw])
        mean = float((np.tensordot(LUMA * gains, zones, 1) * weights).sum() / weights.sum())
        green = np.sort(raw[1], axis=None)
        bright = float(green[int(BRIGHT_SHARE * green.size) :].mean())
        return mean + MEAN_OFFSET >= mean_target and bright >= bright_target

    if not meets(high):
        low = high
    for _ in range(24):
        if high - low < 1e-3:
            break
        middle = (low + high) / 2
        low, high = (low, middle) if meets(middle) else (middle, high)
    exposure, gain = stage_of(float(np.exp(high)), control.mode)
    return camera.model_copy(update={"exposure_ms": exposure, "analogue_gain": gain})


def _balanced(raw: Array, processor: ImageProcessor) -> ImageProcessor:
    """Return the processor with gains and matrix of the colour temperature at which the zones are nearest to grey."""
    zones = np.array([_zone_means(plane, *WHITE_ZONES).ravel() for plane in raw])
    zones = zones[:, zones[1] >= LEAST_GREEN]
    if zones.shape[1] <= LEAST_ZONES:
        return processor
    red, blue = SENSITIVITY * zones[0] / zones[1], SENSITIVITY * zones[2] / zones[1]
    steps = np.arange(np.ceil(np.log(COOLEST_K / WARMEST_K) / np.log1p(STEP)) + 1)
    tried = np.minimum(WARMEST_K * (1 + STEP) ** steps, COOLEST_K)
    white = white_imx477(tried)
    departure = (red / white[0][:, None] - 1.0) ** 2 + (blue / white[1][:, None] - 1.0) ** 2
    share = zones.shape[1] / (WHITE_ZONES[0] * WHITE_ZONES[1])
    cost = np.minimum(departure, DELTA_LIMIT).sum(axis=1) - share * np.interp(tried, *DIM_PRIOR)
    found = ImageProcessor.imx477(_vertex(tried, cost))
    red_gain, blue_gain = found.red_gain * SENSITIVITY, found.blue_gain * SENSITIVITY
    return replace(processor, red_gain=red_gain, blue_gain=blue_gain, matrix=found.matrix)


def _vertex(x: Array, y: Array) -> float:
    """Return where the parabola through the lowest point and its neighbours is lowest, within those three."""
    k = int(np.clip(np.argmin(y), 1, len(y) - 2))
    near, value = x[k - 1 : k + 2], y[k - 1 : k + 2]
    curvature, slope, _ = np.polyfit(near - near[1], value, 2)
    if curvature <= 0.0:
        return float(near[np.argmin(value)])
    return float(np.clip(near[1] - slope / (2 * curvature), near[0], near[2]))


def _zone_means(plane: Array, down: int, across: int) -> Array:
    """Return the mean of each of ``down`` x ``across`` zones of a plane of at least so many pixels."""
    rows, cols = plane.shape
    r, c = _edges(rows, down), _edges(cols, across)
    total = np.add.reduceat(np.add.reduceat(plane, r[:-1], axis=0), c[:-1], axis=1)
    return np.asarray(total / np.outer(np.diff(r), np.diff(c)))


@lru_cache(maxsize=16)
def _edges(size: int, zones: int) -> NDArray[np.int64]:
    """Return where the zones of ``size`` pixels begin, and the end."""
    if size < zones:
        raise ValueError(f"{size} pixels for {zones} zones: automatic exposure needs a larger frame")
    return np.linspace(0, size, zones + 1).astype(np.int64)
