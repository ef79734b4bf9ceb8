"""Export to Rerun recordings: frames, surface states and numbers over time; a file a trial."""

from __future__ import annotations

from pathlib import Path

import rerun as rr

from evanesce.core.states import SurfaceState
from evanesce.dataset.export import Advance
from evanesce.dataset.numbers import SCALARS
from evanesce.dataset.preview import COLOURS
from evanesce.dataset.read import Dataset

NAME = "trial-{:06d}.rrd"
FRAME, STATE = "camera/frame", "camera/frame/state"
TIME = "time"


def write(dataset: Dataset, folder: Path, advance: Advance) -> None:
    """Write each trial's frames with the states over them, and its numbers as curves, units in their names."""
    for trial, indices in dataset.trials().items():
        recording = rr.RecordingStream("evanesce", recording_id=f"trial-{trial:06d}")
        recording.save(folder / NAME.format(trial))
        classes = [rr.AnnotationInfo(int(s), s.name.lower(), COLOURS.get(s, (0, 0, 0, 0))) for s in SurfaceState]
        recording.log("camera", rr.AnnotationContext(classes), static=True)
        for i in indices:
            sample = dataset[i]
            recording.set_time(TIME, duration=sample.scalars["time_s"])
            recording.log(FRAME, rr.EncodedImage(contents=sample.bytes_of("frame.png"), media_type="image/png"))
            recording.log(STATE, rr.SegmentationImage(sample.state, opacity=0.5))
            for name in SCALARS:
                if name != "time_s":
                    recording.log(f"numbers/{name}", rr.Scalars([sample.scalars[name]]))
            advance(1)
        recording.flush()
        recording.disconnect()
