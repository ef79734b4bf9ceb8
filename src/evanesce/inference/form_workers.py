"""Forms of many causes made by several processes; they meet in the folder where forms are kept."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any

import cv2

from evanesce.effects.inference_hints import OBSERVABLES
from evanesce.inference.causes import Cause, changes_plate_light
from evanesce.inference.shapes import FormBank
from evanesce.prediction.candidates import candidates_of
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import View
from evanesce.render.fast import threads
from evanesce.rig import Scene

LEAST = 4
"""Causes without forms from which on processes are started: starting them takes some seconds."""

_bank: FormBank | None = None


def made(bank: FormBank, causes: Sequence[Cause], workers: int, tell: Callable[[str], None]) -> None:
    """Make the forms of causes that are not on disk, and leave them there.

    Parameters
    ----------
    bank : FormBank
    causes : sequence of Cause
    workers : int
        Processes; with 1 nothing is done here.
    tell : callable
        Told each cause that is done.
    """
    missing = [cause for cause in causes if not bank.on_disk(cause)]
    if workers < 2 or len(missing) < LEAST:
        return
    coarse = bank.coarse
    begin = (coarse.scene, coarse.views, coarse.finer, coarse.noise_scale, dict(bank.point))
    # What has not started threads of its own may not be copied while another thread runs.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=begin) as pool:
        running = {pool.submit(_make, cause.id): cause.id for cause in missing}
        for number, done in enumerate(as_completed(running)):
            done.result()
            tell(f"forms of {running[done]} ({number + 1} of {len(missing)})")


def _begin(scene: Scene, views: tuple[View, ...], finer: int, noise_scale: float, point: Mapping[str, float]) -> None:
    global _bank
    cv2.setNumThreads(1)
    threads.THREADS = 1  # its thread pool is created on first use
    _bank = FormBank(Predictor(scene, views, finer=finer, noise_scale=noise_scale), point)


def _make(name: str) -> None:
    assert _bank is not None
    scene = _bank.coarse.scene
    every: list[Any] = [c for c in candidates_of(scene, OBSERVABLES) if c.id == name]
    _bank.of([Cause(candidate, changes_plate_light(scene, candidate)) for candidate in every])
