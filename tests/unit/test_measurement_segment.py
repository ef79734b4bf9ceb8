"""The reference segmentation of the thesis, to the pixel, against two implementations written apart from it.

Rationale: an area is a count of pixels, so the fast chain has to return the very mask that scikit-image's functions
give in double precision, also where a level meets the threshold in the last bit.
Expected behaviour: equality of masks, no tolerance anywhere.
"""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from skimage import color, filters, measure, morphology, util

from evanesce.core.errors import InputError
from evanesce.measurement.reference.segment import (
    LUMA,
    LUMA_SCALE,
    Chain,
    Crop,
    _brighter,
    _runs,
    _single_precision_levels,
    _weights,
    blurred_grey,
    grey,
    rounding_margin,
    segment,
)


def literal(image, threshold, min_blob=2000, blur=1.0, radius=10):
    """Mask, surviving dilated blobs, their number and that of all blobs, as one writes it down with scikit-image."""
    level = color.rgb2gray(image) if image.ndim == 3 else util.img_as_float(image)
    mask = filters.gaussian(level, sigma=blur) > threshold
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # newer releases call this function `dilation`
        dilated = morphology.binary_dilation(mask, morphology.disk(radius))
    labels = measure.label(dilated)
    kept = np.zeros(labels.max() + 1, dtype=bool)
    for region in measure.regionprops(labels):
        kept[region.label] = region.area >= min_blob
    return mask & kept[labels], kept[labels], int(kept.sum()), int(labels.max())


def by_hand(image, threshold, min_blob, radius):
    """The chain in loops over pixels, for tiny images: own blur, own disk, own flood fill."""
    rows, cols = image.shape[:2]
    level = image @ [0.2125, 0.7154, 0.0721] / 255 if image.ndim == 3 else image / 255
    tap = [math.exp(-(k**2) / 2) for k in range(-4, 5)]
    tap = [t / sum(tap) for t in tap]
    blurred = np.zeros((rows, cols))
    for r in range(rows):
        for c in range(cols):
            for i in range(-4, 5):
                for j in range(-4, 5):
                    rr, cc = min(max(r + i, 0), rows - 1), min(max(c + j, 0), cols - 1)
                    blurred[r, c] += tap[i + 4] * tap[j + 4] * level[rr, cc]
    mask = blurred > threshold
    lit = list(zip(*np.nonzero(mask), strict=True))
    grown = np.zeros_like(mask)
    for r in range(rows):
        for c in range(cols):
            grown[r, c] = any((r - a) ** 2 + (c - b) ** 2 <= radius**2 for a, b in lit)
    kept, seen = np.zeros_like(mask), np.zeros_like(mask)
    for start in zip(*np.nonzero(grown), strict=True):
        blob, stack = set(), [start]
        while stack:
            r, c = stack.pop()
            if 0 <= r < rows and 0 <= c < cols and grown[r, c] and not seen[r, c]:
                seen[r, c] = True
                blob.add((r, c))
                stack += [(r + i, c + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        if len(blob) >= min_blob:
            for at in blob:
                kept[at] = True
    return mask & kept, blurred


def assert_same(image, threshold, min_blob=2000, blur=1.0, radius=10):
    mask, dilated, kept, count = literal(image, threshold, min_blob, blur, radius)
    found = segment(image, Chain(threshold=threshold, min_blob=min_blob, blur=blur, radius=radius))
    np.testing.assert_array_equal(found.mask, mask)
    np.testing.assert_array_equal(found.dilated, dilated)
    assert (found.pixels, found.blobs, found.dropped_blobs) == (mask.sum(), kept, count - kept)
    return found


def ugly_frame(seed, shape=(311, 427), colour=True):
    """Ridged, off-centre, elliptical patch under uneven light, with noise, specks, a hot row and a lit corner."""
    rng = np.random.default_rng(seed)
    rows, cols = shape
    y, x = np.mgrid[:rows, :cols]
    inside = ((x - 0.61 * cols) / (0.23 * cols)) ** 2 + ((y - 0.37 * rows) / (0.31 * rows)) ** 2 < 1
    ridges = 0.5 + 0.5 * np.sin(x / 3.1 + y / 7.7)
    level = 9 + 14 * x / cols + 190 * inside * ridges + rng.normal(0, 5, shape)
    level[rng.integers(0, rows, 60), rng.integers(0, cols, 60)] += rng.uniform(50, 250, 60)
    level[rows // 3, : cols // 7] = 255
    level[-6:, -9:] = 255
    if colour:
        level = level[..., None] * [0.91, 1.07, 1.21] + rng.normal(0, 3, (*shape, 3))
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("threshold", [0.0375, 0.15, 0.35, 0.6])
def test_equals_scikit_image_on_ugly_frames(colour, threshold):
    found = assert_same(ugly_frame(int(threshold * 1000), colour=colour), threshold)
    assert found.pixels  # otherwise nothing was compared


def noisy_frame(kind, seed, shape, colour):
    """Frames with something everywhere: every pixel, or specks all over."""
    rng = np.random.default_rng([41, seed])
    rows, cols = shape
    size = (*shape, 3) if colour else shape
    x = np.linspace(0, 1, cols)[None, :, None] if colour else np.linspace(0, 1, cols)[None]
    if kind == "uniform":
        level = rng.uniform(0, 256, size)
    elif kind == "read noise on a ramp":
        level = 9 + 9 * x + rng.normal(0, 3.5, size)
    elif kind == "shot noise":
        level = rng.poisson(30 + 60 * x, size)
    elif kind == "grain":  # correlated over several pixels
        coarse = rng.normal(0, 60, (rows // 6 + 1, cols // 6 + 1, *size[2:]))
        level = 110 + np.kron(coarse, np.ones((6, 6, *(1,) * (len(size) - 2))))[:rows, :cols]
    elif kind == "salt and pepper":
        level = rng.choice([0, 0, 0, 255], size)
    elif kind == "levels of the threshold":  # 102 / 255 is 0.4, 153 / 255 is 0.6: many flat patches at a threshold
        level = np.repeat(rng.choice([101, 102, 102, 153, 154], (rows, cols // 40 + 1, *size[2:])), 40, axis=1)[
            :, :cols
        ]
    else:
        share = {"dense specks": 0.02, "specks": 0.003, "few specks": 0.0006}[kind]
        level = rng.normal(8, 2, size) + 240 * (rng.random(shape) < share).reshape((*shape, 1)[: len(size)])
    return np.clip(np.rint(level), 0, 255).astype(np.uint8)


NOISES = (
    "uniform",
    "read noise on a ramp",
    "shot noise",
    "grain",
    "salt and pepper",
    "levels of the threshold",
    "dense specks",
    "specks",
    "few specks",
)


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("kind", NOISES)
def test_equals_scikit_image_on_frames_lit_all_over(kind, colour):
    """All pixels, half of them, few of them; blobs of every size; shapes that are no multiple of anything."""
    shapes = ((173, 251), (128, 192), (97, 131))
    thresholds = (0.02, 0.0375, 0.11, 0.15, 0.4, 0.45, 0.6)
    settings_ = (
        (2000, 1.0, 10),
        (0, 1.0, 10),
        (318, 1.0, 10),
        (30_000, 1.0, 10),
        (25, 0.0, 1),
        (60, 2.3, 0),
        (900, 0.7, 17),
    )
    counted = 0
    for seed, threshold in enumerate(thresholds):
        min_blob, blur, radius = settings_[seed]
        image = noisy_frame(kind, seed, shapes[seed % 3], colour)
        for least in {min_blob, 2000}:
            counted += assert_same(image, threshold, least, blur, radius).pixels
    assert counted


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    kind=st.sampled_from(NOISES),
    seed=st.integers(0, 10**6),
    shape=st.tuples(st.integers(1, 140), st.integers(1, 140)),
    colour=st.booleans(),
    threshold=st.one_of(st.floats(0, 1), st.sampled_from([0.0375, 0.15, 0.4, 0.6])),
    min_blob=st.integers(0, 4000),
    blur=st.sampled_from([0.0, 0.3, 1.0, 3.0]),
    radius=st.integers(0, 20),
)
def test_equals_scikit_image_on_any_noise(kind, seed, shape, colour, threshold, min_blob, blur, radius):
    assert_same(noisy_frame(kind, seed, shape, colour), threshold, min_blob, blur, radius)


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("threads", [1, 2, 3, 7])
def test_threads_and_strips_change_nothing(monkeypatch, threads, colour):
    image = noisy_frame("read noise on a ramp", 3, (83, 117), colour)
    once = segment(image, Chain(threshold=0.0375, min_blob=300))
    monkeypatch.setattr("evanesce.measurement.reference.segment.THREAD_PIXELS", 1)
    monkeypatch.setattr("evanesce.measurement.reference.segment.cv2.getNumThreads", lambda: threads)
    for pixels in (1, 500, 3000):
        monkeypatch.setattr("evanesce.measurement.reference.segment.STRIP_PIXELS", pixels)
        found = assert_same(image, 0.0375, min_blob=300)
        assert found.grey_range == once.grey_range
        assert_same(image[:3], 0.0375, min_blob=300)  # more threads than rows


@pytest.mark.parametrize(("min_blob", "blur", "radius"), [(0, 0.0, 0), (317, 0.6, 10), (318, 2.5, 3), (900, 1.0, 21)])
def test_equals_scikit_image_at_other_settings(min_blob, blur, radius):
    assert_same(ugly_frame(5), 0.21, min_blob, blur, radius)


@pytest.mark.parametrize("shape", [(1, 1), (1, 37), (41, 1), (2, 3), (8, 90)])
def test_images_smaller_than_the_kernel(shape):
    image = np.random.default_rng(2).integers(0, 256, shape, dtype=np.uint8)
    assert_same(image, 0.45, min_blob=1)
    assert_same(np.dstack([image, image // 2, 255 - image]), 0.45, min_blob=1)


@pytest.mark.parametrize("value", [0, 1, 102, 153, 255])
@pytest.mark.parametrize("colour", [False, True])
def test_flat_images_at_the_threshold_follow_the_last_bit_of_the_reference(value, colour):
    """153/255 is 0.6 and 102/255 is 0.4: whether such a flat patch counts is rounding alone, and has to agree."""
    image = np.full((53, 71, 3) if colour else (53, 71), value, np.uint8)
    for threshold in (value / 255, np.nextafter(value / 255, 2), np.nextafter(value / 255, -1), 0.4, 0.6):
        if 0 <= threshold <= 1:
            assert_same(image, float(threshold))


def test_flat_steps_at_the_threshold_among_other_pixels():
    image = np.full((260, 190, 3), 40, np.uint8)
    image[31:140, 17:120] = 153
    image[150:250, 90:] = 200
    assert_same(image, 0.6)


def test_one_pixel_blob_dilates_to_the_disk():
    """A lone hot pixel grows to the 317 pixels of the disk; ``min_blob`` keeps it at 317 and drops it at 318."""
    image = np.zeros((90, 120), np.uint8)
    image[37, 51] = 255
    assert morphology.disk(10).sum() == 317
    # the blurred peak is the squared middle tap, 0.1592; its neighbours reach 0.0966
    assert segment(image, Chain(threshold=0.15, min_blob=317)).pixels == 1
    found = segment(image, Chain(threshold=0.15, min_blob=318))
    assert (found.pixels, found.blobs, found.dropped_blobs) == (0, 0, 1)


def test_blobs_are_clipped_by_the_edge_and_joined_across_corners():
    image = np.zeros((70, 80), np.uint8)
    image[0, 0] = 255  # at a corner about a quarter of the disk is left
    quarter = int(morphology.disk(10)[10:, 10:].sum())
    # edges are repeated, so the corner pixel's blurred level is higher and takes in its neighbours
    dilated = literal(image, 0.15, 1)[1]
    assert dilated.sum() >= quarter
    assert_same(image, 0.15, min_blob=int(dilated.sum()))
    assert_same(image, 0.15, min_blob=int(dilated.sum()) + 1)
    # two pixels whose disks of radius 2 meet at a corner only: one blob with 8 neighbours
    image[:] = 0
    image[30, 30] = image[33, 33] = 255
    found = segment(image, Chain(threshold=0.5, blur=0.0, radius=2, min_blob=26))
    assert (found.blobs, found.pixels) == (1, 2)


def test_black_and_white_frames():
    assert assert_same(np.zeros((60, 80, 3), np.uint8), 0.15).pixels == 0
    assert assert_same(np.full((60, 80, 3), 255, np.uint8), 0.15).pixels == 4800
    white = assert_same(np.full((60, 80), 255, np.uint8), 1.0)
    assert white.grey_range == pytest.approx((1.0, 1.0), abs=rounding_margin(9))
    assert_same(np.zeros((60, 80), np.uint8), 0.0)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    image=st.one_of(
        arrays(np.uint8, st.tuples(st.integers(1, 16), st.integers(1, 16))),
        arrays(np.uint8, st.tuples(st.integers(1, 13), st.integers(1, 13), st.just(3))),
    ),
    threshold=st.floats(0.01, 0.99),
    min_blob=st.integers(0, 120),
    radius=st.integers(0, 4),
)
def test_equals_loops_over_pixels(image, threshold, min_blob, radius):
    mask, blurred = by_hand(image, threshold, min_blob, radius)
    if np.abs(blurred - threshold).min() < 1e-12:  # the loops sum in another order: rounding alone decides there
        return
    found = segment(image, Chain(threshold=threshold, min_blob=min_blob, radius=radius))
    np.testing.assert_array_equal(found.mask, mask)


@settings(max_examples=40, deadline=None)
@given(
    image=arrays(
        np.uint8,
        st.tuples(st.integers(20, 60), st.integers(20, 60)),
        elements=st.sampled_from([0, 3, 102, 153, 254, 255]),
        fill=st.sampled_from([0, 102, 153, 255]),
    ),
    colour=st.booleans(),
    threshold=st.sampled_from([0.0, 0.15, 0.4, 0.6, 1.0]),
    min_blob=st.sampled_from([0, 317, 2000]),
)
def test_equals_scikit_image_on_anything(image, colour, threshold, min_blob):
    assert_same(np.dstack([image, np.roll(image, 1), image[::-1]]) if colour else image, threshold, min_blob)


def test_double_precision_levels_are_those_of_scikit_image_to_the_bit():
    for image in (ugly_frame(1), ugly_frame(2, colour=False)):
        reference = color.rgb2gray(image) if image.ndim == 3 else util.img_as_float(image)
        np.testing.assert_array_equal(grey(image), reference)
        np.testing.assert_array_equal(blurred_grey(image, 1.0), filters.gaussian(reference, sigma=1))


@pytest.mark.parametrize("blur", [0.0, 1.0, 7.0])
@pytest.mark.parametrize("colour", [False, True])
def test_levels_in_single_precision_stay_within_their_bound(blur, colour):
    """The bound holds for the worst pixel of a noisy frame, and is not idle: errors come within a factor of 100."""
    image = np.random.default_rng(3).integers(0, 256, (200, 300, 3) if colour else (200, 300), dtype=np.uint8)
    taps = _weights(blur)
    strips = [level.copy() for _, level in _single_precision_levels(image, taps, range(200))]
    error = np.abs(np.concatenate(strips) / (LUMA_SCALE if colour else 255) - blurred_grey(image, blur)).max()
    assert error <= rounding_margin(len(taps))
    assert error >= rounding_margin(len(taps)) / 100


def test_sums_of_colours_are_held_exactly():
    image = np.random.default_rng(3).integers(0, 256, (200, 300, 3), dtype=np.uint8)
    image[0, :2] = [[0, 0, 0], [255, 255, 255]]
    strips = [level.copy() for _, level in _single_precision_levels(image, np.ones(1), range(200))]
    np.testing.assert_array_equal(np.concatenate(strips), image.astype(np.int64) @ np.array(LUMA))


def test_undecided_pixels_by_windows_and_by_rows_agree(monkeypatch):
    """Thresholds taken from the frame's own levels leave pixels undecided; both ways to settle them give one answer."""
    image = ugly_frame(8)
    exact = blurred_grey(image, 1.0)
    for at in ((40, 50), (0, 0), (310, 426), (117, 261)):
        threshold = float(exact[at])
        by_windows = _brighter(image, threshold, 1.0)[0]
        monkeypatch.setattr("evanesce.measurement.reference.segment.MOST_WINDOWS", -1)
        by_rows = _brighter(image, threshold, 1.0)[0]
        monkeypatch.undo()
        np.testing.assert_array_equal(by_windows != 0, exact > threshold)
        np.testing.assert_array_equal(by_rows, by_windows)


@pytest.mark.parametrize("radius", [0, 1, 3, 4, 8, 10, 11, 21])
@pytest.mark.parametrize("diagonal", [False, True])
def test_blobs_that_just_touch_are_one(radius, diagonal):
    """Two pixels at every distance near the one at which their disks touch, at odd columns of the words of 64."""
    for apart in range(max(2 * radius - 8, 1), 2 * radius + 5):
        step = (round(apart / 1.4), apart - round(apart / 1.4)) if diagonal else (0, apart)
        image = np.zeros((3 * radius + 41, 4 * radius + 53), np.uint8)
        at = (radius + 5, radius + 3 + apart % 7)
        image[at] = image[at[0] + step[0], at[1] + step[1]] = 255
        size = int(literal(image, 0.5, 1, 0.0, radius)[1].sum())
        one = int(morphology.disk(radius).sum())
        for least in (one, one + 1, size, size + 1):
            assert_same(image, 0.5, min_blob=least, blur=0.0, radius=radius)


def test_entangled_blobs():
    """Diagonal stripes, too far apart to touch: many blobs with wide, overlapping boxes; corners are dropped."""
    y, x = np.mgrid[:500, :617]
    image = np.where((x + y) % 91 == 0, 255, 0).astype(np.uint8)
    found = assert_same(image, 0.3, min_blob=2000, blur=0.0)
    assert (found.blobs, found.dropped_blobs) == (11, 2)  # x + y of 91 to 1001; 0 and 1092 lie in corners
    assert_same(image[:130, :190], 0.3, min_blob=2000, blur=0.0)


def test_nested_blobs_keep_apart():
    """A ring around a disk around which it leaves a gap: each within the other's box, each of its own size."""
    y, x = np.mgrid[:261, :273]
    r = np.hypot(x - 131, y - 126)
    image = np.where((r < 9) | ((r > 60) & (r < 64)), 255, 0).astype(np.uint8)
    inner = int(literal(np.where(r < 9, image, 0).astype(np.uint8), 0.4, 1)[1].sum())
    for least in (1, inner, inner + 1, 20_000):
        assert_same(image, 0.4, min_blob=least)
    assert segment(image, Chain(threshold=0.4, min_blob=inner + 1)).blobs == 1


def test_runs_cover_what_they_should():
    assert _runs(np.array([], dtype=np.intp), 9) == []
    assert _runs(np.array([3, 4, 13, 30]), 9) == [(3, 14), (30, 31)]


def test_crop_is_half_open_and_comes_before_the_blur():
    image = ugly_frame(4)
    crop = Crop.parse("21:260,37:333")
    found = segment(image, Chain(threshold=0.2, crop=crop))
    mask = literal(image[21:260, 37:333], 0.2)[0]
    np.testing.assert_array_equal(found.mask, mask)
    assert Crop.parse(" :7 , 3: ") == Crop(0, 7, 3, None)
    assert str(Crop.parse("2:7,3:")) == "2:7,3:"


@pytest.mark.parametrize(
    "text", ["", "1:2", "1:2,3", "a:2,3:4", "5:5,0:9", "9:2,0:9", "-5:9,0:9", "1.5:2,0:4", "1:2:3,4:5"]
)
def test_bad_crops_are_refused(text):
    with pytest.raises(InputError, match="--crop"):
        Crop.parse(text)


def test_crop_beyond_the_image_names_its_size():
    with pytest.raises(InputError, match="311 rows and 427 columns"):
        segment(ugly_frame(0), Chain(threshold=0.2, crop=Crop.parse("0:312,0:400")))


@pytest.mark.parametrize(
    "setting",
    [
        {"threshold": math.nan},
        {"threshold": 1.2},
        {"threshold": 0.1, "min_blob": -1},
        {"threshold": 0, "blur": math.inf},
    ],
)
def test_bad_settings_are_refused(setting):
    with pytest.raises(InputError):
        Chain(**setting)


@pytest.mark.parametrize(
    "image", [np.zeros((4, 5), np.uint16), np.zeros((4, 5, 4), np.uint8), np.zeros((0, 5), np.uint8)]
)
def test_other_images_are_refused(image):
    with pytest.raises(InputError):
        segment(image, Chain(threshold=0.1))
