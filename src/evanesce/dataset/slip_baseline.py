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
FRICTION_BANDS, FOLDS = 3, 5
"""Parts that friction, and rigs or trials, are held out in."""


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
    friction: float
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
    The threshold is chosen for :data:`FALSE_ALARMS` on training trials of friction and rigs that the model was not
    fitted to.
    """
    require("baseline", "a baseline")
    from sklearn.ensemble import HistGradientBoostingRegressor

    trials = _read(folder, advance)
    known = [trial for trial in trials if trial.split == "train"]
    if len(known) < LEAST_TRIALS:
        raise InputError(
            f"{len(known)} trials in the training split", file=folder, allowed=f"at least {LEAST_TRIALS}: a larger --n"
        )
    model = HistGradientBoostingRegressor(max_iter=200, learning_rate=0.06, max_leaf_nodes=15, random_state=0)
    x, y = np.concatenate([t.features for t in known]), np.concatenate([t.series.stick_ratio for t in known])
    lengths = [len(t.keys) for t in known]
    friction = np.repeat([t.friction for t in known], lengths)
    rig, number = np.repeat([t.rig for t in known], lengths), np.repeat(np.arange(len(known)), lengths)
    evidence_held_out = 1.0 - held_out(model, x, y, friction, rig, number)
    ends = np.cumsum(lengths)[:-1]
    series = [
        Series(t.series.time, evidence, t.series.stick_ratio, t.series.onset_first, t.series.onset_gross)
        for t, evidence in zip(known, np.split(evidence_held_out, ends), strict=True)
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


def held_out(
    model: Any, x: Floats, y: Floats, friction: Floats, rig: NDArray[np.int64], trial: NDArray[np.int64]
) -> Floats:
    """Predict each frame by a model fitted to other friction and other rigs.

    Parameters
    ----------
    model : estimator
        Of scikit-learn; fitted anew.
    x : ndarray (n, k)
        Features of the frames.
    y : ndarray (n,)
        Stick ratio.
    friction : ndarray (n,)
        Coefficient of friction of the frame's trial; held out in :data:`FRICTION_BANDS` bands.
    rig, trial : ndarray (n,)
        Their numbers. Rigs are held out in up to :data:`FOLDS` folds, trials where there is one rig only.

    Returns
    -------
    ndarray (n,)
        Predictions.
    """
    groups = np.unique(rig if len(np.unique(rig)) > 1 else trial, return_inverse=True)[1]
    fold = groups % min(FOLDS, int(groups.max()) + 1)
    levels = np.unique(friction)
    band = np.searchsorted(np.quantile(levels, np.linspace(0.0, 1.0, FRICTION_BANDS + 1)[1:-1]), friction)
    found = np.full(len(y), float(y.mean()))
    for a in np.unique(fold):
        for b in np.unique(band):
            asked = (fold == a) & (band == b)
            given = (fold != a) & (band != b)
            if not given.any():  # one friction level, or each rig has its own
                given = fold != a
            if asked.any() and given.any():
                found[asked] = model.fit(x[given], y[given]).predict(x[asked])
    return found


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
            friction = float(meta["friction"]["friction_coefficient"])
            found.append(_Trial(keys, meta["split"], rig, features, friction, series, numbers["Fz_N"] > 0.0))
            advance(len(samples))
    return found


def write_predictions(path: Path, predictions: dict[str, Prediction]) -> None:
    """Write predictions as the CSV that ``evanesce dataset score`` reads, atomically."""
    lines = [COLUMNS, *((key, f"{p.slip:.6f}", f"{p.stick_ratio:.6f}") for key, p in sorted(predictions.items()))]
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(lines)
    write_text(path, text.getvalue())
