"""Figures about the challenge: ``python -m tests.inference.challenge.figures forms`` (decoys, resolution, forces)."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from evanesce.contact.solve import contact_state
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.fast.transport import render_fast
from evanesce.sensor.lens import form_image

from .camera import binned
from .cases import DECOYS, SEPARATES, cause_shot
from .chain import development, rig_of
from .library import make_cause
from .rig import KNOT, believed, fine_scene, pose_of_case, power, presser
from .strength import OutOfReach, Ruler, amplitude_for, base_levels, levels, means, ruler

DRAWS = range(21, 26)
SHOWN = ("sensor_dust", "led_imbalance", "lateral_glow", "residue_film", "scratch", "rolling_shutter")
PICTURE = Path("docs/pictures/challenge-forms.png")


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
    """Print the strength of what a coarser prediction than the injector's gets wrong with nothing hidden.

    Press frames alone; pixels on which the lens blurs, rays of the view along each, samples of the contact grid.
    """
    rig, measure = rig_of(name, 0), ruler(name, 0)
    scene, (x, y), (px, py) = believed(name), believed(name).finger.position_mm, rig.base.pose_mm
    finger = scene.finger.model_copy(update={"position_mm": (x + px, y + py)})
    table = development(rig, ())
    for pixels, rays, samples in ((1, 1, 512), (1, 2, 512), (1, 4, 1024), (2, 2, 1024), (3, 2, 1024)):
        fine = fine_scene(scene.model_copy(update={"finger": finger}), pixels)
        fine = fine.model_copy(update={"grid": fine.grid.model_copy(update={"samples": samples})})
        view = Projection.of(fine.camera, fine.plate).ideal_view()
        (rows, cols), (cx, cy) = view.shape, view.principal_point
        axis = ((cx + 0.5) * rays - 0.5, (cy + 0.5) * rays - 0.5)
        view = IdealView((rows * rays, cols * rays), view.focal_px * rays, axis)
        kept: dict[float, np.ndarray] = {}
        change = np.zeros_like(measure.base)
        for k, seen in enumerate(rig.views):
            if not seen.touches:
                continue
            force = seen.shot.force_N
            if force not in kept:
                light = render_fast(fine, contact_state(fine, force), view=view)
                gathered = form_image(light, fine.camera, fine.plate).irradiance
                kept[force] = binned(gathered, pixels) if pixels > 1 else gathered
            charge = rig.electronics.e_per_irradiance * power(name, seen.shot.voltage_V) * kept[force]
            change[k] = binned(table.level(charge)) - measure.base[k]
        print(
            f"lens on pixels {pixels} times finer, {rays} rays, grid {samples}: {measure.norm(change):.1f}", flush=True
        )


def forces(name: str = "dev") -> None:
    """Print what light at other forces gets wrong, over what the force changes (root mean square).

    By interpolation between pictures, as cases are made, and by a straight line about one, as they were until run f.
    """
    base = rig_of(name, 0).base
    press = presser(believed(name), pose_of_case(name, 0)[0])
    for k in (0, len(base.forces) - 1):
        for log_force in (0.5 * KNOT, 3.5 * KNOT, 6.5 * KNOT):
            true = press(base.forces[k] * float(np.exp(log_force))).astype(float)
            change = np.sqrt(np.mean((true - base.press[k]) ** 2))
            line = np.maximum(base.press[k] + log_force * base.by_log_force[k], 0.0)
            wrong = [float(np.sqrt(np.mean((x - true) ** 2)) / change) for x in (base.pressed(k, log_force), line)]
            print(f"{base.forces[k]:g} N, {100 * np.expm1(log_force):+.1f} %: "
                  f"between pictures {100 * wrong[0]:.1f} %, by a line {100 * wrong[1]:.0f} %", flush=True)  # fmt: skip


def forms(name: str = "dev", strength: float = 40.0) -> None:
    """Draw what some causes of one strength change in the frame of the largest force, by family and by recipe."""
    rig, measure = rig_of(name, 0), ruler(name, 0)
    largest = max(view.shot.force_N for view in rig.views)
    view = next(k for k, v in enumerate(rig.views) if v.kind == "press" and v.shot.force_N == largest)
    figure = Figure(figsize=(14, 4.2), layout="constrained")
    for row, axes in enumerate(figure.subplots(2, len(SHOWN))):
        for cause, axis in zip(SHOWN, axes, strict=True):
            hidden = make_cause(cause, rig, 8, 0, recipe=bool(row))
            try:
                a = amplitude_for(rig, measure, hidden, strength, tolerance=0.05)
            except OutOfReach:
                a = hidden.limit
            change = (levels(rig, [(hidden, a)]) - base_levels(name, 0))[view]
            most = max(float(np.percentile(np.abs(change), 99.97)), 1e-6)
            axis.imshow(change, cmap="RdBu_r", vmin=-most, vmax=most)
            axis.set(xticks=(), yticks=())
            axis.set_title(f"{cause}\n{('family', 'recipe')[row]}, within {most:.2g} DN", fontsize=9)
    figure.savefig(PICTURE, dpi=90)


if __name__ == "__main__":
    {"forms": forms, "decoys": decoys, "resolution": resolution, "forces": forces}[sys.argv[1]]()
