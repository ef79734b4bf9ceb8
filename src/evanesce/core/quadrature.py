"""Nodes and weights of Gauss and Legendre, computed once: they cost more than most sums that use them."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


@cache
def gauss_legendre(count: int) -> tuple[Array, Array]:
    """Return the nodes on [-1, 1] and weights (count,) of Gauss-Legendre quadrature; read-only.

    Parameters
    ----------
    count : int
    """
    nodes, weights = np.polynomial.legendre.leggauss(count)
    nodes.setflags(write=False)
    weights.setflags(write=False)
    return nodes, weights
