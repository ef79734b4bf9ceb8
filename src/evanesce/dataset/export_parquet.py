"""Export to Parquet: one row per frame with all numbers of frame and trial, without images."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from evanesce.dataset.export import Advance
from evanesce.dataset.numbers import SCALARS
from evanesce.dataset.read import Dataset

FILE = "frames.parquet"


def flat(meta: dict[str, Any]) -> dict[str, Any]:
    """Return a frame's metadata as one row; tables of a rig as JSON text."""
    row = {name: meta[name] for name in ("key", "index", "trial", "frame_in_trial", "kind", "split")}
    row |= meta["scalars"]
    row |= {name: meta[name] for name in ("onset_first_slip_s", "onset_gross_slip_s")}
    for table in ("finger", "friction"):
        row |= {f"{table}.{name}": value for name, value in meta[table].items()}
    row |= {f"programme.{name}": value for name, value in meta["programme"].items()}
    row |= {"rig.index": meta["rig"]["index"], "rig.seed": meta["rig"]["seed"]}
    row |= {f"rig.{name}": json.dumps(meta["rig"][name], sort_keys=True) for name in ("changes", "effects", "left_out")}
    return row


def write(dataset: Dataset, folder: Path, advance: Advance) -> None:
    """Write ``frames.parquet``; units are metadata of the columns."""
    rows = []
    for sample in dataset:
        rows.append(flat(sample.meta))
        advance(1)
    table = pa.Table.from_pylist(rows)
    fields = [field.with_type(pa.float64()) if pa.types.is_null(field.type) else field for field in table.schema]
    fields = [
        field.with_metadata({"unit": SCALARS[field.name]}) if field.name in SCALARS else field for field in fields
    ]
    schema = pa.schema(fields, metadata={"config_sha256": dataset.job.digest})
    pq.write_table(table.cast(schema), folder / FILE)
