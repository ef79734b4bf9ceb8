"""The reduced rig under a colour camera, with a lit flank and ground, exposed at will or by the published control.

Every pixel's grey follows from its light alone (:class:`~evanesce.studies.voltage.grey.GreyTable`): demosaicing, which
mixes neighbours, is left out; the lens blurs the light, before it is clipped, and the chain's Gaussian the grey.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.optics.led_circuit import radiant_power
from evanesce.rig import Camera, Scene
from evanesce.rig.colour import AutoExposure
from evanesce.sensor.automatic import settle
from evanesce.sensor.colour import ImageProcessor, channel_map
from evanesce.sensor.lens import magnification
from evanesce.sensor.response import led_response
from evanesce.studies.voltage.colour_unknowns import RED, SETTINGS, longest_exposure
from evanesce.studies.voltage.grey import GreyTable
from evanesce.studies.voltage.reduced_rig import LitPresses, ReducedRig, grey_levels
from evanesce.studies.voltage.unknowns import GRID_MM, RATIOS, SHAPING, THRESHOLD, THRESHOLDS, Plan

Array = NDArray[np.float64]

FILTERS, FLANK, CONTROL, APERTURE = 6, slice(7, 9), 9, 10
"""Places of the unknowns that the colour camera adds; flank and ground together."""

STATISTICS_CELLS = 4
"""Cells of the contact grid a side of a pixel of the exposure control's statistics."""


@dataclass(frozen=True)
class Reading:
    """How the light of a rig is read.

    Attributes
    ----------
    name : str
    colour : bool
        By the colour camera; else by a monochrome sensor as sensitive as the red pixels.
    surroundings : bool
        With flank and ground.
    control : bool or None
        Exposure by the published control; None: as the sample has it.
    red_leds : int
        Red LEDs of a segment, with the forward voltage of red LEDs; 0: as many as the scene has, at the voltage of a
        whole segment of white ones.
    """

    name: str
    colour: bool = True
    surroundings: bool = True
    control: bool | None = None
    red_leds: int = 0


SAMPLED = Reading("with colour, exposure fixed or automatic")
OTHERS = (
    Reading("without colour", colour=False, surroundings=False, control=False),
    Reading("without colour, automatic exposure", colour=False, surroundings=False, control=True),
    Reading("without colour, flank and ground lit", colour=False, control=False),
    Reading("without colour, flank and ground lit, automatic exposure", colour=False, control=True),
    Reading("with colour, fixed exposure", control=False),
    Reading("with colour, automatic exposure", control=True),
    Reading("with colour, automatic exposure, five red LEDs a segment", control=True, red_leds=5),
    Reading("with colour, fixed exposure, five red LEDs a segment", control=False, red_leds=5),
    Reading("with colour, automatic exposure, three red LEDs a segment", control=True, red_leds=3),
)


@dataclass(frozen=True)
class Lights:
    """One force, light over that which fills a raw red pixel in 1 ms at gain 1 and an LED power of 1 W [1].

    Attributes
    ----------
    image : ndarray (rows, cols)
        Blurred by the lens; without flank.
    bare : ndarray (rows, cols)
        Share of each cell within the finger's outline that is not in contact, blurred likewise.
    contact : float
        Mean over the contact, before the blur.
    """

    image: NDArray[np.float32]
    bare: NDArray[np.float32]
    contact: float

    def with_flank(self, share: float) -> NDArray[np.float32]:
        """Return the image with a flank of a share of the contact's light."""
        return self.image + np.float32(share * self.contact) * self.bare


class ColourRig(ReducedRig):
    """A scene with a colour camera on the contact grid."""

    def __init__(self, scene: Scene, plan: Plan) -> None:
        if scene.camera.colour is None:
            raise InputError("a monochrome camera", key="camera.colour", allowed="a colour camera")
        super().__init__(scene, plan)
        camera = self.scene.camera
        pixel = camera.pixel
        self.full_scale_e = (2**pixel.bits - 1 - pixel.black_level_DN) * pixel.conversion_gain_e_per_DN
        response = led_response(self.scene)
        assert response is not None
        # Light is counted in what fills a raw red pixel.
        self.red_share, self.own_response = response[0], (1.0, response[1] / response[0], response[2] / response[0])
        chain = 1e-3 * pixel.pitch_um / magnification(camera.scale_px_per_mm, pixel.pitch_um) / self.pitch
        self.chain_sigma = float(chain)  # the chain's Gaussian of 1 px [cells]
        self.lens_sigma = float(np.sqrt(max(self.sigma**2 - chain**2, 1e-12)))
        cols, rows = camera.resolution_px
        self.frame_mm2 = cols * rows / camera.scale_px_per_mm**2
        self.longest_ms = longest_exposure(scene)

    @cached_property
    def _inside(self) -> NDArray[np.float32]:
        """Cells within the finger's outline."""
        samples = round(GRID_MM / self.pitch)
        at = (np.arange(samples) + 0.5) * self.pitch - GRID_MM / 2
        radius = self.scene.finger.diameter_mm / 2
        return (np.hypot(at[:, None], at[None, :]) <= radius).astype(np.float32)

    @property
    def outer_mm2(self) -> float:
        """Area of the finger's outline beyond the grid, which only flank light reaches [mm^2]."""
        disc = np.pi / 4 * self.scene.finger.diameter_mm**2
        return max(0.0, float(disc - self._inside.sum() * self.pitch**2))

    @property
    def ground_mm2(self) -> float:
        """Area of the frame beside the finger [mm^2]."""
        return max(0.0, float(self.frame_mm2 - np.pi / 4 * self.scene.finger.diameter_mm**2))

    def lights(self, lit: LitPresses) -> list[Lights]:
        """Return what the readings of one finger share, by force.

        Parameters
        ----------
        lit : LitPresses

        Returns
        -------
        list of Lights
        """
        found = []
        for image, share in zip(lit.images, lit.shares, strict=True):
            light = np.asarray(image * (self.red_share / self.full_scale_e), np.float32)
            contact = float((light * share).sum() / max(float(share.sum()), 1e-12))
            bare = self._inside * (1 - np.asarray(share, np.float32))
            found.append(Lights(self._lens(light), self._lens(bare), contact))
        return found

    def _lens(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        blurred = cv2.GaussianBlur(image, (0, 0), self.lens_sigma, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(blurred, np.float32)

    def camera_of(self, setting: int) -> Camera:
        """Return the camera with one of the settings that the real frame allows.

        Parameters
        ----------
        setting : int
            Of :data:`~evanesce.studies.voltage.colour_unknowns.SETTINGS`; -1 keeps the scene's own.

        Returns
        -------
        Camera
        """
        camera = self.scene.camera
        assert camera.colour is not None
        if setting < 0:
            own = {"response": self.own_response}
            return camera.model_copy(update={"colour": camera.colour.model_copy(update=own)})
        temperature, green, blue = SETTINGS[setting]
        given = {
            "response": (1.0, green, blue),
            "temperature_K": float(temperature),
            "red_gain": None,
            "blue_gain": None,
        }
        return camera.model_copy(update={"colour": camera.colour.model_copy(update=given)})

    def settled(self, image: NDArray[np.float32], ground: float, contact: float, camera: Camera) -> float:
        """Return the contact's light level on which the exposure control settles, its limits left aside [1].

        Parameters
        ----------
        image : ndarray (rows, cols)
            Light on the grid [any unit].
        ground : float
            Light of the rest of the frame, in the same unit.
        contact : float
            Mean light of the contact, in the same unit.
        camera : Camera
            With ``colour.response``.

        Returns
        -------
        float
            Over what fills a raw red pixel.
        """
        assert camera.colour is not None
        size = STATISTICS_CELLS
        rows, cols = (n // size * size for n in image.shape)
        near = image[:rows, :cols].reshape(rows // size, size, -1, size).mean(axis=(1, 3))
        wide, high = (n / (camera.scale_px_per_mm * self.pitch * size) for n in camera.resolution_px)
        # the frame's middle; a frame smaller than the grid shows part of it
        around = [max(0, math.ceil((n - m) / 2)) for n, m in zip((high, wide), near.shape, strict=True)]
        whole = np.pad(near, [(n, n) for n in around], constant_values=ground) / contact
        response = np.asarray(camera.colour.response)[channel_map(whole.shape, camera.colour.mosaic)]
        # with this charge in 1 ms exposure times gain is the level
        one = camera.model_copy(update={"exposure_ms": 1.0, "auto_exposure": camera.auto_exposure or AutoExposure()})
        found, _ = settle(whole * response * self.full_scale_e, one)
        return found.exposure_ms * found.analogue_gain

    def doses(self, values: Array, reading: Reading, lights: Lights) -> Array:
        """Return LED power times exposure and gain at each voltage [W ms].

        Parameters
        ----------
        values : ndarray (unknowns,)
        reading : Reading
        lights : Lights

        Returns
        -------
        ndarray (voltages,)
        """
        forward, exposure = float(values[SHAPING]), float(values[SHAPING + 1])
        circuit = self.scene.leds.circuit
        if reading.red_leds:
            span = self.plan.unknowns[SHAPING]
            share = (forward - span.low) / (span.high - span.low)
            forward = float(RED.value(np.asarray(share)))
            circuit = circuit.model_copy(update={"leds_per_segment": reading.red_leds})
        circuit = circuit.model_copy(update={"forward_voltage_V": forward})
        aperture = (self.scene.camera.lens.f_number / float(values[APERTURE])) ** 2
        power = radiant_power(circuit, np.array(self.plan.voltages)) * aperture
        control = bool(values[CONTROL]) if reading.control is None else reading.control
        if not control:
            return np.asarray(exposure * power)
        flank, ground = (float(v) * reading.surroundings for v in values[FLANK])
        # a monochrome sensor's control sees the same level in all three channels
        camera = self.camera_of(int(values[FILTERS]))
        assert camera.colour is not None
        if not reading.colour:
            equal = camera.colour.model_copy(update={"response": (1.0, 1.0, 1.0), "red_gain": 1.0, "blue_gain": 1.0})
            camera = camera.model_copy(update={"colour": equal})
        level = self.settled(lights.with_flank(flank), ground * lights.contact, lights.contact, camera)
        return np.minimum(level / lights.contact, self.longest_ms * power)

    def read(
        self, lights: Sequence[Lights], values: Array, reading: Reading, cuts: Sequence[float]
    ) -> tuple[Array, Array]:
        """Return areas by threshold [mm^2], and the contact's mean light [1].

        Parameters
        ----------
        lights : sequence of Lights
            One per force.
        values : ndarray (unknowns,)
        reading : Reading
        cuts : sequence of float
            Thresholds, 0 to 1.

        Returns
        -------
        areas : ndarray (forces, voltages, cuts)
        contact : ndarray (forces, voltages)
            Over what fills a raw red pixel.
        """
        flank, ground = (float(v) * reading.surroundings for v in values[FLANK])
        areas = np.zeros((len(lights), len(self.plan.voltages), len(cuts)))
        contact = np.zeros(areas.shape[:2])
        grey = self._table(int(values[FILTERS])) if reading.colour else self._plain_grey
        for i, own in enumerate(lights):
            doses, image = self.doses(values, reading, own), own.with_flank(flank)
            contact[i] = own.contact * doses
            known: dict[float, Array] = {}  # the control gives many voltages the same light
            for j, dose in enumerate(doses):
                if dose not in known:
                    beside = np.array([flank, ground]) * contact[i, j]
                    known[dose] = self._areas(grey(image * np.float32(dose)), grey(beside), np.asarray(cuts))
                areas[i, j] = known[dose]
        return areas, contact

    def areas(self, lit: LitPresses, values: Array) -> Array:
        """Return areas as :meth:`ReducedRig.areas`, in colour, exposed as the values have it.

        Parameters
        ----------
        lit : LitPresses
        values : ndarray (unknowns,)

        Returns
        -------
        ndarray (forces, voltages, thresholds + 1)
        """
        return self.read(self.lights(lit), values, SAMPLED, (*THRESHOLDS, float(values[THRESHOLD])))[0]

    def by_ratio(self, lights: Sequence[Lights], values: Array) -> Array:
        """Return the area brighter than shares of the contact's mean light, as raw red pixels below full scale see it.

        Parameters
        ----------
        lights : sequence of Lights
        values : ndarray (unknowns,)

        Returns
        -------
        ndarray (forces, RATIOS)
            [mm^2].
        """
        flank, ground = (float(v) for v in values[FLANK])
        rows = []
        for own in lights:
            image = own.with_flank(flank) / np.float32(own.contact)
            rows.append(self._areas(image, np.array([flank, ground], np.float32), np.array(RATIOS)))
        return np.array(rows)

    def _areas(self, levels: NDArray[np.float32], beside: NDArray[np.float32], cuts: Array) -> Array:
        """Return the area above each threshold: on the grid, and of flank and ground beyond it [mm^2]."""
        levels = cv2.GaussianBlur(levels, (0, 0), self.chain_sigma, borderType=cv2.BORDER_REPLICATE)
        found = np.array([np.count_nonzero(levels > cut) for cut in cuts]) * self.pitch**2
        beyond = np.where(beside[0] > cuts, self.outer_mm2, 0.0) + np.where(beside[1] > cuts, self.ground_mm2, 0.0)
        return np.asarray(found + beyond)

    def _plain_grey(self, level: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Return the grey of a monochrome sensor; the light holds the gain already."""
        return grey_levels(
            np.asarray(level * self.full_scale_e), self.scene.camera.model_copy(update={"analogue_gain": 1.0})
        )

    def _table(self, setting: int) -> GreyTable:
        if setting not in self._tables:
            camera = self.camera_of(setting)
            assert camera.colour is not None
            assert camera.colour.response is not None
            self._tables[setting] = GreyTable(camera.colour.response, ImageProcessor.of(camera))
        return self._tables[setting]

    @cached_property
    def _tables(self) -> dict[int, GreyTable]:
        return {}
