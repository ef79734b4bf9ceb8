"""The last operators of a frame as Dr.Jit kernels: coupling by gap, and exposure.

Dr.Jit is imported where it is used: elsewhere nothing needs it.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.threads import in_threads
from evanesce.render.fast.readout import NORMALS, ChargeBox, DarkSteps, Readout, dark_steps, dark_values, normal_table

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


def _row_of(i: Any, width: Any, per_width: Any) -> Any:
    """Return the row of element ``i`` of an array: by a product with 1/width, which is one off at most."""
    import drjit as dr
    from drjit.llvm import Float, UInt32

    y = UInt32(Float(i) * per_width)
    y = dr.select(y * width > i, y - 1, y)
    return dr.select(i - y * width >= width, y + 1, y)


@functools.lru_cache(maxsize=8)
def _dark_kernel(shape: tuple[int, int], steps: DarkSteps | None, values: int) -> Any:
    """Return the kernel of a frame without light; ``values`` for each place of a mosaic, 0 without one.

    With few steps a staircase is computed, else looked up: a table does not fit into a core's nearest cache.
    """
    import drjit as dr
    from drjit.llvm import UInt8, UInt32

    rows, cols = shape

    def dark(keys: Any, tone: Any, table: Any) -> Any:
        i = dr.arange(UInt32, rows * cols)
        high = _random_bits(i, keys) >> 16
        if steps is None:
            value = dr.gather(UInt32, table, high)
        else:
            value = UInt32(steps.base)
            for position, rise in steps.rises:
                value += dr.select(high >= position, UInt32(rise), UInt32(0))
        if values == 0:
            return UInt8(value)
        y = _row_of(i, cols, 1.0 / cols)
        place = ((y & 1) << 1) | ((i - y * cols) & 1)
        return dr.gather(UInt32, tone, place * values + value)

    return dr.freeze(dark)


@functools.lru_cache(maxsize=8)
def _exposure_kernel(
    cols: int, camera: tuple[float, float, float, float, float], top: int, share: tuple[float, ...]
) -> Any:
    """Return the kernel of a box of charge; the camera's constants are compiled into it."""
    import drjit as dr
    from drjit.llvm import Float, UInt8, UInt32

    dark, well, noise, gain, black = camera

    def expose(charge: Any, box: Any, per_width: Any, normals: Any, tone: Any, keys: Any) -> Any:
        i = dr.arange(UInt32, dr.width(charge))
        row, col, width = box
        y = _row_of(i, width, per_width)
        x = i - y * width + col
        y = y + row
        bits = _random_bits(y * cols + x, keys)
        place: Any = UInt32(0)
        if share:
            odd_row, odd_col = (y & 1) == 1, (x & 1) == 1
            upper = dr.select(odd_col, Float(share[1]), Float(share[0]))
            charge = charge * dr.select(odd_row, dr.select(odd_col, Float(share[3]), Float(share[2])), upper)
            place = ((y & 1) << 1) | (x & 1)
        mean: Any = dr.maximum(charge + dark, 0.0)
        z = dr.gather(Float, normals, bits & (NORMALS - 1))
        collected = mean + dr.sqrt(mean) * z + (z * z - 1.0) * dr.minimum(mean, 1.0) * (1.0 / 6.0)
        collected = dr.minimum(collected, well)
        signal = dr.gather(Float, normals, bits >> 16) * noise + collected
        number = UInt32(dr.clip(signal * gain + black, 0.0, float(top)))
        if share:
            return dr.gather(UInt32, tone, place * (top + 1) + number), number
        return dr.gather(UInt8, tone, number), number

    return dr.freeze(expose)


@functools.lru_cache(maxsize=4)
def _device_tone(tone: bytes, wide: bool) -> Any:
    from drjit.llvm import UInt8, UInt32

    # Dr.Jit has no integers of 16 bits.
    return UInt32(np.frombuffer(tone, np.uint16).astype(np.uint32)) if wide else UInt8(np.frombuffer(tone, np.uint8))


def _camera_key(readout: Readout) -> tuple[Any, ...]:
    return (
        readout.full_well_e, readout.read_noise_e, readout.gain, readout.black_DN, readout.share,
        readout.tone.shape, readout.tone.dtype.char,
    )  # fmt: skip


@functools.lru_cache(maxsize=4)
def _device_table(key: tuple[Any, ...], tone: bytes) -> Any:
    """Return the values of dark pixels on the device; without a key, which steps make needless, nothing."""
    from drjit.llvm import UInt32

    if not key:
        return UInt32(0)
    well, noise, gain, black, share, shape, kind = key
    readout = Readout((1, 1), 0.0, well, noise, gain, black, np.frombuffer(tone, kind).reshape(shape), share)
    return UInt32(dark_values(readout).astype(np.uint32))


@functools.cache
def _device_normals() -> Any:
    from drjit.llvm import Float

    return Float(normal_table())


def _expose_box(lit: ChargeBox, readout: Readout, keys: Any) -> tuple[NDArray[Any], NDArray[np.uint32]]:
    """Return what the raw numbers of a box of charge stand for, and the numbers."""
    import drjit as dr
    from drjit.llvm import Float, UInt32

    rows, cols = lit.charge.shape
    scalars = (readout.dark_e, readout.full_well_e, readout.read_noise_e, readout.gain, readout.black_DN + 0.5)
    found = _exposure_kernel(readout.shape[1], scalars, readout.top, readout.share)(
        Float(np.ascontiguousarray(lit.charge, np.float32).ravel()),
        tuple(dr.opaque(UInt32, n) for n in (lit.row, lit.col, cols)),
        dr.opaque(Float, 1.0 / cols),
        _device_normals(),
        _device_tone(readout.tone.tobytes(), bool(readout.share)),
        keys,
    )
    dr.eval(found)
    dr.sync_thread()
    data, raw = (np.asarray(np.array(f, copy=False)).reshape(rows, cols) for f in found)
    return data, raw


def _narrow(data: NDArray[Any], readout: Readout) -> NDArray[Any]:
    """Return values in the type of the camera's table."""
    kind = readout.tone.dtype
    if data.dtype == kind or data.size == 1:
        return data.astype(kind, copy=False)
    flat, found = data.reshape(readout.shape), np.empty(readout.shape, kind)

    def work(rows: range) -> None:
        found[rows.start : rows.stop] = flat[rows.start : rows.stop]

    in_threads(work, readout.shape[0], 64)
    return found


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
    drjit.llvm.UInt8 or UInt32, or None
    """
    import drjit as dr

    if readout.dark_e != 0.0:
        return None
    steps = dark_steps(readout)
    values = readout.top + 1 if readout.share else 0
    tone = _device_tone(readout.tone.tobytes(), bool(readout.share))
    table = _device_table(() if steps is not None else _camera_key(readout), readout.tone.tobytes())
    found = _dark_kernel(readout.shape, steps, values)(_llvm_keys(keys), tone, table)
    dr.eval(found)
    return found


def expose_llvm(
    lit: ChargeBox, readout: Readout, keys: tuple[int, int], *, with_raw: bool = False, begun: Any = None
) -> tuple[NDArray[Any], NDArray[np.uint16] | None]:
    """Return what :func:`~evanesce.render.fast.operators_numpy.expose_numpy` does.

    By two kernels: all pixels as if dark, then those of the box.

    ``begun`` is the first, where it runs already.

    Parameters
    ----------
    lit, readout, keys, with_raw
        As for :func:`~evanesce.render.fast.operators_numpy.expose_numpy`.
    begun : drjit.llvm.UInt8 or UInt32, optional
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
        data = _narrow(np.asarray(np.array(begun, copy=False)), readout)
        # Where read noise is so low that all dark pixels read alike, there is one number for them.
        data = np.full(readout.shape, data.ravel()[0], data.dtype) if data.size == 1 else data.reshape(readout.shape)
    else:
        data, raw = _expose_box(ChargeBox(0, 0, np.zeros(readout.shape, np.float32)), readout, words)
        data, raw = _narrow(data, readout), raw.astype(np.uint16)
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
