"""A measurement bundle on disk: a lab's measurement in a folder that can be filled by hand."""

from evanesce.bundle.bundle import Bundle, scene_at
from evanesce.bundle.layout import AUXILIARY, OBSERVABLES, Replicates, Series, Shot
from evanesce.bundle.read import read_bundle

__all__ = ["AUXILIARY", "OBSERVABLES", "Bundle", "Replicates", "Series", "Shot", "read_bundle", "scene_at"]
