"""Presses of the voltage study: light of one force, exposed at any LED voltage, with sources of excess switched off.

Light is linear in LED power, so that a force is rendered once and its irradiance is scaled to every voltage. Lens
distortion is left out, as if it had been undone without error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.chain.simulate import Render, solve_contact
from evanesce.core import rng
from evanesce.core.states import ContactState, SensorLight
from evanesce.effects import Context, Stage, active_effects, apply_stage
from evanesce.measurement.reference.segment import TRUNCATE, Chain, segment
from evanesce.optics.led import each_led_power
from evanesce.optics.projection import Projection
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Camera, Scene
from evanesce.sensor.colour import ImageProcessor
from evanesce.sensor.expose import charge_of, frame_of, signal_of
from evanesce.sensor.lens import form_image
from evanesce.sensor.response import led_response
from evanesce.sensor.tone import CURVES
from evanesce.studies.voltage.grey import GREY, bilinear
from evanesce.studies.voltage.sources import NOTHING, Omitted, at_voltage, without_sources

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
MARGIN_MM = 6.0
"""Around the contact: scattered light beyond it is below any threshold in use, at the LEDs' rated voltage as well."""

UNLIMITED_WELL_E = 1e12
"""A full well that no exposure fills [e-]."""


def led_powers_of(scene: Scene) -> Array:
    """Return the power of every LED of a scene [W], edge by edge, after effects of the rig.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    ndarray (leds,)
        [W].
    """
    rig = apply_stage(Stage.RIG, scene, active_effects(scene), Context(scene, 0))
    return np.concatenate([np.zeros(0), *each_led_power(rig.plate, rig.leds).values()])


def power_ratio(scene: Scene, voltage: float) -> float | None:
    """Return the LEDs' power at a voltage over that at the scene's own; None where they do not all change alike.

    Parameters
    ----------
    scene : Scene
    voltage : float
        [V].

    Returns
    -------
    float or None
        [1].
    """
    here, there = led_powers_of(scene), led_powers_of(at_voltage(scene, voltage))
    if not here.max(initial=0.0) > 0:
        return None
    ratio = there[here > 0] / here[here > 0]
    alike = np.allclose(ratio, ratio[0], rtol=1e-9, atol=0) and not there[here == 0].any()
    return float(ratio[0]) if alike else None


@dataclass(frozen=True)
class Window:
    """Part of the frame in which contact may be found: rows r0 to r1, columns c0 to c1."""

    r0: int
    r1: int
    c0: int
    c1: int

    @classmethod
    def around(cls, scene: Scene, state: ContactState, margin: float = MARGIN_MM) -> Window:
        """Return the frame's part around a contact; the whole where effects need the whole sensor.

        Parameters
        ----------
        scene : Scene
        state : ContactState
        margin : float
            [mm].

        Returns
        -------
        Window
        """
        cols, rows = scene.camera.resolution_px
        late = (Stage.CHARGE, Stage.READOUT, Stage.FRAME)
        contact = np.asarray(state.contact_mask) > 0
        if any(e.effect.stage in late for e in active_effects(scene)) or not contact.any():
            return cls(0, rows, 0, cols)
        at_rows, at_cols = np.nonzero(contact)
        x, y = state.grid.x[at_cols], state.grid.y[at_rows]
        corners = np.array([(a, b) for a in (x.min(), x.max()) for b in (y.min(), y.max())])
        projection = Projection.of(scene.camera, scene.plate)
        u, v = projection.plate_to_ray(corners[:, 0], corners[:, 1])
        px, py = projection.principal_point
        reach = margin * scene.camera.scale_px_per_mm
        u, v = u * projection.focal_px + px, v * projection.focal_px + py
        r0, c0 = max(0, int(v.min() - reach)), max(0, int(u.min() - reach))
        if scene.camera.colour is not None:  # the filter mosaic goes on from an even pixel as from the first
            r0, c0 = r0 // 2 * 2, c0 // 2 * 2
        return cls(r0, min(rows, int(v.max() + reach) + 1), c0, min(cols, int(u.max() + reach) + 1))

    def of(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return the window's part of a frame.

        Parameters
        ----------
        image : ndarray (rows, cols)

        Returns
        -------
        ndarray
        """
        return image[self.r0 : self.r1, self.c0 : self.c1]


def sensor_light(
    scene: Scene, force: float, omitted: Omitted, seed: int, render: Render
) -> tuple[Scene, ContactState, SensorLight]:
    """Return rig, truth and irradiance on the sensor of one press at the scene's voltage, without lens distortion.

    Parameters
    ----------
    scene : Scene
    force : float
        [N].
    omitted : frozenset of str
        Of :data:`SOURCES`.
    seed : int
    render : Render

    Returns
    -------
    rig : Scene
        After effects of the rig.
    state : ContactState
    light : SensorLight
    """
    scene = without_sources(scene, omitted)
    rig, state = solve_contact(scene, force, seed=seed)
    assert state is not None  # a force was given
    effects, context = active_effects(scene), Context(rig, seed)
    light = render(rig, state, seed=rng.integer_seed(seed, "render", 0))
    light = apply_stage(Stage.PLATE_LIGHT, light, effects, context)
    image = form_image(light, rig.camera, rig.plate, distortion=False, blurred="blur" not in omitted)
    return rig, state, apply_stage(Stage.SENSOR_LIGHT, image, effects, context)


def unclipped_levels(signal_DN: Array, camera: Camera) -> Array:
    """Return the grey levels [DN of 8 bits, whole] of a readout and a tone curve that have no upper end.

    Parameters
    ----------
    signal_DN : ndarray (rows, cols)
        Raw signal [DN].
    camera : Camera

    Returns
    -------
    ndarray (rows, cols)
    """
    pixel = camera.pixel
    raw = np.maximum(np.floor(signal_DN + 0.5), 0.0)
    light = np.maximum(raw - pixel.black_level_DN, 0.0) / (2**pixel.bits - 1 - pixel.black_level_DN)
    return np.asarray(np.floor(255.0 * CURVES[camera.tone_curve](light) + 0.5))


def unclipped_colour(signal_DN: Array, camera: Camera) -> Array:
    """Return grey levels [DN of 8 bits, whole] of a mosaic whose raw values and matrix have no upper end.

    Bilinear demosaicing, white balance, colour matrix (cut at 0), the chain's grey of the curves' values.

    Parameters
    ----------
    signal_DN : ndarray (rows, cols)
        Raw signal of the mosaic [DN].
    camera : Camera
        With a table ``colour``.

    Returns
    -------
    ndarray (rows, cols)
    """
    assert camera.colour is not None
    pixel, processor = camera.pixel, ImageProcessor.of(camera)
    raw = np.maximum(np.floor(signal_DN + 0.5) - pixel.black_level_DN, 0.0) / (2**pixel.bits - 1 - pixel.black_level_DN)
    balanced = bilinear(raw, camera.colour.mosaic) * processor.gains
    linear = np.maximum(balanced @ np.array(processor.matrix).T, 0.0)
    return np.asarray(np.floor(255.0 * (CURVES[camera.tone_curve](linear) @ GREY) + 0.5))


def segment_levels(levels: Array, chain: Chain) -> Mask:
    """Segment grey levels that may exceed 255 by the reference segmentation.

    Parameters
    ----------
    levels : ndarray (rows, cols)
        [DN of 255].
    chain : Chain

    Returns
    -------
    ndarray of bool (rows, cols)
    """
    blurred = ndimage.gaussian_filter(levels / 255.0, chain.blur, mode="nearest", truncate=TRUNCATE)
    bright = np.where(blurred > chain.threshold, 255, 0).astype(np.uint8)
    plain = Chain(threshold=0.5, min_blob=chain.min_blob, blur=0.0, radius=chain.radius)
    return np.asarray(segment(bright, plain).mask)


@dataclass(frozen=True)
class Press:
    """One force: truth, and light on the window at the scene's voltage.

    Attributes
    ----------
    scene : Scene
        As the study describes it.
    rig : Scene
        After effects of the rig.
    force_N, true_area_mm2 : float
    irradiance : ndarray
        In the window, at the scene's voltage [W mm^-2].
    dark : ndarray or float
        Part of it that no LED made [W mm^-2].
    window : Window
    omitted : frozenset of str
    seed : int
    """

    scene: Scene
    rig: Scene
    force_N: float
    true_area_mm2: float
    irradiance: Array
    dark: Array | float
    window: Window
    omitted: Omitted
    seed: int
    render: Render

    @classmethod
    def of(
        cls, scene: Scene, force: float, omitted: Omitted = NOTHING, *, seed: int = 0, render: Render = render_fast
    ) -> Press:
        """Render one force.

        Parameters
        ----------
        scene : Scene
            From :func:`study_scene`.
        force : float
            [N].
        omitted : frozenset of str
            Of :data:`SOURCES`.
        seed : int
        render : Render

        Returns
        -------
        Press
        """
        rig, state, light = sensor_light(scene, force, omitted, seed, render)
        # The window must not depend on what is left out: noise is drawn over it.
        window = Window.around(scene, state)
        dark: Array | float = 0.0
        constant = {e.effect.id for e in active_effects(scene) if e.effect.id == "ambient_light"}
        if constant:
            dark = window.of(
                np.asarray(sensor_light(at_voltage(scene, 0.0), force, omitted, seed, render)[2].irradiance)
            )
        irradiance = window.of(np.asarray(light.irradiance, float))
        return cls(scene, rig, force, state.nominal_contact_area, irradiance, dark, window, omitted, seed, render)

    def at(self, voltage: float) -> Array:
        """Return the irradiance at another voltage: scaled, or rendered anew where LEDs do not all change alike.

        Parameters
        ----------
        voltage : float
            [V].

        Returns
        -------
        ndarray (rows, cols)
            [W mm^-2].
        """
        ratio = power_ratio(self.scene, voltage)
        if ratio is not None:
            return np.asarray(self.dark + (self.irradiance - self.dark) * ratio)
        light = sensor_light(at_voltage(self.scene, voltage), self.force_N, self.omitted, self.seed, self.render)[2]
        return np.asarray(self.window.of(np.asarray(light.irradiance, float)))

    def levels(self, voltage: float, saturation: bool = True) -> NDArray[Any]:
        """Return the exposed frame's window [DN]: uint8, or floats beyond 255 without saturation.

        The same random numbers at every voltage.

        Parameters
        ----------
        voltage : float
            [V].
        saturation : bool

        Returns
        -------
        ndarray (rows, cols) or (rows, cols, 3)
            Colour of a colour camera; without saturation the chain's grey of it.
        """
        camera = self.rig.camera
        effects, context = active_effects(self.scene), Context(self.rig, self.seed)
        if not saturation:
            pixel = camera.pixel.model_copy(update={"full_well_capacity_e": UNLIMITED_WELL_E})
            camera = camera.model_copy(update={"pixel": pixel})
        charge = charge_of(SensorLight(irradiance=self.at(voltage)), camera, response=led_response(self.rig))
        charge = apply_stage(Stage.CHARGE, charge, effects, context)
        signal = signal_of(charge, camera, rng.generator(self.seed, "exposure", 0))
        signal = apply_stage(Stage.READOUT, signal, effects, context)
        if not saturation:
            return unclipped_levels(signal, camera) if camera.colour is None else unclipped_colour(signal, camera)
        return np.asarray(apply_stage(Stage.FRAME, frame_of(signal, camera), effects, context).data)

    def area(self, voltage: float, chain: Chain, saturation: bool = True) -> float:
        """Return the area by the reference segmentation at a voltage [mm^2].

        Parameters
        ----------
        voltage : float
            [V].
        chain : Chain
        saturation : bool

        Returns
        -------
        float
        """
        return self.areas(voltage, [chain], saturation)[0]

    def areas(self, voltage: float, chains: Sequence[Chain], saturation: bool = True) -> list[float]:
        """Return the areas of the same frame by several settings of the segmentation [mm^2].

        Parameters
        ----------
        voltage : float
            [V].
        chains : sequence of Chain
        saturation : bool

        Returns
        -------
        list of float
        """
        levels = self.levels(voltage, saturation)
        find = (lambda c: segment(levels, c).mask) if saturation else (lambda c: segment_levels(levels, c))
        return [int(find(c).sum()) / self.rig.camera.scale_px_per_mm**2 for c in chains]
