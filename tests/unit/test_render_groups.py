"""LED groups separated by the same paths, passes until an error, polished edges and parted LEDs of the path tracer."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from evanesce.core.errors import InputError
from evanesce.optics.edge_rays import EdgeLight
from evanesce.optics.emitters import led_table
from evanesce.optics.guide import contact_radiance, guided_irradiance
from evanesce.optics.guided_field import azimuthal_radiance
from evanesce.optics.interface import fresnel_reflectance, frustrated_transmittance
from evanesce.optics.led import led_positions, led_powers, led_radiances
from evanesce.render.reference.led_groups import LedGroups
from evanesce.render.reference.passes import Until, Welford, average, relative_error
from evanesce.render.reference.path import render, render_groups
from support.rigs import hard_contact, need, small_rig, view_around

CENTRE = (3.3, -2.1)


def options_for(scene, pixels=12, scale=3.0, **more):
    return {
        "variant": "llvm", "view": view_around(scene, CENTRE, pixels, scale), "passes": 4, "focus": False, **more
    }  # fmt: skip


# --- groups ---------------------------------------------------------------------------------------------------------


def uneven(scene) -> LedGroups:
    """Return three groups: the left edge; the even LEDs of the top edge and all of the right one; the rest."""
    whole = LedGroups.of(scene)
    top = ["near" if k % 2 == 0 else "odd" for k in range(whole.numbers["top"].size)]
    return LedGroups.of(scene, {"left": "left", "top": top, "right": "near"})


def test_groups_add_up_to_the_rendering_with_the_same_seed():
    """Same seed, same paths: the sum is the ungrouped radiance but for float32's rounding of the sum."""
    need("llvm")
    scene, state = small_rig(), hard_contact()
    options = options_for(scene, samples_per_pixel=64, seed=11)
    together, apart = render(scene, state, **options), render_groups(scene, state, uneven(scene), **options)
    assert list(apart) == ["left", "near", "odd"]
    total = sum(light.radiance for light in apart.values())
    np.testing.assert_allclose(total, together.radiance, rtol=2e-5, atol=1e-6 * together.radiance.max())
    assert min(light.radiance.max() for light in apart.values()) > 0.02 * together.radiance.max()


def test_each_group_is_what_it_is_alone():
    """Each group against its own rendering by other paths: z-test of the sum, Sidak bound over three groups."""
    need("llvm")
    scene, state = small_rig(), hard_contact()
    groups, powers = uneven(scene), {"left": 0.02, "top": 0.013, "right": 0.008}
    options = options_for(scene, samples_per_pixel=1024, powers=powers)
    apart = render_groups(scene, state, groups, seed=2, **options)
    bound = norm.ppf(1 - (1 - (1 - 1e-4) ** (1 / 3)) / 2)
    for k, name in enumerate(groups.names):
        lit = {edge: np.where(numbers == k, powers[edge], 0.0) for edge, numbers in groups.numbers.items()}
        alone = render(scene, state, **options | {"powers": lit, "seed": 5 + k})
        # Pixels are independent, so that the variance of the sum is the sum of the variances.
        spread = np.sqrt(apart[name].variance.sum() + alone.variance.sum())
        assert spread < 0.03 * alone.radiance.sum()
        assert abs(apart[name].radiance.sum() - alone.radiance.sum()) < bound * spread


def test_groups_follow_the_light_that_paths_find_by_themselves():
    """Without connections every LED is met by chance: the same groups, from the emitters' own numbers."""
    need("llvm")
    scene, state = small_rig(), hard_contact()
    options = options_for(scene, pixels=6, samples_per_pixel=2048, seed=3)
    joined = render_groups(scene, state, **options)
    found = render_groups(scene, state, connect=False, **options)
    for edge in ("left", "top", "right"):
        spread = np.sqrt(joined[edge].variance.sum() + found[edge].variance.sum())
        assert spread < 0.08 * joined[edge].radiance.sum()
        assert abs(joined[edge].radiance.sum() - found[edge].radiance.sum()) < 4.5 * spread


def test_groups_of_a_scalar_variant_are_rendered_one_by_one():
    need("scalar")
    scene, state = small_rig(), hard_contact()
    options = options_for(scene, pixels=6, samples_per_pixel=32) | {"variant": "scalar"}
    apart = render_groups(scene, state, **options)
    assert apart["top"].radiance.tobytes() == render(scene, state, leds="top", **options).radiance.tobytes()


@pytest.mark.parametrize(
    ("membership", "named"),
    [({"left": "a", "top": "a"}, "the lit edges"), ({"left": "a", "top": ["a"], "right": "b"}, "led groups, top")],
)
def test_groups_that_do_not_fit_are_refused(membership, named):
    with pytest.raises(InputError, match=named):
        LedGroups.of(small_rig(), membership)


# --- passes ---------------------------------------------------------------------------------------------------------


def test_passes_stop_when_the_error_is_reached():
    """Normal noise of 30 % a pass: an error of 5 % takes (0.3/0.05)^2 = 36 passes, but for the variance's scatter."""
    rng = np.random.default_rng(4)
    until = Until(4, 0.05, 1000)
    sums = average(lambda k: 2.0 * (1 + 0.3 * rng.standard_normal((60, 50, 1))), (60, 50, 1), until)
    # The variance of 3000 pixels by 36 passes is known to sqrt(2/(3000 x 35)) = 0.4 %: one pass either way.
    assert abs(sums.count - 36) <= 1
    noise = np.sqrt(sums.variance_of_mean.mean())
    assert noise <= 0.05 * 2.0 * 1.01
    assert np.abs(sums.mean - 2.0).mean() / 2.0 == pytest.approx(0.05 * np.sqrt(2 / np.pi), rel=0.1)


def test_passes_stop_at_their_limit_and_in_darkness():
    rng = np.random.default_rng(5)
    noisy = average(lambda k: rng.standard_normal((9, 9, 1)) + 0.1, (9, 9, 1), Until(2, 1e-3, 17))
    assert noisy.count == 17
    assert average(lambda k: np.zeros((9, 9, 1)), (9, 9, 1), Until(3, 1e-3, 17)).count == 3


def test_the_worst_channel_decides():
    rng = np.random.default_rng(6)
    shape, until = (40, 40, 2), Until(2, 0.1, 500)
    sums = average(lambda k: 1 + np.array([0.01, 0.5]) * rng.standard_normal(shape), shape, until)
    assert abs(sums.count - 25) <= 2


def test_a_rendering_to_an_error_is_the_rendering_with_that_many_passes():
    """Going on costs nothing: what stops at n passes is, bit for bit, what n passes make."""
    need("llvm")
    scene, state = small_rig(), hard_contact()
    options = options_for(scene, pixels=10)
    until = render(scene, state, samples_per_pixel=32, until_error=0.09, **options)
    count = until.samples // 8
    assert count > 4
    assert relative_error(until) <= 0.09
    fixed = render(scene, state, samples_per_pixel=8 * count, **options | {"passes": count})
    assert fixed.radiance.tobytes() == until.radiance.tobytes()
    before = render(scene, state, samples_per_pixel=8 * (count - 1), **options | {"passes": count - 1})
    assert relative_error(before) > 0.09


def test_the_error_holds_over_window_and_rest():
    need("llvm")
    scene, state = small_rig(), hard_contact(radius=1.2)
    options = {"variant": "llvm", "samples_per_pixel": 8, "passes": 2, "seed": 8}
    ticks = []
    light = render(scene, state, until_error=0.4, progress=lambda *at: ticks.append(at), **options)
    # Some 100 lit pixels of this error: the level that it is relative to is itself known to 4 %; 3 of them.
    assert relative_error(light) <= 0.4 * 1.12
    assert relative_error(render(scene, state, **options)) > 0.45
    assert ticks[-1][0] == ticks[-1][1] == len(ticks)


def test_relative_error_takes_the_noise_off_the_level():
    need("llvm")
    scene, state = small_rig(), hard_contact()
    options = options_for(scene, pixels=10)
    runs = [render(scene, state, samples_per_pixel=16, seed=k, **options) for k in range(8)]
    stated = np.array([relative_error(light) for light in runs])
    best = render(scene, state, samples_per_pixel=4096, seed=99, **options).radiance
    true = np.sqrt(np.mean([np.mean((light.radiance - best) ** 2) for light in runs]) / np.mean(best**2))
    # 8 runs of 4 passes, some 60 lit pixels with heavy tails: 10 % at 1 sigma
    assert stated.mean() == pytest.approx(true, rel=0.35)
    assert Welford((2, 2)).variance_of_mean.max() == np.inf


@pytest.mark.parametrize("wrong", [{"until_error": 0.0}, {"until_error": 1.5}, {"until_error": 0.1, "max_passes": 1}])
def test_bad_stops_are_input_errors(wrong):
    with pytest.raises(InputError):
        render(small_rig(), None, **wrong)


# --- edges and LEDs -------------------------------------------------------------------------------------------------


def small_disc(radius=0.4):
    return hard_contact(radius=radius, notch=False, side=3.2 * radius, samples=64)


def seen(scene, samples, pixels=5, scale=10.0, **more):
    """Return the radiance at the middle of a small contact and its standard error."""
    options = options_for(scene, pixels, scale, samples_per_pixel=samples, seed=21, **more) | {"passes": 8}
    light = render(scene, small_disc(), **options)
    return light.radiance.mean(), np.sqrt(light.variance.sum()) / light.variance.size


@pytest.mark.parametrize("connect", [True, False])
def test_parted_leds_shine_as_the_image_sum_says(connect):
    """Black edges, 70 % of each face behind an air film: the sum over mirror images with Fresnel's transmission."""
    need("llvm")
    share, n = 0.7, 1.523
    scene = small_rig(plate__edge_reflectance=0.0, leds__air_gap_share=share)

    def entering(cosine):
        return 1 - share + share * n**2 * (1 - fresnel_reflectance(np.clip(cosine, 0.0, 1.0), n, 1.0))

    leds = led_table(scene.plate, scene.leds, led_powers(scene.leds))
    optics = (5.0, n, 1.41, 0.6, scene.camera.wavelength_nm, 0.002)
    expected = contact_radiance(*CENTRE, leds, *optics, entering=entering, nodes=32)
    touching = contact_radiance(*CENTRE, leds, *optics, nodes=32)
    found, error = seen(scene, 2048 if connect else 8192, connect=connect)
    assert error < (0.006 if connect else 0.03) * expected
    assert abs(expected / touching - 1) > 0.05
    # 0.5 %: the quadrature's cuts at the critical angles, and what the contact itself sends back
    assert found == pytest.approx(expected, abs=4.5 * error + 0.005 * expected)


def test_parting_keeps_power():
    """Fresnel's transmission times n^2, over the hemisphere inside: the power that leaves air, less its reflection."""
    cosine = (np.arange(200_000) + 0.5) / 200_000
    n = 1.523
    inside = 2 * np.mean(cosine * n**2 * (1 - fresnel_reflectance(cosine, n, 1.0)))
    outside = 2 * np.mean(cosine * (1 - fresnel_reflectance(cosine, 1.0, n)))
    assert inside == pytest.approx(outside, rel=1e-5)


@pytest.mark.parametrize("polish", [0.4, pytest.param(1.0, marks=pytest.mark.slow)])
def test_polished_edges_mirror_as_straight_rays_do(polish):
    """Ground share black: radiance followed as straight lines over mirroring edges, no path sampled (edge_rays)."""
    need("llvm")
    scene = small_rig(plate__edge_reflectance=0.0, plate__edge_polish=polish)
    plate, leds = scene.plate, scene.leds
    light = EdgeLight(
        plate.size_mm, 5.0, 1.523, 0.002, 0.0, led_positions(plate, leds), led_radiances(plate, leds),
        (leds.emitting_width_mm, leds.emitting_height_mm), edge_polish=polish,
    )  # fmt: skip
    u, w = np.polynomial.legendre.leggauss(60)
    low = np.arcsin(1 / 1.523)
    theta, weight = low + (np.pi / 2 - low) * (u + 1) / 2, w * (np.pi / 2 - low) / 2
    radiance = azimuthal_radiance(light, [CENTRE[0]], [CENTRE[1]], theta, azimuths=720, diffuse=np.zeros((4, 4)))[0]
    through = frustrated_transmittance(np.cos(theta), 0.0, scene.camera.wavelength_nm, 1.523, 1.41)
    irradiance = float(np.sum(2 * np.pi * weight * np.cos(theta) * np.sin(theta) * through * radiance))
    bare = small_rig(plate__edge_reflectance=0.0)
    one = contact_radiance(
        *CENTRE, table := led_table(plate, leds, led_powers(leds)), 5.0, 1.523, 1.41, 0.6, 550.0, 0.002, nodes=24
    )
    direct = guided_irradiance(
        *CENTRE, table, 5.0, 1.523, 0.002, lambda c: frustrated_transmittance(c, 0.0, 550.0, 1.523, 1.41), nodes=24
    )
    expected = one * irradiance / direct
    found, error = seen(scene, 8192)
    plain, _ = seen(bare, 1024)
    assert found > 1.1 * plain
    assert error < 0.012 * expected
    # 1 %: angles and azimuths of the straight lines, and what the contact sends back
    assert found == pytest.approx(expected, abs=4.5 * error + 0.01 * expected)


def test_scalar_variants_refuse_what_they_do_not_model():
    need("scalar")
    for change in ({"plate__edge_polish": 0.2}, {"leds__air_gap_share": 0.2}):
        with pytest.raises(InputError, match="scalar variants"):
            render(small_rig(**change), None, variant="scalar", samples_per_pixel=2, passes=2)
