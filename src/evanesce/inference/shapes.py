"""Forms of every cause about the nominal rig, from its parameters' priors and from its other laws; kept on disk."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.provenance import code_digest, digest
from evanesce.core.rng import generator
from evanesce.inference.causes import Cause
from evanesce.inference.constants import DRAWS
from evanesce.inference.data import DataVector, stepped
from evanesce.inference.laws import Law, Seen, all_laws
from evanesce.inference.unknown import unknown_blocks
from evanesce.prediction.colour import expected_grey
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.predict import CONTACT_PX, Predictor
from evanesce.prediction.views import View
from evanesce.render.fast.field_files import Folder, read_arrays, write_arrays
from evanesce.rig import Scene

Array = NDArray[Any]
Tell = Callable[[str], None]

FLAT_DN = 1e-9
"""A tone curve that rises by less from one signal to the next is flat there."""
COSTLY_DRAWS = 2
"""Forms of a cause for which the plate's light is computed anew: one, and another to show how little they differ."""
SHAPES = Folder("shapes", 1024)
"""Of their files, some 2 MB each: 25 rigs, or places of the finger, or cameras."""
SCALE_STEP = 0.25
"""Of the logarithm of the noise's scale at which forms are made: it decides how stairs of the tone curve are smoothed,
of which a change shows little; bundles whose noise is known to some per cent then share their forms."""
FORMAT = 1
"""Of the files."""
BEHIND = (
    "bench", "bundle", "chain", "contact", "core", "effects", "materials", "measurement", "optics", "prediction",
    "render", "rig", "sensor",
)  # fmt: skip
"""Packages of which forms are made: those of other source are not read."""


@dataclass(frozen=True)
class Forms:
    """Forms of one cause.

    Attributes
    ----------
    id : str
    changes : ndarray of float16 (forms, views, rows, cols)
        Of the nominal prediction [DN].
    names : tuple of str
        The law of each; empty where the effect itself was drawn.
    """

    id: str
    changes: Array
    names: tuple[str, ...]

    def rows(self, data: DataVector) -> Array:
        """Return the whitened forms (forms, bins) over the open views."""
        return np.array([data.whitened(one.astype(float)) for one in self.changes], np.float32)


def drawn_point(cause: Cause, rng: np.random.Generator) -> dict[str, float]:
    """Return a point of a cause: amplitudes of half to all of their prior deviation, other parameters over theirs.

    Parameters
    ----------
    cause : Cause
    rng : numpy.random.Generator
    """
    starts = cause.candidate.starts
    point = dict(starts[int(rng.integers(len(starts)))]) if starts else {}
    for p in cause.parameters:
        if p.name in point:
            at = point[p.name]
            if p.name in cause.amplitudes:
                point[p.name] = p.null + (at - p.null) * rng.uniform(0.5, 1.0)
            continue
        if p.name in cause.amplitudes or not cause.amplitudes & set(point):
            size = p.deviation * rng.uniform(0.5, 1.0) * rng.choice([-1.0, 1.0])
        else:
            size = p.deviation * rng.uniform(-1.0, 1.0)
        point[p.name] = _within(p, p.null + size, p.null - size)
    return point


def drawn_points(cause: Cause, rng: np.random.Generator) -> list[dict[str, float]]:
    """Return the points at which a cause's forms are made, beside those of its laws.

    Parameters
    ----------
    cause : Cause
    rng : numpy.random.Generator
    """
    laws = all_laws().get(cause.id, ())
    # Another light of the plate takes seconds, and its form hardly depends on how much there is of it.
    count = COSTLY_DRAWS if cause.costly else max(DRAWS - len(laws), DRAWS // 2)
    return [drawn_point(cause, rng) for _ in range(count)]


def sources_of(cause: Cause) -> list[Any]:
    """Return the source of a cause's effect and of its laws: forms kept on disk are those of this source."""
    laws = [inspect.getsource(inspect.getmodule(law.change or law.rig)) for law in all_laws().get(cause.id, ())]  # type: ignore[arg-type]
    return [inspect.getsource(inspect.getmodule(cause.candidate.effect.apply)), laws]  # type: ignore[arg-type]


def _within(parameter: Parameter, *wanted: float) -> float:
    """Return the first wanted value within a parameter's bounds, or the last one clipped."""
    low, high = parameter.bounds
    for value in wanted:
        if low <= value <= high:
            return float(value)
    return float(np.clip(wanted[-1], low, high))


def form_predictor(scene: Scene, views: Sequence[View], noise_scale: float, pixels: float) -> Predictor:
    """Return the predictor of which a rig's forms are made.

    Parameters
    ----------
    scene : Scene
        At the critic's resolution.
    views : sequence of View
    noise_scale, pixels : float
        See :class:`evanesce.prediction.predict.Predictor`.
    """
    scale = stepped(noise_scale, SCALE_STEP)
    return Predictor(scene, views, noise_scale=scale, pixels=pixels, before=CONTACT_PX, finer=CONTACT_PX)


@dataclass
class FormBank:
    """Forms about the nominal rig with the finger at one place.

    Attributes
    ----------
    coarse : Predictor
        Of the nominal rig.
    point : mapping
        Nuisances: place of the finger, to a tenth of a millimetre, so that another bundle of the rig finds its file.
    tell : callable
    """

    coarse: Predictor
    point: Mapping[str, float]
    tell: Tell = lambda line: None
    _found: dict[str, Forms] = field(default_factory=dict)
    _nominal: Array | None = None

    @property
    def nominal(self) -> Array:
        """Prediction without any cause (views, rows, cols) [DN]."""
        if self._nominal is None:
            self._nominal = self._cube(self.coarse, {})
        return self._nominal

    def of(self, causes: Sequence[Cause]) -> list[Forms]:
        """Return the forms of causes that show; those that the rig cannot have are left out."""
        missing = [c for c in causes if c.id not in self._found]
        for number, cause in enumerate(missing):
            kept = read_arrays(self._key(cause), ("changes", "laws"), SHAPES)
            if kept is None:
                self.tell(f"forms of {cause.id} ({number + 1} of {len(missing)})")
            self._found[cause.id] = self._read(cause, kept) if kept is not None else self._made(cause)
        every = [self._found[c.id] for c in causes]
        return [forms for forms in every if np.any(forms.changes)]

    def blocks(self, causes: Sequence[Cause], data: DataVector) -> dict[str, Array]:
        """Return the whitened forms (forms, bins) of causes that show, and rows of something unknown."""
        found = {forms.id: forms.rows(data) for forms in self.of(causes)}
        return {**found, **unknown_blocks(data, self.nominal)}

    def _key(self, cause: Cause) -> str:
        coarse = self.coarse
        views = [[v.kind, v.force_N, v.voltage_V, v.time_s, v.index, v.session, v.frames] for v in coarse.views]
        known = [FORMAT, code_digest(*BEHIND), DRAWS, coarse.scene.model_dump(mode="json"), views, dict(self.point)]
        return digest([*known, coarse.noise_scale, coarse.before, coarse.finer, *sources_of(cause)])

    def _cube(self, coarse: Predictor, point: Mapping[str, float]) -> Array:
        correction, coarse.correction = coarse.correction, None
        try:
            return coarse.cube({**self.point, **point})
        finally:
            coarse.correction = correction

    def _made(self, cause: Cause) -> Forms:
        rng = generator(0, "forms", cause.id)
        laws = all_laws().get(cause.id, ())
        changes, names = [], []
        for point in drawn_points(cause, rng):
            try:
                changes.append(self._cube(self.coarse, point) - self.nominal)
            except InputError:
                continue
            names.append("")
        for law in laws:
            changes.append(self._by_law(law, rng))
            names.append(law.name)
        cube = np.array(changes, np.float16).reshape(len(changes), *self.nominal.shape)
        numbers = [next((k for k, law in enumerate(laws) if law.name == name), -1) for name in names]
        write_arrays(self._key(cause), {"changes": cube, "laws": np.array(numbers, float)}, SHAPES)
        return Forms(cause.id, cube, tuple(names))

    def _read(self, cause: Cause, kept: Mapping[str, Array]) -> Forms:
        laws = all_laws().get(cause.id, ())
        names = tuple("" if n < 0 else laws[int(n)].name for n in kept["laws"])
        return Forms(cause.id, kept["changes"], names)

    def _by_law(self, law: Law, rng: np.random.Generator) -> Array:
        if law.rig is not None:
            other = Predictor(
                law.rig(self.coarse.scene, rng),
                self.coarse.views,
                finer=self.coarse.finer,
                noise_scale=self.coarse.noise_scale,
                pixels=self.coarse.pixels,
                before=self.coarse.before,
            )
            return np.asarray(self._cube(other, {}) - self.nominal)
        assert law.change is not None
        return law.change(self.seen, rng)

    @property
    def seen(self) -> Seen:
        """The nominal prediction for laws that change it."""
        nominal = self.nominal
        tone = expected_grey(self.coarse.scene, self.coarse.pixels * self.coarse.noise_scale)
        rising = np.concatenate([[True], np.diff(tone.mean) > FLAT_DN])
        by_signal = np.interp(nominal, tone.mean[rising], np.gradient(tone.mean, tone.signal)[rising])
        rows, cols = nominal.shape[1:]
        x = (np.arange(cols) + 0.5 - cols / 2) / (cols / 2)
        y = (np.arange(rows) + 0.5 - rows / 2) / (cols / 2)
        grid_x, grid_y = np.meshgrid(x, y)
        by_light = tone.slope_by_light(nominal)
        return Seen(self.coarse.scene, self.coarse.views, nominal, by_light, by_signal, grid_x, grid_y)
