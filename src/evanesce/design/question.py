"""Question to a rig: loads, positions and materials to be measured, the estimator, and how many rigs are drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import ValidationError

from evanesce.core.errors import InputError
from evanesce.materials import material_names
from evanesce.measurement.reference.segment import Chain, Crop
from evanesce.rig import Scene
from evanesce.rig.finger import OWN, OWN_FIGURES
from evanesce.rig.load import validate

ESTIMATORS = ("reference", "refined")
GRID_MARGIN_MM = 2.0
"""Margin of the contact grid around the largest contact: there the gap exceeds the reach of the evanescent wave."""

GRID_PITCH_MM = 0.03


@dataclass(frozen=True)
class Case:
    """One measurement: force [N], position of the tip on the plate [mm], material of the finger."""

    force_N: float
    position_mm: tuple[float, float]
    material: str

    @property
    def name(self) -> str:
        """Name for tables."""
        return f"{self.force_N:g} N at ({self.position_mm[0]:g}, {self.position_mm[1]:g}) mm, {self.material}"


@dataclass(frozen=True, kw_only=True)
class Question:
    """Measurements by which every design of a search is evaluated.

    Attributes
    ----------
    forces_N : tuple of float
    positions_mm : tuple of (float, float)
    materials : tuple of str
    estimator : {"reference", "refined"}
    rigs : int
        Drawn for the prediction; each measures one of the cases in a search.
    pixel_factor : int
        Pixel pitch of the search over the camera's; lengths of the segmentation in pixels are divided by it.
    crop_mm : float
        Half the side of the square about the finger's position to which frames are cropped.
    speed_mm_per_s : float
        Of a slide, for motion blur.
    standard_deviations : mapping, optional
        Effect -> parameter -> standard deviation (:func:`evanesce.design.uncertainty.uncertainty_of`).
    seed : int
    """

    forces_N: tuple[float, ...]
    positions_mm: tuple[tuple[float, float], ...]
    materials: tuple[str, ...]
    estimator: Literal["reference", "refined"] = "reference"
    rigs: int = 32
    pixel_factor: int = 2
    crop_mm: float = 7.5
    speed_mm_per_s: float = 5.0
    standard_deviations: Mapping[str, Mapping[str, float]] | None = None
    seed: int = 1

    def __post_init__(self) -> None:
        if not self.forces_N or not all(0 < f < math.inf for f in self.forces_N):
            raise InputError(f"{list(self.forces_N)}", key="loads.forces_N", allowed="one or more forces above 0 N")
        if self.estimator not in ESTIMATORS:
            raise InputError(f"{self.estimator!r}", key="measurement.estimator", allowed=", ".join(ESTIMATORS))
        for name in self.materials:
            if name not in (*material_names(), OWN):
                raise InputError(f"{name!r}", key="loads.materials", allowed=", ".join(material_names()))
        for key, value, low, high in (
            ("search.rigs", self.rigs, 8, 4096),
            ("search.pixel_factor", self.pixel_factor, 1, 8),
            ("measurement.crop_mm", self.crop_mm, 0.5, 500.0),
            ("loads.slide_speed_mm_per_s", self.speed_mm_per_s, 1e-3, 1e3),
        ):
            if not low <= value <= high:
                raise InputError(f"{value:g}", key=key, allowed=f"{low:g} to {high:g}")

    @property
    def cases(self) -> tuple[Case, ...]:
        """All combinations of force, position and material."""
        return tuple(
            Case(force, position, material)
            for material in self.materials
            for position in self.positions_mm
            for force in self.forces_N
        )

    def as_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "forces_N": list(self.forces_N), "positions_mm": [list(p) for p in self.positions_mm],
            "materials": list(self.materials), "estimator": self.estimator, "rigs": self.rigs,
            "pixel_factor": self.pixel_factor, "crop_mm": self.crop_mm, "speed_mm_per_s": self.speed_mm_per_s,
            "standard_deviations": None
            if self.standard_deviations is None
            else {k: dict(v) for k, v in self.standard_deviations.items()},
            "seed": self.seed,
        }  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Design:
    """A rig to be built, and how its frames will be segmented.

    Attributes
    ----------
    scene : Scene
    threshold : float
        Grey level of the reference segmentation [1].
    min_blob_px : int
    """

    scene: Scene
    threshold: float = 0.15
    min_blob_px: int = 2000

    def chain(self, pixel_factor: int = 1, crop: Crop | None = None) -> Chain:
        """Return the reference segmentation within a crop, for pixels ``pixel_factor`` times as large."""
        return Chain(
            threshold=self.threshold, min_blob=max(1, round(self.min_blob_px / pixel_factor**2)),
            blur=1.0 / pixel_factor,            radius=max(1, round(10 / pixel_factor)), crop=crop or Crop(),
        )  # fmt: skip


def coarser_camera(scene: Scene, factor: int) -> Scene:
    """Return a scene whose camera sees the same field with pixels ``factor`` times as large, their charge with them.

    Read noise is that of one pixel read once: larger pixels, not binned ones.
    """
    if factor == 1:
        return scene
    data = scene.as_dict()
    camera, pixel = data["camera"], data["camera"]["pixel"]
    camera["resolution_px"] = [max(8, n // factor) for n in camera["resolution_px"]]
    camera["scale_px_per_mm"] /= factor
    camera["principal_point_offset_px"] = [v / factor for v in camera["principal_point_offset_px"]]
    pixel["pitch_um"] *= factor
    for key in ("full_well_capacity_e", "conversion_gain_e_per_DN"):
        pixel[key] *= factor**2
    return validate(Scene, data, "coarser camera")


def on_case(scene: Scene, case: Case) -> Scene:
    """Return a scene with the finger of a case at its position; a slide is left out.

    Raises
    ------
    InputError
        If the position is not on the plate.
    """
    update: dict[str, Any] = {"position_mm": case.position_mm}
    if case.material != scene.finger.material:
        if case.material == OWN:
            raise InputError(f"{OWN!r}", key="loads.materials", allowed=f"a scene with one of {', '.join(OWN_FIGURES)}")
        update |= {"material": case.material, **dict.fromkeys(OWN_FIGURES)}
    finger = scene.finger.model_copy(update=update)
    try:
        return Scene.model_validate({**dict(scene), "finger": finger, "slide": None, "sources": {}, "assumptions": {}})
    except ValidationError as error:
        raise InputError(error.errors()[0]["msg"].removeprefix("Value error, "), key="loads.positions_mm") from None


def fitted_grid(scene: Scene, radius_mm: float) -> Scene:
    """Return a scene whose contact grid is as large as contacts up to a radius [mm] need."""
    size = min(scene.grid.size_mm, 2 * (radius_mm + GRID_MARGIN_MM))
    pitch = max(scene.grid.size_mm / scene.grid.samples, GRID_PITCH_MM)
    grid = scene.grid.model_copy(update={"size_mm": size, "samples": max(16, math.ceil(size / pitch))})
    return scene.model_copy(update={"grid": grid})
