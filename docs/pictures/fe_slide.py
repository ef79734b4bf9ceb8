"""A rendered slide by finite elements, as a video: ``python docs/pictures/fe_slide.py [FRAMES]``.

Silskin 0 %, 1 N held, mu 0.67, 10 mm at 1 mm/s: the slide that ships with the project, no extra needed. Above the frame
as the camera sees it, below the same with what sticks (blue) and what slips (orange). Writes
``docs/pictures/fe_slide.mp4`` and stills, ``fe_slide.png``; some minutes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.chain.simulate import simulate
from evanesce.contact.fem.library import library_slide, library_slide_state
from evanesce.core.states import ContactState, Frame, PlateGrid, SurfaceState
from evanesce.evaluation.labels import ViewGeometry, label, view_geometry
from evanesce.optics.projection import Projection
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, load_scene
from evanesce.sensor.codec import VideoWriter, write_png

HERE = Path(__file__).resolve().parent
NAME, WAY, SPEED = "silskin_0_mu067", 10.0, 1.0  # [mm], [mm/s]
GRID = PlateGrid(shape=(240, 480), pitch=18.0 / 480)
START = (-4.0, 0.0)
CROP = slice(510, 990), slice(420, 1580)
STICK, SLIP = (0, 130, 255), (255, 140, 0)
STILLS = (0.0, 3.0, 5.5, 9.0)  # [mm]


def _states(frames: int) -> Iterator[tuple[float, ContactState]]:
    for way in np.linspace(0.0, WAY, frames):
        yield float(way), library_slide_state(NAME, float(way), GRID, centre=START, time=float(way / SPEED))


def _picture(scene: Scene, geometry: ViewGeometry, state: ContactState, way: float, index: int) -> NDArray[np.uint8]:
    """Return the frame above its overlay, at half the resolution, with a line of figures."""
    # to 1 mm: the light fields around the finger are computed anew for each place of it
    covered = np.asarray(state.contact_mask)
    middle = float(np.round(covered.sum(axis=0) @ state.grid.x / covered.sum()))
    scene = scene.model_copy(update={"finger": scene.finger.model_copy(update={"position_mm": (middle, 0.0)})})
    shot = simulate(scene, state.normal_force, seed=7, index=index, contact=lambda *_, **__: state, render=render_fast)
    frame = shot.frame.data
    frame = frame if frame.ndim == 3 else np.repeat(frame[..., None], 3, axis=2)
    surface = label(shot.state, geometry, supersample=1).surface_state
    assert surface is not None  # finite elements label every cell
    painted = frame.astype(np.float32)
    for kind, colour in ((SurfaceState.STICK, STICK), (SurfaceState.SLIP, SLIP)):
        painted[surface == kind] = 0.55 * painted[surface == kind] + 0.45 * np.array(colour, np.float32)
    both = [part[CROP].astype(np.float32) for part in (frame, painted)]
    size = (both[0].shape[1] // 2, both[0].shape[0] // 2)
    halves = [cv2.resize(part, size, interpolation=cv2.INTER_AREA).round().astype(np.uint8) for part in both]
    strip = np.zeros((40, size[0], 3), np.uint8)
    stick, slip = ((surface == kind).sum() for kind in (SurfaceState.STICK, SurfaceState.SLIP))
    text = (
        f"slide {way:5.2f} mm   Q {state.tangential_force[0]:.3f} N   area {state.nominal_contact_area:.1f} mm2"
        f"   sticks {100 * stick / max(stick + slip, 1):.0f} %"
    )
    cv2.putText(strip, text, (8, 26), cv2.FONT_HERSHEY_SIMPLEX, 0.48, (255, 255, 255), 1, cv2.LINE_AA)
    return np.vstack([*halves, strip])


def main() -> None:
    """Render the slide and write video and still."""
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else 81
    scene = load_scene("thesis", {"grid.size_mm": 12.0})
    geometry = view_geometry(Projection.of(scene.camera, scene.plate))
    stills: dict[float, NDArray[np.uint8]] = {}
    with VideoWriter(HERE / "fe_slide.mp4", frame_rate_hz=(frames - 1) * SPEED / WAY, quality=26) as film:
        for index, (way, state) in enumerate(_states(frames)):
            picture = _picture(scene, geometry, state, way, index)
            film.add(Frame(data=picture, time=state.time, index=index))
            for still in STILLS:
                if still not in stills and way >= still - 1e-9:
                    stills[still] = picture
    top, bottom = (np.hstack([stills[a], stills[b]]) for a, b in (STILLS[:2], STILLS[2:]))
    write_png(HERE / "fe_slide.png", np.vstack([top, bottom]))
    print(f"{frames} frames, tangential force at the end {library_slide(NAME).scalar('tangential_force', WAY):.3f} N")


if __name__ == "__main__":
    main()
