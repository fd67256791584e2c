"""The densities of the base mixture on a grid of readings, with their derivatives by the parameters.

Cells of readings enter with the range at which each is expected; their probabilities leave, and first and second
derivatives. The probabilities are those of `msp_range.reading_model.mixture.ReadingModel`, on any `ReadingGrid`; that
module has the equations and this one their derivatives.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit, ndtr

from msp_range.reading_model.grid import NO_ECHO, NOWHERE, SECOND_NO_ECHO, ReadingGrid
from msp_range.reading_model.sensor_model import WEIGHTS_RANGE_CM

_Array = NDArray[np.float64]
_Add = Callable[[int, int, _Array], None]

NAMES = (
    "unexpected",  # share of the readings that are not max
    "random",  # likewise
    "max",  # share, at the reference range
    "log_sigma",
    "rate",  # lambda [1/cm]
    "second",  # fraction of no-echo codes that arrive as the second code
    "sigma_growth",  # squared [cm^2/cm^2]
    "max_growth",  # [1/cm]
    "offset",  # bias [cm]
    "scale",
)
"""Parameters in the order of every vector here."""
U, R, M, T, L, S, V, G, B, C = range(len(NAMES))

FAR_CM = 1e12
"""Edge of an interval without an end. Finite, so that its products with a density of zero are zero."""
UNHEARD_CM = 1e7
"""Centre of the hits of a surface that cannot be heard: beyond every sensor."""


@dataclass(frozen=True)
class Cells:
    """Rows of one kind, as the densities want them.

    Attributes
    ----------
    lower, upper
        Interval of a hit [cm].
    centre
        Expected range [cm].
    maximum
        The sensor's longest reading [cm].
    near, far, length
        Interval of the unexpected, and the length of its exponential, from the minimum on [cm].
    random
        Probability of a random reading's cell.
    missed
        1 where the cell is the no-echo code, otherwise 0.
    """

    lower: _Array
    upper: _Array
    centre: _Array
    maximum: float
    near: _Array
    far: _Array
    length: _Array
    random: float | _Array
    missed: float

    @property
    def within(self) -> _Array:
        """Expected range within 0 ... maximum, on which spread and missed echoes may depend [cm]."""
        return np.clip(self.centre, 0.0, self.maximum)


def cells_of(grid: ReadingGrid, cell: NDArray[np.int64], expected_cm: _Array) -> Cells:
    """Rows of readings on the grid (`cell` from 0 on), or of the no-echo code (all `NO_ECHO`)."""
    m, r = grid.minimum_cm, grid.resolution_cm
    missed = bool(cell.size) and bool(cell[0] == NO_ECHO)
    # fmin and not minimum: it takes NaN and infinity, a surface that is not heard, out of reach.
    centre = np.fmin(expected_cm, UNHEARD_CM)
    length = np.clip(centre, m, grid.maximum_cm) - m
    if missed:
        cell = np.full(cell.size, grid.cells - 1 if grid.code_on_grid else grid.cells)
    left = r * cell - r / 2
    right = left + r
    lower: _Array = np.where(cell == 0, -FAR_CM, left + m)
    upper: _Array = np.where(missed, FAR_CM, right + m)
    near = np.clip(left, 0.0, length)
    far = np.clip(right, near, length)
    # An exponential without a length is all in the first cell: one that ends far away and has fallen off long before.
    none = length == 0.0
    if none.any():
        near[none] = np.where(cell[none] == 0, 0.0, FAR_CM)
        far[none] = length[none] = FAR_CM
    random = 0.0 if missed and not grid.code_on_grid else 1.0 / grid.cells
    return Cells(lower, upper, centre, grid.maximum_cm, near, far, length, random, float(missed))


class Terms:
    """Probability q of each row's cell before the second code, its first derivatives, and sums of the second ones."""

    def __init__(self, cells: Cells, theta: _Array, free: frozenset[int]) -> None:
        self.cells, self.theta, self.free = cells, theta, free
        variance = math.exp(2.0 * theta[T])
        self.variance: float | _Array = variance
        if theta[V] != 0.0 or V in free:
            self.variance = variance + theta[V] * cells.within * cells.within
        self.sigma = np.sqrt(self.variance)
        centre = cells.centre if theta[B] == 0.0 and theta[C] == 1.0 else theta[B] + theta[C] * cells.centre
        self.a = (cells.lower - centre) / self.sigma
        self.b = (cells.upper - centre) / self.sigma
        # On the left side of the bell both terms are small, and nothing cancels.
        right = self.a + self.b > 0.0
        self.hit = ndtr(np.where(right, -self.a, self.b)) - ndtr(np.where(right, -self.b, self.a))
        rate = theta[L]
        self.e_near = np.exp(-rate * cells.near)
        self.e_width = np.expm1(rate * (cells.near - cells.far))
        self.below = -np.expm1(-rate * cells.length)
        self.unexpected = -self.e_near * self.e_width / self.below
        if theta[G] == 0.0 and G not in free:
            self.max: float | _Array = theta[M]
        else:
            self.max = expit(logit(theta[M]) + theta[G] * (cells.within - WEIGHTS_RANGE_CM))
        self.weight_hit = 1.0 - theta[U] - theta[R]
        self.rest = self.weight_hit * self.hit + theta[U] * self.unexpected + theta[R] * cells.random
        self.left = 1.0 - self.max
        self.q = self.left * self.rest + self.max * cells.missed

    def first(self) -> list[tuple[int, _Array]]:
        """Derivatives of q, by number of the parameter; keeps what `second` needs."""
        cells, theta, free = self.cells, self.theta, self.free
        a, b, sigma, variance = self.a, self.b, self.sigma, self.variance
        half_a = np.exp(-0.5 * a * a) * (1.0 / math.sqrt(2.0 * math.pi))
        half_b = np.exp(-0.5 * b * b) * (1.0 / math.sqrt(2.0 * math.pi))
        a_a, b_b = a * half_a, b * half_b
        self.d_v = (a_a - b_b) / (2.0 * variance)
        self.d_vv = ((a * a - 3.0) * a_a - (b * b - 3.0) * b_b) / (4.0 * variance * variance)
        # Derivatives of the hit's variance and of its centre by their parameters.
        start = 2.0 * math.exp(2.0 * theta[T])
        self.by_variance: list[tuple[int, float | _Array]] = [(T, start)]
        if V in free:
            self.by_variance.append((V, cells.within * cells.within))
        self.by_centre: list[tuple[int, float | _Array]] = []
        if B in free:
            self.by_centre.append((B, 1.0))
        if C in free:
            self.by_centre.append((C, cells.centre))
        if self.by_centre:
            self.d_m = (half_a - half_b) / sigma
            self.d_mv = ((a * a - 1.0) * half_a - (b * b - 1.0) * half_b) / (2.0 * variance * sigma)
        e_far = self.e_near * (1.0 + self.e_width)
        e_length = 1.0 - self.below
        near_near, far_far = cells.near * self.e_near, cells.far * e_far
        by_rate = cells.length * e_length
        self.d_u = (far_far - near_near - self.unexpected * by_rate) / self.below
        top = cells.near * near_near - cells.far * far_far
        self.d_uu = (top - 2.0 * self.d_u * by_rate + self.unexpected * cells.length * by_rate) / self.below
        self.shape = self.left * self.weight_hit
        self.d_max: list[tuple[int, float | _Array]] = [(M, 1.0)]
        if G in free:
            steep = self.max * self.left
            self.by_logit = 1.0 / (theta[M] * (1.0 - theta[M]))
            self.d_max = [(M, steep * self.by_logit), (G, steep * (cells.within - WEIGHTS_RANGE_CM))]
        elif theta[G] != 0.0:
            self.by_logit = 1.0 / (theta[M] * (1.0 - theta[M]))
            self.d_max = [(M, self.max * self.left * self.by_logit)]
        self.to_unexpected = self.unexpected - self.hit
        self.to_random = cells.random - self.hit
        self.to_max = cells.missed - self.rest
        self.hits = [(i, each * self.d_v) for i, each in self.by_variance]
        self.hits += [(i, each * self.d_m) for i, each in self.by_centre]
        first: list[tuple[int, _Array]] = [(U, self.left * self.to_unexpected), (R, self.left * self.to_random)]
        first += [(i, each * self.to_max) for i, each in self.d_max]
        first += [(i, self.shape * each) for i, each in self.hits]
        first.append((L, self.left * theta[U] * self.d_u))
        return first

    def add_second(self, hessian: _Array, weight: _Array) -> None:
        """Add the weighted sums of the second derivatives of q to the upper triangle; after `first`."""
        theta = self.theta

        def add(i: int, j: int, array: _Array) -> None:
            hessian[min(i, j), max(i, j)] += float(np.dot(weight, array))

        def add_with(i: int, factor: _Array | float, others: Sequence[tuple[int, _Array]]) -> None:
            for j, each in others:
                add(i, j, factor * each)

        add_with(U, -self.left, self.hits)
        add_with(R, -self.left, self.hits)
        add(U, L, self.left * self.d_u)
        add(L, L, self.left * theta[U] * self.d_uu)
        for i, by in self.d_max:
            add(i, U, -by * self.to_unexpected)
            add(i, R, -by * self.to_random)
            add(i, L, -by * theta[U] * self.d_u)
            add_with(i, -by * self.weight_hit, self.hits)
        if len(self.d_max) > 1 or theta[G] != 0.0:
            self._add_max(add)
        for n, (i, by_i) in enumerate(self.by_variance):
            for j, by_j in self.by_variance[n:]:
                add(i, j, self.shape * self.d_vv * by_i * by_j)
            for j, by_j in self.by_centre:
                add(i, j, self.shape * self.d_mv * by_i * by_j)
        add(T, T, self.shape * self.d_v * (2.0 * self.by_variance[0][1]))
        for n, (i, by_i) in enumerate(self.by_centre):
            for j, by_j in self.by_centre[n:]:
                add(i, j, self.shape * (2.0 * self.d_v) * by_i * by_j)

    def _add_max(self, add: _Add) -> None:
        """Second derivatives of the share of max, where it depends on range."""
        share, steep = self.theta[M], self.max * self.left
        bend = steep * (1.0 - 2.0 * self.max)
        bent = -(1.0 - 2.0 * share) * self.by_logit**2
        add(M, M, self.to_max * (bend * self.by_logit**2 + steep * bent))
        if G in self.free:
            beyond = self.cells.within - WEIGHTS_RANGE_CM
            add(M, G, self.to_max * bend * self.by_logit * beyond)
            add(G, G, self.to_max * bend * beyond * beyond)


def optional(moving: Sequence[int]) -> frozenset[int]:
    """Those of the numbers whose derivatives have to be asked for."""
    return frozenset(number for number in moving if number >= V)


def probabilities(grid: ReadingGrid, theta: _Array, reading_cm: _Array, expected_cm: _Array) -> tuple[_Array, _Array]:
    """Probability of a smaller reading than each, and of each itself, (n,).

    Codes have their place among the readings by their number.
    """
    cell = grid.cell(reading_cm)
    second_cm, share = grid.second_no_echo_cm, theta[S] if grid.second_no_echo_cm is not None else 0.0
    free = optional([number for number in (V, G) if theta[number] != 0.0])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore", under="ignore"):
        missed = Terms(cells_of(grid, np.full_like(cell, NO_ECHO), expected_cm), theta, free).q
        # The grid's own readings up to a place, which is between two of its cells also for a code outside of it.
        on_grid = grid.cells - 1 if grid.code_on_grid else grid.cells
        place = np.ceil((reading_cm - grid.minimum_cm) / grid.resolution_cm - 0.5)
        place = np.clip(place, 0, on_grid).astype(np.int64)
        below = np.where(place > 0, _up_to(grid, theta, place - 1, expected_cm, free), 0.0)
        own = np.where(cell == SECOND_NO_ECHO, -1 if grid.second_cell is None else grid.second_cell, cell)
        itself = np.zeros(reading_cm.size)
        ordinary = own >= 0
        of_own = cells_of(grid, own[ordinary], expected_cm[ordinary])
        itself[ordinary] = Terms(of_own, theta, free).q
    below += np.where(reading_cm > grid.code_cm, (1.0 - share) * missed, 0.0)
    itself += np.where(cell == NO_ECHO, (1.0 - share) * missed, 0.0)
    if second_cm is not None:
        below += np.where(reading_cm > second_cm, share * missed, 0.0)
        itself += np.where(cell == SECOND_NO_ECHO, share * missed, 0.0)
    itself[cell == NOWHERE] = 0.0
    return below, itself


def _up_to(
    grid: ReadingGrid, theta: _Array, cell: NDArray[np.int64], expected_cm: _Array, free: frozenset[int]
) -> _Array:
    """Probability of the cells from the first to `cell`, without those of the codes."""
    cell = np.maximum(cell, 0)
    cells = cells_of(grid, cell, expected_cm)
    none = cells.length >= FAR_CM
    near = np.zeros(cell.size)
    wide = replace(
        cells,
        lower=np.full(cell.size, -FAR_CM),
        near=near,
        far=np.where(none, FAR_CM, cells.far),
        random=(cell + 1.0) / grid.cells,
    )
    q: _Array = Terms(wide, theta, free).q
    return q
