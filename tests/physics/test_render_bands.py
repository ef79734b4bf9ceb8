"""White light in bands: weights, indices against tables, exact null, and sums of what each band shows alone."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.core.states import PlateLight
from evanesce.optics.spectrum import BAND_NM, Band, luminous_efficiency, pdms_index, white_bands, white_led_power
from evanesce.optics.subsurface import absorption_coefficient
from evanesce.render.bands import banded, in_band
from evanesce.render.reference.path import render
from support.rigs import hard_contact, need, small_rig, view_around


@pytest.mark.parametrize("count", [1, 3, 14])
def test_bands_keep_weight_and_mean_wavelength(count):
    bands = white_bands(count)
    assert sum(b.weight for b in bands) == pytest.approx(1.0, abs=1e-12)
    weight = white_led_power() * luminous_efficiency(BAND_NM)
    mean = float((weight * BAND_NM).sum() / weight.sum())
    # 20 nm steps against 1 nm steps of the same density
    assert sum(b.weight * b.wavelength for b in bands) == pytest.approx(mean, abs=1.0)
    assert all(a.wavelength < b.wavelength for a, b in itertools.pairwise(bands))
    with pytest.raises(ValueError, match="bands"):
        white_bands(0)


def test_pdms_is_within_what_is_published():
    """Schneider et al. as refractiveindex.info tabulates their fit, and their second PDMS, RTV 615, within 0.002."""
    np.testing.assert_allclose(pdms_index([450.0, 530.0, 635.0]), [1.4421, 1.4349, 1.4295], atol=5.1e-5)
    um2 = np.array([0.4, 0.55, 0.7]) ** 2
    np.testing.assert_allclose(
        pdms_index([400.0, 550.0, 700.0]), np.sqrt(1 + 1.0057 * um2 / (um2 - 0.013217)), atol=2e-3
    )
    # Abbe number of PDMS: about 50; (n_d - 1)/(n_F - n_C)
    abbe = (float(pdms_index(587.6)) - 1) / (float(pdms_index(486.1)) - float(pdms_index(656.3)))
    assert 40 < abbe < 65


def test_one_band_is_the_renderer_itself():
    assert banded(render, 1) is render


def test_without_dispersion_white_light_is_that_of_one_wavelength():
    """A renderer that does not look at the scene: weights sum to 1, variances add in squares."""

    def flat(scene, state, *, seed, view):
        return PlateLight(
            radiance=np.full(view.shape, 2.0), variance=np.full(view.shape, 0.1), focal_px=view.focal_px,
            principal_point=view.principal_point, samples=8,
        )  # fmt: skip

    light = banded(flat, 4)(small_rig(), None, seed=3)
    np.testing.assert_allclose(light.radiance, 2.0, rtol=1e-12)
    np.testing.assert_allclose(light.variance, 0.1 / 4, rtol=1e-12)
    assert light.samples == 32


def test_each_band_sees_its_own_rig_and_seed():
    seen = []

    def record(scene, state, *, seed, view):
        seen.append((scene.camera.wavelength_nm, scene.plate.refractive_index, scene.finger.refractive_index, seed))
        radiance = np.full(view.shape, scene.plate.refractive_index)
        return PlateLight(radiance=radiance, variance=0 * radiance, focal_px=1.0, principal_point=(0.0, 0.0))

    scene = small_rig()
    light = banded(record, 3)(scene, None, seed=7)
    waves, glass, silicone, seeds = zip(*seen, strict=True)
    assert list(waves) == sorted(waves)
    assert list(glass) == sorted(glass, reverse=True)  # blue is bent more
    assert list(silicone) == sorted(silicone, reverse=True)
    assert glass[0] > scene.plate.refractive_index > glass[-1]
    assert seeds == (7, 8, 9)
    np.testing.assert_allclose(light.radiance, np.mean(glass), rtol=1e-12)


def silicone(**keys):
    """Return the finger at 450 nm of a scene whose wavelength is 600 nm."""
    scene = small_rig(camera__wavelength_nm=600.0, **{f"finger__{k}": v for k, v in keys.items()})
    return in_band(scene, Band(450.0, 1.0)).finger


def test_silicone_that_absorbs_nothing_scatters_by_its_power_of_wavelength():
    found = silicone(diffuse_reflectance=1.0, scattering_length_mm=0.7, scattering_power=1.3)
    assert found.scattering_length_mm == pytest.approx(0.7 * 0.75**1.3, rel=1e-12)
    assert found.diffuse_reflectance == 1.0


def test_reflectance_depends_on_absorption_over_scattering_alone():
    plain = silicone(diffuse_reflectance=0.55, scattering_length_mm=0.7)
    assert (plain.diffuse_reflectance, plain.scattering_length_mm) == (0.55, 0.7)  # to the bit
    both = silicone(diffuse_reflectance=0.55, scattering_length_mm=0.7, scattering_power=2.1, absorption_power=2.1)
    assert both.diffuse_reflectance == pytest.approx(0.55, rel=1e-9)
    assert both.scattering_length_mm == pytest.approx(0.7 * 0.75**2.1, rel=1e-9)
    more = silicone(diffuse_reflectance=0.55, scattering_length_mm=0.7, scattering_power=2.1)
    ratio = absorption_coefficient(0.55, 1.0) / (1 - absorption_coefficient(0.55, 1.0)) * 0.75**2.1
    # Hapke's 1981 equations 41 and 11, written in gamma
    gamma = np.sqrt(ratio / (1 + ratio))
    assert more.diffuse_reflectance == pytest.approx(
        (1 - gamma) / (1 + gamma) * (1 - gamma / 3 / (1 + gamma)), rel=1e-9
    )
    local = silicone(diffuse_reflectance=0.55, scattering_power=2.1)
    assert local.scattering_length_mm == 0.0
    assert local.diffuse_reflectance == pytest.approx(more.diffuse_reflectance, rel=1e-9)


@pytest.mark.slow
def test_traced_bands_add_up():
    need("llvm")
    scene, state = small_rig(), hard_contact()
    blue, red = (in_band(scene, b) for b in (white_bands(5)[0], white_bands(5)[-1]))
    assert blue.plate.refractive_index > scene.plate.refractive_index > red.plate.refractive_index
    assert blue.finger.refractive_index > red.finger.refractive_index
    options = {"view": view_around(scene, (3.3, -2.1), 6, 2.5), "variant": "llvm", "samples_per_pixel": 64}
    white = banded(render, 2)(scene, state, seed=5, **options)
    alone = [render(in_band(scene, b), state, seed=5 + k, **options) for k, b in enumerate(white_bands(2))]
    np.testing.assert_allclose(white.radiance, 0.5 * (alone[0].radiance + alone[1].radiance), rtol=1e-6)


@pytest.mark.parametrize(
    ("option", "value"), [("--bands", "0"), ("--bands", "15"), ("--until-error", "0"), ("--until-error", "1")]
)
def test_bad_options_end_in_one_line(option, value, tmp_path):
    result = CliRunner().invoke(app, ["render", "thesis", option, value, "--out", str(tmp_path / "o")])
    assert result.exit_code == 2
    assert option in result.output
    assert "Traceback" not in result.output
    assert not (tmp_path / "o").exists()
