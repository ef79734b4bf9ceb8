"""The photograph's story on one page: nominal fit, points, search, posterior, held-out blocks, answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.inference.constants import CERTAIN
from evanesce.inference.joint_fit import JointFit, Taken
from evanesce.inference.left import Left, left_of
from evanesce.inference.photograph.causes import PhotoForms, photo_causes
from evanesce.inference.photograph.light import LightModel
from evanesce.inference.photograph.model import (
    LOCAL_BINS,
    PhotoDiscrepancy,
    PhotoFitter,
    PhotoJudge,
    PhotoModel,
    PhotoSearch,
    even_print,
    local_residual,
    noise_of_print,
    photo_data,
    robust_sd,
)
from evanesce.inference.photograph.picture import Photograph
from evanesce.inference.photograph.points import Points, Scan, points_of, scan_of
from evanesce.inference.posterior import Posterior
from evanesce.inference.removal import everything_marginalised
from evanesce.inference.single_effects import Place
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.calibration.repeated import photographed_views
from evanesce.prediction.noise import Noise

Array = NDArray[Any]
Mask = NDArray[np.bool_]
Tell = Callable[[str], None]

PASSES = 2
"""Fits of everything: the second with noise, and the weight of what stands out, as the first one's model has them."""


@dataclass
class Bench:
    """A photograph's model with its noise, about one prediction.

    Attributes
    ----------
    photograph : Photograph
    light : LightModel
    mean : ndarray (rows, cols)
        Prediction about which noise and points are known [DN].
    sd : ndarray (rows, cols)
        Noise, and what edges may be off by [DN].
    fitter : PhotoFitter
    noise : Noise
    even : ndarray of bool (rows, cols)
    left : ndarray (rows, cols)
        Residual less its neighbourhood's level [DN].
    """

    photograph: Photograph
    light: LightModel
    mean: Array
    sd: Array
    fitter: PhotoFitter
    noise: Noise
    even: Mask
    left: Array

    @classmethod
    def about(cls, light: LightModel, point: Mapping[str, float]) -> Bench:
        """Measure noise and what stands out about a prediction."""
        one, mean = light.photograph, light(point)
        even = even_print(light, mean)
        noise, sd = noise_of_print(one, mean, even)
        left = local_residual(one.data - mean, one.block >= 0)
        # Points are judged by their own scan: what one of them adds near it says nothing of smooth light.
        scan = scan_of(left, sd, even, point["@blur"], point["@disc"])
        taken = np.zeros(mean.size, bool)
        for held in points_of(scan).held.values():
            taken[scan.where[held]] = True
        beside = ndimage.maximum_filter(taken.reshape(mean.shape), LOCAL_BINS)
        data = photo_data(one, noise, robust_sd(sd, left), beside)
        return cls(one, light, mean, sd, PhotoFitter(PhotoModel(light, data)), noise, even, left)

    def scan(self, point: Mapping[str, float], where: Mask) -> Scan:
        """Return the evidence of points in the even print of some blocks."""
        return scan_of(self.left, self.sd, self.even & where, point["@blur"], point["@disc"])

    @property
    def noise_DN(self) -> dict[str, float]:
        """Noise of a bin of dark and of bright even print."""
        tone, n = self.noise.tone, self.photograph.bin_px
        found = np.sqrt(self.noise.ratio * tone.variance_at(self.noise.levels)) / n
        return dict(zip(("dark", "bright"), map(float, found), strict=True))


@dataclass(frozen=True)
class PhotoCriticism:
    """What was found in a photograph.

    Attributes
    ----------
    bench : Bench
        About the extended model.
    search : PhotoSearch
    base, best : JointFit
        Nominal and extended.
    posterior : Posterior
        Causes of smooth light and points together.
    points : Points
        On the open blocks.
    scans : tuple of Scan
        Of open and of held-out blocks.
    left : Left
    dropped : dict of str to dict
        The point of each extension that lacks a cause, the rest refitted.
    seconds : float
    """

    bench: Bench
    search: PhotoSearch
    base: JointFit
    best: JointFit
    posterior: Posterior
    points: Points
    scans: tuple[Scan, Scan]
    left: Left
    dropped: Mapping[str, Mapping[str, float]]
    seconds: float


def criticise_photograph(photograph: Photograph, *, tell: Tell = lambda line: None) -> PhotoCriticism:
    """Find what the nominal model of a photographed board lacks, many causes at once.

    Parameters
    ----------
    photograph : Photograph
    tell : callable
        Told what is done.
    """
    began = time.monotonic()
    light, causes = LightModel(photograph), photo_causes(photograph)
    tell("nominal model and its nuisances")
    start = PhotoFitter.start_of(photograph)
    nominal = Bench.about(light, start).fitter.relinearised([], start)
    point: Mapping[str, float] = nominal.point
    taken: tuple[Taken, ...] = ()
    for number in range(PASSES):
        bench = Bench.about(light, point)
        fitter = bench.fitter
        base = fitter.relinearised([], nominal.point)
        bank = PhotoForms(light, base.point, fitter.model.data.views)
        judge = PhotoJudge(fitter, causes, bank, PhotoDiscrepancy(fitter.model))  # type: ignore[arg-type]
        search = PhotoSearch(fitter, causes, judge, tell)  # type: ignore[arg-type]
        if taken:
            search.warm = fitter.relinearised(taken, point)
        best, posterior = search.run(base)
        point = best.point
        if best.ids == tuple(t.id for t in taken):
            break
        taken = best.taken
        tell(f"pass {number + 1}: {', '.join(best.ids) or 'no cause of smooth light'}")
    tell("points, held-out blocks")
    bench_now = Bench.about(light, best.point)
    scans = tuple(bench_now.scan(best.point, where) for where in (photograph.opened, photograph.locked))
    points = points_of(scans[0])
    rest = everything_marginalised(best)[0].project(best.residual)
    mm = 1.0 / photograph.scene.camera.scale_px_per_mm
    left = left_of(fitter.model.data, rest, bank.seen.by_light, mm)
    dropped = {
        name: fitter.relinearised([t for t in best.taken if t.id != name], best.without(name)).point
        for name in best.ids
    }
    told = with_points(posterior, points).at_most(CERTAIN)
    return PhotoCriticism(
        bench_now, search, base, best, told, points, (scans[0], scans[1]), left, dropped,
        time.monotonic() - began,
    )  # fmt: skip


def with_points(posterior: Posterior, points: Points) -> Posterior:
    """Return the probabilities of all causes, those of points among them.

    Parameters
    ----------
    posterior : Posterior
    points : Points
    """
    found = {name: place for name, place in points.places.items() if name}
    more, further = points.places[""], posterior.further
    # Which of two kinds of further cause: their Bayes factors stand side by side over the same none.
    both = Place.of({**further.log_bayes, **more.log_bayes})
    return Posterior({**posterior.places, **found}, both, posterior.further_p)


def judged_views(bench: Bench, views: Sequence[BoardView]) -> dict[str, Any]:
    """Return whether the views of a calibration are one picture, by the noise that the photograph shows.

    Parameters
    ----------
    bench : Bench
    views : sequence of BoardView
    """
    one, camera = bench.photograph, bench.photograph.rig.camera
    rows, cols = one.full.shape
    focal = camera.lens.focal_length_mm * 1e3 / camera.pixel.pitch_um
    pixel = float(np.mean(list(bench.noise_DN.values()))) * one.bin_px
    return photographed_views(one.grid, (cols, rows), focal, views, pixel)
