"""The answer of a photograph, in the form of :mod:`evanesce.inference.answer`, and its gain on held-out blocks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from evanesce.core.rng import generator
from evanesce.effects import all_effects
from evanesce.inference.answer import unfitted, verdict_of, warnings_of
from evanesce.inference.consequence import NINETY
from evanesce.inference.gate import VERSION
from evanesce.inference.named import scaled, widened_covariance
from evanesce.inference.naming import told_of
from evanesce.inference.photograph.causes import ABSORBED
from evanesce.inference.photograph.critic import PhotoCriticism
from evanesce.inference.photograph.light import UNEVEN
from evanesce.inference.photograph.model import FREEDOM
from evanesce.inference.single_effects import UNKNOWN
from evanesce.prediction.parameters import value_of
from evanesce.prediction.scores import bootstrap_sum, rmse

Array = NDArray[Any]

BOOTSTRAPS = 2000
LIGHT = frozenset({"ambient_light", UNEVEN, "vignetting"})
POINTS = frozenset({"hot_pixels", "sensor_dust", "specks"})
MIRRORED = frozenset({"led_edge_reflections", "residue_film", UNKNOWN})
SHOTS = (
    (LIGHT, "The same target, once turned by 180 degrees in its plane and once with the camera turned by 180 degrees "
     "about its axis: what turns with the target is paper and print, what turns with the camera is the lens, what "
     "stays is the illumination."),
    (POINTS, "The plate wiped and photographed again, and a frame with the lens capped: specks go with the cloth, hot "
     "pixels stay under the cap."),
    (MIRRORED, "The same target with the LEDs off under another lamp: reflections of the edge LEDs vanish, a film of "
     "residue stays where it is."),
)  # fmt: skip


def answer(found: PhotoCriticism) -> dict[str, Any]:
    """Return the result: see docs/criticism/photograph.md.

    Parameters
    ----------
    found : PhotoCriticism
    """
    best, search, one = found.best, found.search, found.bench.photograph
    noise = float(best.residual.size)
    explained = 1.0 - search.share(max(best.misfit - search.floor, 0.0))
    verdict = verdict_of(found.posterior, found.left.found)
    causes = [*_smooth(found), *_points(found)]
    gain = held_out(found)
    return {
        "version": VERSION,
        "method": "photograph",
        "verdict": verdict,
        "first_line": first_line(verdict, causes, explained, found, gain),
        "warnings": [
            *warnings_of(verdict, bool(causes), replicates=True),
            "one photograph: its noise is read off even print, its geometry off the corners of the open blocks",
        ],
        "causes": causes,
        "posterior": found.posterior.as_dict(),
        "unknown": {**found.left.as_dict(), "what": told_left(found) if found.left.found else ""},
        "misfit": {
            "before": search.first, "after": best.misfit, "bins": noise, "removed_share": explained,
            "left_share": 1.0 - explained,
        },
        "held_out": gain,
        "next_measurement": shots(found),
        "nuisances": {name: value for name, value in best.point.items() if name.startswith("@")},
        "moves": [vars(step) for step in search.steps],
        "not_judged": [
            {"id": name, "why": why} for name, why in {**ABSORBED, **_not_tried(), **search.not_taken}.items()
        ],
        "noise_DN": found.bench.noise_DN,
        "corner_error_px": one.corner_error_px * one.bin_px,
        "bin_px": one.bin_px,
        "seconds": found.seconds,
    }  # fmt: skip


def _not_tried() -> dict[str, str]:
    here = {"ambient_light", "black_level", "defocus", "led_edge_reflections", "residue_film", "tone_curve"}
    here |= {"vignetting", "distortion_drift", "plate_tilt"} | POINTS
    return {name: "needs a press, time or another shot" for name in all_effects() if name not in here}


def _smooth(found: PhotoCriticism) -> list[dict[str, Any]]:
    """Return the fitted causes, those that take most of the misfit first."""
    best, search = found.best, found.search
    tied = search.judge.discrepancy.every_row(best)
    covariance = widened_covariance(best, tied) * scaled(best.metric, best.residual)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    rows = []
    for taken in best.taken:
        numbers = {}
        for k in best.of_cause(taken.id):
            p = best.parameters[k]
            value, (low, high) = value_of(best.point, p), p.bounds
            ends = max(value - NINETY * deviation[k], low), min(value + NINETY * deviation[k], high)
            numbers[p.name.partition(":")[2]] = {"value": value, "lo": ends[0], "hi": ends[1], "unit": p.unit}
        place = found.posterior.places[taken.id]
        rows.append(
            _cause(taken.id, place.probability.get(taken.id, 0.0), place.credible_set, numbers)
            | {"misfit_share": search.share(search.lost(best, taken.id))}
        )
    return sorted(rows, key=lambda row: -float(row["misfit_share"]))


def _points(found: PhotoCriticism) -> list[dict[str, Any]]:
    """Return the causes of points, with their number and, of specks, their light."""
    one, scan = found.bench.photograph, found.scans[0]
    per_mm2 = one.scene.camera.scale_px_per_mm**2
    rows = []
    for name, (value, low, high) in found.points.density.items():
        scale = 100.0 * per_mm2 if name == "specks" else 1.0
        unit = "1/cm^2" if name == "specks" else "1/bin"
        label = "per_cm2" if name == "specks" else "share_of_bins"
        numbers = {label: {"value": value * scale, "lo": low * scale, "hi": high * scale, "unit": unit}}
        amount = np.sort(np.abs(scan.amount[name][found.points.held[name]]))
        if amount.size:
            n = amount.size
            ends = [int(stats.binom.ppf(q, n, 0.5)) for q in (0.05, 0.95)]
            middle, lo, hi = (float(amount[min(k, n - 1)]) for k in (n // 2, *ends))
            numbers["median_level_DN"] = {"value": middle, "lo": lo, "hi": hi, "unit": "DN bins"}
        place = found.posterior.places[name]
        rows.append(_cause(name, place.probability[name], place.credible_set, numbers) | {"misfit_share": None})
    return rows


def _cause(name: str, probability: float, credible: tuple[str, ...], numbers: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "id": name, "told": told_of(name, credible), "parameters": dict(numbers), "probability": probability,
        "credible_set": list(credible),
    }  # fmt: skip


def held_out(found: PhotoCriticism) -> dict[str, Any]:
    """Return the gain on the held-out blocks: log score with its 95 % interval over blocks, residual, and each cause's.

    Residuals follow a Student t law whose scale is fitted to the open blocks, for each model its own: a poor model is
    then not judged by a noise that it does not have, which makes every gain smaller.
    """
    one = found.bench.photograph
    names, block = np.unique(one.block[one.locked & (one.block >= 0)], return_inverse=True)
    where = one.locked & (one.block >= 0)

    def scores(point: Mapping[str, float], points: bool) -> Array:
        return np.bincount(block, weights=log_density(found, point, points)[where], minlength=len(names))

    pointed = bool(found.points.density)
    before, after = scores(found.base.point, False), scores(found.best.point, pointed)

    def gained(difference: Array) -> list[float]:
        drawn = generator(0, "photograph", "bootstrap")
        # One view whose blocks are drawn anew.
        return list(bootstrap_sum(difference[None], level=0.95, count=BOOTSTRAPS, rng=drawn))

    def rms(point: Mapping[str, float]) -> float:
        return rmse(one.data[where], found.bench.light(point)[where])

    losses = {name: (point, pointed) for name, point in found.dropped.items()}
    losses |= {"points": (found.best.point, False)} if pointed else {}
    return {
        "log_score": gained(after - before),
        "rms_DN": [rms(found.base.point), rms(found.best.point)],
        "blocks": len(names),
        "bins": int(where.sum()),
        "without": {
            name: {"log_score_lost": gained(after - scores(point, with_points)), "rms_DN": rms(point)}
            for name, (point, with_points) in losses.items()
        },
    }


def log_density(found: PhotoCriticism, point: Mapping[str, float], points: bool) -> Array:
    """Return the log density of every bin (rows, cols) under a model [nats per DN].

    Parameters
    ----------
    found : PhotoCriticism
    point : mapping
    points : bool
        Whether bins may hold points: with the share and the mean height that the open blocks have.
    """
    one, bench = found.bench.photograph, found.bench
    residual = one.data - bench.light(point)
    scale = t_scale((residual / bench.sd)[one.opened])
    sd = scale * bench.sd
    density = stats.t.logpdf(residual / sd, FREEDOM) - np.log(sd)
    if not points:
        return np.asarray(density)
    for sign in (1.0, -1.0):
        if not any(sign == (-1.0 if name == "sensor_dust" else 1.0) for name in found.points.density):
            continue
        high = one.opened & (sign * bench.left > CUT * bench.sd)
        share, height = high.sum() / one.opened.sum(), float(np.mean(sign * residual[high])) if high.any() else 1.0
        tail = stats.expon.logpdf(sign * residual, scale=max(height, 1.0))
        density = np.logaddexp(np.log1p(-share) + density, np.log(max(share, 1e-9)) + tail)
    return np.asarray(density)


CUT = 5.0
"""Standard deviations over its neighbourhood from which on a bin is counted as part of a point."""


def t_scale(plain: Array) -> float:
    """Return the scale of a Student t law of :data:`FREEDOM` degrees for residuals (n,) over their noise."""
    scale = max(1.4826 * float(np.median(np.abs(plain))), 0.2)
    for _ in range(20):
        weight = (FREEDOM + 1.0) / (FREEDOM + (plain / scale) ** 2)
        scale = float(np.sqrt((weight * plain**2).mean()))
    return scale


def shots(found: PhotoCriticism) -> list[dict[str, Any]]:
    """Return the shots that separate what one frame cannot."""
    ids = {*found.posterior.places, *([UNKNOWN] if found.left.found else [])}
    return [{"what": what, "separates": sorted(which)} for which, what in SHOTS if ids & which]


def told_left(found: PhotoCriticism) -> str:
    """Return what is left, and where its middle is on the plate."""
    x, y = found.left.place_mm
    told = found.left.sentence().replace(" in all views", "")
    return f"{told}, about ({x:+.1f}, {y:+.1f}) mm from the frame's middle"


def first_line(
    verdict: str, causes: list[dict[str, Any]], explained: float, found: PhotoCriticism, gain: Mapping[str, Any]
) -> str:
    """Return the sentence that a reader needs if they read no other."""
    if verdict == "none":
        return "The photograph is what the simulation predicts, as far as its noise lets anything be seen."
    unknown = told_left(found) if found.left.found else "something that no cause of the library makes"
    if not causes:
        return f"There is {unknown if 'unknown' in verdict else unfitted(found.posterior.further)}."
    more = f". Beside them there is {unknown}" if "unknown" in verdict else ""
    score, rms = gain["log_score"], gain["rms_DN"]
    caution = "CAUTION: the extension predicts held-out blocks worse. " if score[0] < 0 else ""
    return (
        f"{caution}{len(causes)} cause{'s' if len(causes) > 1 else ''} ({100 * explained:.1f} % of the misfit): "
        f"{', '.join(c['told'] for c in causes)}; on held-out blocks {score[0]:+.0f} nats, "
        f"{rms[0]:.1f} to {rms[1]:.1f} DN RMS{more}."
    )
