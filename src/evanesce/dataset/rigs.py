"""A rig of the dataset: scene, effects, and a camera that is as fast as the effects allow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from evanesce.chain.fast import FastCamera
from evanesce.chain.fast_effects import FastEffects, NotFast
from evanesce.chain.simulate import expose
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, Frame, PlateGrid, embedded
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.config_contact import PRINT_PATTERNS
from evanesce.dataset.design import ITS_TRIALS_MOTION, FingerPlan, RigPlan
from evanesce.dataset.region import crop
from evanesce.effects import Active, Context, Stage, active_effects, all_effects, apply_stage
from evanesce.optics.seen import seen_at
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene
from evanesce.rig.finger import OWN_FIGURES, Finger
from evanesce.rig.load import validate


def rig_scene(
    base: Scene, rig: RigPlan, finger: FingerPlan, config: DatasetConfig, liquid: dict[str, float] | None = None
) -> Scene:
    """Return the scene of a rig with a finger: drawn keys set, the frame scaled, effects listed, the liquid if any.

    Raises
    ------
    InputError
        If a drawn key does not exist in a scene, or leaves its bounds.
    """
    data = base.as_dict()
    for name in ("slide", "assumptions", "sources"):
        data.pop(name, None)
    data["finger"] |= {"tip_radius_mm": finger.tip_radius_mm, "material": finger.material}
    for key in ("ridges", "fingerprint", "height_map", *OWN_FIGURES):
        data["finger"].pop(key, None)
    if finger.pattern in PRINT_PATTERNS:
        data["finger"]["fingerprint"] = {
            "pattern": PRINT_PATTERNS[finger.pattern],
            "ridge_period_um": finger.ridge_pitch_um,
            "ridge_height_um": finger.ridge_height_um,
            "orientation_deg": finger.ridge_orientation_deg,
            "seed": finger.index,
        }
    elif finger.pattern:
        data["finger"]["ridges"] = {
            "pattern": finger.pattern,
            "pitch_um": finger.ridge_pitch_um,
            "width_um": finger.ridge_width_um,
            "height_um": finger.ridge_height_um,
            "orientation_deg": finger.ridge_orientation_deg,
        }
    data["press"] = {"forces_N": [1.0], "frame_rate_hz": config.trial.frame_rate_hz}
    data["contact"] = {"law": "hertz"}
    if finger.tilt_deg:
        data["contact"] |= {"tilt_deg": finger.tilt_deg, "tilt_direction_deg": finger.tilt_direction_deg}
    if liquid:
        data["liquid"] = liquid
    data["effects"] = all_of(base, rig)
    for dotted, value in rig.changes.items():
        _set(data, dotted, value)
    follow_rate(data["camera"], config.trial.frame_rate_hz)
    if config.camera.region_mm is not None:
        crop(data["camera"], validate(Scene, data, "rig.draw"), config.camera)
        _windowed(data["effects"], data["camera"], base)
    else:
        bin_pixels(data["camera"], config.camera.scale)
    interval_ms = 1e3 / config.trial.frame_rate_hz
    for name in ROLLING & rig.effects.keys():
        table = all_effects()[name].parameters.model_validate(data["effects"][name]).model_dump(mode="json")
        if table["readout_ms"] > interval_ms:
            data["effects"][name] = {**table, "readout_ms": interval_ms}
    return validate(Scene, data, "rig.draw")


def replaced_warning(base: Scene) -> str:
    """Return a sentence on what of a scene's mechanics a data set leaves aside; empty where it keeps all."""
    data = base.as_dict()
    finger = data["finger"]
    aside = []
    if data["contact"] != {"law": "hertz"}:
        kept = ", ".join(f"{key} = {value}" for key, value in data["contact"].items())
        aside.append(f"[contact] {kept} (trials press by hertz; tilts are finger.tilt_deg of the configuration)")
    own = [key for key in OWN_FIGURES if finger.get(key) is not None]
    if own:
        aside.append(f"finger.{own[0]} (trials draw named materials: finger.material of the configuration)")
    aside += [f"[finger.{key}] (trials draw ridges)" for key in ("ridges", "fingerprint") if finger.get(key)]
    aside += [f"[{key}] ({why})" for key, why in REPLACED.items() if data.get(key)]
    return f"data sets do not take from the scene: {'; '.join(aside)}" if aside else ""


REPLACED = {"slide": "each trial has its own motion", "environment": "contacts do not depend on rate"}
"""Tables of a scene that trials leave aside, and why."""
EXPOSED = 0.9
"""Longest exposure over the time between two frames; the rest resets and reads the pixels."""


def follow_rate(camera: dict[str, Any], rate_hz: float) -> None:
    """Shorten a camera's exposure to what a frame rate leaves, and raise its gain as much: the mean level stays.

    Photons become fewer, so that noise grows over the signal.

    Raises
    ------
    InputError
        If no gain makes up for it, or the camera chooses its exposure itself.
    """
    longest, key = EXPOSED * 1e3 / rate_hz, "trial.frame_rate_hz"
    if camera["exposure_ms"] <= longest:
        return
    if camera.get("auto_exposure") is not None:
        raise InputError(f"at {rate_hz:g} Hz camera.auto_exposure is not followed", key=key, allowed="a camera without")
    gain, most = camera["analogue_gain"] * camera["exposure_ms"] / longest, 64.0
    if gain > most:
        raise InputError(
            f"exposure {camera['exposure_ms']:g} ms at {rate_hz:g} Hz needs an analogue gain of {gain:.3g}",
            key=key, allowed=f"gains up to {most:g}: at most {rate_hz * most / gain:.3g} Hz, or more light",
        )  # fmt: skip
    camera |= {"exposure_ms": longest, "analogue_gain": gain}


def all_of(base: Scene, rig: RigPlan) -> dict[str, dict[str, Any]]:
    """Return the effects of a rig: those of the scene, overridden by those drawn."""
    return {**base.as_dict().get("effects", {}), **rig.effects}


def _set(data: dict[str, Any], dotted: str, value: Any) -> None:
    *parents, last = dotted.split(".")
    table: Any = data
    for part in parents:
        table = table.get(part) if isinstance(table, dict) else None
    if not isinstance(table, dict):
        raise InputError("is not in a table of a scene", key=f"rig.draw.'{dotted}'", allowed="a dotted key of a scene")
    table[last] = value


def bin_pixels(camera: dict[str, Any], scale: float) -> None:
    """Bin pixels: the same view and exposure on fewer, larger pixels, with charges and noise variances added."""
    if scale == 1.0:
        return
    cols, rows = camera["resolution_px"]
    camera["resolution_px"] = [max(8, round(cols * scale)), max(8, round(rows * scale))]
    camera["scale_px_per_mm"] *= scale
    camera["principal_point_offset_px"] = [scale * v for v in camera["principal_point_offset_px"]]
    pixel = camera["pixel"]
    pixel["pitch_um"] /= scale
    pixel["full_well_capacity_e"] /= scale**2
    pixel["conversion_gain_e_per_DN"] /= scale**2
    pixel["read_noise_e"] /= scale


def _windowed(effects: dict[str, dict[str, Any]], camera: dict[str, Any], base: Scene) -> None:
    """Let effects of a rolling shutter last as long as the rows that a region reads out."""
    rows, full = camera["resolution_px"][1] * base.camera.scale_px_per_mm / camera["scale_px_per_mm"], base.camera
    for name in ROLLING & effects.keys():
        whole = all_effects()[name].parameters.model_validate(effects[name]).model_dump(mode="json")
        effects[name] = {**whole, "readout_ms": whole["readout_ms"] * rows / full.resolution_px[1]}


ROLLING = {"rolling_shutter", "rolling_skew"}
"""Effects with the time from the first row's exposure to the last row's."""


def plate_grid(scene: Scene, config: DatasetConfig) -> PlateGrid:
    """Return the sampling of the contact plane, about the finger's position."""
    n = config.labels.grid_samples
    return PlateGrid((n, n), config.labels.grid_size_mm / n, scene.finger.position_mm)


@dataclass(frozen=True)
class RigWithEffects:
    """A rig with a finger, with its effects applied.

    Attributes
    ----------
    scene : Scene
        After effects of the stage ``rig``, evaluated at time 0.
    effects : tuple of Active
        All that act.
    left_out : tuple of str
        Effects that were drawn for the rig but do not apply to this finger.
    """

    scene: Scene
    effects: tuple[Active, ...]
    left_out: tuple[str, ...]


def rig_with_effects(scene: Scene, seed: int, contact: ContactState | None = None) -> RigWithEffects:
    """Apply a rig's effects to its scene; leave out those that do not apply to the finger.

    Parameters
    ----------
    scene : Scene
        From :func:`rig_scene`.
    seed : int
    contact : ContactState, optional
        A contact of this finger, to which effects of the contact are applied as a test.

    Raises
    ------
    InputError
        If the scene's effects are not valid.
    """
    kept: list[Active] = []
    left_out: list[str] = []
    real = scene
    for entry in active_effects(scene):
        stage = entry.effect.stage
        try:
            if stage is Stage.RIG:
                changed = apply_stage(stage, real, (entry,), Context(real, seed))
                ridges = changed.finger.ridges
                if ridges is not None and ridges.rounding_um is not None:
                    raise InputError("rounded ridges do not slide here")
                real = changed
            elif stage is Stage.CONTACT and contact is not None:
                apply_stage(stage, contact, (entry,), Context(real, seed))
        except InputError:
            left_out.append(entry.effect.id)
            continue
        kept.append(entry)
    if left_out:
        real = real.model_copy(update={"effects": {k: v for k, v in real.effects.items() if k not in left_out}})
    return RigWithEffects(real, tuple(kept), tuple(left_out))


OPTICAL_KEYS = (
    "tip_radius_mm",
    "diameter_mm",
    "length_mm",
    "position_mm",
    "refractive_index",
    "diffuse_reflectance",
    "scattering_length_mm",
    "scattering_share",
)
"""Keys of the finger that the optics depend on; mechanics and ridges act through the contact alone."""


def optical_scene(scene: Scene) -> Scene:
    """Return a scene whose finger has its optical keys only, so that fingers of one shape share a camera."""
    seen = {key: getattr(scene.finger, key) for key in OPTICAL_KEYS}
    return scene.model_copy(update={"finger": Finger(**seen), "liquid": None})


class RigCamera:
    """Camera, light and plate of one rig.

    Parameters
    ----------
    rig : RigWithEffects
        From :func:`rig_with_effects`.
    seed : int
        Of the rig: fixed patterns (specks, hot pixels) are the same in all its frames.
    backend : {"numpy", "llvm"}

    Attributes
    ----------
    scene : Scene
        The rig with its effects, by :func:`optical_scene`, as its LEDs' light sees it.
    readout_s : float
        From the first row's exposure to the last row's [s]; 0: all at once.
    method : {"fast", "general"}
        ``fast``: the fast camera, effects folded into it (:class:`~evanesce.chain.fast_effects.FastEffects`).
        ``general``: the general chain, where camera or effects need it.
    why : str
        What needs the general chain; empty if nothing does.
    """

    def __init__(self, rig: RigWithEffects, seed: int, backend: str = "numpy") -> None:
        self._effects, self.seed = rig.effects, seed
        self.readout_s = sum(1e-3 * readout_ms(e) for e in rig.effects if e.effect.id in ITS_TRIALS_MOTION)
        self.scene = seen_at(optical_scene(rig.scene))
        fast = FastCamera(self.scene.model_copy(update={"effects": {}}), backend)  # type: ignore[arg-type]
        self.why, self._fast = fast.falls_back, None
        if not self.why:
            try:
                self._fast = FastEffects(fast, self.scene, self._effects, seed)
            except NotFast as reason:
                self.why = f"effects: {reason}"
        self.method = "general" if self.why else "fast"

    def load(self, index: int, time_s: float, force_N: float) -> float:
        """Return the actual normal force for a commanded one [N]."""
        return float(apply_stage(Stage.LOAD, force_N, self._effects, self._context(index, time_s)))

    def contact(self, state: ContactState, index: int, time_s: float) -> ContactState:
        """Return a contact with the rig's effects applied."""
        changed: ContactState = apply_stage(Stage.CONTACT, state, self._effects, self._context(index, time_s))
        return changed

    def frame(
        self, state: ContactState | None, *, index: int, time_s: float, with_raw: bool, grid: PlateGrid | None = None
    ) -> Frame:
        """Expose a frame; ``index`` is its number in the dataset, so that no two frames share their noise.

        ``grid`` is the whole of which the states of a rig have parts; by default the state's own.
        """
        if self._fast is not None:
            return self._fast.frame(state, index=index, time_s=time_s, with_raw=with_raw, grid=grid)
        whole = state if state is None or grid is None else embedded(state, grid)
        light = render_fast(self.scene, whole)
        return expose(self.scene, light, seed=self.seed, time_s=time_s, index=index)[1]

    def _context(self, index: int, time_s: float) -> Context:
        return Context(self.scene, self.seed, time_s, index)


def readout_ms(entry: Active) -> float:
    """Return the time from the first row's exposure to the last row's of an effect of a rolling shutter [ms]."""
    return float(entry.parameters.model_dump()["readout_ms"])
