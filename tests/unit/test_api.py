"""The public names: where they live, what importing them costs, what their docstrings say, and scenes that change."""

from __future__ import annotations

import ast
import inspect
import re
import subprocess
import sys
import types
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import evanesce as ev
from evanesce.core.deprecation import Moved, moved_names
from support.rigs import small_rig

PUBLIC = [name for name in ev.__all__ if name != "__version__"]


# --- names -----------------------------------------------------------------------------------------------------------


def test_importing_the_package_brings_no_library() -> None:
    code = "import sys, evanesce; print(*sorted({m.split('.')[0] for m in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "scipy", "cv2", "pydantic", "mitsuba", "drjit", "matplotlib"} & set(loaded)


def test_measuring_and_the_fast_renderer_need_no_mitsuba() -> None:
    code = "import sys, evanesce as ev; [getattr(ev, n) for n in ev.__all__]; print('mitsuba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


@pytest.mark.parametrize("name", PUBLIC)
def test_every_public_name_is_found_and_described(name: str) -> None:
    found = getattr(ev, name)
    assert found is getattr(ev, name)  # the second time without the import
    summary = inspect.getdoc(found).splitlines()[0]
    assert summary.endswith(".")
    assert name in dir(ev)


def _parameters(function: Any) -> list[str]:
    kinds = inspect.Parameter
    return [
        name
        for name, parameter in inspect.signature(function).parameters.items()
        if name != "self" and parameter.kind not in (kinds.VAR_KEYWORD, kinds.VAR_POSITIONAL)
    ]


def _callables() -> dict[str, Any]:
    """Return the public functions, and constructors and public methods of the API's own classes."""
    found: dict[str, Any] = {}
    for name in PUBLIC:
        value = getattr(ev, name)
        if not value.__module__.startswith("evanesce.api"):
            continue
        if isinstance(value, types.FunctionType):
            found[name] = value
            continue
        for method, function in vars(value).items():
            if isinstance(function, types.FunctionType) and not method.startswith("_"):
                found[f"{name}.{method}"] = function
    return found


@pytest.mark.parametrize(("name", "function"), _callables().items(), ids=list(_callables()))
def test_every_parameter_and_result_of_the_api_is_documented(name: str, function: Any) -> None:
    text = inspect.getdoc(function)
    for parameter in _parameters(function):
        assert re.search(rf"^(\w+, )*{parameter}(, \w+)*( :|$)", text, re.MULTILINE), f"{name}: {parameter}"
    returns = inspect.signature(function).return_annotation
    if returns not in ("None", None) and len(text.splitlines()) > 1:
        assert re.search(r"^(Returns|Yields)$", text, re.MULTILINE), name


def test_every_property_of_a_shot_a_truth_and_a_measurement_says_what_it_is() -> None:
    for owner in (ev.Shot, ev.Truth, ev.Measurement, ev.Camera, ev.Pipeline):
        for name, value in vars(owner).items():
            if isinstance(value, property) and not name.startswith("_"):
                assert inspect.getdoc(value), f"{owner.__name__}.{name}"


def test_no_public_name_hides_a_package_or_is_hidden_by_one() -> None:
    folder = Path(ev.__file__).parent
    packages = {path.stem for path in folder.iterdir() if path.is_dir() or path.suffix == ".py"}
    assert not packages & set(PUBLIC)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'no_such_name'"):
        ev.no_such_name  # noqa: B018


# --- names that have moved --------------------------------------------------------------------------------------------


def test_a_module_that_moved_is_found_under_its_old_name_with_a_warning_at_the_callers_line() -> None:
    from evanesce.core import errors

    with pytest.warns(DeprecationWarning, match=r"evanesce\.errors is now evanesce\.core\.errors; .* 0\.4") as caught:
        assert ev.errors is errors
    assert caught[0].filename == __file__


def test_no_old_name_outlives_the_version_that_was_promised_to_drop_it() -> None:
    now = tuple(int(n) for n in ev.__version__.split(".")[:2])
    for name, moved in ev._MOVED.items():
        assert tuple(int(n) for n in moved.removal.split(".")) > now, f"{name} goes with {moved.removal}"
        assert moved.load() is not None


def test_a_renamed_function_is_found_by_its_old_name() -> None:
    old = moved_names("somewhere", {"old_name": Moved("evanesce.core.rng:generator", removal="9.0")})
    with pytest.warns(DeprecationWarning, match=r"somewhere\.old_name is now evanesce\.core\.rng\.generator"):
        assert old("old_name").__name__ == "generator"
    with warnings.catch_warnings(), pytest.raises(AttributeError, match="'somewhere' has no attribute 'other'"):
        old("other")


# --- scenes -----------------------------------------------------------------------------------------------------------


def test_a_scene_with_nothing_changed_is_the_scene() -> None:
    scene = ev.load("thesis_ridged")
    assert scene.with_() == scene
    assert ev.Scene.from_dict(scene.as_dict()) == scene


def test_a_key_is_changed_by_underscores_by_dots_and_by_a_mapping_alike() -> None:
    scene = ev.load("thesis_ridged")
    ways = [
        scene.with_(finger__ridges__height_um=150),
        scene.with_({"finger.ridges.height_um": 150.0}),
        scene.with_(**{"finger.ridges.height_um": np.float64(150)}),
        scene.with_(finger__ridges={**scene.finger.ridges.model_dump(), "height_um": 150.0}),
        scene.with_(finger__ridges=scene.finger.ridges.model_copy(update={"height_um": 150.0})),
    ]
    assert all(way.finger.ridges == ways[0].finger.ridges for way in ways)
    assert ways[0].finger.ridges.height_um == 150.0
    assert scene.finger.ridges.height_um == 47.67


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_a_value_is_taken_if_and_only_if_it_is_within_its_bounds(value: float) -> None:
    scene = small_rig()
    if 0.0 <= value <= 60.0:
        assert scene.with_(leds__voltage_V=value).leds.voltage_V == value
    else:
        with pytest.raises(ev.InputError, match=r"leds\.voltage_V: .* out of range"):
            scene.with_(leds__voltage_V=value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"leds__voltage": 9.5}, r"leds\.voltage: wrong unit: write voltage_V"),
        ({"led__voltage_V": 9.5}, r"led: unknown key; nearest key: leds"),
        ({"leds__voltage_V": "9.5 V"}, r"leds\.voltage_V: '9\.5 V' is not a number"),
        ({"leds__voltage_V__max": 1.0}, r"leds\.voltage_V\.max: voltage_V is not a table"),
        ({"plate": None}, r"plate: missing"),
        ({"finger__ridges__height_um": 60.0}, r"finger\.ridges\.pitch_um: missing"),
        ({"leds__edges": ("left", "up")}, r"leds\.edges\.1: 'up' is not known"),
    ],
)
def test_a_wrong_change_names_the_key_and_what_is_allowed(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ev.InputError, match=rf"Scene\.with_: {message}"):
        small_rig().with_(changes)


def test_a_table_is_replaced_whole_and_an_optional_one_can_be_taken_away() -> None:
    scene = ev.load("thesis_ridged")
    assert scene.with_(finger__ridges=None).finger.is_smooth
    adhesive = scene.with_(finger__ridges=None, contact={"law": "jkr", "work_of_adhesion_N_per_mm": 5e-5})
    assert adhesive.contact.law == "jkr"
    assert scene.with_(leds__edge__top={"voltage_V": 8.0}).leds.edge["top"].voltage_V == 8.0


def test_a_sentence_about_a_changed_value_is_left_out_and_all_others_stay() -> None:
    scene = ev.load("thesis_ridged")
    other = scene.with_(leds__voltage_V=9.5, finger__ridges=None)
    gone = set(scene.sources) - set(other.sources), set(scene.assumptions) - set(other.assumptions)
    assert gone == (
        {"leds.voltage_V", "finger.ridges.height_um", "finger.ridges.width_um"},
        {"finger.ridges.pitch_um", "finger.ridges.orientation_deg"},
    )
    kept = scene.with_(leds__voltage_V=9.5, sources={"leds.voltage_V": "read from the supply"})
    assert kept.sources == {"leds.voltage_V": "read from the supply"}


def test_a_height_map_is_found_from_the_working_folder_and_carries_its_digest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.savetxt(tmp_path / "scan.csv", np.zeros((8, 8)), delimiter=",")
    skin = {"file": "scan.csv", "pitch_um": 10.0}
    scene = small_rig()
    with pytest.raises(ev.InputError, match=r"no such file 'scan\.csv'"):
        scene.with_(finger__height_map=skin)
    monkeypatch.chdir(tmp_path)
    there = scene.with_(finger__height_map=skin)
    assert there.finger.height_map.file == str(tmp_path / "scan.csv")
    assert len(there.finger.height_map.sha256) == 64
    assert there.with_(leds__voltage_V=8.0).finger.height_map == there.finger.height_map
    ev.save_scene(there, tmp_path / "rig.toml")
    assert ev.load(tmp_path / "rig.toml").finger.height_map.sha256 == there.finger.height_map.sha256


def test_a_scene_goes_to_no_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ev.InputError, match="its folder does not exist"):
        ev.save_scene(small_rig(), tmp_path / "none" / "rig.toml")


# --- options ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"renderer": "slow"}, r"renderer: 'slow'"),
        ({"renderer": "fast", "samples": 8}, r"samples: the fast renderer draws no paths"),
        ({"renderer": "fast", "passes": 2}, r"passes: the fast renderer draws no paths"),
        ({"bands": 0}, r"bands: 0 \(allowed: 1 to"),
        ({"renderer": "reference", "until_error": 1.5}, r"until_error: 1\.5"),
    ],
)
def test_a_wrong_option_of_the_camera_is_refused_before_a_frame(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ev.InputError, match=message):
        ev.Camera(small_rig(), **options)


def test_an_unknown_effect_is_refused_before_a_frame() -> None:
    with pytest.raises(ev.InputError, match="unknown effect; nearest: vignetting"):
        ev.Camera(small_rig().with_(effects__vignettin={"strength": 1.0}))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, r"scale_mm2_per_px: no area per pixel was given and there is no calibration"),
        ({"scale_mm2_per_px": -1.0}, r"scale_mm2_per_px: -1\.0"),
        ({"scale_mm2_per_px": float("nan")}, r"scale_mm2_per_px: nan"),
        ({"scale_mm2_per_px": 1.0, "threshold": 1.5}, r"threshold: 1\.5"),
        ({"scale_mm2_per_px": 1.0, "estimator": "best"}, r"estimator: 'best'"),
        ({"scale_mm2_per_px": 1.0, "finger": "wet"}, r"finger: 'wet'"),
        ({"scale_mm2_per_px": 1.0, "dark": [np.zeros((4, 4), np.uint8)]}, r"dark: the reference segmentation"),
        ({"estimator": "refined"}, r"calibration: is needed by the refined estimator"),
        ({"scale_mm2_per_px": 1.0, "crop": np.s_[::2, :]}, r"crop: .*slices without step"),
        ({"scale_mm2_per_px": 1.0, "crop": "1:2"}, r"is no crop"),
    ],
)
def test_a_wrong_option_of_a_pipeline_is_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ev.InputError, match=message):
        ev.Pipeline(**options)


@pytest.mark.parametrize("image", [np.zeros((4, 5)), np.zeros(7, np.uint8), np.zeros((4, 5, 4), np.uint8)])
def test_what_is_no_8_bit_image_is_refused_with_its_shape(image: np.ndarray) -> None:
    with pytest.raises(ev.InputError, match=re.escape(f"shape {image.shape}")):
        ev.measure(image, scale_mm2_per_px=1.0)


def test_a_crop_by_slices_is_the_crop_by_text() -> None:
    image = np.zeros((40, 50), np.uint8)
    image[12:30, 20:45] = 255
    by_slices, by_text = (
        ev.measure(image, scale_mm2_per_px=0.5, min_blob_px=10, blur_px=0.0, dilation_px=0, crop=crop)
        for crop in (np.s_[10:28, 15:], "10:28,15:")
    )
    assert by_slices.pixels == by_text.pixels == 16 * 25
    assert by_slices.area_mm2 == 200.0
    assert by_slices.mask.shape == (18, 35)
    assert [w.code for w in by_slices.warnings] == ["saturation", "mask_touches_border"]


@pytest.mark.parametrize("trials", [0, -1, 1.5, True])
def test_a_dataset_has_whole_trials(trials: Any) -> None:
    with pytest.raises(ev.InputError, match="trials"):
        ev.make_dataset(small_rig(), trials=trials)


def test_a_key_of_a_dataset_that_is_not_known_names_the_nearest() -> None:
    with pytest.raises(ev.InputError, match=r"make_dataset: trial\.frame: unknown key; nearest key: frames"):
        ev.make_dataset(small_rig(), trials=1, trial__frame=8)


# --- examples ---------------------------------------------------------------------------------------------------------

EXAMPLES = sorted((Path(__file__).resolve().parents[2] / "examples").glob("plot_*.py"))


@pytest.mark.parametrize("script", EXAMPLES, ids=[script.stem for script in EXAMPLES])
def test_an_example_has_a_title_a_figure_and_only_public_names(script: Path) -> None:
    """They are run, and their figures drawn, when the documentation is built."""
    text = script.read_text()
    tree = ast.parse(text)
    title, underline = (ast.get_docstring(tree) or "").splitlines()[:2]
    assert underline == "=" * len(title)
    assert text.endswith("plt.show()\n")
    used = {
        node.attr
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "ev"
    }
    assert used
    assert used <= set(PUBLIC)


def test_there_are_ten_examples() -> None:
    assert len(EXAMPLES) == 10
