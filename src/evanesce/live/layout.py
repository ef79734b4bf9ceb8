"""Layout of the live page: header, settings, pictures, charts and the user's own frame."""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from importlib import resources
from typing import Any

from nicegui import ui
from nicegui.element import Element

from evanesce.live.controls import Controls, knobs_of
from evanesce.live.own import ALLOWED, MAX_BYTES, OwnFilm
from evanesce.live.pictures import AGREE, FALSE, MISSED
from evanesce.live.widgets import KnobRow, LedMap, Picture, Screen
from evanesce.materials.tables import material_names
from evanesce.rig import Scene

RIG_KNOBS = ("voltage_V", "force_N", "ridge_height_um", "defocus_um")
CHAIN_KNOBS = ("threshold", "min_blob_px", "line_mm")


@dataclass(frozen=True, kw_only=True)
class Handlers:
    """Functions that the page's elements call.

    Attributes
    ----------
    set : callable
        With fields of :class:`~evanesce.live.controls.Controls` by name.
    reset, save, close_own, drawn : callable
        Without arguments; ``drawn`` when the browser has drawn the enlarged window.
    open_own : callable
        ``await open_own(content, name)`` with an uploaded file.
    set_own_scale : callable
        With the area of a pixel of the own frame [mm^2], or None.
    set_film_frame : callable
        ``await set_film_frame(number)`` of the own film.
    refuse : callable
        With a line that says why an upload was refused.
    """

    set: Callable[..., None]
    reset: Callable[[], None]
    save: Callable[[], None]
    open_own: Callable[[bytes, str], Awaitable[None]]
    close_own: Callable[[], None]
    set_own_scale: Callable[[float | None], None]
    set_film_frame: Callable[[float | None], Awaitable[None]]
    drawn: Callable[[], None]
    refuse: Callable[[str], None]


class Layout:
    """Elements of one browser's page.

    Parameters
    ----------
    scene : Scene
    start : Controls
        Setting at first.
    handlers : Handlers
    undistorted : bool
        Whether the own frame is shown undistorted.
    own_scale : float or None
        Area of a pixel of the own frame at first [mm^2].
    film : OwnFilm, optional
        Of which frames can be chosen.
    """

    def __init__(
        self, scene: Scene, start: Controls, handlers: Handlers, *, undistorted: bool, own_scale: float | None,
        film: OwnFilm | None = None,
    ) -> None:  # fmt: skip
        self._start, self._handlers = start, handlers
        self.knobs: dict[str, KnobRow] = {}
        self.pictures: dict[str, Picture] = {}
        css = (resources.files("evanesce.live") / "page.css").read_text(encoding="utf-8")
        ui.add_head_html(f"<style>{css}</style>")
        ui.colors(primary="#0b5cad")
        self._build_header(scene)
        self.screen = Screen()
        self.preparing = ui.element("div").classes("preparing").props('aria-hidden="true"')
        self.error = ui.label("").classes("error").props('role="alert" id="error"')
        self.error.set_visibility(False)
        with ui.element("main").classes("body"):
            with ui.element("section").classes("panel").props('aria-label="Settings"'):
                self._build_settings(scene)
            with ui.element("section").classes("stage").props('aria-label="Results"') as self.stage:
                self._build_pictures()
                self._build_own(undistorted, film)
                self._build_charts()
                self._build_upload(own_scale)

    def rows(self) -> tuple[KnobRow, ...]:
        """Return all sliders with a number."""
        return (*self.knobs.values(), self.leds.power)

    def show(self, controls: Controls) -> None:
        """Show a setting in all its elements."""
        for name, row in self.knobs.items():
            row.show(float(getattr(controls, name)))
        self.leds.show(controls.led_power)
        self.material.value, self.along.value = controls.material, controls.along
        self.resolution.value = controls.coarser

    def _build_header(self, scene: Scene) -> None:
        with ui.element("header").classes("top"):
            with ui.element("div").classes("names"):
                ui.html("evanesce", sanitize=False, tag="h1")
                ui.label(scene.title or "a rig without a title").classes("scene-title")
            with ui.element("div").classes("state"):
                self.status = ui.label("preparing").props('role="status" id="status"')
                ui.element("div").props('id="speed"')
            ui.button("Reset", on_click=self._handlers.reset).props("outline no-caps dense")
            save = ui.button("Save as scene", on_click=self._handlers.save)
            save.props("unelevated no-caps dense color=primary")

    def _build_settings(self, scene: Scene) -> None:
        handlers, knobs = self._handlers, knobs_of(scene)

        def row(name: str) -> None:
            start = float(getattr(self._start, name))
            self.knobs[name] = KnobRow(knobs[name], start, lambda value: handlers.set(**{name: value}))

        _heading("Measurement")
        for name in CHAIN_KNOBS:
            row(name)
        with ui.element("div").classes("choice"):
            ui.label("Line along").classes("knob-label")
            self.along = ui.radio({"x": "x", "y": "y"}, value="x", on_change=lambda e: handlers.set(along=e.value))
            self.along.props('inline dense aria-label="Direction of the profile line"')
        _heading("Rig")
        for name in RIG_KNOBS:
            row(name)
        silicones = dict.fromkeys((*material_names(), self._start.material))  # the scene's own besides
        self.material = _choice("Material", {m: m for m in silicones}, self._start.material,
                                lambda value: handlers.set(material=value))  # fmt: skip
        cols, rows = scene.camera.resolution_px
        sizes = {f: f"{cols // f} × {rows // f} px" for f in (1, 2, 4) if cols % f == 0 and rows % f == 0}
        self.resolution = _choice("Resolution", sizes, self._start.coarser, lambda value: handlers.set(coarser=value))
        _heading("LEDs")
        self.leds = LedMap(scene, self._start.led_power, lambda powers: handlers.set(led_power=powers))

    def _build_pictures(self) -> None:
        with ui.element("div").classes("pictures"):
            with _panel("Frame", "as the camera takes it; dashed: window enlarged on the right"):
                self.pictures["frame"] = Picture("frame", "frame of the camera")
            with _panel("Mask against truth", "undistorted and enlarged; dashed: line of the profile"):
                alt = "enlarged window with agreeing, missed and false contact in three colours"
                self.pictures["overlay"] = Picture("overlay", alt, self._handlers.drawn)
                ui.html(_legend(), sanitize=False).classes("legend")
            with _panel("Figures", ""):
                _slot("figures").classes("figures")

    def _build_own(self, undistorted: bool, film: OwnFilm | None) -> None:
        with ui.element("div").classes("pictures own") as self.own_row:
            with _panel("Own frame", "undistorted" if undistorted else "as it is"):
                self.pictures["own"] = Picture("own", "own frame")
            with _panel("Its mask", "blue, by the same threshold and minimum blob size"):
                self.pictures["own_mask"] = Picture("own-mask", "own frame with its mask in blue")
            with _panel("Its figures", ""):
                _slot("own").classes("figures")
                if film is not None:
                    number = ui.number("frame of the film", value=film.largest, min=0, max=film.count - 1, precision=0)
                    number.props("dense outlined").on_value_change(lambda e: self._handlers.set_film_frame(e.value))
                close = ui.button("Close", on_click=self._handlers.close_own)
                close.props('flat no-caps dense aria-label="Close the own frame"')
        self.own_row.set_visibility(False)

    def _build_charts(self) -> None:
        with ui.element("div").classes("charts"):
            with _panel("Histogram", "blue: true contact; grey: elsewhere; black line: own frame"):
                _slot("histogram")
            with _panel("Profile", "along the dashed line; blue: true contact"):
                _slot("profile")

    def _build_upload(self, own_scale: float | None) -> None:
        async def uploaded(event: Any) -> None:
            await self._handlers.open_own(await event.file.read(), event.file.name)

        with ui.element("div").classes("bring"):
            ui.label("Your own frame").classes("knob-label")
            upload = ui.upload(
                auto_upload=True, max_file_size=MAX_BYTES, on_upload=uploaded,
                on_rejected=lambda: self._handlers.refuse(f"own frame: refused (allowed: {ALLOWED})"),
            ).props('accept=".png,.tif,.tiff,.jpg,.jpeg,.bmp"').classes("hidden-upload")  # fmt: skip
            ui.button("Open a frame …", on_click=lambda: upload.run_method("pickFiles")).props("outline no-caps dense")
            ui.number("area of its pixel", value=own_scale, min=0.0, suffix="mm²", format="%.7g",
                      on_change=lambda e: self._handlers.set_own_scale(e.value)).props("dense outlined")  # fmt: skip


def _slot(name: str) -> Element:
    """Make an empty element that :class:`Screen` fills."""
    return ui.element("div").props(f'id="slot-{name}"')


def _heading(text: str) -> None:
    ui.html(text, sanitize=False, tag="h2")


def _choice(label: str, options: dict[Any, str], value: Any, changed: Callable[[Any], None]) -> Any:
    with ui.element("div").classes("choice"):
        ui.label(label).classes("knob-label")
        return ui.select(options, value=value, on_change=lambda e: changed(e.value)).props(
            f'dense outlined options-dense aria-label="{label}"'
        )


@contextlib.contextmanager
def _panel(title: str, hint: str) -> Iterator[None]:
    with ui.element("article").classes("result"):
        with ui.element("div").classes("result-title"):
            ui.html(title, sanitize=False, tag="h2")
            if hint:
                ui.label(hint).classes("hint")
        yield


def _legend() -> str:
    entries = ((AGREE, "agrees"), (MISSED, "missed"), (FALSE, "false"))
    return "".join(f'<span><i style="background:{colour}"></i>{name}</span>' for colour, name in entries)
