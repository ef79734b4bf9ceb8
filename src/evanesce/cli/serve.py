"""``evanesce serve``: the live page of a scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evanesce.cli.common import handles_errors, progress
from evanesce.cli.render import SetOption, parse_overrides
from evanesce.core.errors import InputError
from evanesce.core.extras import require

if TYPE_CHECKING:
    from evanesce.live.own import OwnFilm
    from evanesce.measurement.calibration.model import Calibration


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def serve(
        scene: Annotated[str, typer.Argument(help="Scene file, or the name of a shipped scene.")],
        port: Annotated[int, typer.Option("--port", help="Port to listen on; 0: a free one.")] = 8080,
        host: Annotated[
            str, typer.Option("--host", help="Address to listen on; others than 127.0.0.1 are open to other machines.")
        ] = "127.0.0.1",
        frame: Annotated[
            Path | None,
            typer.Option("--frame", help="Your own frame, video or folder of frames, beside the simulation."),
        ] = None,
        calibration: Annotated[
            Path | None, typer.Option("--calibration", help="JSON of `evanesce calibrate`, for your own frames.")
        ] = None,
        mm2_per_px: Annotated[
            float | None, typer.Option("--mm2-per-px", help="Area of a pixel of your own frames in mm².")
        ] = None,
        seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the noise, the same in every frame.")] = 0,
        settings: SetOption = None,
    ) -> None:
        """Show a rig live: sliders for LEDs, force, finger, focus and threshold; frame, mask, area and its error.

        Open the printed address in a browser; Ctrl-C ends it. See docs/howto/live.md.
        """
        from evanesce.contact.solve import check_skin
        from evanesce.effects import active_effects
        from evanesce.measurement.calibration.model import load_calibration
        from evanesce.rig import load_scene, scene_path

        require("page", "the live page")
        loaded = load_scene(scene, parse_overrides(settings))
        active_effects(loaded, scene_path(scene))
        check_skin(loaded)
        if mm2_per_px is not None and not 1e-12 < mm2_per_px < 1e6:
            raise InputError(f"{mm2_per_px:g}", key="--mm2-per-px", allowed="1e-12 to 1e6 mm²")

        from evanesce.live.own import is_film, read_own_file
        from evanesce.live.page import OwnData, run
        from evanesce.live.server import is_loopback, open_socket

        known = None if calibration is None else load_calibration(calibration)
        scale = mm2_per_px if mm2_per_px is not None else None if known is None else known.mm2_per_px
        if frame is None:
            own = OwnData(known, scale)
        elif is_film(frame):
            film = _film(frame, known)
            own = OwnData(known, scale, film.frame(film.largest), film)
        else:
            own = OwnData(known, scale, read_own_file(frame, known))
        listening = open_socket(host, port)
        if not is_loopback(host):
            typer.echo(f"note: the page has no password, and all who reach {host} can use it", err=True)
        address = f"[{host}]" if ":" in host else host
        typer.echo(f"http://{address}:{listening.getsockname()[1]}/  (Ctrl-C ends it)")
        run(loaded, listening, host=host, seed=seed, own=own)


def _film(path: Path, calibration: Calibration | None) -> OwnFilm:
    from evanesce.live.own import read_film

    with progress() as bar:
        return read_film(path, calibration, lambda done, total: bar.report("look through", done, total))
