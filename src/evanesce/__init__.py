"""evanesce: a physical simulation of an optical tactile rig, read back through its real measurement pipeline.

Lengths are mm, forces N, pressures MPa, times s, angles rad, powers W, wavelengths nm, charges e-, digital values DN.
Any other unit stands in the name. Arrays are indexed ``[row, col]``; integer coordinates are pixel centres; x points
right and y down, in the image as on the plate.

The public Python API is what this module offers; everything is imported when it is first used::

    import evanesce as ev

    scene = ev.load("thesis_ridged").with_(leds__voltage_V=9.5)
    shot = ev.Camera(scene).shoot(force_N=2.0, seed=1)
    found = ev.measure(shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, threshold=0.15)
    print(shot.truth.area_mm2, found.area_mm2)
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from evanesce.core.deprecation import Moved, moved_names
from evanesce.core.version import __version__

if TYPE_CHECKING:
    from evanesce.api.bundles import Criticism, criticise
    from evanesce.api.calibrate import calibrate
    from evanesce.api.camera import Camera, Shot
    from evanesce.api.compare import compare, split_error
    from evanesce.api.contact import contact_sequence, solve_contact
    from evanesce.api.dataset import MemoryDataset, make_dataset
    from evanesce.api.measure import Measurement, Pipeline, measure
    from evanesce.api.own_answers import RigAnswers
    from evanesce.api.own_rig import OwnRig, own_rig
    from evanesce.api.scenes import coarser, load, save_scene, shipped_scenes
    from evanesce.api.truth import Truth
    from evanesce.bundle import Bundle, read_bundle
    from evanesce.core.errors import EvanesceError, InputError, WorkError
    from evanesce.core.states import ContactState, SurfaceState
    from evanesce.dataset.read import Dataset, Sample
    from evanesce.dataset.read import open as open_dataset
    from evanesce.effects import all_effects
    from evanesce.evaluation.camera_model import raw_model
    from evanesce.evaluation.compare import Comparison
    from evanesce.evaluation.error_split import ErrorSplit
    from evanesce.measurement.calibration.model import Calibration, load_calibration
    from evanesce.render.cards import Pose
    from evanesce.rig.scene import Scene


__all__ = [
    "Bundle",
    "Calibration",
    "Camera",
    "Comparison",
    "ContactState",
    "Criticism",
    "Dataset",
    "ErrorSplit",
    "EvanesceError",
    "InputError",
    "Measurement",
    "MemoryDataset",
    "OwnRig",
    "Pipeline",
    "Pose",
    "RigAnswers",
    "Sample",
    "Scene",
    "Shot",
    "SurfaceState",
    "Truth",
    "WorkError",
    "__version__",
    "all_effects",
    "calibrate",
    "coarser",
    "compare",
    "contact_sequence",
    "criticise",
    "load",
    "load_calibration",
    "make_dataset",
    "measure",
    "open_dataset",
    "own_rig",
    "raw_model",
    "read_bundle",
    "save_scene",
    "shipped_scenes",
    "solve_contact",
    "split_error",
]

_HOMES = {
    "evanesce.api.bundles": ("Criticism", "criticise"),
    "evanesce.api.calibrate": ("calibrate",),
    "evanesce.api.camera": ("Camera", "Shot"),
    "evanesce.api.compare": ("compare", "split_error"),
    "evanesce.api.contact": ("contact_sequence", "solve_contact"),
    "evanesce.api.dataset": ("MemoryDataset", "make_dataset"),
    "evanesce.api.measure": ("Measurement", "Pipeline", "measure"),
    "evanesce.api.own_answers": ("RigAnswers",),
    "evanesce.api.own_rig": ("OwnRig", "own_rig"),
    "evanesce.api.scenes": ("coarser", "load", "save_scene", "shipped_scenes"),
    "evanesce.api.truth": ("Truth",),
    "evanesce.bundle": ("Bundle", "read_bundle"),
    "evanesce.core.errors": ("EvanesceError", "InputError", "WorkError"),
    "evanesce.core.states": ("ContactState", "SurfaceState"),
    "evanesce.dataset.read": ("Dataset", "Sample", "open as open_dataset"),
    "evanesce.effects": ("all_effects",),
    "evanesce.evaluation.camera_model": ("raw_model",),
    "evanesce.evaluation.compare": ("Comparison",),
    "evanesce.evaluation.error_split": ("ErrorSplit",),
    "evanesce.measurement.calibration.model": ("Calibration", "load_calibration"),
    "evanesce.render.cards": ("Pose",),
    "evanesce.rig.scene": ("Scene",),
}
_PUBLIC = {
    public: (module, name)
    for module, names in _HOMES.items()
    for name, public in ((entry.split(" as ")[0], entry.split(" as ")[-1]) for entry in names)
}

# Modules of 0.1 that stood at the top. Reached as attributes only: `import evanesce.errors` finds no module.
_MOVED = {
    name: Moved(f"evanesce.{package}.{name}", removal="0.4")
    for package, names in {
        "core": ("errors", "provenance", "quantities", "resources", "rng", "states"),
        "chain": ("fast", "fast_optics", "simulate"),
    }.items()
    for name in names
}
_moved = moved_names(__name__, _MOVED, stacklevel=3)


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        return _moved(name)
    module, original = _PUBLIC[name]
    found = getattr(importlib.import_module(module), original)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
