"""``evanesce simulate``: simulate the measurement bundle of a scene's rig."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from evanesce.cli.common import chosen_variant, console, handles_errors, progress
from evanesce.cli.render import (
    FastOption,
    SetOption,
    VariantOption,
    check_variant,
    full_scale_share,
    parse_overrides,
    show_warnings,
    warn_of_saturation,
)


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def simulate(
        scene: Annotated[str, typer.Argument(help="Scene file, or the name of a shipped scene.")],
        bundle: Annotated[Path, typer.Option("--bundle", help="New or empty folder.")],
        seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of noise and patterns.")] = 0,
        fast: FastOption = True,
        coarser: Annotated[
            int, typer.Option("--camera-coarser", min=1, max=50, help="Pixels this many times as large, same field.")
        ] = 1,
        variant: VariantOption = "auto",
        spp: Annotated[int | None, typer.Option("--spp", min=1, help="Paths per pixel of the reference.")] = None,
        settings: SetOption = None,
    ) -> None:
        """Simulate ramp, hold, voltage sweep, replicates, dark frames and printed cards, and write them as a bundle.

        The bundle includes the scene that made it. See docs/reference/bundle.md.
        """
        from evanesce.bundle import read_bundle
        from evanesce.bundle.write import fine_enough, write_bundle
        from evanesce.contact.slide import slide_warnings
        from evanesce.core import provenance
        from evanesce.effects import active_effects
        from evanesce.rig import load_scene, scene_path
        from evanesce.rig.coarser import coarser_camera

        check_variant(variant)
        loaded = coarser_camera(load_scene(scene, parse_overrides(settings)), coarser)
        active_effects(loaded, scene_path(scene))
        show_warnings(slide_warnings(loaded))
        render, card, record = _renderers(fast, variant, spp)
        finer = max(coarser, fine_enough(loaded)) if fast else 1
        origin = provenance.record(seed=seed, config=loaded.as_dict(), **record)
        with progress() as bar:
            task = bar.add_task("frames", total=None)
            write_bundle(
                bundle, loaded, seed=seed, render=render, card=card, provenance=origin, finer=finer,
                tick=lambda done, total: bar.update(task, completed=done, total=total),
            )  # fmt: skip
        found = read_bundle(bundle, decode=False)
        warn_of_saturation({shot.index: full_scale_share(found.frame(shot)) for shot in found.press})
        console.print(f"Written: {bundle}  (evanesce bundle check {bundle})", highlight=False)


def _renderers(fast: bool, variant: str, spp: int | None) -> tuple[Any, Any, dict[str, Any]]:
    """Return the renderers of contacts and cards, and their record for the provenance."""
    if fast:
        return None, None, {"renderer": "transport"}
    import functools

    from evanesce.render.cards import render_card
    from evanesce.render.reference.path import render

    info = chosen_variant(variant)
    options: dict[str, Any] = {} if spp is None else {"samples_per_pixel": spp}
    trace = functools.partial(render, variant=variant, **options)
    return trace, functools.partial(render_card, variant=variant), {"renderer": "path"} | info.record()
