"""The live page: thin adapter between a browser and :class:`evanesce.live.engine.Engine`."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
import socket
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from importlib import resources
from typing import Any

from evanesce.errors import EvanesceError
from evanesce.extras import require
from evanesce.live.controls import Controls, controls_of, knobs_of
from evanesce.live.engine import Engine, Shown
from evanesce.live.own import ALLOWED, MAX_BYTES, OwnFrame, OwnMeasured, measure_own, read_own
from evanesce.live.pictures import AGREE, FALSE, MISSED
from evanesce.live.present import Presented, present, present_own
from evanesce.live.saved import scene_text
from evanesce.live.worker import Worker
from evanesce.materials.tables import material_names
from evanesce.measurement.calibration import Calibration
from evanesce.rig import Scene

try:
    import uvicorn
    from fastapi import FastAPI
    from nicegui import background_tasks, ui
    from nicegui.client import Client
    from nicegui.element import Element

    from evanesce.live.server import PictureStore, guard
    from evanesce.live.widgets import KnobRow, LedMap, Picture, Screen
except ModuleNotFoundError:
    require("page", "the live page")
    raise

log = logging.getLogger(__name__)

DRAWN_WITHIN_S = 1.0
"""How long a browser has to draw a picture before the next is sent all the same."""

PLACES = ("figures", "own", "histogram", "profile")
"""Parts of the page that are HTML or SVG, by their names in :class:`Presented`."""

RIG_KNOBS = ("voltage_V", "force_N", "ridge_height_um", "defocus_um")
CHAIN_KNOBS = ("threshold", "min_blob_px", "line_mm")
ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="6" fill="#0b3a5b"/>'
    '<circle cx="16" cy="16" r="9" fill="#56b4e9"/></svg>'
)


@dataclass(frozen=True)
class Lab:
    """What a lab has brought along.

    Attributes
    ----------
    calibration : Calibration or None
        Of its own frames.
    mm2_per_px : float or None
        Area of one of their pixels [mm^2].
    frame : OwnFrame or None
        Shown from the start.
    """

    calibration: Calibration | None = None
    mm2_per_px: float | None = None
    frame: OwnFrame | None = None


class Bench:
    """What all browsers share: engine, its thread, and how far it has been prepared."""

    def __init__(self, scene: Scene, seed: int, lab: Lab) -> None:
        self.scene, self.lab = scene, lab
        self.engine, self.worker, self.pictures = Engine(scene, seed=seed), Worker(), PictureStore()
        self.doing, self.since = "", time.monotonic()
        self.first: Future[Shown] = self.worker.submit(lambda: self.engine.prepare(self._tell))

    def _tell(self, text: str) -> None:
        self.doing = text


class Session:
    """One browser's setting and what it is shown; the latest setting wins, none is queued."""

    def __init__(self, bench: Bench, client: Client) -> None:
        self.bench, self.client = bench, client
        self.start = self.wanted = controls_of(bench.scene)
        self.own, self.own_scale = bench.lab.frame, bench.lab.mm2_per_px
        self.token, self.serial = secrets.token_urlsafe(12), 0
        self._busy = self._dirty = False
        self._own_last: tuple[Any, OwnMeasured] | None = None
        self._drawn = asyncio.Event()
        self._drawn.set()
        self._times: deque[float] = deque(maxlen=20)
        self._build()

    # --- what the user does -------------------------------------------------------------------------------------------

    def set(self, **values: Any) -> None:
        """Take new values of some controls."""
        try:
            wanted = self.wanted.changed(**values)
        except EvanesceError as error:
            self._fail(str(error))
            return
        if wanted != self.wanted:
            self.wanted = wanted
            self._ask()

    def reset(self) -> None:
        """Go back to the scene as it was opened."""
        self.wanted = self.start
        for name, row in self._knobs.items():
            row.show(float(getattr(self.start, name)))
        self._leds.show(self.start.led_power)
        self._material.value, self._along.value = self.start.material, self.start.along
        self._resolution.value = self.start.coarser
        self._ask()

    def save(self) -> None:
        """Send the setting as a scene."""
        try:
            text = scene_text(self.bench.scene, self.wanted)
        except EvanesceError as error:
            self._fail(str(error), stale=False)
            return
        ui.download.content(text, "scene.toml", "application/toml")

    async def open_own(self, content: bytes, name: str) -> None:
        """Take a lab's own frame."""
        calibration = self.bench.lab.calibration
        try:
            self.own = await asyncio.wrap_future(self.bench.worker.submit(lambda: read_own(content, name, calibration)))
        except EvanesceError as error:
            self._fail(str(error), stale=False)
            return
        self._ask()

    def close_own(self) -> None:
        """Take the own frame away."""
        self.own = None
        self._ask()

    def set_own_scale(self, value: float | None) -> None:
        """Take the area of a pixel of the own frame [mm^2]."""
        self.own_scale = value if value is not None and 1e-12 < value < 1e6 else None
        self._ask()

    # --- what the page does -------------------------------------------------------------------------------------------

    def _ask(self) -> None:
        """See to it that the latest setting is shown."""
        self._dirty = True
        if not self._busy and self.bench.first.done():
            self._busy = True
            background_tasks.create(self._pump(), name="evanesce live page")

    async def _pump(self) -> None:
        try:
            while self._dirty and not self.client.is_deleted:
                self._dirty = False
                began = time.perf_counter()
                try:
                    found = await asyncio.wrap_future(self.bench.worker.submit(self._job()))
                except EvanesceError as error:
                    self._fail(str(error))
                    continue
                except Exception as error:
                    log.exception("the live page could not show a setting")
                    self._fail(f"this setting cannot be shown: {type(error).__name__}: {error}")
                    continue
                took = time.perf_counter() - began
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._drawn.wait(), DRAWN_WITHIN_S)
                self._publish(found, took)
        finally:
            self._busy = False
        if not self.client.is_deleted:
            self._settle()

    def _job(self) -> Callable[[], Presented]:
        """Return what is to be computed for the setting as it is now."""
        engine, wanted, own, scale = self.bench.engine, self.wanted, self.own, self.own_scale

        def job() -> Presented:
            shown = engine.show(wanted)
            if own is None:
                self._own_last = None
                return present(shown)
            chain = wanted.changed(coarser=1).chain
            key = (id(own), chain, scale)
            if self._own_last is not None and self._own_last[0] == key:
                return present(shown, self._own_last[1])
            measured = measure_own(own, chain, scale)
            self._own_last = (key, measured)
            main, beside = present(shown, measured), present_own(measured)
            return Presented(main.images | beside.images, main.markup | beside.markup, main.note)

        return job

    def _publish(self, found: Presented, took: float) -> None:
        self._drawn.clear()
        self.serial += 1
        self._error.set_visibility(False)
        self._stage.classes(remove="stale")
        self._own_row.set_visibility(self.own is not None)
        self._times.append(time.monotonic())
        self._status.text = "ready" + (f"; {found.note}" if found.note else "")
        parts = {("#speed", "text"): f"{1e3 * took:.0f} ms{self._rate()}", ("#speed", "data-serial"): str(self.serial)}
        for name, picture in self._pictures.items():
            if name in found.images:
                address = self.bench.pictures.put(f"{self.token}-{self.serial}-{name}.jpg", found.images[name])
                parts |= picture.part(address, found.markup.get(name, "") if name in ("frame", "overlay") else "")
        parts |= {(f"#place-{name}", "html"): found.markup[name] for name in PLACES if name in found.markup}
        for row in (*self._knobs.values(), self._leds.power):
            parts |= row.part()
        self._screen.show(parts)

    def _rate(self) -> str:
        """Return the updates per second of the last while, where there is a while."""
        if len(self._times) < 3 or self._times[-1] - self._times[-3] > 0.5:
            return ""
        recent = [t for t in self._times if self._times[-1] - t < 2.0]
        return f", {(len(recent) - 1) / (recent[-1] - recent[0]):.0f} updates/s" if len(recent) > 2 else ""

    def _fail(self, line: str, *, stale: bool = True) -> None:
        """Say in one line what is wrong; what was shown stays, dimmed if it is not of the setting."""
        self._error.text = " ".join(line.split())
        self._error.set_visibility(True)
        self._settle()
        if stale:
            self._stage.classes(add="stale")
            self._status.text = "not shown"
            self._screen.show({("#speed", "text"): ""})

    def _settle(self) -> None:
        for row in (*self._knobs.values(), self._leds.power):
            row.settle()

    async def watch(self) -> None:
        """Say how far the preparation is, then show the first picture."""
        first, bench = self.bench.first, self.bench
        while not first.done():
            if self.client.is_deleted:
                return
            self._status.text = f"preparing: {bench.doing} … {time.monotonic() - bench.since:.0f} s"
            await asyncio.sleep(0.3)
        self._preparing.set_visibility(False)
        self._ask()

    # --- how it looks -------------------------------------------------------------------------------------------------

    def _build(self) -> None:
        ui.add_head_html(
            f"<style>{(resources.files('evanesce.live') / 'page.css').read_text(encoding='utf-8')}</style>"
        )
        ui.colors(primary="#0b5cad")
        scene = self.bench.scene
        with ui.element("header").classes("top"):
            with ui.element("div").classes("names"):
                ui.html("evanesce", sanitize=False, tag="h1")
                ui.label(scene.title or "a rig without a title").classes("scene-title")
            with ui.element("div").classes("state"):
                self._status = ui.label("preparing").props('role="status" id="status"')
                ui.element("div").props('id="speed"')
            ui.button("Reset", on_click=self.reset).props("outline no-caps dense")
            ui.button("Save as scene", on_click=self.save).props("unelevated no-caps dense color=primary")
        self._screen = Screen()
        self._preparing = ui.element("div").classes("preparing").props('aria-hidden="true"')
        self._error = ui.label("").classes("error").props('role="alert" id="error"')
        self._error.set_visibility(False)
        with ui.element("main").classes("body"):
            with ui.element("section").classes("panel").props('aria-label="Settings"'):
                self._build_panel(scene)
            with ui.element("section").classes("stage").props('aria-label="Results"') as self._stage:
                self._build_stage()

    def _build_panel(self, scene: Scene) -> None:
        knobs = knobs_of(scene)
        self._knobs: dict[str, KnobRow] = {}

        def row(name: str) -> None:
            start = float(getattr(self.start, name))
            self._knobs[name] = KnobRow(knobs[name], start, lambda value: self.set(**{name: value}))

        _heading("Measurement")
        for name in CHAIN_KNOBS:
            row(name)
        with ui.element("div").classes("choice"):
            ui.label("Line along").classes("knob-label")
            self._along = ui.radio({"x": "x", "y": "y"}, value="x", on_change=lambda e: self.set(along=e.value))
            self._along.props('inline dense aria-label="Direction of the profile line"')
        _heading("Rig")
        for name in RIG_KNOBS:
            row(name)
        self._material = _choice("Material", {m: m for m in material_names()}, self.start.material,
                                 lambda value: self.set(material=value))  # fmt: skip
        cols, rows = scene.camera.resolution_px
        sizes = {f: f"{cols // f} × {rows // f} px" for f in (1, 2, 4) if cols % f == 0 and rows % f == 0}
        self._resolution = _choice("Resolution", sizes, self.start.coarser, lambda value: self.set(coarser=value))
        _heading("LEDs")
        self._leds = LedMap(scene, self.start.led_power, lambda powers: self.set(led_power=powers))

    def _build_stage(self) -> None:
        self._pictures: dict[str, Picture] = {}
        with ui.element("div").classes("pictures"):
            with _card("Frame", "as the camera takes it; dashed: enlarged beside"):
                self._pictures["frame"] = Picture("frame", "frame of the camera")
            with _card("Mask against truth", "undistorted and enlarged; dashed: line of the profile"):
                alt = "enlarged window with agreeing, missed and false contact in three colours"
                self._pictures["overlay"] = Picture("overlay", alt, self._drawn.set)
                ui.html(_legend(), sanitize=False).classes("legend")
            with _card("Figures", ""):
                _place("figures").classes("figures")
        with ui.element("div").classes("pictures own") as self._own_row:
            with _card("Own frame", "undistorted" if self.bench.lab.calibration else "as it is"):
                self._pictures["own"] = Picture("own", "own frame")
            with _card("Its mask", "blue, by the same threshold and least blob"):
                self._pictures["own_mask"] = Picture("own-mask", "own frame with its mask in blue")
            with _card("Its figures", ""):
                _place("own").classes("figures")
                ui.button("Close", on_click=self.close_own).props('flat no-caps dense aria-label="Close the own frame"')
        self._own_row.set_visibility(False)
        with ui.element("div").classes("charts"):
            with _card("Histogram", "blue: truly in contact; grey: elsewhere; black line: own frame"):
                _place("histogram")
            with _card("Profile", "along the dashed line; blue: truly in contact"):
                _place("profile")
        self._build_own()

    def _build_own(self) -> None:
        async def uploaded(event: Any) -> None:
            await self.open_own(await event.file.read(), event.file.name)

        with ui.element("div").classes("bring"):
            ui.label("Your own frame").classes("knob-label")
            upload = ui.upload(
                auto_upload=True, max_file_size=MAX_BYTES, on_upload=uploaded,
                on_rejected=lambda: self._fail(f"own frame: refused (allowed: {ALLOWED})", stale=False),
            ).props('accept=".png,.tif,.tiff,.jpg,.jpeg,.bmp"').classes("hidden-upload")  # fmt: skip
            ui.button("Open a frame …", on_click=lambda: upload.run_method("pickFiles")).props("outline no-caps dense")
            ui.number("area of its pixel", value=self.own_scale, min=0.0, suffix="mm²", format="%.7g",
                      on_change=lambda e: self.set_own_scale(e.value)).props("dense outlined")  # fmt: skip


def _place(name: str) -> Element:
    """Make an empty place that :class:`Screen` fills."""
    return ui.element("div").props(f'id="place-{name}"')


def _heading(text: str) -> None:
    ui.html(text, sanitize=False, tag="h2")


def _choice(label: str, options: dict[Any, str], value: Any, changed: Callable[[Any], None]) -> Any:
    with ui.element("div").classes("choice"):
        ui.label(label).classes("knob-label")
        return ui.select(options, value=value, on_change=lambda e: changed(e.value)).props(
            f'dense outlined options-dense aria-label="{label}"'
        )


@contextlib.contextmanager
def _card(title: str, hint: str) -> Any:
    with ui.element("article").classes("card"):
        with ui.element("div").classes("card-title"):
            ui.html(title, sanitize=False, tag="h2")
            if hint:
                ui.label(hint).classes("hint")
        yield


def _legend() -> str:
    entries = ((AGREE, "agrees"), (MISSED, "missed"), (FALSE, "false"))
    return "".join(f'<span><i style="background:{colour}"></i>{name}</span>' for colour, name in entries)


def run(scene: Scene, listening: socket.socket, *, host: str, seed: int, lab: Lab) -> None:
    """Serve a scene's page on a socket until interrupted."""
    bench, app = Bench(scene, seed, lab), FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    guard(app, host, MAX_BYTES)
    bench.pictures.serve(app)

    @ui.page("/", title="evanesce, live")
    def page(client: Client) -> None:
        session = Session(bench, client)
        background_tasks.create(session.watch(), name="evanesce preparation")

    ui.run_with(
        app, title="evanesce, live", favicon=ICON, tailwind=False, show_welcome_message=False, language="en-US",
        binding_refresh_interval=None, gzip_middleware_factory=None,
    )  # fmt: skip
    config = uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=1)
    with contextlib.suppress(KeyboardInterrupt):
        uvicorn.Server(config).run(sockets=[listening])


__all__ = ["Controls", "Lab", "run"]
