"""The last operators of a frame in NumPy, on blocks of rows: coupling by gap, and exposure."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.threads import in_threads
from evanesce.render.fast.readout import NORMALS, ChargeBox, Readout, dark_steps, normal_table, raw_numbers

Image = NDArray[np.float32]

_BLOCK_PX = 48_000  # what fits into a core's cache


def _rows_of(shape: tuple[int, int]) -> int:
    """Return the rows of a block."""
    return max(1, _BLOCK_PX // shape[1])


def _mix(x: NDArray[np.uint32], work: NDArray[np.uint32]) -> None:
    """Scramble 32-bit words in place (C. Wellons's lowbias32, a bijection)."""
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        np.right_shift(x, np.uint32(shift), out=work)
        np.bitwise_xor(x, work, out=x)
        np.multiply(x, np.uint32(factor), out=x)
    np.right_shift(x, np.uint32(16), out=work)
    np.bitwise_xor(x, work, out=x)


def pixel_bits(first: int, count: int, keys: tuple[int, int]) -> NDArray[np.uint32]:
    """Return 32 random bits for pixels ``first`` to ``first + count``; two keyed rounds, so that frames differ.

    Parameters
    ----------
    first, count : int
    keys : tuple of int
        Two words of 32 bits.

    Returns
    -------
    ndarray of uint32 (count,)
    """
    x = np.arange(first, first + count, dtype=np.uint32)
    work = np.empty_like(x)
    np.add(x, np.uint32(keys[0]), out=x)
    _mix(x, work)
    np.bitwise_xor(x, np.uint32(keys[1]), out=x)
    _mix(x, work)
    return x


def _expose_rows(
    out: NDArray[Any], raw: NDArray[np.uint16] | None, rows: range, lit: ChargeBox, readout: Readout, keys: Any
) -> None:
    """Expose some rows: every pixel as if dark, then those of the box of charge."""
    cols = readout.shape[1]
    bits = pixel_bits(rows.start * cols, len(rows) * cols, keys).reshape(len(rows), cols)
    here = slice(rows.start, rows.stop)
    steps = dark_steps(readout)
    if readout.share:
        steps = None  # its values differ from place to place
    if steps is not None and raw is None:
        high = (bits >> np.uint32(16)).astype(np.uint16)
        out[here] = steps.base
        for position, rise in steps.rises:
            out[here] += (high >= np.uint16(position)).view(np.uint8) * np.uint8(rise)
    else:
        values = _quantised(np.full(bits.shape, readout.dark_e, np.float32), bits, readout)
        _look_up(values, (rows.start, 0), readout, out[here])
        if raw is not None:
            raw[here] = values
    r0, r1 = max(rows.start, lit.row), min(rows.stop, lit.row + lit.charge.shape[0])
    if r1 > r0:
        columns = slice(lit.col, lit.col + lit.charge.shape[1])
        charge = _filtered(lit.charge[r0 - lit.row : r1 - lit.row], (r0, lit.col), readout) + np.float32(readout.dark_e)
        values = _quantised(charge, bits[r0 - rows.start : r1 - rows.start, columns], readout)
        _look_up(values, (r0, lit.col), readout, out[r0:r1, columns])
        if raw is not None:
            raw[r0:r1, columns] = values


def _places(first: tuple[int, int]) -> list[tuple[int, tuple[slice, slice]]]:
    """Return each of a mosaic's places and its pixels in an array that begins at pixel ``first``."""
    return [(p, np.s_[(p // 2 - first[0]) % 2 :: 2, (p % 2 - first[1]) % 2 :: 2]) for p in range(4)]


def _filtered(charge: Image, first: tuple[int, int], readout: Readout) -> Image:
    """Return the charge behind the filters of a colour camera."""
    if not readout.share:
        return charge
    found = np.empty_like(charge)
    for place, here in _places(first):
        np.multiply(charge[here], np.float32(readout.share[place]), out=found[here])
    return found


def _look_up(values: NDArray[np.uint16], first: tuple[int, int], readout: Readout, out: NDArray[Any]) -> None:
    """Write what the raw numbers of an array that begins at pixel ``first`` stand for."""
    if not readout.share:
        out[...] = readout.tone.take(values)
        return
    for place, here in _places(first):
        out[here] = readout.tone[place].take(values[here])


def _quantised(charge: Image, bits: NDArray[np.uint32], readout: Readout) -> NDArray[np.uint16]:
    """Return raw numbers of mean charges."""
    return raw_numbers(_collected(charge, bits, readout), normal_table().take(bits >> np.uint32(16)), readout)


def _collected(charge: Image, bits: NDArray[np.uint32], readout: Readout) -> Image:
    """Return the charges of one exposure of mean charges [e-], up to the full well."""
    z = normal_table().take(bits & np.uint32(NORMALS - 1))
    charge = np.maximum(charge, np.float32(0))
    collected = charge + np.sqrt(charge) * z
    collected += (z * z - np.float32(1)) * np.minimum(charge, np.float32(1)) * np.float32(1 / 6)
    return np.minimum(collected, np.float32(readout.full_well_e), out=collected)


def signal_numpy(lit: ChargeBox, readout: Readout, keys: tuple[int, int]) -> Image:
    """Return the signal of a frame before quantisation, with the noise of :func:`expose_numpy` [DN].

    Parameters
    ----------
    lit : ChargeBox
    readout : Readout
    keys : tuple of int

    Returns
    -------
    ndarray of float32 (rows, cols)
    """
    out = np.empty(readout.shape, np.float32)

    def work(rows: range) -> None:
        here, cols = slice(rows.start, rows.stop), readout.shape[1]
        bits = pixel_bits(rows.start * cols, len(rows) * cols, keys).reshape(len(rows), cols)
        charge = np.full(bits.shape, readout.dark_e, np.float32)
        r0, r1 = max(rows.start, lit.row), min(rows.stop, lit.row + lit.charge.shape[0])
        if r1 > r0:
            some = lit.charge[r0 - lit.row : r1 - lit.row]
            lit_part = charge[r0 - rows.start : r1 - rows.start, lit.col : lit.col + some.shape[1]]
            lit_part += _filtered(some, (r0, lit.col), readout)
        read = normal_table().take(bits >> np.uint32(16)) * np.float32(readout.read_noise_e)
        out[here] = (_collected(charge, bits, readout) + read) * np.float32(readout.gain) + np.float32(readout.black_DN)

    in_threads(work, readout.shape[0], _rows_of(readout.shape))
    return out


def developed_numpy(raw: NDArray[np.uint16], readout: Readout) -> NDArray[Any]:
    """Return what raw numbers of a whole frame stand for: 8 bits, of a colour camera the balanced mosaic.

    Parameters
    ----------
    raw : ndarray of uint16 (rows, cols)
        [DN].
    readout : Readout
    """
    out = np.empty(raw.shape, readout.tone.dtype)
    _look_up(raw, (0, 0), readout, out)
    return out


def expose_numpy(
    lit: ChargeBox, readout: Readout, keys: tuple[int, int], *, with_raw: bool = False
) -> tuple[NDArray[Any], NDArray[np.uint16] | None]:
    """Return 8-bit frame, of a colour camera the balanced mosaic, and, if asked for, raw numbers.

    Parameters
    ----------
    lit : ChargeBox
    readout : Readout
    keys : tuple of int
        Two words of 32 bits that the noise depends on.
    with_raw : bool

    Returns
    -------
    data : ndarray of uint8, of a colour camera uint16, (rows, cols)
    raw : ndarray of uint16 (rows, cols) or None
        [DN].
    """
    out = np.empty(readout.shape, readout.tone.dtype)
    raw = np.empty(readout.shape, np.uint16) if with_raw else None
    in_threads(lambda rows: _expose_rows(out, raw, rows, lit, readout, keys), readout.shape[0], _rows_of(readout.shape))
    return out, raw


def coupling_numpy(gap: Image, share: Image, end: float, table: Image) -> Image:
    """Return the coupling of each point: its share in contact, and of the rest what the gap lets through.

    Parameters
    ----------
    gap, share : ndarray (rows, cols)
        [mm], [1].
    end : float
        Gap of the table's last entry [mm].
    table : ndarray
        Coupling by the square root of the gap, evenly spaced, 0 in the last entry [1].
    """
    out = np.empty_like(gap)

    def work(rows: range) -> None:
        here = slice(rows.start, rows.stop)
        g, s = gap[here], share[here]
        index = np.sqrt(np.minimum(g * np.float32(1 / end), np.float32(1))) * np.float32(table.size - 1)
        through = table.take((index + np.float32(0.5)).astype(np.int32))
        np.multiply(through, 1 - s, out=out[here])
        out[here] += s

    in_threads(work, gap.shape[0], 128)
    return out
