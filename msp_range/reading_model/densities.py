"""The base mixture on a grid of readings, with its derivatives by the fitted parameters.

Cells of readings and their expected ranges enter; their probabilities leave, with first and second derivatives. The
kinds of reading are those of `msp_range.reading_model.kernel`, mixed as `mixture.ReadingModel` says.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from msp_range.arrays import Array
from msp_range.reading_model.grid import NO_ECHO, NOWHERE, SECOND_NO_ECHO, ReadingGrid
from msp_range.reading_model.kernel import NO_ECHO_CENTRE, Hit, Missed, Random, Short
from msp_range.reading_model.sensor_model import WEIGHTS_RANGE_CM

_Add = Callable[[int, int, Array], None]

NAMES = (
    "short",  # share of the readings that are not missed
    "random",  # likewise
    "missed",  # share, at the reference range
    "log_sigma",
    "rate",  # lambda [1/cm]
    "second",  # fraction of no-echo codes that arrive as the second code
    "sigma_growth",  # squared [cm^2/cm^2]
    "missed_growth",  # [1/cm]
)
"""Parameters in the order of every vector here."""
U, R, M, T, L, S, V, G = range(len(NAMES))


class Terms:
    """Probability q of each row's reading before the second code, its first derivatives, and sums of the second ones.

    Parameters
    ----------
    grid
        The possible readings.
    cell, expected_cm
        Cells of readings on the grid (from 0 on) or of the no-echo code (all `NO_ECHO`), and the expected ranges of
        hits.
    theta, free
        Parameters, and those from sigma_growth on whose derivatives are computed.
    below
        Compute the probability of all readings up to each one, instead of its own.
    reference_cm2
        Variance of the error of each expected range [cm^2], part of the hits' variance.
    """

    def __init__(
        self,
        grid: ReadingGrid,
        cell: NDArray[np.int64],
        expected_cm: Array,
        theta: Array,
        free: frozenset[int],
        below: bool,
        reference_cm2: float | Array,
    ) -> None:
        self.theta, self.free = theta, free
        lowest, highest, step = grid.minimum_cm, grid.maximum_cm, grid.resolution_cm
        is_code = bool(cell.size) and bool(cell[0] == NO_ECHO)
        if is_code:
            cell = np.full(cell.size, grid.cells - 1)
        last: Array = np.asarray(lowest + step * cell, dtype=np.float64)
        first: Array = np.full(last.size, lowest, dtype=np.float64) if below else last
        self.expected = np.fmin(expected_cm, NO_ECHO_CENTRE)
        # Spread and missed echoes may depend on the range within 0 ... maximum [cm].
        self.within = np.clip(self.expected, 0.0, highest)
        variance = math.exp(2.0 * theta[T]) + reference_cm2
        self.variance: float | Array = variance
        if theta[V] != 0.0 or V in free:
            self.variance = variance + theta[V] * self.within * self.within
        self.hit = Hit(first, last, is_code, self.expected, np.sqrt(self.variance), lowest, step)
        self.short = Short(first, last, self.expected, theta[L], lowest, highest, step)
        self.random = Random(first, last, lowest, highest, step).p
        self.at_code = Missed(is_code).p
        if theta[G] == 0.0 and G not in free:
            self.share: float | Array = theta[M]
        else:
            self.share = expit(logit(theta[M]) + theta[G] * (self.within - WEIGHTS_RANGE_CM))
        self.weight_hit = 1.0 - theta[U] - theta[R]
        self.rest = self.weight_hit * self.hit.p + theta[U] * self.short.p + theta[R] * self.random
        self.left = 1.0 - self.share
        self.q = self.left * self.rest + self.share * self.at_code

    def first(self) -> list[tuple[int, Array]]:
        """Derivatives of q, by number of the parameter; stores intermediate results for `second`."""
        theta, free = self.theta, self.free
        self.d_v = self.hit.by_log_sigma / (2.0 * self.variance)
        # Derivatives of the hit's variance by its parameters.
        start = 2.0 * math.exp(2.0 * theta[T])
        self.by_variance: list[tuple[int, float | Array]] = [(T, start)]
        if V in free:
            self.by_variance.append((V, self.within * self.within))
        self.shape = self.left * self.weight_hit
        self.by_share: list[tuple[int, float | Array]] = [(M, 1.0)]
        if G in free:
            steep = self.share * self.left
            self.by_logit = 1.0 / (theta[M] * (1.0 - theta[M]))
            self.by_share = [(M, steep * self.by_logit), (G, steep * (self.within - WEIGHTS_RANGE_CM))]
        elif theta[G] != 0.0:
            self.by_logit = 1.0 / (theta[M] * (1.0 - theta[M]))
            self.by_share = [(M, self.share * self.left * self.by_logit)]
        self.to_short = self.short.p - self.hit.p
        self.to_random = self.random - self.hit.p
        self.to_missed = self.at_code - self.rest
        self.hits = [(i, each * self.d_v) for i, each in self.by_variance]
        first: list[tuple[int, Array]] = [(U, self.left * self.to_short), (R, self.left * self.to_random)]
        first += [(i, each * self.to_missed) for i, each in self.by_share]
        first += [(i, self.shape * each) for i, each in self.hits]
        first.append((L, self.left * theta[U] * self.short.by_rate))
        return first

    def add_second(self, hessian: Array, weight: Array) -> None:
        """Add the weighted sums of the second derivatives of q to the upper triangle; after `first`."""
        theta = self.theta

        def add(i: int, j: int, array: Array) -> None:
            hessian[min(i, j), max(i, j)] += float(np.dot(weight, array))

        def add_with(i: int, factor: Array | float, others: Sequence[tuple[int, Array]]) -> None:
            for j, each in others:
                add(i, j, factor * each)

        add_with(U, -self.left, self.hits)
        add_with(R, -self.left, self.hits)
        add(U, L, self.left * self.short.by_rate)
        add(L, L, self.left * theta[U] * self.short.by_rate_twice)
        for i, by in self.by_share:
            add(i, U, -by * self.to_short)
            add(i, R, -by * self.to_random)
            add(i, L, -by * theta[U] * self.short.by_rate)
            add_with(i, -by * self.weight_hit, self.hits)
        if len(self.by_share) > 1 or theta[G] != 0.0:
            self._add_share(add)
        d_vv = self.hit.by_variance_twice(self.variance)
        for n, (i, by_i) in enumerate(self.by_variance):
            for j, by_j in self.by_variance[n:]:
                add(i, j, self.shape * d_vv * by_i * by_j)
        add(T, T, self.shape * self.d_v * (2.0 * self.by_variance[0][1]))

    def _add_share(self, add: _Add) -> None:
        """Second derivatives of the share of missed readings, if it depends on range."""
        share, steep = self.theta[M], self.share * self.left
        bend = steep * (1.0 - 2.0 * self.share)
        bent = -(1.0 - 2.0 * share) * self.by_logit**2
        add(M, M, self.to_missed * (bend * self.by_logit**2 + steep * bent))
        if G in self.free:
            beyond = self.within - WEIGHTS_RANGE_CM
            add(M, G, self.to_missed * bend * self.by_logit * beyond)
            add(G, G, self.to_missed * bend * beyond * beyond)


def optional(moving: Sequence[int]) -> frozenset[int]:
    """Those of the parameters whose derivatives are computed on request."""
    return frozenset(number for number in moving if number >= V)


def probabilities(
    grid: ReadingGrid,
    theta: Array,
    reading_cm: Array,
    expected_cm: Array,
    reference_cm2: Array | None = None,
) -> tuple[Array, Array]:
    """Probability of a smaller reading than each, and of each itself, (n,).

    Codes are ordered among the readings by their number.
    """
    cell = grid.cell(reading_cm)
    if reference_cm2 is None:
        reference_cm2 = np.zeros(cell.size)
    second_cm, share = grid.second_no_echo_cm, theta[S] if grid.second_no_echo_cm is not None else 0.0
    free = optional([number for number in (V, G) if theta[number] != 0.0])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
        missed = Terms(grid, np.full_like(cell, NO_ECHO), expected_cm, theta, free, False, reference_cm2).q
        # The grid's readings up to a value, which for a second code off the grid lies between two cells.
        place = np.ceil((reading_cm - grid.minimum_cm) / grid.resolution_cm - 0.5)
        place = np.clip(place, 0, grid.cells - 1).astype(np.int64)
        up_to = Terms(grid, np.maximum(place - 1, 0), expected_cm, theta, free, True, reference_cm2).q
        below = np.where(place > 0, up_to, 0.0)
        own = np.where(cell == SECOND_NO_ECHO, -1 if grid.second_cell is None else grid.second_cell, cell)
        itself = np.zeros(reading_cm.size)
        ordinary = own >= 0
        some = grid, own[ordinary], expected_cm[ordinary], theta, free, False, reference_cm2[ordinary]
        itself[ordinary] = Terms(*some).q
    below += np.where(reading_cm > grid.maximum_cm, (1.0 - share) * missed, 0.0)
    itself += np.where(cell == NO_ECHO, (1.0 - share) * missed, 0.0)
    if second_cm is not None:
        below += np.where(reading_cm > second_cm, share * missed, 0.0)
        itself += np.where(cell == SECOND_NO_ECHO, share * missed, 0.0)
    itself[cell == NOWHERE] = 0.0
    return below, itself
