"""Fit the base mixture by maximum likelihood: weights, sigma, lambda and their errors from readings at known ranges.

Standard errors are by the curvature, of some 100,000 of the readings. The likelihood is that of `ReadingModel` (report
5.2.1 with erratum 6): intervals of the readings' grid, limits, and codes as point masses.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from msp_lab.mixture_fit.fit_result import FitError, FitResult, columns, result_of
from msp_lab.mixture_fit.grid import ReadingGrid
from msp_lab.mixture_fit.likelihood import Likelihood, Optimum
from msp_lab.mixture_fit.parameters import HIGHEST, MIN_WEIGHT, NAMES, Numbers, bounds_of
from msp_range.reading_model.kernel import NO_ECHO_CENTRE

FEWEST_READINGS = 50
FEWEST_HITS = 20
START_ROWS = 4_000
"""Number of rows on which the start values are compared."""
START_NATS = 0.1
"""Starts are compared when a step gains less [nats]: they differ by more, and the best one is climbed on from."""
MOST_LEFT_NATS = 0.1
"""A fit has not converged where a further step promises more: half a standard error. Usual ones leave 0.001."""
SMALL_GROWTH = 0.01
"""Where a fit with growth of the spread starts [(cm/m)^2]: at 0 it would be at a bound."""
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
    reference_std_cm: ArrayLike = 0.0,
) -> FitResult:
    """Fit the base mixture to readings.

    Parameters
    ----------
    reading_cm, expected_cm
        Readings and codes as the sensor reported them [cm], (n,), and the mean reading of a hit [cm], (n,): the true
        range, or `Calibration.forward` of it. Infinite if there is no echo. All are known, and the readings are those
        that the sensor can report: the intake has refused others.
    grid
        The possible readings.
    growth
        Test whether spread and missed echoes depend on range, and select by BIC. This assumes independent readings;
        otherwise it selects too much.
    reference_std_cm
        Standard deviation of each expected range's own normal error [cm], a number or (n,). It widens the hits and is
        no part of sigma.

    Raises
    ------
    FitError
        There are too few readings or hits.

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
    rows = _counted(grid, reading_cm, expected_cm, reference_std_cm)
    moving = [name for name in NAMES[:6] if grid.saturates or name != "saturated"]
    mean_length_m = _mean_length_m(rows)
    best = rows.optimum(_start(rows.sample(START_ROWS), moving, mean_length_m), moving)
    if growth and (kept := _growth(rows, best, moving)):
        moving = [*moving, *kept]
        best = rows.optimum(_growing(best.numbers, kept), moving)
    if best.left_nats > MOST_LEFT_NATS:
        raise FitError(f"the fit of {rows.readings:.0f} readings does not converge: {best.left_nats:.2g} nats are left")
    result = result_of(rows, best, moving, mean_length_m)
    hits, sigma_cm = rows.hits(best.numbers), result.estimates["sigma_cm"]
    if hits < FEWEST_HITS or best.numbers.log_sigma >= HIGHEST.log_sigma:
        raise FitError(
            f"found {hits:.0f} hits with a spread of {sigma_cm:.3g} cm in {rows.readings:.0f} readings, expected at "
            f"least {FEWEST_HITS} around their ranges; do the ranges belong to these readings, and are they in "
            "centimetres?"
        )
    return result


def _counted(
    grid: ReadingGrid, reading_cm: ArrayLike, expected_cm: ArrayLike, reference_std_cm: ArrayLike
) -> Likelihood:
    """The likelihood of the rows; equal ones are combined if there are few ranges, and these are exact."""
    reading, expected = columns(reading_cm, expected_cm)
    reading = grid.nearest(reading)
    if reading.size < FEWEST_READINGS:
        raise FitError(f"found {reading.size} readings, expected at least {FEWEST_READINGS}; take more")
    if np.isin(reading, grid.codes_cm).all():
        raise FitError(f"found nothing but codes for 'no echo' in {reading.size} readings, expected ranges")
    reference_cm2 = np.broadcast_to(np.asarray(reference_std_cm, dtype=np.float64) ** 2, reading.shape)
    some = expected[:: max(expected.size // 5_000, 1)]
    if reference_cm2.any() or np.unique(some).size > FEW_RANGES * some.size:
        return Likelihood(grid, reading, expected, np.ones(reading.size), reference_cm2)
    pairs, counts = np.unique(expected + 1j * reading, return_counts=True)
    return Likelihood(grid, pairs.imag, pairs.real, counts.astype(np.float64), np.zeros(pairs.size))


def _growth(rows: Likelihood, base: Optimum, moving: list[str]) -> list[str]:
    """Names of the dependences on range of which each by itself gains what BIC requires."""
    finite = rows.expected_cm[rows.expected_cm < NO_ECHO_CENTRE]
    if np.ptp(finite) < SHORTEST_SPAN * finite.max():
        return []
    kept = []
    for name in ("sigma_growth_2", *(["missed_growth"] if "log_odds_missed" in base.inside else [])):
        start = _growing(base.numbers, [name])
        _, value, _ = rows.maximum(start, bounds_of(start, [*moving, name]))
        if value - base.value > 0.5 * math.log(rows.readings):
            kept.append(name)
    return kept


def _growing(numbers: Numbers, names: Sequence[str]) -> Numbers:
    """Where a fit with these dependences on range starts."""
    return numbers._replace(sigma_growth_2=SMALL_GROWTH if "sigma_growth_2" in names else 0.0)


def _mean_length_m(rows: Likelihood) -> float:
    """Mean of the ranges beyond the minimum of readings with a range [m]."""
    is_range = ~np.isin(rows.reading_cm, rows.grid.codes_cm)
    length_cm = np.minimum(rows.expected_cm[is_range], rows.grid.maximum_cm) - rows.grid.minimum_cm
    mean_cm = np.average(np.maximum(length_cm, 0.0), weights=rows.count[is_range])
    return max(float(mean_cm), rows.grid.resolution_cm) / 100.0


def _start(few: Likelihood, moving: Sequence[str], mean_length_m: float) -> Numbers:
    """The best of a few fits to some of the rows, starting with small and large spread and lambda."""
    grid, share_of = few.grid, few.count / few.count.sum()
    no_echo = max(float(share_of @ (few.reading_cm == grid.maximum_cm)), MIN_WEIGHT)
    usable = (few.reading_cm < grid.maximum_cm) & (few.expected_cm < NO_ECHO_CENTRE)
    error, weight = (few.reading_cm - few.expected_cm)[usable], few.count[usable]
    order = np.argsort(np.abs(error))
    distance, below = np.abs(error)[order], np.cumsum(weight[order])
    found = []
    # A share p of all readings lies within so many sigmas of the centre if nearly all are hits, or if half are.
    # Readings that hardly differ do not determine a sigma below a step: start with a small one and with one step.
    for share, sigmas, least in ((0.5, 0.674, grid.resolution_cm), (0.2, 0.524, 0.3 * grid.resolution_cm)):
        sigma_cm = max(float(distance[np.searchsorted(below, share * below[-1])]) / sigmas, least)
        shorter, longer = (
            min(max(float(weight[far].sum() / weight.sum()), 0.005), 0.4)
            for far in (error < -4.0 * sigma_cm, error > 4.0 * sigma_cm)
        )
        # Where hits read 255 too, most missed echoes may be among them.
        for per_length, saturated in ((0.5, 0.2), (5.0, 0.9)):
            seen = 1.0 - saturated if "saturated" in moving else 1.0
            missed = min(no_echo / seen, 0.9)
            hit = (1.0 - missed) * (1.0 - min(shorter + 2.0 * longer, 0.8))
            log_odds = [math.log(share / hit) for share in (shorter, missed, 2.0 * longer)]
            rates = per_length / mean_length_m, 1.0 - seen, 0.0, 0.0
            start = Numbers(*(math.log(sigma_cm), *log_odds, *rates))
            found.append(few.maximum(start, bounds_of(start, moving), START_NATS))
    return Numbers(*max(found, key=lambda maximum: maximum[1])[0].tolist())
