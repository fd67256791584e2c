"""A two-sided Kalman filter of a vehicle's height over ground that slopes, for several sets of readings at once.

From times and readings with their geometry and variances it estimates the height, its rate and the ground's slope at
each time, with their covariance. An infinite variance leaves a reading out, so that one pass gives what each sensor's
neighbours say without it (Rauch, Tung and Striebel 1965).
"""

from dataclasses import dataclass
from itertools import product
from math import factorial

import numpy as np

from msp_range.arrays import Array

STATES = 5
HEIGHT, CLIMB, ACCELERATION, NORTH, EAST = range(STATES)
"""Places in the state: height [m], its rate [m/s] and that one's [m/s^2], and how much the ground rises per metre to
the north and to the east."""
START_STD = np.array([10.0, 3.0, 3.0, 0.1, 0.1])
"""Standard deviations before the first reading. The slope's is that of the bridge's own fusion (6 deg): ground on which
a vehicle lands. The others say nothing."""
MAX_STEP_S = 2.0
"""Longer pauses between readings count as this one [s]: the height is then unknown in any case."""
GATE = 4.5
"""A reading more than this many standard deviations from what the others predict is no reading of the ground. With 3
one hit in 370 is lost; with 6 more short readings move the reference."""
MOST_REFUSED = 3
"""After this many refused readings in a row the next one is used: the ground has a step there."""


@dataclass(frozen=True)
class Smoothed:
    """States at n times, of each of B sets of readings."""

    mean: Array
    covariance: Array
    """(B, n, 5) and (B, n, 5, 5)."""
    log_likelihood: Array
    """Log-likelihood of each reading given those before it, (B, n); 0 where it is left out."""

    def predicted(self, geometry: Array) -> tuple[Array, Array]:
        """What a reading of this geometry should be, and its variance, each (B, n)."""
        expected = np.einsum("bni,ni->bn", self.mean, geometry)
        return expected, np.einsum("ni,bnij,nj->bn", geometry, self.covariance, geometry)


def smooth(
    time_s: Array,
    reading_m: Array,
    geometry: Array,
    variance_m2: Array,
    jerk: Array,
    slope_per_s: Array | float,
    backward: bool = True,
) -> Smoothed:
    """Filter forwards, and back.

    Parameters
    ----------
    time_s
        In order, (n,).
    reading_m, geometry
        Each reading, (n,), and its derivatives by the state, (n, 5): it is their product and noise.
    variance_m2
        Of that noise, (B, n); infinite: not in this set.
    jerk
        Power of the white jerk by which the vehicle moves [m^2/s^5]; of a shape that broadcasts to (B, n).
    slope_per_s
        Growth of the slope's variance, (B,), or one for all [1/s].
    backward
        False: the filtered states, for their likelihood.
    """
    (sets, n), jerk = variance_m2.shape, np.broadcast_to(jerk, variance_m2.shape)
    mean, ahead_mean = np.zeros((2, sets, n, 5))
    covariance, ahead_covariance = np.zeros((2, sets, n, 5, 5))
    log_likelihood = np.zeros((sets, n))
    pauses_s = np.minimum(np.diff(time_s, prepend=time_s[0]), MAX_STEP_S)
    moves, noises = _steps(pauses_s)
    x, p = np.zeros((sets, 5)), np.broadcast_to(np.diag(START_STD**2), (sets, 5, 5)).copy()
    first = np.flatnonzero(np.isfinite(variance_m2).any(axis=0))
    x[:, HEIGHT] = reading_m[first[0]] if first.size else 0.0
    refused, slope_noise = np.zeros(sets), np.zeros((sets, 5, 5))
    slope_noise[:, NORTH, NORTH] = slope_noise[:, EAST, EAST] = slope_per_s
    for i in range(n):
        move = moves[i]
        x = ahead_mean[:, i] = x @ move.T
        p = ahead_covariance[:, i] = move @ p @ move.T + jerk[:, i, None, None] * noises[i] + slope_noise * pauses_s[i]
        across = p @ geometry[i]
        whole = across @ geometry[i] + variance_m2[:, i]
        off = reading_m[i] - x @ geometry[i]
        used = np.isfinite(whole)
        taken = used & ((off**2 < GATE**2 * whole) | (refused >= MOST_REFUSED))
        refused = np.where(used, np.where(taken, 0.0, refused + 1.0), refused)
        gain = np.where(taken, 1.0 / whole, 0.0)[:, None] * across
        x = mean[:, i] = x + gain * off[:, None]
        p = covariance[:, i] = p - gain[:, :, None] * across[:, None, :]
        with np.errstate(invalid="ignore"):
            square = np.minimum(off**2 / whole, GATE**2)
            log_likelihood[:, i] = np.where(used, -0.5 * (np.log(whole) + square), 0.0)
    if backward:
        for i in range(n - 2, -1, -1):
            ahead = ahead_covariance[:, i + 1]
            back = np.linalg.solve(ahead, moves[i + 1] @ covariance[:, i]).transpose(0, 2, 1)
            mean[:, i] += np.einsum("bij,bj->bi", back, mean[:, i + 1] - ahead_mean[:, i + 1])
            covariance[:, i] += back @ (covariance[:, i + 1] - ahead) @ back.transpose(0, 2, 1)
    return Smoothed(mean, covariance, log_likelihood)


def _steps(t: Array) -> tuple[Array, Array]:
    """How the state moves in each of these times t [s], and what a unit of white jerk adds to its covariance."""
    moves = np.broadcast_to(np.eye(5), (t.size, 5, 5)).copy()
    moves[:, HEIGHT, CLIMB] = moves[:, CLIMB, ACCELERATION] = t
    moves[:, HEIGHT, ACCELERATION] = t * t / 2.0
    noises = np.zeros((t.size, 5, 5))
    # The integral of s^(2-i) / (2-i)! s^(2-j) / (2-j)! over the time, for height, its rate and that one's.
    for i, j in product((HEIGHT, CLIMB, ACCELERATION), repeat=2):
        power = 5 - i - j
        noises[:, i, j] = t**power / (power * factorial(2 - i) * factorial(2 - j))
    return moves, noises
