"""Light files: what is written comes back, with units, and the contact lies where the light does."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from evanesce.contact.solve import contact_state
from evanesce.core.errors import InputError, WorkError
from evanesce.core.states import PlateLight
from evanesce.optics.projection import Projection
from evanesce.render.exr import UNITS, read_light, write_light
from evanesce.rig import Scene, load_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene(
        "thesis",
        {
            "camera.resolution_px": [400, 300],
            "camera.scale_px_per_mm": 11.7,
            "camera.pixel.pitch_um": 15.5,
            "camera.tilt_x_deg": 3.0,
            "camera.roll_deg": 7.0,
            "finger.position_mm": [4.0, -2.5],
            "grid.samples": 256,
        },
    )


def _light(scene: Scene) -> PlateLight:
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    rng = np.random.default_rng(4)
    return PlateLight(
        radiance=rng.random(view.shape).astype(np.float32),
        variance=rng.random(view.shape).astype(np.float32),
        focal_px=view.focal_px,
        principal_point=view.principal_point,
        samples=12,
    )


def test_light_and_contact_come_back_with_units_and_provenance(scene: Scene, tmp_path: Path) -> None:
    light, state = _light(scene), contact_state(scene, 3.0)
    path = tmp_path / "light.exr"
    write_light(path, scene, light, state, {"seed": 5})
    back = read_light(path)
    np.testing.assert_array_equal(back.light.radiance, light.radiance)
    np.testing.assert_array_equal(back.light.variance, light.variance)
    assert (back.light.focal_px, back.light.principal_point) == (light.focal_px, light.principal_point)
    assert back.light.samples == 12
    assert back.provenance == {"seed": 5}
    assert set(back.contact) == {"gap", "pressure", "mask"}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert json.loads(file.header()["evanesce:units"]) == UNITS
    assert [p.name for p in tmp_path.iterdir()] == ["light.exr"]


def test_contact_lies_where_the_camera_sees_it(scene: Scene, tmp_path: Path) -> None:
    write_light(tmp_path / "l.exr", scene, _light(scene), contact_state(scene, 3.0), {})
    back = read_light(tmp_path / "l.exr")
    mask = back.contact["mask"]
    rows, cols = np.nonzero(mask > 0.5)
    projection = Projection.of(scene.camera, scene.plate)
    x, y = projection.plate_to_ray(*(np.array([p]) for p in scene.finger.position_mm))
    px, py = back.light.principal_point
    # Perspective moves a disc's centroid off its centre's image by far less than a pixel here.
    assert abs(cols.mean() - (x[0] * back.light.focal_px + px)) < 0.3
    assert abs(rows.mean() - (y[0] * back.light.focal_px + py)) < 0.3
    assert np.isnan(back.contact["gap"][0, 0])
    assert (back.contact["gap"][mask == 1] == 0).all()


def test_no_contact_leaves_the_contact_channels_out(scene: Scene, tmp_path: Path) -> None:
    write_light(tmp_path / "dark.exr", scene, _light(scene), None, {})
    assert read_light(tmp_path / "dark.exr").contact == {}


def test_broken_and_unwritable_files_are_named(scene: Scene, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"gone\.exr"):
        read_light(tmp_path / "gone.exr")
    broken = tmp_path / "broken.exr"
    broken.write_bytes(b"\x76\x2f\x31\x01" + bytes(40))
    with pytest.raises(InputError, match=r"broken\.exr"):
        read_light(broken)
    with pytest.raises(WorkError, match="cannot write"):
        write_light(tmp_path / "no" / "light.exr", scene, _light(scene), None, {})
    assert sorted(p.name for p in tmp_path.iterdir()) == ["broken.exr"]
