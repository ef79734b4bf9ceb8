"""Refined estimator and reference segmentation on the same frames: fingers, positions, LED voltages."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.chain.simulate import solve_contact
from evanesce.core import provenance, rng
from evanesce.core.states import Frame, SensorLight
from evanesce.evaluation.calibrated_rig import calibrated, with_board_blur
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import Rectification, rectification
from evanesce.measurement.reference.area import measure_frame
from evanesce.measurement.reference.segment import Chain
from evanesce.measurement.refined.estimator import Estimator
from evanesce.optics.seen import seen_at
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene
from evanesce.sensor.expose import charge_of, frame_of, signal_of
from evanesce.sensor.lens import form_image
from evanesce.sensor.response import led_response
from evanesce.studies.ledger import Keep, not_kept
from evanesce.studies.voltage.press import power_ratio

VOLTAGES = (8.0, 8.5, 9.0, 10.0, 11.0, 12.0)
FORCES = (1.0, 3.0)
POSITIONS = {"centre": (0.37, -0.21), "corner": (11.3, 7.9)}
REFERENCE_V = 9.0
"""Voltage of the one press to which the estimator's scattering length is fitted; it does not saturate."""

SCATTERING_LENGTH_MM = 0.5
STIFF_MPA = 4.0
"""Reduced modulus at which grooves stay open under the study's forces."""

Tick = Callable[[int, int], None]


@dataclass(frozen=True, kw_only=True)
class Row:
    """One frame.

    Attributes
    ----------
    finger, place : str
    force_N, voltage_V : float
    true_mm2, reference_mm2, refined_mm2 : float
    saturated_share : float
        Of the contact's pixels.
    """

    finger: str
    place: str
    force_N: float
    voltage_V: float
    true_mm2: float
    reference_mm2: float
    refined_mm2: float
    saturated_share: float

    @property
    def reference_percent(self) -> float:
        """Error of the reference segmentation [%]."""
        return 100.0 * (self.reference_mm2 / self.true_mm2 - 1.0)

    @property
    def refined_percent(self) -> float:
        """Error of the refined estimator [%]."""
        return 100.0 * (self.refined_mm2 / self.true_mm2 - 1.0)


def fingers_of(smooth: Scene, ridged: Scene) -> dict[str, Scene]:
    """Return the fingers of the study by name: plain, with open grooves, and with subsurface scattering.

    Parameters
    ----------
    smooth, ridged : Scene

    Returns
    -------
    dict of str to Scene
    """
    stiff = ridged.model_copy(update={"contact": ridged.contact.model_copy(update={"reduced_modulus_MPa": STIFF_MPA})})

    def scattering(scene: Scene) -> Scene:
        return scene.model_copy(
            update={"finger": scene.finger.model_copy(update={"scattering_length_mm": SCATTERING_LENGTH_MM})}
        )

    return {
        "smooth": smooth,
        "ridged": ridged,
        "ridged, open grooves": stiff,
        "smooth, scattering": scattering(smooth),
        "ridged, scattering": scattering(ridged),
        "ridged, open grooves, scattering": scattering(stiff),
    }


def placed(scene: Scene, place: tuple[float, float]) -> Scene:
    """Return a scene whose finger presses elsewhere on the plate [mm].

    Parameters
    ----------
    scene : Scene
    place : tuple of float
        (x, y) [mm].

    Returns
    -------
    Scene
    """
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"position_mm": place})})


@dataclass(frozen=True)
class LitPress:
    """Light of a press on the sensor, from which frames at any voltage are exposed.

    Attributes
    ----------
    scene : Scene
    irradiance : ndarray (rows, cols)
        At the scene's own voltage [W mm^-2].
    true_mm2 : float
    """

    scene: Scene
    irradiance: NDArray[np.float32]
    true_mm2: float

    @classmethod
    def of(cls, scene: Scene, force: float, seed: int) -> LitPress:
        """Solve the contact and render it by the fast renderer.

        Parameters
        ----------
        scene : Scene
        force : float
            [N].
        seed : int

        Returns
        -------
        LitPress
        """
        rig, state = solve_contact(scene, force, seed=seed)
        assert state is not None  # a force was given
        image = form_image(render_fast(rig, state), rig.camera, rig.plate)
        return cls(seen_at(scene), np.asarray(image.irradiance, np.float32), state.nominal_contact_area)

    def frame(self, voltage: float, seed: int) -> Frame:
        """Expose at a voltage.

        Parameters
        ----------
        voltage : float
            [V].
        seed : int
            Of the noise.

        Returns
        -------
        Frame
        """
        ratio = power_ratio(self.scene, voltage)
        if ratio is None:
            raise ValueError("the LEDs do not all change alike")
        camera = self.scene.camera
        lit = SensorLight(irradiance=self.irradiance.astype(np.float64) * ratio)
        charge = charge_of(lit, camera, response=led_response(self.scene))
        return frame_of(signal_of(charge, camera, rng.generator(seed, "exposure", round(1000 * voltage))), camera)


def rows_of(
    name: str, place: str, scene: Scene, calibration: Calibration, voltages: Sequence[float], forces: Sequence[float],
    *, threshold: float, seed: int,
) -> Iterator[Row]:  # fmt: skip
    """Yield the rows of one finger at one place; the estimator sees frames and calibration only.

    Parameters
    ----------
    name, place : str
        Of finger and position.
    scene : Scene
    calibration : Calibration
    voltages, forces : sequence of float
        [V], [N].
    threshold : float
        Of the reference segmentation, 0 to 1.
    seed : int

    Yields
    ------
    Row
    """
    stream = name.replace("scattering", "glow")  # the random stream's label: frames of a seed stay the same
    chain, view = Chain(threshold=threshold), rectification(calibration)
    presses = {force: LitPress.of(scene, force, seed) for force in forces}
    first = presses[forces[0]]
    estimator = Estimator.of(calibration).tuned_on(first.frame(REFERENCE_V, rng.integer_seed(seed, "teach")).data)
    for force, press in presses.items():
        for voltage in voltages:
            frame = press.frame(voltage, rng.integer_seed(seed, stream, place, f"{force:g}"))
            yield _row(name, place, force, voltage, press.true_mm2, frame, (estimator, chain, view, calibration))


def _row(
    name: str, place: str, force: float, voltage: float, true_mm2: float, frame: Frame,
    tools: tuple[Estimator, Chain, Rectification, Calibration],
) -> Row:  # fmt: skip
    estimator, chain, view, calibration = tools
    found = estimator.area(frame.data)
    assert calibration.mm2_per_px is not None
    reference = measure_frame(frame, chain, calibration.mm2_per_px, view).estimate.area
    return Row(
        finger=name, place=place, force_N=force, voltage_V=voltage, true_mm2=true_mm2, reference_mm2=reference,
        refined_mm2=found.area_mm2, saturated_share=found.saturated_pixels / max(1, int(found.mask.sum())),
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class EstimatorStudy:
    """All rows, with what the page needs.

    Attributes
    ----------
    rows : list of Row
    threshold : float
        Of the reference segmentation.
    provenance : mapping
    """

    rows: list[Row]
    threshold: float
    provenance: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON result.

        Returns
        -------
        dict
        """
        plain = [
            asdict(r) | {"reference_percent": r.reference_percent, "refined_percent": r.refined_percent}
            for r in self.rows
        ]
        return {"threshold": self.threshold, "rows": plain, "worst": self.worst(), "provenance": self.provenance}

    def worst(self) -> list[dict[str, Any]]:
        """Return greatest error and RMS of each finger and place, over voltages and forces [%].

        Returns
        -------
        list of dict
        """
        found = []
        for finger, place in dict.fromkeys((r.finger, r.place) for r in self.rows):
            own = [r for r in self.rows if (r.finger, r.place) == (finger, place)]
            refined = np.array([r.refined_percent for r in own])
            reference = np.array([r.reference_percent for r in own])
            found.append(
                {
                    "finger": finger,
                    "place": place,
                    "frames": len(own),
                    "refined_rms_percent": float(np.sqrt((refined**2).mean())),
                    "refined_worst_percent": float(refined[np.abs(refined).argmax()]),
                    "reference_rms_percent": float(np.sqrt((reference**2).mean())),
                    "reference_worst_percent": float(reference[np.abs(reference).argmax()]),
                }
            )
        return found


def run_study(
    smooth: Scene,
    ridged: Scene,
    *,
    voltages: Sequence[float] = VOLTAGES,
    forces: Sequence[float] = FORCES,
    fingers: Sequence[str] | None = None,
    threshold: float = 0.15,
    seed: int = 1,
    keep: Keep = not_kept,
    tick: Tick = lambda done, total: None,
) -> EstimatorStudy:
    """Run the study.

    Parameters
    ----------
    smooth, ridged : Scene
    voltages, forces : sequence of float
        [V], [N].
    fingers : sequence of str, optional
        Names of :func:`fingers_of`; all by default.
    threshold : float
        Of the reference segmentation.
    seed : int
    keep : callable
        Keeps the rows of a finger at a place, so that an interrupted run goes on; see
        :data:`~evanesce.studies.ledger.Keep`.
    tick : callable
        ``tick(done, total)``.

    Returns
    -------
    EstimatorStudy
    """
    chosen = {n: s for n, s in fingers_of(smooth, ridged).items() if fingers is None or n in fingers}
    calibration = with_board_blur(calibrated(smooth, rng.generator(seed, "corners")), smooth, seed)
    origin = dict(provenance.record(seed=seed, config={"smooth": smooth.as_dict(), "ridged": ridged.as_dict()}))
    total = len(chosen) * len(POSITIONS) * len(voltages) * len(forces)
    rows: list[Row] = []

    def measured(name: str, place: str, done: int) -> dict[str, Any]:
        found = []
        scene = placed(chosen[name], POSITIONS[place])
        for row in rows_of(name, place, scene, calibration, voltages, forces, threshold=threshold, seed=seed):
            found.append(asdict(row))
            tick(done + len(found), total)
        return {"rows": found}

    for place in POSITIONS:
        for name in chosen:
            kept = keep(f"{name}, {place}", partial(measured, name, place, len(rows)))
            rows += [Row(**data) for data in kept["rows"]]
            tick(len(rows), total)
    return EstimatorStudy(rows=rows, threshold=threshold, provenance=origin)
