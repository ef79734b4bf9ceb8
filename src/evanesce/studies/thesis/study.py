"""The thesis's own experiments in simulation: predictions, then a table per figure.

Nothing is fitted. Inputs are the thesis's shapes, materials, coefficients and programmes; what it does not print (the
bone's size, first of all) is varied over its range, which makes the interval. An entry that disagrees names its reason.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.chain.fast import FastCamera
from evanesce.chain.simulate import solve_contact
from evanesce.contact.solve import contact_sequence
from evanesce.core.states import ContactState
from evanesce.evaluation.perfect_view import PerfectView
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.report.charts import CaptionedImage
from evanesce.rig import Scene, load_scene
from evanesce.studies.ledger import Ledger
from evanesce.studies.mechanics.study import Prediction, predictions
from evanesce.studies.registry import Progress
from evanesce.studies.scenes import Finger, check_studied
from evanesce.studies.thesis.figures import (
    FORCES,
    Reproduced,
    area_figures,
    depth_figures,
    friction_figures,
    voltage_figures,
)
from evanesce.studies.thesis.outcomes import Outcome, outcomes
from evanesce.studies.voltage.analysis import converged, onset
from evanesce.studies.voltage.press import Press
from evanesce.studies.voltage.sources import study_scene

Floats = NDArray[np.float64]

CHAIN = Chain(threshold=0.15)
VOLTAGES = tuple(round(7.0 + 0.25 * k, 2) for k in range(21))
TRUE, MEASURED = (0, 179, 255), (255, 127, 14)
HALF_MM = 5.2


@dataclass(frozen=True, kw_only=True)
class ThesisStudy:
    """What the study computed.

    Attributes
    ----------
    outcomes : list of Outcome
        What sections 6.4 to 6.6 report, beside what follows from the inputs.
    stated : mapping
        Predictions by name: value, low, high, basis.
    entries : list of Reproduced
        Figures of the thesis beside those computed here.
    seen : list of mapping
        Areas that the simulated rig reports of finite-element contacts [mm^2].
    volts : mapping
        Area of the ridged finger against voltage [mm^2].
    picture : CaptionedImage
        Four moments of a slide.
    """

    stated: Mapping[str, Mapping[str, Any]]
    outcomes: Sequence[Outcome]
    entries: Sequence[Reproduced]
    seen: Sequence[Mapping[str, Any]]
    volts: Mapping[str, Any]
    picture: CaptionedImage


def compute(scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> ThesisStudy:
    """Compute predictions, figures, reported areas, voltages and the picture of a slide.

    Parameters
    ----------
    scene, out, progress, quick, seed
        See :meth:`evanesce.studies.registry.Study.run`.

    Returns
    -------
    ThesisStudy
    """
    check_studied(scene)
    ledger = Ledger(out / "thesis.jsonl", {"scene": scene.as_dict(), "seed": seed})
    steps = 5
    progress("thesis: figures", 0, steps)
    stated = ledger.row("predictions", lambda: {k: asdict(p) for k, p in _flat(predictions())})
    reported = [
        Outcome(**row | {"moves": tuple(row["moves"])})
        for row in ledger.row("outcomes", lambda: {"rows": [asdict(one) for one in outcomes()]})["rows"]
    ]
    progress("thesis: figures", 1, steps)
    entries = [*area_figures(), *depth_figures(), *friction_figures()]
    progress("thesis: figures", 2, steps)
    forces = (1.0, 5.0) if quick else FORCES
    view = PerfectView.of(scene)
    seen = list(_seen(scene, view, forces, seed, ledger))
    progress("thesis: figures", 3, steps)
    volts = ledger.row("voltage", partial(_voltage, scene, seed))
    entries += list(voltage_figures(volts))
    progress("thesis: figures", 4, steps)
    picture = slide_picture(scene, seed)
    progress("thesis: figures", steps, steps)
    return ThesisStudy(stated=stated, outcomes=reported, entries=entries, seen=seen, volts=volts, picture=picture)


def _flat(found: Mapping[str, Any]) -> Iterator[tuple[str, Prediction]]:
    for key, one in found.items():
        if isinstance(one, Prediction):
            yield key, one
        else:
            yield from ((f"{key} {sub}", each) for sub, each in one.items())


def _seen(
    scene: Scene, view: PerfectView, forces: Sequence[float], seed: int, ledger: Ledger
) -> Iterator[dict[str, Any]]:
    """Yield what the rig reports of finite-element contacts, clear and with scattering and specks [mm^2]."""
    law = {"contact": load_scene("thesis_slide").contact}
    for name in ("silskin_0", "silskin_20"):
        fingers = [Finger(name, ridged=False, scattering=scattering) for scattering in (False, True)]
        cameras: dict[bool, FastCamera] = {}

        def reported(force: float, fingers: Sequence[Finger] = fingers, cameras: Any = cameras) -> dict[str, Any]:
            row: dict[str, Any] = {}
            for finger in fingers:
                if finger.scattering not in cameras:
                    cameras[finger.scattering] = FastCamera(finger.on(scene.model_copy(update=law)))
                camera = cameras[finger.scattering]
                _, state = solve_contact(camera.scene, force, seed=seed)
                assert state is not None  # a force was given
                image = view.straight(camera.press(force, seed=seed).data)
                row["true_area_mm2"] = state.nominal_contact_area
                row["scattering_mm2" if finger.scattering else "clear_mm2"] = (
                    segment(image, CHAIN).pixels * view.mm2_per_px
                )
            return row

        for force in forces:
            row = ledger.row(f"seen {name} {force:g}", partial(reported, force))
            yield {"material": name, "force_N": force} | row


def _voltage(scene: Scene, seed: int) -> dict[str, Any]:
    """Return the area that the ridged finger shows at each voltage [mm^2], and the voltages that the thesis names."""
    ridged = study_scene(Finger("silskin_0", ridged=True, scattering=False).on(scene))[0]
    found: dict[str, Any] = {"voltage_V": VOLTAGES}
    for force in (1.0, 5.0):
        press = Press.of(ridged, force, seed=seed)
        area = np.array([press.area(v, CHAIN) for v in VOLTAGES])
        found[f"{force:g} N"] = {
            "area_mm2": area,
            "true_area_mm2": press.true_area_mm2,
            "onset_V": float(onset(VOLTAGES, area, np.array(press.true_area_mm2))),
            "converged_V": float(converged(VOLTAGES, area)),
        }
    return found


def slide_picture(scene: Scene, seed: int) -> CaptionedImage:
    """Return four moments of a slide with true (blue) and measured (orange) outline.

    Parameters
    ----------
    scene : Scene
        Its camera, plate and LEDs are used.
    seed : int

    Returns
    -------
    CaptionedImage
    """
    sliding = load_scene("thesis_slide")
    scene = sliding.model_copy(update={"camera": scene.camera, "plate": scene.plate, "leds": scene.leds})
    states, camera, view = contact_sequence(scene), FastCamera(scene), PerfectView.of(scene)
    count, panels = len(states), []
    for index in (int(0.1 * count), int(0.42 * count), int(0.72 * count), count - 1):
        state = states[index]
        crop = view.window(HALF_MM)
        image = crop.apply(view.straight(camera.frame(state, seed=seed, index=index).data))
        panels.append(outlined(image, segment(image, CHAIN).mask, view, state))
    return CaptionedImage(
        image=np.concatenate(panels, axis=1),
        caption="Silskin 0 %, 1 N, mu 0.67, slid to the right at 5 mm/s: a quarter into the press, pressed, the finger"
        " bending, and slipping as a whole. Blue the true outline, orange the measured one at a threshold of 0.15.",
    )


def outlined(
    image: NDArray[np.uint8], mask: NDArray[np.bool_], view: PerfectView, state: ContactState
) -> NDArray[np.uint8]:
    """Return a crop around the finger in colour, with both outlines.

    Parameters
    ----------
    image : ndarray of uint8 (rows, cols)
        Crop [DN].
    mask : ndarray of bool (rows, cols)
        Measured.
    view : PerfectView
    state : ContactState

    Returns
    -------
    ndarray of uint8 (rows, cols, 3)
    """
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    truth = view.labels(state, view.window(HALF_MM)).mask >= 0.5
    for found, colour, width in ((mask, MEASURED, 5), (truth, TRUE, 2)):
        lines, _ = cv2.findContours(found.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, lines, -1, colour, width)
    return np.asarray(picture, np.uint8)
