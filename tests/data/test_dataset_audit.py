"""The audit finds each fault that is planted in a small set of closed forms, and nothing in the set itself."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.core.errors import InputError
from evanesce.dataset import layout, worker
from evanesce.dataset.audit import audit
from evanesce.dataset.config import CHANNELS
from evanesce.dataset.encode import exr, png
from evanesce.dataset.job import Job
from evanesce.dataset.labels import LabelBox
from evanesce.dataset.produce import Record
from evanesce.dataset.run import make
from support.datasets import paper_meta, tiny_job

N, A, PITCH, SIDE = 0.9, 1.7, 0.05, 96  # Hertz's contact of 0.9 N, 1.7 mm in radius
MU, STEP, ANGLE, TORQUE = 0.7, 0.11, 0.6, 0.31
FIRST = np.array([-0.4, 0.2])

Parts = dict[str, Any]


def closed_form(trial: int, position: int, time_s: float) -> Parts:
    """Return maps and numbers: trial 0 sticks, shears, then slides; trial 1 is twisted."""
    axis = (np.arange(SIDE) - (SIDE - 1) / 2) * PITCH
    along = np.array([math.cos(ANGLE), math.sin(ANGLE)])
    slipped = max(position - 1, 0) * STEP if trial == 0 else 0.0
    centre = FIRST + slipped * along
    fine = (np.arange(SIDE * 4) - (SIDE * 4 - 1) / 2) * PITCH / 4
    inside = np.hypot(fine[None, :] - centre[0], fine[:, None] - centre[1]) < A
    mask = inside.reshape(SIDE, 4, SIDE, 4).mean(axis=(1, 3))
    x, y = np.meshgrid(axis - centre[0], axis - centre[1])
    r = np.hypot(x, y)
    pressure = 1.5 * N / (math.pi * A**2) * np.sqrt(np.clip(1 - (r / A) ** 2, 0, None))
    strength, nothing = MU * pressure, np.zeros_like(x)
    share = (0.0, 0.5, 1.0, 1.0, 1.0, 1.0)[position] if trial == 0 else 0.0
    traction = share * strength * along[:, None, None]
    torque = 0.0
    if trial == 1:
        # the moment of a traction r p about the middle: 2 pi integral of r^3 p dr, by Euler's beta function
        arm = 1.5 * N / (math.pi * A**2) * 2 * math.pi * A**4 * math.gamma(2) * math.gamma(1.5) / (2 * math.gamma(3.5))
        torque = TORQUE
        traction = TORQUE / arm * pressure * np.stack([-y, x])
    gross = trial == 0 and position >= 2
    touching = mask >= 0.5
    speed = STEP / 0.125 if gross else 0.0
    fields = {
        "contact_mask": mask, "state": np.where(touching, 3.0 if gross else 2.0, 0.0), "pressure": pressure,
        "gap": np.where(touching, 0.0, 0.1), "strength": strength,
        "traction.x": traction[0], "traction.y": traction[1],
        "slip.x": (slipped if gross else 0) * along[0] * touching,
        "slip.y": (slipped if gross else 0) * along[1] * touching,
        "slip_velocity.x": nothing + speed * along[0] * touching,
        "slip_velocity.y": nothing + speed * along[1] * touching,
    }  # fmt: skip
    scalars = {
        "time_s": time_s, "Fz_N": N, "Fx_N": share * MU * N * along[0], "Fy_N": share * MU * N * along[1],
        "torque_N_mm": torque, "nominal_area_mm2": math.pi * A**2, "stick_ratio": 0.0 if gross else 1.0,
        "centre_x_mm": centre[0], "centre_y_mm": centre[1],
    }  # fmt: skip
    return {"fields": fields, "scalars": scalars, "mask": None, "meta": {}}


class ClosedForm:
    """Makes frames of closed forms, with a fault where one is planted."""

    fault: Callable[[int, int, Parts], None] = staticmethod(lambda trial, position, parts: None)

    def __init__(self, job: Job) -> None:
        self.job = job

    def record(self, frame: int) -> Record:
        trial, position = divmod(frame, self.job.config.trial.frames)
        parts = closed_form(trial, position, position / 8.0)
        type(self).fault(trial, position, parts)
        box = LabelBox(0, 0, (SIDE, SIDE), {n: np.asarray(parts["fields"][n], np.float32) for n in CHANNELS})
        meta = paper_meta(self.job, frame, trial)
        meta["scalars"] |= parts["scalars"]
        meta |= {"kind": ("slide", "rotation")[trial], "split": ("train", "test")[trial]}
        meta["finger"]["index"], meta["rig"]["index"] = trial, trial
        for name, value in parts["meta"].items():
            meta[name]["index"] = value
        start = -(SIDE - 1) / 2 * PITCH
        geometry = {"pitch_mm": PITCH, "x0_mm": start, "y0_mm": start}
        state = parts["mask"] if parts["mask"] is not None else box.whole("state")
        data = exr(box, "half", {"geometry": geometry})
        members = {
            "frame.png": png(np.zeros((SIDE, SIDE), np.uint8)), "labels.exr": data, "plate.exr": data,
            "mask.png": png(state.astype(np.uint8)), "json": json.dumps(meta).encode(),
        }  # fmt: skip
        row = {"split": meta["split"], "kind": meta["kind"], "seed": 5, "time_s": position / 8.0}
        return Record(frame, trial, row, members)


def audited(folder: Path, fault: Callable[[int, int, Parts], None] | None = None) -> tuple[int, dict[str, Any]]:
    real = worker.Producer
    worker.Producer = type("Planted", (ClosedForm,), {"fault": staticmethod(fault)} if fault else {})  # type: ignore
    worker.forget()
    try:
        make(folder / "d", tiny_job(12))
    finally:
        worker.Producer = real  # type: ignore[misc]
        worker.forget()
    result = CliRunner().invoke(app, ["dataset", "audit", str(folder / "d"), "--json", str(folder / "a.json")])
    return result.exit_code, json.loads((folder / "a.json").read_text())


def test_closed_forms_pass_every_identity(tmp_path):
    code, found = audited(tmp_path)
    rows = {row["name"]: row for row in found["findings"]}
    assert code == 0, [row for row in rows.values() if row["verdict"] == "wrong"]
    assert found["good"]
    assert all(row["verdict"] == "good" for row in rows.values() if row["identity"])
    # and the composition is counted: eight frames stick, four slide, and no contact has texture
    assert rows["frames in stick"]["value"] == pytest.approx(8 / 12)
    assert rows["frames in gross"]["value"] == pytest.approx(4 / 12)
    assert rows["slides that reach gross slip"]["value"] == 1.0
    assert rows["trials with texture inside the contact"]["verdict"] == "low"
    outline = math.pi * A**2 / (SIDE * PITCH) ** 2
    assert rows["median share of pixels within the contact"]["value"] == pytest.approx(outline, rel=0.05)


def scaled(name: str, factor: float, trial: int = 0) -> Callable[[int, int, Parts], None]:
    def plant(t: int, position: int, parts: Parts) -> None:
        if t == trial:
            for key in parts["fields"]:
                if key.partition(".")[0] == name:
                    parts["fields"][key] = parts["fields"][key] * factor

    return plant


def number(name: str, change: float, trial: int = 0) -> Callable[[int, int, Parts], None]:
    def plant(t: int, position: int, parts: Parts) -> None:
        if t == trial:
            parts["scalars"][name] = parts["scalars"][name] + change

    return plant


def sheared(t: int, position: int, parts: Parts) -> None:
    if t == 1:  # a net force in a twist that states none
        parts["fields"]["traction.x"] = parts["fields"]["traction.x"] + 0.03 * parts["fields"]["pressure"]


def weak(t: int, position: int, parts: Parts) -> None:
    if (t, position) == (0, 1):
        parts["fields"]["strength"] = 0.45 * parts["fields"]["strength"]


def at_rest(t: int, position: int, parts: Parts) -> None:
    if (t, position) == (0, 2):
        for axis in ("x", "y"):
            parts["fields"][f"slip_velocity.{axis}"] = parts["fields"][f"slip_velocity.{axis}"] * 1e-5


def creeping(t: int, position: int, parts: Parts) -> None:
    if (t, position) == (0, 1):
        parts["fields"]["slip_velocity.x"] = 0.005 * (parts["fields"]["state"] == 2)


def other_pixels(t: int, position: int, parts: Parts) -> None:
    if (t, position) == (1, 3):
        parts["mask"] = parts["fields"]["state"].copy()
        parts["mask"][SIDE // 2, SIDE // 2] = 3


def shared(name: str) -> Callable[[int, int, Parts], None]:
    def plant(t: int, position: int, parts: Parts) -> None:
        parts["meta"] = {name: 0}

    return plant


FAULTS = {
    "pressure": (scaled("pressure", 1.03), "normal force: map against Fz_N", 6),
    "force": (number("Fz_N", 0.04, 1), "normal force: map against Fz_N", 6),
    "traction": (number("Fx_N", 0.02), "tangential force: map against Fx_N, Fy_N", 6),
    "net force": (sheared, "tangential force: map against Fx_N, Fy_N", 6),
    "torque": (number("torque_N_mm", 0.01, 1), "torque: map against torque_N_mm", 6),
    "area": (number("nominal_area_mm2", 0.3), "area: map against nominal_area_mm2", 6),
    "stick ratio": (number("stick_ratio", -0.03, 1), "stick_ratio: map against number", 6),
    "strength": (weak, "share of stick cells with traction above strength", 1),
    "no motion": (at_rest, "share of slip cells without motion", 1),
    "motion": (creeping, "share of stick cells with motion", 1),
    # of five frames that have one before them four slide
    "velocity": (scaled("slip_velocity", 1.3), "slip gained in the inner half against slip_velocity", 4),
    "pixels": (other_pixels, "pixels of mask.png that differ from the labels", 1),
    "finger": (shared("finger"), "fingers and rigs that are in two splits", 1),
    "rig": (shared("rig"), "fingers and rigs that are in two splits", 1),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_planted_fault_is_found_where_it_is(name, tmp_path):
    fault, row, count = FAULTS[name]
    code, found = audited(tmp_path, fault)
    wrong = {r["name"]: r for r in found["findings"] if r["verdict"] == "wrong"}
    assert code == 1
    assert not found["good"]
    assert row in wrong
    assert wrong[row]["wrong"] == count
    assert wrong[row]["examples"]


def test_folders_that_are_no_dataset_are_refused(tmp_path):
    result = CliRunner().invoke(app, ["dataset", "audit", str(tmp_path)])
    assert result.exit_code == 2
    (tmp_path / layout.DESCRIPTION).write_text(json.dumps({"format": layout.FORMAT, "format_version": 3}))
    result = CliRunner().invoke(app, ["dataset", "audit", str(tmp_path)])
    assert result.exit_code == 2
    assert "version 3" in result.output
    assert "make it again" in " ".join(result.output.split())


def test_a_frame_that_cannot_be_decoded_is_named(tmp_path):
    real = worker.Producer

    class Broken(ClosedForm):
        def record(self, frame: int) -> Record:
            found = super().record(frame)
            found.members["plate.exr"] = b"nothing"
            return found

    worker.Producer = Broken  # type: ignore[misc,assignment]
    worker.forget()
    try:
        make(tmp_path / "d", tiny_job(6))
    finally:
        worker.Producer = real  # type: ignore[misc]
        worker.forget()
    result = CliRunner().invoke(app, ["dataset", "audit", str(tmp_path / "d")])
    assert result.exit_code == 2
    assert "000000000" in result.output


def test_a_dataset_of_other_versions_is_audited_on_request(tmp_path):
    """Maps that are not stored are made again, by the packages that are here."""
    make(tmp_path / "d", tiny_job(frames=12, labels={"frame": (), "plate": ()}))
    text = (tmp_path / "d" / "dataset.json").read_text()
    (tmp_path / "d" / "dataset.json").write_text(text.replace(f'"numpy": "{np.__version__}"', '"numpy": "1.0"'))
    with pytest.raises(InputError, match=r"numpy 1\.0 .*--any-versions"):
        audit(tmp_path / "d")
    assert not [finding for finding in audit(tmp_path / "d", any_versions=True) if finding.verdict == "wrong"]
