"""The critic on whole bundles of the challenge's injector: what was hidden is found, and nothing where nothing was.

A stratified slice of the development cases, all at one pose so that one light serves all. Each takes a minute or two.
"""

from __future__ import annotations

import json
import shutil
import textwrap
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import evanesce.effects
from challenge.cases import CaseSpec, cases
from challenge.make import write_case
from challenge.run import strip_pixels
from evanesce.bundle import read_bundle
from evanesce.cli.app import app
from evanesce.criticism.critic import criticise
from evanesce.prediction.observe import observe
from evanesce.rig import load_scene
from evanesce.sensor.codec import write_png

pytestmark = pytest.mark.whole_case


def spec(group: str, cause: str = "", strength: float = 0.0, noise: str = "", pose: int = 0) -> CaseSpec:
    """Return the first development case at a pose of that kind."""
    return next(
        c
        for c in sorted(cases("dev"), key=lambda c: c.id)
        if c.pose == pose
        and c.group == group
        and (not cause or cause in c.causes)
        and (not strength or strength in c.strengths)
        and (not noise or c.noise == noise)
    )


def judged(case: CaseSpec, folder: Path) -> dict:
    path, _ = write_case(case, folder)
    return criticise(read_bundle(path), exclude=case.exclude)[0]


def said(answer: dict) -> set[str]:
    return {e["id"] for e in answer["effects"]} | set(answer["ambiguous_with"])


@pytest.mark.parametrize("noise", ["plain", "h264"])
def test_nothing_is_found_where_nothing_is_hidden(noise: str, tmp_path: Path) -> None:
    answer = judged(spec("null", noise=noise), tmp_path)
    assert answer["verdict"] == "none", answer["probabilities"]
    assert answer["gain"]["log_score"][0] == 0.0


@pytest.mark.parametrize(
    ("cause", "strength"),
    [("modulus", 20.0), pytest.param("black_level", 40.0, marks=pytest.mark.slow), ("plate_tilt", 20.0)],
)
def test_a_loud_single_cause_is_in_the_answer(cause: str, strength: float, tmp_path: Path) -> None:
    answer = judged(spec("single", cause, strength), tmp_path)
    assert answer["verdict"] in ("named", "ambiguous")
    assert cause in said(answer)
    assert answer["global_p"] < 0.001


def test_two_causes_are_both_in_the_answer(tmp_path: Path) -> None:
    case = next(c for c in cases("dev") if c.causes == ("square_size", "creep") and c.pose == 0)
    answer = judged(case, tmp_path)
    assert said(answer) >= set(case.causes)


@pytest.mark.slow
def test_of_two_causes_that_partly_cancel_the_one_that_is_left_over_is_found(tmp_path: Path) -> None:
    """A distortion that takes 7.7 from cards of 20: what remains looks like fewer cards, and is named so."""
    case = next(
        c for c in cases("dev") if c.cancelling and c.causes == ("card_offset", "distortion_drift") and c.pose == 0
    )
    path, truth = write_case(case, tmp_path)
    assert truth["overlap"] < -0.5
    assert truth["strength_together"] < 0.7 * max(case.strengths)
    answer = criticise(read_bundle(path))[0]
    assert answer["effects"][0]["id"] == "card_offset"


def test_a_cause_taken_out_of_the_library_is_called_unknown(tmp_path: Path) -> None:
    case = next(c for c in cases("dev") if c.group == "removed" and c.pose == 0 and c.causes == ("rolling_shutter",))
    answer = judged(case, tmp_path)
    assert answer["verdict"] == "unknown"
    assert "rolling_shutter" not in answer["probabilities"]


@pytest.mark.slow
def test_a_decoy_is_told_from_its_cause_by_the_shot_that_separates_them(tmp_path: Path) -> None:
    case = next(
        c for c in cases("dev") if c.group == "decoy" and c.pose == 0 and c.causes == ("black_level",) and not c.drop
    )
    answer = judged(case, tmp_path)
    assert case.decoy == "ambient_light"
    assert said(answer) == {"black_level"}


def test_a_decoy_without_its_shot_is_answered_as_a_set_and_the_shot_is_advised(tmp_path: Path) -> None:
    case = next(
        c
        for c in cases("dev")
        if c.group == "decoy" and c.causes == ("black_level",) and c.drop and c.strengths == (10.0,)
    )
    answer = judged(case, tmp_path)
    assert said(answer) == {"black_level", "ambient_light"}
    assert answer["next_measurement"]["what"] == "lens_cap"
    assert set(answer["next_measurement"]["separates"]) == {"ambient_light"}


@pytest.mark.slow
def test_a_film_is_named_through_a_codec(tmp_path: Path) -> None:
    """JPEG leaves noise, by which the level of other bundles holds; place and size of the film come from the data."""
    answer = judged(spec("single", "residue_film", 10.0, "jpeg"), tmp_path)
    assert said(answer) == {"residue_film"}


@pytest.mark.parametrize("cause", ["row_banding", pytest.param("ghost_image", marks=pytest.mark.slow)])
def test_what_is_not_in_the_library_is_called_unknown(cause: str, tmp_path: Path) -> None:
    answer = judged(spec("unknown", cause), tmp_path)
    assert answer["verdict"] == "unknown"
    assert answer["unknown"]["where"]


@pytest.mark.slow
def test_specks_at_places_of_their_own_are_named_with_them(tmp_path: Path) -> None:
    """Of the 25 to 60 points those that a bin shows are listed, and the list is about as bright as it was read."""
    answer = judged(spec("single", "specks", 40.0, pose=2), tmp_path)
    assert answer["verdict"] == "named"
    assert [e["id"] for e in answer["effects"]] == ["specks"]
    assert 3 <= answer["effects"][0]["places"] <= 60
    assert answer["effects"][0]["parameters"]["marks"]["value"] == pytest.approx(1.0, abs=0.2)


def test_a_bundle_by_another_name_is_the_same_to_the_critic(tmp_path: Path) -> None:
    """All that the critic ever sees of a bundle, whatever the folder is called: nothing can be learnt from names."""
    path, _ = write_case(spec("single", "modulus", 20.0), tmp_path / "case")
    other = tmp_path / "vignetting" / "black_level-40"
    shutil.copytree(path, other)
    one, two = (observe(read_bundle(p)) for p in (path, other))
    assert one.views == two.views
    assert (one.believed, one.scene, one.available) == (two.believed, two.scene, two.available)
    np.testing.assert_array_equal(one.images, two.images)
    for mine, others in ((one.held, two.held), (one.scatter, two.scatter)):
        assert mine.keys() == others.keys()
        assert len(mine) >= 3
        for kind in mine:
            np.testing.assert_array_equal(mine[kind], others[kind])


@pytest.mark.slow
@pytest.mark.parametrize("how", ["shuffle", "flat"])
def test_stripped_pixels_tell_nothing_of_the_cause(tmp_path: Path, how: str) -> None:
    """The same bundle with its pixels in another order, or without any: unknown, as no contact shows."""
    case = spec("single", "modulus", 20.0)
    path, _ = write_case(case, tmp_path)
    strip_pixels(path, how)
    answer = criticise(read_bundle(path))[0]
    assert answer["verdict"] == "unknown"
    assert answer["probabilities"]["unknown"] > 0.99
    assert said(answer) == set()
    assert any("do not show the contact" in note for note in answer["notes"])


HAZE = '''
"""A stripe of haze across the lens: light falls by a share along a band."""
import numpy as np

from evanesce.effects.protocol import Effect, Stage
from evanesce.core.quantities import Strict, field
from evanesce.core.states import SensorLight


class Parameters(Strict):
    """Amount."""

    amount: float = field(0.0, unit="1", bounds=(-0.5, 0.5), null=0.0)


def apply(light, parameters, context):
    rows, cols = light.irradiance.shape
    v = (np.arange(rows)[:, None] + 0.5) / rows + 0.35 * (np.arange(cols)[None, :] + 0.5) / cols
    band = np.cos(2 * np.pi * v / 0.31)
    return SensorLight(irradiance=light.irradiance * (1.0 + parameters.amount * band))


EFFECT = Effect(id="test_only_haze", stage=Stage.SENSOR_LIGHT, parameters=Parameters, amplitudes=("amount",),
                apply=apply, fitted={"amount": 0.05})
'''


def test_an_effect_file_is_found_with_no_other_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A band over the frames of a bundle with nothing hidden, drawn on grey values: the new file's effect is named."""
    path, _ = write_case(spec("null", noise="plain"), tmp_path / "case")
    for file in sorted(f for f in path.rglob("*.png") if f.parent.name not in ("led_off", "lens_cap")):
        frame = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE).astype(float)
        rows, cols = frame.shape
        v, u = (np.mgrid[:rows, :cols] + 0.5) / np.array([rows, cols])[:, None, None]
        # BT.709 bends light by a power of about 0.45 where it is bright.
        frame *= (1 + 0.06 * np.cos(2 * np.pi * (v + 0.35 * u) / 0.31)) ** 0.45
        write_png(file, np.clip(np.rint(frame), 0, 255).astype(np.uint8))
    folder = tmp_path / "effects"
    folder.mkdir()
    (folder / "test_only_haze.py").write_text(textwrap.dedent(HAZE))
    monkeypatch.setattr(evanesce.effects, "__path__", [*evanesce.effects.__path__, str(folder)])
    evanesce.effects.all_effects.cache_clear()
    try:
        answer = criticise(read_bundle(path))[0]
    finally:
        evanesce.effects.all_effects.cache_clear()
    assert "test_only_haze" in {e["id"] for e in answer["effects"]}
    value = next(e for e in answer["effects"] if e["id"] == "test_only_haze")["parameters"]["amount"]["value"]
    assert value == pytest.approx(0.06, abs=0.015)


@pytest.mark.slow
def test_the_command_writes_answer_page_and_a_scene_that_loads(tmp_path: Path) -> None:
    path, _ = write_case(spec("single", "vignetting", 10.0), tmp_path / "case")
    out, report = tmp_path / "out.json", tmp_path / "out.html"
    done = CliRunner().invoke(app, ["criticise", str(path), "--json", str(out), "--report", str(report)])
    assert done.exit_code == 0, done.output
    answer = json.loads(out.read_text())
    assert {"global_p", "verdict", "probabilities", "effects", "ambiguous_with", "absorbed", "next_measurement",
            "unknown", "gain", "extended_scene", "false_alarm_control"} <= set(answer)  # fmt: skip
    assert "vignetting" in said(answer)
    extended = load_scene(answer["extended_scene"])
    assert extended.effects["vignetting"]["k"] > 0
    assert "vignetting" in report.read_text()
