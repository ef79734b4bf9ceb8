"""Standard errors of what all views share, also where corners of one view err together.

Least squares' own standard errors count every corner as one more independent observation. Corners of one picture are
not: blur, glare, the card's bow and a lens that two radial terms do not quite describe push them together. Views are
independent of one another, so that what the estimate loses with each view left out says how it would scatter (the
jackknife, or CR3 estimator of clustered errors), with one degree of freedom less than there are views [1]_: it is
widened by Student's factor, so that twice the error covers 95 % as for a Gaussian. The greater of the two is stated.

.. [1] Bell & McCaffrey, Bias reduction in standard errors for linear regression with multi-stage samples, Survey
   Methodology 28 (2002) 169.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

Array = NDArray[np.float64]

COVERED = 0.975
"""Upper limit of the interval, of 95 %, that twice the error is to cover."""

MIN_VIEWS = 3
"""Views below which leaving one out says nothing."""


def shared_errors(shared: Sequence[Array], own: Sequence[Array], residuals: Sequence[Array]) -> Array:
    """Return the standard errors of the shared parameters.

    Parameters
    ----------
    shared : sequence of ndarray (m, p)
        Derivatives of each view's residuals by the shared parameters.
    own : sequence of ndarray (m, q)
        By the view's own parameters, its pose.
    residuals : sequence of ndarray (m,)

    Returns
    -------
    ndarray (p,)
    """
    parts = []
    for common, pose, residual in zip(shared, own, residuals, strict=True):
        # the pose takes up its share of every change: what is left of it decides
        scale = np.linalg.norm(pose, axis=0)
        base = np.linalg.qr(pose / np.where(scale > 0, scale, 1.0))[0]
        parts.append((common - base @ (base.T @ common), residual - base @ (base.T @ residual)))
    unit = np.sqrt(sum((a**2).sum(axis=0) for a, _ in parts))
    unit = np.where(unit > 0, unit, 1.0)
    squares = [(a / unit).T @ (a / unit) for a, _ in parts]
    total = np.sum(squares, axis=0)
    inverse = np.linalg.pinv(total)
    count = sum(map(len, residuals)) - len(total) - sum(a.shape[1] for a in own)
    variance = sum(float(r @ r) for r in residuals) / max(count, 1)
    plain = np.sqrt(np.maximum(variance * np.diag(inverse), 0.0))
    if len(parts) < MIN_VIEWS:
        return np.asarray(plain / unit)
    moves = np.array([
        np.linalg.pinv(total - square) @ ((a / unit).T @ r) for square, (a, r) in zip(squares, parts, strict=True)
    ])  # fmt: skip
    student = stdtrit(len(parts) - 1, COVERED) / ndtri(COVERED)
    clustered = student * np.sqrt((len(parts) - 1) / len(parts) * (moves**2).sum(axis=0))
    return np.asarray(np.maximum(plain, clustered) / unit)
