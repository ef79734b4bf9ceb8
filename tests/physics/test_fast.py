"""The fast camera: both backends alike, nothing ignored without notice, and the noise of the camera's figures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from evanesce.chain.fast import FastCamera
from evanesce.chain.simulate import expose, simulate
from evanesce.contact.solve import contact_state
from evanesce.render.fast.operators_llvm import expose_llvm, llvm_works
from evanesce.render.fast.operators_numpy import expose_numpy, pixel_bits
from evanesce.render.fast.readout import ChargeBox, Readout, dark_steps, normal_table
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, load_scene
from evanesce.sensor.expose import signal_of
from evanesce.sensor.tone import develop

CAMERA = {
    "camera.resolution_px": [333, 250],
    "camera.scale_px_per_mm": 9.7,
    "camera.pixel.pitch_um": 18.6,
    "camera.centre_mm": [0.7, -0.4],
    "camera.tilt_x_deg": 2.0,
    "camera.pixel.full_well_capacity_e": 295_000.0,
    "camera.pixel.conversion_gain_e_per_DN": 76.7,
    "camera.pixel.read_noise_e": 40.0,
    "finger.position_mm": [1.3, -0.8],
    "grid.samples": 512,
}


def scene_of(name: str = "thesis", **changes: object) -> Scene:
    return load_scene(name, CAMERA | changes)


def readout(tone: np.ndarray | None = None, **changes: float) -> Readout:
    values = {"dark_e": 0.0, "full_well_e": 8180.0, "read_noise_e": 3.3, "gain": 1 / 2.13, "black_DN": 256.0}
    if tone is None:
        tone = develop(np.arange(4096, dtype=np.uint16), black_level_DN=256.0, bits=12, curve="bt709")
    return Readout(shape=(83, 127), tone=tone, **(values | changes))


def keys(count: int, seed: int = 1) -> list[tuple[int, int]]:
    """Return keys as a run draws them: one pair of 32-bit words a frame."""
    words = np.random.SeedSequence(seed).generate_state(2 * count)
    return [(int(a), int(b)) for a, b in words.reshape(count, 2)]


def box(level: float, rows: int = 41, cols: int = 59) -> ChargeBox:
    """Return light on a part of the frame, uneven from side to side."""
    return ChargeBox(7, 31, (level * np.linspace(0.2, 1.0, cols) * np.ones((rows, 1))).astype(np.float32))


# --- noise -----------------------------------------------------------------------------------------------------------


def test_table_of_normals_is_normal() -> None:
    table = normal_table().astype(float)
    assert table.mean() == pytest.approx(0.0, abs=1e-6)
    assert np.mean(table**2) == pytest.approx(1.0, abs=1e-6)
    # 2^16 equal shares cut the tails: their fourth moment lacks less than 2^-16 times z^4 at the outermost share
    assert np.mean(table**4) == pytest.approx(3.0, abs=2**-16 * 4.3**4)


def test_random_words_are_even_and_independent_of_neighbours_and_frames() -> None:
    bits = pixel_bits(1000, 1 << 18, (12345, 678))
    for shift in (0, 8, 16, 24):
        counts = np.bincount((bits >> np.uint32(shift)) & np.uint32(255), minlength=256)
        assert stats.chisquare(counts).pvalue > 1e-4
    other = pixel_bits(1000, 1 << 18, (12345, 679))
    upper, lower = (bits >> np.uint32(16)).astype(float), (bits & np.uint32(0xFFFF)).astype(float)
    limit = 4.5 / np.sqrt(bits.size)
    pairs = ((upper, lower), (upper[1:], upper[:-1]), (upper, (other >> np.uint32(16)).astype(float)))
    for a, b in (*pairs, (lower[2000:], lower[:-2000])):
        assert abs(np.corrcoef(a, b)[0, 1]) < limit
    # A word depends on its pixel's number alone, not on where a block of rows begins.
    assert (pixel_bits(5000, 100, (12345, 678)) == bits[4000:4100]).all()


def test_photon_transfer_returns_gain_and_read_noise() -> None:
    """Variance over mean of raw numbers is a line: slope 1/gain of the converter, offset read noise and rounding."""
    camera = readout()
    levels = np.linspace(0.0, 3000.0, 13).astype(np.float32)
    means, variances, counts = [], [], 83 * 127
    for k, level in enumerate(levels):
        even = ChargeBox(0, 0, np.full(camera.shape, level))
        raws = [expose_numpy(even, camera, key, with_raw=True)[1] for key in keys(8, k)]
        values = np.array(raws, float)
        means.append(values.mean() - 256.0)
        variances.append(values.var(ddof=1))
    # Both sides of the line are known to this; the weights are those of the variances' own errors.
    error = np.array(variances) * np.sqrt(2 / (8 * counts))
    slope, offset = np.polyfit(means, variances, 1, w=1 / error)
    design = np.stack([means / error, 1 / error], axis=1)
    slope_error, offset_error = np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    assert slope == pytest.approx(1 / 2.13, abs=4.5 * slope_error)
    assert offset == pytest.approx((3.3 / 2.13) ** 2 + 1 / 12, abs=4.5 * offset_error)
    assert means[-1] == pytest.approx(3000.0 / 2.13, abs=4.5 * np.sqrt(variances[-1] / (8 * counts)))


@pytest.mark.parametrize("level", [0.0, 2.5, 40.0, 900.0])
def test_distribution_is_the_general_chains(level: float) -> None:
    """Raw numbers against Poisson and read noise drawn by numpy: two-sample chi-square over all numbers that occur."""
    scene = load_scene("thesis", {"camera.pixel.read_noise_e": 3.3})
    fast = np.concatenate(
        [
            expose_numpy(ChargeBox(0, 0, np.full((83, 127), level, np.float32)), readout(), key, with_raw=True)[
                1
            ].ravel()
            for key in keys(6)
        ]
    )
    signal = signal_of(np.full(fast.size, level), scene.camera, np.random.default_rng(4))
    slow = np.clip(np.floor(signal + 0.5), 0, 4095).astype(int)
    low = min(int(fast.min()), slow.min())
    a, b = (np.bincount(v - low, minlength=max(int(fast.max()), slow.max()) - low + 1) for v in (fast, slow))
    # Bins with fewer than 40 in both are joined to the rest.
    large = a + b >= 40
    table = np.array([[*a[large], a[~large].sum()], [*b[large], b[~large].sum()]])
    assert stats.chi2_contingency(table[:, table.sum(axis=0) > 0]).pvalue > 1e-4


def test_saturation_is_the_wells() -> None:
    """Only read noise is left, whose mean is known to its deviation over the root of the pixels' number."""
    full = ChargeBox(0, 0, np.full((83, 127), 5e4, np.float32))
    raw = expose_numpy(full, readout(full_well_e=5120.0), keys(1)[0], with_raw=True)[1]
    assert raw is not None
    assert raw.mean() == pytest.approx(5120.0 / 2.13 + 256, abs=4.5 * 1.6 / np.sqrt(raw.size))
    assert raw.std() == pytest.approx(np.hypot(3.3 / 2.13, 1 / np.sqrt(12)), rel=4.5 / np.sqrt(2 * raw.size))


@pytest.mark.parametrize("changes", [{}, {"dark_e": 7.0}, {"read_noise_e": 90.0}, {"black_DN": 16.0}])
def test_dark_staircase_is_what_the_readout_says(changes: dict[str, float]) -> None:
    """The short cut for pixels without light gives the bytes of the long way."""
    camera = readout(**changes)
    dark = ChargeBox(0, 0, np.zeros((0, 0), np.float32))
    short, _ = expose_numpy(dark, camera, (5, 6))
    long, raw = expose_numpy(dark, camera, (5, 6), with_raw=True)
    assert (short == long).all()
    assert raw is not None
    assert (camera.tone[raw] == long).all()
    assert (dark_steps(camera) is None) == (camera.dark_e > 0 or camera.read_noise_e > 50)


# --- two backends ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("changes", [{}, {"dark_e": 7.0}, {"read_noise_e": 90.0}])
@pytest.mark.parametrize("with_raw", [False, True])
def test_backends_expose_alike(changes: dict[str, float], with_raw: bool) -> None:
    """Float32 rounds differently where multiplication and addition are one step: a raw number may be one off."""
    if not llvm_works():
        pytest.skip("Dr.Jit's LLVM backend does not work here")
    camera = readout(**changes)
    for lit in (box(4000.0), box(30.0, 76, 96), ChargeBox(0, 0, np.zeros((0, 0), np.float32)), box(900.0, 1, 1)):
        a, b = (f(lit, camera, (77, 4_000_000_000), with_raw=with_raw) for f in (expose_numpy, expose_llvm))
        assert np.abs(a[0].astype(int) - b[0]).max() <= 1
        assert np.mean(a[0] != b[0]) < 2e-3
        if with_raw:
            assert a[1] is not None
            assert b[1] is not None
            assert np.abs(a[1].astype(int) - b[1]).max() <= 1
            assert np.mean(a[1] != b[1]) < 2e-3


def test_a_camera_without_visible_dark_noise_is_dark_all_over() -> None:
    """Coarse steps of the converter: no dark pixel leaves the black level."""
    if not llvm_works():
        pytest.skip("Dr.Jit's LLVM backend does not work here")
    camera = readout(gain=1 / 40.0)
    for lit in (box(4000.0), ChargeBox(0, 0, np.zeros((0, 0), np.float32))):
        found, _ = expose_llvm(lit, camera, (7, 8))
        assert (found == expose_numpy(lit, camera, (7, 8))[0]).all()
        assert (found.shape, found.dtype) == ((83, 127), np.uint8)
        assert (found[60:] == 0).all()


def test_backends_take_the_same_frames() -> None:
    if not llvm_works():
        pytest.skip("Dr.Jit's LLVM backend does not work here")
    scene = scene_of("thesis_ridged")
    cameras = [FastCamera(scene, backend) for backend in ("numpy", "llvm")]
    for force in (0.3, 5.0):
        state = contact_state(scene, force)
        a, b = (camera.frame(state, seed=3, index=2).data.astype(int) for camera in cameras)
        assert np.abs(a - b).max() <= 1
        assert np.mean(a != b) < 2e-3
        assert a.max() > 60
    assert (cameras[0].frame(None, seed=3).data == cameras[1].frame(None, seed=3).data).all()


# --- against the general chain ---------------------------------------------------------------------------------------


def noiseless(scene: Scene, state: object) -> np.ndarray:
    """Return the mean charge of the general chain behind the fast renderer [e-]."""
    from evanesce.sensor.expose import charge_of
    from evanesce.sensor.lens import form_image

    light = render_fast(scene, state)  # type: ignore[arg-type]
    return charge_of(form_image(light, scene.camera, scene.plate), scene.camera, None)


@pytest.mark.parametrize(("name", "full"), [("thesis", False), ("thesis_ridged", False), ("thesis_ridged", True)])
def test_mean_charge_is_the_general_chains(name: str, full: bool) -> None:
    """By regions to 0.3 %: the same fields and tables, but one table for the film's decay and one remap for two."""
    scene = load_scene(name, {"finger.position_mm": [1.3, -0.8]}) if full else scene_of(name)
    state = contact_state(scene, 3.0)
    lit = FastCamera(scene, "numpy").mean_charge(state)
    found = np.zeros(scene.camera.resolution_px[::-1], np.float64)
    found[lit.row : lit.row + lit.charge.shape[0], lit.col : lit.col + lit.charge.shape[1]] = lit.charge
    expected = noiseless(scene, state)
    assert found.sum() == pytest.approx(expected.sum(), rel=2e-3)
    rows, cols = np.nonzero(expected > 0.3 * expected.max())
    for part in (rows < rows.mean(), rows >= rows.mean(), cols < cols.mean(), cols >= cols.mean()):
        here = rows[part], cols[part]
        assert found[here].mean() == pytest.approx(expected[here].mean(), rel=3e-3)
    # Pixel by pixel where neighbours are alike; on rims the two ways of sampling differ by a part of a pixel.
    assert np.sqrt(np.mean((found - expected)[rows, cols] ** 2)) < 0.03 * expected.max()


EFFECTS = {
    "vignetting": {"k": 0.3},
    "black_level": {"offset_DN": 40.0},
    "led_dead": {"loss": 0.8},
    "specks": {"per_cm2": 60.0},
    "lateral_glow": {"length_mm": 0.7},
    "real_contact": {"rms_slope": 0.4},
    "hot_pixels": {"fraction": 0.002, "rate_e_per_s": 3e6},
}


@pytest.mark.parametrize("effect", EFFECTS)
def test_effects_take_the_general_chain(effect: str) -> None:
    """A frame with an effect is, byte for byte, the one that ``simulate`` takes with the fast renderer."""
    from evanesce.effects import all_effects

    if effect not in all_effects():
        pytest.fail(f"effect {effect} is gone: take another")
    scene = scene_of(effects={effect: EFFECTS[effect]})
    camera = FastCamera(scene, "numpy")
    assert effect in camera.falls_back
    expected = simulate(scene, 2.0, seed=11, index=3, time_s=0.1, render=render_fast)
    found = camera.press(2.0, seed=11, index=3, time_s=0.1)
    assert (found.data == expected.frame.data).all()
    assert found.time == expected.frame.time
    state = contact_state(scene, 2.0)
    given = simulate(scene, 2.0, seed=11, index=3, contact=lambda *_, **__: state, render=render_fast)
    assert (camera.frame(state, seed=11, index=3).data == given.frame.data).all()
    assert found.data.max() > 20


def test_an_effect_at_its_null_changes_nothing() -> None:
    plain, null = scene_of(), scene_of(effects={"vignetting": {"k": 0.0}})
    state = contact_state(plain, 2.0)
    cameras = [FastCamera(scene, "numpy") for scene in (plain, null)]
    assert [camera.falls_back for camera in cameras] == ["", ""]
    a, b = (camera.frame(state, seed=1).data for camera in cameras)
    assert (a == b).all()
    assert (cameras[0].press(2.0, seed=1).data == a).all()


@pytest.mark.parametrize(
    "changes",
    [{"camera.pixel.prnu": 0.02}, {"camera.pixel.dsnu_e": 3.0}, {"camera.pixel.read_noise_e": 0.0},
     {"camera.lens.field_curvature_um": 60.0}],
)  # fmt: skip
def test_cameras_beyond_the_fast_operators_take_the_general_chain(changes: dict[str, float]) -> None:
    scene = scene_of(**changes)
    camera, state = FastCamera(scene, "numpy"), contact_state(scene, 2.0)
    assert camera.falls_back.startswith(next(iter(changes)).rpartition(".")[0])
    expected = expose(scene, render_fast(scene, state), seed=5, index=1)[1]
    assert (camera.frame(state, seed=5, index=1).data == expected.data).all()


def test_same_seed_same_bytes_and_frames_differ() -> None:
    scene = scene_of()
    camera, state = FastCamera(scene, "numpy"), contact_state(scene, 2.0)
    first, again = (camera.frame(state, seed=7, index=4, with_raw=True) for _ in range(2))
    assert first.data.tobytes() == again.data.tobytes()
    assert first.raw is not None
    assert again.raw is not None
    assert first.raw.tobytes() == again.raw.tobytes()
    for other in ({"seed": 8, "index": 4}, {"seed": 7, "index": 5}):
        assert camera.frame(state, **other).data.tobytes() != first.data.tobytes()
    times = [frame.time for frame in camera.frames([state, None, state], seed=7, frame_rate_hz=25.0)]
    assert times == pytest.approx([0.0, 0.04, 0.08])


@pytest.mark.parametrize(
    "changes",
    [
        {"leds.voltage_V": 9.7},
        {"leds.edge.top.relative_power": [1.0, 0.0, 0.4, 1.0, 1.3, 1.0, 0.0, 0.9]},
        {"camera.lens.defocus_um": -90.0},
        {"leds.voltage_V": 8.4, "camera.lens.defocus_um": 55.0, "finger.material": "silskin_20"},
        {"camera.exposure_ms": 4.0},
    ],
)
def test_retuned_camera_is_a_new_one(changes: dict[str, object]) -> None:
    """To the byte, whether maps could be kept or not; the old camera is none the worse."""
    first, second = scene_of("thesis_ridged"), scene_of("thesis_ridged", **changes)
    camera = FastCamera(first, "numpy")
    before = camera.frame(contact_state(first, 1.7), seed=5)
    state = contact_state(second, 2.9)
    found = camera.retuned(second).frame(state, seed=5, index=1)
    assert (found.data == FastCamera(second, "numpy").frame(state, seed=5, index=1).data).all()
    assert (found.data != before.data).any()
    assert (camera.frame(contact_state(first, 1.7), seed=5).data == before.data).all()


@pytest.mark.parametrize(
    ("changes", "kept"),
    [({"leds.voltage_V": 8.0}, True), ({"leds.edge.left.offset_mm": 3.0}, False), ({"grid.samples": 400}, False),
     ({"finger.position_mm": [1.9, -0.8]}, False), ({"plate.edge_reflectance": 0.4}, False),
     ({"camera.lens.distortion.k1": -0.3}, False)],
)  # fmt: skip
def test_retuned_camera_keeps_no_map_of_another_rig(changes: dict[str, object], kept: bool) -> None:
    scene = scene_of()
    camera = FastCamera(scene, "numpy")
    camera.frame(contact_state(scene, 1.0), seed=1)
    assert (camera.retuned(scene_of(**changes))._optics is not None) == kept


def test_a_plate_of_airs_index_is_the_limit_of_thinner_and_thinner_glass() -> None:
    """It guides no light: nothing is withheld from the edges by the contact, and no figure is missing."""
    found = []
    for index in (1.0, 1.0 + 1e-6):
        scene = load_scene("thesis", {"plate.refractive_index": index, "camera.resolution_px": [200, 150],
                                      "camera.scale_px_per_mm": 5.84})  # fmt: skip
        found.append(noiseless(scene, contact_state(scene, 2.0)))
    assert np.isfinite(found[0]).all()
    assert found[0] == pytest.approx(found[1], rel=1e-3, abs=1e-4 * found[1].max())
