"""What a photographed checkerboard should look like: print, light and lens, with the library's effects along the way.

The share of bright print is drawn once, sharp, from the fitted geometry; blur and light then cost milliseconds. Fields
of light come from the effects' own code.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import PlateLight, SensorLight
from evanesce.effects import Context, all_effects
from evanesce.effects.readout.tone_curve import departed
from evanesce.inference.constants import WAVES
from evanesce.inference.discrepancy import cosines
from evanesce.inference.photograph.picture import Photograph
from evanesce.optics.projection import Projection
from evanesce.render.fast.defects import contact_radiance
from evanesce.rig import Scene
from evanesce.rig.leds import StripEdge
from evanesce.sensor.blur import blur, disc_mtf, field_blur
from evanesce.sensor.lens import field_radius2, form_image
from evanesce.sensor.tone import CURVES

Array = NDArray[np.float64]
Point = Mapping[str, float]

SIDES = ("left", "right", "top", "bottom")
UNEVEN = "uneven_light"
COSINES = tuple((i, j) for i in range(4) for j in range(4) if 0 < i + j <= 3)
SHIFTS = tuple(f"@shift_{axis}[{k}]" for axis in "xy" for k in range(WAVES**2))
FINE = 8
"""Samples to a bin at which a kernel is drawn."""
INK_MOVED_BINS = 0.01
"""By so much the ink's edge has to move for the print to be drawn anew."""
KEPT = 64
"""Fields kept: some hundred megabytes at the working size."""


@functools.lru_cache(maxsize=256)
def edge_kernel(spread: float, disc: float, dx: float = 0.0, dy: float = 0.0) -> Array:
    """Return the light that a point sends into each bin: a disc of defocus, a Gaussian, and the bin's own square.

    Parameters
    ----------
    spread : float
        Standard deviation along an axis, without the bin's square [bins].
    disc : float
        Share of the variance that the disc has: its diameter is 4 spread sqrt(disc) [1].
    dx, dy : float
        Place of the point beside the middle of its bin [bins].

    Returns
    -------
    ndarray (k, k), k odd
        Sum 1.

    Notes
    -----
    Defocus of an ideal lens spreads a point over a disc of uniform light; what else softens an edge (aberrations,
    diffraction, demosaicking, sharpening) is taken as Gaussian. A disc's edge is steeper than a Gaussian's of the same
    variance by up to 4 % of the step.
    """
    diameter, rest = 4.0 * spread * math.sqrt(disc), spread * math.sqrt(max(1.0 - disc, 0.0))
    half = math.ceil(diameter / 2 + 4.0 * rest + 1.0)
    size = (2 * half + 1) * FINE
    f = np.fft.fftfreq(size, d=1.0 / FINE)
    u, v = f[None, :], f[:, None]
    transfer = disc_mtf(np.hypot(u, v), diameter) * np.exp(-2.0 * (math.pi * rest) ** 2 * (u**2 + v**2))
    transfer = transfer * np.sinc(u) * np.sinc(v) * np.exp(-2j * math.pi * (u * dx + v * dy))
    index = np.arange(-half, half + 1) * FINE
    kernel = np.clip(np.fft.ifft2(transfer).real[np.ix_(index, index)], 0.0, None)
    return np.asarray(kernel / kernel.sum())


@dataclass
class LightModel:
    """Grey values of a photograph at a point; fields that do not change are kept.

    Nuisances: ``@bright``, ``@dark`` (relative light of the print, 1 = full scale), ``@blur`` (standard deviation of
    the even blur, bins), ``@disc`` (share of its variance that a disc has), ``@ink`` (spread of the dark print, mm) and
    ``@shift_x[k]``, ``@shift_y[k]`` (smooth shifts of the print, bins). Causes: ``<effect>:<parameter>``.
    """

    photograph: Photograph
    _kept: dict[Any, Array] = field(default_factory=dict, repr=False)
    _ink_mm: float = 0.0

    def anchor(self, point: Point) -> None:
        """Draw the print with a point's ink: from there on the ink's reach acts linearly."""
        if abs(point.get("@ink", 0.0) - self._ink_mm) * self.photograph.scene.camera.scale_px_per_mm > INK_MOVED_BINS:
            self._ink_mm = point["@ink"]
            self.__dict__.pop("_drawn", None)

    @functools.cached_property
    def _drawn(self) -> tuple[Array, dict[str, Array]]:
        return self.photograph.printed.drawn(self._ink_mm)

    def __call__(self, point: Point) -> Array:
        """Return the mean grey value of each bin (rows, cols) [DN]."""
        pixel = self.photograph.scene.camera.pixel
        light = self.linear(point)
        light = light + point.get("black_level:offset_DN", 0.0) / (2**pixel.bits - 1 - pixel.black_level_DN)
        value = CURVES[self.photograph.curve](np.clip(light, 0.0, 1.0))
        gamma, contrast = point.get("tone_curve:gamma", 0.0), point.get("tone_curve:contrast", 0.0)
        return np.asarray(255.0 * (departed(value, gamma, contrast) if gamma or contrast else value))

    def linear(self, point: Point) -> Array:
        """Return the relative light of each bin (rows, cols)."""
        bright, dark = point["@bright"], point["@dark"]
        print_light = dark + (bright - dark) * self.share(point) + bright * self.veil(point)
        return np.asarray(print_light * self.photograph.gain * self.shading(point))

    def share(self, point: Point) -> Array:
        """Return the blurred share of bright print (rows, cols)."""
        names = ("@ink", "@blur", "@disc", "defocus:corner_blur_um", *SHIFTS)
        return self._keep(
            ("share", self._ink_mm, *(point.get(n, 0.0) for n in names)), lambda: self.spread(self.sharp(point), point)
        )

    def sharp(self, point: Point) -> Array:
        """Return the share of bright print without blur (rows, cols)."""
        drawn, slopes = self._drawn
        total = drawn + (point.get("@ink", 0.0) - self._ink_mm) * slopes["ink"]
        waves = self._waves
        for axis in "xy":
            amounts = np.array([point.get(f"@shift_{axis}[{k}]", 0.0) for k in range(len(waves))])
            if amounts.any():
                total = total + (amounts @ waves).reshape(total.shape) * slopes[axis]
        return np.asarray(total)

    @functools.cached_property
    def _waves(self) -> Array:
        rows, cols = self.photograph.data.shape
        return cosines((rows, cols), WAVES).reshape(WAVES**2, -1)

    def spread(self, image: Array, point: Point) -> Array:
        """Blur an image (rows, cols) by the even blur and by what defocus adds towards the corners."""
        even, disc = point["@blur"], point["@disc"]
        corner = point.get("defocus:corner_blur_um", 0.0) / self.photograph.scene.camera.pixel.pitch_um
        # Discs of defocus on the axis and of curvature of field add before their size is taken.
        widths = np.abs(even + corner * self._field2)
        # Of a disc of diameter c the standard deviation is c/4: kernels of neighbouring widths blend by variance.
        return blur(image, field_blur(4.0 * widths, lambda c: edge_kernel(c / 4.0, disc)))

    @functools.cached_property
    def _field2(self) -> Array:
        projection = Projection.of(self.photograph.scene.camera, self.photograph.scene.plate)
        return field_radius2(projection.shape, projection.principal_point)

    def veil(self, point: Point) -> Array:
        """Return light added on the plate over that of bright print (rows, cols)."""
        total: Array = np.zeros(self.photograph.data.shape)
        for axis in "xy":
            if point.get(f"ambient_light:{axis}"):
                total = total + point[f"ambient_light:{axis}"] * self._ambient(axis)
        for side in SIDES:
            if point.get(f"led_edge_reflections:{side}"):
                total = total + point[f"led_edge_reflections:{side}"] * self._edge(side, point)
        if point.get("residue_film:relative_radiance"):
            total = total + point["residue_film:relative_radiance"] * self._film(point)
        return total

    def shading(self, point: Point) -> Array:
        """Return what multiplies the light (rows, cols): vignetting and uneven illumination of the print."""
        shape = self.photograph.data.shape
        total: Array = np.ones(shape)
        if point.get("vignetting:k"):
            effect = all_effects()["vignetting"]
            table = {
                "k": point["vignetting:k"],
                "centre_offset_px[0]": point["vignetting:centre_x_px"],
                "centre_offset_px[1]": point["vignetting:centre_y_px"],
            }
            lit = SensorLight(irradiance=total)
            context = Context(self.photograph.scene, seed=0)
            total = np.maximum(effect.apply(lit, effect.with_values(table), context).irradiance, 0.0)
        amounts = [point.get(f"{UNEVEN}:c{i}{j}", 0.0) for i, j in COSINES]
        if any(amounts):
            y, x = ((np.arange(k) + 0.5) * np.pi / k for k in shape)
            waves = sum(
                a * np.cos(j * y)[:, None] * np.cos(i * x)[None] for a, (i, j) in zip(amounts, COSINES, strict=True)
            )
            total = total * np.exp(waves)
        return np.asarray(total)

    def plate_field(self, effect_id: str, table: dict[str, Any], scene: Scene | None = None) -> Array:
        """Return what an effect adds on the plate, as the frame sees it without blur and without the lens's gain."""
        scene, effect = scene or self.photograph.scene, all_effects()[effect_id]
        view = Projection.of(scene.camera, scene.plate).ideal_view()
        zero = np.zeros(view.shape)
        dark = PlateLight(radiance=zero, variance=zero, focal_px=view.focal_px, principal_point=view.principal_point)
        lit = effect.apply(dark, effect.parameters(**table), Context(scene, seed=0))
        seen = form_image(lit, scene.camera, scene.plate, blurred=False).irradiance
        return np.asarray(seen / self._flat)

    @functools.cached_property
    def _flat(self) -> Array:
        scene = self.photograph.scene
        view = Projection.of(scene.camera, scene.plate).ideal_view()
        one = np.ones(view.shape)
        even = PlateLight(radiance=one, variance=0 * one, focal_px=view.focal_px, principal_point=view.principal_point)
        return np.asarray(form_image(even, scene.camera, scene.plate, blurred=False).irradiance, np.float64)

    @functools.cached_property
    def contact(self) -> float:
        """Radiance of a contact in the frame's middle, which effects on the plate are given relative to."""
        scene = self.photograph.scene
        return float(contact_radiance(scene, *(np.array(c) for c in scene.camera.centre_mm)))

    def _ambient(self, axis: str) -> Array:
        """Return what the effect's gradient adds to its even part, which cannot be separated from dark print."""
        gradient = (0.5, 0.0) if axis == "x" else (0.0, 0.5)
        table = {"radiance_W_per_mm2_sr": 1.0, "gradient": gradient}
        return self._keep(("ambient", axis), lambda: (self.plate_field("ambient_light", table) - 1.0) / 0.5)

    def _edge(self, side: str, point: Point) -> Array:
        """Return the veil of one side's LEDs, as they stand along their edge."""
        own = {name: point[f"led_edge_reflections:{name}"] for name in ("decay_mm", "along_mm", "offset_mm")}

        def made() -> Array:
            scene = self.photograph.scene
            edges = {e: StripEdge(offset_mm=own["offset_mm"]) for e in scene.leds.edges}
            scene = scene.model_copy(update={"leds": scene.leds.model_copy(update={"edge": edges})})
            sides = tuple(float(side == s) for s in SIDES)
            table = {"decay_mm": own["decay_mm"], "along_mm": own["along_mm"], "sides": sides}
            return self.plate_field("led_edge_reflections", {"relative_radiance": 1.0, **table}, scene) / self.contact

        return self._keep(("edge", side, *own.values()), made)

    def _film(self, point: Point) -> Array:
        x, y, radius = (point[f"residue_film:{name}"] for name in ("middle_x_mm", "middle_y_mm", "radius_mm"))
        table = {"relative_radiance": 1.0, "middle_mm": (x, y), "radius_mm": radius}
        return self._keep(("film", x, y, radius), lambda: self.plate_field("residue_film", table) / self.contact)

    def _keep(self, key: Any, made: Any) -> Array:
        if key not in self._kept:
            if len(self._kept) >= KEPT:
                for old in list(self._kept)[: KEPT // 2]:
                    del self._kept[old]
            self._kept[key] = made()
        return self._kept[key]
