"""A scan as a finger's height map: the contact it makes against that of the ridges it was made from, and bad files."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from evanesce.bench.relief import HeightMap, RepeatedProfile
from evanesce.bench.surface_files import read_skin
from evanesce.contact.ridges.heightmap import RidgeRow
from evanesce.contact.ridges.skin import scanned_depth
from evanesce.contact.solve import contact_state
from evanesce.core.errors import InputError
from evanesce.core.resources import resource
from evanesce.core.states import ContactState
from evanesce.rig import copy_height_map, dump_scene, load_scene

ROW = RidgeRow("parallel", pitch=0.83, width=0.44, height=0.061, orientation=np.radians(17.0), rounding=0.06)
SCAN_PITCH = 0.0137
SHAPE = (731, 790)  # 10.0 mm along y, 10.8 mm along x
POSITION = (1.7, -2.3)
RIDGES = {
    "height_um": 61.0, "width_um": 440.0, "pitch_um": 830.0, "orientation_deg": 17.0, "rounding_um": 60.0
}  # fmt: skip
HALFSPACE = {"law": "halfspace", "reduced_modulus_MPa": 0.61}
LAWS = {"halfspace": HALFSPACE, "hertz": {"law": "hertz", "reduced_modulus_MPa": 0.61}, "fem": {"law": "fem"}}
FORCE = 1.3


@lru_cache
def scan(offset: tuple[float, float] = (0.0, 0.0), turn: float = 0.0) -> np.ndarray:
    """Return heights [mm] of the ridges in a scan whose middle and axes lie off the finger's."""
    rows, cols = SHAPE
    u, v = (np.arange(n) - (n - 1) / 2 for n in (cols, rows))
    u, v = SCAN_PITCH * u[None, :], SCAN_PITCH * v[:, None]
    cos, sin = np.cos(turn), np.sin(turn)
    return -ROW.heights(offset[0] + u * cos - v * sin, offset[1] + u * sin + v * cos)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    text = resource("scenes", "thesis.toml").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    return tmp_path


def settings(**more: object) -> dict[str, object]:
    # Cells of 40 um: three samples of the scan, 21 to a ridge.
    return {"finger.position_mm": list(POSITION), "grid.samples": 240, "grid.size_mm": 9.59, "contact": HALFSPACE} | {
        key.replace("__", "."): value for key, value in more.items()
    }


def scanned(folder: Path, file: str = "scan.npz", contact: dict | None = None, **keys: object):
    return load_scene(
        folder / "rig.toml", settings(contact=contact or HALFSPACE) | {"finger.height_map": {"file": file} | keys}
    )


def write_npz(path: Path, heights: np.ndarray, pitch: object = SCAN_PITCH) -> None:
    np.savez(path, distance_mm=-heights, pitch_mm=pitch)


def write_exr(path: Path, heights_um: np.ndarray) -> None:
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": heights_um.astype(np.float32)}).write(str(path))


@pytest.fixture(scope="module")
def designed() -> dict[str, ContactState]:
    """Contacts of the designed ridges: they know no scan."""
    scenes = {
        law: load_scene("thesis", settings(finger__ridges=RIDGES, contact=LAWS[law])) for law in ("halfspace", "fem")
    }
    return {law: contact_state(scene, FORCE) for law, scene in scenes.items()}


def moved_force(found: ContactState, wanted: ContactState) -> float:
    """Return the share of the force that presses elsewhere: 0 for equal pressures, 1 for disjoint ones."""
    cell = wanted.grid.pitch**2
    return float(0.5 * np.abs(found.pressure - wanted.pressure).sum() * cell / wanted.normal_force)


def test_a_scan_of_designed_ridges_makes_their_contact(folder: Path, designed: dict[str, ContactState]) -> None:
    """A border of contact found to a tenth of a cell, with 21 cells a ridge and two borders, leaves 1 % of the area."""
    wanted, offset, turn = designed["halfspace"], (0.31, -0.22), -24.0
    write_npz(folder / "scan.npz", scan(offset, np.radians(turn)))
    state = contact_state(scanned(folder, offset_mm=list(offset), orientation_deg=turn), FORCE)
    assert state.nominal_contact_area == pytest.approx(wanted.nominal_contact_area, rel=1e-2)
    assert moved_force(state, wanted) < 0.02
    assert (state.law, state.parameters["height_map"]) == ("halfspace+height_map", "scan.npz")
    smooth = contact_state(load_scene("thesis", settings()), FORCE)
    assert smooth.nominal_contact_area > 1.1 * wanted.nominal_contact_area
    # Half a pitch aside, or turned the other way, it is another contact.
    across = 0.5 * ROW.pitch * np.array([-np.sin(ROW.orientation), np.cos(ROW.orientation)])
    for other, angle in ((np.array(offset) + across, turn), (np.array(offset), -turn)):
        wrong = contact_state(scanned(folder, offset_mm=other.tolist(), orientation_deg=angle), FORCE)
        assert moved_force(wrong, wanted) > 0.3


def test_every_kind_of_file_holds_the_same_skin(folder: Path) -> None:
    heights = scan()[:301, :350]
    y, x = np.meshgrid(*(np.linspace(-1, 1, n) for n in heights.shape), indexing="ij")
    tilted = heights + 0.04 * x - 0.11 * y + 3.0  # a scanner's stage is neither level nor at zero
    write_npz(folder / "scan.npz", heights)
    Image.fromarray((1e3 * tilted).astype(np.float32)).save(folder / "scan.tiff")
    write_exr(folder / "scan.exr", 1e6 * tilted)
    np.savetxt(folder / "scan.csv", tilted, delimiter=",", fmt="%.6f")
    wanted = read_skin(folder / "scan.npz", None, None, 1)
    for file, unit in (("scan.tiff", "um"), ("scan.exr", "nm"), ("scan.csv", "mm")):
        found = read_skin(folder / file, SCAN_PITCH, unit, 1)
        assert isinstance(found, HeightMap)
        assert found.pitch == SCAN_PITCH
        np.testing.assert_allclose(found.height, wanted.height, atol=3e-6)


@pytest.mark.parametrize("law", ["fem", "hertz"])
def test_a_scan_rides_on_a_contact_known_from_elsewhere(
    folder: Path, law: str, designed: dict[str, ContactState]
) -> None:
    write_npz(folder / "scan.npz", scan())
    state = contact_state(scanned(folder, contact=LAWS[law]), FORCE)
    # Hertz and the half-space press the same shape with the same modulus; the first ridged model is another.
    wanted = designed["fem" if law == "fem" else "halfspace"]
    assert state.nominal_contact_area == pytest.approx(wanted.nominal_contact_area, rel=1e-2)
    assert moved_force(state, wanted) < 0.02
    assert state.law == f"{law}+height_map"
    smooth = contact_state(load_scene("thesis", settings(contact=LAWS[law])), FORCE)
    assert state.depth == smooth.depth


def test_a_profile_repeats_over_the_finger(folder: Path, designed: dict[str, ContactState]) -> None:
    """Its direction is the ridges' less 90 deg, its middle 0.19 mm beyond a crest along it."""
    x = np.arange(0.0, 4.4 * ROW.pitch, 0.0041)
    across = x - x.mean() + 0.19
    crests_along_y = replace(ROW, orientation=np.pi / 2)
    z = -crests_along_y.heights(-across, np.zeros_like(across)) + 0.003 * x
    table = np.column_stack([x, 1e3 * z])
    np.savetxt(folder / "profile.csv", table, delimiter=",", header="x_mm,z_um", comments="", fmt="%.6f")
    normal = ROW.orientation - np.pi / 2
    for side, right in ((1.0, True), (-1.0, False)):
        offset = [side * 0.19 * np.cos(normal), side * 0.19 * np.sin(normal)]
        state = contact_state(scanned(folder, "profile.csv", orientation_deg=17.0 - 90.0, offset_mm=offset), FORCE)
        moved = moved_force(state, designed["halfspace"])
        assert moved < 0.03 if right else moved > 0.1


@pytest.mark.parametrize("window", [1, 2, 5, 6])
def test_means_over_cells_are_those_of_a_sinusoid(window: int) -> None:
    """The mean of a sinusoid over a cell is a sinusoid, less by sinc: closed form for both kinds of scan."""
    k, pitch, cell = 2 * np.pi / 0.8, 0.01, 0.01 * window
    u = (np.arange(640) - 319.5) * pitch
    x, y = np.array([[-0.613, 0.02, 0.87]]), np.array([[-0.4], [1.03]])
    kept = np.sinc(k * cell / (2 * np.pi))
    found, known, share = scanned_depth(HeightMap(np.tile(np.sin(k * u), (500, 1)), pitch), x, y, cell)
    assert known.all()
    assert share == pytest.approx(kept, rel=1e-3)
    assert found == pytest.approx(np.broadcast_to(-np.sin(k * x) * kept, (2, 3)), abs=2e-3)
    row = RepeatedProfile(np.sin(k * pitch * np.arange(80)), pitch)
    assert scanned_depth(row, x + 8.0, y, cell)[0] == pytest.approx(
        np.broadcast_to(-np.sin(k * x) * kept, (2, 3)), abs=2e-3
    )


def test_columns_run_along_x_and_rows_along_y() -> None:
    heights = np.add.outer(np.arange(40.0) ** 2, 7.0 * np.arange(60.0))
    depth, known, _ = scanned_depth(HeightMap(heights, 0.1), np.array([0.55, 9.0]), np.array([-0.95, 0.0]), 0.1)
    assert -depth[0] == pytest.approx((-0.95 / 0.1 + 19.5) ** 2 + 7.0 * (0.55 / 0.1 + 29.5), rel=1e-3)
    assert known.tolist() == [True, False]


def test_the_scene_keeps_its_map(folder: Path) -> None:
    (folder / "maps").mkdir()
    write_npz(folder / "maps" / "scan.npz", scan())
    scene = scanned(folder, "maps/scan.npz", orientation_deg=3.5)
    digest = hashlib.sha256((folder / "maps" / "scan.npz").read_bytes()).hexdigest()
    assert scene.finger.height_map is not None
    assert scene.finger.height_map.sha256 == digest
    elsewhere = folder / "elsewhere"
    elsewhere.mkdir()
    copy_height_map(scene, elsewhere)
    text = dump_scene(scene)
    assert str(folder) not in text
    (elsewhere / "scene.toml").write_text(text, encoding="utf-8")
    again = load_scene(elsewhere / "scene.toml")
    assert dump_scene(again) == text
    assert again.finger.height_map is not None
    assert Path(again.finger.height_map.file).parent == elsewhere
    first, second = (contact_state(s, 0.4) for s in (scene, again))
    np.testing.assert_array_equal(first.pressure, second.pressure)
    # A map that changed since is not this scene's.
    write_npz(elsewhere / "height_map.npz", 0.5 * scan())
    with pytest.raises(InputError, match="sha256"):
        load_scene(elsewhere / "scene.toml")
    anew = again.finger.height_map.model_copy(update={"form_degree": 2})
    finger = again.finger.model_copy(update={"height_map": anew})
    with pytest.raises(InputError, match="unchanged since"):
        contact_state(again.model_copy(update={"finger": finger}), 0.4)


def test_a_contact_beyond_the_scan_is_refused(folder: Path) -> None:
    write_npz(folder / "scan.npz", scan()[300:460, 300:500])
    scene = scanned(folder)
    assert contact_state(scene, 0.01).nominal_contact_area > 0
    with pytest.raises(InputError, match=r"beyond the scan of 2\.74 x 2\.192 mm"):
        contact_state(scene, 1.0)


def test_a_grid_too_coarse_for_the_scan_is_refused(folder: Path) -> None:
    write_npz(folder / "scan.npz", scan())
    scene = scanned(folder)
    coarse = scene.model_copy(update={"grid": scene.grid.model_copy(update={"samples": 24})})
    with pytest.raises(InputError, match=r"grid\.samples"):
        contact_state(coarse, 1.0)


def _scaled(factor: float):
    return lambda folder: write_npz(folder / "scan.npz", factor * scan()[:64, :64])


def _with_nan(folder: Path) -> None:
    heights = scan()[:64, :80].copy()
    heights[5, 7] = np.nan
    write_npz(folder / "scan.npz", heights)


def _pickled(folder: Path) -> None:
    np.savez(folder / "scan.npz", distance_mm=np.array([[{}] * 40] * 40, dtype=object), pitch_mm=0.01)


def _as_csv(folder: Path) -> None:
    np.savetxt(folder / "m.csv", scan()[:40, :40], delimiter=",")


BAD = [
    (_scaled(1e3), {}, "unit and pitch right"),
    (_scaled(1e-3), {}, "is the unit right"),
    (_scaled(0.0), {}, "unit and pitch right"),
    (lambda f: write_npz(f / "scan.npz", scan()[:64, :64], 13.7), {}, "pitch_mm: 13.7 mm"),
    (lambda f: write_npz(f / "scan.npz", scan()[:64, :64], [0.1, 0.2]), {}, "a number"),
    (lambda f: write_npz(f / "scan.npz", scan()[:31, :64]), {}, "at least 32 x 32"),
    (lambda f: write_npz(f / "scan.npz", scan()[0]), {}, "rows, cols"),
    (lambda f: np.savez(f / "scan.npz", pitch_mm=0.1), {}, "distance_mm"),
    (lambda f: (f / "scan.npz").write_bytes(b"PK\x03\x04 no archive"), {}, "not a readable NPZ"),
    (_with_nan, {}, "1 samples without a height, the first in row 6, column 8"),
    (_pickled, {}, "not a readable NPZ"),
    (_scaled(1.0), {"pitch_um": 13.7}, "says this itself"),
    (lambda f: Image.fromarray(np.zeros((64, 64, 3), np.uint8)).save(f / "scan.tif"),
     {"file": "scan.tif", "pitch_um": 9.0, "height_unit": "um"}, "3 channels"),
    (lambda f: (f / "scan.tif").write_bytes(b"II*\x00garbage"),
     {"file": "scan.tif", "pitch_um": 9.0, "height_unit": "um"}, "not a readable TIFF"),
    (_as_csv, {"file": "m.csv"}, "pitch_um: missing"),
    (_as_csv, {"file": "m.csv", "pitch_um": 9.0}, "height_unit: missing"),
    (lambda f: (f / "p.csv").write_text("x_mm,z_um\n" + "".join(f"{i / 100},{i / 7}\n" for i in range(90))),
     {"file": "p.csv"}, "whole ridge"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "keys", "message"), BAD)
def test_an_unfit_map_is_refused_in_one_line(folder: Path, make, keys: dict, message: str) -> None:
    make(folder)
    scene = scanned(folder, **({"file": "scan.npz"} | keys))
    with pytest.raises(InputError, match=message) as caught:
        contact_state(scene, 0.1)
    assert "\n" not in str(caught.value)


def test_a_map_that_leaves_its_place_is_refused(folder: Path) -> None:
    inner = folder / "inner"
    inner.mkdir()
    (inner / "rig.toml").write_text((folder / "rig.toml").read_text())
    write_npz(folder / "scan.npz", scan()[:64, :64])
    (inner / "link.npz").symlink_to(folder / "scan.npz")
    (inner / "loop.npz").symlink_to("loop.npz")
    (inner / "empty.npz").touch()
    (inner / "scan.txt").write_text("1,2,3")
    bad = {
        "../scan.npz": "leaves the scene's folder",
        str(folder / "scan.npz"): "leaves the scene's folder",
        "link.npz": "leaves the scene's folder",
        "loop.npz": "cannot be read|no such file",
        "a\0b.npz": "cannot be read",
        "absent.npz": "no such file",
        ".": "ending in",
        "scan.txt": "ending in",
        "empty.npz": "0 bytes",
        "": "height_map.file",
    }
    for file, message in bad.items():
        with pytest.raises(InputError, match=message) as caught:
            scanned(inner, file)
        assert "\n" not in str(caught.value)
        assert "rig.toml: finger.height_map.file" in str(caught.value)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"finger.ridges": RIDGES}, "both given"),
        ({"finger.height_map.pitch_mm": 0.0137}, "write pitch_um instead"),
        ({"finger.height_map.pitch_um": float("nan")}, "out of range"),
        ({"finger.height_map.pitch_um": 13700.0}, "0.01 to 1000"),
        ({"finger.height_map.height_unit": "inch"}, "height_unit"),
        ({"finger.height_map.form_degree": 3}, "at most 2"),
        ({"finger.height_map.offset_mm": [0.0, 1e4]}, "-100 to 100"),
        ({"finger.height_map.sha256": "0" * 64}, "sha256"),
        ({"slide": {"distance_mm": 3.0}, "press.forces_N": [1.0]}, "no height map"),
    ],
)
def test_keys_that_cannot_be_are_refused(folder: Path, more: dict, message: str) -> None:
    write_npz(folder / "scan.npz", scan()[:64, :64])
    overrides = settings(contact={"law": "hertz"}) | {"finger.height_map": {"file": "scan.npz"}} | more
    with pytest.raises(InputError, match=message):
        load_scene(folder / "rig.toml", overrides)


def test_laws_that_know_no_relief_say_so(folder: Path) -> None:
    write_npz(folder / "scan.npz", scan())
    with pytest.raises(InputError, match=r"contact\.law"):
        contact_state(scanned(folder, contact={"law": "jkr", "work_of_adhesion_N_per_mm": 1e-4}), 1.0)


def test_adhesion_of_the_finger_widens_a_scans_contact(folder: Path) -> None:
    write_npz(folder / "scan.npz", scan())
    dry = scanned(folder, contact=LAWS["hertz"])
    dry = dry.model_copy(update={"grid": dry.grid.model_copy(update={"samples": 160})})
    finger = dry.finger.model_copy(update={"work_of_adhesion_N_per_mm": 5e-5})
    areas = [contact_state(s, 0.3).nominal_contact_area for s in (dry, dry.model_copy(update={"finger": finger}))]
    assert areas[0] * 1.01 < areas[1] < areas[0] * 1.6


def test_a_round_scan_is_flattened_by_degree_two(folder: Path) -> None:
    """What is left of a paraboloid after a plane is known: (u^2 - mean) / 2R; after degree two, nothing."""
    rows, cols = SHAPE
    u, v = (SCAN_PITCH * (np.arange(n) - (n - 1) / 2) for n in (cols, rows))
    flat, bow = scan(), -(u[None, :] ** 2 + v[:, None] ** 2) / (2 * 31.0)
    write_npz(folder / "flat.npz", flat)
    write_npz(folder / "round.npz", flat + bow)
    wanted, found, bent = (
        read_skin(folder / file, None, None, degree).height
        for file, degree in (("flat.npz", 2), ("round.npz", 2), ("round.npz", 1))
    )
    np.testing.assert_allclose(found - found.mean(), wanted - wanted.mean(), atol=2e-3)
    assert np.ptp(bent) > 10 * np.abs(found - found.mean() - wanted + wanted.mean()).max()
    assert bent[0, 0] < bent[rows // 2, cols // 2] - 0.5
