"""Scenes: what ships is valid and traceable; what is wrong is refused in one line that names file, key and range."""

from __future__ import annotations

import json
import math
import tomllib
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evanesce.core.errors import InputError
from evanesce.core.resources import resource
from evanesce.rig import Camera, Plate, Scene, dump_scene, load_scene
from evanesce.rig.load import validate

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = sorted(p.stem for p in resource("scenes").glob("*.toml"))


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenes_load_and_survive_a_round_trip(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    copy = tmp_path / "copy.toml"
    copy.write_text(dump_scene(scene), encoding="utf-8")
    assert load_scene(copy) == scene


@pytest.mark.parametrize("name", SHIPPED)
def test_every_figure_of_a_shipped_scene_is_a_source_or_an_assumption(name: str) -> None:
    scene = load_scene(name)
    data = tomllib.loads(resource("scenes", f"{name}.toml").read_text(encoding="utf-8"))
    known = set(scene.sources) | set(scene.assumptions)
    settings = ("grid", "render", "schema_version", "sources", "assumptions", "title", "press.forces_N")
    free = {"finger.position_mm", "finger.material", "contact.law", "leds.edges", "finger.ridges.pattern"}

    def leaves(value: object, at: str = "") -> list[str]:
        if isinstance(value, dict):
            return [leaf for k, v in value.items() for leaf in leaves(v, f"{at}.{k}" if at else k)]
        return [at]

    unexplained = [k for k in leaves(data) if k not in known | free and not k.startswith(settings)]
    assert unexplained == []


def test_thesis_scene_agrees_with_the_published_figures() -> None:
    reference = ROOT.parent / "shared" / "reference" / "thesis.toml"
    if not reference.is_file():
        pytest.skip(f"the published figures are not here: {reference} does not exist")
    thesis = tomllib.loads(reference.read_text(encoding="utf-8"))
    scene = load_scene("thesis_ridged")
    assert scene.plate.thickness_mm == thesis["waveguide"]["glass_thickness_mm"]
    assert scene.leds.voltage_V == thesis["waveguide"]["led_voltage_V"]["used"]
    assert scene.press.frame_rate_hz == thesis["waveguide"]["frame_rate_hz"]
    assert scene.finger.tip_radius_mm == thesis["finger"]["tip_radius_mm"]
    assert scene.finger.diameter_mm == thesis["finger"]["diameter_mm"]
    assert scene.finger.length_mm == thesis["finger"]["length_mm"]
    assert scene.finger.ridges is not None
    assert scene.finger.ridges.height_um == thesis["finger"]["ridges"]["moulded_height_um"]
    assert scene.finger.ridges.width_um == thesis["finger"]["ridges"]["moulded_width_um"]
    # 0.0002935 mm^2 a pixel is printed to four digits
    assert scene.camera.scale_px_per_mm**-2 == pytest.approx(thesis["waveguide"]["area_per_pixel_mm2"], rel=2e-4)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ({"plate.thicknes_mm": 3.0}, ["plate.thicknes_mm", "unknown key", "thickness_mm"]),
        ({"plate.thickness_um": 6000.0}, ["plate.thickness_um", "wrong unit", "thickness_mm", "0.1 to 50 mm"]),
        ({"plate.thickness_mm": "6 mm"}, ["plate.thickness_mm", "'6 mm'", "0.1 to 50 mm"]),
        ({"plate.thickness_mm": -1.0}, ["plate.thickness_mm", "-1.0", "0.1 to 50 mm"]),
        ({"plate.thickness_mm": math.nan}, ["plate.thickness_mm", "nan", "0.1 to 50 mm"]),
        ({"plate.thickness_mm": True}, ["plate.thickness_mm", "True"]),
        ({"plate.refractive_index": 0.9}, ["plate.refractive_index", "0.9", "1 to 2.5"]),
        ({"camera.resolution_px": [20000, 20000]}, ["camera.resolution_px", "400000000", "100000000"]),
        ({"camera.resolution_px": [10**9, 1]}, ["camera.resolution_px", "1000000000", "8 to 20000 px"]),
        ({"camera.tone_curve": "gamma"}, ["camera.tone_curve", "'gamma'", "bt709"]),
        ({"contact": {"law": "jkr"}}, ["work_of_adhesion_N_per_mm", "missing"]),
        ({"contact": {"law": "herz"}}, ["contact", "herz", "hertz"]),
        ({"leds.edge": {"left": {"voltage_V": 99.0}}}, ["leds.edge.left.voltage_V", "99.0", "0 to 60 V"]),
        ({"leds.emitting_height_mm": 7.0}, ["leds.emitting_height_mm", "7", "plate.thickness_mm = 6"]),
        ({"press": {}}, ["press", "exactly one of forces_N and ramp"]),
        ({"press": {"ramp": {"stop_N": 5.0}}}, ["press.ramp", "rate_N_per_s"]),
        ({"contact.law": "hertzz"}, ["contact.law", "'hertzz'", "hertz", "fem"]),
        ({"contact": {}}, ["contact.law", "missing", "halfspace"]),
        ({"press": {"forces_N": []}}, ["press.forces_N", "[]", "at least 1"]),
        ({"camera.resolution_px": [2000.5, 1500]}, ["camera.resolution_px", "2000.5", "whole"]),
        ({"schema_version": 99}, ["schema_version", "99", "at most 1"]),
        ({"finger.position_mm": [500.0, 0.0]}, ["finger.position_mm", "500", "+-60 mm"]),
        ({"leds.edges": ["left", "left"]}, ["leds.edges", "left", "once"]),
        ({"camera.lens.distortion": {"k1": -2.0}}, ["camera.lens.distortion", "folds over"]),
        ({"sources": {"plate.colour": "nowhere"}}, ["sources.'plate.colour'", "names no key"]),
    ],
)
def test_bad_scene_is_one_line_naming_file_key_value_and_range(override: dict, words: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        load_scene("thesis", override)
    line = str(caught.value)
    assert "\n" not in line
    assert "thesis.toml" in line
    for word in words:
        assert word in line


def test_huge_frame_is_refused_before_anything_is_allocated() -> None:
    tracemalloc.start()
    with pytest.raises(InputError):
        load_scene("thesis", {"camera.resolution_px": [20000, 20000]})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e6  # a single byte a pixel would be 400 MB


def test_missing_and_broken_files_are_input_errors(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no such scene.*thesis"):
        load_scene("no_such_scene")
    broken = tmp_path / "broken.toml"
    broken.write_bytes(b"plate = {")
    with pytest.raises(InputError, match=r"broken\.toml.*not valid TOML"):
        load_scene(broken)
    broken.write_text("a=" + "[" * 5000 + "]" * 5000)
    with pytest.raises(InputError, match=r"broken\.toml.*not valid TOML"):
        load_scene(broken)
    broken.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"broken\.toml"):
        load_scene(broken)


@given(st.floats(allow_nan=True, allow_infinity=True), st.sampled_from(["thickness_mm", "refractive_index"]))
def test_a_figure_is_taken_if_and_only_if_it_is_within_its_bounds(value: float, key: str) -> None:
    bounds = dict(Plate.quantities())[key].bounds
    data = {"size_mm": [50.0, 40.0], key: value}
    if bounds[0] <= value <= bounds[1]:
        assert getattr(validate(Plate, data, "x.toml"), key) == value
    else:
        with pytest.raises(InputError, match=key):
            validate(Plate, data, "x.toml")


def test_every_quantity_lies_within_its_own_bounds_at_default_and_null() -> None:
    for model in (Plate, Camera):
        for name, quantity in model.quantities():
            default = model.model_fields[name].default
            values = [quantity.null, *(default if isinstance(default, tuple) else [default])]
            for value in values:
                if isinstance(value, int | float):
                    assert quantity.bounds[0] <= value <= quantity.bounds[1], name


@pytest.mark.parametrize("name", ["thesis", "thesis_ridged", "thesis_ridged_red", "thesis_slide"])
def test_scenes_come_back_from_json(name: str) -> None:
    """Data sets and results keep their scene as JSON, where a tuple is a list."""
    scene = load_scene(name)
    assert Scene.model_validate_json(json.dumps(scene.as_dict())) == scene


def test_another_law_alone_leaves_the_keys_of_the_old_one_behind() -> None:
    """Rationale: a shipped scene of the law ``fem`` refused another law by a key that nobody had asked for."""
    other = load_scene("soft_slide", {"contact.law": "hertz"})
    assert other.contact.law == "hertz"
    assert "contact.bone" in load_scene("soft_slide").assumptions
    assert "contact.bone" not in other.assumptions
    assert load_scene("soft_slide", {"contact.law": "fem"}) == load_scene("soft_slide")
    with pytest.raises(InputError, match=r"contact\.bone: unknown key"):
        load_scene("soft_slide", {"contact.law": "hertz", "contact.bone": "half"})
