"""The frozen thresholds and priors, and their digest."""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources


@dataclass(frozen=True)
class Frozen:
    """Contents of ``frozen.toml``, table by table.

    Attributes
    ----------
    levels, noise, nuisances, priors, search : mapping of str to float
    digest : str
        SHA-256 of the file.
    """

    levels: Mapping[str, float]
    noise: Mapping[str, float]
    nuisances: Mapping[str, float]
    priors: Mapping[str, float]
    search: Mapping[str, float]
    digest: str


def load_frozen() -> Frozen:
    """Read the file that stands beside this module."""
    data = resources.files("evanesce.prediction").joinpath("frozen.toml").read_bytes()
    tables = tomllib.loads(data.decode("utf-8"))
    return Frozen(
        levels=tables["levels"],
        noise=tables["noise"],
        nuisances=tables["nuisances"],
        priors=tables["priors"],
        search=tables["search"],
        digest=hashlib.sha256(data).hexdigest(),
    )


FROZEN = load_frozen()
