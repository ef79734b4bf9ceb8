"""LED types in a scene: figures of the circuit that are not given, spectrum files beside the scene, refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.api.scenes import save_scene
from evanesce.cli.app import app
from evanesce.core.errors import InputError
from evanesce.optics.led_circuit import segment_current
from evanesce.optics.spectrum import spectrum_of
from evanesce.rig import LedCircuit, Leds, Scene, load_scene
from evanesce.rig.leds import CIRCUITS, circuit_defaults
from evanesce.rig.load import dump_scene

STRIP = {"pitch_mm": 11.0, "emitting_width_mm": 4.0, "emitting_height_mm": 2.5}
SPECTRUM = "wavelength_nm,power\n600,0\n630,2.5\n# between\n650,0.5\n660,0\n"


def scene_file(folder: Path, **leds: object) -> Path:
    """Write the thesis's scene, its LED voltage bin left to the type, with further keys of [leds]."""
    scene = load_scene("thesis").with_(leds__circuit__forward_voltage_V=3.1)
    text = dump_scene(scene).replace('spectrum = "white"\n', "")
    head, rest = text.split("[leds]\n")
    before, circuit = rest.split("[leds.circuit]\n")
    circuit = circuit[circuit.index("\n[") :]  # none of its keys
    lines = "".join(f"{key} = {value!r}\n".replace("'", '"') for key, value in leds.items())
    path = folder / "scene.toml"
    path.write_text(head + "[leds]\n" + lines + before + circuit)
    return path


def test_white_leds_are_those_of_a_scene_without_the_key(tmp_path: Path) -> None:
    plain, named = load_scene(scene_file(tmp_path)), load_scene(scene_file(tmp_path, spectrum="white"))
    assert plain == named
    assert plain.leds.circuit == LedCircuit()
    assert plain.leds.circuit.model_dump() == circuit_defaults("white")


@pytest.mark.parametrize("kind", ["red", "infrared"])
def test_keys_that_are_not_given_take_the_types_figures_and_given_ones_win(kind: str) -> None:
    leds = Leds.model_validate({**STRIP, "spectrum": kind, "circuit": {"rated_current_mA": 13.0}})
    for name, value in leds.circuit.model_dump().items():
        expected = (
            13.0 if name == "rated_current_mA" else CIRCUITS[kind].get(name, LedCircuit.model_fields[name].default)
        )
        assert value == expected, name
    given = Leds(**STRIP, spectrum=kind, circuit=LedCircuit(forward_voltage_V=1.9))  # type: ignore[arg-type]
    assert given.circuit.forward_voltage_V == 1.9
    assert given.circuit.leds_per_segment == CIRCUITS[kind]["leds_per_segment"]
    # every type's figures are within bounds and can be driven: the rated current flows at the rated voltage
    circuit = LedCircuit(**circuit_defaults(kind))
    assert segment_current(circuit, circuit.rated_voltage_V) == pytest.approx(1e-3 * circuit.rated_current_mA, rel=1e-9)


def test_a_changed_type_brings_its_own_figures_but_keeps_what_the_scene_gave() -> None:
    scene = load_scene("thesis").with_(leds__circuit__rated_current_mA=13.0, leds__circuit__forward_voltage_V=3.1)
    red = scene.with_(leds__spectrum="red")
    assert red.leds.circuit.model_dump() == circuit_defaults("red") | {"rated_current_mA": 13.0}
    assert red.with_(leds__spectrum="white") == scene
    assert red.with_(leds__voltage_V=8.5).leds.circuit == red.leds.circuit
    assert red.with_(leds__spectrum="infrared", leds__circuit__ideality=1.4).leds.circuit.ideality == 1.4
    # what the scene said of a figure that has changed no longer holds
    said = scene.with_(assumptions={"leds.circuit.forward_voltage_V": "a usual bin"})
    assert "leds.circuit.forward_voltage_V" in said.assumptions
    assert not said.with_(leds__spectrum="red").assumptions


def test_round_trips_are_exact(tmp_path: Path) -> None:
    (tmp_path / "led.csv").write_text(SPECTRUM)
    for spectrum in ("red", "infrared", "led.csv"):
        scene = load_scene(scene_file(tmp_path, spectrum=spectrum))
        assert Scene.from_dict(scene.as_dict()) == scene
        assert Scene.model_validate_json(scene.model_dump_json()) == scene
        other = tmp_path / f"of {spectrum}"
        other.mkdir()
        save_scene(scene, other / "scene.toml")
        back = load_scene(other / "scene.toml")
        assert dump_scene(back) == dump_scene(scene)
        np.testing.assert_array_equal(spectrum_of(back.leds).power, spectrum_of(scene.leds).power)


def test_a_spectrum_file_is_read_beside_the_scene_and_watched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "led.csv").write_text(SPECTRUM)
    scene = load_scene(scene_file(tmp_path, spectrum="led.csv"))
    found = spectrum_of(scene.leds)
    np.testing.assert_array_equal(found.wavelength_nm, [600.0, 630.0, 650.0, 660.0])
    np.testing.assert_array_equal(found.power, [0.0, 2.5, 0.5, 0.0])
    assert scene.leds.circuit == LedCircuit()  # a file says nothing of the chip
    monkeypatch.chdir(tmp_path)
    assert load_scene("thesis").with_(leds__spectrum="led.csv").leds.spectrum == scene.leds.spectrum
    (tmp_path / "other.csv").write_text(SPECTRUM.replace("2.5", "2.4"))
    assert scene.with_(leds__spectrum="other.csv").leds.spectrum_sha256 != scene.leds.spectrum_sha256
    (tmp_path / "led.csv").write_text(SPECTRUM.replace("2.5", "2.6"))
    path = scene_file(tmp_path, spectrum="led.csv", spectrum_sha256=scene.leds.spectrum_sha256)
    with pytest.raises(InputError, match=r"leds.spectrum_sha256: .* not the file that the scene was made with"):
        load_scene(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "0 bytes"),
        ("600,1\n610,2\n", "wavelength_nm,power"),
        ("wavelength_nm,power,more\n600,1,1\n610,2,2\n", "headings"),
        ("wavelength_nm,power\n600,1\n", "no spectrum"),
        ("wavelength_nm,power\n600,0\n610,0\n", "no spectrum"),
        ("wavelength_nm,power\n600,1\n600,2\n", r"row 3: 600 \(allowed: rising"),
        ("wavelength_nm,power\n600,1\n610,-2\n", r"row 3: -2 \(allowed: at least 0"),
        ("wavelength_nm,power\n200,1\n610,2\n", r"row 2: 200 \(allowed: 300 to 1100 nm"),
        ("wavelength_nm,power\n600,1\n610,inf\n", "not finite"),
        ("wavelength_nm,power\n600,1\n610\n", "row 3 has 1 columns"),
        ("wavelength_nm,power\n600,red\n610,2\n", "not a number"),
        ("wavelength_nm,power\n" + "600,1\n" * 200_000, "bytes"),
    ],
)
def test_spectra_that_are_none_are_refused_by_name(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "led.csv").write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        load_scene(scene_file(tmp_path, spectrum="led.csv"))
    assert "\n" not in str(caught.value)


def test_what_is_no_spectrum_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"leds.spectrum: 'green' is not a spectrum \(allowed: white, red, infrared"):
        load_scene(scene_file(tmp_path, spectrum="green"))
    with pytest.raises(InputError, match="leaves the scene's folder"):
        load_scene(scene_file(tmp_path, spectrum="../led.csv"))
    with pytest.raises(InputError, match="no such file"):
        load_scene(scene_file(tmp_path, spectrum="led.csv"))
    path = scene_file(tmp_path, spectrum="green")
    ran = CliRunner().invoke(app, ["render", str(path), "--out", str(tmp_path / "out")])
    assert ran.exit_code == 2
    assert not (tmp_path / "out").exists()
