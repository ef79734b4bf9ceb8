"""Tests of a fitted model, and the search that extends it cause by cause."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from evanesce.core.errors import InputError
from evanesce.criticism.answer import Findings
from evanesce.criticism.battery import BatteryResult, run_battery
from evanesce.criticism.battery_data import Residuals
from evanesce.criticism.case import Case
from evanesce.criticism.extend import Extension, extend
from evanesce.criticism.isolability import confusion, group_of
from evanesce.criticism.posterior import Posterior, posterior
from evanesce.criticism.problem import Fit, Problem
from evanesce.criticism.renew import change_of, is_loud, renewed, undecided
from evanesce.criticism.residuals import noise_draws, residuals_of
from evanesce.criticism.score import Scored, ScoreTest, score_test
from evanesce.criticism.signatures import Signature
from evanesce.prediction.frozen import FROZEN


def test(case: Case, signatures: Sequence[Signature], base: Fit, number: int) -> ScoreTest:
    """Score all candidates against a fitted model."""
    draws = int(FROZEN.levels["draws_score"])
    return score_test(case.problem, base, signatures, draws=draws, rng=case.rng("score", number))


def ring(case: Case, fitted: Fit, number: int) -> tuple[BatteryResult, Residuals]:
    """Run the battery on what a fitted model leaves."""
    left = residuals_of(case.problem, fitted)
    draws = int(FROZEN.levels["draws_battery"])
    return run_battery(left, noise_draws(case.problem, fitted, draws, case.rng("battery", number))), left


def joint_p(score_p: float, battery_p: float, *, codec: bool = False) -> float:
    """Return the probability of either test ringing, its level shared between them (Bonferroni, weighted).

    What a codec makes of a frame has structure of any kind, so that the battery says nothing there.
    """
    if codec:
        return score_p
    share = FROZEN.levels["score_share"]
    return min(1.0, score_p / share, battery_p / (1 - share))


def search(case: Case, signatures: Sequence[Signature], findings: Findings) -> None:
    """Extend the model step by step, each step by the best of the candidates that were fitted for good."""
    base, known, scores = case.base, None, findings.first
    problem = case.problem
    for number in range(int(FROZEN.search["rounds"])):
        tried = [s for s in scores.scored if known is None or s.id not in known.ids]
        extensions = renewed(case, problem, base, known, fitted_for_good(case, problem, base, known, tried))
        findings.rounds.append(extensions)
        better = max(extensions, key=lambda e: e.log_bayes, default=None)
        if better is None or not acceptable(better, known, len(scores.scored)):
            break
        known, base, problem = better, better.fitted, better.problem
        findings.best = known
        left_scores = test(case, [s for s in signatures if s.id not in known.ids], base, number + 1)
        battery, left = ring(case, base, number + 1)
        findings.after, findings.left = battery, left
        findings.left_p = joint_p(left_scores.p, battery.global_p, codec=case.codec)
        if left_scores.p >= findings.level:
            break
        scores = left_scores


def fitted_for_good(
    case: Case, problem: Problem, base: Fit, known: Extension | None, tried: Sequence[Scored]
) -> list[tuple[Scored, Extension]]:
    """Return the fits of the candidates that are worth one: the best few, and all that come near the best.

    By linear evidence one comes near, and by what the best fit so far has kept of it where that is less: a cause that
    bends away from its straight line must not keep those from being tried that do not. Where it is loud, one also comes
    near that the quick prediction may have misjudged. One whose fit leaves what its effect allows is left out, with a
    note.
    """
    few, most = int(FROZEN.search["always"]), int(FROZEN.search["refine"])
    before = 0.0 if known is None else known.log_bayes
    found: list[tuple[Scored, Extension]] = []
    ahead = sorted(tried, key=lambda s: -s.result.log_bayes)[:most]
    while ahead:
        # Of those that can be fitted: one that cannot sets no bar.
        best = max(s.result.log_bayes for s in [*(s for s, _ in found), *ahead])
        best = min(best, max((e.log_bayes - before for _, e in found), default=np.inf))
        scored = ahead.pop(0)
        own = scored.result.log_bayes
        near = own > least_near(best) or (is_loud(best) and own + undecided(change_of(scored)) > best)
        if len(found) >= few and not near:
            continue
        try:
            found.append((scored, extend(problem, base, known, scored)))
        except InputError as error:
            case.notes.append(f"{scored.id} could not be fitted: {error}")
    return found


def least_near(best: float) -> float:
    """Return the evidence from which on a candidate comes near the best one's [nats]."""
    return best - max(FROZEN.search["near_nats"], FROZEN.search["near_share"] * best)


def acceptable(extension: Extension, known: Extension | None, library: int) -> bool:
    """Tell whether an extension may be built upon: it predicts the unseen, is worth its prior, and is possible.

    A further cause has to bring a share of what the first ones did (``second_share``).

    Parameters
    ----------
    extension : Extension
    known : Extension, optional
        What it was built upon; None for the believed rig.
    library : int
        How many effects could have been named.
    """
    gained = extension.gain > FROZEN.levels["accept_gain_se"] * extension.gain_error
    before = {} if known is None else {known.ids: known.log_bayes}
    models = {**before, extension.ids: extension.log_bayes}
    odds = log_odds(posterior(models, library), extension.ids, tuple(before)[-1:])
    # What a cause named already leaves is first of all its own form, which no library knows to a few per cent.
    over = 0.0 if known is None else FROZEN.levels["second_share"] * known.log_bayes
    worth = extension.log_bayes - (0.0 if known is None else known.log_bayes) > over
    return gained and worth and odds > FROZEN.levels["accept_nats"] and extension.possible


def log_odds(found: Posterior, ids: tuple[str, ...], against: tuple[tuple[str, ...], ...]) -> float:
    """Return the logarithm of the odds of a model against another one, the believed rig by default."""
    other = against[0] if against else ()
    return float(np.log(max(found.models[ids], 1e-300)) - np.log(max(found.models[other], 1e-300)))


def rivals(fitted: Sequence[Extension], ids: tuple[str, ...], metric: Any) -> list[Extension]:
    """Return what a cause that was accepted could be mistaken for, of those that were fitted in the same step."""
    number = next(k for k, e in enumerate(fitted) if e.ids == ids)
    levels, best = FROZEN.levels, fitted[number]
    near = set(group_of(number, confusion([e.cause for e in fitted], metric), levels["ambiguous_lambda"]))

    def comes_near(k: int, other: Extension) -> bool:
        # Of two that draw the same picture, one that has more parameters to do so is no less likely to have drawn it.
        alike = k in near and other.improved > best.improved - levels["ambiguous_nats"]
        return alike or other.log_bayes > best.log_bayes - levels["ambiguous_nats" if k in near else "rival_nats"]

    return [e for k, e in enumerate(fitted) if k != number and e.possible and comes_near(k, e)]


def rivals_without_best(findings: Findings) -> list[Extension]:
    """Return the causes that come nearest where none was worth its prior."""
    least = FROZEN.levels["least_nats"]
    fitted = [e for e in (findings.rounds[0] if findings.rounds else []) if e.possible and e.log_bayes > least]
    best = max((e.log_bayes for e in fitted), default=0.0)
    return sorted((e for e in fitted if e.log_bayes > best - FROZEN.levels["rival_nats"]), key=lambda e: -e.log_bayes)
