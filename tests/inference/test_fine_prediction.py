"""The fine prediction: where nothing is finer it is the quick one, and finer pixels converge."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from evanesce.prediction.fine import FineFrames, FinePredictor, placed
from evanesce.prediction.observe import model_factor, model_scene
from evanesce.prediction.predict import CONTACT_PX, Predictor
from evanesce.prediction.views import View
from evanesce.rig import Scene, load_scene

VIEWS = (
    View(kind="press", force_N=1.3, voltage_V=9.0, index=0, condition=0),
    View(kind="press", force_N=3.7, voltage_V=9.4, index=1, condition=1),
    View(kind="lens_cap"),
)


def coarse(cols: int = 160) -> Scene:
    """The thesis's rig on few pixels, finger and focus off the middle."""
    return load_scene(
        "thesis",
        {
            "camera.resolution_px": [cols, cols * 3 // 4],
            "camera.scale_px_per_mm": 58.37 * cols / 2000,
            "camera.pixel.pitch_um": 6200 / cols,
            "camera.lens.defocus_um": 210.0,
            "finger.position_mm": [1.3, -0.7],
            "grid.samples": 512,
        },
    )


@pytest.fixture(scope="module")
def scene() -> Scene:
    return coarse()


@pytest.mark.parametrize("point", [{"liquid_film:volume_uL": 3.0}, {"modulus:relative": 0.2}, {"@pose_x[0]": 0.4}])
def test_a_contact_that_was_kept_answers_for_no_other_rig(scene: Scene, point: dict[str, float]) -> None:
    """Rationale: contacts were kept without the liquid about them."""
    used, alone = (Predictor(model_scene(scene), VIEWS) for _ in range(2))
    plain = used.cube({})
    after = used.cube(point)
    np.testing.assert_array_equal(after, alone.cube(point))
    assert np.abs(after - plain).max() > 1.0
    np.testing.assert_array_equal(used.cube({}), plain)


@pytest.mark.slow  # 6 s
def test_a_dark_view_needs_no_finer_pixels(scene: Scene) -> None:
    quick = Predictor(model_scene(scene), VIEWS).cube({})
    fine = FineFrames(scene, VIEWS, model_factor(scene), {}).cube()
    np.testing.assert_allclose(fine[2], quick[2], atol=1e-9)


@pytest.mark.slow  # 8 s: light gathered by pixels of a sixth
def test_finer_pixels_converge(scene: Scene) -> None:
    """Twice as fine again changes much less than the first step did: away from the edge next to nothing."""
    quick = Predictor(model_scene(scene), VIEWS).cube({})
    fine = FineFrames(scene, VIEWS, model_factor(scene), {}).cube()
    finer = FineFrames(scene, VIEWS, model_factor(scene), {}, fine_px=6).cube()
    first, second = (np.sqrt(np.mean((a - b) ** 2)) for a, b in ((quick, fine), (fine, finer)))
    assert second < 0.35 * first


@pytest.mark.slow
def test_a_finger_beside_its_place_is_the_rig_with_the_finger_there(scene: Scene) -> None:
    """The light is that of the nearest tenth of a millimetre; the contact is moved under it."""
    shift = {"@pose_x[0]": 0.34, "@pose_y[0]": -0.12}
    found = FineFrames(scene, VIEWS, 1, shift).cube()
    there = FinePredictor(placed(scene, (0.34, -0.12)), VIEWS, 1).cube({})
    # The guided light of a plate changes by some 1e-4 over the 40 um between the two places.
    np.testing.assert_allclose(found, there, rtol=2e-3, atol=0.15)


def test_a_length_in_pixels_is_the_cameras_own_where_its_light_is_gathered_by_smaller_ones(scene: Scene) -> None:
    """Rationale: a centre 30 px off the middle lay 15 px off it where pixels were halved."""
    beside = {"vignetting:k": 0.4, "vignetting:centre_offset_px[0]": 30.0}
    models = [Predictor(model_scene(scene), VIEWS[:2], before=before, finer=2) for before in (1, 2)]
    plain, shaded = (np.array([m.cube(point) for m in models]) for point in ({}, beside))
    lit = plain[0] > 0.2 * plain.max()
    falls = shaded / plain
    np.testing.assert_allclose(falls[1][lit], falls[0][lit], rtol=0.004)
    assert np.abs(falls[0][lit] - 1.0).max() > 0.03


@pytest.mark.slow  # 15 s
@pytest.mark.parametrize(("name", "step"), [("modulus:relative", 0.02), ("bone_stiffening:per_N", 0.01)])
def test_smaller_pixels_of_a_contact_bring_its_derivative_nearer_the_fine_models(name: str, step: float) -> None:
    """What a cause's change holds that the finger's place and light do not has the fine model's form."""
    scene = coarse(400)
    models = [Predictor(model_scene(scene), VIEWS[:2], before=n, finer=n) for n in (1, CONTACT_PX)]

    def fine(point: dict[str, float]) -> np.ndarray:
        return np.asarray(FineFrames(scene, VIEWS[:2], model_factor(scene), point, fine_px=4).cube())

    def beside(cube: Callable[[dict[str, float]], np.ndarray]) -> np.ndarray:
        """Return the change less what the finger's place and the light make of it, of unit length."""
        nominal = cube({}).ravel()
        known = [nominal, *(cube({f"@pose_{axis}[0]": 0.01}).ravel() - nominal for axis in "xy")]
        rows = np.linalg.qr(np.array(known).T)[0].T
        change = cube({name: step}).ravel() - nominal
        left = change - rows.T @ (rows @ change)
        return np.asarray(left / np.linalg.norm(left))

    true = beside(fine)
    shares = [float(true @ beside(model.cube)) ** 2 for model in models]
    assert shares[1] > 0.95
    assert 1.0 - shares[1] < 0.6 * (1.0 - shares[0])
