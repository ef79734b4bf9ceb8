"""Whether frames show the believed contact at all: on discs in noise whose correlation is known."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from evanesce.criticism.likeness import Likeness, likeness_of
from evanesce.prediction.views import View

SHAPE = (30, 41)
SD = 2.0
VIEWS = tuple(View(kind=kind, force_N=1.0 + k, condition=k) for k, kind in enumerate(["press"] * 5 + ["led_off"]))


def disc(row: float, col: float, height: float) -> np.ndarray:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return height * (np.hypot(y - row, x - col) < 7.3) + 11.0


def compared(shown: np.ndarray, believed: np.ndarray, *, sd: float = SD, prior: float = 0.0, seed: int = 3) -> Likeness:
    """Of frames ``shown`` in noise beside a prediction that was fitted to be ``believed`` (one picture for all)."""
    rng = np.random.default_rng(seed)
    data = np.repeat(shown[None], len(VIEWS), 0) + sd * rng.standard_normal((len(VIEWS), *SHAPE))
    data[-1] = rng.standard_normal(SHAPE)
    cube = np.repeat(believed[None], len(VIEWS), 0)
    cube[-1] = 0.0
    valid = np.ones(data.shape, bool)
    valid[1, :4] = False
    open_views = [0, 1, 3, 4, 5]
    problem: Any = SimpleNamespace(
        data=data, sd=np.full(data.shape, sd), valid=valid, views=open_views, kinds=[VIEWS[v] for v in open_views]
    )
    residual = ((data - cube) / sd)[open_views][valid[open_views]]

    def unwhitened(row: np.ndarray) -> np.ndarray:
        found = np.zeros((len(open_views), *SHAPE))
        found[valid[open_views]] = row
        return found

    problem.unwhitened = unwhitened
    fitted: Any = SimpleNamespace(residual=residual, misfit=float(residual @ residual) + prior)
    return likeness_of(problem, fitted, cube)


@pytest.mark.parametrize("height", [6.0, 60.0])
def test_a_contact_as_believed_is_alike_however_faint(height: float) -> None:
    """The noise is taken off: without that a disc of three deviations would correlate by 0.8."""
    picture = disc(13.0, 22.0, height)
    found = compared(picture, picture)
    assert found.correlation == pytest.approx(1.0, abs=0.03)
    assert found.evidence == 0.0


def test_brightness_is_no_likeness() -> None:
    """A fifth of the light, and more light beneath: another exposure, the same contact."""
    assert compared(disc(13.0, 22.0, 12.0) + 30.0, disc(13.0, 22.0, 60.0)).correlation > 0.95


def test_a_contact_elsewhere_or_none_is_not_alike() -> None:
    """Evidence is what an even picture gains: half the square of the believed disc about its mean, at known noise."""
    believed = disc(13.0, 22.0, 60.0)
    even = np.full(SHAPE, 25.0)
    none = compared(even, believed, prior=8.0)
    assert abs(none.correlation) < 0.2
    uneven = believed - believed.mean()
    # One view of four has lost four rows, in which nothing of the disc lies.
    assert none.evidence == pytest.approx(4.0 + 0.5 * 4 * float((uneven**2).sum()) / SD**2, rel=0.1)
    elsewhere = compared(disc(15.0, 6.0, 60.0), believed)
    assert elsewhere.correlation < 0.2


def test_shuffled_pixels_are_not_alike() -> None:
    picture = disc(13.0, 22.0, 60.0)
    order = np.random.default_rng(8).permutation(picture.size)
    assert abs(compared(picture.ravel()[order].reshape(SHAPE), picture).correlation) < 0.2


def test_light_put_out_by_the_fit_is_no_likeness() -> None:
    """The fit may explain frames without contact by no light at all; what was believed says that it is missing."""
    rng = np.random.default_rng(5)
    dark: Any = SimpleNamespace(
        data=rng.standard_normal((1, *SHAPE)), sd=np.ones((1, *SHAPE)), valid=np.ones((1, *SHAPE), bool), views=[0],
        kinds=[VIEWS[0]], unwhitened=lambda row: row.reshape(1, *SHAPE),
    )  # fmt: skip
    residual = dark.data.ravel()
    fitted: Any = SimpleNamespace(residual=residual, misfit=float(residual @ residual) + 9.0)
    found = likeness_of(dark, fitted, disc(13.0, 22.0, 60.0)[None])
    assert found.correlation == 0.0
    assert found.evidence == pytest.approx(4.5, abs=1.0)


def test_nothing_to_compare_is_no_objection() -> None:
    """A believed contact that is lost in the noise, or no press frames, cannot be missing."""
    assert compared(disc(13.0, 22.0, 0.3), disc(13.0, 22.0, 0.3)).correlation == 1.0
