"""Solve the contact of a scene's finger with the glass: once, or along its loading programme."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

from evanesce.chain import simulate as chain
from evanesce.core.states import ContactState
from evanesce.rig import Scene


def solve_contact(scene: Scene, force_N: float, *, seed: int = 0, time_s: float = 0.0, index: int = 0) -> ContactState:
    """Solve the contact under a normal force, with the scene's contact law and effects.

    Parameters
    ----------
    scene : Scene
    force_N : float
        Normal force [N], not negative.
    seed, index : int
        Seed and frame number of the effects that draw from them; without effects neither matters.
    time_s : float
        Time of the state [s]. A scene that slides knows only the forces and times of its programme
        (:func:`contact_sequence`).

    Returns
    -------
    ContactState
        Pressure [MPa], gap [mm], contact mask (share of each cell) and, in a slide, traction [MPa], slip [mm] and
        stick or slip, each (rows, cols) on a grid of the contact plane; ``nominal_contact_area`` [mm^2].

    Raises
    ------
    InputError
        If the force is impossible or the law has no answer for it, or the contact leaves grid or finger.

    Examples
    --------
    >>> import evanesce as ev
    >>> smooth, ridged = (ev.solve_contact(ev.load(name), 2.0) for name in ("thesis", "thesis_ridged"))
    >>> round(smooth.nominal_contact_area, 2), round(ridged.nominal_contact_area, 2)
    (18.79, 17.91)
    >>> round(float(smooth.pressure.sum()) * smooth.grid.pitch**2, 2)
    2.0
    """
    _, state = chain.solve_contact(scene, force_N, seed=seed, time_s=time_s, index=index)
    assert state is not None  # there is a force
    return state


def contact_sequence(scene: Scene, *, seed: int = 0) -> Sequence[ContactState]:
    """Solve the contact along the scene's loading programme: held forces, a ramp or a slide.

    Parameters
    ----------
    scene : Scene
    seed : int
        Of the effects that draw from it.

    Returns
    -------
    sequence of ContactState
        One for each frame, at the scene's frame rate; each is sampled when it is indexed.

    Raises
    ------
    InputError
        As :func:`solve_contact`, or if the programme has too many frames.

    Examples
    --------
    >>> import evanesce as ev
    >>> states = ev.contact_sequence(ev.load("thesis"))
    >>> [state.normal_force for state in states]
    [1.0, 2.0, 5.0]
    """
    return _Programme(scene, seed)


class _Programme(Sequence[ContactState]):
    """The states of a scene's programme, each solved when asked for."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self._scene, self._seed, self._steps = scene, seed, chain.programme(scene, seed=seed)

    def __len__(self) -> int:
        return len(self._steps)

    @overload
    def __getitem__(self, index: int) -> ContactState: ...
    @overload
    def __getitem__(self, index: slice) -> list[ContactState]: ...
    def __getitem__(self, index: int | slice) -> ContactState | list[ContactState]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        frame = range(len(self))[index]
        time_s, force_N = self._steps[frame]
        return solve_contact(self._scene, force_N, seed=self._seed, time_s=time_s, index=frame)
