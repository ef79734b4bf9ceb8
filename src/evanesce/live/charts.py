"""Draw histogram and profile as SVG text, small enough for ten updates a second."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.live.figures import Histogram, Profile

WIDTH, HEIGHT = 560, 210
LEFT, RIGHT, TOP, BOTTOM = 52, 12, 12, 40

Array = NDArray[np.floating[Any]]


def histogram_svg(shown: Histogram, threshold: float, own: Histogram | None = None) -> str:
    """Return the histogram of grey levels within and outside contact, on a logarithmic scale, with the threshold.

    Parameters
    ----------
    shown : Histogram
    threshold : float
        Grey level, 0 to 1.
    own : Histogram, optional
        Of the user's own frame, drawn as a line.
    """
    classes = shown.inside.size
    counts = [shown.inside, shown.outside] + ([] if own is None else [own.outside])
    decades = max(3, int(np.ceil(np.log10(max(int(c.max()) for c in counts) + 1))))

    def steps(count: NDArray[np.int64], closed: bool) -> str:
        high = np.log10(np.maximum(count, 0.8)) / decades
        y = _y(np.repeat(np.clip(high, 0.0, 1.0), 2))
        x = _x(np.repeat(np.arange(classes + 1) / classes, 2)[1:-1])
        path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))
        return f"M{x[0]:.1f} {_y(0.0):.1f}L{path[1:]}L{x[-1]:.1f} {_y(0.0):.1f}Z" if closed else path

    parts = [_grid([k / decades for k in range(decades + 1)], [_power(k) for k in range(decades + 1)])]
    parts.append(f'<path class="outside" d="{steps(shown.outside, True)}"/>')
    parts.append(f'<path class="inside" d="{steps(shown.inside, True)}"/>')
    if own is not None:
        parts.append(f'<path class="own" d="{steps(own.outside, False)}"/>')
    parts.append(_ticks(np.linspace(0, 1, 6), np.linspace(0, 1, 6), "grey level after blur, 0 to 1"))
    at = float(_x(threshold))
    parts.append(f'<path class="threshold" d="M{at:.1f} {TOP}V{HEIGHT - BOTTOM}"/>')
    anchor, shift = ("end", -5) if threshold > 0.75 else ("start", 5)
    parts.append(
        f'<text x="{at + shift:.1f}" y="{TOP + 10}" text-anchor="{anchor}" class="threshold">'
        f"threshold {threshold:.4f}</text>"
    )
    parts.append(_upright("pixels"))
    return _svg("histogram of grey levels with the threshold", parts)


def profile_svg(profile: Profile, threshold: float, reach_mm: float) -> str:
    """Return the plot of grey level along a line, with true contact as bands and the threshold.

    Parameters
    ----------
    profile : Profile
    threshold : float
        Grey level, 0 to 1.
    reach_mm : float
        Largest distance from the tip that is drawn [mm].
    """
    near = np.abs(profile.position_mm) <= reach_mm
    position, grey, share = profile.position_mm[near], profile.grey[near], profile.share[near]
    x = _x((position + reach_mm) / (2 * reach_mm))
    parts = [_grid([0, 0.25, 0.5, 0.75, 1.0], ["0", "0.25", "0.5", "0.75", "1"])]
    half = 0.5 * (x[1] - x[0]) if x.size > 1 else 0.0
    for first, last in _runs(share >= 0.5):
        left, wide = x[first] - half, x[last] - x[first] + 2 * half
        parts.append(
            f'<rect class="truth" x="{left:.1f}" y="{TOP}" width="{wide:.1f}" height="{HEIGHT - TOP - BOTTOM}"/>'
        )
    if x.size:
        points = "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, _y(grey), strict=True))
        parts.append(f'<path class="grey" d="M{points}"/>')
    level = float(_y(threshold))
    parts.append(f'<path class="threshold" d="M{LEFT} {level:.1f}H{WIDTH - RIGHT}"/>')
    step = next(s for s in (1, 2, 5, 10, 20, 50, 100, 1000) if reach_mm / s <= 5)
    at = np.arange(-(reach_mm // step) * step, reach_mm + 1e-9, step)
    parts.append(_ticks((at + reach_mm) / (2 * reach_mm), at, f"{profile.along} from the finger's tip [mm]"))
    parts.append(_upright("grey level"))
    return _svg("grey level along the profile line", parts)


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _x(share: Array | float) -> Array:
    return np.asarray(LEFT + np.asarray(share) * (WIDTH - LEFT - RIGHT))


def _y(share: Array | float) -> Array:
    return np.asarray(HEIGHT - BOTTOM - np.asarray(share) * (HEIGHT - TOP - BOTTOM))


def _power(k: int) -> str:
    return "1" if k == 0 else "10" if k == 1 else f'10<tspan dy="-5" font-size="9">{k}</tspan>'


def _grid(at: list[float], names: list[str]) -> str:
    """Return horizontal grid lines with their labels."""
    parts = []
    for share, name in zip(at, names, strict=True):
        y = float(_y(share))
        parts.append(f'<path class="grid" d="M{LEFT} {y:.1f}H{WIDTH - RIGHT}"/>')
        parts.append(f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{name}</text>')
    return "".join(parts)


def _ticks(at: Array, values: Array, title: str) -> str:
    """Return the horizontal axis."""
    parts = []
    for share, value in zip(at, values, strict=True):
        x = float(_x(share))
        parts.append(f'<path class="axis" d="M{x:.1f} {HEIGHT - BOTTOM}v4"/>')
        parts.append(f'<text x="{x:.1f}" y="{HEIGHT - BOTTOM + 16}" text-anchor="middle">{value + 0.0:g}</text>')
    parts.append(f'<path class="axis" d="M{LEFT} {HEIGHT - BOTTOM}H{WIDTH - RIGHT}"/>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text x="{middle:.1f}" y="{HEIGHT - 6}" text-anchor="middle" class="title">{title}</text>')
    return "".join(parts)


def _upright(title: str) -> str:
    y = (TOP + HEIGHT - BOTTOM) / 2
    return (
        f'<text x="13" y="{y:.1f}" text-anchor="middle" class="title" transform="rotate(-90 13 {y:.1f})">{title}</text>'
    )


def _svg(name: str, parts: list[str]) -> str:
    return f'<svg class="chart" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{name}">{"".join(parts)}</svg>'
