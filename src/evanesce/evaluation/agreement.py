"""Agreement of the fast renderer with the path tracer: by regions of unseen contacts, noise subtracted."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.contact.solve import contact_state
from evanesce.core.states import ContactState, PlateLight
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.optics.projection import Projection
from evanesce.optics.seen import seen_at
from evanesce.rig import Scene, load_scene
from evanesce.sensor.expose import charge_of, frame_of, signal_of
from evanesce.sensor.lens import form_image

Array = NDArray[np.float64]

RIM_MM = 0.3
FLANK_MM = 2.0


@dataclass(frozen=True)
class Case:
    """A contact that both renderers render.

    Attributes
    ----------
    name : str
    scene : Scene
    state : ContactState
    """

    name: str
    scene: Scene
    state: ContactState


def two_patches(scene: Scene, force_N: float) -> ContactState:
    """Return two contacts of one finger's shape on one grid, unequal and off its middle.

    Parameters
    ----------
    scene : Scene
    force_N : float
        Of both together [N].

    Returns
    -------
    ContactState
    """
    grid = contact_state(scene, force_N).grid
    states, parts = [], []
    for (dx, dy), share in zip(((-2.3, 1.1), (2.6, -1.7)), (0.6, 0.4), strict=True):
        one = contact_state(scene, share * force_N)
        row, col = -round(dy / grid.pitch), -round(dx / grid.pitch)
        states.append(one)
        parts.append({name: _moved(getattr(one, name), row, col, name) for name in ("gap", "contact_mask", "pressure")})
    first, second = parts
    return dataclasses.replace(
        states[0],
        gap=np.minimum(first["gap"], second["gap"]),
        contact_mask=np.maximum(first["contact_mask"], second["contact_mask"]),
        pressure=first["pressure"] + second["pressure"],
        nominal_contact_area=sum(one.nominal_contact_area for one in states),
        normal_force=force_N,
        law="two patches",
        state=None,
        traction=None,
        slip=None,
        real_contact_fraction=None,
    )


def _moved(array: Any, row: int, col: int, name: str) -> Array:
    """Shift an array, filled beyond its border: far for gaps, nothing for the rest."""
    return np.asarray(
        ndimage.shift(np.asarray(array, float), (-row, -col), order=0, cval=1.0 if name == "gap" else 0.0)
    )


def _case(
    name: str, scene: str, force_N: float, changes: dict[str, Any], make: Callable[..., ContactState] = contact_state
) -> Case:
    loaded = load_scene(scene, changes)
    return Case(name, seen_at(loaded), make(loaded, force_N))


def cases(camera: dict[str, Any]) -> list[Case]:
    """Return the contacts on which the renderers are compared.

    Parameters
    ----------
    camera : dict
        Dotted keys of the scene for all of them.

    Returns
    -------
    list of Case
    """
    dead = {"left": {"relative_power": [1, 1, 0, 1, 1]}}
    soft = {"law": "hertz", "reduced_modulus_MPa": 0.16}
    return [
        _case("smooth, 5 N", "thesis", 5.0, camera),
        _case("smooth, small, 0.2 N", "thesis", 0.2, camera),
        _case("smooth, large, 9 N, soft", "thesis", 9.0, camera | {"contact": soft}),
        _case("ridged, 5 N", "thesis_ridged", 5.0, camera),
        _case("off-centre, 3 N", "thesis", 3.0, camera | {"finger.position_mm": [7.6, -4.7]}),
        _case("two patches, 2 N", "thesis", 2.0, camera, two_patches),
        _case("8.4 V, 4 N", "thesis", 4.0, camera | {"leds.voltage_V": 8.4}),
        _case("10.5 V, 4 N", "thesis", 4.0, camera | {"leds.voltage_V": 10.5, "camera.exposure_ms": 2.2}),
        _case("one LED dead, 4 N", "thesis", 4.0, camera | {"leds.edge": dead, "finger.position_mm": [-5.2, 3.1]}),
    ]


def coarser(factor: int) -> dict[str, Any]:
    """Return keys of a camera that sees the same field with pixels ``factor`` times as large.

    Parameters
    ----------
    factor : int

    Returns
    -------
    dict
        Dotted keys of a scene.
    """
    return {
        "camera.resolution_px": [2000 // factor, 1500 // factor],
        "camera.scale_px_per_mm": 58.37 / factor,
        "camera.pixel.pitch_um": 3.1 * factor,
        "camera.pixel.full_well_capacity_e": 8180.0 * factor**2,
        "camera.pixel.conversion_gain_e_per_DN": 2.13 * factor**2,
    }


@dataclass(frozen=True)
class Agreement:
    """Fast less reference.

    Attributes
    ----------
    mean_abs_DN : float
        Mean over blocks of the lit field of the absolute difference of means, the reference's noise subtracted [DN].
    noise_DN : float
        The same from the reference's noise alone [DN].
    regions : dict
        Difference of means by region: (difference, its standard error) [DN].
    area_bias : float
        Relative difference of the area that the reference segmentation counts [1].
    area_error : float
        Its standard error by the reference's noise [1].
    level : float
        Ratio of mean radiance inside the contact [1].
    level_error : float
        Its standard error [1].
    """

    mean_abs_DN: float
    noise_DN: float
    regions: dict[str, tuple[float, float]]
    area_bias: float
    area_error: float
    level: float
    level_error: float

    @property
    def worst(self) -> tuple[str, float]:
        """Region of the largest difference, and that [DN]."""
        return max(((name, d) for name, (d, _) in self.regions.items()), key=lambda item: abs(item[1]))


def picture(light: PlateLight, scene: Scene) -> Array:
    """Return the frame without noise, before its values are rounded to 8 bits.

    Parameters
    ----------
    light : PlateLight
    scene : Scene

    Returns
    -------
    ndarray (rows, cols)
        [DN of 255].
    """
    image = form_image(light, scene.camera, scene.plate)
    signal = signal_of(charge_of(image, scene.camera), scene.camera, None)
    raw = np.floor(signal)
    low, high = (frame_of(r, scene.camera).data.astype(float) for r in (raw, raw + 1))
    return np.asarray(low + (high - low) * (signal - raw))


def regions(case: Case) -> dict[str, NDArray[np.bool_]]:
    """Return the frame's regions: contact in quadrants, rim, beside it, the flank farther out.

    Parameters
    ----------
    case : Case

    Returns
    -------
    dict of ndarray of bool (rows, cols)
        Regions of at least 20 pixels.
    """
    projection = Projection.of(case.scene.camera, case.scene.plate)
    rows, cols = projection.shape
    u, v = np.meshgrid(np.arange(cols), np.arange(rows))
    x, y = projection.to_plate(u, v)
    grid = case.state.grid
    row, col = (np.round(i).astype(int) for i in grid.index(x, y))
    inside = (row >= 0) & (col >= 0) & (row < grid.shape[0]) & (col < grid.shape[1])
    row, col = np.where(inside, row, 0), np.where(inside, col, 0)
    mask = np.asarray(case.state.contact_mask) > 0.5
    depth = ndimage.distance_transform_edt(mask) * grid.pitch
    beyond = ndimage.distance_transform_edt(~mask) * grid.pitch
    depth = np.where(inside, depth[row, col], 0.0)
    beyond = np.where(inside, beyond[row, col], np.inf)
    core = depth > RIM_MM / 2
    middle = x[core].mean(), y[core].mean()
    found = {}
    for name, right, down in (("upper left", 0, 0), ("upper right", 1, 0), ("lower left", 0, 1), ("lower right", 1, 1)):
        found[f"contact, {name}"] = core & ((x > middle[0]) == bool(right)) & ((y > middle[1]) == bool(down))
    found["rim"] = (depth <= RIM_MM / 2) & (beyond <= RIM_MM / 2)
    found["beside"] = (beyond > RIM_MM / 2) & (beyond <= FLANK_MM)
    found["flank"] = (beyond > FLANK_MM) & (beyond <= 2 * FLANK_MM)
    found["farther out"] = beyond > 2 * FLANK_MM
    return {name: region for name, region in found.items() if region.sum() >= 20}


def agreement(
    case: Case, passes: list[PlateLight], fast: PlateLight, *, threshold: float = 0.15, block_px: int = 16
) -> Agreement:
    """Compare the fast renderer's light with independent renderings of the reference.

    Parameters
    ----------
    case : Case
    passes : list of PlateLight
        At least 2, of other seeds.
    fast : PlateLight
        On the same view.
    threshold : float
        Of the reference segmentation [1].
    block_px : int
        Side of the blocks [px].

    Returns
    -------
    Agreement
    """
    count = len(passes)
    mean_light = dataclasses.replace(passes[0], radiance=np.mean([p.radiance for p in passes], axis=0))
    mine, reference = picture(fast, case.scene), picture(mean_light, case.scene)
    each = np.array([picture(p, case.scene) for p in passes])
    found = {}
    for name, region in regions(case).items():
        values = each[:, region].mean(axis=1)
        found[name] = (
            float((mine - reference)[region].mean()),
            float(values.std(ddof=1) / np.sqrt(count)),
        )
    lit = _blocks((reference > 1.0).astype(float), block_px) > 0.5
    difference = _blocks(mine - reference, block_px)[lit]
    variance = np.var([_blocks(e, block_px)[lit] for e in each], axis=0, ddof=1).mean() / count
    # Absolute values do not subtract; the mean square does, and noise is Gaussian: |d| shrinks by the same ratio.
    square = max(float(np.mean(difference**2)) - float(variance), 0.0)
    mean_abs = float(np.abs(difference).mean()) * np.sqrt(square / max(float(np.mean(difference**2)), 1e-30))
    chain = Chain(threshold=threshold, min_blob=200)

    def area(image: Array) -> int:
        return segment(np.floor(np.clip(image, 0, 255) + 0.5).astype(np.uint8), chain).pixels

    areas = np.array([area(e) for e in each], float)
    core = np.any([r for n, r in regions(case).items() if n.startswith("contact")], axis=0)
    levels = np.array([_level(p, case, core) for p in passes])
    return Agreement(
        mean_abs_DN=mean_abs,
        noise_DN=float(np.sqrt(variance * 2 / np.pi)),
        regions=found,
        area_bias=area(mine) / max(area(reference), 1) - 1.0,
        area_error=float(areas.std(ddof=1) / np.sqrt(count) / max(areas.mean(), 1.0)),
        level=float(_level(fast, case, core) / levels.mean()),
        level_error=float(levels.std(ddof=1) / np.sqrt(count) / levels.mean()),
    )


def _level(light: PlateLight, case: Case, core: NDArray[np.bool_]) -> float:
    return float(form_image(light, case.scene.camera, case.scene.plate).irradiance[core].mean())


def _blocks(image: Array, side: int) -> Array:
    rows, cols = (n // side for n in image.shape)
    return np.asarray(image[: rows * side, : cols * side].reshape(rows, side, cols, side).mean(axis=(1, 3)))
