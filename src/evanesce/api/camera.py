"""Take frames of a scene: a camera that exposes contacts, and shots that know their truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from evanesce.api.truth import Truth
from evanesce.chain import simulate as chain
from evanesce.core import provenance, rng
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, Frame, PlateLight, SensorLight
from evanesce.effects import active_effects
from evanesce.render.bands import MAX_BANDS, banded
from evanesce.render.cards import Pose
from evanesce.rig import Scene

Renderer = Literal["fast", "reference"]


class Camera:
    """The camera of a scene, with a renderer.

    Parameters
    ----------
    scene : Scene
        Plate, LEDs, finger, camera and effects.
    renderer : {"fast", "reference"} or callable
        ``"fast"``: light transport in closed form and tables, about a second a frame, no noise of its own.
        ``"reference"``: the path tracer (Mitsuba 3), which the fast one is checked against. A callable
        ``render(scene, state, *, seed, **options) -> PlateLight`` replaces both.
    samples : int, optional
        Reference only: paths per pixel around the contact; the scene's ``render.samples_per_pixel`` by default.
    passes : int, optional
        Reference only: independent passes, from which the variance comes; the scene's ``render.passes`` by default.
    until_error : float, optional
        Reference only: passes are added until this relative standard error [1].
    bands : int
        The LEDs' light in so many bands of wavelength; 1: one wavelength.
    variant : {"auto", "llvm", "scalar", "cuda"}
        Reference only: Mitsuba's variant.

    Attributes
    ----------
    scene : Scene
    renderer : str
        ``"fast"``, ``"reference"`` or ``"given"``.

    Raises
    ------
    InputError
        If an effect of the scene or an option is not valid.

    Examples
    --------
    >>> import evanesce as ev
    >>> camera = ev.Camera(ev.coarser(ev.load("thesis_ridged"), 4))
    >>> shot = camera.shoot(force_N=2.0, seed=1)
    >>> shot.frame.shape, shot.frame.dtype, round(shot.truth.area_mm2, 2)
    ((375, 500), dtype('uint8'), 17.91)
    """

    def __init__(
        self,
        scene: Scene,
        renderer: Renderer | Callable[..., PlateLight] = "fast",
        *,
        samples: int | None = None,
        passes: int | None = None,
        until_error: float | None = None,
        bands: int = 1,
        variant: str = "auto",
    ) -> None:
        active_effects(scene)
        if not 1 <= bands <= MAX_BANDS:
            raise InputError(f"{bands}", key="bands", allowed=f"1 to {MAX_BANDS}")
        if until_error is not None and not 0 < until_error < 1:
            raise InputError(f"{until_error:g}", key="until_error", allowed="above 0, below 1")
        self.scene = scene
        options = {"samples_per_pixel": samples, "passes": passes, "until_error": until_error}
        self._options: dict[str, Any] = {name: value for name, value in options.items() if value is not None}
        self._variant, self._bands = variant, bands
        if renderer == "fast":
            for name in self._options:
                key = "samples" if name == "samples_per_pixel" else name
                raise InputError("the fast renderer draws no paths", key=key, allowed="with renderer='reference' only")
        elif renderer != "reference" and not callable(renderer):
            raise InputError(f"{renderer!r}", key="renderer", allowed="'fast', 'reference', or a callable")
        self.renderer = renderer if isinstance(renderer, str) else "given"
        self._given = None if isinstance(renderer, str) else renderer

    def __repr__(self) -> str:
        cols, rows = self.scene.camera.resolution_px
        return f"Camera({self.scene.title!r}, {self.renderer!r}, {rows} x {cols} px)"

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of a frame [px]."""
        cols, rows = self.scene.camera.resolution_px
        return rows, cols

    @property
    def scale_mm2_per_px(self) -> float:
        """Area of the contact plane that a pixel on the optical axis sees [mm^2], by the scene's own figures."""
        return 1.0 / self.scene.camera.scale_px_per_mm**2

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top border of a frame on the contact plane [mm], for matplotlib's ``imshow``.

        By the scale on the optical axis: towards the corners the lens's distortion makes distances larger.
        """
        (rows, cols), camera = self.shape, self.scene.camera
        (x, y), (dx, dy) = camera.centre_mm, camera.principal_point_offset_px
        scale = camera.scale_px_per_mm
        left, top = x - (cols / 2 + dx) / scale, y - (rows / 2 + dy) / scale
        return left, left + cols / scale, top + rows / scale, top

    def shoot(self, force_N: float | None, *, seed: int = 0, time_s: float = 0.0, index: int = 0) -> Shot:
        """Press with a normal force and take the frame.

        Parameters
        ----------
        force_N : float or None
            Normal force that the load cell reports [N]; None leaves the finger away.
        seed : int
            Light, noise and effects draw from their own streams of it: the same arguments give the same bytes.
        time_s : float
            Mid-exposure time [s].
        index : int
            Number of the frame; noise differs from frame to frame.

        Returns
        -------
        Shot

        Raises
        ------
        InputError
            If the contact cannot be solved.
        """
        found = chain.simulate(
            self.scene, force_N, seed=seed, time_s=time_s, index=index, render=self._render, **self._options
        )
        return Shot(simulated=found, camera=self, seed=seed)

    def shoot_all(self, *, seed: int = 0) -> Iterator[Shot]:
        """Take the frames of the scene's loading programme, one after the other.

        Parameters
        ----------
        seed : int

        Yields
        ------
        Shot
            At the scene's frame rate; of a slide with stick and slip in ``shot.truth.surface_state``.

        Raises
        ------
        InputError
            As :meth:`shoot`, or if the programme has too many frames.
        """
        for index, (time_s, force_N) in enumerate(chain.programme(self.scene, seed=seed)):
            yield self.shoot(force_N, seed=seed, time_s=time_s, index=index)

    def expose(self, state: ContactState | None, *, seed: int = 0, time_s: float | None = None, index: int = 0) -> Shot:
        """Take the frame of a contact that is known.

        Parameters
        ----------
        state : ContactState or None
            The contact as it is: effects of load and contact are not applied to it. None: no contact.
        seed, index : int
            As for :meth:`shoot`.
        time_s : float, optional
            Mid-exposure time [s]; the state's own by default.

        Returns
        -------
        Shot
        """
        time_s = (0.0 if state is None else state.time) if time_s is None else time_s
        scene, _ = chain.solve_contact(self.scene, None, seed=seed, time_s=time_s, index=index)
        light_seed = rng.integer_seed(seed, "render", index)
        light = self._render(scene, state, seed=light_seed, **self._options)
        sensor, frame = chain.expose(scene, light, seed=seed, time_s=time_s, index=index)
        return Shot(simulated=chain.SimulatedFrame(scene, state, light, sensor, frame), camera=self, seed=seed)

    def shoot_target(
        self,
        which: Literal["checkerboard", "square"],
        pose: Pose | None = None,
        *,
        seed: int = 0,
        time_s: float = 0.0,
        index: int = 0,
    ) -> NDArray[np.uint8]:
        """Take the frame of a printed calibration target on the glass, LEDs off, under even illumination.

        Parameters
        ----------
        which : {"checkerboard", "square"}
            The scene's ``[card]`` table has their sizes.
        pose : Pose, optional
            Where the target is held; flat on the glass by default.
        seed, time_s, index
            As for :meth:`shoot`.

        Returns
        -------
        ndarray of uint8 (rows, cols)
            [DN].
        """
        if which not in ("checkerboard", "square"):
            raise InputError(f"{which!r}", key="which", allowed="'checkerboard', 'square'")
        options: dict[str, Any] = {}
        if self.renderer == "reference":
            options = {name: value for name, value in self._options.items() if name != "until_error"}
            options["variant"] = self._variant
        else:
            from evanesce.bundle.card_light import card_light

            options["render"] = card_light
        return chain.simulate_card(self.scene, which, seed=seed, pose=pose, time_s=time_s, index=index, **options).data

    def provenance(self, *, seed: int | None = None) -> Mapping[str, Any]:
        """Return what decides a frame.

        Parameters
        ----------
        seed : int, optional

        Returns
        -------
        mapping
            Versions, seed, renderer and digest of the scene, JSON-able.
        """
        record: dict[str, Any] = {"renderer": {"fast": "transport", "reference": "path"}.get(self.renderer, "given")}
        if self.renderer == "reference":
            from evanesce.render.variant import select

            record |= select(self._variant).record()
        if self._bands > 1:
            record["bands"] = self._bands
        return provenance.record(seed=seed, config=self.scene.as_dict(), **record)

    @cached_property
    def _render(self) -> Callable[..., PlateLight]:
        """The renderer with its options; imported when the first frame is taken."""
        if self._given is not None:
            render = self._given
        elif self.renderer == "fast":
            from evanesce.render.fast.transport import render_fast

            render = render_fast
        else:
            from evanesce.render.reference.path import render as trace

            render = partial(trace, variant=self._variant)
        return banded(render, self._bands)


@dataclass(frozen=True, kw_only=True, repr=False)
class Shot:
    """A frame with everything it came from.

    Attributes
    ----------
    simulated : SimulatedFrame
        Scene, contact, light and frame as the chain made them.
    camera : Camera
        That took it.
    seed : int
    """

    simulated: chain.SimulatedFrame
    camera: Camera
    seed: int

    def __repr__(self) -> str:
        rows, cols = self.frame.shape[:2]
        force = "no contact" if self.contact is None else f"{self.contact.normal_force:g} N"
        return f"Shot({force}, seed {self.seed}, frame {self.index}, {rows} x {cols} px)"

    @property
    def frame(self) -> NDArray[np.uint8]:
        """8-bit frame (rows, cols) as the measurement reads it, distorted by the lens [DN]."""
        return self.simulated.frame.data

    @property
    def raw(self) -> NDArray[np.uint16]:
        """Raw numbers (rows, cols) before the tone curve, 12 bits [DN]."""
        raw = self.simulated.frame.raw
        assert raw is not None  # the chain always keeps them
        return raw

    @property
    def contact(self) -> ContactState | None:
        """Pressure, gap and contact mask on the contact plane's grid; None without contact."""
        return self.simulated.state

    @property
    def scene(self) -> Scene:
        """The rig as it was, after the effects that change it; ``camera.scene`` is the nominal one."""
        return self.simulated.scene

    @property
    def plate_light(self) -> PlateLight:
        """Radiance (rows, cols) that left the plate [W mm^-2 sr^-1], on a distortion-free pinhole view."""
        return self.simulated.plate_light

    @property
    def sensor_light(self) -> SensorLight:
        """Irradiance (rows, cols) on the sensor, after lens and distortion [W mm^-2]."""
        return self.simulated.sensor_light

    @property
    def index(self) -> int:
        """Number of the frame."""
        return self.simulated.frame.index

    @property
    def time_s(self) -> float:
        """Mid-exposure time [s]."""
        return self.simulated.frame.time

    @property
    def scale_mm2_per_px(self) -> float:
        """Area of the contact plane that a pixel on the optical axis sees [mm^2], by the nominal scene's figures."""
        return self.camera.scale_mm2_per_px

    @cached_property
    def truth(self) -> Truth:
        """What a measurement of this frame should find."""
        return Truth(scene=self.scene, state=self.contact)

    @property
    def provenance(self) -> Mapping[str, Any]:
        """Versions, seed, renderer and digest of the nominal scene, JSON-able."""
        return self.camera.provenance(seed=self.seed)

    def as_frame(self) -> Frame:
        """Return frame, raw numbers, time and index as one value."""
        return self.simulated.frame
