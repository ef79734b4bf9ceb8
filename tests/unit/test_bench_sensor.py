"""Sensor figures against frames and tables drawn by NumPy alone: gain, read noise, PRNU, dark current, its law."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from evanesce.bench import dark_signal, frame_stack, photon_transfer, sensor, sensor_tables
from evanesce.cli.app import app
from evanesce.core.errors import InputError, WorkError

K, READ_E, PRNU, DSNU_E, BLACK = 2.6, 4.2, 0.012, 3.0, 200.0
SHAPE = (160, 240)
BOLTZMANN = 8.617333e-5  # eV/K


class Drawn:
    """A sensor of known figures, apart from the program's."""

    def __init__(self, seed=1, shape=SHAPE, prnu=PRNU, dsnu=DSNU_E):
        self.rng = np.random.default_rng(seed)
        self.gain_of_pixel = 1 + prnu * self.rng.normal(size=shape)
        self.offset_e = dsnu * self.rng.normal(size=shape)

    def frame(self, electrons, dark_e=0.0, clip=4095):
        charge = self.rng.poisson(np.maximum(electrons * self.gain_of_pixel + dark_e, 0)).astype(float) + self.offset_e
        signal = (charge + READ_E * self.rng.normal(size=charge.shape)) / K + BLACK
        return np.clip(np.floor(signal + 0.5), 0, clip).astype(np.uint16)


def write_stack(
    folder, drawn, levels=(300, 700, 1500, 2500, 3500, 4500, 5500, 6500, 7500, 8500, 9500, 11000), frames=3
):
    folder.mkdir(exist_ok=True)
    lines = ["file,exposure_ms,light"]
    for level in (0, *levels):
        for k in range(frames):
            name = f"f{level:05d}_{k}.png"
            Image.fromarray(drawn.frame(level)).save(folder / name)
            lines.append(f"{name},{10 if level == 0 else level / 100},{0 if level == 0 else 1}")
    (folder / "stack.csv").write_text("\n".join(lines) + "\n")
    return folder


def test_a_stack_of_known_figures(tmp_path):
    rows = frame_stack.reduce_stack(write_stack(tmp_path / "s", Drawn()), bits=12)
    (found,) = sensor.of_stack(rows, 256.0).transfers
    # 38,400 pixels, 2 degrees of freedom: a variance is good to sqrt(2/76800) = 0.5 %, and nine rows of them.
    assert found.fit.gain_e_per_DN == pytest.approx(K, rel=0.01)
    assert found.fit.read_noise_e == pytest.approx(READ_E, rel=0.02)
    assert found.prnu == pytest.approx(PRNU, rel=0.02)  # 1/sqrt(2 x 38400) = 0.4 %
    assert found.dsnu_e == pytest.approx(DSNU_E, rel=0.03)
    assert found.line.error < 0.002
    assert found.fit.saturation_DN == pytest.approx(3895, rel=0.07)  # a row at the end of the converter, or the last
    assert not found.doubts
    assert max(map(abs, found.correlation)) < 5 * found.correlation_se


def test_standard_errors_of_tables_cover_the_truth():
    """100 tables of 40 rows of 1 % scatter: gain, read noise and PRNU within two standard errors in most."""
    rng, inside = np.random.default_rng(5), []
    signal = np.linspace(20, 3000, 40)
    truth = (K, READ_E, PRNU)
    for _ in range(100):
        variance = (1 / 12 + (READ_E / K) ** 2 + signal / K + (PRNU * signal) ** 2) * (1 + 0.01 * rng.normal(size=40))
        f = photon_transfer.fit_photon_transfer(signal, variance)
        found = ((f.gain_e_per_DN, f.gain_se), (f.read_noise_e, f.read_noise_se), (f.prnu, f.prnu_se))
        inside.append([abs(v - t) < 2 * se for (v, se), t in zip(found, truth, strict=True)])
    share = np.mean(inside, axis=0)
    assert np.all(share > 0.87)  # 0.95 +- 3 x 0.022


def test_saturated_rows_are_left_out():
    signal = np.linspace(20, 3800, 60)
    variance = 3 + signal / K
    variance[signal > 3600] = 5.0
    f = photon_transfer.fit_photon_transfer(signal, variance, quadratic=False)
    assert f.saturation_DN == pytest.approx(3600, abs=65)
    assert f.limit_DN <= 0.7 * f.saturation_DN
    assert f.gain_e_per_DN == pytest.approx(K, rel=1e-9)


def test_a_planted_curvature_shows_in_the_linearity():
    exposure = np.linspace(1, 40, 30)
    straight = photon_transfer.linearity(exposure, 90 * exposure)
    bent = photon_transfer.linearity(exposure, 90 * exposure * (1 - 0.002 * exposure))
    assert straight.error < 1e-12
    assert bent.error > 0.003
    assert abs(bent.worst) > bent.error


def test_a_low_pass_on_the_sensor_is_noticed(tmp_path):
    """Frames smoothed by (1, 6, 1)/8 along rows have less variance: gain wrong by half, and said so."""
    drawn = Drawn()
    plain = drawn.frame

    def smoothed(electrons, dark_e=0.0, clip=4095):
        f = plain(electrons, dark_e, 60000).astype(float)
        f = (np.roll(f, 1, 1) + 6 * f + np.roll(f, -1, 1)) / 8
        return np.clip(np.floor(f + 0.5), 0, clip).astype(np.uint16)

    drawn.frame = smoothed
    rows = frame_stack.reduce_stack(write_stack(tmp_path / "s", drawn), bits=12)
    (found,) = sensor.of_stack(rows, 256.0).transfers
    assert found.fit.gain_e_per_DN == pytest.approx(K / (38 / 64), rel=0.02)
    assert found.correlation[0] == pytest.approx(12 / 38, abs=0.02)
    assert "filtered" in found.doubts[0]


def test_light_that_flickers_and_varies_over_the_frame_is_no_noise_of_the_sensor(tmp_path):
    drawn, x = Drawn(prnu=0.0), np.linspace(-1, 1, SHAPE[1])
    shade = 1 - 0.2 * x**2 + 0.1 * np.linspace(-1, 1, SHAPE[0])[:, None]
    plain = drawn.frame
    drawn.frame = lambda level: plain(level * shade * (1 + 0.02 * drawn.rng.normal()))
    levels = (300, 700, 1500, 2500, 3500, 4500, 5500, 6500)
    rows = frame_stack.reduce_stack(write_stack(tmp_path / "s", drawn, levels), bits=12)
    (found,) = sensor.of_stack(rows, 256.0).transfers
    assert found.fit.gain_e_per_DN == pytest.approx(K, rel=0.015)
    assert found.prnu < 0.002


def test_mosaic_classes_are_separate(tmp_path):
    drawn = Drawn(shape=(200, 300))
    colour = np.tile(np.array([[0.4, 1.0], [0.9, 0.6]]), (100, 150))
    plain = drawn.frame
    drawn.frame = lambda level: plain(level * colour)
    rows = frame_stack.reduce_stack(write_stack(tmp_path / "s", drawn), bits=12, mosaic="BGGR")
    found = {t.name: t for t in sensor.of_stack(rows, 256.0).transfers}
    assert list(found) == ["B", "G1", "G2", "R"]
    for one in found.values():
        assert one.fit.gain_e_per_DN == pytest.approx(K, rel=0.02)
    assert found["B"].signal_DN.max() / found["R"].signal_DN.max() == pytest.approx(0.4 / 0.6, rel=0.02)


def test_dark_current_and_its_law_from_frames(tmp_path):
    """Dark current from the mean and from the variance, of which it is shot noise, at two temperatures."""
    energy, rate_20 = 0.6, 30.0
    folder, lines = tmp_path / "d", ["file,exposure_s,light,temperature_C"]
    folder.mkdir()
    for at in (5.0, 25.0):
        drawn = Drawn(seed=3)
        rate = rate_20 * np.exp(energy / BOLTZMANN * (1 / 293.15 - 1 / (at + 273.15)))
        own = rate * drawn.rng.gamma(4.0, 0.25, SHAPE)  # relative spread 0.5
        for t in (0, 2, 5, 10, 15, 20, 30):
            for k in range(2):
                name = f"d{at:g}_{t}_{k}.npy"
                np.save(folder / name, drawn.frame(0.0, own * t))
                lines.append(f"{name},{t},0,{at}")
    (folder / "stack.csv").write_text("\n".join(lines))
    found = sensor.of_stack(frame_stack.reduce_stack(folder, bits=12), 256.0)
    assert not found.transfers
    for series, fit in zip(found.dark.series, found.dark.fits, strict=True):
        rate = rate_20 * np.exp(energy / BOLTZMANN * (1 / 293.15 - 1 / (series.temperature_C + 273.15)))
        assert fit.current_DN_per_s * K == pytest.approx(rate, rel=0.01)
        assert fit.shot_DN2_per_s * K**2 == pytest.approx(rate, rel=0.03)
        assert fit.nonuniformity_DN_per_s * K == pytest.approx(0.5 * rate, rel=0.03)
    assert found.dark.law.activation_energy_eV == pytest.approx(energy, rel=0.03)


def test_one_factor_on_exposure_whatever_the_law():
    """Variances that saturate: only the exposure's scale differs between the two temperatures."""
    t = np.arange(0.0, 301, 10)

    def grown(scale):
        return 2.0 + 40 * (1 - np.exp(-t * scale / 90.0)) + 0.05 * t * scale

    low = dark_signal.DarkSeries("all", 0.0, t, grown(1.0))
    high = dark_signal.DarkSeries("all", 20.0, t, grown(3.0))
    found = dark_signal.acceleration(low, high)
    assert found.factor == pytest.approx(3.0, rel=0.02)  # straight lines between 10 s steps
    assert found.doubling_K == pytest.approx(20 * np.log(2) / np.log(3.0), rel=0.02)
    with pytest.raises(WorkError, match=r"no faster|share no levels"):
        dark_signal.acceleration(high, low)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mean_DN,variance_DN2\n300,-1\n", "row 2: -1 DN2"),
        ("mean_DN,variance_DN2\n300,5\n5000,5\n", "row 3: 5000 DN"),
        ("mean,variance_DN2\n300,5\n", "has no unit"),
        ("mean_DN,brightness\n300,5\n", "no column 'variance'"),
        ("mean_DN,variance_DN2\n300,x\n", "'x' is not a number"),
    ],
)
def test_bad_transfer_tables(tmp_path, text, message):
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        sensor_tables.read_transfer(path, 4095)


@pytest.mark.parametrize(
    ("text", "temperature", "message"),
    [
        ("exposure_s,variance_DN2\n0,2\n1,3\n", None, "has no temperature"),
        ("exposure_s,variance_DN2\n0,0\n1,3\n", 20.0, "no variance"),
        ("exposure_s,variance_DN2\n-1,2\n1,3\n", 20.0, "row 2: -1 s"),
        ("exposure_s,noise_DN\n0,2\n", 20.0, "begins with 'variance'"),
        ("exposure_s,variance_DN2\n0,2\n1,3\n", 500.0, "500 degC"),
    ],
)
def test_bad_dark_tables(tmp_path, text, temperature, message):
    path = tmp_path / "t.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        sensor_tables.read_dark(path, temperature)


def test_a_table_below_its_black_level_is_another_cameras(tmp_path):
    level = np.linspace(40.0, 900.0, 30)
    table = sensor_tables.TransferTable("all", level, 2.0 + level / 3.0)
    with pytest.raises(InputError, match=r"--black-level-DN.*below the black level of 600 DN: 40 to 900 DN"):
        sensor.of_table(table, 600.0)
    assert sensor.of_table(table, 40.0).fit.gain_e_per_DN == pytest.approx(3.0, rel=0.01)


def test_bad_stacks(tmp_path):
    folder = tmp_path / "s"
    folder.mkdir()
    with pytest.raises(InputError, match=r"s: has no stack.csv \(allowed: a list: file, exposure_s"):
        frame_stack.reduce_stack(folder, bits=12)
    good = np.full((16, 16), 300, np.uint16)
    np.save(folder / "a.npy", good)

    def fails(lines, message, **options):
        (folder / "stack.csv").write_text("file,exposure_s\n" + lines)
        with pytest.raises(InputError, match=message):
            frame_stack.reduce_stack(folder, bits=12, **options)

    fails("a.npy,1\n", "one frame of exposure")
    fails("a.npy,1\na.npy,1\n", "listed twice")
    fails("a.npy,1\nb.npy,1\n", "no such file")
    np.save(folder / "b.npy", np.full((16, 18), 300, np.uint16))
    fails("a.npy,1\nb.npy,1\n", "18 x 16 pixels")
    np.save(folder / "c.npy", good * 16)
    fails("a.npy,1\nc.npy,1\n", "4800 DN")
    (folder / "d.png").write_bytes(b"\x89PNG\r\n\x1a\n broken")
    fails("a.npy,1\nd.png,1\n", "not a readable image")
    Image.fromarray(np.zeros((16, 16, 3), np.uint8)).save(folder / "e.png")
    fails("a.npy,1\ne.png,1\n", "not colour")
    good.tofile(folder / "f.raw")
    fails("f.raw,1\na.npy,1\n", "--raw-size")
    fails("f.raw,1\na.npy,1\n", "512 bytes", raw_size=(16, 17))
    (folder / "stack.csv").unlink()
    with pytest.raises(InputError, match=r"stack\.csv"):
        frame_stack.reduce_stack(folder, bits=12)


def test_each_dark_table_is_read_at_its_own_analogue_gain(tmp_path):
    """Shot noise of 0.4 e-/s at 3 e-/DN: filmed at gain 4 the same charge is four times as many DN."""
    gain_e, current_e, t = 3.0, 0.4, np.linspace(0.0, 200.0, 20)
    level = np.linspace(50.0, 3000.0, 30)
    for name, gain in (("one", 1.0), ("four", 4.0)):
        variance = (4.0 + current_e * (3.0 if name == "four" else 1.0) * t) * (gain / gain_e) ** 2
        rows = "\n".join(f"{a:.6g},{b:.8g}" for a, b in zip(t, variance, strict=True))
        (tmp_path / f"{name}.csv").write_text(f"exposure_s,variance_DN2\n{rows}\n", encoding="utf-8")
    rows = "\n".join(f"{a + 64:.6g},{4.0 / gain_e**2 + a / gain_e:.8g}" for a in level)
    (tmp_path / "light.csv").write_text(f"mean_DN,variance_DN2\n{rows}\n", encoding="utf-8")

    def bench(*tables, gains):
        out = tmp_path / "out.json"
        options = [f"--temperature-C={20.0 if name == 'one' else 30.0}" for name in tables if name != "light"]
        done = CliRunner().invoke(app, [
            "bench", "sensor", *(str(tmp_path / f"{name}.csv") for name in tables), *options, "--black-level-DN", "64",
            *(f"--analogue-gain={gain}" for gain in gains), "--json", str(out), "--out", str(tmp_path / "o"),
        ])  # fmt: skip
        assert done.exit_code == 0, done.output
        return json.loads(out.read_text(encoding="utf-8"))

    for order in (("light", "one", "four"), ("four", "light", "one")):
        found = bench(*order, gains=[4 if name == "four" else 1 for name in order])
        currents = [row["dark_current_from_variance_e_per_s"] for row in found["dark"]]
        assert sorted(currents) == pytest.approx([current_e, 3 * current_e], rel=0.01)
        (faster,) = found["temperature_factors"]
        assert faster["factor"] == pytest.approx(3.0, rel=0.01)
