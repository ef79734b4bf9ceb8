"""``evanesce bench``: files in, JSON and plots out, one line and exit code 2 for bad input, nothing half-written."""

from __future__ import annotations

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from evanesce.bench import dma, indentation
from evanesce.cli import bench
from evanesce.contact.sliding.stick_slip import Slider, simulate_stick_slip
from evanesce.materials import hyperelastic
from evanesce.materials.tables import material
from evanesce.rig import load_scene

pytestmark = pytest.mark.system


@pytest.fixture
def run():
    app = typer.Typer()
    app.callback()(lambda: None)
    bench.register(app)
    return lambda *words: CliRunner().invoke(app, ["bench", *map(str, words)])


def csv(path, headings, *columns):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=headings, comments="")
    return path


def done(result, folder, *files):
    assert result.exit_code == 0, result.output
    for name in ("result.json", *files):
        assert (folder / name).stat().st_size > 0
    assert not [p for p in folder.iterdir() if p.name.startswith(".")]
    return json.loads((folder / "result.json").read_text())


def test_indentation(run, tmp_path):
    g = indentation.elliptic_geometry(8.2, 25.45 / 2)
    f = np.linspace(0.05, 9.0, 120)
    noise = 0.002 * np.random.default_rng(1).normal(size=120)
    file = csv(tmp_path / "i.csv", "Load [N],Depth [um]", f, 1e3 * (0.2 + noise + g.depth(f, 0.31 + 0.02 * f)))
    out = tmp_path / "out"
    ran = run("stiffness", file, "--finger-radius-mm", 8.2, "--out", out, "--json", tmp_path / "r.json")
    result = done(ran, out, "indentation.png", "indentation.csv")
    assert result["reduced_modulus_intercept_MPa"] == pytest.approx(
        0.31, abs=5 * result["reduced_modulus_intercept_se_MPa"]
    )
    assert result["peak_pressure_max_MPa"] == pytest.approx(1.5 * result["mean_pressure_max_MPa"])
    assert json.loads((tmp_path / "r.json").read_text()) == result
    assert result["provenance"]["packages"]["scipy"]


def test_compression(run, tmp_path):
    s = np.linspace(0.99, 0.6, 50)
    file = csv(
        tmp_path / "c.csv",
        "strain_%,stress_kPa",
        100 * (1 - s),
        -1e3 * hyperelastic.of_material("silskin_0").uniaxial(s),
    )
    result = done(
        run("stiffness", file, "--test", "compression", "--out", tmp_path / "o"), tmp_path / "o", "compression.png"
    )
    assert result["C01_Pa"] == pytest.approx(49474.0, rel=1e-4)
    assert result["stability_limits"]["tension"] == pytest.approx(2.627, abs=0.002)


def test_dma(run, tmp_path):
    sweeps = [dma.from_range(material("silskin_0").dma, t) for t in (5.0, 20.0, 40.0)]
    columns = [
        np.concatenate([getattr(s, n) for s in sweeps]) for n in ("frequency", "temperature", "storage", "loss_factor")
    ]
    file = csv(tmp_path / "d.csv", "frequency_Hz,temperature_C,storage_MPa,tan_delta", *columns)
    result = done(
        run("dma", file, "--reference-C", 20, "--out", tmp_path / "o"), tmp_path / "o", "dma.png", "prony.csv"
    )
    assert result["reference_temperature_C"] == 20
    assert result["activation_energy_kJ_per_mol"] > 0
    assert len(result["moduli_MPa"]) == len(result["times_s"]) > 2


def test_friction_groups(run, tmp_path):
    rng = np.random.default_rng(5)
    files = []
    for i, (static, dynamic) in enumerate(
        [(1.1, 0.9), (1.12, 0.92), (1.13, 0.91), (0.8, 0.7), (0.81, 0.69), (0.82, 0.7)]
    ):
        r = simulate_stick_slip(Slider(0.05, 1.5, 1.0, static, dynamic, damping=0.001), 1.0, 5.0, 400)
        noise = 0.005 * rng.normal(size=(3, len(r.time)))
        files.append(
            csv(
                tmp_path / f"f{i}.csv",
                "time_s,Fx_N,Fy_N,Fz_N",
                r.time,
                r.spring_force + noise[0],
                noise[1],
                1 + noise[2],
            )
        )
    words = [w for g in "aaabbb" for w in ("--group", g)]
    out = tmp_path / "o"
    ran = run("friction", *files, *words, "--out", out)
    result = done(ran, out, "friction.png", "histogram.png", "spectrum.png")
    assert [s["static"] for s in result["slides"]] == pytest.approx([1.1, 1.12, 1.13, 0.8, 0.81, 0.82], abs=0.03)
    assert result["static"]["anova"]["significant"]
    pair = result["static"]["anova"]["pairs"][0]
    assert pair["low"] < 1.1167 - 0.81 < pair["high"]
    assert result["static"]["repeatability"]["within_std"] == pytest.approx(0.0129, abs=0.01)


def test_friction_files_of_one_name_are_kept_apart(run, tmp_path):
    files = []
    for folder, dynamic in (("left", 0.9), ("right", 0.6)):
        (tmp_path / folder).mkdir()
        r = simulate_stick_slip(Slider(0.05, 1.5, 1.0, dynamic + 0.1, dynamic, damping=0.001), 1.0, 5.0, 400)
        headings = "time_s,tangential_N,normal_N"
        files.append(csv(tmp_path / folder / "slide.csv", headings, r.time, r.spring_force, 0 * r.time + 1))
    result = done(run("friction", *files, "--out", tmp_path / "o"), tmp_path / "o", "histogram.png")
    first, second = result["slides"]
    assert first["file"] != second["file"]
    # the mode of each is its own, near its own median: within half of what parts the two
    assert first["mode"] == pytest.approx(first["dynamic"], abs=0.15)
    assert second["mode"] == pytest.approx(second["dynamic"], abs=0.15)
    twice = run("friction", files[0], files[0])
    assert twice.exit_code == 2
    assert "given twice" in twice.stderr


def test_profile_and_map(run, tmp_path):
    x = np.arange(0, 8, 0.004)
    d = np.abs((x - 0.2 + 0.5) % 1.0 - 0.5)
    z = 47.67 * np.clip((0.25 + 0.04 - d) / 0.08, 0, 1)
    file = csv(tmp_path / "p.csv", "x_mm,z_um", x, z)
    out = tmp_path / "o"
    ran = run("profile", file, "--design-height-um", 100, "--design-width-um", 500, "--out", out)
    result = done(ran, out, "profile.png", "height_map.npz")
    assert result["height_mm"]["mean"] == pytest.approx(0.04767, rel=1e-3)
    assert result["against_design"]["height"]["relative_deviation"] == pytest.approx(-0.523, abs=0.002)
    with np.load(out / "height_map.npz", allow_pickle=False) as data:
        assert data["pitch_mm"] == pytest.approx(0.004)
        assert data["distance_mm"].max() == pytest.approx(0.04767, rel=0.01)
    grid = tmp_path / "m.csv"
    np.savetxt(grid, np.tile(z[::4], (200, 1)), delimiter=",")
    out = tmp_path / "m"
    result = done(run("profile", grid, "--pitch-um", 16, "--out", out), out, "map.png", "height_map.npz")
    assert abs(result["orientation_deg"]) == pytest.approx(90, abs=0.5)
    assert result["pitch_mm"]["mean"] == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["stiffness", "no.csv"], 2, "no such file"),
        (["stiffness", "text.csv"], 2, "no column 'force'"),
        (["stiffness", "text.csv", "--test", "tension"], 2, "indentation, compression"),
        (["dma", "text.csv", "--reference-C", "900"], 2, "--reference-C"),
        (["dma", "text.csv"], 2, "no column 'frequency'"),
        (["friction", "text.csv", "--group", "a", "--group", "b"], 2, "2 groups for 1 files"),
        (["profile", "numbers.csv"], 2, "--pitch-um"),
        (["profile", "text.csv", "--design-height-um", "-3"], 2, "above 0 um"),
        (["profile", "text.csv", "--json", "nowhere/x.json"], 2, "its folder does not exist"),
        (["friction", "flat.csv"], 2, "flat.csv: no sliding found"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(run, tmp_path, monkeypatch, words, code, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.csv").write_text("colour_MPa,shape_mm\n1,2\n")
    (tmp_path / "numbers.csv").write_text("1,2,3\n4,5,6\n")
    t = np.linspace(0, 1, 100)
    csv(tmp_path / "flat.csv", "time_s,Fx_N,Fz_N", t, 0 * t, 0 * t + 1)
    result = run(*words)
    assert result.exit_code == code, result.output
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "outputs").exists()


def test_stiffness_gives_a_scene_its_finger(run, tmp_path):
    """E*(F) of a drawn test of the scene's own tip, and the figures of a compression: the scenes written hold both."""
    from evanesce.contact.laws import finger_modulus
    from evanesce.rig import dump_scene, load_scene

    (tmp_path / "rig.toml").write_text(dump_scene(load_scene("thesis", {"finger.tip_radius_mm": 8.2})))
    g = indentation.elliptic_geometry(8.2, 25.45 / 2)
    f = np.linspace(0.05, 9.0, 120)
    file = csv(tmp_path / "i.csv", "Load [N],Depth [um]", f, 1e3 * (0.2 + g.depth(f, 0.31 + 0.02 * f)))
    out = tmp_path / "out"
    ran = run("stiffness", file, "--scene", tmp_path / "rig.toml", "--out", out)
    done(ran, out, "finger.toml", "scene.toml")
    assert "[finger.reduced_modulus]" in ran.stdout
    scene = load_scene(str(out / "scene.toml"))
    for force in (0.5, 3.0, 8.9):
        assert finger_modulus(scene, force) == pytest.approx(0.31 + 0.02 * force, rel=1e-3)
    s = np.linspace(0.99, 0.6, 50)
    stress = -hyperelastic.MooneyRivlin(0.02, 0.005, 0.0).uniaxial(s)
    file = csv(tmp_path / "c.csv", "strain_%,stress_kPa", 100 * (1 - s), 1e3 * stress)
    ran = run("stiffness", file, "--test", "compression", "--terms", 2, "--scene", tmp_path / "rig.toml", "--out", out)
    done(ran, out, "finger.toml", "scene.toml")
    assert finger_modulus(load_scene(str(out / "scene.toml")), 3.0) == pytest.approx(8 * 0.025, rel=1e-4)


def drawn_stack(folder, gain=2.0):
    """Frames of a sensor of known gain, read noise 4 e-, by NumPy alone."""
    rng = np.random.default_rng(2)
    folder.mkdir()
    lines = ["file,exposure_s,light"]
    for level in (0, 200, 500, 900, 1500, 2200, 3000, 4000):
        for k in range(2):
            charge = rng.poisson(level, (100, 120)) + 4.0 * rng.normal(size=(100, 120))
            np.save(folder / f"{level}_{k}.npy", np.clip(np.rint(charge / gain + 256), 0, 4095).astype(np.uint16))
            lines.append(f"{level}_{k}.npy,{0.01 if level == 0 else level / 1e5},{0 if level == 0 else 1}")
    (folder / "stack.csv").write_text("\n".join(lines))
    return folder


def test_sensor_of_a_stack_and_the_scene_with_its_keys(run, tmp_path):
    ran = run(
        "sensor",
        drawn_stack(tmp_path / "s"),
        "--scene",
        "thesis",
        "--out",
        tmp_path / "o",
        "--json",
        tmp_path / "r.json",
    )
    result = done(ran, tmp_path / "o", "photon_transfer.png", "photon_transfer.csv", "pixel.toml", "scene.toml")
    (one,) = result["photon_transfer"]
    assert one["gain_e_per_DN"] == pytest.approx(2.0, rel=0.02)
    assert one["read_noise_e"] == pytest.approx(4.0, rel=0.03)
    assert one["linearity"]["error"] < 0.005
    assert json.loads((tmp_path / "r.json").read_text()) == result
    scene = load_scene(str(tmp_path / "o" / "scene.toml"))
    assert scene.camera.pixel.conversion_gain_e_per_DN == pytest.approx(one["gain_e_per_DN"], rel=1e-4)
    assert scene.camera.pixel.black_level_DN == pytest.approx(256.0, abs=0.05)  # mean of 24,000 covered samples


def test_covered_exposures_too_few_for_a_dark_current_are_told(run, tmp_path):
    folder = drawn_stack(tmp_path / "s")
    rng, more = np.random.default_rng(3), []
    for exposure in (1.0, 4.0):
        for k in range(2):
            charge = rng.poisson(50.0 * exposure, (100, 120)) + 4.0 * rng.normal(size=(100, 120))
            np.save(folder / f"d{exposure:g}_{k}.npy", np.rint(charge / 2.0 + 256).astype(np.uint16))
            more.append(f"d{exposure:g}_{k}.npy,{exposure},0")
    with (folder / "stack.csv").open("a") as stream:
        stream.write("\n" + "\n".join(more))
    result = done(run("sensor", folder, "--out", tmp_path / "o"), tmp_path / "o", "photon_transfer.png")
    assert result["dark"] == []
    (note,) = result["notes"]
    assert "3 exposures, 5 needed" in note


def test_sensor_of_tables(run, tmp_path):
    m = np.linspace(20, 3000, 30)
    transfer = csv(tmp_path / "ptc.csv", "mean_DN,variance_DN2", m + 256, 2.0 + m / 2.2 + (0.011 * m) ** 2)
    t = np.arange(0.0, 200, 20)
    cold = csv(tmp_path / "cold.csv", "exposure_s,variance_DN2", t, 2 + 0.05 * t)
    warm = csv(tmp_path / "warm.csv", "exposure_s,variance_DN2", t, 2 + 0.10 * t)
    files = ("sensor", transfer, cold, warm, "--temperature-C", 10, "--temperature-C", 18)
    result = done(run(*files, "--out", tmp_path / "o"), tmp_path / "o", "dark.png")
    assert result["photon_transfer"][0]["prnu"] == pytest.approx(0.011, rel=1e-3)
    assert result["dark"][1]["dark_current_from_variance_e_per_s"] == pytest.approx(0.1 * 2.2**2, rel=1e-3)
    assert result["temperature_factors"][0]["doubling_K"] == pytest.approx(8.0, rel=1e-3)
    assert result["temperature_law"]["activation_energy_se"] is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--mosaic", "RGB"), "--mosaic"),
        (("--raw-size", "12"), "--raw-size"),
        (("--temperature-C", 20), "--temperature-C"),
        (("--gain-e-per-DN", -1), "--gain-e-per-DN"),
        (("--black-level-DN", 5000), "--black-level-DN"),
    ],
)
def test_sensor_options_out_of_range(run, tmp_path, options, words):
    table = csv(tmp_path / "ptc.csv", "mean_DN,variance_DN2", np.linspace(300, 900, 9), np.linspace(20, 300, 9))
    ran = run("sensor", table, *options, "--out", tmp_path / "o")
    assert ran.exit_code == 2
    assert words in ran.output
    assert "Traceback" not in ran.output
    assert not (tmp_path / "o").exists()


def test_sensor_of_a_table_without_a_curve(run, tmp_path):
    flat = csv(tmp_path / "flat.csv", "mean_DN,variance_DN2", np.linspace(300, 900, 9), np.linspace(300, 20, 9))
    ran = run("sensor", flat, "--out", tmp_path / "o")
    assert ran.exit_code == 2
    assert "no conversion gain" in ran.output
    assert not (tmp_path / "o").exists()


def test_sensor_terms_of_a_table(run, tmp_path):
    """A sensor of the default gain and read noise whose pixels differ by 1.2 %: one term lacks, and is named."""
    m = np.geomspace(15, 2600, 40)
    rng = np.random.default_rng(1)
    variance = ((3.0 / 2.13) ** 2 + 1 / 12 + m / 2.13 + (0.012 * m) ** 2) * np.exp(0.01 * rng.normal(size=40))
    table = csv(tmp_path / "ptc.csv", "mean_DN,variance_DN2", m + 256, variance)
    result = done(run("sensor", table, "--terms", "--out", tmp_path / "o"), tmp_path / "o")
    (term,) = result["lacking"]["transfer"]["terms"]
    assert term["key"] == "prnu"
    assert term["values"][""] == pytest.approx(0.012, rel=0.05)
    assert result["lacking"]["transfer"]["held_out_gain"][0] > 20  # five stretches of one series: no narrow interval
    short = csv(tmp_path / "short.csv", "mean_DN,variance_DN2", m[::5] + 256, variance[::5])
    ran = run("sensor", short, "--terms", "--out", tmp_path / "o2")
    assert ran.exit_code == 2
    assert "--terms" in ran.output
    assert not (tmp_path / "o2").exists()
