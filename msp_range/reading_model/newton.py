"""Newton's method for a maximum within bounds, and what a fixed parameter costs.

A log-likelihood with its derivatives, a start and bounds enter; the maximum leaves, with the parameters that a bound
holds. Bertsekas (1982), Projected Newton methods, SIAM J. Control Optim. 20: parameters on their bound that want to
go beyond it are held, the others take a Newton step that is clipped to the bounds and halved until it gains.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from msp_range.arrays import Array, Flags

Derivatives = Callable[[Array], tuple[float, Array, Array]]
"""theta -> value, gradient, Hessian."""

GAIN = 1e-3
"""The last step gains less than this in log-likelihood: it is at most 4 % of a standard error long, and what it leaves
is of the order of its square. It may gain 1000 times as much where the step before says that it leaves next to nothing.
"""
ITERATIONS = 200
HALVINGS = 30
_RIDGE = 0.1
"""A parameter on which nothing depends steps as if it were known to ten of its longest steps: not to infinity."""
_FLATTEST = 1e-9
"""Smallest curvature that is believed, of a Hessian scaled to a diagonal of one."""


class NotConvergedError(ArithmeticError):
    """No step gains, and the gradient says that there is something to gain."""


@dataclass(frozen=True)
class Optimum:
    """A maximum within bounds."""

    theta: Array
    value: float
    gradient: Array
    hessian: Array
    """Where it is, and value, gradient and Hessian there."""
    inside: tuple[int, ...]
    """Numbers of the parameters that moved and are not held by a bound."""


@dataclass(frozen=True)
class Bounds:
    """Where parameters may be, shape (k,) each."""

    lower: Array
    upper: Array
    """Lowest and highest value of each parameter."""
    stride: Array
    """Longest step of one iteration."""
    relative: Flags
    """Whether half of the parameter itself is allowed where that is longer."""

    def longest(self, theta: Array) -> Array:
        """Longest step of each parameter from here."""
        return np.where(self.relative, np.maximum(self.stride, 0.5 * np.abs(theta)), self.stride)


def maximise(derivatives: Derivatives, start: Array, moving: Sequence[int], bounds: Bounds, gain: float) -> Optimum:
    """Climb from `start` with the parameters of the numbers `moving`; the others stay.

    Raises
    ------
    NotConvergedError
        The start has no probability, or the climb does not end.
    """
    theta = np.array(start)
    numbers = np.array(sorted(moving), dtype=np.int64)
    theta[numbers] = np.clip(theta[numbers], bounds.lower[numbers], bounds.upper[numbers])
    value, gradient, hessian = derivatives(theta)
    if value == -math.inf:
        raise NotConvergedError("the start has no probability")
    before = 0.0
    for _ in range(ITERATIONS):
        down = (theta <= bounds.lower) & (gradient <= 0.0)
        up = (theta >= bounds.upper) & (gradient >= 0.0)
        inside = numbers[~(down | up)[numbers]]
        step = np.zeros_like(theta)
        ridge = np.diag((_RIDGE / bounds.longest(theta)[inside]) ** 2)
        step[inside] = _newton(gradient[inside], hessian[np.ix_(inside, inside)] - ridge)
        left = 0.5 * float(gradient @ step)
        # Errors are squared from step to step, so that gains go as 1, c, c^3: the one after this is left^3 / before^2.
        if left < gain or (left < 1e3 * gain and left**3 < 1e-3 * gain * before**2):
            # The last step is taken unseen: there is nothing to see in it.
            last = np.clip(theta + step, bounds.lower, bounds.upper)
            return Optimum(last, value + left, gradient, hessian, tuple(inside.tolist()))
        before = left
        longest = float((np.abs(step) / bounds.longest(theta)).max())
        step /= max(longest, 1.0)
        for _ in range(HALVINGS):
            trial = np.where(step == 0.0, theta, np.clip(theta + step, bounds.lower, bounds.upper))
            found = derivatives(trial)
            # Sums of a million logarithms are known to about this.
            if found[0] > value - 1e-13 * abs(value):
                break
            step /= 2.0
        else:
            if left < 10.0 * gain:
                return Optimum(theta, value, gradient, hessian, tuple(inside.tolist()))
            raise NotConvergedError(f"no step gains, and {left:.3g} is left to gain")
        theta, (value, gradient, hessian) = trial, found
    raise NotConvergedError(f"not at an end after {ITERATIONS} steps")


def profile_limit(
    derivatives: Derivatives,
    best: Optimum,
    moving: Sequence[int],
    number: int,
    bounds: Bounds,
    step: float,
    drop: float,
) -> float:
    """Value of a parameter at which the best log-likelihood of the others has dropped by `drop`.

    Parameters
    ----------
    derivatives, moving, bounds
        As for `maximise`.
    best
        The maximum.
    number
        Of the parameter.
    step
        Where to look first, from the maximum; its sign says to which side.
    drop
        In log-likelihood.

    Returns
    -------
    float
        The limit; the bound where the likelihood does not drop as far before it.
    """
    others = [each for each in moving if each != number]
    start = best.theta
    bound = bounds.upper[number] if step > 0.0 else bounds.lower[number]
    centre = float(best.theta[number])

    # Asked for twice, a place must give the same answer; the climb there depends on where the last one ended.
    known = {centre: -drop}

    def excess(value: float) -> float:
        nonlocal start
        if value not in known:
            theta = np.array(start)
            theta[number] = value
            try:
                found = maximise(derivatives, theta, others, bounds, gain=1e-4)
                start = found.theta
                known[value] = best.value - found.value - drop
            except NotConvergedError:
                known[value] = math.inf
        return known[value]

    near, far, at_far = centre, centre + step, -math.inf
    for _ in range(60):
        far = min(far, bound) if step > 0.0 else max(far, bound)
        at_far = excess(far)
        if at_far > 0.0 or far == bound:
            break
        near, far = far, far + 2.0 * (far - centre)
    if at_far <= 0.0:
        return float(bound)
    for _ in range(60):
        # A place without any probability has no root's function: come nearer.
        if at_far < math.inf:
            break
        middle = 0.5 * (near + far)
        at_middle = excess(middle)
        if at_middle > 0.0:
            far, at_far = middle, at_middle
        else:
            near = middle
    return float(brentq(excess, near, far, xtol=1e-4 * abs(far - centre), rtol=1e-9)) if near != far else near


def _newton(gradient: Array, hessian: Array) -> Array:
    """Step to the maximum of the quadratic form; where it bends upwards, as if it bent downwards as much."""
    if not gradient.size:
        return gradient
    scale = np.sqrt(np.abs(np.diag(hessian)))
    curvature, axes = np.linalg.eigh(-hessian / np.outer(scale, scale))
    curvature = np.maximum(np.abs(curvature), _FLATTEST)
    step: Array = axes @ ((axes.T @ (gradient / scale)) / curvature) / scale
    return step
