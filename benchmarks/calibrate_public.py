"""Corners and camera of chessboard photographs beside OpenCV's finders, its `calibrateCamera` and a plumb-line fit.

    python benchmarks/calibrate_public.py FOLDER=COLSxROWS ... [--json FILE]

``FOLDER`` holds pictures of one board of so many inner corners by one camera; OpenCV's finders have to be told, ours
finds out. Without a folder a drawn set is calibrated alone, whose camera is known. Public sets, whose pictures are not
part of this project, on GitHub: hwftw1/CalibrationImg (commit 740de60d, ``left*.jpg``, 9x6),
umbraclet16/graduate_project (65370dc7, ``images/left*.jpg``, 6x5), firiceguo/VisualOdometryUI (64fd991a,
``data/left*.jpg``, 7x7).

The same views and corners go through the same solver (two radial terms), so that what differs is the corners. The error
on held-out views: camera from all views but one, pose of that one fitted. The plumb-line fit uses no board geometry:
centre and two radial terms that make rows and columns of corners straight.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from calibrate import draw
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import KDTree

from evanesce.core.errors import WorkError
from evanesce.measurement.calibration.corners import find_corners
from evanesce.measurement.calibration.fit import calibrate
from evanesce.measurement.calibration.pinhole import fit_pinhole
from evanesce.measurement.calibration.points import BoardView

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
SUFFIXES = (".jpg", ".jpeg", ".png")
SAME_PX = 4.0
"""Corners of two finders within this distance are one [px]."""


def ours(picture: Picture, shape: tuple[int, int]) -> tuple[Array, Array] | None:
    """Return corners and their places on the board, if it is the whole board."""
    try:
        view = find_corners(picture).view("", 1.0)
    except WorkError:
        return None
    return (view.image, view.world) if len(view) == shape[0] * shape[1] else None


def sectors(picture: Picture, shape: tuple[int, int]) -> tuple[Array, Array] | None:
    """Return those of OpenCV's sector finder."""
    found, corners = cv2.findChessboardCornersSB(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), shape)
    return (corners.reshape(-1, 2).astype(float), places(shape)) if found else None


def classic(picture: Picture, shape: tuple[int, int]) -> tuple[Array, Array] | None:
    """Return those of OpenCV's first finder, refined by gradients in a window of 11 px, as its tutorials do."""
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    found, corners = cv2.findChessboardCorners(grey, shape)
    if not found:
        return None
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 40, 1e-3)
    corners = cv2.cornerSubPix(grey, corners, (5, 5), (-1, -1), criteria)
    return corners.reshape(-1, 2).astype(float), places(shape)


FINDERS: Mapping[str, Callable[[Picture, tuple[int, int]], tuple[Array, Array] | None]] = {
    "ours": ours, "OpenCV sectors": sectors, "OpenCV classic": classic,
}  # fmt: skip


def places(shape: tuple[int, int]) -> Array:
    """Return the corners of a board of unit squares in OpenCV's order."""
    return np.mgrid[: shape[0], : shape[1]].T.reshape(-1, 2).astype(float)


def matched(first: tuple[Array, Array], other: tuple[Array, Array]) -> tuple[Array, Array] | None:
    """Return another finder's corners in the order of the first, or None where they are not the same corners."""
    off, which = KDTree(other[0]).query(first[0])
    if off.max() > SAME_PX or len(set(which)) != len(first[0]):
        return None
    return other[0][which], first[1]


def held_out(views: list[BoardView], size: tuple[int, int]) -> float:
    """Return the RMS of corners of views that the camera was not fitted to [px]."""
    square, count = 0.0, 0
    for k, one in enumerate(views):
        fit = fit_pinhole([view for j, view in enumerate(views) if j != k], size)
        flat = np.column_stack([one.world, np.zeros(len(one))])
        _, turn, shift = cv2.solvePnP(flat, one.image, fit.camera_matrix, fit.distortion)
        off = cv2.projectPoints(flat, turn, shift, fit.camera_matrix, fit.distortion)[0][:, 0] - one.image
        square, count = square + float((off**2).sum()), count + len(one)
    return float(np.sqrt(square / count))


def plumb_line(views: list[BoardView], size: tuple[int, int]) -> tuple[Array, float]:
    """Return (cx, cy, a1, a2) that make lines of corners straight, and what is left of straightness [px RMS].

    A point at c + d goes to c + d (1 + a1 q + a2 q^2), q = |d|^2 over the squared half diagonal.
    """
    half = 0.5 * float(np.hypot(*size))
    lines = []
    for view in views:
        for axis in (0, 1):
            for value in np.unique(view.world[:, axis]):
                points = view.image[view.world[:, axis] == value]
                if len(points) > 3:
                    lines.append(points)

    def left(values: Array) -> Array:
        found = []
        for line in lines:
            off = line - values[:2]
            q = (off**2).sum(axis=1, keepdims=True) / half**2
            straight = off * (1.0 + values[2] * q + values[3] * q**2)
            centred = straight - straight.mean(axis=0)
            across = np.linalg.svd(centred, full_matrices=False)[2][1]
            # In pixels of the picture: a map that shrinks everything straightens nothing.
            found.append((centred @ across) / (1.0 + values[2] * q[:, 0] + values[3] * q[:, 0] ** 2))
        return np.concatenate(found)

    start = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2, 0.0, 0.0])
    fit = least_squares(left, start, x_scale=[10.0, 10.0, 0.01, 0.01], loss="soft_l1", f_scale=0.5)
    return fit.x, float(np.sqrt(np.mean(left(fit.x) ** 2)))


def edge_shift(matrix: Array, distortion: Array, size: tuple[int, int]) -> float:
    """Return how far undistortion moves a point 0.8 of the half diagonal from the centre, outwards [px]."""
    centre = np.array([matrix[0, 2], matrix[1, 2]])
    reach = 0.4 * float(np.hypot(*size))
    way = np.array(size) / np.hypot(*size)
    point = (centre + reach * way)[None, None]
    moved = cv2.undistortPoints(point, matrix, distortion, P=matrix)[0, 0]
    return float((moved - point[0, 0]) @ way)


def drawn_set() -> tuple[list[Picture], tuple[int, int], tuple[int, int], dict[str, float]]:
    """Return twelve drawn pictures of a board of 10 x 7 squares, with the camera that they were drawn by."""
    rng, size = np.random.default_rng(11), (960, 720)
    pictures = [cv2.cvtColor(draw(rng, size, (10, 7))[0], cv2.COLOR_GRAY2BGR) for _ in range(12)]
    return pictures, size, (9, 6), {"fx": 0.86 * 960, "cx": 479.5, "cy": 359.5, "k1": -0.18}


def compared(name: str, pictures: list[Picture], size: tuple[int, int], shape: tuple[int, int]) -> dict[str, Any]:
    """Return corners, cameras and held-out errors of all finders on one set."""
    every = {kind: [find(picture, shape) for picture in pictures] for kind, find in FINDERS.items()}
    result: dict[str, Any] = {
        "set": name, "size": size, "pictures": len(pictures),
        "boards_found": {kind: sum(one is not None for one in found) for kind, found in every.items()},
    }  # fmt: skip
    common = []
    for k, own in enumerate(every["ours"]):
        others = {kind: every[kind][k] for kind in FINDERS}
        if own is None or any(one is None for one in others.values()):
            continue
        same = {kind: matched(own, one) for kind, one in others.items() if one is not None}
        if all(one is not None for one in same.values()):
            common.append({kind: BoardView(f"{k}", one[1], one[0]) for kind, one in same.items() if one is not None})
    result["common_views"] = len(common)
    result["cameras"] = {}
    for kind in FINDERS:
        views = [one[kind] for one in common]
        fit = fit_pinhole(views, size)
        entry = {
            "fx": fit.camera_matrix[0, 0], "fy": fit.camera_matrix[1, 1], "cx": fit.camera_matrix[0, 2],
            "cy": fit.camera_matrix[1, 2], "k1": fit.distortion[0], "k2": fit.distortion[1],
            "standard_errors": fit.standard_errors, "held_out_rms_px": held_out(views, size),
            "edge_shift_px": edge_shift(fit.camera_matrix, fit.distortion, size),
        }  # fmt: skip
        off = np.concatenate([one[kind].image - one["ours"].image for one in common])
        entry["corners_from_ours_px"] = {
            "rms": float(np.sqrt((off**2).sum(axis=1).mean())), "mean": off.mean(axis=0).tolist(),
            "worst": float(np.hypot(*off.T).max()),
        }  # fmt: skip
        full = fit_pinhole(views, size, "full")
        entry["with_tangential_and_k3"] = {
            "fx": full.camera_matrix[0, 0],
            "edge_shift_px": edge_shift(full.camera_matrix, full.distortion, size),
        }
        (_, _, a1, a2), rough = plumb_line(views, size)
        entry["plumb_line"] = {
            "edge_shift_px": 0.4 * float(np.hypot(*size)) * (0.64 * a1 + 0.64**2 * a2), "rms_px": rough
        }  # fmt: skip
        result["cameras"][kind] = entry
    whole = calibrate(
        [BoardView(f"{k}", one[1], one[0]) for k, one in enumerate(every["ours"]) if one is not None], size
    )
    result["evanesce_calibrate"] = {
        "fx": float(whole.calibration.camera_matrix[0, 0]), "fx_error": whole.fit.standard_errors.get("fx"),
        "held_out_rms_px": held_out(whole.distinct, size), "outliers": sum(map(len, whole.outliers)),
        "views": len(whole.distinct), "warnings": [warning.code for warning in whole.warnings],
    }  # fmt: skip
    return result


def show(found: dict[str, Any], truth: dict[str, float] | None) -> None:
    """Print one set."""
    boards = ", ".join(f"{kind} {n}" for kind, n in found["boards_found"].items())
    print(f"\n{found['set']}: {found['pictures']} pictures of {found['size']}; boards: {boards}")
    print(f"  {found['common_views']} views in common; px")
    heads = ("fx", "+-", "fy", "cx", "cy", "k1", "k2", "held out", "edge", "plumb", "to ours")
    widths = (9, 7, 9, 8, 8, 9, 9, 10, 8, 8, 9)
    print(f"  {'':16}" + "".join(f"{head:>{width}}" for head, width in zip(heads, widths, strict=True)))
    for kind, c in found["cameras"].items():
        print(
            f"  {kind:16}{c['fx']:9.2f}{c['standard_errors']['fx']:7.2f}{c['fy']:9.2f}{c['cx']:8.2f}{c['cy']:8.2f}"
            f"{c['k1']:9.4f}{c['k2']:9.4f}{c['held_out_rms_px']:10.4f}{c['edge_shift_px']:8.2f}"
            f"{c['plumb_line']['edge_shift_px']:8.2f}{c['corners_from_ours_px']['rms']:9.4f}"
        )
    if truth is not None:
        print("  drawn by        " + ", ".join(f"{key} {value:g}" for key, value in truth.items()))
    own = found["evanesce_calibrate"]
    print(
        f"  evanesce calibrate: fx {own['fx']:.2f} +- {own['fx_error'] or float('nan'):.2f}, held out"
        f" {own['held_out_rms_px']:.4f} px, {own['outliers']} corners left out, {own['warnings']}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="*", metavar="FOLDER=COLSxROWS", help="pictures of a board of inner corners")
    parser.add_argument("--json", type=Path, help="write the figures here as well")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    pictures, size, shape, truth = drawn_set()
    results = [compared("drawn", pictures, size, shape) | {"truth": truth}]
    show(results[0], truth)
    for given in options.folders:
        name, _, board = given.rpartition("=")
        folder = Path(name)
        files = sorted(f for f in folder.iterdir() if f.suffix.lower() in SUFFIXES) if folder.is_dir() else []
        if not files or board.count("x") != 1:
            parser.error(f"{given}: a folder of pictures and the inner corners of its board, such as left=9x6")
        read = [cv2.imread(str(file)) for file in files]
        cols, rows = (int(n) for n in board.split("x"))
        same = [one for one in read if one is not None and one.shape == read[0].shape]
        found = compared(folder.name, same, (read[0].shape[1], read[0].shape[0]), (cols, rows))
        results.append(found)
        show(found, None)
    if options.json:
        options.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
