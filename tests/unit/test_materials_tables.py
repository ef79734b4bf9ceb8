"""Materials: the tables are those of the thesis, and nothing unknown or out of range gets in."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from evanesce.core.errors import InputError
from evanesce.materials import material, material_names
from evanesce.materials.tables import TABLES, read_tables

REFERENCE = Path(__file__).resolve().parents[3] / "shared" / "reference" / "thesis.toml"


@pytest.fixture(scope="module")
def thesis() -> dict:
    if not REFERENCE.is_file():
        pytest.skip(f"the published figures are not here: {REFERENCE} does not exist")
    return tomllib.loads(REFERENCE.read_text(encoding="utf-8"))


def test_every_silicone_figure_of_the_thesis_is_in_the_tables(thesis: dict) -> None:
    published = thesis["materials"]
    sweep = published["youngs_modulus_MPa"]
    for rubber, key in (("silastic", "silastic_3481"), ("silskin", "silskin_10")):
        for percent, modulus in zip(sweep["deadener_percent"], sweep[key], strict=True):
            assert material(f"{rubber}_{percent}").youngs_modulus_MPa == modulus
    for name in ("silskin_0", "silskin_20"):
        ours = material(name)
        assert ours.poisson_ratio == published["dma"]["poisson_ratio"]
        for key, value in published["mooney_rivlin_3_Pa"][name].items():
            assert getattr(ours.mooney_rivlin, f"{key}_Pa") == value
        dma = published["dma"]
        assert list(ours.dma.storage_modulus_MPa) == dma[f"{name}_storage_MPa"]
        assert list(ours.dma.loss_factor) == dma[f"{name}_loss_factor"]
        assert ours.dma.rise_1_to_80_hz == dma[f"{name}_rise_1_to_80_Hz"]
        assert ours.dma.drop_0_to_50_C_at_80_hz == dma[f"{name}_drop_0_to_50_C_at_80_Hz"]
        flat = thesis["contact"]["hertz"][f"{name}_reduced_modulus_MPa"]
        bench = thesis["stiffness"][f"{name}_reduced_modulus_MPa"]
        for law, line in ((ours.flat_reduced_modulus, flat), (ours.indenter_reduced_modulus, bench)):
            assert (law.intercept_MPa, law.slope_MPa_per_N) == (line["intercept"], line["slope_per_N"])
        rheology = thesis["friction"]["interfacial_rheology"][name]
        assert (ours.friction.tau0_MPa, ours.friction.alpha) == (rheology["tau0_MPa"], rheology["alpha"])
        static = thesis["friction"]["static_coefficient_1N_1mm_s"]
        assert ours.friction.static_coefficient_smooth == static[f"{name}_smooth"]
        assert ours.friction.static_coefficient_ridged == static.get(f"{name}_ridged")
    soft, hard = material("silskin_20"), material("silskin_0")
    assert soft.hertz_area_scale.value == thesis["contact"]["hertz"]["silskin_20_area_scale"]
    assert soft.fe_area_scale.value == thesis["contact"]["fe"]["silskin_20_area_scale"]
    assert hard.area_deviation.value == thesis["contact"]["hertz"]["silskin_0_area_deviation_at_5N"]
    laws = thesis["contact"]["silskin_20_measured_area_mm2"]
    below, above = laws["below_2N"], laws["above_2N"]
    assert soft.measured_area.area(1.3) == pytest.approx(below["scale"] * 1.3 ** below["exponent"], rel=1e-14)
    assert soft.measured_area.area(3.7) == pytest.approx(above["scale"] * 3.7 ** above["exponent"], rel=1e-14)


def test_the_two_measured_power_laws_meet_at_their_break() -> None:
    law = material("silskin_20").measured_area
    low, high = law.area(np.nextafter(law.break_N, 0)), law.area(law.break_N)
    # two separate fits to scattered points: as printed they differ by 1.5 % where they meet
    assert low == pytest.approx(high, rel=0.02)


def test_small_strain_moduli_of_the_hyperelastic_fit() -> None:
    # Uniaxial tension of the printed energy, differentiated numerically: dW/d(lambda) / (lambda - 1) -> E.
    for name in ("silskin_0", "silskin_20"):
        fit = material(name).mooney_rivlin

        def energy(stretch: float, fit=fit) -> float:
            i1, i2 = stretch**2 + 2 / stretch, 2 * stretch + 1 / stretch**2
            return 1e-6 * (fit.C10_Pa * (i1 - 3) + fit.C01_Pa * (i2 - 3) + fit.C11_Pa * (i1 - 3) * (i2 - 3))

        h = 1e-3
        modulus = (energy(1 + h) - 2 * energy(1) + energy(1 - h)) / h**2
        # second difference: truncation h^2/12 W'''' , with W''''/W'' up to about 1e3 for the stiffening material
        assert fit.youngs_modulus_MPa == pytest.approx(modulus, rel=1e-3)


def test_a_silicone_without_a_press_test_falls_back_on_plane_strain() -> None:
    other = material("silastic_30")
    assert other.mooney_rivlin is None
    assert other.reduced_modulus(3.0) == pytest.approx(0.243 / (1 - 0.49**2), rel=1e-14)
    assert "table 3" in other.flat_reduced_modulus.source


def test_an_unknown_material_names_the_known_ones() -> None:
    with pytest.raises(InputError) as caught:
        material("silskin_25")
    assert all(name in str(caught.value) for name in material_names())
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("alpha = 0.2324", "alpha = nan", "silskin_0.friction.alpha"),
        ("alpha = 0.2324", "alpha = -1.0", "silskin_0.friction.alpha"),
        ("alpha = 0.2324", "alfa = 0.2324", "alfa"),
        ("alpha = 0.2324", "", "silskin_0.friction.alpha"),
        ("[0.345, 0.298,", "[0.345,", "differ in length"),
        ("C10_Pa = 3693.2", "C10_Pa = ", "not a readable table"),
    ],
)
def test_a_damaged_table_is_refused_by_key(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = TABLES.read_text(encoding="utf-8")
    assert old in text
    bad = tmp_path / "bad.toml"
    bad.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(InputError, match=said):
        read_tables(bad)
