"""What the grey and the channels of a clipped colour frame say of pressure, and what raw red says at less exposure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.solve import contact_state
from evanesce.core import provenance, rng
from evanesce.core.states import Frame, SensorLight
from evanesce.evaluation.labels import label, view_geometry
from evanesce.measurement.pressure import pressure_map, reference_map
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.optics.projection import Projection
from evanesce.rig import Camera, Scene
from evanesce.sensor.expose import charge_of, frame_of, signal_of
from evanesce.sensor.response import led_response
from evanesce.studies.estimator.study import LitPress
from evanesce.studies.ledger import Keep, not_kept
from evanesce.studies.pressure.study import FORCES, MARGIN_PX, SLOPES, rough, roughness_curve
from evanesce.studies.voltage.grey import GREY, bilinear
from evanesce.studies.voltage.press import power_ratio

Floats = NDArray[np.float64]

THRESHOLD = 0.6
"""Of the segmentation whose dilated mask the thesis's map fills: the published scripts call the contact "above 0.6"."""
VOLTAGE = 9.0
BRIGHTEST = 0.9
"""Raw red value over full scale of the contact's 99.9th percentile, at the exposure that does not clip."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One map of one frame; errors over the true contact's pixels.

    Attributes
    ----------
    rms_slope, force_N, exposure : float
        ``exposure`` times gain [ms].
    what : str
        Made of what.
    correlation : float or None
        With the true pressure; None where the map is flat.
    rms_percent : float
        RMS error of the map scaled to the force [% of the true peak].
    full_share : float
        Share of the contact at full scale.
    span : float
        5 to 95 % of the values within the contact, over full scale [1].
    """

    rms_slope: float
    force_N: float
    exposure: float
    what: str
    correlation: float | None
    rms_percent: float
    full_share: float
    span: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class ColourPressure:
    """All rows, and the maps of the first press.

    Attributes
    ----------
    rows : list of Row
    maps : dict of ndarray
        ``true`` and each map [MPa].
    provenance : dict
    """

    rows: list[Row]
    maps: dict[str, Floats]
    provenance: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON result.

        Returns
        -------
        dict
        """
        return {"colour_rows": [asdict(r) for r in self.rows], "provenance": self.provenance}


def run_colour(
    scene: Scene,
    *,
    slopes: Sequence[float] = SLOPES,
    forces: Sequence[float] = FORCES,
    voltage: float = VOLTAGE,
    threshold: float = THRESHOLD,
    seed: int = 1,
    tick: Callable[[int, int], None] = lambda done, total: None,
    keep: Keep = not_kept,
) -> ColourPressure:
    """Compare maps of one colour camera with the true pressure.

    Parameters
    ----------
    scene : Scene
        With a colour camera, exposed as the scene has it; its skin gets the slopes.
    slopes, forces : sequence of float
        [1], [N].
    voltage : float
        [V].
    threshold : float
        Of the reference segmentation.
    seed : int
    tick : callable
        ``tick(done, total)``.
    keep : callable
        See :data:`~evanesce.studies.ledger.Keep`.

    Returns
    -------
    ColourPressure
    """
    rows: list[Row] = []
    maps: dict[str, Floats] = {}

    def first(found: dict[str, Floats]) -> None:
        if not maps:
            maps.update(found)

    for slope in slopes:
        for force in forces:
            make = partial(_press, rough(scene, slope), slope, force, voltage, threshold, seed, first)
            kept = keep(f"colour, slope {slope:g}, {force:g} N", make)["rows"]
            rows += [Row(**{**row, "span": tuple(row["span"])}) for row in kept]
            tick(len(rows), len(slopes) * len(forces) * len(kept))
    record = provenance.record(seed=seed, config=scene.as_dict())
    return ColourPressure(rows=rows, maps=maps, provenance=dict(record))


def unclipped(charge_e: Floats, camera: Camera) -> Camera:
    """Return the camera at the exposure and gain 1 at which the brightest red pixels stay below full scale.

    Parameters
    ----------
    charge_e : ndarray (rows, cols)
        Mean charge of each pixel at the camera's own exposure [e-].
    camera : Camera

    Returns
    -------
    Camera
    """
    pixel = camera.pixel
    top = (2**pixel.bits - 1 - pixel.black_level_DN) * pixel.conversion_gain_e_per_DN
    lit = charge_e[charge_e > 0.5 * charge_e.max()]
    factor = BRIGHTEST * min(top, pixel.full_well_capacity_e) / float(np.percentile(lit, 99.9))
    return camera.model_copy(update={"exposure_ms": camera.exposure_ms * factor, "analogue_gain": 1.0})


def _press(
    rig: Scene, slope: float, force: float, voltage: float, threshold: float, seed: int,
    show: Callable[[dict[str, Floats]], None],
) -> dict[str, Any]:  # fmt: skip
    """Return the rows of one press as plain data."""
    press, state = LitPress.of(rig, force, seed), contact_state(rig, force)
    scene = press.scene
    ratio = power_ratio(scene, voltage)
    if ratio is None:
        raise ValueError("the LEDs do not all change alike")
    light = SensorLight(irradiance=press.irradiance.astype(np.float64) * ratio)
    truth = label(state, view_geometry(Projection.of(scene.camera, scene.plate)), supersample=2)
    at_rows, at_cols = np.nonzero(truth.mask > 0)
    box = np.s_[
        max(0, at_rows.min() - MARGIN_PX) : at_rows.max() + MARGIN_PX + 1,
        max(0, at_cols.min() - MARGIN_PX) : at_cols.max() + MARGIN_PX + 1,
    ]
    true, area, inside = truth.pressure[box].astype(float), truth.pixel_area[box], truth.mask[box] > 0.5
    curve = roughness_curve(float(state.parameters["reduced_modulus_MPa"]), slope, 4.0 * float(state.pressure.max()))
    own, low = scene.camera, unclipped(charge_of(light, scene.camera, response=led_response(scene)), scene.camera)
    bright, dim = (_frame(scene, light, camera, seed) for camera in (own, low))
    mask = segment(bright.data, Chain(threshold=threshold)).dilated[box]
    values: dict[str, tuple[Camera, Floats]] = {
        "grey of the frame": (own, bright.data[box] @ GREY / 255.0),
        "green of the frame": (own, bright.data[box][..., 1] / 255.0),
        "blue of the frame": (own, bright.data[box][..., 2] / 255.0),
    }
    for camera, frame in ((own, bright), (low, dim)):
        raw = _raw(frame, camera)[box]
        names = ("red", "green", "blue") if camera is own else ("red",)
        where = "of the frame" if camera is own else "at less exposure"
        values |= {f"raw {name}, {where}": (camera, raw[..., k]) for k, name in enumerate(names)}
    rows, maps = [], {"true": true}
    for what, (camera, value) in values.items():
        found = reference_map(value, mask, area, force)
        rows.append(_row(what, camera, value, found, true, inside, slope, force))
        maps[what] = found
    red = values["raw red, at less exposure"][1]
    dark = float(np.median(red[truth.mask[box] == 0]))
    model = pressure_map(red - dark, red >= 1.0, area, force, curve).pressure
    rows.append(_row("raw red at less exposure, roughness model", low, red, model, true, inside, slope, force))
    maps[rows[-1]["what"]] = model
    show(maps)
    return {"rows": rows}


def _frame(scene: Scene, light: SensorLight, camera: Camera, seed: int) -> Frame:
    charge = charge_of(light, camera, response=led_response(scene))
    return frame_of(signal_of(charge, camera, rng.generator(seed, "pressure colour")), camera)


def _raw(frame: Frame, camera: Camera) -> Floats:
    """Return raw red, green and blue over full scale by bilinear interpolation (rows, cols, 3)."""
    assert frame.raw is not None
    assert camera.colour is not None
    pixel = camera.pixel
    light = (frame.raw.astype(np.float64) - pixel.black_level_DN) / (2**pixel.bits - 1 - pixel.black_level_DN)
    return bilinear(light, camera.colour.mosaic)


def _row(
    what: str, camera: Camera, value: Floats, found: Floats, true: Floats, inside: NDArray[np.bool_], slope: float,
    force: float,
) -> dict[str, Any]:  # fmt: skip
    within = value[inside]
    flat = np.ptp(within) < 1e-9
    return asdict(
        Row(
            rms_slope=slope, force_N=force, exposure=camera.exposure_ms * camera.analogue_gain, what=what,
            correlation=None if flat else float(np.corrcoef(found[inside], true[inside])[0, 1]),
            rms_percent=100 * float(np.sqrt(((found - true)[inside] ** 2).mean())) / float(true.max()),
            full_share=float((within >= 1.0 - 1e-9).mean()),
            span=(float(np.percentile(within, 5)), float(np.percentile(within, 95))),
        )
    )  # fmt: skip
