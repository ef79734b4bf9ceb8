"""Dilation, runs and blobs on one bit per pixel, against scikit-image.

Rationale: the words of all rows form one string of bits, so the danger is at the seams: between words, between a row
and the next, at the edges and in the guard.
Expected behaviour: equality of masks and of numbers, no tolerance anywhere.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage import measure, morphology

from evanesce.measurement.reference.blobs import (
    WORD,
    dilate,
    dilates_to_everything,
    disk_segments,
    fill,
    label_runs,
    large_blobs,
    pack,
    runs,
    unpack,
)

WIDTHS = (1, 7, 8, 63, 64, 65, 127, 128, 130, 200)


def dilated_by_scikit_image(mask, radius):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # newer releases call this function `dilation`
        return morphology.binary_dilation(mask, morphology.disk(radius))


def random_mask(seed, shape, share):
    return np.random.default_rng(seed).random(shape) < share


@pytest.mark.parametrize("cols", WIDTHS)
@pytest.mark.parametrize("guard", [1, 10, 64, 70])
def test_packed_rows_read_back_and_end_in_a_guard(cols, guard):
    mask = random_mask(cols, (9, cols), 0.5)
    words = pack(mask, guard)
    assert words.shape[1] * WORD >= cols + guard
    np.testing.assert_array_equal(unpack(words, cols), mask)
    assert not unpack(words, words.shape[1] * WORD)[:, cols:].any()


@pytest.mark.parametrize("radius", [*range(24), 31, 45, 64, 65, 200])
def test_segments_make_up_the_disk(radius):
    """Rows of the disk as half-lengths; each segment is the one before and its two copies, without a gap."""
    disk = morphology.disk(radius).astype(bool)
    made = np.zeros_like(disk)
    length = 0
    for half, rows in disk_segments(radius):
        assert half - length <= 2 * length + 1
        length = half
        for y in rows:
            for at in (radius - y, radius + y):
                made[at, radius - half : radius + half + 1] = True
    np.testing.assert_array_equal(made, disk)


@pytest.mark.parametrize("radius", [0, 1, 2, 5, 10, 11, 20, 33, 63, 64, 65, 90])
@pytest.mark.parametrize("cols", WIDTHS)
def test_dilation_of_single_pixels_is_the_disk(radius, cols):
    """Pixels at the seams of words, at corners and edges; nothing of it appears in the row before or after."""
    for rows, at in ((1, [0]), (7, [0, 6]), (150, [0, 71, 149])):
        for row in at:
            for col in {0, cols // 2, cols - 1, min(63, cols - 1), min(64, cols - 1)}:
                mask = np.zeros((rows, cols), dtype=bool)
                mask[row, col] = True
                y, x = np.mgrid[:rows, :cols]
                expected = (y - row) ** 2 + (x - col) ** 2 <= radius**2
                words = dilate(pack(mask, max(radius, 1)), cols, radius)
                np.testing.assert_array_equal(unpack(words, cols), expected)
                assert not unpack(words, words.shape[1] * WORD)[:, cols:].any()


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    shape=st.tuples(st.integers(1, 90), st.integers(1, 200)),
    share=st.sampled_from([0.0, 0.001, 0.01, 0.1, 0.5, 0.9, 1.0]),
    radius=st.integers(0, 15),
    min_size=st.integers(0, 3000),
)
def test_large_blobs_are_those_of_scikit_image(seed, shape, share, radius, min_size):
    mask = random_mask(seed, shape, share)
    dilated = dilated_by_scikit_image(mask, radius)
    labels, count = measure.label(dilated, return_num=True)
    large = np.bincount(labels.ravel(), minlength=count + 1) >= min_size
    large[0] = False
    found = large_blobs(mask, radius, min_size)
    np.testing.assert_array_equal(found.dilated, large[labels])
    assert (found.kept, found.dropped) == (large.sum(), count - large.sum())


@pytest.mark.parametrize("cols", WIDTHS)
@pytest.mark.parametrize("share", [0.05, 0.4, 0.59, 0.95, 1.0])
def test_labels_of_runs_are_those_of_pixels(cols, share):
    """Without dilation: touching corner to corner counts, ends of rows do not touch the next row's beginning."""
    mask = random_mask(7, (61, cols), share)
    words = pack(mask, 1)
    starts, stops = runs(words)
    stride = words.shape[1] * WORD
    assert (stops > starts).all()
    np.testing.assert_array_equal(starts // stride, (stops - 1) // stride)
    np.testing.assert_array_equal(fill(starts, stops, words.shape), words)
    count, labels = label_runs(starts, stops, stride)
    expected = measure.label(mask)
    assert count == expected.max()
    # each run has one label of either kind, and the two correspond one to one
    of_run = expected[starts // stride, starts % stride]
    assert len({*zip(labels.tolist(), of_run.tolist(), strict=True)}) == count


def test_chosen_runs_are_filled_alone():
    mask = random_mask(3, (40, 150), 0.5)
    words = pack(mask, 1)
    starts, stops = runs(words)
    chosen = np.random.default_rng(1).random(len(starts)) < 0.5
    expected = np.zeros(mask.shape, dtype=bool)
    stride = words.shape[1] * WORD
    for start, stop in zip(starts[chosen], stops[chosen], strict=True):
        expected[start // stride, start % stride : (stop - 1) % stride + 1] = True
    np.testing.assert_array_equal(unpack(fill(starts[chosen], stops[chosen], words.shape), 150), expected)


def test_many_runs_are_labelled_by_pixels_alike(monkeypatch):
    mask = random_mask(5, (170, 230), 0.01)
    for min_size in (0, 30, 400, 10**6):
        by_runs = large_blobs(mask, 2, min_size)
        monkeypatch.setattr("evanesce.measurement.reference.blobs.MOST_RUNS", 0)
        by_pixels = large_blobs(mask, 2, min_size)
        monkeypatch.undo()
        np.testing.assert_array_equal(by_pixels.dilated, by_runs.dilated)
        assert (by_pixels.kept, by_pixels.dropped) == (by_runs.kept, by_runs.dropped)


@pytest.mark.parametrize("radius", [0, 1, 3, 7, 10, 17])
@pytest.mark.parametrize("shape", [(3, 5), (60, 64), (61, 131)])
def test_only_what_dilates_to_everything_passes_for_it(radius, shape):
    """Holes at any place, corners included: yes is never wrong, and is said of every hole that is narrow enough."""
    rows, cols = shape
    half = int(radius / 2**0.5)  # of the square within the disk
    answers = set()
    for seed in range(60):
        rng = np.random.default_rng([radius, seed])
        row, col = int(rng.integers(rows)), int(rng.integers(cols))
        tall, wide = (int(n) for n in rng.integers(0, 2 * half + 4, 2))
        mask = np.ones(shape, dtype=bool)
        mask[row : row + tall, col : col + wide] = False
        yes = dilates_to_everything(pack(mask, max(radius, 1)), cols, radius)
        answers.add(yes)
        assert not yes or dilated_by_scikit_image(mask, radius).all()
        columns = (~mask).any(axis=0).sum()
        assert yes or half < columns or columns == cols  # beside a hole of `half` columns there is always a pixel
    assert True in answers


@pytest.mark.parametrize("radius", [0, 10])
def test_a_blob_that_is_the_whole_frame_may_be_too_small(radius):
    mask = np.ones((20, 30), dtype=bool)
    for min_size, kept in ((600, True), (601, False)):
        found = large_blobs(mask, radius, min_size)
        assert (found.kept, found.dropped) == (int(kept), int(not kept))
        assert found.dilated.all() == found.dilated.any() == kept


def test_nothing_set_is_no_blob():
    found = large_blobs(np.zeros((30, 40), dtype=bool), 10, 0)
    assert (found.kept, found.dropped, found.dilated.any()) == (0, 0, False)
