"""The maximum of a log-likelihood within bounds, by damped steps of scoring.

Numbers at a bound that want to go beyond it are held, the others step by the inverse of their information, and the step
is damped until it gains (Levenberg 1944; Bertsekas 1982, SIAM J. Control Optim. 20). With the outer product of the
scores as information (Berndt et al. 1974) no second derivatives are needed.
"""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from msp_range.arrays import Array, Flags

ROUNDS = 12
"""Steps at most; usual fits take three to six."""
DAMPINGS = 8
"""A step that gains nothing is tried again with more damping, up to this many times."""
DAMPING, LEAST_DAMPING, FAILED_DAMPING, RAISED = 1e-3, 1e-6, 1e-2, 10.0
"""Share of the information's diagonal that is added: at first, at least, at least after a step that gained nothing, and
by what it falls and is raised. Any start from 1e-5 to 1 takes as many steps within 10 %."""
LEAST_NATS = 1e-7
"""A step that promises less is not taken: it is 0.0005 standard errors long, and what it gains is near the rounding of
a sum of a million logarithms."""
LEAST_INFORMATION = 1e-9
"""Numbers with less are held: no reading depends on them."""

Here = TypeVar("Here")


def held_numbers(at: Array, gradient: Array, information: Array, low: Array, high: Array) -> Flags:
    """Numbers at a bound that want to go beyond it, with equal bounds, or without information."""
    held: Flags = ((at <= low) & (gradient < 0.0)) | ((at >= high) & (gradient > 0.0)) | (low == high)
    return held | (np.diag(information) < LEAST_INFORMATION)


def maximise(
    value_of: Callable[[Array], tuple[float, Here]],
    slopes_of: Callable[[Array, Here], tuple[Array, Array]],
    start: Array,
    bounds: tuple[Array, Array],
    enough_nats: float,
    rounds: int = ROUNDS,
    known: tuple[float, Here] | None = None,
) -> tuple[Array, float, Here]:
    """Climb from a start.

    Parameters
    ----------
    value_of
        Log-likelihood at some numbers, and what their slopes follow from.
    slopes_of
        Gradient (k,) and information (k, k) there.
    start, bounds
        Numbers (k,), with their lowest and highest values.
    enough_nats, rounds
        It ends with a step that gains less, or after so many.
    known
        What `value_of` has returned at the start; None: it is asked.

    Returns
    -------
    tuple
        Numbers, their log-likelihood, and what `value_of` returned with it.
    """
    low, high = bounds
    at = start
    best, here = value_of(at) if known is None else known
    damping = DAMPING
    for _ in range(rounds):
        gradient, information = slopes_of(at, here)
        free = ~held_numbers(at, gradient, information, low, high)
        own, gained = information[np.ix_(free, free)], 0.0
        step = np.zeros(at.size)
        for _ in range(DAMPINGS):
            step[free] = np.linalg.lstsq(own + damping * np.diag(np.diag(own)), gradient[free], rcond=1e-10)[0]
            if 0.5 * float(gradient @ step) < LEAST_NATS:
                break
            there = np.clip(at + step, low, high)
            value, here_there = value_of(there)
            if value > best:
                gained, best, at, here = value - best, value, there, here_there
                damping = max(damping / RAISED, LEAST_DAMPING)
                break
            damping = max(damping * RAISED, FAILED_DAMPING)
        if gained < enough_nats:
            break
    return at, best, here
