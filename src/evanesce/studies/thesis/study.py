"""The thesis's own experiments in simulation: predictions stated first, then a table per figure.

Nothing is fitted. Inputs are the thesis's shapes, materials, coefficients and programmes; what it does not state (the
bone, first of all) is spanned and makes the interval. An entry that disagrees names its reason.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.chain.fast import FastCamera
from evanesce.chain.simulate import solve_contact
from evanesce.contact.analytic.hertz import hertz_depth
from evanesce.contact.fem.library import library_press
from evanesce.contact.solve import contact_sequence
from evanesce.core.states import ContactState
from evanesce.evaluation.perfect_view import PerfectView
from evanesce.materials.tables import material
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.rig import Scene, load_scene
from evanesce.studies.mechanics.runs import BONES
from evanesce.studies.mechanics.study import Prediction, modulus_at_ridges, predictions, slide_curves
from evanesce.studies.registry import Chart, Findings, Ledger, Listing, Panel, Part, Progress, Series, Shown
from evanesce.studies.scenes import Finger, check_studied
from evanesce.studies.thesis.figures import (
    FORCES,
    RADIUS,
    Reproduced,
    area_figures,
    area_laws,
    depth_figures,
    friction_figures,
    observations,
    published_depth,
    voltage_figures,
)
from evanesce.studies.voltage.curve import Press, study_scene
from evanesce.studies.voltage.findings import converged, onset

Floats = NDArray[np.float64]

CHAIN = Chain(threshold=0.15)
VOLTAGES = tuple(round(7.0 + 0.25 * k, 2) for k in range(21))
TRUE, MEASURED = (0, 179, 255), (255, 127, 14)
HALF_MM = 5.2


def run(scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
    """Do the study; see :class:`evanesce.studies.registry.Study`."""
    check_studied(scene)
    ledger = Ledger(out / "thesis.jsonl", {"scene": scene.as_dict(), "seed": seed})
    steps = 5
    progress("thesis: figures", 0, steps)
    stated = ledger.row("predictions", lambda: {k: asdict(p) for k, p in _flat(predictions())})
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
    return findings(stated, entries, seen, volts, picture)


def _flat(found: Mapping[str, Any]) -> Iterator[tuple[str, Prediction]]:
    for key, one in found.items():
        if isinstance(one, Prediction):
            yield key, one
        else:
            yield from ((f"{key} {sub}", each) for sub, each in one.items())


def _seen(
    scene: Scene, view: PerfectView, forces: Sequence[float], seed: int, ledger: Ledger
) -> Iterator[dict[str, Any]]:
    """Yield what the rig reports of finite-element contacts, clear and with glow and specks [mm^2]."""
    law = {"contact": load_scene("thesis_slide").contact}
    for name in ("silskin_0", "silskin_20"):
        fingers = [Finger(name, ridged=False, glowing=glowing) for glowing in (False, True)]
        cameras: dict[bool, FastCamera] = {}

        def reported(force: float, fingers: Sequence[Finger] = fingers, cameras: Any = cameras) -> dict[str, Any]:
            row: dict[str, Any] = {}
            for finger in fingers:
                if finger.glowing not in cameras:
                    cameras[finger.glowing] = FastCamera(finger.on(scene.model_copy(update=law)))
                camera = cameras[finger.glowing]
                _, state = solve_contact(camera.scene, force, seed=seed)
                assert state is not None  # a force was given
                image = view.straight(camera.press(force, seed=seed).data)
                row["true_area_mm2"] = state.nominal_contact_area
                row["glowing_mm2" if finger.glowing else "clear_mm2"] = segment(image, CHAIN).pixels * view.mm2_per_px
            return row

        for force in forces:
            row = ledger.row(f"seen {name} {force:g}", partial(reported, force))
            yield {"material": name, "force_N": force} | row


def _voltage(scene: Scene, seed: int) -> dict[str, Any]:
    """Return the area that the ridged finger shows at each voltage [mm^2], and the voltages that the thesis names."""
    ridged = study_scene(Finger("silskin_0", ridged=True, glowing=False).on(scene))[0]
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


def slide_picture(scene: Scene, seed: int) -> Shown:
    """Return four moments of a slide with true (blue) and measured (orange) outline."""
    sliding = load_scene("thesis_slide")
    scene = sliding.model_copy(update={"camera": scene.camera, "plate": scene.plate, "leds": scene.leds})
    states, camera, view = contact_sequence(scene), FastCamera(scene), PerfectView.of(scene)
    count, panels = len(states), []
    for index in (int(0.1 * count), int(0.42 * count), int(0.72 * count), count - 1):
        state = states[index]
        crop = view.window(HALF_MM)
        image = crop.apply(view.straight(camera.frame(state, seed=seed, index=index).data))
        panels.append(outlined(image, segment(image, CHAIN).mask, view, state))
    return Shown(
        image=np.concatenate(panels, axis=1),
        caption="Silskin 0 %, 1 N, mu 0.67, slid to the right at 5 mm/s: a quarter into the press, pressed, the finger"
        " bending, and slipping as a whole. Blue the true outline, orange the measured one at a threshold of 0.15.",
    )


def outlined(
    image: NDArray[np.uint8], mask: NDArray[np.bool_], view: PerfectView, state: ContactState
) -> NDArray[np.uint8]:
    """Return a crop around the finger in colour, with both outlines."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
    truth = view.labels(state, view.window(HALF_MM)).mask >= 0.5
    for found, colour, width in ((mask, MEASURED, 5), (truth, TRUE, 2)):
        lines, _ = cv2.findContours(found.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
        cv2.drawContours(picture, lines, -1, colour, width)
    return np.asarray(picture, np.uint8)


def findings(
    stated: Mapping[str, Mapping[str, Any]], entries: Sequence[Reproduced], seen: Sequence[Mapping[str, Any]],
    volts: Mapping[str, Any], picture: Shown,
) -> Findings:  # fmt: skip
    """Return tables, charts and verdict."""
    simulated = [entry for entry in entries if entry.simulated]
    agreed, published = (
        f"{sum(entry.agrees for entry in some)} of {len(some)}"
        for some in (simulated, [entry for entry in entries if not entry.simulated])
    )
    far = Counter(entry.figure for entry in entries if not entry.agrees)
    verdict = [
        f"{agreed} of the thesis's figures that were simulated lie in the interval that its own inputs leave; of those"
        f" that only set the thesis's own laws beside each other, without simulation, {published}. Intervals are no"
        " 95 % intervals: they are the hull of what the thesis leaves open, bone or none above all, and many are wide.",
        f"Outside lie: {'; '.join(f'{figure} ({count})' for figure, count in far.items())}. Reasons are in the tables."
        if far
        else "None lies outside.",
        _glow_sentence(seen),
        "Textured against smooth, short against long, the larger tip and the bone are predictions: the thesis's own"
        " figures of them were not used and are not known here.",
    ]
    tables = [_prediction_table(stated)]
    for figure in dict.fromkeys(entry.figure for entry in entries):
        tables.append(_figure_table(figure, [entry for entry in entries if entry.figure == figure]))
    tables.append(
        Listing(
            columns=("the thesis says", "here", "verdict"),
            rows=observations(slide_curves()),
            caption="What the thesis says in words.",
        )
    )
    tables += [_law_table(name) for name in ("silskin_0", "silskin_20")]
    tables.append(_seen_table(seen))
    return Findings(
        verdict=verdict,
        charts=[_area_chart(seen), _depth_and_voltage(volts)],
        pictures=[picture],
        tables=tables,
        data={
            "predictions": {key: dict(one) for key, one in stated.items()},
            "figures": [asdict(entry) | {"agrees": entry.agrees, "wide": entry.wide} for entry in entries],
            "seen": [dict(row) for row in seen],
            "voltage": dict(volts),
        },
    )


def _glow_sentence(seen: Sequence[Mapping[str, Any]]) -> str:
    law = material("silskin_20").measured_area
    assert law is not None  # in the tables
    some = [row for row in seen if row["material"] == "silskin_20"]
    told = "; ".join(
        f"{r['force_N']:g} N: true {r['true_area_mm2']:.0f}, reported {r['glowing_mm2']:.0f}, thesis"
        f" {float(law.area(r['force_N'])):.0f}"
        for r in some
    )
    return (
        "With the assumed glow the rig's chain at a threshold of 0.15 reports areas of the size of the thesis's from a"
        f" finite-element contact that is much smaller (Silskin 20 %, mm²: {told}): glow is a candidate for the factor"
        " of 1.8, beside adhesion."
    )


def _prediction_table(stated: Mapping[str, Mapping[str, Any]]) -> Listing:
    return Listing(
        columns=("predicted", "value", "interval", "basis"),
        rows=[
            (key.replace("_", " "), f"{p['value']:.3g}", f"{p['low']:.3g} to {p['high']:.3g}", p["basis"])
            for key, p in stated.items()
        ],
        caption="Predictions, stated before anyone compares: ratios, or changes over 1.",
    )


def _figure_table(figure: str, entries: Sequence[Reproduced]) -> Listing:
    return Listing(
        columns=("quantity", "basis", "thesis", "ours", "ours over thesis", "hull of the open inputs", "verdict"),
        rows=[
            (
                f"{e.what} [{e.unit}]",
                "simulated" if e.simulated else "the thesis's own laws",
                f"{e.thesis:.4g}",
                f"{e.value:.4g}",
                f"{e.value / e.thesis:.2f}",
                f"{e.low:.4g} to {e.high:.4g}" + (f" ({e.high / e.low:.1f} times)" if e.wide else ""),
                ("within" + (" a wide hull" if e.wide else "")) if e.agrees else f"outside: {e.reason}",
            )
            for e in entries
        ],
        caption=figure[0].upper() + figure[1:] + ".",
    )


def _law_table(name: str) -> Listing:
    laws = area_laws(name)
    title = "Silskin 0 %" if name == "silskin_0" else "Silskin 20 %"
    return Listing(
        columns=("force [N]", *(f"{law} [mm²]" for law in laws)),
        rows=[(f"{f:g}", *(f"{laws[law][k]:.2f}" for law in laws)) for k, f in enumerate(FORCES)],
        caption=f"{title}: area against force by every law.",
    )


def _seen_table(seen: Sequence[Mapping[str, Any]]) -> Listing:
    return Listing(
        columns=(
            "material",
            "force [N]",
            "true area [mm²]",
            "reported, clear [mm²]",
            "reported, glow and specks [mm²]",
        ),
        rows=[
            (
                r["material"],
                f"{r['force_N']:g}",
                f"{r['true_area_mm2']:.2f}",
                f"{r['clear_mm2']:.2f}",
                f"{r['glowing_mm2']:.2f}",
            )
            for r in seen
        ],
        caption="The same presses of the solid finger (finite elements) through light, camera and the reference segmentation"
        " at a threshold of 0.15: what a waveguide would have reported.",
    )


def _area_chart(seen: Sequence[Mapping[str, Any]]) -> Chart:
    panels = []
    for name, title in (("silskin_0", "Silskin 0 %"), ("silskin_20", "Silskin 20 %")):
        laws = area_laws(name)
        some = [r for r in seen if r["material"] == name]
        fe = [laws["finite elements, no bone"], laws["finite elements, bone"]]
        series = [
            Series(label=law, x=FORCES, y=area.tolist(), points=law.startswith("measured"))
            for law, area in laws.items()
            if not law.startswith("finite") and "1 J" not in law and "10 J" not in law
        ]
        series.append(
            Series(label="finite elements, no bone to bone", x=FORCES, y=fe[0].tolist(),
                   low=np.minimum(*fe).tolist(), high=np.maximum(*fe).tolist())
        )  # fmt: skip
        for key, label in (("clear_mm2", "reported by the rig, clear"), ("glowing_mm2", "reported, glow and specks")):
            series.append(Series(label=label, x=[r["force_N"] for r in some], y=[r[key] for r in some], points=True))
        panels.append(Panel(title=title, x_label="normal force [N]", y_label="contact area [mm²]", series=series))
    return Chart(
        panels=panels,
        caption="Finite elements, bone or none, fall short of the waveguide's areas of Silskin 20 %; what the simulated"
        " rig reports of their smaller contact comes near those areas up to 3 N once glow is assumed.",
    )


def _depth_and_voltage(volts: Mapping[str, Any]) -> Chart:
    series = []
    for name, title in (("silskin_0", "Silskin 0 %"), ("silskin_20", "Silskin 20 %")):
        presses = [library_press(name, bone) for bone in BONES]
        force = np.linspace(0.2, 5.0, 25)
        depth = [np.interp(force, press.force, press.depth) for press in presses]
        series += [
            Series(label=f"{title}, finite elements", x=force.tolist(), y=depth[0].tolist(),
                   low=np.minimum(*depth).tolist(), high=np.maximum(*depth).tolist()),
            Series(label=f"{title}, thesis's E*(F)", x=force.tolist(),
                   y=[published_depth(name, float(f)) for f in force], points=True),
            Series(label=f"{title}, Hertz, E* = 4 G", x=force.tolist(),
                   y=hertz_depth(force, RADIUS, modulus_at_ridges(name)).tolist()),
        ]  # fmt: skip
    shown = [
        Series(label=key, x=volts["voltage_V"], y=[a / volts[key]["true_area_mm2"] for a in volts[key]["area_mm2"]])
        for key in ("1 N", "5 N")
    ]
    return Chart(
        panels=[
            Panel(title="force and displacement on glass", x_label="normal force [N]", y_label="depth [mm]",
                  series=series),
            Panel(title="ridged finger, threshold 0.15", x_label="LED voltage [V]",
                  y_label="estimated over true area [1]", series=shown),
        ],
        caption="The published material sinks deeper than the published modulus says unless a bone stiffens it (bands:"
        " no bone to bone), and with assumed glow the estimated area goes on growing with voltage instead of settling.",
    )  # fmt: skip


STUDY = Part("thesis", "The thesis's experiments in simulation", 60, run)
