"""A scene on the contact grid, for many values of its unknowns: fast light, one Gaussian blur, exposure, threshold."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.contact.solve import contact_state
from evanesce.core.errors import InputError
from evanesce.core.states import SensorLight
from evanesce.optics.led_circuit import radiant_power
from evanesce.optics.seen import seen_at
from evanesce.render.fast.fields import Fields, fields_of
from evanesce.render.fast.patch import patch_radiance
from evanesce.render.fast.subsurface import spread_of
from evanesce.rig import Camera, Ridges, Scene
from evanesce.rig.finger import HertzLaw
from evanesce.sensor.expose import charge_of
from evanesce.sensor.lens import defocus_disc, irradiance_per_radiance, magnification, working_f_number
from evanesce.sensor.tone import CURVES
from evanesce.studies.voltage.unknowns import GRID_MM, GRID_SAMPLES, RATIOS, SHAPING, THRESHOLDS, Plan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LitPresses:
    """Presses of one finger: images of charge per ms and LED watt, and the like-named arrays of :class:`Samples`.

    ``shares`` are those of each cell in contact.
    """

    images: list[Array]
    shares: list[Array]
    true_area: Array
    by_ratio: Array
    open_middle: NDArray[np.bool_]


class ReducedRig:
    """A scene on the contact grid, for many values of its unknowns."""

    def __init__(self, scene: Scene, plan: Plan) -> None:
        if scene.finger.ridges is None:
            raise InputError("the finger has no ridges", key="finger.ridges", allowed="a ridged finger")
        if scene.leds.edge or scene.leds.strip_resistance_ohm_per_mm:
            raise InputError("strips of their own voltage", key="leds.edge", allowed="one supply for all LEDs, no sag")
        scene = seen_at(scene)
        grid = scene.grid.model_copy(update={"size_mm": GRID_MM, "samples": GRID_SAMPLES})
        finger = scene.finger.model_copy(update={"scattering_length_mm": 1.0})
        # Light per watt of an LED: a supply at which every bin is lit.
        leds = scene.leds.model_copy(update={"voltage_V": scene.leds.circuit.rated_voltage_V})
        self.scene = scene.model_copy(update={"grid": grid, "finger": finger, "leds": leds, "effects": {}})
        self.plan, self.fields = plan, fields_of(self.scene)
        self.unit = 1.0 / float(radiant_power(leds.circuit, leds.voltage_V))
        self.pitch = GRID_MM / GRID_SAMPLES
        camera = scene.camera
        m = magnification(camera.scale_px_per_mm, camera.pixel.pitch_um)
        on_axis = irradiance_per_radiance(
            0.0, 0.0, f_number=camera.lens.f_number, magnification=m, transmittance=camera.lens.transmittance
        )
        self.charge = _charge_per_irradiance(camera) * float(on_axis)
        self.sigma = blur_mm(camera) / self.pitch

    def light(self, values: Array) -> LitPresses:
        """Return what the first :data:`SHAPING` unknowns make, by force.

        Parameters
        ----------
        values : ndarray (unknowns,)

        Returns
        -------
        LitPresses
        """
        length, pitch, modulus = (float(v) for v in values[:SHAPING])
        finger = self.scene.finger
        ridges = finger.ridges or Ridges(pitch_um=1e3 * pitch)
        ridges = ridges.model_copy(update={"pitch_um": 1e3 * pitch})
        scene = self.scene.model_copy(
            update={
                "finger": finger.model_copy(update={"ridges": ridges, "scattering_length_mm": length}),
                "contact": HertzLaw(law="hertz", reduced_modulus_MPa=modulus),
            }
        )
        fields = with_length(self.fields, finger.diffuse_reflectance, length, self.pitch)
        images, shares, areas, ratios, opened = [], [], [], [], []
        for force in self.plan.forces:
            state = contact_state(scene, force)
            radiance, _ = patch_radiance(fields, state, refine=1)
            share = np.asarray(state.contact_mask, np.float64)
            images.append(np.asarray(radiance, float) * (self.unit * self.charge))
            shares.append(share)
            areas.append(state.nominal_contact_area)
            spread = cv2.GaussianBlur(images[-1], (0, 0), self.sigma, borderType=cv2.BORDER_REPLICATE)
            own = float((images[-1] * share).sum() / max(share.sum(), 1e-12))
            ratios.append([np.count_nonzero(spread > r * own) * self.pitch**2 for r in RATIOS])
            opened.append(middle_open(share, pitch / self.pitch))
        return LitPresses(images, shares, np.array(areas), np.array(ratios, float), np.array(opened))

    def areas(self, lit: LitPresses, values: Array) -> Array:
        """Return areas (forces, voltages, thresholds + 1) [mm^2]; the last threshold is the sample's own.

        Parameters
        ----------
        lit : LitPresses
        values : ndarray (unknowns,)

        Returns
        -------
        ndarray (forces, voltages, thresholds + 1)
        """
        forward, exposure, threshold = (float(v) for v in values[SHAPING:])
        circuit = self.scene.leds.circuit.model_copy(update={"forward_voltage_V": forward})
        powers = radiant_power(circuit, np.array(self.plan.voltages))
        cuts = (*THRESHOLDS, threshold)
        found = np.zeros((len(lit.images), powers.size, len(cuts)))
        for i, image in enumerate(lit.images):
            for j, power in enumerate(powers):
                levels = grey_levels(image * (exposure * power), self.scene.camera)
                levels = cv2.GaussianBlur(levels, (0, 0), self.sigma, borderType=cv2.BORDER_REPLICATE)
                found[i, j] = [np.count_nonzero(levels > cut) for cut in cuts]
        return found * self.pitch**2


def with_length(fields: Fields, reflectance: float, length: float, pitch: float) -> Fields:
    """Return fields whose subsurface scattering has another length [mm]: only its kernel depends on it.

    At 0 there is no scattering: light leaves where it entered.

    Parameters
    ----------
    fields : Fields
    reflectance : float
        Diffuse reflectance of the body [1].
    length : float
        Transport mean free path [mm].
    pitch : float
        Of the contact grid [mm].

    Returns
    -------
    Fields
    """
    if length == 0.0:
        return replace(fields, subsurface=None)
    if fields.subsurface is None:
        raise ValueError("the fields have no subsurface scattering")
    cell, spread = spread_of(reflectance, length, GRID_MM, pitch, fields.subsurface.spread.beyond)
    return replace(fields, subsurface=replace(fields.subsurface, cell=cell, spread=spread))


def blur_mm(camera: Camera) -> float:
    """Return the standard deviation on the plate [mm] of lens (disc and Airy core) and the chain's Gaussian of 1 px.

    Parameters
    ----------
    camera : Camera

    Returns
    -------
    float
    """
    m = magnification(camera.scale_px_per_mm, camera.pixel.pitch_um)
    number = working_f_number(camera.lens.f_number, m)
    disc = float(defocus_disc(camera.lens.defocus_um, number))
    airy = 0.45 * camera.wavelength_nm * 1e-3 * number  # Gaussian of the Airy core's width
    return 1e-3 / m * math.sqrt(disc**2 / 16 + airy**2 + camera.pixel.pitch_um**2)


def _charge_per_irradiance(camera: Camera) -> float:
    """Return e- per ms of exposure and W mm^-2 on the sensor; in colour of a filter with response 1."""
    unit = camera.model_copy(update={"exposure_ms": 1.0, "colour": None})
    lit, dark = (float(charge_of(SensorLight(irradiance=np.full((1, 1), e)), unit)[0, 0]) for e in (1e-6, 0.0))
    return (lit - dark) * 1e6


def grey_levels(charge: Array, camera: Camera) -> NDArray[np.float32]:
    """Return grey levels 0 to 1 of a charge [e-], with saturation, without noise or rounding.

    Parameters
    ----------
    charge : ndarray
        [e-].
    camera : Camera

    Returns
    -------
    ndarray of float32
    """
    pixel = camera.pixel
    signal = np.minimum(charge, pixel.full_well_capacity_e) * (camera.analogue_gain / pixel.conversion_gain_e_per_DN)
    light = np.clip(signal / (2**pixel.bits - 1 - pixel.black_level_DN), 0.0, 1.0)
    steps = np.linspace(0.0, 1.0, 1025)
    # evenly in the root of light: the curves are steep at the dark end
    return np.asarray(np.interp(np.sqrt(light), steps, CURVES[camera.tone_curve](steps**2)), np.float32)


def middle_open(share: Array, period: float) -> bool:
    """Return whether some cell within one ridge's period [cells] of the grid's middle is not in contact.

    Parameters
    ----------
    share : ndarray (rows, cols)
        Share of each cell in contact.
    period : float
        Of the ridges [cells].

    Returns
    -------
    bool
    """
    reach, (rows, cols) = math.ceil(period / 2) + 1, share.shape
    middle = share[rows // 2 - reach : rows // 2 + reach + 1, cols // 2 - reach : cols // 2 + reach + 1]
    return bool(middle.min() < 0.5)
