"""A plain slip detector of any data set: gradient boosting on features of its frames, trained on its training split.

Its predictions are a file that :mod:`evanesce.dataset.score` judges, as any detector's.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.extras import require
from evanesce.core.files import write_text
from evanesce.dataset.read import Dataset
from evanesce.dataset.score import COLUMNS, Prediction, SplitScore, score
from evanesce.dataset.slip_features import frame_features
from evanesce.dataset.slip_scores import Series, choose_threshold

Floats = NDArray[np.float64]

FALSE_ALARMS = 4.0
"""Budget in training [1/min]."""
HOLD = 2
"""Consecutive frames above the threshold that an alarm needs."""
LEAST_TRIALS = 4
"""Of the training split."""


@dataclass(frozen=True)
class Baseline:
    """A trained detector's outcome.

    Attributes
    ----------
    predictions : dict
        Of every frame, by key; ``slip`` is 1 less the predicted stick ratio.
    threshold : float
        Of ``slip``.
    scores : list of SplitScore
    constant_error : float
        Mean error of the stick ratio in the test split, were the training's mean predicted [1]; NaN without a test.
    """

    predictions: dict[str, Prediction]
    threshold: float
    scores: list[SplitScore]
    constant_error: float


@dataclass
class _Trial:
    keys: list[str]
    split: str
    rig: int
    features: Floats
    series: Series
    held: NDArray[np.bool_]


def baseline(folder: Path, *, advance: Callable[[int], None] = lambda _: None) -> Baseline:
    """Train on a data set's training split and score on all.

    Parameters
    ----------
    folder : Path
    advance : callable
        Called with the number of frames read since the last call.

    Returns
    -------
    Baseline

    Raises
    ------
    InputError
        If the training split has fewer than :data:`LEAST_TRIALS` trials, or scikit-learn is missing.

    Notes
    -----
    The threshold is chosen for :data:`FALSE_ALARMS` on training trials that the model was not fitted to: rig by rig,
    where there are several, else trial by trial.
    """
    require("baseline", "a baseline")
    from sklearn.ensemble import HistGradientBoostingRegressor
    from sklearn.model_selection import GroupKFold, cross_val_predict

    trials = _read(folder, advance)
    known = [trial for trial in trials if trial.split == "train"]
    if len(known) < LEAST_TRIALS:
        raise InputError(
            f"{len(known)} trials in the training split", file=folder, allowed=f"at least {LEAST_TRIALS}: a larger --n"
        )
    model = HistGradientBoostingRegressor(max_iter=200, learning_rate=0.06, max_leaf_nodes=15, random_state=0)
    x, y = np.concatenate([t.features for t in known]), np.concatenate([t.series.stick_ratio for t in known])
    groups = np.concatenate([np.full(len(t.keys), t.rig) for t in known])
    if len(np.unique(groups)) < 2:
        groups = np.concatenate([np.full(len(t.keys), k) for k, t in enumerate(known)])
    folds = GroupKFold(min(5, len(np.unique(groups))))
    held_out = 1.0 - cross_val_predict(model, x, y, groups=groups, cv=folds)
    ends = np.cumsum([len(t.keys) for t in known])[:-1]
    series = [
        Series(t.series.time, evidence, t.series.stick_ratio, t.series.onset_first, t.series.onset_gross)
        for t, evidence in zip(known, np.split(held_out, ends), strict=True)
    ]
    threshold = choose_threshold(series, FALSE_ALARMS, HOLD)
    model.fit(x, y)
    found: dict[str, Prediction] = {}
    for trial in trials:
        stick = np.clip(model.predict(trial.features), 0.0, 1.0)
        found |= {key: Prediction(1.0 - float(s), float(s)) for key, s in zip(trial.keys, stick, strict=True)}
    test = [t.series.stick_ratio[t.held] for t in trials if t.split == "test"]
    constant = float(np.abs(np.concatenate(test) - y.mean()).mean()) if test else math.nan
    return Baseline(found, threshold, score(folder, found, threshold=threshold, hold=HOLD), constant)


def _read(folder: Path, advance: Callable[[int], None]) -> list[_Trial]:
    found = []
    with Dataset(folder) as data:
        rate = data.job.config.trial.frame_rate_hz
        for indices in data.trials().values():
            samples = [data[i] for i in indices]
            meta = samples[0].meta
            onsets = (math.nan if meta[n] is None else meta[n] for n in ("onset_first_slip_s", "onset_gross_slip_s"))
            numbers: dict[str, Any] = {
                name: np.array([s.scalars[name] for s in samples]) for name in ("time_s", "stick_ratio", "Fz_N")
            }
            series = Series(numbers["time_s"], np.zeros(len(samples)), numbers["stick_ratio"], *onsets)
            features = frame_features([s.frame for s in samples], rate)
            keys = [s.key for s in samples]
            rig = int(meta["rig"]["index"])
            found.append(_Trial(keys, meta["split"], rig, features, series, numbers["Fz_N"] > 0.0))
            advance(len(samples))
    return found


def write_predictions(path: Path, predictions: dict[str, Prediction]) -> None:
    """Write predictions as the CSV that ``evanesce dataset score`` reads, atomically."""
    lines = [COLUMNS, *((key, f"{p.slip:.6f}", f"{p.stick_ratio:.6f}") for key, p in sorted(predictions.items()))]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    write_text(path, text.getvalue())
