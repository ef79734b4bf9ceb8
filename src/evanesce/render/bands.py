"""White light: a scene rendered band by band, each with its own wavelength and indices, summed as a frame does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from evanesce.core.states import ContactState, PlateLight
from evanesce.optics.spectrum import SODIUM_NM, Band, pdms_index, soda_lime_index, white_bands
from evanesce.optics.subsurface import absorption_coefficient, half_space_reflectance
from evanesce.rig import Scene
from evanesce.rig.finger import Finger

MAX_BANDS = 14
LONGEST_MM = 5.0
"""Bound of ``finger.scattering_length_mm``: beyond, light is scattered farther than the finger is thick."""
Render = Callable[..., PlateLight]


def in_band(scene: Scene, band: Band) -> Scene:
    """Return a scene at the wavelength of one band.

    The scene's indices are those at 589 nm; glass and silicone are shifted as soda-lime and PDMS disperse. Silicone's
    scattering and absorption are those at the scene's wavelength and follow the finger's powers of wavelength; the
    glass's absorption stays, which for the rig's glass is not known by wavelength.

    Parameters
    ----------
    scene : Scene
    band : Band
    """

    def shift(index: Callable[[float], Any]) -> float:
        return float(index(band.wavelength)) - float(index(SODIUM_NM))

    plate, finger = scene.plate, scene.finger
    glass = plate.refractive_index + shift(soda_lime_index)
    silicone = finger.refractive_index + shift(pdms_index)
    return scene.model_copy(
        update={
            "plate": plate.model_copy(update={"refractive_index": glass}),
            "finger": _silicone(finger, band.wavelength / scene.camera.wavelength_nm).model_copy(
                update={"refractive_index": silicone}
            ),
            "camera": scene.camera.model_copy(update={"wavelength_nm": band.wavelength}),
        }
    )


def _silicone(finger: Finger, ratio: float) -> Finger:
    """Return the finger whose sigma_s' and sigma_a are those at ``ratio`` times the scene's wavelength."""
    if finger.scattering_power == finger.absorption_power == 0.0:
        return finger
    # Without a length light leaves where it entered, and reflectance depends on the ratio of the coefficients alone.
    length = finger.scattering_length_mm or 1.0
    absorption = absorption_coefficient(finger.diffuse_reflectance, length)
    scattering = (1.0 / length - absorption) * ratio**-finger.scattering_power
    total = scattering + absorption * ratio**-finger.absorption_power
    update = {
        "diffuse_reflectance": float(half_space_reflectance(scattering / total)),
        "scattering_length_mm": min(1.0 / total, LONGEST_MM) if finger.scattering_length_mm else 0.0,
    }
    return finger.model_copy(update=update)


def banded(render: Render, count: int) -> Render:
    """Return a renderer of white light in ``count`` bands; with 1 it is ``render`` itself, at the scene's wavelength.

    Radiance and variance are sums over the bands with their weights in a grey frame (LED power by band times the luma's
    sensitivity), which add up to 1: where nothing disperses the light is that of one wavelength. The result is seen on
    the pixels of one view, so that lateral colour of the plate's window is in it; the lens's is not.

    Parameters
    ----------
    render : callable
        ``render(scene, state, *, seed, view, **options) -> PlateLight``: the path tracer or the fast renderer.
    count : int
        1 to :data:`MAX_BANDS`.
    """
    if count == 1:
        return render
    bands = white_bands(count)

    def white(scene: Scene, state: ContactState | None, *, seed: int = 0, **options: Any) -> PlateLight:
        from evanesce.optics.projection import Projection

        options = {"view": Projection.of(scene.camera, scene.plate).ideal_view()} | options
        total: PlateLight | None = None
        for k, band in enumerate(bands):
            # A seed of its own for each band, or their noise would not average out.
            light = render(in_band(scene, band), state, seed=seed + k, **options)
            radiance = band.weight * np.asarray(light.radiance, float)
            variance = band.weight**2 * np.asarray(light.variance, float)
            if total is not None:
                radiance, variance = radiance + total.radiance, variance + total.variance
            total = replace(light, radiance=radiance, variance=variance, samples=light.samples * (k + 1))
        assert total is not None
        return total

    return white
