"""Estimated area against LED voltage at a fixed threshold, and where its excess over the true area comes from.

Light is linear in LED power, so that a force is rendered once and its irradiance is scaled to every voltage. The frame
is exposed and segmented anew at each voltage, with the noise, the saturation and the rounding that belong to it. Lens
distortion is left out, as if it had been undone without error: scale is another study's subject.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.chain.simulate import Render, solve_contact
from evanesce.core import rng
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, SensorLight
from evanesce.effects import Context, Stage, active_effects, apply_stage
from evanesce.measurement.reference.segment import TRUNCATE, Chain, segment
from evanesce.optics.led import each_led_power
from evanesce.optics.projection import Projection
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Camera, Scene
from evanesce.sensor.expose import charge_of, frame_of, signal_of
from evanesce.sensor.lens import form_image
from evanesce.sensor.tone import CURVES

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Source = Literal["subsurface scattering", "blur", "saturation", "specks"]
SOURCES: tuple[Source, ...] = get_args(Source)
Omitted = frozenset[Source]
NOTHING: Omitted = frozenset()

MARGIN_MM = 6.0
"""Around the contact: scattered light beyond it is below any threshold in use, at the LEDs' rated voltage as well."""

UNLIMITED_WELL_E = 1e12
"""A full well that no exposure fills [e-]."""

DEFAULT_LENGTH_MM = 0.5
DEFAULT_SPECKS_PER_CM2 = 418.0


def study_scene(scene: Scene) -> tuple[Scene, list[str]]:
    """Return a scene with the effects that the study switches off, and notes of what was added.

    A scene without subsurface scattering or specks gets them: without scattering no light enters the grooves.
    """
    notes = []
    effects: dict[str, Any] = {name: dict(table) for name, table in scene.effects.items()}
    if scene.finger.scattering_length_mm == 0 and "lateral_glow" not in effects:
        effects["lateral_glow"] = {"length_mm": DEFAULT_LENGTH_MM}
        notes.append(f"lateral_glow.length_mm = {DEFAULT_LENGTH_MM:g}: not in the scene, not published")
    if "specks" not in effects:
        effects["specks"] = {"per_cm2": DEFAULT_SPECKS_PER_CM2}
        notes.append(f"specks.per_cm2 = {DEFAULT_SPECKS_PER_CM2:g}: not in the scene; counted on the rig's photograph")
    return scene.model_copy(update={"effects": effects}), notes


def without_sources(scene: Scene, omitted: Omitted) -> Scene:
    """Return a scene without subsurface scattering or specks (blur and saturation belong to the camera)."""
    effects = dict(scene.effects)
    finger = scene.finger
    if "subsurface scattering" in omitted:
        effects.pop("lateral_glow", None)
        finger = finger.model_copy(update={"scattering_length_mm": 0.0})
    if "specks" in omitted:
        effects.pop("specks", None)
    return scene.model_copy(update={"effects": effects, "finger": finger})


def at_voltage(scene: Scene, voltage: float) -> Scene:
    """Return a scene whose LEDs' common supply is at another voltage [V]."""
    return scene.model_copy(update={"leds": scene.leds.model_copy(update={"voltage_V": voltage})})


def led_powers_of(scene: Scene) -> Array:
    """Return the power of every LED of a scene [W], edge by edge, after effects of the rig."""
    rig = apply_stage(Stage.RIG, scene, active_effects(scene), Context(scene, 0))
    return np.concatenate([np.zeros(0), *each_led_power(rig.plate, rig.leds).values()])


def power_ratio(scene: Scene, voltage: float) -> float | None:
    """Return the LEDs' power at a voltage over that at the scene's own; None where they do not all change alike."""
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
        """Return the frame's part around a contact; the whole where effects need the whole sensor."""
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
        return cls(
            max(0, int(v.min() - reach)), min(rows, int(v.max() + reach) + 1),
            max(0, int(u.min() - reach)), min(cols, int(u.max() + reach) + 1),
        )  # fmt: skip

    def of(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return the window's part of a frame."""
        return image[self.r0 : self.r1, self.c0 : self.c1]


def sensor_light(
    scene: Scene, force: float, omitted: Omitted, seed: int, render: Render
) -> tuple[Scene, ContactState, SensorLight]:
    """Return rig, truth and irradiance on the sensor of one press at the scene's voltage, without lens distortion."""
    scene = without_sources(scene, omitted)
    rig, state = solve_contact(scene, force, seed=seed)
    assert state is not None  # a force was given
    effects, context = active_effects(scene), Context(rig, seed)
    light = render(rig, state, seed=rng.integer_seed(seed, "render", 0))
    light = apply_stage(Stage.PLATE_LIGHT, light, effects, context)
    image = form_image(light, rig.camera, rig.plate, distortion=False, blurred="blur" not in omitted)
    return rig, state, apply_stage(Stage.SENSOR_LIGHT, image, effects, context)


def unclipped_levels(signal_DN: Array, camera: Camera) -> Array:
    """Return the grey levels [DN of 8 bits, whole] of a readout and a tone curve that have no upper end."""
    pixel = camera.pixel
    raw = np.maximum(np.floor(signal_DN + 0.5), 0.0)
    light = np.maximum(raw - pixel.black_level_DN, 0.0) / (2**pixel.bits - 1 - pixel.black_level_DN)
    return np.asarray(np.floor(255.0 * CURVES[camera.tone_curve](light) + 0.5))


def segment_levels(levels: Array, chain: Chain) -> Mask:
    """Segment grey levels that may exceed 255 by the reference segmentation."""
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
        """Render one force."""
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
        """Return the irradiance at another voltage: scaled, or rendered anew where LEDs do not all change alike."""
        ratio = power_ratio(self.scene, voltage)
        if ratio is not None:
            return np.asarray(self.dark + (self.irradiance - self.dark) * ratio)
        light = sensor_light(at_voltage(self.scene, voltage), self.force_N, self.omitted, self.seed, self.render)[2]
        return np.asarray(self.window.of(np.asarray(light.irradiance, float)))

    def levels(self, voltage: float, saturation: bool = True) -> NDArray[Any]:
        """Return the exposed frame's window [DN]: uint8, or floats beyond 255 without saturation.

        The same random numbers at every voltage.
        """
        camera = self.rig.camera
        effects, context = active_effects(self.scene), Context(self.rig, self.seed)
        if not saturation:
            pixel = camera.pixel.model_copy(update={"full_well_capacity_e": UNLIMITED_WELL_E})
            camera = camera.model_copy(update={"pixel": pixel})
        charge = charge_of(SensorLight(irradiance=self.at(voltage)), camera)
        charge = apply_stage(Stage.CHARGE, charge, effects, context)
        signal = signal_of(charge, camera, rng.generator(self.seed, "exposure", 0))
        signal = apply_stage(Stage.READOUT, signal, effects, context)
        if not saturation:
            return unclipped_levels(signal, camera)
        return np.asarray(apply_stage(Stage.FRAME, frame_of(signal, camera), effects, context).data)

    def area(self, voltage: float, chain: Chain, saturation: bool = True) -> float:
        """Return the area by the reference segmentation at a voltage [mm^2]."""
        return self.areas(voltage, [chain], saturation)[0]

    def areas(self, voltage: float, chains: Sequence[Chain], saturation: bool = True) -> list[float]:
        """Return the areas of the same frame by several settings of the segmentation [mm^2]."""
        levels = self.levels(voltage, saturation)
        find = (lambda c: segment(levels, c).mask) if saturation else (lambda c: segment_levels(levels, c))
        return [int(find(c).sum()) / self.rig.camera.scale_px_per_mm**2 for c in chains]


@dataclass(frozen=True, kw_only=True)
class Excess:
    """One force at one voltage; ``sum(parts) + residual + interaction`` is estimate less truth.

    Attributes
    ----------
    force_N, voltage_V, area_mm2, true_area_mm2 : float
    parts_mm2 : dict of str to float
        What each source adds while all others are present [mm^2].
    residual_mm2 : float
        Error with all four left out: threshold, gaps narrower than a wavelength, counting [mm^2].
    interaction_mm2 : float
    """

    force_N: float
    voltage_V: float
    area_mm2: float
    true_area_mm2: float
    parts_mm2: dict[Source, float]
    residual_mm2: float
    interaction_mm2: float

    def row(self) -> dict[str, Any]:
        """Return plain data, units in the keys."""
        return {
            "force_N": self.force_N,
            "voltage_V": self.voltage_V,
            "area_mm2": self.area_mm2,
            "true_area_mm2": self.true_area_mm2,
            "excess_mm2": self.area_mm2 - self.true_area_mm2,
            "parts_mm2": dict(self.parts_mm2),
            "residual_mm2": self.residual_mm2,
            "interaction_mm2": self.interaction_mm2,
        }


def excess_parts(area: Callable[[Omitted], float], true_area: float) -> tuple[dict[Source, float], float, float]:
    """Split the excess of a measured area over the true one by its sources.

    Parameters
    ----------
    area : callable
        ``area(omitted)`` [mm^2].
    true_area : float
        [mm^2].

    Returns
    -------
    parts : dict of str to float
        What each source adds while all others are present [mm^2].
    residual : float
        Excess with all sources omitted [mm^2].
    interaction : float
        Excess less residual and parts [mm^2].
    """
    full = area(NOTHING)
    parts: dict[Source, float] = {source: full - area(frozenset({source})) for source in SOURCES}
    residual = area(frozenset(SOURCES)) - true_area
    return parts, residual, full - true_area - residual - sum(parts.values())


def voltage_curve(
    scene: Scene,
    force: float,
    voltages: Sequence[float],
    chain: Chain,
    *,
    seed: int = 0,
    render: Render = render_fast,
    tick: Callable[[], None] = lambda: None,
) -> list[Excess]:
    """Return estimated area, true area and parts of the excess at each voltage, for one force.

    Parameters
    ----------
    scene : Scene
        From :func:`study_scene`.
    force : float
        [N].
    voltages : sequence of float
        [V].
    chain : Chain
        Fixed.
    seed : int
    render : Render
    tick : callable
        Called after each voltage.

    Returns
    -------
    list of Excess
        One per voltage.

    Raises
    ------
    InputError
        If the scene's own voltage leaves the LEDs dark, so that nothing could be scaled from it.
    """
    if not led_powers_of(scene).max(initial=0.0) > 0:
        raise InputError("no light at the scene's own voltage", key="leds.voltage_V", allowed="a voltage that lights")
    lit = {
        omitted: Press.of(scene, force, omitted - {"saturation"}, seed=seed, render=render)
        for omitted in (NOTHING, *(frozenset({s}) for s in SOURCES if s != "saturation"), frozenset(SOURCES))
    }
    lit[frozenset({"saturation"})] = lit[NOTHING]
    truth = lit[NOTHING].true_area_mm2
    rows = []
    for voltage in voltages:
        found = {omitted: press.area(voltage, chain, "saturation" not in omitted) for omitted, press in lit.items()}
        parts, residual, interaction = excess_parts(found.__getitem__, truth)
        rows.append(
            Excess(
                force_N=force, voltage_V=voltage, area_mm2=found[NOTHING], true_area_mm2=truth,
                parts_mm2=parts, residual_mm2=residual, interaction_mm2=interaction,
            )
        )  # fmt: skip
        tick()
    return rows
