"""The last operators of a frame, fused: coupling by gap, and from mean charge to a noisy 8-bit frame.

Each exists twice, as one Dr.Jit kernel and in NumPy, with the same numbers within float32's rounding. Noise is a
function of seed, frame and pixel alone: a hash of the pixel's number gives 32 bits, whose halves are looked up in a
table of normal quantiles, one for shot noise and one for read noise.

Shot noise is Poisson's to its third moment: mean + sqrt(mean) z + (z^2 - 1)/6 min(mean, 1), the first terms of the
Cornish-Fisher expansion. Below some ten electrons Poisson's steps would show; read noise of a few electrons hides them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

Image = NDArray[np.float32]
Backend = Literal["llvm", "numpy"]

THREADS = 2
NORMALS = 1 << 16
MOST_STEPS = 12
_ROWS = 24  # of a block: what fits into a core's cache


@functools.cache
def normal_table() -> Image:
    """Return the means of the normal distribution's 2^16 equal shares, scaled to variance 1."""
    edges = ndtri(np.linspace(0.0, 1.0, NORMALS + 1))
    density = np.exp(-0.5 * edges**2) / np.sqrt(2 * np.pi)
    means = -np.diff(density) * NORMALS
    return np.asarray(means / np.sqrt(np.mean(means**2)), np.float32)


@dataclass(frozen=True)
class Readout:
    """A camera from mean charge to 8 bits.

    Attributes
    ----------
    shape : tuple of int
        (rows, cols).
    dark_e : float
        Mean charge without light [e-].
    full_well_e, read_noise_e : float
        [e-].
    gain : float
        [DN/e-].
    black_DN : float
        [DN].
    tone : ndarray of uint8 (2^bits,)
        8-bit value of each raw number.
    """

    shape: tuple[int, int]
    dark_e: float
    full_well_e: float
    read_noise_e: float
    gain: float
    black_DN: float
    tone: NDArray[np.uint8]


@dataclass(frozen=True)
class Lit:
    """The part of a frame that light falls on.

    Attributes
    ----------
    row, col : int
        Of its upper left pixel.
    charge : ndarray of float32 (rows, cols)
        Mean charge by light [e-].
    """

    row: int
    col: int
    charge: Image


# --- NumPy -----------------------------------------------------------------------------------------------------------


def _mix(x: NDArray[np.uint32], work: NDArray[np.uint32]) -> None:
    """Scramble 32-bit words in place (C. Wellons's lowbias32, a bijection)."""
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        np.right_shift(x, np.uint32(shift), out=work)
        np.bitwise_xor(x, work, out=x)
        np.multiply(x, np.uint32(factor), out=x)
    np.right_shift(x, np.uint32(16), out=work)
    np.bitwise_xor(x, work, out=x)


def pixel_bits(first: int, count: int, keys: tuple[int, int]) -> NDArray[np.uint32]:
    """Return 32 random bits for pixels ``first`` to ``first + count``; two keyed rounds, so that frames differ."""
    x = np.arange(first, first + count, dtype=np.uint32)
    work = np.empty_like(x)
    np.add(x, np.uint32(keys[0]), out=x)
    _mix(x, work)
    np.bitwise_xor(x, np.uint32(keys[1]), out=x)
    _mix(x, work)
    return x


def _expose_rows(
    out: NDArray[np.uint8], raw: NDArray[np.uint16] | None, rows: range, lit: Lit, readout: Readout, keys: Any
) -> None:
    """Expose some rows: every pixel as if dark, then the lit ones anew."""
    cols = readout.shape[1]
    bits = pixel_bits(rows.start * cols, len(rows) * cols, keys).reshape(len(rows), cols)
    here = slice(rows.start, rows.stop)
    steps = dark_steps(readout)
    if steps is not None and raw is None:
        high = (bits >> np.uint32(16)).astype(np.uint16)
        out[here] = steps.base
        for place, rise in steps.rises:
            out[here] += (high >= np.uint16(place)).view(np.uint8) * np.uint8(rise)
    else:
        values = _quantised(np.full(bits.shape, readout.dark_e, np.float32), bits, readout)
        readout.tone.take(values, out=out[here])
        if raw is not None:
            raw[here] = values
    r0, r1 = max(rows.start, lit.row), min(rows.stop, lit.row + lit.charge.shape[0])
    if r1 > r0:
        columns = slice(lit.col, lit.col + lit.charge.shape[1])
        charge = lit.charge[r0 - lit.row : r1 - lit.row] + np.float32(readout.dark_e)
        values = _quantised(charge, bits[r0 - rows.start : r1 - rows.start, columns], readout)
        out[r0:r1, columns] = readout.tone.take(values)
        if raw is not None:
            raw[r0:r1, columns] = values


def _quantised(charge: Image, bits: NDArray[np.uint32], readout: Readout) -> NDArray[np.uint16]:
    """Return raw numbers of mean charges."""
    table = normal_table()
    z = table.take(bits & np.uint32(NORMALS - 1))
    charge = np.maximum(charge, np.float32(0))
    collected = charge + np.sqrt(charge) * z
    collected += (z * z - np.float32(1)) * np.minimum(charge, np.float32(1)) * np.float32(1 / 6)
    np.minimum(collected, np.float32(readout.full_well_e), out=collected)
    return _numbers(collected, table.take(bits >> np.uint32(16)), readout)


def _numbers(charge: NDArray[Any], z: Image, readout: Readout) -> NDArray[np.uint16]:
    signal = z * np.float32(readout.read_noise_e) + charge
    signal = signal * np.float32(readout.gain) + np.float32(readout.black_DN + 0.5)
    return np.clip(signal, np.float32(0), np.float32(readout.tone.size - 1)).astype(np.uint16)


@dataclass(frozen=True)
class DarkSteps:
    """The 8-bit value of a pixel without charge, as a staircase over the upper 16 bits of its random word.

    Attributes
    ----------
    base : int
        Value at 0.
    rises : tuple of (int, int)
        Where it rises, and by how much.
    """

    base: int
    rises: tuple[tuple[int, int], ...]


def dark_steps(readout: Readout) -> DarkSteps | None:
    """Return the staircase of a camera without dark charge; None where there is some, or too many steps to be quick."""
    if readout.dark_e != 0.0:
        return None
    return _dark_steps(
        readout.full_well_e, readout.read_noise_e, readout.gain, readout.black_DN, readout.tone.tobytes()
    )  # fmt: skip


@functools.lru_cache(maxsize=4)
def _dark_steps(full_well: float, noise: float, gain: float, black: float, tone: bytes) -> DarkSteps | None:
    values = np.frombuffer(tone, np.uint8)
    readout = Readout((1, 1), 0.0, full_well, noise, gain, black, values)
    staircase = values[_numbers(np.zeros(NORMALS, np.float32), normal_table(), readout)].astype(int)
    rise = np.diff(staircase)
    places = np.flatnonzero(rise)
    if places.size > MOST_STEPS or (rise < 0).any():
        return None
    return DarkSteps(int(staircase[0]), tuple((int(p) + 1, int(rise[p])) for p in places))


@functools.cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(THREADS)


def in_threads(work: Callable[[range], None], rows: int, block: int) -> None:
    """Call ``work`` on blocks of rows, in a few threads; each writes to its own rows, so order does not matter."""
    list(_pool().map(work, [range(r, min(r + block, rows)) for r in range(0, rows, block)]))


def expose_numpy(
    lit: Lit, readout: Readout, keys: tuple[int, int], *, with_raw: bool = False
) -> tuple[NDArray[np.uint8], NDArray[np.uint16] | None]:
    """Return 8-bit frame and, if asked for, raw numbers."""
    out = np.empty(readout.shape, np.uint8)
    raw = np.empty(readout.shape, np.uint16) if with_raw else None
    in_threads(lambda rows: _expose_rows(out, raw, rows, lit, readout, keys), readout.shape[0], _ROWS)
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


# --- Dr.Jit ----------------------------------------------------------------------------------------------------------


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
    """Return :func:`pixel_bits` in Dr.Jit arithmetic."""
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
        for place, rise in steps.rises:
            value += dr.select(high >= place, UInt32(rise), UInt32(0))
        return UInt8(value)

    return dr.freeze(dark)


@functools.lru_cache(maxsize=8)
def _exposure_kernel(cols: int, camera: tuple[float, float, float, float, float], top: int) -> Any:
    """Return the kernel of a lit box; the camera's constants are compiled into it."""
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


def _expose_box(lit: Lit, readout: Readout, keys: Any) -> tuple[NDArray[np.uint8], NDArray[np.uint32]]:
    """Return 8-bit values and raw numbers of a lit box."""
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


def _begin_dark(readout: Readout, keys: tuple[int, int]) -> Any:
    """Start the kernel of a frame without light, if there is one, and return its pixels; other work goes on."""
    import drjit as dr

    steps = dark_steps(readout)
    if steps is None:
        return None
    found = _dark_kernel(readout.shape[0] * readout.shape[1], steps)(_llvm_keys(keys))
    dr.eval(found)
    return found


def expose_llvm(
    lit: Lit, readout: Readout, keys: tuple[int, int], *, with_raw: bool = False, begun: Any = None
) -> tuple[NDArray[np.uint8], NDArray[np.uint16] | None]:
    """Return the same as :func:`expose_numpy`, by two kernels: all pixels as if dark, then the lit ones anew.

    ``begun`` is the first, where it runs already.
    """
    words = _llvm_keys(keys)
    raw: NDArray[Any] | None = None
    begun = _begin_dark(readout, keys) if begun is None and not with_raw else begun
    box = _expose_box(lit, readout, words) if lit.charge.size else None
    if begun is not None and not with_raw:
        # Kernels end in the order of their start: a box that is there says that the rest is.
        if box is None:
            import drjit as dr

            dr.sync_thread()
        data = np.asarray(np.array(begun, copy=False))
        # A camera so quiet that all dark pixels read alike has one number for them.
        data = np.full(readout.shape, data.ravel()[0], np.uint8) if data.size == 1 else data.reshape(readout.shape)
    else:
        data, raw = _expose_box(Lit(0, 0, np.zeros(readout.shape, np.float32)), readout, words)
        raw = raw.astype(np.uint16)
    if box is not None:
        here = np.s_[lit.row : lit.row + lit.charge.shape[0], lit.col : lit.col + lit.charge.shape[1]]
        data[here] = box[0]
        if raw is not None:
            raw[here] = box[1]
    return data, raw if with_raw else None


def coupling_llvm(gap: Image, share: Image, end: float, table: Image) -> Image:
    """Return the same as :func:`coupling_numpy`, by one kernel."""
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
            self._begun = _begin_dark(self.readout, self.keys)

    def finish(self, lit: Lit) -> tuple[NDArray[np.uint8], NDArray[np.uint16] | None]:
        """Return 8-bit frame and, if asked for, raw numbers."""
        if self.backend == "llvm":
            return expose_llvm(lit, self.readout, self.keys, with_raw=self.with_raw, begun=self._begun)
        return expose_numpy(lit, self.readout, self.keys, with_raw=self.with_raw)


@dataclass(frozen=True)
class Operators:
    """The fused operators of one backend."""

    coupling: Callable[[Image, Image, float, Image], Image]
    exposure: Callable[[Readout, tuple[int, int], bool], Exposure]


def operators(backend: Backend) -> Operators:
    """Return the operators of a backend; llvm has to work (:func:`llvm_works`)."""

    def exposure(readout: Readout, keys: tuple[int, int], with_raw: bool) -> Exposure:
        return Exposure(readout, keys, with_raw, backend)

    return Operators(coupling_llvm if backend == "llvm" else coupling_numpy, exposure)
