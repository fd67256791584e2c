"""Least squares for a few parameters with lower bounds, by the method of Levenberg and Marquardt.

The bridge fits one small equation when it starts (`msp_range.acoustics.sonar`). This is plain Python, because importing
scipy.optimize took longer than the rest of the start, and importing numpy a fifth of what remained.
"""

import math
from collections.abc import Callable, Sequence
from itertools import combinations

STEP = 1e-7
"""Step of a parameter, relative to it or to 1, for numeric derivatives: near the square root of a float's precision,
where errors from rounding and from curvature are equal."""
ENOUGH = 1e-14
"""Relative change of the sum of squares at which the fit ends: nearly all digits of a float."""
MAX_STEPS = 200
"""Largest number of iterations; fits of the sonar equation take 5 to 30."""
MAX_DAMPING = 1e12
"""Damping at which the fit ends: the steps are then smaller than a float's precision."""
MAX_SWEEPS = 30
"""Largest number of passes over all pairs of columns to make them orthogonal; 4 to 6 are enough for a few columns."""
FLOAT_EPSILON = 2.0**-52
"""A float's precision: columns are orthogonal to within this, and weaker directions are treated as zero."""


def least_squares(
    residuals: Callable[[Sequence[float]], Sequence[float]], start: Sequence[float], lower: Sequence[float]
) -> list[float]:
    """Find the parameters p >= lower that minimise the sum of squared residuals, starting from ``start``.

    Steps solve (J'J + d diag(J'J)) s = -J'r over the parameters that are not at their bound, and are limited by the
    bounds; the damping d is multiplied by ten while steps increase the sum, and divided by ten otherwise.

    Parameters
    ----------
    residuals
        Function from n parameters to the residuals.
    start, lower
        Start values, at or above the bounds; lower bounds, minus infinity for none. Length n.

    Returns
    -------
    list of float, length n

    Examples
    --------
    A line through (0, 1), (1, 3), (2, 5), and one that must not start below 2:

    >>> line = lambda p: [p[0] + p[1] * x - y for x, y in ((0, 1), (1, 3), (2, 5))]
    >>> [f"{each:.4f}" for each in least_squares(line, [0.0, 0.0], [-math.inf, -math.inf])]
    ['1.0000', '2.0000']
    >>> [f"{each:.4f}" for each in least_squares(line, [2.0, 0.0], [2.0, -math.inf])]
    ['2.0000', '1.4000']
    """
    parameters = list(start)
    misses = list(residuals(parameters))
    cost, damping = _dot(misses, misses), 1e-3
    for _ in range(MAX_STEPS):
        slopes = _slopes(residuals, parameters, misses)
        free = [i for i, slope in enumerate(slopes) if parameters[i] > lower[i] or _dot(slope, misses) < 0.0]
        if not free:
            break
        before = cost
        while damping < MAX_DAMPING:
            tried = _step(parameters, lower, misses, slopes, free, damping)
            misses_there = list(residuals(tried))
            cost_there = _dot(misses_there, misses_there)
            if cost_there <= cost:
                parameters, misses, cost = tried, misses_there, cost_there
                damping /= 10.0
                break
            damping *= 10.0
        if before - cost <= ENOUGH * before:
            break
    return parameters


def shortest_solution(columns: Sequence[Sequence[float]], aims: Sequence[float]) -> list[float]:
    """Minimum-norm least-squares solution x of sum x_i columns_i = ``aims``, by singular value decomposition.

    Pairs of columns are rotated until all are orthogonal (Hestenes 1958); their lengths are then the singular values.
    Values below the rounding error are treated as zero.

    Parameters
    ----------
    columns
        n columns of length m.
    aims
        Length m.

    Returns
    -------
    list of float, length n

    Examples
    --------
    Where two columns are the same, both get half:

    >>> [f"{each:.3f}" for each in shortest_solution([[1.0, 1.0], [1.0, 1.0]], [3.0, 3.0])]
    ['1.500', '1.500']
    """
    turned = [list(column) for column in columns]
    size = len(turned)
    turns = [[float(i == j) for j in range(size)] for i in range(size)]
    for _ in range(MAX_SWEEPS):
        turned_pairs = [_turn(turned, turns, i, j) for i, j in combinations(range(size), 2)]
        if not any(turned_pairs):
            break
    lengths = [math.hypot(*column) for column in turned]
    weakest = FLOAT_EPSILON * max(size, len(aims)) * max(lengths)
    solution = [0.0] * size
    for column, turn, length in zip(turned, turns, lengths, strict=True):
        if length > weakest:
            share = _dot(column, aims) / (length * length)
            solution = [each + share * part for each, part in zip(solution, turn, strict=True)]
    return solution


def _turn(columns: list[list[float]], turns: list[list[float]], i: int, j: int) -> bool:
    """Rotate two columns until they are orthogonal, and record the rotation; False if they already are."""
    one, other = columns[i], columns[j]
    product = _dot(one, other)
    if abs(product) <= FLOAT_EPSILON * math.hypot(*one) * math.hypot(*other):
        return False
    ratio = (_dot(other, other) - _dot(one, one)) / (2.0 * product)
    tangent = math.copysign(1.0, ratio) / (abs(ratio) + math.hypot(1.0, ratio))
    cosine = 1.0 / math.hypot(1.0, tangent)
    sine = cosine * tangent
    for rows in (columns, turns):
        one, other = rows[i], rows[j]
        rows[i] = [cosine * a - sine * b for a, b in zip(one, other, strict=True)]
        rows[j] = [sine * a + cosine * b for a, b in zip(one, other, strict=True)]
    return True


def _step(
    parameters: list[float],
    lower: Sequence[float],
    misses: list[float],
    slopes: list[list[float]],
    free: list[int],
    damping: float,
) -> list[float]:
    """The parameters after one step of the free ones."""
    root = math.sqrt(damping)
    # Solved as a least-squares problem, which gives the shortest step if parameters are redundant.
    columns = [[*slopes[i], *(root * math.hypot(*slopes[i]) if i == j else 0.0 for j in free)] for i in free]
    step = shortest_solution(columns, [*(-miss for miss in misses), *(0.0 for _ in free)])
    tried = list(parameters)
    for i, by in zip(free, step, strict=True):
        tried[i] = max(tried[i] + by, lower[i])
    return tried


def _slopes(
    residuals: Callable[[Sequence[float]], Sequence[float]], parameters: list[float], misses: list[float]
) -> list[list[float]]:
    """Forward differences of the residuals by each parameter."""
    slopes = []
    for i, parameter in enumerate(parameters):
        step = STEP * max(abs(parameter), 1.0)
        moved = [*parameters[:i], parameter + step, *parameters[i + 1 :]]
        slopes.append([(there - miss) / step for there, miss in zip(residuals(moved), misses, strict=True)])
    return slopes


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return sum([a * b for a, b in zip(one, other, strict=True)])
