"""The report's five statistics of a filter's error, and its delay, which the report leaves out.

Estimates and true ranges of shape (runs, samples) give one number per run. The error is estimate less truth, in
centimetres; samples without an estimate (NaN) do not count.
"""

import numpy as np

from msp_range.arrays import Array

STATISTICS = ("rms", "p90", "median", "mean", "variance")
"""RMS, 90th percentile of the signed error, median, mean [cm] and variance with N - 1 [cm^2], as in tables 5.4-5.6."""
LONGEST_DELAY = 20
"""Largest delay that is looked for [samples]: more than the window of any of the filters."""


def error_statistics(error_cm: Array) -> Array:
    """Return the five statistics of each run, shape (5, runs).

    Examples
    --------
    >>> print(error_statistics(np.array([[-1.0, 0.0, 1.0, 4.0]])).round(3)[:, 0])
    [2.121 3.1   0.5   1.    4.667]
    """
    # Functions that leave NaN out take much longer.
    percentile, mean, var = np.percentile, np.mean, np.var
    if np.isnan(error_cm).any():
        percentile, mean, var = np.nanpercentile, np.nanmean, np.nanvar
    p90, median = percentile(error_cm, (90, 50), axis=1)
    rms = np.sqrt(mean(error_cm**2, axis=1))
    return np.stack([rms, p90, median, mean(error_cm, axis=1), var(error_cm, axis=1, ddof=1)])


def delay_samples(estimate_cm: Array, true_cm: Array) -> Array:
    """Return the delay of each run's estimates [samples]: the shift of the truth that fits them best.

    Least squares over whole shifts from 0 to `LONGEST_DELAY`, then the vertex of the parabola through the best one and
    its neighbours; NaN where the truth does not change.
    """
    samples = true_cm.shape[1]
    cost = np.stack(
        [
            np.nanmean(
                (estimate_cm[:, LONGEST_DELAY:] - true_cm[:, LONGEST_DELAY - shift : samples - shift]) ** 2, axis=1
            )
            for shift in range(LONGEST_DELAY + 1)
        ]
    )
    best = cost.argmin(axis=0)
    inner = np.clip(best, 1, LONGEST_DELAY - 1)
    runs = np.arange(cost.shape[1])
    before, here, after = cost[inner - 1, runs], cost[inner, runs], cost[inner + 1, runs]
    bend = before - 2 * here + after
    vertex = inner + 0.5 * (before - after) / np.where(bend > 0, bend, 1.0)
    delay = np.where(best == inner, np.clip(vertex, inner - 0.5, inner + 0.5), best)
    return np.where(np.ptp(true_cm, axis=1) > 0, delay, np.nan)
