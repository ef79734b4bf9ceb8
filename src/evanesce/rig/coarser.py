"""A camera of the same field with larger pixels, or with smaller ones at which light is sampled."""

from __future__ import annotations

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict
from evanesce.rig.load import validate
from evanesce.rig.scene import Scene


def coarser_camera(scene: Scene, factor: int, *, key: str = "--camera-coarser") -> Scene:
    """Return the scene with a camera of the same field whose pixels are ``factor`` times as large.

    Wells and gain grow with a pixel's area, as where pixels are binned in charge.

    Parameters
    ----------
    scene : Scene
    factor : int
    key : str
        Named in errors.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If the resolution does not divide.
    """
    if factor == 1:
        return scene
    camera = scene.camera
    cols, rows = camera.resolution_px
    if cols % factor or rows % factor:
        raise InputError(f"{factor} does not divide {cols} x {rows} px", key=key, allowed="a common divisor")
    dx, dy = camera.principal_point_offset_px
    pixel = camera.pixel.model_copy(
        update={
            "pitch_um": camera.pixel.pitch_um * factor,
            "full_well_capacity_e": camera.pixel.full_well_capacity_e * factor**2,
            "conversion_gain_e_per_DN": camera.pixel.conversion_gain_e_per_DN * factor**2,
        }
    )
    update = {
        "resolution_px": (cols // factor, rows // factor),
        "scale_px_per_mm": camera.scale_px_per_mm / factor,
        "principal_point_offset_px": (dx / factor, dy / factor),
        "pixel": pixel,
    }
    changed = scene.model_copy(update={"camera": camera.model_copy(update=update)})
    return validate(Scene, changed.as_dict(), key)


def finer_pixels(scene: Scene, factor: int) -> Scene:
    """Return the scene with the smaller pixels at which its light is sampled, ``factor`` along each of the camera's.

    Added up again they are the camera's own: wells and gain stay those of the whole pixel. A lens that is sharper than
    a pixel cannot be blurred on it.

    Parameters
    ----------
    scene : Scene
    factor : int
        Finer pixels along each of the camera's.

    Returns
    -------
    Scene
    """
    if factor == 1:
        return scene
    camera = scene.camera
    (cols, rows), (dx, dy) = camera.resolution_px, camera.principal_point_offset_px
    update = {
        "resolution_px": (cols * factor, rows * factor),
        "scale_px_per_mm": camera.scale_px_per_mm * factor,
        "principal_point_offset_px": (dx * factor, dy * factor),
        "pixel": camera.pixel.model_copy(update={"pitch_um": camera.pixel.pitch_um / factor}),
    }
    return scene.model_copy(update={"camera": camera.model_copy(update=update)})


def in_smaller_pixels(parameters: Strict, times: int) -> Strict:
    """Return settings with the lengths in pixels counted in pixels so many times smaller.

    Parameters
    ----------
    parameters : Strict
        Of an effect; lengths in pixels are those whose names end in ``_px``.
    times : int
    """
    lengths = {name: value for name, value in parameters if name.endswith("_px")}
    if times == 1 or not lengths:
        return parameters
    smaller = {
        n: tuple(times * v for v in one) if isinstance(one, tuple) else times * one for n, one in lengths.items()
    }
    return parameters.model_copy(update=smaller)
