"""Finite elements: a rubber finger pressed on rigid glass and slid; only solving needs the extra ``fem``."""
