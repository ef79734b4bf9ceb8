"""A scene: the nominal model of the rig, its contact, its loading programme, and how to sample it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from evanesce.core.quantities import Strict, field
from evanesce.rig.camera import Camera
from evanesce.rig.card import Cards
from evanesce.rig.environment import Environment
from evanesce.rig.finger import OWN, Contact, Finger, HalfspaceLaw, HertzLaw
from evanesce.rig.leds import Leds
from evanesce.rig.liquid import Liquid
from evanesce.rig.plate import Plate
from evanesce.rig.programme import Press, Slide
from evanesce.rig.surroundings import Surroundings

MAX_PIXELS = 100_000_000
LEAST_AUTOMATIC_PX = 32
"""Side of a frame whose 16 zones of statistics have two pixels each."""


class ContactGrid(Strict):
    """Sampling of the contact plane around the finger's tip."""

    size_mm: float = field(16.0, unit="mm", bounds=(0.1, 500.0), doc="side of the square")
    samples: int = field(1024, unit="1", bounds=(16, 8192), doc="samples along a side")


class RenderSettings(Strict):
    """Settings of the path tracer."""

    samples_per_pixel: int = field(64, unit="1", bounds=(1, 1_000_000))
    passes: int = field(4, unit="1", bounds=(2, 100_000), doc="independent passes: the variance comes from them")
    max_depth: int = field(64, unit="1", bounds=(2, 4096))
    seed: int = field(0, unit="1", bounds=(0, 2**62))


def _positive_roots(rising: list[float]) -> list[float]:
    """Return the positive real roots of a polynomial given by its coefficients, constant first."""
    roots = np.polynomial.Polynomial(rising).trim().roots()
    values = np.asarray(roots, np.complex128)
    return [float(root.real) for root in values if abs(root.imag) < 1e-12 and root.real > 0]


class Scene(Strict):
    """Everything a simulation needs; read from TOML by :func:`evanesce.rig.load.load_scene`.

    ``assumptions`` and ``sources`` map dotted keys of this scene to a sentence: why an unpublished figure was chosen,
    and where a published one stands.
    """

    schema_version: int = Field(1, ge=1, le=1)
    title: str = Field("", max_length=200)
    plate: Plate
    leds: Leds
    finger: Finger
    contact: Contact = HertzLaw(law="hertz")
    camera: Camera = Camera()
    card: Cards = Cards()
    press: Press
    slide: Slide | None = None
    environment: Environment | None = None
    liquid: Liquid | None = None
    grid: ContactGrid = ContactGrid()
    render: RenderSettings = RenderSettings()
    figures_at_nm: float | None = field(
        None,
        unit="nm",
        bounds=(300.0, 1100.0),
        doc="indices, absorption, scattering and camera hold at this wavelength; none: as published, in white light",
    )
    surroundings: Surroundings | None = None
    effects: dict[str, dict[str, float | int | bool | str | list[float]]] = Field(default_factory=dict)
    assumptions: dict[str, str] = Field(default_factory=dict)
    sources: dict[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        width, height = self.camera.resolution_px
        if width * height > MAX_PIXELS:
            raise ValueError(f"camera.resolution_px asks for {width * height} pixels (allowed: at most {MAX_PIXELS})")
        if len(set(self.leds.edges)) < len(self.leds.edges):
            raise ValueError(f"leds.edges = {list(self.leds.edges)} names an edge twice (allowed: each edge once)")
        for centre, size, axis in zip(self.finger.position_mm, self.plate.size_mm, "xy", strict=True):
            if abs(centre) >= size / 2:
                raise ValueError(
                    f"finger.position_mm puts the tip at {axis} = {centre:g} mm, off the plate"
                    f" (allowed: within +-{size / 2:g} mm)"
                )
        self._lens_is_invertible()
        automatic = self.camera.auto_exposure is not None or (
            self.camera.colour is not None and self.camera.colour.white_balance == "automatic"
        )
        if automatic and min(width, height) < LEAST_AUTOMATIC_PX:
            raise ValueError(
                f"camera.resolution_px = {width} x {height} is too small for automatic exposure or white balance"
                f" (allowed: sides from {LEAST_AUTOMATIC_PX} px)"
            )
        response = None if self.camera.colour is None else self.camera.colour.response
        if response is not None and max(response) <= 0.0:
            raise ValueError("camera.colour.response lets nothing through (allowed: one share above 0 at least)")
        for edge in self.leds.edge:
            if edge not in self.leds.edges:
                raise ValueError(f"leds.edge.{edge} is described, but '{edge}' is not in leds.edges")
        if self.leds.emitting_height_mm > self.plate.thickness_mm:
            raise ValueError(
                f"leds.emitting_height_mm = {self.leds.emitting_height_mm:g} is taller than the plate"
                f" (allowed: at most plate.thickness_mm = {self.plate.thickness_mm:g} mm)"
            )
        if self.leds.emitting_width_mm > self.leds.pitch_mm:
            raise ValueError(
                f"leds.emitting_width_mm = {self.leds.emitting_width_mm:g} overlaps its neighbour"
                f" (allowed: at most leds.pitch_mm = {self.leds.pitch_mm:g} mm)"
            )
        if self.finger.tip_radius_mm * 2 > self.finger.diameter_mm * 4:
            raise ValueError(
                f"finger.tip_radius_mm = {self.finger.tip_radius_mm:g} is no finger's tip"
                f" (allowed: at most twice finger.diameter_mm, {2 * self.finger.diameter_mm:g} mm)"
            )
        ridges = self.finger.ridges
        if ridges is not None and self.finger.height_map is not None:
            raise ValueError("finger.ridges and finger.height_map are both given (allowed: one of them)")
        if self.finger.fingerprint is not None and not (ridges is None and self.finger.height_map is None):
            raise ValueError("finger.fingerprint is given beside another relief (allowed: one of them)")
        law = self.contact
        if isinstance(law, HalfspaceLaw) and law.skin_modulus_MPa is not None and law.layer_mm is None:
            raise ValueError("contact.skin_modulus_MPa is given without contact.layer_mm (allowed: both)")
        if getattr(self.contact, "layer_mm", None) is not None and (
            self.finger.work_of_adhesion_N_per_mm > 0 or getattr(self.contact, "work_of_adhesion_N_per_mm", 0.0) > 0
        ):
            raise ValueError("contact.layer_mm is given beside adhesion (allowed: one of them)")
        if ridges is not None and ridges.width_um > ridges.pitch_um:
            raise ValueError(
                f"finger.ridges.width_um = {ridges.width_um:g} exceeds the pitch"
                f" (allowed: at most finger.ridges.pitch_um = {ridges.pitch_um:g} um)"
            )
        if self.finger.material == OWN and getattr(self.contact, "reduced_modulus_MPa", None) is not None:
            raise ValueError("contact.reduced_modulus_MPa and the finger's own stiffness are both given")
        self._slide_is_possible()
        for table, name in ((self.assumptions, "assumptions"), (self.sources, "sources")):
            for key in table:
                if not self._has(key):
                    raise ValueError(f"{name}.'{key}' names no key of a scene")
        return self

    def _lens_is_invertible(self) -> None:
        """Refuse a distortion that folds over within the frame: two directions would share a pixel."""
        lens, (width, height) = self.camera.lens, self.camera.resolution_px
        focal_px = lens.focal_length_mm * 1e3 / self.camera.pixel.pitch_um
        dx, dy = self.camera.principal_point_offset_px
        corner = math.hypot(width / 2 + abs(dx) + 1, height / 2 + abs(dy) + 1) / focal_px
        k1, k2, k3 = lens.distortion.k1, lens.distortion.k2, lens.distortion.k3
        # r (1 + k1 r^2 + k2 r^4 + k3 r^6) must rise until it reaches the frame's corner.
        turning = _positive_roots([1.0, 3 * k1, 5 * k2, 7 * k3])
        if not turning:
            return
        r2 = min(turning)
        reach = math.sqrt(r2) * (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))
        if reach <= corner:
            raise ValueError(
                f"camera.lens.distortion folds over at {100 * reach / corner:.0f} % of the frame's half-diagonal"
                " (allowed: coefficients whose radial curve rises out to the frame's corner)"
            )

    def _slide_is_possible(self) -> None:
        if self.slide is None:
            return
        forces = self.press.forces_N
        if forces is None or len(forces) != 1 or forces[0] <= self.slide.preload_N:
            raise ValueError("a slide needs press.forces_N with one force, above slide.preload_N")
        if self.press.rate_mm_per_min is not None or self.press.dwell_s is not None:
            raise ValueError(
                "press.rate_mm_per_min and press.dwell_s are not those of a slide"
                " (allowed: slide.press_time_s and slide.hold_time_s)"
            )
        if self.contact.tilt_deg:
            raise ValueError("contact.tilt_deg is that of a press (allowed: slide.contact_angle_deg)")
        scanned = self.finger.height_map is not None or self.finger.fingerprint is not None
        if scanned or self.contact.law == "halfspace":
            raise ValueError(
                "a slide needs a law other than halfspace, no height map and no print: a slide has round contacts"
            )
        ridges = self.finger.ridges
        if ridges is not None and (self.slide.glass_moves or ridges.rounding_um is not None):
            raise ValueError("a ridged finger slides itself, without rounding (allowed: glass_moves = false)")
        aside = bool(self.slide.spin_deg_per_s) or self.slide.ridge_friction_ratio not in (None, 1.0)
        if aside and self.slide.area_loss_mm2_per_N2:
            raise ValueError(
                "slide.area_loss_mm2_per_N2 is along one direction (allowed: 0 with spin_deg_per_s or"
                " ridge_friction_ratio)"
            )
        if self.slide.ridge_friction_ratio is not None and (ridges is None or ridges.pattern != "parallel"):
            raise ValueError('slide.ridge_friction_ratio needs finger.ridges (allowed: pattern "parallel")')

    def _has(self, dotted: str) -> bool:
        """Return whether a dotted key names something in this scene."""
        value: Any = self
        for part in dotted.split("."):
            if isinstance(value, dict):
                value = value.get(part)
            else:
                value = getattr(value, part, None)
            if value is None:
                return False
        return True

    def as_dict(self) -> dict[str, Any]:
        """Return plain JSON-able data, None left out (TOML has no null).

        Returns
        -------
        dict
        """
        return self.model_dump(mode="json", exclude_none=True)

    def table(self, name: str) -> dict[str, Any]:
        """Return one of the tables of :meth:`as_dict`, a tenth of the work.

        Parameters
        ----------
        name : str
            Of a table that every scene has.

        Returns
        -------
        dict
        """
        found: dict[str, Any] = getattr(self, name).model_dump(mode="json", exclude_none=True)
        return found

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Self:
        """Build a scene from nested tables, as a TOML file has them; :meth:`as_dict` gives them back.

        Parameters
        ----------
        data : mapping
            Keys carry their units: ``{"plate": {"size_mm": [120.0, 80.0], ...}, ...}``.

        Returns
        -------
        Scene

        Raises
        ------
        InputError
            For a missing or unknown key, naming the nearest, or a value of the wrong type or out of bounds.

        Examples
        --------
        >>> import evanesce as ev
        >>> scene = ev.load("thesis")
        >>> ev.Scene.from_dict(scene.as_dict()) == scene
        True
        """
        from evanesce.rig.load import validate  # which needs this class

        return validate(cls, dict(data), "Scene.from_dict")

    def with_(self, changes: Mapping[str, Any] | None = None, /, **keywords: Any) -> Scene:
        """Return this scene with some keys changed; the scene itself stays as it is.

        Parameters
        ----------
        changes : mapping, optional
            From dotted keys to values: ``{"finger.ridges.height_um": 150.0}``.
        **keywords
            The same with two underscores for each dot: ``finger__ridges__height_um=150.0``. A table is given as a
            mapping and replaces the whole table; None removes an optional key.

        Returns
        -------
        Scene
            Checked like a scene that is read from a file. Sentences under ``sources`` and ``assumptions`` that speak
            of a changed key are left out: they hold for the value that was there.

        Raises
        ------
        InputError
            For an unknown key, naming the nearest, or a value of the wrong type or out of bounds.

        Examples
        --------
        >>> import evanesce as ev
        >>> scene = ev.load("thesis_ridged").with_(leds__voltage_V=9.5, finger__ridges__height_um=150)
        >>> scene.leds.voltage_V, scene.finger.ridges.height_um
        (9.5, 150.0)
        >>> scene.with_(finger__ridges=None).finger.is_smooth
        True
        >>> scene.with_(leds__voltage=9.5)
        Traceback (most recent call last):
        ...
        evanesce.core.errors.InputError: Scene.with_: leds.voltage: wrong unit: write voltage_V instead (allowed: ...
        """
        from evanesce.rig.change import changed  # which needs this class

        return changed(self, {**(changes or {}), **keywords})
