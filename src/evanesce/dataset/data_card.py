"""Write the files beside the shards: JSON schema of KEY.json, and data card in the Croissant format."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.contact.analytic.hertz import hertz_pressure, hertz_radius
from evanesce.contact.ridges.profile import closure_pressure, contact_edge, profile_exponent
from evanesce.dataset import baselines, layout
from evanesce.dataset.audit_checks import TEXTURED
from evanesce.dataset.config import CHANNELS, KINDS, SLIDING
from evanesce.dataset.config_motion import MOTIONS
from evanesce.dataset.design import TrialPlan, trial_plan
from evanesce.dataset.distributions import constant
from evanesce.dataset.job import Job
from evanesce.dataset.manifest import Manifest
from evanesce.dataset.numbers import MEANINGS, SCALARS
from evanesce.dataset.rigs import EXPOSED
from evanesce.materials import material

CROISSANT = "http://mlcommons.org/croissant/1.0"
COUNTED_TRIALS = 1000
"""Number of trials that the card counts ridges of."""
RINGS = 16
"""Of a contact's inner half, whose mean is then within 0.01 of the integral."""
RESPONSIBLE = "http://mlcommons.org/croissant/RAI/1.0"


def write_data_card(folder: Path, job: Job, manifest: Manifest) -> None:
    """Write schema and data card atomically."""
    layout.write_json(folder / layout.SCHEMA, schema())
    layout.write_json(folder / layout.DATA_CARD, croissant(job, manifest))


def schema() -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of a frame's ``json`` member."""
    number, text, whole = {"type": "number"}, {"type": "string"}, {"type": "integer", "minimum": 0}
    maybe = {"type": ["number", "null"]}
    table = {"type": "object"}
    scalars = {name: {"type": "number", "description": _description(name)} for name in SCALARS}
    properties = {
        "key": {"type": "string", "pattern": "^[0-9]{9}$"},
        "index": whole,
        "trial": whole,
        "frame_in_trial": whole,
        "kind": {"enum": list(KINDS)},
        "split": {"enum": ["train", "validation", "test"]},
        "scalars": {"type": "object", "properties": scalars, "required": list(SCALARS), "additionalProperties": False},
        "markers": {
            "type": "array",
            "description": "dots that touch: number on the finger, place on plate and in the frame, displacement",
            "items": {**table, "additionalProperties": number},
        },
        "onset_first_slip_s": {**maybe, "description": "[s] from the trial's start; null: not in this trial"},
        "onset_gross_slip_s": {**maybe, "description": "[s] from the trial's start; null: not in this trial"},
        "finger": {**table, "required": ["index", "material", "pattern", "ridge_pitch_um"]},
        "friction": {**table, "required": ["index", "friction_coefficient"]},
        "rig": {**table, "required": ["index", "seed", "changes", "effects", "left_out"]},
        "camera": {
            **table,
            "description": "as it took the frames, a drawn exposure cut to the frame rate",
            "properties": {
                "scale_px_per_mm": number,
                "exposure_ms": number,
                "analogue_gain": number,
                "readout_ms": number,
            },
            "required": ["scale_px_per_mm", "exposure_ms", "analogue_gain", "readout_ms"],
        },
        "programme": {**table, "additionalProperties": number},
        "motion": {**table, "additionalProperties": number},
        "liquid": {**table, "additionalProperties": number},
        "seed": whole,
        "config_sha256": text,
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A frame of an evanesce dataset",
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _description(name: str) -> str:
    """Return unit and meaning of a number."""
    return f"[{SCALARS[name]}] {MEANINGS.get(name, '')}".rstrip()


def croissant(job: Job, manifest: Manifest) -> dict[str, Any]:
    """Return the data card as JSON-LD in the Croissant 1.0 format."""
    numbers = _field("frames/numbers", "json-files", "sc:Text", "all numbers of the frame and its trial: schema.json")
    fields = [_key("frames", "json-files"), numbers]
    for name, path, kind, text in _NUMBERS:
        fields.append(_field(f"frames/{name}", "json-files", kind, text, {"jsonPath": f"$.{path}"}))
    pictures = [
        _key("images", "frame-png-files"),
        _field("images/frame", "frame-png-files", "sc:ImageObject", "8-bit frame [DN]"),
    ]
    kinds, (cols, rows) = ", ".join(kind for kind in KINDS if kind not in SLIDING), job.resolution
    labels = job.config.labels
    names = [
        name for name in CHANNELS if name == "state" or name in labels.channels("frame") + labels.channels("plate")
    ]
    units = "; ".join(f"{name} [{CHANNELS[name]}]" for name in names)
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": [CROISSANT, RESPONSIBLE],
        "name": (job.config.title or job.scene.title or "evanesce dataset").replace("/", " "),
        "description": (
            f"{len(manifest.frames())} simulated frames of {job.trials} presses and slides of a silicone finger on an"
            f" FTIR tactile plate at {job.config.trial.frame_rate_hz:g} Hz, {cols} x {rows} px, with per-pixel truth:"
            f" {units}. Negatives: {kinds}. Labels are in the distorted frame (mask.png, and where asked for"
            " labels.exr) and on the undistorted plate plane (where asked for plate.exr), on a fixed physical scale. No"
            f" {' and no '.join(job.config.split.by.split('_'))} is in two splits. {_composition(job)}"
            " Simulated, not measured: Hertz with partial slip, ridges in two scales."
            f" {_effects(job)}{_exposure(job)}{_besides(job)}"
        ),
        "rai:dataUseCases": f"Training and testing detectors of incipient slip. {baselines.summary()}",
        "rai:dataLimitations": (
            "No real finger was measured: how well a detector trained here generalises to a real rig is not known."
            " No inertia; ridges slip by the scale of the whole contact; processes of minutes, such as warming LEDs,"
            " are held constant."
        ),
        "version": f"{layout.FORMAT_VERSION}.0.0",
        "citeAs": f"evanesce dataset, configuration {job.digest[:16]}, seed {job.seed}",
        "distribution": _distribution(job, manifest),
        "recordSet": [
            {"@type": "cr:RecordSet", "@id": name, "name": name, "field": those}
            for name, those in (("frames", fields), ("images", pictures))
        ],
    }


def _distribution(job: Job, manifest: Manifest) -> list[dict[str, Any]]:
    """Return the shards, and the sets of members in them."""
    shards = manifest.shards()
    files: list[dict[str, Any]] = [
        {
            "@type": "cr:FileObject",
            "@id": row["file"],
            "name": row["file"],
            "contentUrl": f"{layout.SHARDS}/{row['file']}",
            "contentSize": f"{row['size']} B",
            "encodingFormat": "application/x-tar",
            "sha256": row["sha256"],
        }
        for row in shards.values()
    ]
    sets = [
        {
            "@type": "cr:FileSet",
            "@id": f"{extension.replace('.', '-')}-files",
            "name": f"{extension.replace('.', '-')}-files",
            "containedIn": [{"@id": row["file"]} for row in shards.values()],
            "encodingFormat": kind,
            "includes": f"*.{extension}",
        }
        for extension, kind in _members(job).items()
    ]
    return files + sets


def _effects(job: Job) -> str:
    """Return a sentence on which effects are randomised, and which are not."""
    options = job.config.randomisation
    drawn, left_out = options.candidates, "; ".join(f"{name} ({why})" for name, why in options.left_out.items())
    if not drawn:
        return "No effects are randomised."
    shares = [
        f"{e} in {100 * options.probability_of(e):g} %, at {options.strength_of(e):g} times its size"
        for e in drawn
        if e in options.effects
    ]
    own = f" But {'; '.join(shares)}." if shares else ""
    return (
        f"Each of these effects is on in {100 * options.probability:g} % of the rigs: {', '.join(drawn)}.{own} A trial"
        f" whose finger an effect does not apply to is made without it, and lists it. Not drawn: {left_out}."
    )


def _exposure(job: Job) -> str:
    """Return a sentence on exposures that the frame rate shortens."""
    longest = EXPOSED * 1e3 / job.config.trial.frame_rate_hz
    exposure = job.config.rig.draw.get("camera.exposure_ms", constant(job.scene.camera.exposure_ms))
    if float(exposure.support()[1]) <= longest:
        return ""
    return f" Exposures last at most {longest:.3g} ms; gain keeps the mean level, and noise grows."


def _besides(job: Job) -> str:
    """Return sentences on motions, liquid and markers, where there are any."""
    config, found = job.config, ""
    if shares := [f"{name} {100 * s:g} %" for name in MOTIONS if (s := getattr(config.motion, name))]:
        found += f" Of the slides have, each drawn independently: {', '.join(shares)}."
    if config.liquid.share:
        found += f" {100 * config.liquid.share:g} % of the trials are wet."
    if config.markers.pitch_mm:
        marks = config.markers
        found += f" Dots {marks.diameter_mm:g} mm wide and {marks.pitch_mm:g} mm apart are printed on the skin."
    return found


def _composition(job: Job) -> str:
    """Return a sentence on ridges and friction of the trials."""
    plans = [trial_plan(job.config, job.seed, index) for index in range(min(job.trials, COUNTED_TRIALS))]
    ridged = [plan.finger for plan in plans if plan.finger.pattern]
    if not ridged:
        return "No finger has ridges."
    heights, pitches = ([getattr(f, name) for f in ridged] for name in ("ridge_height_um", "ridge_pitch_um"))
    return (
        f"{100 * len(ridged) / len(plans):.0f} % of the trials are of fingers with ridges {min(heights):.0f} to"
        f" {max(heights):.0f} um high and {min(pitches):.0f} to {max(pitches):.0f} um apart; of which the contact's"
        f" core keeps texture in {100 * sum(map(_keeps_texture, plans)) / len(plans):.0f} % of all trials."
    )


def _keeps_texture(plan: TrialPlan) -> bool:
    """Return whether as much of the contact's inner half stays open under the held force as the audit asks for.

    Ridges close under Hertz's pressure; radii are those of rings of equal area.
    """
    finger, force = plan.finger, plan.programme["normal_force_N"]
    if not finger.pattern:
        return False
    modulus = float(material(finger.material).reduced_modulus(force))
    radius = float(hertz_radius(force, finger.tip_radius_mm, modulus))
    inner = 0.5 * radius * np.sqrt((np.arange(RINGS) + 0.5) / RINGS)
    exponent = profile_exponent(finger.ridge_width_um, finger.ridge_pitch_um)
    closes = closure_pressure(modulus, finger.ridge_height_um, finger.ridge_pitch_um, exponent)
    edge = contact_edge(hertz_pressure(inner, force, radius), closes, exponent)
    return float(1.0 - (2.0 / math.pi * np.arcsin(edge)).mean()) >= TEXTURED


def _members(job: Job) -> dict[str, str]:
    found = {"frame.png": "image/png", "mask.png": "image/png"}
    files = {"labels.exr": job.config.labels.frame, "plate.exr": job.config.labels.plate}
    found |= {name: "image/x-exr" for name, channels in files.items() if channels}
    if job.config.labels.raw:
        found["raw.png"] = "image/png"
    return {**found, "json": "application/json"}


_NUMBERS = (
    ("index", "index", "sc:Integer", "number of the frame; its key is this number in nine digits"),
    ("trial", "trial", "sc:Integer", "number of its trial"),
    ("kind", "kind", "sc:Text", "kind of the trial"),
    ("split", "split", "sc:Text", "train, validation or test"),
    *((name, f"scalars.{name}", "sc:Float", f"[{unit}]") for name, unit in SCALARS.items()),
)


def _key(records: str, files: str) -> dict[str, Any]:
    regex = {"regex": r"^(\d{9})\."}
    return _field(f"{records}/key", files, "sc:Text", "key of the frame", regex, of="filename")


def _field(
    name: str, files: str, kind: str, description: str, transform: dict[str, str] | None = None, of: str = "content"
) -> dict[str, Any]:
    source = {"fileSet": {"@id": files}, "extract": {"fileProperty": of}}
    return {
        "@type": "cr:Field",
        "@id": name,
        "name": name,
        "description": description,
        "dataType": kind,
        "source": {**source, "transform": transform} if transform else source,
    }


_CONTEXT = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileProperty": "cr:fileProperty",
    "fileObject": "cr:fileObject",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "recordSet": "cr:recordSet",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}
