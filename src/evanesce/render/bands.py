"""Light in bands: a scene rendered band by band, each with its own wavelength and indices, summed as a frame does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from evanesce.core.states import ContactState, PlateLight
from evanesce.optics.seen import at_wavelength, dispersed_plate, seen_finger
from evanesce.optics.spectrum import Band, spectrum_of, white_bands
from evanesce.rig import Scene

MAX_BANDS = 14
Render = Callable[..., PlateLight]


def in_band(scene: Scene, band: Band) -> Scene:
    """Return a scene at the wavelength of one band.

    Light of another spectrum than white: :func:`~evanesce.optics.seen.at_wavelength`. Of white light, indices,
    scattering and photons are as there; the glass's absorption stays, since the scene's figure is that in white light,
    and the scale on the axis stays, which the lens's own lateral colour would change as much.

    Parameters
    ----------
    scene : Scene
    band : Band

    Returns
    -------
    Scene
    """
    if scene.leds.spectrum != "white":
        return at_wavelength(scene, band.wavelength)
    return scene.model_copy(
        update={
            "plate": dispersed_plate(scene.plate, band.wavelength, scene.figures_at_nm),
            "finger": seen_finger(scene, band.wavelength),
            "camera": scene.camera.model_copy(update={"wavelength_nm": band.wavelength}),
        }
    )


def bands_of(scene: Scene, count: int) -> tuple[Band, ...]:
    """Return the light of a scene's LEDs in ``count`` bands.

    Parameters
    ----------
    scene : Scene
    count : int
        1 to :data:`MAX_BANDS`.

    Returns
    -------
    tuple of Band
        White light: of equal weight in a grey frame. Another spectrum: of equal numbers of photons.
    """
    return white_bands(count) if scene.leds.spectrum == "white" else spectrum_of(scene.leds).bands(count)


def banded(render: Render, count: int) -> Render:
    """Return a renderer of the LEDs' light in ``count`` bands; with 1 it is ``render`` itself.

    Radiance and variance are sums over the bands with their weights in a frame (white light: LED power by band times
    the luma's sensitivity), which add up to 1: where nothing disperses the light is that of one wavelength. The result
    is seen on the pixels of one view, so that lateral colour of the plate's window is in it; the lens's is not.

    Parameters
    ----------
    render : callable
        ``render(scene, state, *, seed, view, **options) -> PlateLight``: the path tracer or the fast renderer.
    count : int
        1 to :data:`MAX_BANDS`.
    """
    if count == 1:
        return render

    def summed(scene: Scene, state: ContactState | None, *, seed: int = 0, **options: Any) -> PlateLight:
        from evanesce.optics.projection import Projection

        options = {"view": Projection.of(scene.camera, scene.plate).ideal_view()} | options
        total: PlateLight | None = None
        for k, band in enumerate(bands_of(scene, count)):
            # A seed of its own for each band, or their noise would not average out.
            light = render(in_band(scene, band), state, seed=seed + k, **options)
            radiance = band.weight * np.asarray(light.radiance, float)
            variance = band.weight**2 * np.asarray(light.variance, float)
            if total is not None:
                radiance, variance = radiance + total.radiance, variance + total.variance
            total = replace(light, radiance=radiance, variance=variance, samples=light.samples * (k + 1))
        assert total is not None
        return total

    return summed
