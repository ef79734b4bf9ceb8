"""The last operators of a frame as Dr.Jit kernels: coupling by gap, and exposure.

Dr.Jit is imported where it is used: elsewhere nothing needs it.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.render.fast.readout import NORMALS, ChargeBox, DarkSteps, Readout, dark_steps, normal_table

Image = NDArray[np.float32]


def llvm_works() -> bool:
    """Tell whether Dr.Jit's LLVM backend runs here; the first call prepares it."""
    from evanesce.render.variant import VariantInfo, select

    try:
        info: VariantInfo = select("llvm")
    except Exception:  # any failure of a foreign library means: not here
        return False
    return info.is_jit


@functools.cache
def _coupling_kernel(steps: int) -> Any:
    """Return the kernel of :func:`coupling_llvm` for a table's length less 1."""
    import drjit as dr
    from drjit.llvm import Float, UInt32

    def coupling(gap: Any, share: Any, table: Any, scale: Any) -> Any:
        index = dr.sqrt(dr.minimum(gap * scale, 1.0)) * float(steps)
        return dr.fma(dr.gather(Float, table, UInt32(index + 0.5)), 1.0 - share, share)

    return dr.freeze(coupling)


def _random_bits(index: Any, keys: Any) -> Any:
    """Return :func:`~evanesce.render.fast.operators_numpy.pixel_bits` in Dr.Jit arithmetic."""
    from drjit.llvm import UInt32

    def mix(x: Any) -> Any:
        for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
            x = (x ^ (x >> shift)) * UInt32(factor)
        return x ^ (x >> 16)

    return mix(mix(index + keys[0]) ^ keys[1])


@functools.lru_cache(maxsize=8)
def _dark_kernel(pixels: int, steps: DarkSteps) -> Any:
    """Return the kernel of a frame without light."""
    import drjit as dr
    from drjit.llvm import UInt8, UInt32

    def dark(keys: Any) -> Any:
        high = _random_bits(dr.arange(UInt32, pixels), keys) >> 16
        value = UInt32(steps.base)
        for position, rise in steps.rises:
            value += dr.select(high >= position, UInt32(rise), UInt32(0))
        return UInt8(value)

    return dr.freeze(dark)


@functools.lru_cache(maxsize=8)
def _exposure_kernel(cols: int, camera: tuple[float, float, float, float, float], top: int) -> Any:
    """Return the kernel of a box of charge; the camera's constants are compiled into it."""
    import drjit as dr
    from drjit.llvm import Float, UInt8, UInt32

    dark, well, noise, gain, black = camera

    def expose(charge: Any, box: Any, per_width: Any, normals: Any, tone: Any, keys: Any) -> Any:
        i = dr.arange(UInt32, dr.width(charge))
        first, width = box
        # Row by a product with 1/width, which is one off at most.
        y = UInt32(Float(i) * per_width)
        y = dr.select(y * width > i, y - 1, y)
        y = dr.select(i - y * width >= width, y + 1, y)
        bits = _random_bits(first + y * cols + (i - y * width), keys)
        mean: Any = dr.maximum(charge + dark, 0.0)
        z = dr.gather(Float, normals, bits & (NORMALS - 1))
        collected = mean + dr.sqrt(mean) * z + (z * z - 1.0) * dr.minimum(mean, 1.0) * (1.0 / 6.0)
        collected = dr.minimum(collected, well)
        signal = dr.gather(Float, normals, bits >> 16) * noise + collected
        number = UInt32(dr.clip(signal * gain + black, 0.0, float(top)))
        return dr.gather(UInt8, tone, number), number

    return dr.freeze(expose)


@functools.lru_cache(maxsize=4)
def _device_tone(tone: bytes) -> Any:
    from drjit.llvm import UInt8

    return UInt8(np.frombuffer(tone, np.uint8))


@functools.cache
def _device_normals() -> Any:
    from drjit.llvm import Float

    return Float(normal_table())


def _expose_box(lit: ChargeBox, readout: Readout, keys: Any) -> tuple[NDArray[np.uint8], NDArray[np.uint32]]:
    """Return 8-bit values and raw numbers of a box of charge."""
    import drjit as dr
    from drjit.llvm import Float, UInt32

    rows, cols = lit.charge.shape
    scalars = (readout.dark_e, readout.full_well_e, readout.read_noise_e, readout.gain, readout.black_DN + 0.5)
    found = _exposure_kernel(readout.shape[1], scalars, readout.tone.size - 1)(
        Float(np.ascontiguousarray(lit.charge, np.float32).ravel()),
        tuple(dr.opaque(UInt32, n) for n in (lit.row * readout.shape[1] + lit.col, cols)),
        dr.opaque(Float, 1.0 / cols),
        _device_normals(),
        _device_tone(readout.tone.tobytes()),
        keys,
    )
    dr.eval(found)
    dr.sync_thread()
    data, raw = (np.asarray(np.array(f, copy=False)).reshape(rows, cols) for f in found)
    return data, raw


def _llvm_keys(keys: tuple[int, int]) -> Any:
    import drjit as dr
    from drjit.llvm import UInt32

    return tuple(dr.opaque(UInt32, int(k)) for k in keys)


def begin_dark(readout: Readout, keys: tuple[int, int]) -> Any:
    """Start the kernel of a frame without light, if there is one, and return its pixels; other work goes on.

    Parameters
    ----------
    readout : Readout
    keys : tuple of int
        Two words of 32 bits that the noise depends on.

    Returns
    -------
    drjit.llvm.UInt8 or None
    """
    import drjit as dr

    steps = dark_steps(readout)
    if steps is None:
        return None
    found = _dark_kernel(readout.shape[0] * readout.shape[1], steps)(_llvm_keys(keys))
    dr.eval(found)
    return found


def expose_llvm(
    lit: ChargeBox, readout: Readout, keys: tuple[int, int], *, with_raw: bool = False, begun: Any = None
) -> tuple[NDArray[np.uint8], NDArray[np.uint16] | None]:
    """Return what :func:`~evanesce.render.fast.operators_numpy.expose_numpy` does.

    By two kernels: all pixels as if dark, then those of the box.

    ``begun`` is the first, where it runs already.

    Parameters
    ----------
    lit, readout, keys, with_raw
        As for :func:`~evanesce.render.fast.operators_numpy.expose_numpy`.
    begun : drjit.llvm.UInt8, optional
        Of :func:`begin_dark`, where it runs already.
    """
    words = _llvm_keys(keys)
    raw: NDArray[Any] | None = None
    begun = begin_dark(readout, keys) if begun is None and not with_raw else begun
    box = _expose_box(lit, readout, words) if lit.charge.size else None
    if begun is not None and not with_raw:
        # Kernels end in the order of their start: once the box is done, so is the rest.
        if box is None:
            import drjit as dr

            dr.sync_thread()
        data = np.asarray(np.array(begun, copy=False))
        # Where read noise is so low that all dark pixels read alike, there is one number for them.
        data = np.full(readout.shape, data.ravel()[0], np.uint8) if data.size == 1 else data.reshape(readout.shape)
    else:
        data, raw = _expose_box(ChargeBox(0, 0, np.zeros(readout.shape, np.float32)), readout, words)
        raw = raw.astype(np.uint16)
    if box is not None:
        here = np.s_[lit.row : lit.row + lit.charge.shape[0], lit.col : lit.col + lit.charge.shape[1]]
        data[here] = box[0]
        if raw is not None:
            raw[here] = box[1]
    return data, raw if with_raw else None


def coupling_llvm(gap: Image, share: Image, end: float, table: Image) -> Image:
    """Return the same as :func:`~evanesce.render.fast.operators_numpy.coupling_numpy`, by one kernel.

    Parameters
    ----------
    gap, share, end, table
        As for :func:`~evanesce.render.fast.operators_numpy.coupling_numpy`.
    """
    import drjit as dr
    from drjit.llvm import Float

    found = _coupling_kernel(table.size - 1)(
        Float(np.ascontiguousarray(gap).ravel()),
        Float(np.ascontiguousarray(share).ravel()),
        Float(np.ascontiguousarray(table)),
        dr.opaque(Float, 1.0 / end),
    )
    dr.eval(found)
    dr.sync_thread()
    return np.asarray(np.array(found, copy=False)).reshape(gap.shape)
