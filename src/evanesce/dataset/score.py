"""Score anybody's predictions against a data set: onset of slip, false alarms, stick ratio, by split."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.dataset.design import SPLITS
from evanesce.dataset.layout import frame_key
from evanesce.dataset.read import Dataset
from evanesce.dataset.slip_scores import STICKING, Series, slips, sorted_alarms

Floats = NDArray[np.float64]

COLUMNS = ("key", "slip", "stick_ratio")
MAX_BYTES = 2_000_000_000


@dataclass(frozen=True)
class Prediction:
    """What a detector says of one frame; NaN where it says nothing."""

    slip: float = math.nan
    stick_ratio: float = math.nan


@dataclass(frozen=True)
class SplitScore:
    """Scores on the trials of one split.

    Attributes
    ----------
    split : str
    trials, slips : int
        Trials, and how often slip begins in them.
    found : int
        Of those slips, with an alarm.
    onset_bias_ms, onset_error_ms : float
        Median, and mean magnitude, of alarm less begin of slip, over the slips found [ms].
    false_per_minute : float
        False alarms (:func:`~evanesce.dataset.slip_scores.sorted_alarms`) per minute of frames without slip [1/min].
    minutes : float
        Their duration [min].
    stick_ratio_error, stick_ratio_se : float
        Mean magnitude of the error over held frames, and its standard error over trials [1].
    """

    split: str
    trials: int
    slips: int
    found: int
    onset_bias_ms: float
    onset_error_ms: float
    false_per_minute: float
    minutes: float
    stick_ratio_error: float
    stick_ratio_se: float

    def as_dict(self) -> dict[str, Any]:
        """Return JSON-able data; NaN is None."""
        return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in asdict(self).items()}


def read_predictions(path: Path) -> dict[str, Prediction]:
    """Read predictions: CSV with the columns ``key`` and ``slip``, ``stick_ratio``, or both.

    Parameters
    ----------
    path : Path
        ``key`` is the frame's key or number; ``slip`` grows with the evidence of slip.

    Returns
    -------
    dict
        By key.

    Raises
    ------
    InputError
        Naming the line and what is allowed there.
    """
    if not path.is_file():
        raise InputError("no such file", file=path, allowed=f"a CSV file with columns {', '.join(COLUMNS)}")
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_BYTES}")
    found: dict[str, Prediction] = {}
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            rows = csv.DictReader(stream, strict=True)
            names = rows.fieldnames or ()
            if "key" not in names or len(names) < 2 or set(names) - set(COLUMNS) or len(set(names)) < len(names):
                raise InputError(
                    f"columns {', '.join(names) or 'none'}", file=path, key="line 1",
                    allowed="key, and slip or stick_ratio or both",
                )  # fmt: skip
            for row in rows:
                _add(found, row, names, path, f"line {rows.line_num}")
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"not a CSV file: {error}", file=path) from None
    if not found:
        raise InputError("no predictions", file=path, allowed="at least one line")
    return found


def _add(found: dict[str, Prediction], row: dict[str, Any], names: Sequence[str], path: Path, line: str) -> None:
    key = row["key"]
    if None in row or not isinstance(key, str) or not key.isdigit() or len(key) > 9 or not key.isascii():
        raise InputError(f"key {key!r}", file=path, key=line, allowed="a frame's key, and a value for each column")
    values = {}
    for name in names:
        if name == "key":
            continue
        try:
            value = float(row[name])
        except (TypeError, ValueError):
            value = math.nan
        if not math.isfinite(value) or (name == "stick_ratio" and not 0.0 <= value <= 1.0):
            allowed = "0 to 1" if name == "stick_ratio" else "a number"
            raise InputError(f"{name} {row[name]!r}", file=path, key=line, allowed=allowed)
        values[name] = value
    key = frame_key(int(key))
    if key in found:
        raise InputError(f"a second prediction of {key}", file=path, key=line, allowed="one of each frame")
    found[key] = Prediction(**values)


def score(
    folder: Path, predictions: dict[str, Prediction], *, threshold: float | None = None, hold: int = 1,
    file: Path | None = None,
) -> list[SplitScore]:  # fmt: skip
    """Score predictions of whole trials.

    Parameters
    ----------
    folder : Path
    predictions : dict
        By key. Trials without any are left out.
    threshold : float, optional
        An alarm is raised where ``slip`` exceeds it; by default 0.5, and where there is only a stick ratio, where that
        falls below 0.95.
    hold : int
        Consecutive frames above the threshold that an alarm needs.
    file : Path, optional
        Of the predictions, for errors.

    Returns
    -------
    list of SplitScore
        Of each split that has predictions, and ``all``.

    Raises
    ------
    InputError
        If a key is none of the data set, or a trial is predicted in part.
    """
    if hold < 1:
        raise InputError(f"{hold}", key="--hold", allowed="1 or more")
    series: dict[str, list[tuple[Series, Floats, NDArray[np.bool_]]]] = {}
    with Dataset(folder) as data:
        known = {row["key"] for row in data.rows()}
        if unknown := sorted(predictions.keys() - known):
            raise InputError(f"{unknown[0]} is no frame of {folder}", file=file, key="key", allowed="its frames")
        for trial, indices in data.trials().items():
            samples = [data[i] for i in indices]
            given = [predictions.get(sample.key) for sample in samples]
            if not any(given):
                continue
            if None in given:
                raise InputError(
                    f"trial {trial}: no prediction of frame {samples[given.index(None)].key}", file=file, key="key",
                    allowed="all frames of a trial, or none",
                )  # fmt: skip
            said = [p for p in given if p is not None]
            meta = samples[0].meta
            stick = np.array([p.stick_ratio for p in said])
            slip = np.array([p.slip for p in said])
            evidence = slip if np.isfinite(slip).all() else 1.0 - stick
            level = threshold if threshold is not None else 0.5 if evidence is slip else 1.0 - STICKING
            truth = np.array([s.scalars["stick_ratio"] for s in samples])
            one = Series(
                np.array([s.scalars["time_s"] for s in samples]), evidence - level, truth,
                *(math.nan if meta[n] is None else meta[n] for n in ("onset_first_slip_s", "onset_gross_slip_s")),
            )  # fmt: skip
            held = np.array([s.scalars["Fz_N"] > 0.0 for s in samples])
            series.setdefault(meta["split"], []).append((one, np.abs(stick - truth), held))
    rows = [_scored(split, series[split], hold) for split in SPLITS if split in series]
    return [*rows, _scored("all", [one for split in series.values() for one in split], hold)]


def _scored(split: str, trials: Sequence[tuple[Series, Floats, NDArray[np.bool_]]], hold: int) -> SplitScore:
    late, false, without_slip_s, count = [], 0, 0.0, 0
    for one, _, _ in trials:
        raised, wrong = sorted_alarms(one, 0.0, hold)
        sticking = one.stick_ratio >= STICKING
        without_slip_s += float(sticking.sum()) * float(np.median(np.diff(one.time)))
        false += wrong
        for number, ((begin, _), own) in enumerate(zip(slips(sticking), raised, strict=True)):
            count += 1
            known = number == 0 and math.isfinite(one.onset_first)
            onset = one.onset_first if known else float(one.time[begin])
            late += [float(one.time[i]) - onset for i in own[:1]]
    errors = [float(error[held].mean()) for _, error, held in trials if held.any()]
    spread = float(np.std(errors, ddof=1) / math.sqrt(len(errors))) if len(errors) > 1 else math.nan
    return SplitScore(
        split=split,
        trials=len(trials),
        slips=count,
        found=len(late),
        onset_bias_ms=1e3 * float(np.median(late)) if late else math.nan,
        onset_error_ms=1e3 * float(np.abs(late).mean()) if late else math.nan,
        false_per_minute=60.0 * false / without_slip_s if without_slip_s else math.nan,
        minutes=without_slip_s / 60.0,
        stick_ratio_error=float(np.mean(errors)) if errors else math.nan,
        stick_ratio_se=spread,
    )
