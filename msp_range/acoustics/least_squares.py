"""Least squares of a few parameters with lower bounds, by Levenberg and Marquardt's method.

The bridge fits one small equation when it starts (`msp_range.acoustics.sonar`), and importing scipy.optimize for it
took longer than everything else of the start together.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

STEP = 1e-7
"""Of a parameter, relative to it or to 1, for the residuals' slopes: near the root of a float's precision, where a
difference loses as much to rounding as to curvature."""
ENOUGH = 1e-14
"""The fit ends where a step changes the sum of squares by less than this share of it: nearly all digits of a float."""
MAX_STEPS = 200
"""Fits of the sonar equation take 5 to 30; a fit that has not ended by then is as good as it gets."""
MAX_DAMPING = 1e12
"""With more damping than this a step is smaller than a float can resolve: there is no better point near."""

_Array = NDArray[np.float64]


def least_squares(
    residuals: Callable[[_Array], Sequence[float]], start: Sequence[float], lower: Sequence[float]
) -> _Array:
    """The parameters p >= lower nearest to ``start`` in whose neighbourhood the sum of squared residuals is least.

    Steps solve (J'J + d diag(J'J)) s = -J'r over the parameters that are not held by their bound, and are cut at the
    bounds; the damping d grows tenfold while they lead uphill and shrinks tenfold where they do not.

    Parameters
    ----------
    residuals
        Parameters, shape (n,) -> residuals, as many for all parameters.
    start, lower
        Where to start, at the bounds or above; lower bounds, minus infinity for none. Length n.

    Returns
    -------
    ndarray, shape (n,)

    Examples
    --------
    A line through (0, 1), (1, 3), (2, 5), and one that must not start below 2:

    >>> line = lambda p: [p[0] + p[1] * x - y for x, y in ((0, 1), (1, 3), (2, 5))]
    >>> print(least_squares(line, [0.0, 0.0], [-np.inf, -np.inf]).round(6))
    [1. 2.]
    >>> print(least_squares(line, [2.0, 0.0], [2.0, -np.inf]).round(6))
    [2.  1.4]
    """
    bounds = np.asarray(lower, dtype=np.float64)
    parameters = np.array(start, dtype=np.float64)
    misses = np.asarray(residuals(parameters), dtype=np.float64)
    cost, damping = float(misses @ misses), 1e-3
    for _ in range(MAX_STEPS):
        slopes = _slopes(residuals, parameters, misses)
        downhill = -slopes.T @ misses
        free = (parameters > bounds) | (downhill > 0.0)
        if not free.any():
            break
        scale = np.diag(np.linalg.norm(slopes[:, free], axis=0))
        aims = np.concatenate([-misses, np.zeros(len(scale))])
        before = cost
        while damping < MAX_DAMPING:
            tried = parameters.copy()
            # The step as a least-squares problem of its own: the shortest one where parameters do the same or nothing.
            tried[free] += np.linalg.lstsq(np.vstack([slopes[:, free], math.sqrt(damping) * scale]), aims)[0]
            tried = np.maximum(tried, bounds)
            misses_there = np.asarray(residuals(tried), dtype=np.float64)
            if float(misses_there @ misses_there) <= cost:
                parameters, misses, cost = tried, misses_there, float(misses_there @ misses_there)
                damping /= 10.0
                break
            damping *= 10.0
        if before - cost <= ENOUGH * before:
            break
    return parameters


def _slopes(residuals: Callable[[_Array], Sequence[float]], parameters: _Array, misses: _Array) -> _Array:
    """Forward differences of the residuals, shape (residuals, parameters)."""
    columns = []
    for i, parameter in enumerate(parameters.tolist()):
        step = STEP * max(abs(parameter), 1.0)
        moved = parameters.copy()
        moved[i] += step
        columns.append((np.asarray(residuals(moved), dtype=np.float64) - misses) / step)
    return np.array(columns).T
