"""A measurement bundle on disk: what a lab measured, in a folder that it can fill by hand."""

from evanesce.bundle.layout import AUXILIARY, OBSERVABLES, Replicates, Series, Shot
from evanesce.bundle.read import Bundle, read_bundle, scene_at

__all__ = ["AUXILIARY", "OBSERVABLES", "Bundle", "Replicates", "Series", "Shot", "read_bundle", "scene_at"]
