"""The command line as scripts use it: exit codes, one-line errors, JSON written whole or not at all."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import cv2
import numpy as np
import pytest
import typer
from rich.text import Text
from typer.testing import CliRunner

from evanesce.bundle.layout import Shot
from evanesce.bundle.protocol import Protocol
from evanesce.cli.app import COMMANDS, app
from evanesce.cli.common import write_json
from evanesce.cli.render import parse_overrides
from evanesce.core.errors import InputError, WorkError

SMALL = [
    "--set", "camera.resolution_px=[400, 300]", "--set", "camera.scale_px_per_mm=11.674",
    "--set", "camera.pixel.pitch_um=15.5", "--set", "grid.samples=512", "--set", "camera.exposure_ms=0.24",
]  # fmt: skip
runner = CliRunner()


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str) -> None:
    done = runner.invoke(app, [command.replace("_", "-"), "--help"])
    assert done.exit_code == 0
    assert "Usage" in done.output


def test_no_help_text_loses_a_unit_as_markup() -> None:
    def commands(one: click.Command) -> Iterator[click.Command]:
        yield one
        for inner in getattr(one, "commands", {}).values():
            yield from commands(inner)

    texts = [
        (c.name, p.help) for c in commands(typer.main.get_command(app)) for p in c.params if getattr(p, "help", "")
    ]
    assert any("\\[mm]" in text for _, text in texts)
    for name, text in texts:
        assert Text.from_markup(text).plain == text.replace("\\[", "["), (name, text)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["render", "no_scene"], ["no_scene", "thesis"]),
        (["render", "thesis", "--set", "plate.thickness_mm=-3"], ["plate.thickness_mm", "-3", "0.1 to 50 mm"]),
        (["render", "thesis", "--set", "plate.thickness_mm"], ["--set", "key=value"]),
        (["render", "thesis", "--set", "leds.voltage_V=nine"], ["leds.voltage_V", "nine", "0 to 60 V"]),
        (["render", "thesis", "--force", "-1"], ["press.forces_N", "-1", "0 to 1000 N"]),
        (["render", "thesis", "--set", "effects.vigneting.k=0.1"], ["thesis.toml", "effects.vigneting", "vignetting"]),
        (["render", "thesis", "--set", "x=" + "[" * 5000 + "]" * 5000], ["--set x", "TOML"]),
        (["render", "thesis_slide", "--set", "grid.size_mm=4"], ["thesis_slide: grid.size_mm", "at least"]),
        (["render", "thesis", "--video", "gif"], ["--video", "gif", "h264"]),
        (["render", "thesis", "--variant", "metal", "--fast"], ["--variant"]),
        (["render", "thesis", "--fast", "--spp", "16"], ["--spp", "--reference"]),
        (["render", "thesis", "--fast", "--until-error", "0.05"], ["--until-error", "--reference"]),
        (["render", "thesis", "--json", "no/such/folder/x.json"], ["--json", "no/such/folder"]),
        (["compare", "no_folder", "--mm2-per-px", "1e-4"], ["no_folder", "evanesce render"]),
        (["compare", "no_folder"], ["no_folder", "evanesce render"]),
        (["criticise-photo", "no_photo.png"], ["no_photo.png", "no such file"]),
        (["criticise-photo", "no_photo.png", "--curve", "log"], ["--curve", "log", "libcamera"]),
        (["compare", "no_folder", "--mm2-per-px", "nan"], ["--mm2-per-px", "nan"]),
        (["compare", "no_folder", "--mm2-per-px", "1e-4", "--threshold", "2"], ["threshold", "2"]),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    words: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
) -> None:
    monkeypatch.chdir(tmp_path)
    done = runner.invoke(app, arguments)
    assert done.exit_code == 2, done.output
    text = done.output + (done.stderr if done.stderr not in done.output else "")
    assert "Traceback" not in text
    lines = [line for line in text.splitlines() if line.startswith("error: ")]
    assert len(lines) == 1
    for word in words:
        assert word in lines[0]
    assert list(tmp_path.iterdir()) == []


def test_no_traceback_from_the_real_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "evanesce.cli", "render", "thesis", "--set", "plate.refractive_index=0.5"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("error: ")


@pytest.mark.system
def test_render_and_compare_agree_with_the_truth(tmp_path: Path) -> None:
    folder, result = tmp_path / "r", tmp_path / "r.json"
    done = runner.invoke(
        app, ["render", "thesis", "--fast", "--force", "4", *SMALL, "--out", str(folder), "--json", str(result)]
    )
    assert done.exit_code == 0, done.output
    frames = json.loads(result.read_text())["frames"]
    assert len(frames) == 1
    names = {p.name for p in folder.iterdir()}
    assert {"frame_000000.png", "raw", "light_000000.exr", "times.csv", "scene.toml", "result.json"} <= names
    assert not [name for name in names if name.startswith(".")]

    compared = tmp_path / "c.json"
    scale = 11.674**-2
    options = ["--mm2-per-px", repr(scale), "--threshold", "0.35", "--min-blob", "100", "--json", str(compared)]
    done = runner.invoke(app, ["compare", str(folder), *options])
    assert done.exit_code == 0, done.output
    row = json.loads(compared.read_text())["frames"][0]
    # Hertz: pi (3 F R / 4 E*)^(2/3), E* = 0.7686 + 0.0004 F (thesis, section 5.5.1)
    hertz = np.pi * (3 * 4 * 7.5 / (4 * (0.7686 + 0.0004 * 4))) ** (2 / 3)
    assert row["true_area_mm2"] == pytest.approx(hertz, rel=1e-6)
    # A pixel is 86 um: a blurred edge at a low threshold lies within one pixel of the truth.
    assert abs(row["error_mm2"]) < 2 * np.sqrt(np.pi * hertz) / 11.674
    assert sum(row["split_percent"].values()) == pytest.approx(row["error_percent"], abs=1e-6)


@pytest.mark.system
@pytest.mark.parametrize(
    "options",
    [["--reference", "--spp", "32"], ["--fast", "--set", "finger.scattering_length_mm=1.0"]],
    ids=["path tracer", "subsurface"],
)
def test_compare_names_saturation_and_light_beside_the_contact(tmp_path: Path, options: list[str]) -> None:
    """At 12 V: what is counted beside the contact, found here from mask and truth alone, is named and explains it."""
    folder, compared = tmp_path / "r", tmp_path / "c.json"
    bright = ["--set", "leds.voltage_V=12.0", "--force", "5", "--out", str(folder)]
    done = runner.invoke(app, ["render", "thesis", *SMALL, *options, *bright])
    assert done.exit_code == 0, done.output
    frame = cv2.imread(str(folder / "frame_000000.png"), cv2.IMREAD_UNCHANGED)
    share = float((frame == 255).mean())
    assert share > 0.01
    assert f"at full scale (255) in 1 of 1 frame(s), {100 * share:.1f} % in frame 0" in done.stderr
    done = runner.invoke(
        app, ["compare", str(folder), "--mm2-per-px", repr(11.674**-2), "--min-blob", "100", "--json", str(compared)]
    )
    assert done.exit_code == 0, done.output
    row = json.loads(compared.read_text())["frames"][0]
    assert row["error_percent"] > 15
    assert row["split_percent"]["residual"] > 0.3 * row["error_percent"]
    # the disc of the true area in the middle of the frame, 4 px wider; what is bright beyond
    y, x = np.mgrid[:300, :400]
    beyond = np.hypot(x - 199.5, y - 149.5) > np.sqrt(row["true_area_mm2"] / np.pi) * 11.674 + 4
    bright_beyond = 100 * (cv2.GaussianBlur(frame, (0, 0), 1.0)[beyond] > 0.15 * 255).sum() / 11.674**2
    assert row["flank_percent"] == pytest.approx(bright_beyond / row["true_area_mm2"], rel=0.15)
    assert f"frame 0: {row['error_percent']:+.1f} %" in done.stderr
    assert "light beside the contact" in done.stderr
    assert "at full scale (saturation)" in done.stderr


@pytest.mark.system
def test_render_and_simulate_tell_what_a_slide_and_a_liquid_leave_out(tmp_path: Path) -> None:
    slide = {"distance_mm": 0.4, "speed_mm_per_s": 4.0, "press_time_s": 0.2}
    changes = [f"slide.{key}={value}" for key, value in slide.items()] + [
        "contact={law='hertz'}", "assumptions={}", "sources={}", "press.frame_rate_hz=5.0", "grid.size_mm=14.0",
        "liquid={volume_uL=900.0}",
    ]  # fmt: skip
    asked = [*SMALL, *(piece for change in changes for piece in ("--set", change))]
    done = runner.invoke(app, ["render", "thesis_slide", "--fast", *asked, "--out", str(tmp_path / "r")])
    assert done.exit_code == 0, done.output
    warnings = json.loads((tmp_path / "r" / "result.json").read_text())["warnings"]
    for start, warning in zip(("area stays under shear", "liquid: "), warnings, strict=True):
        assert warning.startswith(start)
        assert f"warning: {warning}" in done.stderr
    done = runner.invoke(app, ["simulate", "thesis_slide", "--fast", *asked, "--bundle", str(tmp_path / "b")])
    assert done.exit_code == 0, done.output
    assert "area stays under shear" in done.stderr


def test_simulate_warns_of_saturation_and_of_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shots = tuple(Shot(index=k, time_s=k, force_N=4.0, voltage_V=v) for k, v in enumerate((9.0, 12.0)))
    for name, kept in (("bright", shots), ("dim", shots[:1])):
        protocol = Protocol(press=kept, replicates=0, led_off=1, lens_cap=1, checkerboard=0, square=0)
        monkeypatch.setattr("evanesce.bundle.write.default_protocol", lambda scene, protocol=protocol: protocol)
        done = runner.invoke(app, ["simulate", "thesis", *SMALL, "--bundle", str(tmp_path / name)])
        assert done.exit_code == 0, done.output
        share = float((cv2.imread(str(tmp_path / name / "press" / f"{len(kept) - 1:04d}.png"), -1) == 255).mean())
        said = f"in 1 of {len(kept)} frame(s), {100 * share:.1f} % in frame {len(kept) - 1}" in done.stderr
        assert said == (name == "bright")
        assert ("saturation" in done.stderr) == (share > 0.001) == (name == "bright")


def test_compare_without_light_says_so(tmp_path: Path) -> None:
    folder = tmp_path / "r"
    done = runner.invoke(app, ["render", "thesis", "--fast", "--no-exr", "--force", "1", *SMALL, "--out", str(folder)])
    assert done.exit_code == 0, done.output
    done = runner.invoke(app, ["compare", str(folder), "--mm2-per-px", "0.0073", "--min-blob", "100"])
    assert done.exit_code == 0, done.output
    assert "no linear light" in done.output


def test_compare_refuses_a_tampered_result(tmp_path: Path) -> None:
    folder = tmp_path / "r"
    folder.mkdir()
    for text, word in (("[", "JSON"), ("{}", "provenance"), ('{"provenance": {"seed": true}, "frames": []}', "whole")):
        (folder / "result.json").write_text(text)
        done = runner.invoke(app, ["compare", str(folder), "--mm2-per-px", "0.0073"])
        assert done.exit_code == 2
        assert word in done.output


def test_overrides_are_toml_values() -> None:
    found = parse_overrides(["a.b=1.5", "c = [1, 2]", 'd="x"', "e=true", "f=linear"])
    assert found == {"a.b": 1.5, "c": [1, 2], "d": "x", "e": True, "f": "linear"}
    with pytest.raises(InputError, match="TOML"):
        parse_overrides(["a=__import__('os')"])


def test_json_has_no_nan_and_is_not_left_half_written(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", {"x": float("nan"), "y": np.float32(2.5), "z": np.arange(2), "p": tmp_path})
    assert json.loads((tmp_path / "a.json").read_text()) == {"x": None, "y": 2.5, "z": [0, 1], "p": str(tmp_path)}
    with pytest.raises(WorkError):
        write_json(tmp_path / "no" / "a.json", {})
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_a_slower_variant_is_announced(tmp_path: Path) -> None:
    """Without LLVM the work is done all the same, and standard error says that it is slower and what to install."""
    environment = os.environ | {"DRJIT_LIBLLVM_PATH": str(tmp_path / "none.so"), "EVANESCE_CACHE": str(tmp_path / "c")}
    small = [part.replace("400, 300", "80, 60").replace("11.674", "2.335") for part in SMALL]
    done = subprocess.run(
        [sys.executable, "-m", "evanesce.cli", "render", "thesis", "--force", "1", "--spp", "2", "--passes", "2",
         *small, "--out", str(tmp_path / "r"), "--json", str(tmp_path / "r.json")],
        capture_output=True, text=True, env=environment, cwd=tmp_path, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "r.json").read_text())["provenance"]
    assert record["renderer"] == "path"
    if "scalar" in json.dumps(record):  # a machine may have another libLLVM where Dr.Jit looks by itself
        assert "note: " in done.stderr
        assert "libllvm" in done.stderr.lower()
