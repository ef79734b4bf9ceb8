"""Figures of docs/criticism-challenge.md: ``python -m tests.challenge.figures decoys`` or ``resolution``."""

from __future__ import annotations

import sys

import numpy as np

from evanesce.bundle.card_light import card_light
from evanesce.contact.solve import contact_state
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.cards import checkerboard_of, pose_of, square_of
from evanesce.render.transport import render_fast
from evanesce.sensor.lens import form_image

from .camera import binned
from .cases import DECOYS, SEPARATES, cause_shot
from .chain import development, rig_of
from .library import make_cause
from .rig import COLS, ROWS, believed, pose_of_case, power
from .strength import Ruler, amplitude_for, means, ruler

DRAWS = range(21, 26)


def decoys(name: str = "dev", strength: float = 10.0) -> None:
    """Print how far each decoy case is from the span of five shapes of its decoy, with and without the shots."""
    rig, whole = rig_of(name, 0), ruler(name, 0)

    def change(cause: str, seed: int, measure: Ruler) -> np.ndarray:
        hidden = make_cause(cause, rig, seed, 0, True)
        a = amplitude_for(rig, measure, hidden, strength, tolerance=0.05)
        return means(rig, [(hidden, a)]) - whole.base

    for cause, decoy, shot in DECOYS:
        lacking = whole.without(tuple(s for s in SEPARATES[shot] if s != cause_shot(cause)), rig.views)
        own, others = change(cause, 3, lacking), [change(decoy, k, lacking) for k in DRAWS]
        found = []
        for measure in (lacking, whole):
            gram = np.array([[measure.inner(x, y) for y in others] for x in others])
            onto = np.array([measure.inner(own, x) for x in others])
            inverse = np.linalg.pinv(gram, rcond=1e-6, hermitian=True)
            found.append(measure.inner(own, own) - float(onto @ inverse @ onto))
        print(f"{cause} {decoy}: without {found[0]:.1f}, with {found[1]:.0f}", flush=True)


def resolution(name: str = "dev") -> None:
    """Print the strength of what a coarser prediction than the injector's gets wrong with nothing hidden."""
    rig, measure = rig_of(name, 0), ruler(name, 0)
    scene, (x, y), (px, py) = believed(name), believed(name).finger.position_mm, rig.base.pose_mm
    finger = scene.finger.model_copy(update={"position_mm": (x + px, y + py)})
    table = development(rig, ())
    card = pose_of_case(name, 0)[1]
    for finer, samples in ((1, 512), (3, 512), (3, 1024)):
        grid = scene.grid.model_copy(update={"samples": samples})
        coarse = scene.model_copy(update={"finger": finger, "grid": grid})
        view = Projection.of(coarse.camera, coarse.plate).ideal_view()
        (rows, cols), (cx, cy) = view.shape, view.principal_point
        axis = ((cx + 0.5) * finer - 0.5, (cy + 0.5) * finer - 0.5)
        view = IdealView((rows * finer, cols * finer), view.focal_px * finer, axis)
        kept: dict[object, np.ndarray] = {}
        pictures = []
        for seen in rig.views:
            key = seen.shot.force_N if seen.touches else seen.kind
            if key not in kept:
                light = None
                if seen.touches:
                    light = render_fast(coarse, contact_state(coarse, seen.shot.force_N), view=view)
                elif seen.is_card:
                    printed = (checkerboard_of if seen.kind == "checkerboard" else square_of)(coarse.card)
                    light = card_light(coarse, printed, pose_of(coarse.card, card), view=view)
                dark = np.zeros((ROWS, COLS))
                kept[key] = dark if light is None else form_image(light, coarse.camera, coarse.plate).irradiance
            share = power(name, seen.shot.voltage_V) if seen.touches else 1.0
            pictures.append(binned(table.level(rig.electronics.e_per_irradiance * share * kept[key])))
        print(
            f"view {finer} times finer, grid {samples}: {measure.norm(np.array(pictures) - measure.base):.1f}",
            flush=True,
        )


if __name__ == "__main__":
    {"decoys": decoys, "resolution": resolution}[sys.argv[1]]()
