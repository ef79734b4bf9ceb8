"""Load, change and save scenes: the rig as data."""

from __future__ import annotations

from pathlib import Path

from evanesce.core.errors import InputError
from evanesce.core.files import write_text
from evanesce.core.resources import resource
from evanesce.rig import Scene, copy_scene_files, dump_scene, load_scene
from evanesce.rig.coarser import coarser_camera


def load(name: str | Path) -> Scene:
    """Read a scene from a TOML file, or one that ships with evanesce by its name.

    Parameters
    ----------
    name : str or Path
        A file, or one of :func:`shipped_scenes`.

    Returns
    -------
    Scene
        Frozen; :meth:`Scene.with_ <evanesce.rig.scene.Scene.with_>` returns one with other values.

    Raises
    ------
    InputError
        With file, key, value and what is allowed of the first thing wrong.

    Examples
    --------
    >>> import evanesce as ev
    >>> scene = ev.load("thesis_ridged").with_(leds__voltage_V=9.5)
    >>> scene.plate.thickness_mm, scene.finger.ridges.height_um
    (6.0, 47.67)
    """
    return load_scene(name)


def shipped_scenes() -> tuple[str, ...]:
    """Return the names of the scenes that ship with evanesce.

    Returns
    -------
    tuple of str

    Examples
    --------
    >>> import evanesce as ev
    >>> ev.shipped_scenes()
    ('gripper', 'human_print', 'pmma_infrared', 'prism_reader', 'soft_slide', 'stick_slip', ...)
    """
    return tuple(sorted(path.stem for path in resource("scenes").glob("*.toml")))


def save_scene(scene: Scene, path: str | Path) -> None:
    """Write a scene as TOML that :func:`load` reads back equal.

    A scanned finger's height map and a measured spectrum are copied beside it.

    Parameters
    ----------
    scene : Scene
    path : str or Path
        Of the file, which is written whole or not at all; its folder exists.

    Raises
    ------
    InputError
        If the folder does not exist.
    WorkError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile, evanesce as ev
    >>> scene = ev.load("thesis").with_(plate__thickness_mm=8)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     ev.save_scene(scene, f"{folder}/thick.toml")
    ...     ev.load(f"{folder}/thick.toml") == scene
    True
    """
    path = Path(path)
    if not path.parent.is_dir():
        raise InputError("its folder does not exist", file=path, allowed="a file in an existing folder")
    copy_scene_files(scene, path.parent)
    write_text(path, dump_scene(scene))


def coarser(scene: Scene, factor: int) -> Scene:
    """Return a scene whose camera sees the same field on fewer, larger pixels.

    Full wells and gains grow with a pixel's area, as where charge is binned. Everything is faster by about the square
    of the factor; sizes that a measurement states in pixels (the minimum blob size) have to be divided.

    Parameters
    ----------
    scene : Scene
    factor : int
        Side of the new pixels in old ones; a divisor of rows and columns.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If the resolution does not divide.

    Examples
    --------
    >>> import evanesce as ev
    >>> ev.coarser(ev.load("thesis"), 4).camera.resolution_px
    (500, 375)
    """
    return coarser_camera(scene, factor, key="factor")
