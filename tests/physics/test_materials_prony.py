"""Prony series, interconversion, fits and shift against Laplace and Fourier identities and known truths; DMA files."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from evanesce.bench import dma
from evanesce.bench.prony_fit import fit_arrhenius, fit_prony
from evanesce.core.errors import InputError
from evanesce.materials.prony import PronySeries, arrhenius_shift, wlf_shift
from evanesce.materials.tables import material

SERIES = PronySeries(0.11, (0.31, 0.07, 0.022), (0.004, 0.09, 2.7))


def test_complex_modulus_is_the_fourier_transform_of_relaxation():
    w = 2 * np.pi * 3.3
    storage = SERIES.equilibrium + w * quad(
        lambda t: SERIES.relaxation(t) - SERIES.equilibrium, 0, 60, weight="sin", wvar=w, limit=400
    )[0]  # fmt: skip
    loss = w * quad(lambda t: SERIES.relaxation(t) - SERIES.equilibrium, 0, 60, weight="cos", wvar=w, limit=400)[0]
    assert SERIES.storage(3.3) == pytest.approx(storage, rel=1e-7)
    assert SERIES.loss_factor(3.3) == pytest.approx(loss / storage, rel=1e-7)


@pytest.mark.parametrize("series", [SERIES, PronySeries(0.0, (0.31, 0.07), (0.004, 0.09)), PronySeries(0.4, (), ())])
def test_creep_and_relaxation_are_laplace_inverses(series):
    creep = series.creep()
    for s in (0.02, 1.3, 400.0):
        carson_e = series.equilibrium + sum(
            m * s / (s + 1 / t) for m, t in zip(series.moduli, series.times, strict=True)
        )
        carson_d = creep.instantaneous + creep.fluidity / s
        carson_d += sum(d / (1 + s * t) for d, t in zip(creep.compliances, creep.times, strict=True))
        assert carson_e * carson_d == pytest.approx(1.0, rel=1e-12)


def test_convolution_of_creep_and_relaxation_is_time():
    creep, t = SERIES.creep(), 1.7
    whole = quad(lambda s: SERIES.relaxation(t - s) * creep.creep(s), 0, t, points=[0.004, t - 0.004], limit=400)[0]
    assert whole == pytest.approx(t, rel=1e-8)


def test_integrals():
    creep = PronySeries(0.0, (0.31, 0.07), (0.004, 0.09)).creep()
    assert SERIES.relaxation_integral(0.8) == pytest.approx(quad(SERIES.relaxation, 0, 0.8, points=[0.01])[0], rel=1e-9)
    assert creep.creep_integral(0.8) == pytest.approx(quad(creep.creep, 0, 0.8, points=[0.01])[0], rel=1e-9)


def test_fit_returns_a_known_series():
    frequency = np.logspace(-1, 3, 60)
    fit = fit_prony(frequency, SERIES.storage(frequency), SERIES.loss_factor(frequency), times=SERIES.times)
    np.testing.assert_allclose(fit.series.moduli, SERIES.moduli, rtol=1e-9)
    assert fit.series.equilibrium == pytest.approx(0.11, rel=1e-9)
    assert max(fit.storage_rms, fit.loss_rms) < 1e-10


def test_fit_with_noise_predicts_within_its_error():
    rng = np.random.default_rng(20260)
    frequency = np.logspace(-1, 3, 80)
    noise = 0.01
    storage = SERIES.storage(frequency) * (1 + noise * rng.normal(size=80))
    loss = SERIES.loss_factor(frequency) * (1 + noise * rng.normal(size=80))
    fit = fit_prony(frequency, storage, loss)
    # E'' = E' tan(delta) carries both noises; residuals are those and the ripple of three terms a decade (1 %).
    assert fit.storage_rms < 1.2 * noise + 0.01
    assert fit.storage_rms > 0.5 * noise
    assert fit.loss_rms < 1.5 * noise + 0.02
    np.testing.assert_allclose(fit.series.storage(frequency), SERIES.storage(frequency), rtol=0.03)


def test_shift_moves_the_curve_along_frequency():
    np.testing.assert_allclose(SERIES.shifted(7.0).storage(3.0), SERIES.storage(21.0))


def test_wlf_and_arrhenius():
    # Ferry's universal constants: 17.44 decades at T_g - far above; at T_ref the shift is nil.
    assert wlf_shift(25.0, 25.0, 17.44, 51.6) == 0.0
    assert wlf_shift(76.6, 25.0, 17.44, 51.6) == pytest.approx(-8.72)
    with pytest.raises(ValueError, match="diverges"):
        wlf_shift(-30.0, 25.0, 17.44, 51.6)
    # 50 kJ/mol from 20 to 30 degC is a factor of exp(-50000/8.314 (1/293.15 - 1/303.15)) = 0.5082.
    assert 10 ** arrhenius_shift(30.0, 20.0, 50.0) == pytest.approx(0.5082, rel=2e-4)


def test_activation_energy_of_a_shifted_sweep_is_recovered():
    rng = np.random.default_rng(77)
    f, t = (a.ravel() for a in np.meshgrid(np.logspace(0, 2, 15), [2.0, 18.0, 31.0, 47.0]))
    broad = PronySeries(0.1, tuple(0.03 for _ in range(9)), tuple(np.logspace(-5, 3, 9)))
    storage = broad.storage(f * 10 ** arrhenius_shift(t, 20.0, 63.0)) * (1 + 0.002 * rng.normal(size=len(f)))
    master = fit_arrhenius(f, t, storage, 20.0)
    assert abs(master.activation_energy_kJ_per_mol - 63.0) < 3.5 * master.activation_energy_se
    assert master.activation_energy_se < 3.0
    with pytest.raises(ValueError, match="two temperatures"):
        fit_arrhenius(f, np.full_like(f, 20.0), storage, 20.0)


@pytest.mark.parametrize("name", ["silskin_0", "silskin_20"])
def test_thesis_ranges_are_met(name):
    published = material(name).dma
    sweeps = [dma.from_range(published, t) for t in (0.0, 20.0, 50.0)]
    storage = np.concatenate([s.storage for s in sweeps])
    assert (storage.min(), storage.max()) == pytest.approx(published.storage_modulus_MPa)
    cold, hot = (np.interp(80.0, sweeps[i].frequency, sweeps[i].storage) for i in (0, 2))
    assert 1 - hot / cold == pytest.approx(published.drop_0_to_50_C_at_80_hz)
    assert cold / sweeps[0].storage[0] - 1 > published.rise_1_to_80_hz  # printed as "over"
    # Causality: the mean loss factor and the slope of E' belong together, (pi/2) d ln E'/d ln w.
    assert dma.loss_from_slope(sweeps[1]).mean() == pytest.approx(sweeps[1].loss_factor.mean(), rel=0.4)
    series = dma.prony_of(name)
    # No positive spectrum has exactly the printed rise together with the printed loss: 5 % and 16 % at the worst end.
    np.testing.assert_allclose(series.storage(sweeps[1].frequency), sweeps[1].storage, rtol=0.17)


def test_material_without_dynamic_data():
    with pytest.raises(InputError, match="no dynamic data"):
        dma.prony_of("silskin_10")
    with pytest.raises(ValueError, match="outside the published"):
        dma.from_range(material("silskin_0").dma, 60.0)


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def test_dma_file_units_and_spellings(tmp_path):
    one = dma.read_dma(
        write(tmp_path / "a.csv", "Frequency [Hz];Storage modulus [kPa];Tan Delta\n1;600;0.1\n10;700;0.12\n")
    )
    two = dma.read_dma(
        write(
            tmp_path / "b.csv",
            "# a rheometer's export\nfreq_rad/s,temp_K,storage_Pa,loss_modulus_Pa\n"
            f"{2 * np.pi},293.15,600000,60000\n{20 * np.pi},293.15,700000,84000\n",
        )
    )
    np.testing.assert_allclose(one.storage, [0.6, 0.7])
    for field in ("frequency", "storage", "loss_factor", "temperature"):
        np.testing.assert_allclose(getattr(one, field), getattr(two, field))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frequency_Hz,storage_modulus,loss_factor\n1,1,0.1\n2,1,0.1\n", "has no unit"),
        ("frequency_Hz,storage_modulus_psi,loss_factor\n1,1,0.1\n", "no column 'storage_modulus'"),
        ("frequency_Hz,storage modulus [psi],loss_factor\n1,1,0.1\n", "unit 'psi'"),
        ("frequency_Hz,storage_modulus_MPa\n1,1\n2,1\n", "loss_factor"),
        ("frequency_Hz,storage_modulus_GPa,loss_factor\n1,600,0.1\n2,600,0.1\n", "row 2: 600000 MPa is implausible"),
        ("frequency_Hz,storage_modulus_MPa,loss_factor\n1,0.6,0.1\n2,nan,0.1\n", "row 3: 'nan' is not finite"),
        ("frequency_Hz,storage_modulus_MPa,loss_factor\n1,x,0.1\n", "row 2: 'x' is not a number"),
        ("frequency_Hz,storage_modulus_MPa,loss_factor\n1,0.6\n", "row 2 has 2 columns"),
        ("frequency_Hz,storage_modulus_MPa,loss_factor\n", "no rows"),
        ("", "holds no data"),
        ("frequency_Hz,storage_modulus_MPa,loss_factor\n-1,0.6,0.1\n2,0.6,0.1\n", "frequency: row 2"),
        ("frequency_Hz,freq_Hz,storage_modulus_MPa,loss_factor\n1,1,0.6,0.1\n", "occurs 2 times"),
    ],
)
def test_bad_dma_files_name_what_is_wrong(tmp_path, text, message):
    path = write(tmp_path / "bad.csv", text)
    with pytest.raises(InputError, match=message) as caught:
        dma.read_dma(path)
    assert "bad.csv" in str(caught.value)


def test_bad_series_and_fits():
    with pytest.raises(ValueError, match="ascend"):
        PronySeries(0.1, (1.0, 1.0), (2.0, 1.0))
    with pytest.raises(ValueError, match="positive"):
        PronySeries(0.1, (-1.0,), (2.0,))
    with pytest.raises(ValueError, match="at least 2"):
        fit_prony([1.0], [1.0], [0.1])
    with pytest.raises(ValueError, match="positive and finite"):
        fit_prony([1.0, 2.0], [1.0, np.nan], [0.1, 0.1])
