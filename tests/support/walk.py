"""The path of the tutorial of a first measurement by the command line, in a drawn lab, against the truth."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from typer.testing import CliRunner

from evanesce.cli.app import app
from support.labs import Lab, Rig

VIEWS = 6


def calibrate_args(lab: Lab, folder: Path) -> list[str]:
    boards = [str(folder / f"board{k}.png") for k in range(VIEWS)]
    return [
        "calibrate", "--checkerboard", *boards, "--square-mm", str(lab.board.side),
        "--square", str(folder / "card.png"), "--side-mm", str(lab.card),
        "--on-glass", "board0.png", "--json", str(folder / "cal.json"),
    ]  # fmt: skip


@dataclass(frozen=True)
class Walk:
    """Areas of the frames with contact, their intervals and truths [mm^2]; the calibration; areas against force."""

    lab: Lab
    area: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    true: NDArray[np.float64]
    free: NDArray[np.float64]
    calibration: dict[str, Any]
    data: dict[str, Any]
    said: tuple[str, ...]

    @property
    def errors(self) -> NDArray[np.float64]:
        """Relative error of each area."""
        return self.area / self.true - 1

    @property
    def codes(self) -> list[str]:
        return sorted({warning["code"] for warning in self.data["warnings"]})

    def off(self) -> dict[str, float]:
        """Errors of the camera's parameters in their own standard errors."""
        lens, errors = self.lab.lens, self.calibration["standard_errors"]
        matrix, k = np.array(self.calibration["camera_matrix"]), self.calibration["distortion"]
        true = {"fx": lens.fx, "fy": lens.fy, "cx": lens.cx, "cy": lens.cy, "k1": lens.k1, "k2": lens.k2}
        found = {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2], "k1": k[0], "k2": k[1]}
        return {key: float((found[key] - true[key]) / errors[key]) for key in true}

    def covered(self, rng: np.random.Generator, prints: int = 2000) -> float:
        """Share of frames and prints whose interval holds the truth.

        Prints are longer than stated by up to 0.2 % and lie up to 0.1 mm over the plate, as the budget assumes: a print
        that is longer, and nearer, makes every area and interval smaller by the same factor.
        """
        size = (1 + rng.uniform(-0.002, 0.002, prints)) * (1 - rng.uniform(0, 0.1, prints) / self.lab.distance)
        factor = (size**-2)[:, None]
        return float(((self.low * factor <= self.true) & (self.true <= self.high * factor)).mean())


def walk(lab: Lab, folder: Path, options: Sequence[str] = ()) -> Walk:
    """Draw a lab, calibrate, measure with the forces."""
    true = Rig(lab).write(folder)
    run = CliRunner()
    done = run.invoke(app, calibrate_args(lab, folder))
    assert done.exit_code == 0, done.output
    said = done.stderr
    camera = ["--camera-model", str(folder / "camera.csv")] if lab.colour is not None else []
    done = run.invoke(
        app,
        ["measure", str(folder / "film.mp4"), "--calibration", str(folder / "cal.json"), "--force",
         str(folder / "force.csv"), "--json", str(folder / "measured.json"), *camera, *options],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    data = json.loads((folder / "measured.json").read_text())
    area, low, high = (np.array([f[k] for f in data["frames"]]) for k in ("area_mm2", "area_low_mm2", "area_high_mm2"))
    on = true > 0
    lines = (said + done.stderr).splitlines()
    return Walk(
        lab, area[on], low[on], high[on], true[on], area[~on], json.loads((folder / "cal.json").read_text()), data,
        tuple(line for line in lines if line.startswith(("warning:", "error:"))),
    )  # fmt: skip
