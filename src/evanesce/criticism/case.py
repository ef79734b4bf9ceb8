"""A case: the believed rig fitted to one bundle's open part, before anything is tested."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.rng import generator
from evanesce.criticism.bands import with_bands
from evanesce.criticism.codec import codec_parameters, codec_variance, noise_by_bins
from evanesce.criticism.likeness import Likeness, likeness_of
from evanesce.criticism.marks import with_places, without_places
from evanesce.criticism.numerics import edge_template, leftover_variance, numerics_parameters, quick_variance
from evanesce.criticism.problem import Fit, Problem, derivatives, fit, predicted_part, stepped
from evanesce.prediction.candidates import Candidate, candidates_of
from evanesce.prediction.fine import FineFrames
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.noise import noise_of
from evanesce.prediction.noise_scale import LOOSE, NoiseScale, noise_scale_of
from evanesce.prediction.nuisance import nuisance_parameters
from evanesce.prediction.observe import Observation, model_factor
from evanesce.prediction.parameters import Parameter, derivative
from evanesce.prediction.predict import Point, Predictor
from evanesce.prediction.recoded import Codec, Shooting, codec_of, recoded
from evanesce.prediction.tone import expected_tone

Array = NDArray[Any]

ROUNDS = 20
"""Of the believed rig's fits: where the light is far off, the tone curve's bend leaves only short steps."""

QUIET = 0.9
"""Real over modelled noise below which a codec is possible where no dark level speaks for or against it."""

PLACES = 3
"""The fine prediction is made at so many points at most."""

ROUGH = 0.2
"""Share of a contact's displacement by which the quick prediction's derivatives may be off."""

ROUGH_LEFT = 10.0
"""Square of what they may be off by, over the noise's, that asks for a fine prediction at the new place."""

FAR: Mapping[str, float] = {"@pose": 0.01, "@light": 0.01, "@card_light": 0.01, "@black": 0.2, "@turn": 0.05}
"""Steps of the nuisances by which what finer pixels change stays what it is [their units]."""


@dataclass
class Case:
    """One bundle on its way through the critic."""

    observation: Observation
    problem: Problem
    base: Fit
    candidates: tuple[Candidate, ...]
    seed: int
    codec: bool = False
    silent: bool = False
    likeness: Likeness = field(default_factory=Likeness)
    notes: list[str] = field(default_factory=list)

    @property
    def unlike(self) -> bool:
        """Whether the frames show too little of the believed contact for changes of it to be judged."""
        return self.likeness.correlation < FROZEN.levels["least_likeness"]

    def rng(self, name: str, number: int = 0) -> np.random.Generator:
        """Return a random stream of its own for each step."""
        return generator(self.seed, "criticism", name, number)


def prepare(observation: Observation, seed: int, exclude: Collection[str] = ()) -> Case:
    """Measure the noise and fit the believed rig with its nuisances."""
    size = noise_scale_of(observation.believed.camera, observation.scatter)
    codec = codec_before(observation, seed) if size.codec else None
    if codec is not None:
        size = replace(size, value=codec[1], deviation=LOOSE)
    predictor = Predictor(observation.scene, observation.views, noise_scale=size.value)
    known = FROZEN.noise
    data = observation.cube
    noise = noise_of(
        observation.held,
        expected_tone(observation.scene.camera, size.value),
        data.shape[1:],
        floor_DN=known["floor_DN"],
        flicker=known["flicker"],
    )
    if size.codec:
        # What changes little from frame to frame a codec does not pass on.
        noise = replace(noise, flicker=max(noise.flicker, known["flicker"]))
    views = [int(v) for v in observation.open]
    parameters = [
        p
        for p in nuisance_parameters(observation.views, noise.flicker, size.deviation)
        if p.views is None or set(p.views) & set(views)
    ]
    base = predictor.cube({})
    problem = Problem.of(predictor, data, noise, quick_variance(base), views, base)
    start = {"@black": size.black_DN} if size.black_DN else {}
    seen = None if start else base
    own = predicted_part(fit(problem, parameters, start, predicted=seen, rounds=ROUNDS).point, parameters)
    fitted_problem, every, fitted, frames = finely_fitted(observation, problem, parameters, own, size)
    own = predicted_part(fitted.point, every)
    if size.codec:
        if codec is not None:
            fitted_problem, every = through_codec(fitted_problem, every, frames, codec[0], seed, size.silent)
            fitted = fit(fitted_problem, every, own, rounds=ROUNDS)
            own = predicted_part(fitted.point, every)
        # A codec hands noise from frame to frame, so that replicates show too little of it; single bins tell.
        fitted_problem = fitted_problem.louder(*noise_by_bins(fitted_problem, fitted))
        fitted = fit(fitted_problem, every, own, rounds=ROUNDS)
    fitted = settled(fitted_problem, fitted)
    library = candidates_of(observation.scene, observation.available, exclude)
    candidates = (
        without_places(library) if size.silent else with_places(fitted_problem, fitted, library, codec=size.codec)
    )
    candidates = with_bands(fitted_problem, fitted, candidates)
    likeness = likeness_of(fitted_problem, fitted, base)
    case = Case(observation, fitted_problem, fitted, candidates, seed, size.codec, size.silent, likeness)
    if case.unlike:
        case.notes.append(
            "the press frames do not show the contact that the believed rig has there (correlation"
            f" {likeness.correlation:.2f}): another rig or place, or no contact; no effect is judged"
        )
    if not noise.measured:
        case.notes.append("no replicates: the noise is the camera's own model, false alarms are not controlled")
    if not size.codec and size.value < QUIET and "lens_cap" not in observation.scatter:
        case.notes.append(
            "the camera is quieter than its data sheet says, or a codec smoothed its noise: frames of a covered lens"
            " would tell, and a codec may be taken for a cause"
        )
    if observation.series:
        case.notes.append(
            "scalar series take no part beside frames (" + ", ".join(sorted(observation.series)) + "): a bundle of them"
            " alone is judged by them"
        )
    if size.codec:
        like = f"as by {codec[0]}" if codec else "by a codec?"
        case.notes.append(f"noise was smoothed after the tone curve, {like}: structure of no known kind is not sought")
    return case


def settled(problem: Problem, fitted: Fit) -> Fit:
    """Return a fit with its derivatives made anew where it ended, and settled by them.

    Some hundredths of a deviation are enough for candidates of which the nuisances take all but a hundredth: what old
    derivatives miss along a nuisance would be theirs.
    """
    at = predicted_part(fitted.point, fitted.parameters)
    rows = derivatives(problem, at, fitted.parameters, fitted.predicted)
    return fit(problem, fitted.parameters, fitted.point, rows=rows, predicted=fitted.predicted, rounds=ROUNDS)


def finely_fitted(
    observation: Observation, problem: Problem, parameters: Sequence[Parameter], own: Point, size: NoiseScale
) -> tuple[Problem, list[Parameter], Fit, FineFrames]:
    """Return the problem about the fitted place of the finger, all its nuisances, the fit, and the fine prediction.

    Parameters
    ----------
    observation : Observation
    problem : Problem
        Of the quick prediction.
    parameters : sequence of Parameter
        Nuisances but for those of computation.
    own : mapping
        Where the quick prediction fits best.
    size : NoiseScale
    """
    for _ in range(PLACES):
        point = own
        renewed, found, frames = at_place(observation, problem, point, size.codec, size.silent)
        every = [*parameters, *found]
        fitted = fit(renewed, every, point, rounds=ROUNDS)
        own = predicted_part(fitted.point, every)
        if displaced(own, point):
            continue
        fitted = anchored(renewed, every, point, fitted)
        own = predicted_part(fitted.point, every)
        if left_by_derivatives(fitted, point) < ROUGH_LEFT:
            break
    return renewed, every, fitted, frames


def anchored(problem: Problem, parameters: Sequence[Parameter], start: Point, fitted: Fit) -> Fit:
    """Return the fit by derivatives alone from where the fine prediction was made, if it is the better one.

    The last micrometre of a quick prediction is rough: the edge of contact moves from cell to cell, some grey levels of
    a bin at a time, and a fit stops at the first that goes up. From here on the predictor says at the fitted point what
    the fine prediction and its derivatives say there.
    """
    predictor = problem.predictor
    first = predictor.cube(start, problem.views)
    rows = fitted.rows
    straight = stepped(problem, parameters, start, rows, first)
    if straight.misfit > fitted.misfit:
        return fitted
    there = predicted_part(straight.point, parameters)
    difference = straight.predicted - predictor.cube(there, problem.views)
    predictor.correction = np.asarray(predictor.correction) + np.nan_to_num(difference, nan=0.0)
    return straight


def left_by_derivatives(fitted: Fit, start: Point) -> float:
    """Return the square of what derivatives may be off by since a point, over the mean square of what is left of bins.

    Noise may be far below the weights' own, where those keep to what no camera is known better than.
    """
    moved = sum(
        float((fitted.point.get(p.name, 0.0) - start.get(p.name, 0.0)) ** 2 * (row @ row))
        for p, row in zip(fitted.parameters, fitted.rows, strict=True)
        if p.name.startswith("@pose")
    )
    return ROUGH**2 * moved / float(np.mean(np.square(fitted.residual)))


def displaced(point: Mapping[str, float], since: Mapping[str, float]) -> bool:
    """Tell whether a fit has moved so far that the fine prediction is to be made anew."""
    return any(
        abs(point.get(name, 0.0) - since.get(name, 0.0)) > far
        for stem, far in FAR.items()
        for name in point
        if name.startswith(stem)
    )


def at_place(
    observation: Observation,
    problem: Problem,
    point: Mapping[str, float],
    codec: bool = False,
    silent: bool = False,
) -> tuple[Problem, tuple[Parameter, ...], FineFrames]:
    """Return the problem about the fitted place of the finger, the nuisances of computation there, and its frames.

    From now on predictions carry the plate's light at that very place, as fine pixels gather it, and weights follow
    the level there.
    """
    predictor = problem.predictor
    predictor.correction = None
    quick = predictor.cube(point)
    factor, scale = model_factor(observation.believed), predictor.noise_scale
    frames = FineFrames(observation.believed, predictor.views, factor, point, noise_scale=scale)
    fine = frames.cube()
    predictor.correction = np.nan_to_num(fine - quick, nan=0.0)
    lit = [k for k, view in enumerate(predictor.views) if view.touches]
    change = np.zeros_like(fine)
    change[lit] = fine[lit] - quick[lit]
    left_over = leftover_variance(change)
    if codec:
        left_over = left_over + codec_variance(fine)
    renewed = Problem.of(predictor, problem.data, problem.noise, left_over, problem.views, fine)
    every = nuisance_parameters(predictor.views, 0.0)
    force = {p.views[0]: p for p in every if p.name.startswith("@force") and p.views}
    by_force = [
        derivative(predictor, point, force[k], [k])[k] if k in force else None for k in range(len(predictor.views))
    ]
    edge = edge_template(predictor.scene, predictor.views, by_force)
    found = numerics_parameters(predictor.views, change, edge, silent=silent)
    return renewed, (*found, *codec_parameters(predictor.views, fine)) if codec else found, frames


def codec_before(observation: Observation, seed: int) -> tuple[Codec, float] | None:
    """Return the codec that the replicates went through, and the scale of the noise before it; None: not to be told."""
    views, believed = observation.views, observation.believed
    place = next((k for k, v in enumerate(views) if v.kind == "replicate"), None)
    if place is None or "replicate" not in observation.scatter:
        return None
    factor = model_factor(believed)
    quick = Predictor(observation.scene, views)

    def picture(number: int) -> Array:
        return quick.image({}, number).repeat(factor, 0).repeat(factor, 1)

    before = [partial(picture, k) for k, view in enumerate(views) if view.kind == "press"]
    held, scatter = observation.held["replicate"], observation.scatter["replicate"]
    shooting = Shooting(believed.camera, 1.0, factor)
    return codec_of(shooting, picture(place), before, held, scatter, generator(seed, "criticism", "codec", 0))


def through_codec(
    problem: Problem, parameters: Sequence[Parameter], frames: FineFrames, codec: Codec, seed: int, silent: bool
) -> tuple[Problem, list[Parameter]]:
    """Return the problem with what a codec makes of its frames, and the nuisances that are left.

    The change of the mean goes into the prediction, its scatter into the weights and the draws. Of the shapes that
    stood for a codec's changes before, a share remains, for it may have been another codec: a larger one where no noise
    outlived it, which would have spread its steps over all levels.
    """
    predictor = problem.predictor
    shooting = Shooting(frames.believed.camera, predictor.noise_scale, frames.factor)
    level, share = frames.cube(), FROZEN.nuisances["codec_known_silent" if silent else "codec_known"]
    rng = generator(seed, "criticism", "codec", 1)
    made = recoded(shooting, frames.picture, predictor.views, codec, level, rng, share if silent else 0.0)
    predictor.correction = made.bias if predictor.correction is None else predictor.correction + made.bias
    known = (1.0 - share**2) * codec_variance(level) - problem.noise.floor_DN**2
    kept = [p for p in parameters if not p.name.startswith("@codec")]
    shapes = codec_parameters(predictor.views, level, share, made.bias)
    return problem.recoded(made, problem.numerics - known), [*kept, *shapes]
