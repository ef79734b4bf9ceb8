"""The last operators of a frame by backend: coupling by gap, and from mean charge to a noisy 8-bit frame.

Each exists twice, as one Dr.Jit kernel and in NumPy, with the same numbers within float32's rounding. Noise is a
function of seed, frame and pixel alone: a hash of the pixel's number gives 32 bits, whose halves are looked up in a
table of normal quantiles, one for shot noise and one for read noise.

Shot noise is Poisson's to its third moment: mean + sqrt(mean) z + (z^2 - 1)/6 min(mean, 1), the first terms of the
Cornish-Fisher expansion. Below some ten electrons Poisson's steps would show; read noise of a few electrons hides them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from evanesce.render.fast.operators_llvm import begin_dark, coupling_llvm, expose_llvm
from evanesce.render.fast.operators_numpy import coupling_numpy, expose_numpy
from evanesce.render.fast.readout import ChargeBox, Readout

Image = NDArray[np.float32]
Backend = Literal["llvm", "numpy"]


@dataclass
class Exposure:
    """An exposure in two steps, of which the first needs no light.

    Attributes
    ----------
    readout : Readout
    keys : tuple of int
    with_raw : bool
    backend : str
    """

    readout: Readout
    keys: tuple[int, int]
    with_raw: bool
    backend: Backend
    _begun: Any = None

    def begin(self) -> None:
        """Start what needs no light, where it can run beside other work."""
        if self.backend == "llvm" and not self.with_raw:
            self._begun = begin_dark(self.readout, self.keys)

    def finish(self, lit: ChargeBox) -> tuple[NDArray[Any], NDArray[np.uint16] | None]:
        """Return 8-bit frame, of a colour camera the balanced mosaic, and, if asked for, raw numbers."""
        if self.backend == "llvm":
            return expose_llvm(lit, self.readout, self.keys, with_raw=self.with_raw, begun=self._begun)
        return expose_numpy(lit, self.readout, self.keys, with_raw=self.with_raw)


@dataclass(frozen=True)
class Operators:
    """The fused operators of one backend."""

    coupling: Callable[[Image, Image, float, Image], Image]
    exposure: Callable[[Readout, tuple[int, int], bool], Exposure]


def operators(backend: Backend) -> Operators:
    """Return the operators of a backend; llvm has to work (:func:`~evanesce.render.fast.operators_llvm.llvm_works`).

    Parameters
    ----------
    backend : {"llvm", "numpy"}
    """

    def exposure(readout: Readout, keys: tuple[int, int], with_raw: bool) -> Exposure:
        return Exposure(readout, keys, with_raw, backend)

    return Operators(coupling_llvm if backend == "llvm" else coupling_numpy, exposure)
