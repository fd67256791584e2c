"""Fit the base mixture by maximum likelihood: weights, sigma, lambda and their errors from readings at known ranges.

Readings and their expected ranges enter, one row per reading; parameters leave, with standard errors
from the observed information, intervals, and the log-likelihood. The likelihood is that of `ReadingModel` (report
5.2.1 with erratum 6): intervals of the readings' grid, limits, and codes as point masses.
"""

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msp_range.arrays import Array
from msp_range.reading_model import densities as mix
from msp_range.reading_model.fit_result import (
    BOUNDS,
    FitError,
    FitResult,
    bounds_of,
    columns,
    result_of,
)
from msp_range.reading_model.grid import NOWHERE, ReadingGrid
from msp_range.reading_model.likelihood import Likelihood
from msp_range.reading_model.newton import GAIN, NotConvergedError, Optimum, maximise

FEWEST_READINGS = 50
FEWEST_HITS = 20
START_ROWS = 4_000
"""Number of rows on which the start values are compared."""
STAGE = 6
"""Factor on the number of rows from one stage of the fit to the next, until all are used."""
SHORTEST_SPAN = 0.05
"""Ranges that differ by less than this share of the largest count as equal."""
FEW_RANGES = 0.2
"""Equal rows are counted if there are fewer distinct ranges than this share of a sample of the rows."""


def fit_readings(
    reading_cm: ArrayLike,
    expected_cm: ArrayLike,
    grid: ReadingGrid,
    *,
    growth: bool = False,
    reference_std_cm: ArrayLike | None = None,
) -> FitResult:
    """Fit the base mixture to readings.

    Parameters
    ----------
    reading_cm
        Readings and codes as the sensor reported them [cm], (n,).
    expected_cm
        Mean reading of a hit [cm], (n,): the true range, or `Calibration.forward` of it. Infinite if there is no
        echo.
    grid
        The possible readings.
    growth
        Test whether spread and missed echoes depend on range, and select by BIC. This assumes independent readings;
        otherwise it selects too much.
    reference_std_cm
        Standard deviation of each expected range's own normal error [cm], (n,); None: they are exact. It widens the
        hits and is no part of sigma.

    Returns
    -------
    FitResult

    Raises
    ------
    FitError
        There are too few readings, or readings or ranges are implausible.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> expected_cm = rng.uniform(100.0, 500.0, 5000)
    >>> reading_cm = np.rint(expected_cm + 1.5 * rng.standard_normal(5000))
    >>> reading_cm[:250] = 765
    >>> result = fit_readings(reading_cm, expected_cm, ReadingGrid(20, 765))
    >>> print(f"{result.estimates['sigma_cm']:.2f} {result.standard_errors['sigma_cm']:.2f}")
    1.49 0.02
    >>> print("{:.3f} {:.3f}".format(*result.interval("missed")), result.at_bound)
    0.044 0.056 ('short', 'random')
    """
    reading, expected = columns(reading_cm, expected_cm)
    cell = _checked_cells(reading, expected, grid)
    reference_cm2 = None if reference_std_cm is None else np.asarray(reference_std_cm, dtype=np.float64) ** 2
    rows = _counted(grid, cell, expected, reference_cm2)
    moving = [mix.U, mix.R, mix.M, mix.T, mix.L]
    if grid.second_no_echo_cm is not None:
        moving.append(mix.S)
    try:
        best = _climb(rows, _start(rows, moving), moving)
        if growth:
            best, moving = _with_growth(rows, best, moving)
    except NotConvergedError as error:
        raise FitError(f"the fit of {reading.size} readings does not converge: {error}") from None
    result = result_of(rows, best, moving)
    hits, sigma_cm = result.estimates["hit"] * reading.size, result.estimates["sigma_cm"]
    if hits < FEWEST_HITS or best.theta[mix.T] >= BOUNDS.upper[mix.T]:
        raise FitError(
            f"found {hits:.0f} hits with a spread of {sigma_cm:.3g} cm in {reading.size} readings, expected at least "
            f"{FEWEST_HITS} around their ranges; do the ranges belong to these readings, and are they in centimetres?"
        )
    return result


def _checked_cells(reading: Array, expected: Array, grid: ReadingGrid) -> NDArray[np.int64]:
    """Cells of the readings, or a FitError."""
    if reading.size < FEWEST_READINGS:
        raise FitError(f"found {reading.size} readings, expected at least {FEWEST_READINGS}; take more")
    for name, column in (("readings", reading), ("expected ranges", expected)):
        unknown = int(np.isnan(column).sum())
        if unknown:
            raise FitError(f"found {unknown} {name} that are unknown (NaN), expected none; leave out their rows")
    cell = grid.cell(reading)
    odd = np.flatnonzero(cell == NOWHERE)
    limits = f"{grid.minimum_cm:g} to {grid.maximum_cm:g} cm by {grid.resolution_cm:g}"
    if odd.size:
        codes = [grid.maximum_cm, *([] if grid.second_no_echo_cm is None else [grid.second_no_echo_cm])]
        inside = (reading[odd] >= grid.minimum_cm) & (reading[odd] <= grid.maximum_cm)
        if np.median(reading) < 0.05 * np.median(expected):
            advice = "they look like metres: give centimetres"
        elif inside.all():
            advice = "give the resolution with which they were written, or round them with grid.nearest"
        else:
            advice = "widen the limits or name the code"
        raise FitError(
            f"found {odd.size} of {reading.size} readings that the sensor cannot report, such as "
            f"{reading[odd[0]]:g}, expected {limits} and codes {', '.join(f'{code:g}' for code in codes)}; {advice}"
        )
    if (cell < 0).all():
        raise FitError(f"found nothing but codes for 'no echo' in {reading.size} readings, expected ranges")
    usable = (cell >= 0) & (expected < np.inf)
    if not usable.any():
        raise FitError("found no reading with a finite expected range, expected some")
    some = np.flatnonzero(usable)[:: max(usable.size // START_ROWS, 1)]
    middles = float(np.median(reading[some])), float(np.median(expected[some]))
    if middles[0] > 30.0 * abs(middles[1]):
        raise FitError(
            f"found expected ranges with a median of {middles[1]:.3g} for readings with one of {middles[0]:.3g} cm, "
            "expected centimetres for both; the ranges look like metres"
        )
    return cell


def _counted(grid: ReadingGrid, cell: NDArray[np.int64], expected: Array, reference_cm2: Array | None) -> Likelihood:
    """The likelihood of the rows; equal ones are combined if there are few ranges."""
    if reference_cm2 is not None and reference_cm2.any():
        return Likelihood(grid, cell, expected, np.ones(expected.size), reference_cm2)
    sample = expected[:: max(expected.size // 5_000, 1)]
    if np.unique(sample).size > FEW_RANGES * sample.size:
        return Likelihood(grid, cell, expected, np.ones(expected.size))
    ranges = np.unique(expected)
    kinds = grid.cells - NOWHERE
    key = np.searchsorted(ranges, expected) * kinds + (cell - NOWHERE)
    if ranges.size * kinds <= 4 * expected.size + 100_000:
        counts = np.bincount(key)
        keys = np.flatnonzero(counts)
        counts = counts[keys]
    else:
        keys, counts = np.unique(key, return_counts=True)
    return Likelihood(grid, keys % kinds + NOWHERE, ranges[keys // kinds], counts.astype(np.float64))


def _with_growth(rows: Likelihood, base: Optimum, moving: list[int]) -> tuple[Optimum, list[int]]:
    """Add each dependence on range that by itself gains what BIC requires."""
    nearest_cm, farthest_cm = rows.ranges_cm
    if farthest_cm - nearest_cm < SHORTEST_SPAN * farthest_cm:
        return base, moving
    kept = []
    for number, start in ((mix.V, 1e-6), (mix.G, 0.0)):
        if number == mix.G and mix.M not in base.inside:
            continue
        theta = np.array(base.theta)
        theta[number] = start
        try:
            gain = _climb_from(rows, theta, [*moving, number]).value - base.value
        except NotConvergedError:
            continue
        if gain > 0.5 * math.log(rows.readings):
            kept.append(number)
    if not kept:
        return base, moving
    theta = np.array(base.theta)
    theta[mix.V] = 1e-6 if mix.V in kept else 0.0
    try:
        return _climb_from(rows, theta, [*moving, *kept]), [*moving, *kept]
    except NotConvergedError:
        return base, moving


def _start(rows: Likelihood, moving: Sequence[int]) -> Array:
    """The best of a few fits to some of the rows, starting with small and large spread and lambda."""
    few = rows.part(max(rows.rows // START_ROWS, 1))
    theta = np.zeros(len(mix.NAMES))
    error, weight = few.errors()
    share = few.no_echoes / few.readings
    distance = np.abs(error)
    theta[[mix.M, mix.S]] = min(max(share, 0.005), 0.9), 0.2 if mix.S in moving else 0.0
    best: Optimum | None = None
    # A share p of all readings lies within so many sigmas of the centre if nearly all are hits, or if half are.
    # Readings that hardly differ do not determine a sigma below a step: start with a small one and with one step.
    step_cm = rows.grid.resolution_cm
    for share, sigmas, least in ((0.5, 0.674, step_cm), (0.2, 0.524, 0.3 * step_cm)):
        sigma = max(_quantile(distance, weight, share) / sigmas, least)
        shorter = float(weight[error < -4.0 * sigma].sum() / weight.sum())
        longer = float(weight[error > 4.0 * sigma].sum() / weight.sum())
        for per_length in (0.5, 5.0):
            theta[mix.T], theta[mix.L] = math.log(sigma), per_length / few.mean_length_cm
            theta[mix.U], theta[mix.R] = min(max(shorter, 0.01), 0.4), min(max(2.0 * longer, 0.01), 0.4)
            try:
                found = maximise(
                    partial(few.derivatives, free=mix.optional(moving)), theta, moving, bounds_of(moving), 1e-2
                )
            except NotConvergedError:
                continue
            if best is None or found.value > best.value:
                best = found
    if best is None:
        raise NotConvergedError("from none of its starts")
    return best.theta


def _climb(rows: Likelihood, start: Array, moving: Sequence[int]) -> Optimum:
    """Maximise on a share of the rows, on a larger share, and on all of them."""
    every = rows.rows // START_ROWS // STAGE
    theta = start
    while every > 1:
        theta = _climb_from(rows.part(every), theta, moving, 0.1).theta
        every //= STAGE
    return _climb_from(rows, theta, moving)


def _climb_from(rows: Likelihood, start: Array, moving: Sequence[int], gain: float = GAIN) -> Optimum:
    """Maximise, starting with all weights above 0, because fewer rows may not have had readings of every kind."""
    theta = np.array(start)
    theta[[mix.U, mix.R, mix.M]] = np.maximum(theta[[mix.U, mix.R, mix.M]], 1e-4)
    if mix.S in moving:
        theta[mix.S] = min(max(theta[mix.S], 1e-3), 1.0 - 1e-3)
    return maximise(partial(rows.derivatives, free=mix.optional(moving)), theta, moving, bounds_of(moving), gain)


def _quantile(ordinate: Array, weight: Array, share: float) -> float:
    """Weighted quantile."""
    order = np.argsort(ordinate)
    below = np.cumsum(weight[order])
    return float(ordinate[order[np.searchsorted(below, share * below[-1])]])
