"""Areas of Silskin 20 % from the thesis beside the nominal model and beside single causes fitted to them.

Run: python docs/validation/criticism_thesis.py BUNDLE PICTURE [--other BUNDLE] (some minutes)
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from evanesce.bundle import Series, read_bundle
from evanesce.effects import all_effects
from evanesce.inference.causes import causes_of
from evanesce.inference.joint import Fitter
from evanesce.inference.joint_fit import Taken
from evanesce.inference.series.critic import observation_of
from evanesce.inference.series.model import SeriesModel
from evanesce.inference.series.predict import Point, SeriesPredictor
from evanesce.inference.series.rows import rows_of

OTHER_N = 5.0  # the force at which the thesis compares its fingers
SHOWN = ("lateral_glow", "led_edge_reflections", "modulus", "creep")
COLOURS = ("tab:blue", "tab:cyan", "tab:red", "tab:orange")


def show_other(path: Path, series: Series, cause: str, point: Point) -> None:
    """Print what a cause, as fitted to one finger's areas, makes of another's at ``OTHER_N``, its light as believed."""
    asked = replace(series, x=np.array([OTHER_N]), y=np.ones(1), sigma=None)
    predictor = SeriesPredictor(read_bundle(path).scene, fine=True)
    for told, values in (("nominal model", {}), (cause, point)):
        print(f"{path.name} at {OTHER_N:g} N, {told}: {np.exp(predictor.log(asked, values))[0]:.1f} mm^2")


def main() -> None:
    """Fit, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bundle", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--other", type=Path, help="bundle of a finger that the first cause has to suit as well")
    given = parser.parse_args()
    bundle = read_bundle(given.bundle)
    rows, held_out, _ = rows_of(bundle.series)
    model = SeriesModel(observation_of(bundle), rows)
    fitter = Fitter(model)
    base = fitter.relinearised([], {})
    nominal = model.log(base.point)
    series, sd = rows.series[0], rows.sd
    light = base.point["@light"]
    print(f"nominal model: misfit {base.misfit:.1f} of {len(series)} rows at {sd[0]:.0%}; light {light:.2f}")
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    left.errorbar(series.x, series.y, yerr=sd * series.y, fmt="ko", ms=4, label="thesis")
    left.plot(held_out.series[0].x, held_out.series[0].y, "o", color="black", mfc="white", ms=4, label="held out")
    left.plot(series.x, np.exp(nominal), "k--", label="nominal model")
    right.plot(series.x, np.exp(rows.log_y - nominal), "k--", label="nominal model")
    causes, _ = causes_of(model.observation, set(all_effects()) - set(SHOWN))
    for name, colour in zip(SHOWN, COLOURS, strict=True):
        cause = next(c for c in causes if c.id == name)
        first = {p.name: float(np.clip(p.null + p.deviation, *p.bounds)) for p in cause.parameters}
        fits = []
        for start in cause.candidate.starts[:4] or (first,):
            model.anchor({**base.point, **start})
            metric = fitter.jitter_metric(base.point)
            fits.append(fitter.fitted([Taken(cause, cause.parameters)], {**base.point, **start}, metric=metric))
        best = min(fits, key=lambda f: f.misfit)
        found = fitter.relinearised(best.taken, best.point)
        predicted = model.log(found.point)
        off = np.exp(rows.log_y - predicted) - 1.0
        values = ", ".join(f"{p.name.partition(':')[2]} {found.point[p.name]:.3g} {p.unit}" for p in cause.parameters)
        spread = f"thesis over model {off.min():+.0%} to {off.max():+.0%}"
        print(f"{name}: misfit {found.misfit:.1f}; {values}; light {found.point['@light']:.2f}; {spread}")
        if given.other and name == SHOWN[0]:
            show_other(given.other, series, name, {p.name: found.point[p.name] for p in cause.parameters})
        left.plot(series.x, np.exp(predicted), color=colour, label=name)
        right.plot(series.x, np.exp(rows.log_y - predicted), "o-", ms=3, color=colour, label=name)
    right.fill_between(series.x, 1 - sd, 1 + sd, color="0.85")
    left.set(xlabel="normal force [N]", ylabel="area by the reference segmentation [mm$^2$]")
    right.set(xlabel="normal force [N]", ylabel="thesis over model [1]")
    left.legend(fontsize=8)
    figure.savefig(given.picture, dpi=110)


if __name__ == "__main__":
    main()
