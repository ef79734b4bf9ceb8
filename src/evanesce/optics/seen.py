"""A scene as light of one wavelength sees it: indices, absorption, scattering, photons and diffraction.

A scene states its figures where they are published: indices at the sodium line, the glass's absorption at 550 nm, the
silicone's scattering at ``camera.wavelength_nm``, and the camera's scale in white light. White light is seen by these
figures as they are. Light of another spectrum is seen at its mean wavelength (:func:`seen_at`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from evanesce.optics.glass import soda_lime_absorption
from evanesce.optics.projection import rotation
from evanesce.optics.spectrum import SODIUM_NM, pdms_index, soda_lime_index, spectrum_of
from evanesce.optics.subsurface import absorption_coefficient, half_space_reflectance
from evanesce.rig import Camera, Scene
from evanesce.rig.finger import Finger
from evanesce.rig.plate import Plate

LONGEST_MM = 5.0
"""Bound of ``finger.scattering_length_mm``: beyond, light is scattered farther than the finger is thick."""

MOST_ABSORPTION_PER_MM = 1.0
"""Bound of ``plate.absorption_coefficient_per_mm``."""


def seen_at(scene: Scene) -> Scene:
    """Return the scene whose figures hold at the mean wavelength of its LEDs' light.

    White light leaves the very same scene. So does a scene that names the wavelength of its figures
    (``figures_at_nm``), as the scenes that this function returns do: calling it again changes nothing.

    The wavelength is taken to a whole nanometre, so that a junction that warms by some kelvins during a run does not
    ask for new tables of light in every frame: photon energies are right to 0.08 %, indices to 2e-5.

    Parameters
    ----------
    scene : Scene
        After effects of the stage ``rig``.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If a measured spectrum's file is not the one that the scene was read with.
    """
    if scene.leds.spectrum == "white" or scene.figures_at_nm is not None:
        return scene
    return at_wavelength(scene, round(spectrum_of(scene.leds).mean_wavelength_nm))


def under_lamp(scene: Scene) -> Scene:
    """Return the scene of a printed card: LEDs off, lit by a white lamp, whatever light the LEDs have.

    Parameters
    ----------
    scene : Scene
        Its figures as it states them, not those of :func:`seen_at`.

    Returns
    -------
    Scene
        The very same with white LEDs.
    """
    if scene.leds.spectrum == "white":
        return scene
    leds = scene.leds.model_copy(update={"spectrum": "white", "spectrum_sha256": None})
    return scene.model_copy(update={"leds": leds})


def at_wavelength(scene: Scene, wavelength: float) -> Scene:
    """Return a scene whose figures hold at a wavelength, its camera where it stood.

    Indices are shifted as soda-lime glass and PDMS disperse, the glass's absorption is scaled as iron's, the silicone's
    sigma_s' and sigma_a follow the finger's powers of wavelength; photon energy and diffraction are those of the
    wavelength. The camera does not move, so that ``scale_px_per_mm`` changes with the plate's apparent depth.

    Parameters
    ----------
    scene : Scene
    wavelength : float
        [nm], 300 to 1100.

    Returns
    -------
    Scene
    """
    stated = scene.figures_at_nm
    plate = dispersed_plate(scene.plate, wavelength, stated)
    absorption = plate.absorption_coefficient_per_mm
    if absorption > 0.0:
        base = 1.0 if stated is None else float(soda_lime_absorption(stated))
        absorption = min(absorption * float(soda_lime_absorption(wavelength)) / base, MOST_ABSORPTION_PER_MM)
    plate = plate.model_copy(update={"absorption_coefficient_per_mm": absorption})
    camera = _unmoved(scene.camera, scene.plate, plate)
    return scene.model_copy(
        update={
            "plate": plate,
            "finger": seen_finger(scene, wavelength),
            "camera": camera.model_copy(update={"wavelength_nm": float(wavelength)}),
            "figures_at_nm": float(wavelength),
        }
    )


def dispersed_plate(plate: Plate, wavelength: float, stated: float | None = None) -> Plate:
    """Return the plate with its index at a wavelength.

    Parameters
    ----------
    plate : Plate
    wavelength : float
        [nm].
    stated : float, optional
        At which its index is stated [nm]; the sodium line if not given.

    Returns
    -------
    Plate
    """
    index = plate.refractive_index + _shift(soda_lime_index, wavelength, stated)
    return plate.model_copy(update={"refractive_index": index})


def seen_finger(scene: Scene, wavelength: float) -> Finger:
    """Return the scene's finger with index, scattering and absorption at a wavelength.

    Parameters
    ----------
    scene : Scene
    wavelength : float
        [nm].

    Returns
    -------
    Finger
    """
    index = scene.finger.refractive_index + _shift(pdms_index, wavelength, scene.figures_at_nm)
    finger = _silicone(scene.finger, wavelength / scene.camera.wavelength_nm)
    return finger.model_copy(update={"refractive_index": index})


def _shift(index: Callable[[float], Any], wavelength: float, stated: float | None) -> float:
    return float(index(wavelength)) - float(index(SODIUM_NM if stated is None else stated))


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


def _unmoved(camera: Camera, plate: Plate, seen: Plate) -> Camera:
    """Return the camera at the same place before a plate of another index: scale and centre are those of its axis."""
    axis = rotation(*np.deg2rad([camera.tilt_x_deg, camera.tilt_y_deg, camera.roll_deg]))[:, 2]
    focal_px = camera.lens.focal_length_mm * 1e3 / camera.pixel.pitch_um
    # Depth of the contact plane as it appears moves by t (1/n' - 1/n) along z; the axis meets it farther on.
    nearer = plate.thickness_mm * (1.0 / seen.refractive_index - 1.0 / plate.refractive_index)
    along = nearer / float(axis[2])
    x, y = camera.centre_mm
    return camera.model_copy(
        update={
            "scale_px_per_mm": focal_px / (focal_px / camera.scale_px_per_mm + along),
            "centre_mm": (x + along * float(axis[0]), y + along * float(axis[1])),
        }
    )
