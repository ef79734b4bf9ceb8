"""Finite elements: a rubber finger pressed on and slid over rigid glass; solving needs the extra ``fem``, reading not."""
