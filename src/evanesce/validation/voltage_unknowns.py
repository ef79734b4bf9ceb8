"""For which unpublished parameters the thesis's observation on voltage holds, and where the area error is least.

Every sample of the unknowns is a rig of its own: contact, fast light on the contact grid (without a camera's pixels),
a blur as wide as lens and chain together, exposure, tone curve, threshold. Variance is attributed by Sobol' indices.
Contact and light depend on some unknowns only, and samples that share those share them.

References
----------
A. Saltelli, P. Annoni, I. Azzini, F. Campolongo, M. Ratto and S. Tarantola, "Variance based sensitivity analysis of
model output", Computer Physics Communications 181 (2010) 259.
W. Usher et al., "SALib", Journal of Open Source Software 2(9) (2017) 97, doi:10.21105/joss.00097.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.contact.solve import contact_state
from evanesce.errors import InputError
from evanesce.extras import require
from evanesce.optics.glow import profile_kernel
from evanesce.optics.led import radiant_power
from evanesce.provenance import digest
from evanesce.render.fields import Fields, fields_of
from evanesce.render.glow import GLOW_CELL
from evanesce.render.transport import patch_radiance
from evanesce.rig import Camera, Ridges, Scene
from evanesce.rig.finger import HertzLaw
from evanesce.sensor.expose import charge_of
from evanesce.sensor.lens import defocus_disc, irradiance_per_radiance, magnification, working_f_number
from evanesce.sensor.tone import CURVES
from evanesce.states import SensorLight

Array = NDArray[np.float64]

GRID_MM, GRID_SAMPLES = 12.8, 400
THRESHOLDS = (0.0375, 0.05, 0.075, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7, 0.8, 0.9)
"""Grey levels among which the best is sought; four of them are in use in the thesis."""

RATIOS = tuple(float(r) for r in np.round(np.arange(0.05, 1.0, 0.05), 2))
"""Linear light over the contact's own mean at which the area is cut, free of voltage and exposure."""

SEEN = 0.05
"""Share of the true area below which there is nothing to segment."""
FLAT = 0.05
"""Change of the estimate, relative to the last voltage, within which it has converged."""


@dataclass(frozen=True)
class Unknown:
    """A figure that the thesis does not publish (or that may differ at the ridges' scale), and where it may lie."""

    name: str
    low: float
    high: float
    unit: str
    logarithmic: bool
    why: str

    def value(self, share: Array) -> Array:
        """Return values at shares 0 to 1 of the range."""
        if self.logarithmic:
            return np.asarray(self.low * (self.high / self.low) ** share)
        return np.asarray(self.low + (self.high - self.low) * share)


UNKNOWNS = (
    Unknown("scattering_length", 0.25, 2.0, "mm", True, "PDMS phantoms 0.5 to 2 mm; deadened silicone less"),
    Unknown("ridge_pitch", 0.6, 1.5, "mm", True, "not published; ridges are 0.5 mm wide"),
    Unknown("reduced_modulus", 0.3, 6.0, "MPa", True, "0.77 by Hertz on glass, 1.8 in indentation"),
    Unknown("forward_voltage", 2.8, 3.3, "V", False, "bins of white LEDs at 20 mA"),
    Unknown("exposure", 1.0, 33.0, "ms", True, "not published; at most a frame's time at 30 Hz"),
    Unknown("threshold", 0.0375, 0.6, "1", True, "by hand; 0.0375, 0.15, 0.35 and 0.6 are in use"),
)  # fmt: skip
SHAPING = 3
"""The first so many unknowns change contact or light; the others only scale the light or cut it."""


@dataclass(frozen=True)
class Plan:
    """What is asked of the samples.

    Attributes
    ----------
    forces, voltages : tuple of float
        [N], [V], ascending.
    base : int
        N of the Saltelli sample, a power of two; N (unknowns + 2) samples in all.
    seed : int
    """

    forces: tuple[float, ...]
    voltages: tuple[float, ...]
    base: int = 64
    seed: int = 1

    def shares(self) -> Array:
        """Return the sample, (samples, unknowns), as shares of each range."""
        require("design", "a sample of the unknowns", "SALib")
        from SALib.sample import sobol  # type: ignore[import-untyped]

        return np.asarray(sobol.sample(problem(), self.base, calc_second_order=False, seed=self.seed))


def problem() -> dict[str, Any]:
    """Return the unknowns as SALib wants them, each from 0 to 1."""
    names = [u.name for u in UNKNOWNS]
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}


@dataclass(frozen=True)
class Samples:
    """Areas of all samples.

    Attributes
    ----------
    plan : Plan
    values : ndarray (samples, unknowns)
        In the unknowns' units.
    true_area : ndarray (samples, forces)
        [mm^2].
    own : ndarray (samples, forces, voltages)
        Area at the sample's own threshold [mm^2].
    area : ndarray (samples, forces, voltages, thresholds)
        [mm^2].
    by_ratio : ndarray (samples, forces, RATIOS)
        Area brighter than that share of the contact's own mean light [mm^2].
    open_middle : ndarray of bool (samples, forces)
        Whether the grooves next to the middle are open.
    """

    plan: Plan
    values: Array
    true_area: Array
    own: Array
    area: Array
    by_ratio: Array
    open_middle: NDArray[np.bool_]

    @property
    def independent(self) -> NDArray[np.intp]:
        """Rows that are independent of each other: A and B of each of Saltelli's blocks."""
        block = len(UNKNOWNS) + 2
        starts = np.arange(0, len(self.values), block)
        return np.sort(np.concatenate([starts, starts + block - 1]))


@dataclass(frozen=True)
class Lit:
    """Presses of one finger: images of charge per ms and LED watt, and the like-named arrays of :class:`Samples`."""

    images: list[Array]
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

    def light(self, values: Array) -> Lit:
        """Return what the first :data:`SHAPING` unknowns make, by force."""
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
        images, areas, ratios, opened = [], [], [], []
        for force in self.plan.forces:
            state = contact_state(scene, force)
            radiance, _ = patch_radiance(fields, state, refine=1)
            share = np.asarray(state.contact_mask, np.float64)
            images.append(np.asarray(radiance, float) * (self.unit * self.charge))
            areas.append(state.nominal_contact_area)
            spread = cv2.GaussianBlur(images[-1], (0, 0), self.sigma, borderType=cv2.BORDER_REPLICATE)
            own = float((images[-1] * share).sum() / max(share.sum(), 1e-12))
            ratios.append([np.count_nonzero(spread > r * own) * self.pitch**2 for r in RATIOS])
            opened.append(middle_open(share, pitch / self.pitch))
        return Lit(images, np.array(areas), np.array(ratios, float), np.array(opened))

    def areas(self, images: Sequence[Array], values: Array) -> Array:
        """Return areas (forces, voltages, thresholds + 1) [mm^2]; the last threshold is the sample's own."""
        forward, exposure, threshold = (float(v) for v in values[SHAPING:])
        circuit = self.scene.leds.circuit.model_copy(update={"forward_voltage_V": forward})
        powers = radiant_power(circuit, np.array(self.plan.voltages))
        cuts = (*THRESHOLDS, threshold)
        found = np.zeros((len(images), powers.size, len(cuts)))
        for i, image in enumerate(images):
            for j, power in enumerate(powers):
                levels = grey_levels(image * (exposure * power), self.scene.camera)
                levels = cv2.GaussianBlur(levels, (0, 0), self.sigma, borderType=cv2.BORDER_REPLICATE)
                found[i, j] = [np.count_nonzero(levels > cut) for cut in cuts]
        return found * self.pitch**2


def with_length(fields: Fields, reflectance: float, length: float, pitch: float) -> Fields:
    """Return fields whose lateral glow has another transport mean free path [mm]: only its kernel depends on it.

    At 0 there is no glow: light leaves where it entered.
    """
    if length == 0.0:
        return replace(fields, glow=None)
    if fields.glow is None:
        raise ValueError("fields without glow have no glow to change")
    cell = min(GLOW_CELL, max(length / 4, pitch))
    kernel = profile_kernel(reflectance, length, cell, math.ceil(GRID_MM / cell))
    return replace(fields, glow=replace(fields.glow, cell=cell, kernel=kernel))


def blur_mm(camera: Camera) -> float:
    """Return the standard deviation on the plate [mm] of lens (disc and Airy core) and the chain's Gaussian of 1 px."""
    m = magnification(camera.scale_px_per_mm, camera.pixel.pitch_um)
    number = working_f_number(camera.lens.f_number, m)
    disc = float(defocus_disc(camera.lens.defocus_um, number))
    airy = 0.45 * camera.wavelength_nm * 1e-3 * number  # Gaussian of the Airy core's width
    return 1e-3 / m * math.sqrt(disc**2 / 16 + airy**2 + camera.pixel.pitch_um**2)


def _charge_per_irradiance(camera: Camera) -> float:
    """Return e- per ms of exposure and W mm^-2 on the sensor."""
    unit = camera.model_copy(update={"exposure_ms": 1.0})
    lit, dark = (float(charge_of(SensorLight(irradiance=np.full((1, 1), e)), unit)[0, 0]) for e in (1e-6, 0.0))
    return (lit - dark) * 1e6


def grey_levels(charge: Array, camera: Camera) -> NDArray[np.float32]:
    """Return grey levels 0 to 1 of a charge [e-], with saturation, without noise or rounding."""
    pixel = camera.pixel
    signal = np.minimum(charge, pixel.full_well_capacity_e) * (camera.analogue_gain / pixel.conversion_gain_e_per_DN)
    light = np.clip(signal / (2**pixel.bits - 1 - pixel.black_level_DN), 0.0, 1.0)
    steps = np.linspace(0.0, 1.0, 1025)
    # evenly in the root of light: the curves are steep at the dark end
    return np.asarray(np.interp(np.sqrt(light), steps, CURVES[camera.tone_curve](steps**2)), np.float32)


def middle_open(share: Array, period: float) -> bool:
    """Tell whether some cell within one ridge's period [cells] of the grid's middle is not in contact."""
    reach, (rows, cols) = math.ceil(period / 2) + 1, share.shape
    middle = share[rows // 2 - reach : rows // 2 + reach + 1, cols // 2 - reach : cols // 2 + reach + 1]
    return bool(middle.min() < 0.5)


def run_samples(
    scene: Scene, plan: Plan, *, keep: Path | None = None, tick: Callable[[int, int], None] = lambda done, total: None
) -> Samples:
    """Compute all samples.

    Parameters
    ----------
    scene : Scene
        Ridged; ``UNKNOWNS`` take the place of its own figures, effects are left out.
    plan : Plan
    keep : Path, optional
        File in which finished samples are kept, and from which an interrupted run goes on.
    tick : callable
        ``tick(done, total)`` samples.

    Raises
    ------
    InputError
        If the scene has no ridges, or LEDs of different voltages.
    """
    shares = plan.shares()
    values = np.stack([u.value(shares[:, k]) for k, u in enumerate(UNKNOWNS)], axis=1)
    total, forces = len(values), len(plan.forces)
    key = digest(
        [scene.as_dict(), values.tolist(), plan.forces, plan.voltages, THRESHOLDS, RATIOS, GRID_MM, GRID_SAMPLES]
    )
    shape = (total, forces, len(plan.voltages), len(THRESHOLDS) + 1)
    found = _resume(keep, key, shape)
    areas, done = found["areas"], found["done"]
    rig = ReducedRig(scene, plan) if not done.all() else None
    _, group = np.unique(values[:, :SHAPING], axis=0, return_inverse=True)
    for number in range(int(group.max()) + 1):
        members = np.flatnonzero((group.ravel() == number) & ~done)
        if rig is None or not members.size:
            continue
        lit = rig.light(values[members[0]])
        found["truth"][members], found["by_ratio"][members] = lit.true_area, lit.by_ratio
        found["opened"][members] = lit.open_middle
        for row in members:
            areas[row] = rig.areas(lit.images, values[row])
        done[members] = True
        tick(int(done.sum()), total)
        if keep is not None and number % 16 == 15:
            _keep(keep, key, found)
    if keep is not None:
        _keep(keep, key, found)
    return Samples(
        plan, values, found["truth"], areas[..., -1], areas[..., :-1], found["by_ratio"], found["opened"]
    )  # fmt: skip


def _resume(keep: Path | None, key: str, shape: tuple[int, int, int, int]) -> dict[str, NDArray[Any]]:
    fresh: dict[str, NDArray[Any]] = {
        "areas": np.zeros(shape),
        "truth": np.zeros(shape[:2]),
        "by_ratio": np.zeros((*shape[:2], len(RATIOS))),
        "opened": np.zeros(shape[:2], bool),
        "done": np.zeros(shape[0], bool),
    }
    if keep is None or not keep.is_file():
        return fresh
    try:
        with np.load(keep, allow_pickle=False) as data:
            same = str(data["key"]) == key
            found = {name: np.array(data[name]) for name in fresh}
    except (OSError, ValueError, KeyError, EOFError):
        return fresh
    fits = all(found[name].shape == fresh[name].shape and found[name].dtype == fresh[name].dtype for name in fresh)
    return found if same and fits else fresh


def _keep(path: Path, key: str, found: dict[str, NDArray[Any]]) -> None:
    handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
    try:
        with os.fdopen(handle, "wb") as stream:
            np.savez_compressed(stream, key=np.array(key), **found)  # type: ignore[arg-type]
        os.replace(part, path)
    except BaseException:
        Path(part).unlink(missing_ok=True)
        raise
