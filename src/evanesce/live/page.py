"""Live page: adapter between a browser and :class:`evanesce.live.engine.Engine`."""

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
from typing import Any

from evanesce.core.errors import EvanesceError
from evanesce.core.extras import require
from evanesce.live.controls import Controls, controls_of
from evanesce.live.engine import Engine, Shown
from evanesce.live.own import MAX_BYTES, OwnFilm, OwnFrame, OwnMeasured, measure_own, read_own
from evanesce.live.present import Presented, present, present_own
from evanesce.live.saved import scene_text
from evanesce.live.worker import Worker
from evanesce.measurement.calibration.model import Calibration
from evanesce.rig import Scene

try:
    import uvicorn
    from fastapi import FastAPI
    from nicegui import background_tasks, ui
    from nicegui.client import Client

    from evanesce.live.layout import Handlers, Layout
    from evanesce.live.server import PictureStore, guard
except ModuleNotFoundError:
    require("page", "the live page")
    raise

log = logging.getLogger(__name__)

DRAWN_WITHIN_S = 1.0
"""Time that a browser has to draw a picture before the next is sent regardless [s]."""

CONNECTED_WITHIN_S = 30.0
"""Time that a browser has to connect [s]."""

SLOTS = ("figures", "own", "histogram", "profile")
"""Parts of the page that are HTML or SVG, by their names in :class:`Presented`."""

ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><rect width="32" height="32" rx="6" fill="#0b3a5b"/>'
    '<circle cx="16" cy="16" r="9" fill="#56b4e9"/></svg>'
)


@dataclass(frozen=True)
class OwnData:
    """Data of the user's own rig to show beside the simulation.

    Attributes
    ----------
    calibration : Calibration or None
        Of its own frames.
    mm2_per_px : float or None
        Area of one of their pixels [mm^2].
    frame : OwnFrame or None
        Shown from the start.
    film : OwnFilm or None
        From which it is, and others can be chosen.
    """

    calibration: Calibration | None = None
    mm2_per_px: float | None = None
    frame: OwnFrame | None = None
    film: OwnFilm | None = None


class SharedEngine:
    """What all browsers share: the engine, its thread, and the state of its preparation."""

    def __init__(self, scene: Scene, seed: int, own: OwnData) -> None:
        self.scene, self.own = scene, own
        self.engine, self.worker, self.pictures = Engine(scene, seed=seed), Worker(), PictureStore()
        self.step, self.since = "", time.monotonic()
        self.first: Future[Shown] = self.worker.submit(lambda: self.engine.prepare(self._report))

    def _report(self, text: str) -> None:
        self.step = text


class Session:
    """Setting and results of one browser; the latest setting replaces earlier ones, none is queued."""

    def __init__(self, shared: SharedEngine, client: Client) -> None:
        self.shared, self.client = shared, client
        self.start = self.wanted = controls_of(shared.scene)
        self.own, self.own_scale = shared.own.frame, shared.own.mm2_per_px
        self.token, self.serial = secrets.token_urlsafe(12), 0
        self._busy = self._dirty = False
        self._own_last: tuple[Any, OwnMeasured] | None = None
        self._drawn = asyncio.Event()
        self._drawn.set()
        self._times: deque[float] = deque(maxlen=20)
        handlers = Handlers(
            set=self.set, reset=self.reset, save=self.save, open_own=self.open_own, close_own=self.close_own,
            set_own_scale=self.set_own_scale, set_film_frame=self.set_film_frame, drawn=self._drawn.set,
            refuse=lambda line: self._fail(line, stale=False),
        )  # fmt: skip
        self._layout = Layout(
            shared.scene, self.start, handlers, undistorted=shared.own.calibration is not None,
            own_scale=self.own_scale, film=shared.own.film,
        )  # fmt: skip

    # --- actions of the user ------------------------------------------------------------------------------------------

    def set(self, **values: Any) -> None:
        """Set some controls."""
        try:
            wanted = self.wanted.changed(**values)
        except EvanesceError as error:
            self._fail(str(error))
            return
        if wanted != self.wanted:
            self.wanted = wanted
            self._ask()

    def reset(self) -> None:
        """Return to the scene as it was opened."""
        self.wanted = self.start
        self._layout.show(self.start)
        self._ask()

    def save(self) -> None:
        """Download the setting as a scene."""
        try:
            text = scene_text(self.shared.scene, self.wanted)
        except EvanesceError as error:
            self._fail(str(error), stale=False)
            return
        ui.download.content(text, "scene.toml", "application/toml")

    async def open_own(self, content: bytes, name: str) -> None:
        """Show an uploaded frame."""
        calibration = self.shared.own.calibration
        try:
            self.own = await asyncio.wrap_future(
                self.shared.worker.submit(lambda: read_own(content, name, calibration))
            )
        except EvanesceError as error:
            self._fail(str(error), stale=False)
            return
        self._ask()

    async def set_film_frame(self, number: float | None) -> None:
        """Show another frame of the own film."""
        film = self.shared.own.film
        if film is None or number is None:
            return
        try:
            self.own = await asyncio.to_thread(film.frame, int(number))
        except EvanesceError as error:
            self._fail(str(error), stale=False)
            return
        self._ask()

    def close_own(self) -> None:
        """Close the own frame."""
        self.own = None
        self._ask()

    def set_own_scale(self, value: float | None) -> None:
        """Set the area of a pixel of the own frame [mm^2]."""
        self.own_scale = value if value is not None and 1e-12 < value < 1e6 else None
        self._ask()

    # --- computation and display --------------------------------------------------------------------------------------

    def _ask(self) -> None:
        """Start the computation of the latest setting, unless one runs that will include it."""
        self._dirty = True
        if not self._busy and self.shared.first.done():
            self._busy = True
            background_tasks.create(self._pump(), name="evanesce live page")

    async def _pump(self) -> None:
        try:
            while self._dirty and not self.client.is_deleted:
                self._dirty = False
                began = time.perf_counter()
                try:
                    found = await asyncio.wrap_future(self.shared.worker.submit(self._job()))
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
        """Return the computation of the present setting."""
        engine, wanted, own, scale = self.shared.engine, self.wanted, self.own, self.own_scale

        def job() -> Presented:
            shown = engine.show(wanted)
            if own is None:
                self._own_last = None
                return present(shown)
            measured, new = self._measured(own, wanted, scale)
            main = present(shown, measured)
            if not new:
                return main
            beside = present_own(measured)
            return Presented(main.images | beside.images, main.markup | beside.markup, main.note)

        return job

    def _measured(self, own: OwnFrame, wanted: Controls, scale: float | None) -> tuple[OwnMeasured, bool]:
        """Return the own frame measured by a setting, and whether that was not shown before."""
        chain = wanted.changed(coarser=1).chain
        key = (id(own), chain, scale)
        if self._own_last is not None and self._own_last[0] == key:
            return self._own_last[1], False
        self._own_last = (key, measure_own(own, chain, scale))
        return self._own_last[1], True

    async def _show_own(self) -> None:
        """Show the own frame and its mask while the simulation is still prepared."""
        own = self.own
        if own is None:
            return
        measured, new = await asyncio.to_thread(self._measured, own, self.wanted, self.own_scale)
        if not new or self.client.is_deleted:
            return
        self.serial += 1
        self._layout.own_row.set_visibility(True)
        self._layout.screen.show(self._parts(present_own(measured)))

    def _publish(self, found: Presented, took: float) -> None:
        self._drawn.clear()
        self.serial += 1
        self._layout.error.set_visibility(False)
        self._layout.stage.classes(remove="stale")
        self._layout.own_row.set_visibility(self.own is not None)
        self._times.append(time.monotonic())
        self._layout.status.text = "ready" + (f"; {found.note}" if found.note else "")
        parts = {("#speed", "text"): f"{1e3 * took:.0f} ms{self._rate()}", ("#speed", "data-serial"): str(self.serial)}
        parts |= self._parts(found)
        for row in self._layout.rows():
            parts |= row.part()
        self._layout.screen.show(parts)

    def _parts(self, found: Presented) -> dict[tuple[str, str], str]:
        """Return pictures and markup for :class:`Screen`."""
        parts: dict[tuple[str, str], str] = {}
        for name, picture in self._layout.pictures.items():
            if name in found.images:
                address = self.shared.pictures.put(f"{self.token}-{self.serial}-{name}.jpg", found.images[name])
                parts |= picture.part(address, found.markup.get(name, "") if name in ("frame", "overlay") else "")
        return parts | {(f"#slot-{name}", "html"): found.markup[name] for name in SLOTS if name in found.markup}

    def _rate(self) -> str:
        """Return the rate of recent updates in words; empty where there are too few."""
        if len(self._times) < 3 or self._times[-1] - self._times[-3] > 0.5:
            return ""
        recent = [t for t in self._times if self._times[-1] - t < 2.0]
        return f", {(len(recent) - 1) / (recent[-1] - recent[0]):.0f} updates/s" if len(recent) > 2 else ""

    def _fail(self, line: str, *, stale: bool = True) -> None:
        """Show an error; earlier results remain, dimmed if they are of another setting."""
        self._layout.error.text = " ".join(line.split())
        self._layout.error.set_visibility(True)
        self._settle()
        if stale:
            self._layout.stage.classes(add="stale")
            self._layout.status.text = "not shown"
            self._layout.screen.show({("#speed", "text"): ""})

    def _settle(self) -> None:
        for row in self._layout.rows():
            row.settle()

    async def watch(self) -> None:
        """Show the state of the preparation, then the first picture."""
        first, shared = self.shared.first, self.shared
        with contextlib.suppress(TimeoutError):
            await self.client.connected(CONNECTED_WITHIN_S)  # what is sent to the screen before is lost
        while not first.done():
            if self.client.is_deleted:
                return
            self._layout.status.text = f"preparing: {shared.step} … {time.monotonic() - shared.since:.0f} s"
            await self._show_own()
            await asyncio.sleep(0.3)
        self._layout.preparing.set_visibility(False)
        self._ask()


def run(scene: Scene, listening: socket.socket, *, host: str, seed: int, own: OwnData) -> None:
    """Serve a scene's page on a socket until interrupted.

    Parameters
    ----------
    scene : Scene
    listening : socket.socket
        From :func:`~evanesce.live.server.open_socket`.
    host : str
    seed : int
        Of the camera's noise, the same in every frame.
    own : OwnData
    """
    shared, app = SharedEngine(scene, seed, own), FastAPI(docs_url=None, redoc_url=None, openapi_url=None)
    guard(app, host, MAX_BYTES)
    shared.pictures.serve(app)

    @ui.page("/", title="evanesce, live")
    def page(client: Client) -> None:
        session = Session(shared, client)
        background_tasks.create(session.watch(), name="evanesce preparation")

    ui.run_with(
        app, title="evanesce, live", favicon=ICON, tailwind=False, show_welcome_message=False, language="en-US",
        binding_refresh_interval=None, gzip_middleware_factory=None,
    )  # fmt: skip
    config = uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=1)
    with contextlib.suppress(KeyboardInterrupt):
        uvicorn.Server(config).run(sockets=[listening])


__all__ = ["OwnData", "run"]
