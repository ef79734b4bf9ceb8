"""Friction traces, statistics and ridge profiles: synthetic truth with noise, tables from the literature, limits."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.bench import friction, profile, relief, statistics, surface_files
from evanesce.contact.analytic.hertz import hertz_radius
from evanesce.core.errors import InputError, WorkError

# --- friction


def trace(static=1.13, dynamic=0.81, noise=0.01, rng=None, direction=0.4, load=1.0, drop=0.15):
    """Touch, rise for 1 s, break away with an exponential drop, slide on."""
    t = np.arange(0, 8, 0.002)
    mu = np.where(t < 1, 0, np.where(t < 2, static * (t - 1), dynamic + (static - dynamic) * np.exp(-(t - 2) / drop)))
    fz = load * np.clip(t / 0.5, 0, 1)
    q = mu * fz
    rng = rng or np.random.default_rng(4)
    n = noise * rng.normal(size=(3, len(t)))
    return friction.FrictionTrace(t, q * np.cos(direction) + n[0], q * np.sin(direction) + n[1], fz + n[2])


def test_static_and_dynamic_of_a_known_trace():
    rng = np.random.default_rng(31)
    errors = []
    for _ in range(25):
        result = friction.analyse(trace(rng=rng))
        errors.append((result.static - 1.13, result.dynamic - 0.81))
        assert 1.9 < result.peak_time < 2.1
    static, dynamic = np.array(errors).T
    # 41 samples a window: noise of a smoothed sample 0.01 sqrt(1 + mu^2) * 0.23 = 0.0035, its maximum over the peak
    # some +2 of these; the cusp is rounded by the window's 0.08 s against a drop of 0.15 s, some -0.03.
    assert np.abs(static).max() < 0.04
    assert np.abs(dynamic).max() < 0.003  # median of some 2,000 samples of noise 0.014, tail of the drop below 1e-4


def test_coefficient_uses_both_axes_and_skips_unloaded_samples():
    one = friction.FrictionTrace(
        np.arange(3.0), np.array([3.0, 3, 3]), np.array([4.0, -4, 4]), np.array([2.0, 5, 0.001])
    )
    np.testing.assert_allclose(friction.coefficient_of_friction(one), [2.5, 1.0, np.nan])


def test_noise_estimate_is_the_sensors():
    result = friction.analyse(trace(noise=0.02))
    # Friction noise 0.02 and normal-force noise 0.02 mu, over 1 N.
    assert result.noise == pytest.approx(0.02 * np.hypot(1, 0.81), rel=0.1)


def test_a_trace_without_peak_has_static_equal_dynamic():
    result = friction.analyse(trace(static=0.8, dynamic=0.8))
    assert result.static == pytest.approx(result.dynamic, abs=0.02)


def test_no_sliding_is_reported():
    t = np.linspace(0, 1, 200)
    nothing = friction.FrictionTrace(t, np.zeros(200), np.zeros(200), np.ones(200))
    with pytest.raises(WorkError, match="no sliding"):
        friction.analyse(nothing)


def test_spectrum_finds_a_line_between_bins():
    t = np.arange(0, 4, 0.001)
    found = friction.spectrum(t, 0.3 * np.sin(2 * np.pi * 7.31 * t) + 0.2 * t + 5)
    assert found.peak == pytest.approx(7.31, abs=0.02)  # bins of 0.25 Hz, parabola good to a few hundredths of one
    width = found.frequency[1]
    assert found.density.sum() * width == pytest.approx(0.3**2 / 2, rel=0.02)  # Parseval


def test_interfacial_rheology_is_recovered():
    rng = np.random.default_rng(9)
    force = np.array([0.5, 1, 2, 3, 4, 5])
    p = force / (np.pi * hertz_radius(force, 7.5, 0.77) ** 2)
    fits = [friction.fit_interfacial_rheology(p, 0.0606 / p + 0.2324 + 0.01 * rng.normal(size=6)) for _ in range(300)]
    tau = np.array([f.tau0 for f in fits])
    # Standard error of 300 means is sd/17; the predicted standard error is right on average (in the square).
    assert tau.mean() == pytest.approx(0.0606, abs=5 * tau.std() / np.sqrt(300))
    assert np.mean([f.tau0_se**2 for f in fits]) == pytest.approx(tau.var(), rel=0.3)
    with pytest.raises(ValueError, match="different positive pressures"):
        friction.fit_interfacial_rheology([0.1, 0.1, 0.1], [1, 1, 1])


def test_hysteresis_of_a_sphere_is_greenwood_and_tabors():
    """F = 0.17 beta W^(4/3) R^(-2/3) ((1 - nu^2)/E)^(1/3) for a hard sphere on rubber."""
    w, r, e = 1.7, 6.0, 0.9
    a = float(hertz_radius(w, r, e))
    mu = friction.hysteresis_coefficient(w / (np.pi * a**2), e, 0.3)
    assert mu * w == pytest.approx(0.1704 * 0.3 * w ** (4 / 3) * r ** (-2 / 3) * e ** (-1 / 3), rel=1e-3)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("0,1,0,1\n" * 10, "10 samples"),
        ("".join(f"{i % 7},1,0,1\n" for i in range(60)), "row 9: time does not ascend"),
        ("".join(f"{i},1,0,0\n" for i in range(60)), "zero throughout"),
    ],
)
def test_bad_traces(tmp_path, rows, message):
    path = tmp_path / "t.csv"
    path.write_text("time_s,Fx_N,Fy_N,Fz_N\n" + rows)
    with pytest.raises(InputError, match=message):
        friction.read_trace(path)


def test_trace_with_negative_normal_force_and_millinewtons(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("time [ms],friction force [mN],Load [N]\n" + "".join(f"{i},{500 + i},-2\n" for i in range(60)))
    read = friction.read_trace(path)
    assert read.sampling_rate == pytest.approx(1000)
    assert np.all(read.fz == 2)
    assert friction.coefficient_of_friction(read)[0] == pytest.approx(0.25)


# --- statistics


def test_anova_of_a_published_table():
    """Montgomery, Design and Analysis of Experiments, plasma etch rates: F = 66.80; every pair of powers differs."""
    groups = {
        "160": [575, 542, 530, 539, 570],
        "180": [565, 593, 590, 579, 610],
        "200": [600, 651, 610, 637, 629],
        "220": [725, 700, 715, 685, 710],
    }
    result = statistics.one_way_anova(groups)
    assert result.f_statistic == pytest.approx(66.80, abs=0.005)
    assert result.significant
    assert len(result.pairs) == 6
    assert all(p.p_value < 0.05 for p in result.pairs)
    # Montgomery's T_0.05 = q(4, 16) sqrt(MSE/n) = 33.09.
    assert result.pairs[0].high - result.pairs[0].difference == pytest.approx(33.09, abs=0.1)


def test_no_pairs_without_significance():
    result = statistics.one_way_anova({"a": [1.0, 2, 3], "b": [1.1, 2.1, 2.9]})
    assert not result.significant
    assert result.pairs == ()
    with pytest.raises(ValueError, match="at least two groups"):
        statistics.one_way_anova({"a": [1.0, 2.0]})
    with pytest.raises(ValueError, match="no group varies"):
        statistics.one_way_anova({"a": [1.0, 1.0], "b": [2.0, 2.0]})


def test_repeatability_recovers_the_variance_components():
    rng = np.random.default_rng(2)
    groups = {str(i): 1.0 + 0.2 * rng.normal() + 0.05 * rng.normal(size=12) for i in range(150)}
    r = statistics.repeatability(groups)
    # Standard errors: s_r/sqrt(2 dof) = 0.05/57; sigma_b/sqrt(2*149) = 0.2/17.
    assert r.within_std == pytest.approx(0.05, abs=4 * 0.05 / 57)
    assert r.between_std == pytest.approx(0.2, abs=4 * 0.2 / 17)
    assert r.limit == pytest.approx(2.77 * r.within_std, rel=1e-3)
    with pytest.raises(ValueError, match="two values"):
        statistics.repeatability({"a": [1.0], "b": [2.0]})


def test_freedman_diaconis_shrinks_with_the_cube_root():
    x = np.random.default_rng(1).normal(size=8000)
    assert statistics.freedman_diaconis_width(x) == pytest.approx(2 * 1.349 / 20, rel=0.05)  # IQR of a normal: 1.349
    assert statistics.freedman_diaconis_width(np.tile(x, 8)) == pytest.approx(
        statistics.freedman_diaconis_width(x) / 2, rel=1e-3
    )
    density, edges = statistics.histogram(x)
    assert np.sum(density * np.diff(edges)) == pytest.approx(1.0)
    assert len(statistics.histogram(np.full(9, 2.5))[0]) == 1
    assert len(statistics.histogram([0.0, 1e-9, 2e-9, 3e-9, 1e9])[0]) <= 10_000


def test_mode_of_a_skewed_sample():
    x = np.random.default_rng(6).gamma(4.0, 0.5, size=20_000)  # mode (k - 1) theta = 1.5, mean 2
    assert statistics.kernel_density_mode(x) == pytest.approx(1.5, abs=0.1)
    assert statistics.kernel_density_mode([3.0, 3.0]) == 3.0


# --- ridges

PITCH, WIDTH, HEIGHT, FLANK = 1.07, 0.51, 0.0477, 0.12


def ridge(u, height=HEIGHT):
    """Trapezoid: width at half height, flanks of full run FLANK; middle of a ridge at u = 0."""
    d = np.abs((u + PITCH / 2) % PITCH - PITCH / 2)
    return height * np.clip((WIDTH / 2 + FLANK / 2 - d) / FLANK, 0, 1)


def test_profile_returns_its_ridges():
    x = np.arange(0, 9.3, 0.004)
    rng = np.random.default_rng(1)
    z = ridge(x - 0.21) + 6e-4 * rng.normal(size=len(x)) + 0.003 * x - 0.1
    r = profile.analyse_profile(x, z)
    # Noise 0.6 um: a third of a plateau holds 42 samples (0.1 um); at mid-flank it moves a crossing by 1.5 um a side.
    assert r.height.mean == pytest.approx(HEIGHT, abs=3e-4)
    assert r.width.mean == pytest.approx(WIDTH, abs=0.002)
    assert r.pitch.mean == pytest.approx(PITCH, abs=0.002)
    assert r.edge.mean == pytest.approx(0.8 * FLANK, abs=0.002)
    assert r.height.count == 8
    against = profile.against_design(r, {"height": 0.1, "width": 0.5})
    assert against["height"]["relative_deviation"] == pytest.approx(-0.523, abs=0.005)


def test_spread_is_the_specimens():
    rng = np.random.default_rng(12)
    x = np.arange(0, 60, 0.01)
    n = np.floor((x - 0.2) / PITCH + 0.5).astype(int)
    heights = HEIGHT * (1 + 0.08 * rng.normal(size=n.max() + 2))
    r = profile.analyse_profile(x, ridge(x - 0.2) / HEIGHT * heights[n])
    true = np.std(heights[1 : r.height.count + 1], ddof=1)
    assert r.height.std == pytest.approx(true, rel=0.05)


def test_sinusoid_has_the_step_height_and_rounding_of_the_definitions():
    x = np.arange(0, 12, 0.002)
    r = profile.analyse_profile(x, 0.02 * np.cos(2 * np.pi * (x - 0.3) / 1.5))
    step = 0.04 * np.sin(np.pi / 6) / (np.pi / 6)  # mean over a third of a half wave
    assert r.height.mean == pytest.approx(step, rel=0.01)
    # 10 to 90 % of that step about the middle, on the sine.
    run = 2 * 1.5 / (2 * np.pi) * np.arcsin(0.8 * step / 0.04)
    assert r.edge.mean == pytest.approx(run, rel=0.02)
    assert r.width.mean == pytest.approx(0.75, rel=0.005)
    assert r.crest_radius.mean == pytest.approx(1.5**2 / (4 * np.pi**2 * 0.02), rel=0.05)


def test_a_bent_profile_is_flattened():
    x = np.arange(0, 9.3, 0.004)
    bent = ridge(x - 0.21) - (x - 4.0) ** 2 / (2 * 40.0)
    flat = profile.analyse_profile(x, bent, form_degree=2)
    assert flat.height.mean == pytest.approx(HEIGHT, rel=0.01)


@pytest.fixture(scope="module")
def scan():
    """A tilted map of oblique ridges with lost samples, 6 um pitch."""
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(700) * 0.006, np.arange(560) * 0.006)
    across = -x * np.sin(0.35) + y * np.cos(0.35)
    z = ridge(across - 0.3) + 8e-4 * rng.normal(size=x.shape) + 0.01 * x - 0.004 * y
    z[50:60, 70:90] = np.nan
    return z


def test_map_returns_its_ridges_whatever_their_direction(scan):
    r = profile.analyse_map(scan, 0.006)
    assert r.orientation == pytest.approx(0.35, abs=0.003)
    assert r.height.mean == pytest.approx(HEIGHT, abs=3e-4)
    assert r.width.mean == pytest.approx(WIDTH, abs=0.002)
    assert r.pitch.mean == pytest.approx(PITCH, abs=0.002)
    turned = profile.analyse_map(scan.T, 0.006)
    assert turned.orientation == pytest.approx(np.pi / 2 - 0.35, abs=0.003)
    assert turned.pitch.mean == pytest.approx(PITCH, abs=0.002)


def test_height_maps_for_the_finger(scan):
    surface = relief.height_map_of_scan(scan, 0.006)
    assert surface.height.shape == scan.shape
    assert np.isfinite(surface.height).all()
    assert np.percentile(surface.height, 5) == pytest.approx(-HEIGHT, abs=0.002)
    x = np.arange(0, 9.3, 0.004)
    tiled = relief.height_map_of_profile(x, ridge(x - 0.21) + 0.002 * x, (5, 3000), 0.01)
    row = tiled.height[2]
    assert tiled.pitch == 0.01
    # 30 mm from a profile of 9.3 mm: the ridges go on at their pitch, without a step at the seams.
    spectrum = np.abs(np.fft.rfft(row - row.mean()))
    assert np.argmax(spectrum) == pytest.approx(30 / PITCH, abs=1)
    assert np.abs(np.diff(row)).max() < 1.1 * HEIGHT / FLANK * 0.01


def test_a_measured_profile_goes_straight_into_the_half_space_solver():
    from evanesce.contact.halfspace.solver import press_height_map

    x = np.arange(0, 9.3, 0.004)
    tiled = relief.height_map_of_profile(x, ridge(x - 0.21) + 0.002 * x, (8, 856), PITCH / 107)
    light = press_height_map(tiled.distance, tiled.pitch, 0.3, 1e-5, periodic=True)
    touched = light.pressure > 0
    assert light.pressure.sum() * tiled.pitch**2 == pytest.approx(1e-5, rel=1e-6)
    assert np.all(tiled.distance[touched] < 0.1 * HEIGHT)  # crests touch, furrows do not


def test_maps_from_files(tmp_path, scan):
    import OpenEXR
    from PIL import Image

    um = np.ascontiguousarray(1e3 * scan, dtype=np.float32)
    Image.fromarray(um).save(tmp_path / "scan.tif")
    np.savetxt(tmp_path / "scan.csv", um, delimiter=",", fmt="%.6g")
    with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"height": um}) as file:
        file.write(str(tmp_path / "scan.exr"))
    for name in ("scan.tif", "scan.csv", "scan.exr"):
        read = surface_files.read_map(tmp_path / name, 0.006, "um")
        np.testing.assert_allclose(read.height, scan, rtol=2e-5, atol=1e-9)


def test_bad_surfaces(tmp_path, scan):
    with pytest.raises(InputError, match="pitch"):
        surface_files.read_map(tmp_path / "x.tif", 0.0, "um")
    with pytest.raises(InputError, match="no such file"):
        surface_files.read_map(tmp_path / "x.tif", 0.1, "um")
    text = tmp_path / "fake.tif"
    text.write_text("not a picture")
    with pytest.raises(InputError, match="not a readable TIFF"):
        surface_files.read_map(text, 0.1, "um")
    text.rename(tmp_path / "fake.exr")
    with pytest.raises(InputError, match="not a readable OpenEXR"):
        surface_files.read_map(tmp_path / "fake.exr", 0.1, "um")
    np.savetxt(tmp_path / "big.csv", scan[:40, :40] * 1e3, delimiter=",")
    with pytest.raises(InputError, match="unit and pitch"):
        surface_files.read_map(tmp_path / "big.csv", 0.006, "mm")
    ragged = tmp_path / "ragged.csv"
    ragged.write_text("1,2,3\n1,2\n")
    with pytest.raises(InputError, match="row 2 has 2 columns"):
        surface_files.read_map(ragged, 0.006, "um")
    with pytest.raises(WorkError, match="no whole ridge"):
        profile.analyse_profile(np.linspace(0, 1, 100), np.linspace(0, 1, 100) ** 2)
    with pytest.raises(WorkError, match="at least half"):
        profile.analyse_map(np.full((50, 50), np.nan), 0.01)
