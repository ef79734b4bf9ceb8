"""Search over designs with Optuna: trials in a SQLite file, so that an interrupted search resumes.

References
----------
T. Akiba, S. Sano, T. Yanase, T. Ohta and M. Koyama, "Optuna: a next-generation hyperparameter optimization framework",
KDD (2019) 2623, doi:10.1145/3292500.3330701.
S. Watanabe, "Tree-structured Parzen estimator", arXiv:2304.11127 (2023).
K. Deb, A. Pratap, S. Agarwal and T. Meyarivan, "A fast and elitist multiobjective genetic algorithm: NSGA-II", IEEE
Transactions on Evolutionary Computation 6 (2002) 182.
"""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from evanesce.core.errors import InputError, WorkError
from evanesce.core.extras import require
from evanesce.core.provenance import code_digest, digest
from evanesce.design.evaluate import evaluate, plain_job
from evanesce.design.parts import PartsTable
from evanesce.design.processes import Call, done_by
from evanesce.design.question import Design, Question
from evanesce.design.secondary import OBJECTIVES
from evanesce.design.variables import DesignVariable, value_of

if TYPE_CHECKING:
    import optuna

STORE = "trials.sqlite"
STUDY = "design"
SAMPLERS = ("tpe", "nsga2")
PENALTY = 1e9
"""Figure of an infeasible rig, which has none; its constraint marks it as infeasible."""


@dataclass(frozen=True)
class Limit:
    """Bound of an objective: an upper one, or a lower one where more is better."""

    name: str
    value: float

    def violation(self, figures: Mapping[str, float]) -> float:
        """Return by how much figures violate the limit, 0 or less where they do not; in the objective's unit."""
        over = figures[self.name] - self.value
        return over if OBJECTIVES[self.name].direction == "minimize" else -over


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A search over designs: what is varied, evaluated and optimised.

    Attributes
    ----------
    base : Design
    question : Question
    variables : tuple of DesignVariable
    objectives : tuple of str
    limits : tuple of Limit
    parts : PartsTable, optional
    sampler : {"tpe", "nsga2"}
    trials : int
        In all, those of earlier runs included.
    """

    base: Design
    question: Question
    variables: tuple[DesignVariable, ...]
    objectives: tuple[str, ...]
    limits: tuple[Limit, ...] = ()
    parts: PartsTable | None = None
    sampler: Literal["tpe", "nsga2"] = "tpe"
    trials: int = 200

    def __post_init__(self) -> None:
        if self.sampler not in SAMPLERS:
            raise InputError(f"{self.sampler!r}", key="search.sampler", allowed=", ".join(SAMPLERS))
        if not 1 <= self.trials <= 1_000_000:
            raise InputError(f"{self.trials}", key="search.trials", allowed="1 to 1000000")
        for key, names in (("objectives", self.objectives), ("limits", [limit.name for limit in self.limits])):
            for name in names:
                if name not in OBJECTIVES:
                    raise InputError(f"{name!r}", key=key, allowed=", ".join(OBJECTIVES))
                if name == "cost" and self.parts is None:
                    raise InputError("'cost' needs prices", key=key, allowed="with parts, a TOML table")
        if not self.objectives or len(set(self.objectives)) < len(self.objectives):
            raise InputError(f"{list(self.objectives)}", key="objectives", allowed="one or more, each once")

    @property
    def signature(self) -> str:
        """Digest of all but the number of trials, and of the code: only the same search by the same code resumes."""
        limits = [(limit.name, limit.value) for limit in self.limits]
        ranges = [vars(v) for v in self.variables]
        return digest([self.job, ranges, list(self.objectives), limits, self.sampler, code_digest()])

    @property
    def job(self) -> dict[str, Any]:
        """Input of every trial (:func:`~evanesce.design.evaluate.plain_job`)."""
        return plain_job(self.base, self.question, self.parts)


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One evaluated design.

    Attributes
    ----------
    number : int
    values : mapping
        Key -> value.
    figures : mapping
        Objective -> figure in its unit; empty where the rig is infeasible.
    standard_percent : float
        Standard error of the area error [%].
    reason : str
        Why the rig is infeasible; empty where it is not.
    violated : tuple of str
        Limits that it violates.
    """

    number: int
    values: Mapping[str, float]
    figures: Mapping[str, float] = field(default_factory=dict)
    standard_percent: float = math.nan
    reason: str = ""
    violated: tuple[str, ...] = ()

    @property
    def feasible(self) -> bool:
        """Whether it can be built and violates no limit."""
        return not self.reason and not self.violated


OnProgress = Callable[[int, int], None]


def run(
    plan: Plan, folder: Path, client: Any = None, on_progress: OnProgress = lambda done, total: None
) -> list[Trial]:
    """Search, or resume a search, until the folder holds ``plan.trials`` trials.

    Parameters
    ----------
    plan : Plan
    folder : Path
        Keeps the trials in :data:`STORE`.
    client : distributed.Client, optional
        Its workers evaluate designs in parallel; without it this process evaluates one after the other.
    on_progress : callable
        ``on_progress(done, total)``.

    Raises
    ------
    InputError
        If the folder holds another search.
    WorkError
        If the file cannot be read or written, or workers die repeatedly.
    """
    with _quiet(), _study(plan, folder) as study:
        _restart(study, plan)
        done = len(_finished(study))
        on_progress(done, plan.trials)
        for number, found in _evaluated(study, plan, client, plan.trials - done):
            _record(study, plan, number, found)
            done += 1
            on_progress(done, plan.trials)
        return trials_of(study, plan)


def read(plan: Plan, folder: Path) -> list[Trial]:
    """Return the trials of a folder."""
    with _quiet(), _study(plan, folder) as study:
        return trials_of(study, plan)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    require("design", "a search", "optuna")
    import optuna
    from sqlalchemy.exc import SQLAlchemyError

    level = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
            yield
    except (SQLAlchemyError, optuna.exceptions.StorageInternalError) as error:
        raise WorkError(f"{STORE}: {error}") from None
    finally:
        optuna.logging.set_verbosity(level)


@contextlib.contextmanager
def _study(plan: Plan, folder: Path) -> Iterator[optuna.Study]:
    """Yield the study of a folder, and close its store afterwards."""
    import optuna

    path = (folder / STORE).resolve()
    if path.exists() and path.read_bytes()[:16] not in (b"", b"SQLite format 3\0"):
        raise InputError("is not the store of a search", file=path, key="--out", allowed="a new folder")
    storage = optuna.storages.RDBStorage(f"sqlite:///{path}")
    try:
        study = _signed(plan, folder, storage)
        study.sampler = _sampler(plan, len(study.get_trials(deepcopy=False)))
        yield study
    finally:
        storage.remove_session()
        storage.engine.dispose()


def _sampler(plan: Plan, begun: int) -> optuna.samplers.BaseSampler:
    """Return the sampler of a study of ``begun`` trials; its seed depends on them, so that no design is drawn twice."""
    import optuna

    seed, few = plan.question.seed + begun, max(4, plan.trials // 5)
    if plan.sampler == "tpe":
        return optuna.samplers.TPESampler(seed=seed, multivariate=True, n_startup_trials=few)
    return optuna.samplers.NSGAIISampler(seed=seed, population_size=min(50, few))


def _signed(plan: Plan, folder: Path, storage: Any) -> optuna.Study:
    """Return the study of a store: a new one gets the signature, one of another search is refused."""
    import optuna

    study = optuna.create_study(
        storage=storage, study_name=STUDY, load_if_exists=True,
        directions=[OBJECTIVES[name].direction for name in plan.objectives],
    )  # fmt: skip
    kept = study.user_attrs.get("signature")
    if kept is None:
        study.set_user_attr("code", code_digest())
        study.set_user_attr("signature", plan.signature)
    elif study.user_attrs.get("code") != code_digest():
        raise InputError("holds a search by other code of evanesce", file=folder, key="--out", allowed="a new folder")
    elif kept != plan.signature:
        raise InputError("holds another search", file=folder, key="--out", allowed="a new folder, or the same question")
    return study


def _finished(study: optuna.Study) -> list[optuna.trial.FrozenTrial]:
    import optuna

    return study.get_trials(deepcopy=False, states=(optuna.trial.TrialState.COMPLETE,))


def _restart(study: optuna.Study, plan: Plan) -> None:
    """Enqueue the base first, and again the trials that an interrupted run had begun."""
    import optuna

    state = optuna.trial.TrialState
    for begun in study.get_trials(deepcopy=False, states=(state.RUNNING,)):
        study.tell(begun.number, state=state.FAIL)
        if begun.params:
            study.enqueue_trial(dict(begun.params))
    if not study.get_trials(deepcopy=False):
        own = {v.key: value_of(plan.base, v.key) for v in plan.variables}
        study.enqueue_trial({v.key: v.clip(x) for v in plan.variables if (x := own[v.key]) is not None})


def _ask(study: optuna.Study, plan: Plan) -> tuple[int, dict[str, float]]:
    trial = study.ask()
    values: dict[str, float] = {}
    for v in plan.variables:
        if v.whole:
            values[v.key] = trial.suggest_int(v.key, int(v.low), int(v.high), step=int(v.step or 1), log=v.log)
        else:
            values[v.key] = trial.suggest_float(v.key, v.low, v.high, step=v.step, log=v.log)
    return trial.number, values


def _record(study: optuna.Study, plan: Plan, number: int, found: Mapping[str, Any]) -> None:
    """Record a trial: figures and constraints first, so that a finished trial is complete."""
    import optuna

    trial = optuna.trial.Trial(study, study._storage.get_trial_id_from_study_id_trial_number(study._study_id, number))
    trial.set_user_attr("found", {key: value for key, value in found.items() if key != "figures"})
    figures = found.get("figures")
    trial.set_constraint("buildable", 1.0 if figures is None else -1.0)
    if figures is None:
        signs = [1 if OBJECTIVES[name].direction == "minimize" else -1 for name in plan.objectives]
        study.tell(number, [sign * PENALTY for sign in signs])
        return
    trial.set_user_attr("figures", {key: value for key, value in figures.items() if math.isfinite(value)})
    for limit in plan.limits:
        trial.set_constraint(limit.name, limit.violation(figures))
    study.tell(number, [figures[name] for name in plan.objectives])


def _evaluated(study: optuna.Study, plan: Plan, client: Any, count: int) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield number and outcome of ``count`` further trials."""
    job = plan.job
    if client is None:
        for _ in range(max(0, count)):
            number, values = _ask(study, plan)
            yield number, evaluate(job, values)
        return
    numbers: list[int] = []

    def calls() -> Iterator[Call]:
        for _ in range(count):
            number, values = _ask(study, plan)
            numbers.append(number)
            yield evaluate, (job, values), {}

    for k, found in done_by(client, calls()):
        yield numbers[k], found


def trials_of(study: optuna.Study, plan: Plan) -> list[Trial]:
    """Return the finished trials of a study."""
    rows = []
    for frozen in _finished(study):
        found, figures = frozen.user_attrs["found"], frozen.user_attrs.get("figures", {})
        rows.append(
            Trial(
                number=frozen.number, values=dict(frozen.params), figures=figures,
                standard_percent=float(found.get("standard_percent", math.nan)), reason=found.get("reason", ""),
                violated=tuple(limit.name for limit in plan.limits if figures and limit.violation(figures) > 0),
            )
        )  # fmt: skip
    return rows


def pareto(trials: Sequence[Trial], objectives: Sequence[str]) -> list[Trial]:
    """Return the feasible trials that no other dominates, by the first objective."""
    able = [t for t in trials if t.feasible]
    signs = [1.0 if OBJECTIVES[name].direction == "minimize" else -1.0 for name in objectives]
    points = [tuple(s * t.figures[name] for s, name in zip(signs, objectives, strict=True)) for t in able]

    def dominated(point: tuple[float, ...]) -> bool:
        return any(all(o <= p for o, p in zip(other, point, strict=True)) and other != point for other in points)

    front, seen = [], set()
    for trial, point in zip(able, points, strict=True):
        if not dominated(point) and point not in seen:
            front.append(trial)
            seen.add(point)
    return sorted(front, key=lambda t: signs[0] * t.figures[objectives[0]])
