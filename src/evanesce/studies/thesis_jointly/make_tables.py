"""Compute the tables that the joint judgement interpolates: areas as the rig reads them, ridged over smooth areas.

``python -m evanesce.studies.thesis_jointly.make_tables`` (some minutes) writes ``data/reading.npz`` and
``data/ridges.csv``.

``reading.npz`` holds ``log_ratio`` (areas, shares, lengths, levels), the logarithm of the area that the reference
segmentation reads over the true one, of a smooth contact in the thesis's rig as the nominal scene has it (threshold
0.15), and its axes: ``log_area`` (true area [mm^2]), ``share`` and ``length_mm`` of subsurface scattering, ``level``
(logarithm of the light over the nominal one). ``ridges.csv`` holds the ridged over the smooth area of Silskin 0 % at
1 N, against bone, ridge height and pitch, the mean of a crest and a furrow at the tip and half their difference; and
the share by which the ridged finger is pressed deeper.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

from evanesce.bundle.layout import Series
from evanesce.contact.halfspace.resolved import contact_area
from evanesce.inference.series.predict import SeriesPredictor
from evanesce.materials.tables import read_tables
from evanesce.rig import Scene, load_scene
from evanesce.studies.mechanics.ridges import GRID, Ridging, pressed, ridged_press
from evanesce.studies.mechanics.study import modulus_at_ridges

DATA = Path(__file__).resolve().parent / "data"
READING, RIDGES = DATA / "reading.npz", DATA / "ridges.csv"

AREAS = np.array([4.0, 7.0, 12.0, 20.0, 35.0, 60.0, 100.0, 150.0])
SHARES = np.array([0.0, 0.1, 0.25, 0.45, 0.7, 1.0])
LENGTHS = np.array([0.0, 0.2, 0.4, 0.7, 1.1, 1.6, 2.2])
LEVELS = np.arange(-3.0, 3.01, 0.5)
LEAST = -3.0
"""Logarithm of read over true area where nothing is segmented."""
HEIGHTS = (0.04767, 0.07, 0.1)
PITCHES = (0.75, 1.0, 1.25, 1.5)


def with_area(scene: Scene, area: float) -> Scene:
    """Return a scene whose Hertz contact at 1 N has an area [mm^2].

    Parameters
    ----------
    scene : Scene
    area : float
        [mm^2].

    Returns
    -------
    Scene
    """
    nu = read_tables().poisson_ratio.value
    radius = np.sqrt(area / np.pi)
    plane = 0.75 * scene.finger.tip_radius_mm / radius**3  # Hertz at 1 N [MPa]
    own = {"material": "own", "modulus_MPa": float(plane * (1 - nu**2))}
    return scene.model_copy(update={"finger": scene.finger.model_copy(update=own)})


def reading_table(scene: Scene) -> np.ndarray:
    """Return the logarithm of read over true area (areas, shares, lengths, levels).

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    ndarray
    """
    one = Series(
        name="area", x_name="force", x_unit="N", y_name="area", y_unit="mm2", x=np.ones(1), y=np.ones(1),
        held={"threshold": 0.15},
    )  # fmt: skip
    found = np.zeros((AREAS.size, SHARES.size, LENGTHS.size, LEVELS.size))
    for i, area in enumerate(AREAS):
        predictor = SeriesPredictor(with_area(scene, float(area)))
        for j, share in enumerate(SHARES):
            for k, length in enumerate(LENGTHS):
                if (share == 0 or length == 0) and (j or k):
                    found[i, j, k] = found[i, 0, 0]
                    continue
                glow = {"lateral_glow:share": float(share), "lateral_glow:length_mm": float(length)}
                for m, level in enumerate(LEVELS):
                    point = {"@light": float(level), **(glow if share else {})}
                    found[i, j, k, m] = predictor.log(one, point)[0] - np.log(area)
        print(f"{area:g} mm^2", flush=True)
    return np.maximum(found, LEAST)


def ridge_rows() -> list[tuple[float, ...]]:
    """Return bone share, height, pitch, mean ratio, half the difference of crest and furrow, share of greater depth.

    Returns
    -------
    list of tuple
    """
    modulus = modulus_at_ridges("silskin_0")
    rows: list[tuple[float, ...]] = []
    for share, bone in ((0.0, "none"), (0.5, "half")):
        smooth = pressed(bone, 1.0)
        plain = ridged_press(smooth, modulus, np.zeros(GRID.shape))
        plain_area = contact_area(plain.pressure > 0, GRID.pitch)
        for height in HEIGHTS:
            for pitch in PITCHES:
                found = [
                    ridged_press(smooth, modulus, Ridging(pitch, furrow, 0.0).heights(height))
                    for furrow in (False, True)
                ]
                both = [contact_area(one.pressure > 0, GRID.pitch) / plain_area for one in found]
                half = abs(both[1] - both[0]) / 2
                deeper = (sum(one.depth for one in found) / 2 - plain.depth) / smooth.depth
                rows.append((share, height, pitch, round(sum(both) / 2, 4), round(half, 4), round(deeper, 4)))
    return rows


def main(scene: str) -> None:
    """Write both tables.

    Parameters
    ----------
    scene : str
        Nominal scene of the rig.
    """
    with RIDGES.open("w", newline="", encoding="utf-8") as out:
        writer = csv.writer(out, lineterminator="\n")
        writer.writerow(("bone_share", "height_mm", "pitch_mm", "ratio", "half_difference", "deeper"))
        writer.writerows(ridge_rows())
    axes = {"log_area": np.log(AREAS), "share": SHARES, "length_mm": LENGTHS, "level": LEVELS}
    table = reading_table(load_scene(scene))
    np.savez_compressed(READING, log_ratio=table.astype(np.float32), **axes)


if __name__ == "__main__":
    main(sys.argv[1])
