"""Sub-pixel position of checkerboard corners: a blurred-corner model fitted to the grey values, many corners at once.

Where two edges of a board cross, a Gaussian blur leaves, with d_k = n_k . (p - c) / (sqrt(2) sigma_k),

    I(p) = b0 + b . (p - c) + a erf(d_1) erf(d_2) + g exp(-d_1^2 - d_2^2).

Without the last term this holds for a blur whose axes lie along the edges; g = (2/pi) rho a is the first term of the
tetrachoric series for a blur correlated by rho between the two normals, as an astigmatic lens leaves it in the corners
of a frame. Without g the best isotropic corner there sits beside the true one, on either side; spreading ink, which
joins the dark squares, adds to g as well. The model has the corner's own point symmetry, so that ink spread, a tone
curve or a blur that is not Gaussian change the other parameters but leave c where it is. Cauchy weights keep bright
specks from pulling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

Array = NDArray[np.float64]
Single = NDArray[np.float32]

ITERATIONS = 25
MAX_HALF_WIDTH_PX = 13.0
START_BLUR = 0.2  # of the window's half-width, where no earlier fit gives the blur
MAX_BATCH_SAMPLES = 40_000  # the derivatives of a batch (3.5 MB) stay in the cache
MEDIAN_OF = 4  # every fourth sample of a window, whose side is odd, gives the scale of its residuals
_CAUCHY = 2.385  # 95 % efficiency on Gaussian noise (Holland & Welsch 1977)
_SAME = 1 + 1e-6  # sums of squares that differ by less are equal in single precision
# the columns of the parameters
X, Y, LEVEL, SLOPE_X, SLOPE_Y, CONTRAST, BUMP = 0, 1, 6, 7, 8, 9, 10
ANGLE, WIDTH = slice(2, 4), slice(4, 6)


@dataclass(frozen=True)
class SaddleFit:
    """Fitted corners, one per row.

    Attributes
    ----------
    position : ndarray (n, 2)
        (x, y) [px].
    sigma : ndarray (n, 2)
        Width of the blur across the edge that u crosses and across that which v crosses [px].
    level, contrast : ndarray (n,)
        Mean of bright and dark squares, and half their difference [the image's unit]; contrast is positive where the
        square towards +u +v is bright.
    bump : ndarray (n,)
        g of the module's docstring [the image's unit].
    normals : ndarray (n, 2, 2)
        ``normals[k, 0]`` is the unit normal of the edge that u crosses, ``normals[k, 1]`` of that which v crosses.
    explained : ndarray (n,)
        Share of the window's variance that the model explains, specks weighted down.
    support : ndarray (n,)
        Share of the window that lies inside the image.
    """

    position: Array
    sigma: Array
    level: Array
    contrast: Array
    bump: Array
    normals: Array
    explained: Array
    support: Array


def fit_saddles(
    image: Array,
    centres: Array,
    lattice: Array,
    half_width: float = 0.42,
    limit_px: float = MAX_HALF_WIDTH_PX,
    tolerance_px: float = 5e-4,
    iterations: int = ITERATIONS,
    start: tuple[Array, Array] | None = None,
) -> SaddleFit:
    """Fit the corner model around approximate positions.

    Parameters
    ----------
    image : ndarray (rows, cols)
        Grey values.
    centres : ndarray (n, 2)
        Approximate corners (x, y) [px], within about a quarter of a square.
    lattice : ndarray (n, 2, 2)
        Local lattice: ``lattice[k] @ (u, v)`` is the offset in pixels of u squares along the first grid axis and v
        along the second.
    half_width : float
        Half-width of the window in squares; below 0.5 the next corner stays outside.
    limit_px : float
        Half-width that is never exceeded [px]; the work grows as its square.
    tolerance_px : float
        A corner that moves by less in a step has converged [px].
    iterations : int
        Steps at the most.
    start : tuple of ndarray, optional
        Normals (n, 2, 2) and blur (n, 2) [px] of an earlier fit to start from; else those of the lattice, and a fifth
        of the window's half-width.

    Returns
    -------
    SaddleFit
    """
    pitch = np.sqrt(np.abs(np.linalg.det(lattice)))
    widths = np.minimum(half_width, limit_px / pitch)  # boards of large squares are cut at the limit
    reach = int(np.ceil((widths[:, None] * np.abs(lattice).sum(axis=2)).max(initial=1.0))) + 1
    step = max(1, MAX_BATCH_SAMPLES // (2 * reach + 1) ** 2)
    starts = range(0, max(len(centres), 1), step)
    parts = []
    for k in starts:
        some = slice(k, k + step)
        begin = None if start is None else (start[0][some], start[1][some])
        found = _fit_batch(image, centres[some], lattice[some], widths[some], reach, tolerance_px, iterations, begin)
        parts.append(found)
    joined = {name: np.concatenate([getattr(part, name) for part in parts]) for name in SaddleFit.__dataclass_fields__}
    return SaddleFit(**joined)


def quadrants(image: Array, position: Array, lattice: Array, part: tuple[float, float] = (0.18, 0.45)) -> Array:
    """Return the median grey value of the four squares that meet at each corner, the middle part of their near halves.

    Parameters
    ----------
    image : ndarray (rows, cols)
    position : ndarray (n, 2)
        (x, y) [px].
    lattice : ndarray (n, 2, 2)
        As for :func:`fit_saddles`.
    part : tuple of float
        Between these distances from both edges [squares].

    Returns
    -------
    ndarray (n, 4)
        In the order (+u +v), (-u +v), (-u -v), (+u -v); NaN where most of a square lies outside the image.
    """
    inner = np.linspace(*part, 5)
    u, v = (g.ravel() for g in np.meshgrid(inner, inner))
    signs = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)], dtype=np.float64)
    offsets = signs[:, None, :] * np.stack([u, v], axis=-1)
    points = position[:, None, None, :] + np.einsum("kab,qmb->kqma", lattice, offsets)
    x, y = points[..., 0], points[..., 1]
    rows, cols = image.shape
    inside = (x >= -0.5) & (x <= cols - 0.5) & (y >= -0.5) & (y <= rows - 0.5)
    values = map_coordinates(image, [y, x], order=1, mode="nearest")
    ordered = np.sort(np.where(inside, values, np.inf), axis=-1)
    count = inside.sum(axis=-1)
    median = np.take_along_axis(ordered, np.maximum(count - 1, 0)[..., None] // 2, axis=-1)[..., 0]
    return np.where(count >= u.size // 3, median, np.nan)


def _fit_batch(
    image: Array,
    centres: Array,
    lattice: Array,
    widths: Array,
    reach: int,
    tolerance_px: float,
    iterations: int,
    begin: tuple[Array, Array] | None,
) -> SaddleFit:
    base = np.rint(centres).astype(np.int64)
    dx, dy, values, inside = _windows(image, base, reach)
    start = centres - base
    inverse = np.linalg.inv(lattice)
    in_squares = np.zeros(values.shape, dtype=np.float32)
    for k in (0, 1):  # u, v of each sample
        across, along = inverse[:, k, :1].astype(np.float32), inverse[:, k, 1:].astype(np.float32)
        offset = across * dx + along * dy - (inverse[:, k] * start).sum(axis=1, keepdims=True).astype(np.float32)
        np.maximum(in_squares, np.abs(offset), out=in_squares)
    window = in_squares <= widths[:, None]
    support = (window & inside).sum(axis=1) / np.maximum(window.sum(axis=1), 1)
    dx, dy, values, mask = _packed(dx, dy, values, window & inside)

    pitch = np.sqrt(np.abs(np.linalg.det(lattice)))
    theta = np.zeros((len(centres), 11))
    theta[:, X : Y + 1] = start
    # rows of the inverse lattice are the gradients of u and v: the normals of the edges that u and v cross
    theta[:, ANGLE] = np.arctan2(inverse[:, :, 1], inverse[:, :, 0])
    theta[:, WIDTH] = np.log(np.maximum(START_BLUR * widths * pitch, 0.5))[:, None]
    if begin is not None:
        theta[:, ANGLE] = np.arctan2(begin[0][..., 1], begin[0][..., 0])
        theta[:, WIDTH] = np.log(begin[1])
    _start_levels(theta, dx, dy, values, mask)
    theta, weights = _levenberg(theta, dx, dy, values, mask, pitch, tolerance_px, iterations)

    model, _ = _model(theta, dx, dy)
    total = np.maximum(weights.sum(axis=1), 1e-12)
    mean = (weights * values).sum(axis=1) / total
    spread = np.maximum((weights * (values - mean[:, None]) ** 2).sum(axis=1), 1e-12)
    return SaddleFit(
        position=base + theta[:, X : Y + 1],
        sigma=np.exp(theta[:, WIDTH]),
        level=theta[:, LEVEL],
        contrast=theta[:, CONTRAST],
        bump=theta[:, BUMP],
        normals=np.stack([np.cos(theta[:, ANGLE]), np.sin(theta[:, ANGLE])], axis=-1),
        explained=1.0 - (weights * (values - model) ** 2).sum(axis=1) / spread,
        support=support,
    )


def _windows(image: Array, base: NDArray[np.int64], reach: int) -> tuple[Single, Single, Single, NDArray[np.bool_]]:
    """Return offsets dx, dy (m,), grey values (n, m) and which of them lie inside the image."""
    offsets = np.arange(-reach, reach + 1)
    dx, dy = (g.ravel() for g in np.meshgrid(offsets, offsets))
    rows, cols = image.shape
    x, y = base[:, :1] + dx, base[:, 1:] + dy
    inside = (x >= 0) & (x < cols) & (y >= 0) & (y < rows)
    values = image[np.clip(y, 0, rows - 1), np.clip(x, 0, cols - 1)]
    return dx.astype(np.float32), dy.astype(np.float32), values.astype(np.float32), inside


def _packed(dx: Single, dy: Single, values: Single, mask: NDArray[np.bool_]) -> tuple[Single, Single, Single, Single]:
    """Leave out samples beside the windows, which lie askew in their squares: (n, most samples of any window) each."""
    most = int(mask.sum(axis=1).max(initial=1))
    order = np.argsort(~mask, axis=1, kind="stable")[:, :most]
    kept, weight = np.take_along_axis(values, order, axis=1), np.take_along_axis(mask, order, axis=1)
    return dx[order], dy[order], kept, weight.astype(np.float32)


def _model(values: Array, dx: Single, dy: Single) -> tuple[Single, Single]:
    """Return the model (n, m) and its derivatives (n, 11, m) by the parameters, in single precision: it is fast."""
    theta = values.astype(np.float32)
    x, y = dx - theta[:, X, None], dy - theta[:, Y, None]
    contrast, bump = theta[:, CONTRAST, None], theta[:, BUMP, None]
    cos, sin = np.cos(theta[:, ANGLE]), np.sin(theta[:, ANGLE])
    scale = np.float32(np.sqrt(0.5)) * np.exp(-theta[:, WIDTH])
    d = [(x * cos[:, k, None] + y * sin[:, k, None]) * scale[:, k, None] for k in (0, 1)]
    gauss = [np.exp(-dk * dk) for dk in d]
    edge = [_erf(dk, g) for dk, g in zip(d, gauss, strict=True)]
    jacobian = np.empty((len(theta), 11, x.shape[1]), dtype=np.float32)
    cross = np.multiply(edge[0], edge[1], out=jacobian[:, CONTRAST])
    both = np.multiply(gauss[0], gauss[1], out=jacobian[:, BUMP])
    jacobian[:, LEVEL], jacobian[:, SLOPE_X], jacobian[:, SLOPE_Y] = 1.0, x, y
    model = theta[:, LEVEL, None] + theta[:, SLOPE_X, None] * x + theta[:, SLOPE_Y, None] * y
    model += contrast * cross
    model += bump * both
    twice = 2 * bump * both
    by_d = [np.float32(2 / np.sqrt(np.pi)) * contrast * gauss[k] * edge[1 - k] - twice * d[k] for k in (0, 1)]
    for column, trig, slope in ((X, cos, SLOPE_X), (Y, sin, SLOPE_Y)):
        pull = by_d[0] * (trig * scale)[:, 0, None] + by_d[1] * (trig * scale)[:, 1, None]
        np.subtract(-theta[:, slope, None], pull, out=jacobian[:, column])
    for k in (0, 1):
        along = (y * cos[:, k, None] - x * sin[:, k, None]) * scale[:, k, None]
        np.multiply(by_d[k], along, out=jacobian[:, ANGLE.start + k])
        np.multiply(by_d[k], -d[k], out=jacobian[:, WIDTH.start + k])
    return model, jacobian


def _erf(x: Single, gauss: Single) -> Single:
    """Return erf(x) to 1.5e-7 with gauss = exp(-x^2) at hand (Abramowitz & Stegun 1964, 7.1.26).

    The error is odd in x, as the function is, so that it does not move a corner.
    """
    t = np.abs(x)
    t *= 0.3275911
    t += 1.0
    np.reciprocal(t, out=t)
    total = 1.061405429 * t
    for coefficient in (-1.453152027, 1.421413741, -0.284496736, 0.254829592):
        total += coefficient
        total *= t
    total *= gauss
    return np.copysign(1.0 - total, x)


def _start_levels(theta: Array, dx: Single, dy: Single, values: Single, mask: Single) -> None:
    """Fill in the linear parameters (level, slopes, contrast) by least squares at the starting geometry."""
    _, jacobian = _model(theta, dx, dy)
    linear = jacobian[:, LEVEL : CONTRAST + 1]
    weighted = linear * mask[:, None]
    normal, right = (weighted @ linear.swapaxes(1, 2)).astype(np.float64), weighted @ values[..., None]
    solved = np.linalg.solve(normal + 1e-9 * np.eye(4), right.astype(np.float64))
    theta[:, LEVEL : CONTRAST + 1] = solved[..., 0]


def _cauchy(residual: Single, mask: Single) -> Single:
    """Return robust weights; the scale is the window's own median absolute residual, at least half a grey level."""
    some = slice(None, None, MEDIAN_OF if residual.shape[1] >= 64 * MEDIAN_OF else 1)
    inside = mask[:, some] > 0
    ordered = np.sort(np.where(inside, np.abs(residual[:, some]), np.float32(np.inf)), axis=1)
    middle = np.maximum(inside.sum(axis=1) - 1, 0) // 2
    median = ordered[np.arange(len(ordered)), middle]
    scale = np.maximum(1.4826 * np.where(np.isfinite(median), median, 0.0), 0.5).astype(np.float32)
    return np.asarray(mask / (1 + (residual / (np.float32(_CAUCHY) * scale[:, None])) ** 2))


def _levenberg(
    theta: Array,
    dx: Single,
    dy: Single,
    values: Single,
    mask: Single,
    pitch: Array,
    tolerance_px: float,
    iterations: int,
) -> tuple[Array, Single]:
    """Return parameters and weights after iteratively reweighted Levenberg-Marquardt steps.

    Corners drop out of the batch as they converge.
    """
    theta, start = theta.copy(), theta[:, :2].copy()
    weights = np.zeros_like(mask)
    damping = np.full(len(theta), 1e-2)
    active = np.arange(len(theta))
    low, high = np.log(0.15), np.log(np.maximum(0.35 * pitch, 0.3))
    model, jacobian = _model(theta, dx, dy)
    for step in range(iterations + 1):
        now, grey = theta[active], values[active]
        residual = grey - model
        robust = weights[active] = _cauchy(residual, mask[active])
        if step == iterations or not active.size:
            break
        weighted = jacobian * robust[:, None]
        normal = (weighted @ jacobian.swapaxes(1, 2)).astype(np.float64)
        gradient = (weighted @ residual[..., None]).astype(np.float64)
        diagonal = np.einsum("kii->ki", normal)
        lifted = normal + np.eye(theta.shape[1]) * (damping[active, None] * diagonal + 1e-9)[:, None, :]
        tried = now + np.linalg.solve(lifted, gradient)[..., 0]
        # a corner that leaves its quarter of a square, or a blur beyond the window, is held at the bound
        bound = 0.35 * pitch[active, None]
        tried[:, :2] = np.clip(tried[:, :2], start[active] - bound, start[active] + bound)
        tried[:, WIDTH] = np.clip(tried[:, WIDTH], low, high[active, None])
        limit = np.abs(tried[:, CONTRAST])
        tried[:, BUMP] = np.clip(tried[:, BUMP], -limit, limit)
        there, slope = _model(tried, dx[active], dy[active])
        better = (robust * (grey - there) ** 2).sum(1) <= _SAME * (robust * residual**2).sum(1)
        moved = np.abs(tried[:, :2] - now[:, :2]).max(axis=1)
        theta[active[better]] = tried[better]
        there[~better], slope[~better] = model[~better], jacobian[~better]
        damping[active] = np.clip(damping[active] * np.where(better, 0.3, 8.0), 1e-6, 1e6)
        more = ~(better & (moved < tolerance_px)) & (damping[active] < 1e5)
        active, model, jacobian = active[more], there[more], slope[more]
    return theta, weights
