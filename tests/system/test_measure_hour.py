"""A lab's film and force log, drawn without the package, through ``evanesce measure`` with its defaults."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.core.errors import InputError
from evanesce.measurement.calibration.model import Calibration, save_calibration
from evanesce.measurement.force import area_force
from evanesce.measurement.io.force import ForceLog, read_force
from evanesce.measurement.reference.area import AreaRow
from support import drawn_lab
from support.videos import write_video

SHAPE, PX_PER_MM, RATE, FREE, FRAMES = (240, 320), 24.0, 10, 5, 16
FACTOR, LATER_S = 5.0, 0.43
"""True law A = 5 F^(2/3) [mm^2], and how much later the frames' clock starts than the load cell's."""


def force_at(time_s):
    return np.clip((np.asarray(time_s) - (FREE - 0.5) / RATE) * 3.0, 0.0, None)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A film that begins without a finger, dust and glow in it, in H.264; a calibration; a log at 50 Hz."""
    folder = tmp_path_factory.mktemp("lab")
    rng = np.random.default_rng(4)
    specks = drawn_lab.dust(SHAPE, rng, 15, 0.3)
    frames, true = [], []
    for k in range(FRAMES):
        area = FACTOR * float(force_at(k / RATE)) ** (2 / 3) * PX_PER_MM**2
        a = np.sqrt(area / np.pi / 0.8)
        share = drawn_lab.contact(SHAPE, (163.0, 118.0), (a, 0.8 * a)) if a > 0 else np.zeros(SHAPE)
        true.append(float(share.sum()) / PX_PER_MM**2)
        grey = drawn_lab.frame(share, rng, glow=0.05, specks=specks)
        frames.append(np.repeat(grey[..., None], 3, axis=2))
    write_video(folder / "film.mp4", frames, "libx264", "yuv420p", RATE, options={"crf": "15"})
    save_calibration(
        folder / "cal.json",
        Calibration(
            image_size=SHAPE[::-1], camera_matrix=np.array([[600.0, 0, 159.5], [0, 600, 119.5], [0, 0, 1]]),
            distortion=np.zeros(5), mm2_per_px=PX_PER_MM**-2, square_side_mm=15.0,
        ),
    )  # fmt: skip
    times = np.arange(0.0, FRAMES / RATE + 1, 0.02)
    lines = [f"{t:.3f};{f / 9.80665e-3:.4f}" for t, f in zip(times, force_at(times - LATER_S), strict=True)]
    (folder / "force.csv").write_text("time_s;force_g\n" + "\n".join(lines) + "\n")
    return folder, np.array(true)


def measured(folder, *options):
    target = folder / "o.json"
    done = CliRunner().invoke(app, ["measure", str(folder / "film.mp4"), "--json", str(target), *map(str, options)])
    assert done.exit_code == 0, done.output
    return json.loads(target.read_text()), done


def test_defaults_lead_with_the_refined_area(lab):
    folder, true = lab
    out = folder / "out"
    data, done = measured(folder, "--calibration", folder / "cal.json", "--force", folder / "force.csv", "--out", out)
    area, low, high = (np.array([f[k] for f in data["frames"]]) for k in ("area_mm2", "area_low_mm2", "area_high_mm2"))
    assert data["settings"]["estimator"] == "refined"
    assert data["dark_frames"] == list(range(FREE))
    assert (area[:FREE] == 0).all()
    large = true > 2
    assert np.sqrt(np.mean((area[large] / true[large] - 1) ** 2)) < 0.005
    # no film of air here, which is one end of what the budget allows it; prints are drawn, as in support/walk.py
    draws = np.random.default_rng(3)
    size = (1 + draws.uniform(-0.002, 0.002, 2000)) * (1 - draws.uniform(0, 0.1, 2000) / (600 / PX_PER_MM))
    factor = (size**-2)[:, None]
    held = (low[FREE:] * factor <= true[FREE:]) & (true[FREE:] <= high[FREE:] * factor)
    assert held.mean() > 0.8
    assert ((low <= area) & (area <= high)).all()
    beside = np.array([f["reference_mm2"] for f in data["frames"]])
    assert (beside[large] > 1.05 * true[large]).all()
    split = data["reference"]["apart"]
    total = 100 * (split["reference_mm2"] / split["refined_mm2"] - 1)
    assert split["blur_percent"] + split["flank_percent"] + split["rest_percent"] == pytest.approx(total)
    assert "threshold_far_from_half" in {w["code"] for w in data["warnings"]}
    curve = [point["area_mm2"] for point in data["area_against_threshold"]]
    assert all(a >= b for a, b in itertools.pairwise(curve))  # a higher threshold never counts more
    assert "mean of 5 frame(s) without a finger" in done.stdout
    joined = data["area_force"]
    assert abs(joined["offset_s"] - LATER_S) < 4 * joined["offset_standard_s"] < 0.2
    assert joined["hertz"]["factor"] == pytest.approx(FACTOR, rel=0.02)
    assert (out / "area_force.png").is_file()
    assert (out / "threshold.png").is_file()


def test_automatic_threshold_and_the_published_segmentation(lab):
    """Half-way leaves the boundary of a blurred edge in place; the published threshold counts the same as ever."""
    folder, true = lab
    common = ("--calibration", folder / "cal.json", "--estimator", "reference")
    auto, done = measured(folder, *common, "--threshold", "auto")
    area = np.array([f["area_mm2"] for f in auto["frames"]])
    assert abs(area[-1] / true[-1] - 1) < 0.02
    assert "half-way in linear light" in done.stdout
    assert auto["settings"]["threshold"] == pytest.approx(auto["edge_levels"]["half"], abs=1e-3)
    plain, done = measured(folder, *common)
    assert plain["settings"]["threshold"] == 0.15
    last = plain["frames"][-1]
    assert last["area_mm2"] == pytest.approx(last["pixels"] / PX_PER_MM**2, rel=1e-14)
    assert last["area_low_mm2"] < last["corrected_mm2"] < last["area_high_mm2"] < last["area_mm2"]
    assert "lies outside the interval" in done.stdout


@pytest.mark.parametrize("offset", [None, 0.0])
def test_a_constant_force_has_no_law(offset):
    time = np.arange(60) / 30
    rows = [AreaRow(k, float(t), 1, 5.0 + 0.01 * k, 1) for k, t in enumerate(time)]
    log = ForceLog(np.linspace(-1, 4, 200), np.full(200, 2.0))
    with pytest.raises(InputError, match="2 to 2 N, and no law of force"):
        area_force(rows, log, offset)


def test_offset_and_law_of_drawn_areas():
    """Closed form: areas of a power law at a known offset, with noise; both come back within their own intervals."""
    rng = np.random.default_rng(9)
    hits = 0
    for number in range(20):
        time = np.arange(60) / 30
        rows = [
            AreaRow(k, float(t), 1, max(0.0, float(7.0 * f**0.8 + 0.05 * rng.normal())) if f > 0 else 0.0, 1)
            for k, (t, f) in enumerate(zip(time, force_at(time), strict=True))
        ]
        log_time = np.arange(0, 4, 0.02)
        found = area_force(rows, ForceLog(log_time, force_at(log_time - 0.21 - 0.01 * number)))
        assert abs(found.offset_s - 0.21 - 0.01 * number) < 0.02
        hits += found.power.exponent_low <= 0.8 <= found.power.exponent_high
    assert hits >= stats.binom.ppf(0.01, 20, 0.95)


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("time_s,load\n0,1\n1,2\n", "no column of force"),
        ("time_s,force_lbs\n0,1\n1,2\n", "force in n, mn"),
        ("time_s,force_N\n0,1\n0,2\n", "does not rise"),
        ("time_s,force_N\n0,1\n1,nan\n", "line 3"),
        ("time_s,force_N\n0,1\n1\n", "line 3"),
        ("time_s,force_N\n", "fewer than two lines"),
    ],
)
def test_a_damaged_force_log_names_its_place(tmp_path, text, part):
    (tmp_path / "f.csv").write_text(text)
    with pytest.raises(InputError) as caught:
        read_force(tmp_path / "f.csv")
    assert part in str(caught.value)


def test_implausible_forces_are_named(tmp_path):
    (tmp_path / "f.csv").write_text("Time [ms]\tForce [N]\n0\t0\n20\t350\n40\t410\n")
    log = read_force(tmp_path / "f.csv")
    assert log.time_s.tolist() == [0.0, 0.02, 0.04]
    assert [w.code for w in log.warnings] == ["force_implausible"]
