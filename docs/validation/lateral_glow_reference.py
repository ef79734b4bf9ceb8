"""Subsurface scattering: the diffusion model against a participating medium (slab, finger). Figures and a picture.

Run: python docs/validation/lateral_glow_reference.py (about two minutes)
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import cv2
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

from evanesce.contact.solve import contact_state
from evanesce.optics.interface import fresnel_reflectance
from evanesce.optics.subsurface import profile_kernel
from evanesce.render.fast.subsurface import Spread, body_light
from evanesce.render.reference.medium import Body, Boundary, Silicone, exitance, finger_body, medium_scene, slab_body
from evanesce.render.variant import select
from evanesce.rig import load_scene

Array = NDArray[np.float64]
REFLECTANCE, INDEX = 0.6, 1.41
CELL, SIDE = 0.05, 15.0
PATHS = 200_000


def air_inside() -> float:
    """Reflectance that diffuse light in the body meets at a smooth boundary to air."""
    u, w = np.polynomial.legendre.leggauss(2000)
    mu = 0.5 * (u + 1)
    return float(np.sum(w * mu * fresnel_reflectance(mu, INDEX, 1.0)))


def model(touching: Array, length: float, boundary: Boundary) -> Array:
    """Exitance over entering irradiance on a grid of CELL: the model of optics/subsurface.py."""
    inside = (1 - touching) * (air_inside() if boundary == "air" else 0.0)
    kernel = profile_kernel(REFLECTANCE, length, CELL, len(touching) - 1)
    return np.asarray((1 - inside) * body_light(Spread(kernel), touching, inside))


def axis() -> Array:
    """Return the middles of the model's cells [mm]."""
    n = round(SIDE / CELL)
    return (np.arange(n) + 0.5 - n / 2) * CELL


@dataclass
class Profile:
    """Medium and model by distance from the axis."""

    radius: Array
    medium: Array
    error: Array
    model: Array

    def ratio(self, low: float, high: float) -> str:
        """Return medium, model and their ratio between two distances."""
        some = (self.radius >= low) & (self.radius < high)
        m, d, e = self.medium[some].mean(), self.model[some].mean(), np.sqrt((self.error[some] ** 2).sum()) / some.sum()
        return f"{m:.4f} ± {e:.4f}, model {d:.4f} ({100 * (d / m - 1):+.0f} %)"


def radial(body: Body, touching: Array, length: float, boundary: Boundary, reach: float, seed: int) -> Profile:
    """Trace a body and run the model on the same contact."""
    scene = medium_scene(body, Silicone.of(REFLECTANCE, length, INDEX), boundary)
    rng = np.random.default_rng(seed)
    r, phi = reach * rng.random(PATHS), 2 * np.pi * rng.random(PATHS)
    value = exitance(scene, np.stack([r * np.cos(phi), r * np.sin(phi)], axis=1), seed=seed)
    x = axis()
    flat, distance = model(touching, length, boundary), np.hypot(x[None, :], x[:, None])
    borders = np.linspace(0, reach, 26)
    rows = []
    for low, high in itertools.pairwise(borders):
        some, cells = (r >= low) & (r < high), (distance >= low) & (distance < high)
        # points are even in r, cells in r^2: weigh cells alike
        weighed = float((flat[cells] / distance[cells]).sum() / (1 / distance[cells]).sum())
        rows.append((0.5 * (low + high), value[some].mean(), value[some].std() / np.sqrt(some.sum()), weighed))
    return Profile(*(np.array(column) for column in zip(*rows, strict=True)))


def disc(radius: float) -> Callable[[Array, Array], NDArray[np.bool_]]:
    """Return the test for a disc around the origin."""
    return lambda x, y: np.hypot(x, y) < radius


def slabs() -> dict[tuple[float, Boundary], Profile]:
    """Disc of 1.5 mm on a thick flat slab."""
    x = axis()
    fine = np.hypot(
        *np.meshgrid(np.linspace(-SIDE / 2, SIDE / 2, 5 * x.size), np.linspace(-SIDE / 2, SIDE / 2, 5 * x.size))
    )
    touching = cv2.resize((fine < 1.5).astype(float), (x.size, x.size), interpolation=cv2.INTER_AREA)
    body = slab_body(disc(1.5), half=30.0, depth=30.0, cell=0.05, fine=2.0)
    found = {}
    print("Disc of 1.5 mm on a flat slab, exitance over entering irradiance (two standard deviations are 95 %)")
    for boundary in ("matched", "air"):
        for length in (0.5, 1.0, 2.0):
            p = radial(body, touching, length, boundary, 5.0, 11)
            found[length, boundary] = p
            print(f"  {boundary}, l = {length} mm")
            for low, high in ((0.0, 1.2), (1.6, 2.2), (2.2, 3.0), (3.0, 4.0), (4.0, 5.0)):
                print(f"    {low} to {high} mm: {p.ratio(low, high)}")
    return found


def stripes() -> None:
    """Ridges in contact, grooves open: crest and groove."""
    print("Stripes 0.5 mm wide, 1 mm apart on a flat slab, middle 2 mm")
    x = axis()
    touch = (np.mod(x, 1.0) < 0.5) & (np.abs(x) < 4)
    touching = np.where(np.abs(x[:, None]) < 4, touch[None, :].astype(float), 0.0)
    body = slab_body(
        lambda a, b: (np.mod(a, 1.0) < 0.5) & (np.abs(a) < 4) & (np.abs(b) < 4),
        half=30.0,
        depth=30.0,
        cell=0.1,
        fine=4.0,
    )
    for length in (0.5, 1.0, 2.0):
        scene = medium_scene(body, Silicone.of(REFLECTANCE, length, INDEX), "air")
        points = np.random.default_rng(5).uniform(-1, 1, (PATHS, 2))
        value, crest = exitance(scene, points, seed=5), np.mod(points[:, 0], 1.0) < 0.5
        flat = model(touching, length, "air")
        middle = np.abs(x) < 1
        shown = []
        for name, some, columns in (("crest", crest, touch & middle), ("groove", ~crest, ~touch & middle)):
            medium, error = value[some].mean(), value[some].std() / np.sqrt(some.sum())
            level = flat[np.ix_(middle, columns)].mean()
            shown.append(f"{name} {medium:.4f} ± {error:.4f}, model {level:.4f} ({100 * (level / medium - 1):+.1f} %)")
        print(f"  l = {length} mm: " + "; ".join(shown))


def fingers() -> dict[str, tuple[Profile, float]]:
    """The thesis's finger, pressed: its flank recedes from the glass, which the flat model does not know."""
    found = {}
    for name, scene_name, force, changes in (
        ("smooth, 1 N", "thesis", 1.0, {}),
        ("smooth, 5 N", "thesis", 5.0, {}),
        ("ridged, 1 N, E* 4 MPa", "thesis_ridged", 1.0, {"contact": {"law": "hertz", "reduced_modulus_MPa": 4.0}}),
    ):
        scene = load_scene(scene_name, changes)
        state = contact_state(scene, force)
        n = round(SIDE / CELL)
        cells = round(SIDE / state.grid.pitch)
        start = (state.grid.shape[0] - cells) // 2
        cut = np.asarray(state.contact_mask, float)[start : start + cells, start : start + cells]
        touching = cv2.resize(cut, (n, n), interpolation=cv2.INTER_AREA)
        body = finger_body(scene.finger, state)
        edge = float(np.sqrt(state.nominal_contact_area / np.pi)) if scene.finger.ridges is None else 1.13
        print(f"Finger, {name}: contact {state.nominal_contact_area:.2f} mm^2, l = 0.5 and 1 mm, open skin to air")
        for length in (0.5, 1.0):
            p = radial(body, touching, length, "air", 6.5, 23)
            found[f"{name}, l = {length} mm"] = (p, edge)
            for low, high in ((0.0, 0.6), (0.1, 0.9), (0.6, 1.6), (1.6, 2.6), (2.6, 3.6)):
                a, b = (low, high) if high == 0.6 else (edge + low, edge + high)
                print(f"  l = {length}: {a:.1f} to {b:.1f} mm: {p.ratio(a, b)}")
    return found


def ridge_maps() -> tuple[Array, Array, float]:
    """Maps of a ridged finger, medium and model, 4 mm wide."""
    scene = load_scene("thesis_ridged", {"contact": {"law": "hertz", "reduced_modulus_MPa": 4.0}})
    state = contact_state(scene, 2.0)
    body, reach = finger_body(scene.finger, state), 2.5
    traced = medium_scene(body, Silicone.of(REFLECTANCE, 0.5, INDEX), "air")
    points = np.random.default_rng(3).uniform(-reach, reach, (4 * PATHS, 2))
    value = np.concatenate([exitance(traced, part, seed=k) for k, part in enumerate(np.array_split(points, 4))])
    bins = np.linspace(-reach, reach, 101)
    total = np.histogram2d(points[:, 1], points[:, 0], bins, weights=value)[0]
    count = np.histogram2d(points[:, 1], points[:, 0], bins)[0]
    n, cells = round(SIDE / CELL), round(SIDE / state.grid.pitch)
    start = (state.grid.shape[0] - cells) // 2
    cut = np.asarray(state.contact_mask, float)[start : start + cells, start : start + cells]
    flat = model(cv2.resize(cut, (n, n), interpolation=cv2.INTER_AREA), 0.5, "air")
    keep = np.abs(axis()) < reach
    return total / np.maximum(count, 1), flat[np.ix_(keep, keep)], reach


def picture(flat: dict, pressed: dict, maps: tuple[Array, Array, float]) -> None:
    """Draw profiles and maps."""
    figure, axes = plt.subplots(2, 2, figsize=(11, 8.4), layout="constrained")
    for panel, boundary in ((axes[0, 0], "air"),):
        for colour, length in (("tab:blue", 0.5), ("tab:orange", 1.0), ("tab:green", 2.0)):
            p = flat[length, boundary]
            panel.errorbar(p.radius, p.medium, 2 * p.error, fmt=".", color=colour, label=f"medium, l = {length} mm")
            panel.plot(p.radius, p.model, color=colour, label="model")
        panel.set_title("disc of 1.5 mm on a flat slab, open to air", fontsize=10)
    for colour, name in (("tab:blue", "smooth, 1 N, l = 0.5 mm"), ("tab:orange", "smooth, 5 N, l = 0.5 mm"),
                         ("tab:green", "smooth, 5 N, l = 1.0 mm")):  # fmt: skip
        p, edge = pressed[name]
        axes[0, 1].errorbar(p.radius, p.medium, 2 * p.error, fmt=".", color=colour, label=f"medium, {name}")
        axes[0, 1].plot(p.radius, p.model, color=colour, label="flat model")
        axes[0, 1].axvline(edge, color=colour, linewidth=0.6, linestyle=":")
    axes[0, 1].set_title("pressed finger (dotted: edge of contact)", fontsize=10)
    for panel in axes[0]:
        panel.set_yscale("log")
        panel.set_xlabel("distance from the axis [mm]")
        panel.set_ylabel("exitance / entering irradiance")
        panel.legend(fontsize=7)
    medium, plain, reach = maps
    for panel, image, name in (
        (axes[1, 0], medium, "medium in the ridged finger's mesh"),
        (axes[1, 1], plain, "model"),
    ):
        shown = panel.imshow(image, vmin=0, vmax=0.5, cmap="magma", extent=(-reach, reach, reach, -reach))
        panel.set_title(f"{name}: 2 N, E* 4 MPa, l = 0.5 mm", fontsize=10)
        panel.set_xlabel("x [mm]")
        panel.set_ylabel("y [mm]")
        figure.colorbar(shown, ax=panel, label="exitance / entering irradiance")
    figure.savefig(Path(__file__).resolve().parent.parent / "pictures" / "lateral-glow.png", dpi=110)


def main() -> None:
    """Print the tables and draw the picture."""
    print(f"variant {select('llvm').name}, {PATHS} paths a case, reflectance {REFLECTANCE}")
    flat = slabs()
    stripes()
    pressed = fingers()
    picture(flat, pressed, ridge_maps())


if __name__ == "__main__":
    main()
