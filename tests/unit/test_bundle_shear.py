"""Columns of tangential force, way and torque: from a slide's truth to the table and back; none of a press."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evanesce.bundle import read_bundle
from evanesce.bundle.folder import write_shots
from evanesce.bundle.layout import Shot, with_shear
from evanesce.bundle.tables import read_shots
from evanesce.bundle.write import write_bundle
from evanesce.contact.programme import slide_programme
from evanesce.contact.solve import contact_sequence, contact_state
from evanesce.core.errors import InputError
from evanesce.inference.series.predict import SeriesPredictor
from evanesce.rig import load_scene

SLIDE = {
    "contact": {"law": "hertz", "reduced_modulus_MPa": 0.4}, "grid.size_mm": 30.0, "grid.samples": 128,
    "press.frame_rate_hz": 10.0, "slide.direction_deg": 160.0, "slide.drive_stiffness_N_per_mm": 0.8,
    "slide.shaft": "rigid", "slide.spin_deg_per_s": 90.0,
}  # fmt: skip


def test_a_slides_load_cell_is_in_the_table(tmp_path: Path) -> None:
    scene = load_scene("thesis_slide", SLIDE)
    states, drive = contact_sequence(scene), slide_programme(scene).sample()[2]
    picked = (0, 12, 14, len(states) - 1)
    shots = [
        with_shear(Shot(index=i, time_s=states[i].time, force_N=states[i].normal_force, voltage_V=9.0), states[i])
        for i in picked
    ]
    for i, shot in zip(picked, shots, strict=True):
        # what the machine did, from tip and force, as well as the plane's tractions are solved
        assert shot.slide_mm == pytest.approx(float(drive[i]), abs=2e-3)
        assert shot.tangential_force_N == pytest.approx(np.hypot(*states[i].tangential_force), rel=0.02, abs=1e-9)
    assert shots[0].torque_Nmm == 0.0
    assert shots[-1].torque_Nmm == states[-1].parameters["torque_N_mm"] > 0.0
    write_shots(tmp_path / "press.csv", shots)
    back = read_shots(tmp_path / "press.csv", 9.0)
    for one, other in zip(shots, back, strict=True):
        for name in ("tangential_force_N", "slide_mm", "torque_Nmm"):
            assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-8, abs=1e-12)


@pytest.mark.slow
def test_a_slides_bundle_holds_its_frames_and_what_the_load_cell_read(tmp_path: Path) -> None:
    small = {"camera.resolution_px": [208, 156], "camera.scale_px_per_mm": 6.07, "press.frame_rate_hz": 5.0}
    scene = load_scene("thesis_slide", SLIDE | small)
    write_bundle(tmp_path / "slid", scene, seed=3)
    bundle = read_bundle(tmp_path / "slid")
    force = bundle.series["tangential_force_slide"]
    np.testing.assert_array_equal(force.x, bundle.series["torque_slide"].x)
    moving = [shot for shot in bundle.press if shot.slide_mm > 0]
    np.testing.assert_allclose(force.y, [shot.tangential_force_N for shot in moving], rtol=1e-8)
    assert force.y[-1] < 0.67 * 1.0  # Coulomb's, less what spinning takes
    assert "replicates" not in bundle.available
    # The nominal rig predicts it: of all frames, between which these lie.
    own = np.exp(SeriesPredictor(scene).log(force, {}))
    np.testing.assert_allclose(own, force.y, rtol=2e-3)


def test_a_press_has_no_such_columns(tmp_path: Path) -> None:
    state = contact_state(load_scene("thesis", {"grid.samples": 64}), 1.0)
    shot = Shot(index=0, time_s=0.0, force_N=1.0, voltage_V=9.0)
    assert with_shear(shot, state) is shot
    write_shots(tmp_path / "press.csv", [shot])
    assert (tmp_path / "press.csv").read_text().splitlines()[
        0
    ] == "index,time_s,force_N,voltage_V,displacement_mm,session"


def test_a_torque_out_of_range_is_refused_by_column(tmp_path: Path) -> None:
    table = tmp_path / "press.csv"
    table.write_text("index,time_s,force_N,torque_Nmm\n0,0.0,1.0,1e9\n")
    with pytest.raises(InputError, match="torque_Nmm"):
        read_shots(table, 9.0)
