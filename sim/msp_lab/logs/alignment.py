"""How much later a range finder is than its reference, how far they are apart, and how well the reference is known.

Both are compared while the range changes: the lag is the one at which a straight line from the reference to the
readings leaves the least squares (which is the largest correlation), with outliers left out. Its interval is from a
bootstrap over blocks of time, in which errors may depend on each other as they like.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.stats import median_abs_deviation

from msp_range.arrays import Array

LARGEST_LAG_S = 1.5
"""Lags up to this are tried, both ways [s]: filters and autopilots delay by 0.02 to 0.5 s. A larger one costs time."""
LAG_STEP_S = 0.01
"""Steps in which they are tried [s]; between them a parabola through the least squares is used."""
MOST_READINGS = 10_000
"""Of a longer log this many readings are drawn: with them 300 lags take 100 MB and half a second. More: narrower
intervals than anybody needs."""
BLOCKS = 30
"""The log is cut into this many blocks for the bootstrap. Fewer: their number limits what the interval can know; more:
blocks become shorter than manoeuvres, whose errors then count twice."""
RESAMPLES = 500
"""Replicates of the bootstrap: their 2.5 and 97.5 % points have a standard error of 3 % of the interval's width."""
GATE = 4.5
"""Readings whose difference from the reference is more than this many standard deviations from the median difference
are outliers; one normal reading in 150,000 is lost."""
LEAST_STD_CM = 0.5
"""Differences scatter at least by this [cm] where a gate is set: the rounding of readings and logs."""
WIDEST_SHARE = 0.25
"""A lag whose interval is a larger share of all lags that were tried is not known: the range hardly changes, or the
reference is noisy or has holes. Larger: lags are reported that say nothing; smaller: slow flights have none."""
LEAST_READINGS = 50
"""Fewer readings with a reference are not aligned: a lag of them would have an interval as wide as what is tried."""


class Interval(NamedTuple):
    """An estimate and its 95 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, drawn: Sequence[float]) -> "Interval":
        """A value with the interval that values drawn by a bootstrap have."""
        low, high = np.quantile(drawn, (0.025, 0.975)).tolist()
        return cls(value, low, high)

    @property
    def std(self) -> float:
        """Standard deviation of the estimate, a quarter of its interval."""
        return (self.high - self.low) / 4.0


@dataclass(frozen=True)
class Alignment:
    """What the comparison of readings with a reference shows."""

    lag_s: Interval | None
    """How much later than the reference the readings are; None: cannot be seen."""
    offset_cm: float
    """Median of readings minus reference at that lag."""
    scatter_cm: float
    """Standard deviation of the differences, outliers left out."""
    no_lag: str = ""
    """Why the lag cannot be seen, in a few words; empty: it can."""

    @classmethod
    def by(cls, off_cm: Array, lag_s: Interval | None, no_lag: str = "") -> "Alignment":
        """By readings minus reference at the lag, or without one where it cannot be seen [cm]."""
        return cls(lag_s, float(np.nanmedian(off_cm)), _spread(off_cm), no_lag)


def align(
    time_s: Array, reading_cm: Array, expected_cm: Callable[[Array], Array], rng: np.random.Generator
) -> Alignment | None:
    """Compare readings with a reference; None where they hardly overlap.

    Parameters
    ----------
    time_s, reading_cm
        Readings in the order of time; NaN: no answer.
    expected_cm
        The reference at any times [s -> cm], NaN where it is not known.
    rng
        Draws the readings if there are many, and the blocks of the bootstrap.
    """
    rows = np.flatnonzero(np.isfinite(reading_cm) & np.isfinite(expected_cm(time_s)))
    rows = _sample(rows, rng)
    if rows.size < LEAST_READINGS:
        return None
    time_s, reading_cm = time_s[rows], reading_cm[rows]
    lags_s = np.arange(-LARGEST_LAG_S, LARGEST_LAG_S + LAG_STEP_S / 2, LAG_STEP_S)
    expected = np.stack([expected_cm(time_s - lag_s) for lag_s in lags_s])
    whole = np.isfinite(expected).all(axis=0)
    if whole.sum() < LEAST_READINGS:
        around = f"{LARGEST_LAG_S:g} s before to {LARGEST_LAG_S:g} s after them"
        why = f"only {whole.sum()} readings have the reference throughout from {around}"
        return Alignment.by(reading_cm - expected_cm(time_s), None, why)
    time_s, reading_cm, expected = time_s[whole], reading_cm[whole], expected[:, whole]
    off_cm = reading_cm - expected
    off_cm -= np.median(off_cm, axis=1, keepdims=True)
    best = int(np.argmin(np.median(np.abs(off_cm), axis=1)))
    for _ in range(2):
        good = np.abs(off_cm[best]) < GATE * max(LEAST_STD_CM, _spread(off_cm[best]))
        sums = _sums(reading_cm[good], expected[:, good], _blocks(time_s[good]))
        best = int(np.argmin(_squares(sums.sum(axis=2))))
    weights = rng.multinomial(sums.shape[2], np.full(sums.shape[2], 1.0 / sums.shape[2]), size=RESAMPLES)
    lag_s = Interval.of(
        _lowest(lags_s, _squares(sums.sum(axis=2))), [_lowest(lags_s, _squares(sums @ weight)) for weight in weights]
    )
    why = ""
    if np.ptp(expected) < LEAST_STD_CM:
        why = "the reference does not change"
    elif lag_s.high - lag_s.low > WIDEST_SHARE * 2.0 * LARGEST_LAG_S:
        why = f"its 95 % interval is {lag_s.low:.2f} to {lag_s.high:.2f} s"
    elif abs(lag_s.value) > LARGEST_LAG_S - LAG_STEP_S:
        why = f"the best one is {lag_s.value:.2f} s, the last that is tried"
    if why:
        return Alignment.by(reading_cm - expected_cm(time_s), None, why)
    return Alignment.by(reading_cm - expected_cm(time_s - lag_s.value), lag_s)


def reference_std_cm(
    reading_cm: Array, reference_cm: Array, other_cm: Array, rng: np.random.Generator
) -> Interval | None:
    """Standard deviation of a reference's error, from three instruments whose errors are independent, with an interval.

    Of three instruments the variance of each follows from the three differences: var(a) = (var(a - b) + var(a - c) -
    var(b - c)) / 2 (Grubbs 1948, the three-cornered hat of clocks). Medians take the place of variances, so that
    outliers of the readings do not count.

    Parameters
    ----------
    reading_cm, reference_cm, other_cm
        At the same times; NaN where one is not known.
    rng
        Draws the readings if there are many, and the blocks of the bootstrap.

    Returns
    -------
    Interval or None
        In centimetres; zero where it is too small to be seen; None: too few times with all three.
    """
    rows = np.flatnonzero(np.isfinite(reading_cm) & np.isfinite(reference_cm) & np.isfinite(other_cm))
    rows = _sample(rows, rng)
    if rows.size < LEAST_READINGS:
        return None
    reading, reference, other = reading_cm[rows], reference_cm[rows], other_cm[rows]
    blocks = np.array_split(np.arange(rows.size), BLOCKS)

    def estimate(at: np.ndarray) -> float:
        pairs = ((reference, other), (reference, reading), (other, reading))
        with_other, with_reading, rest = (_spread(a[at] - b[at]) ** 2 for a, b in pairs)
        return float(np.sqrt(max(0.0, (with_other + with_reading - rest) / 2.0)))

    drawn = [estimate(np.concatenate([blocks[b] for b in rng.integers(0, BLOCKS, BLOCKS)])) for _ in range(200)]
    return Interval.of(estimate(np.arange(rows.size)), drawn)


def _sample(rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Some of many rows, in their order. Every k-th one could be always of the same state of a vehicle."""
    return rows if rows.size <= MOST_READINGS else np.sort(rng.choice(rows, MOST_READINGS, replace=False))


def _spread(values: Array) -> float:
    """Standard deviation, by the median of the distances from the median."""
    # Without an axis scipy takes two thirds of the time, and an import with many runs computes thousands of these.
    return float(median_abs_deviation(values[np.isfinite(values)], axis=None, scale="normal"))


def _blocks(time_s: Array) -> np.ndarray:
    """Block of each reading."""
    share = (time_s - time_s[0]) / max(float(np.ptp(time_s)), 1e-9)
    return np.asarray(np.minimum((share * BLOCKS).astype(int), BLOCKS - 1))


def _sums(reading: Array, expected: Array, block: np.ndarray) -> Array:
    """Sums of 1, r, h, rr, rh, hh for each lag and block, (6, lags, blocks), about a common level."""
    r, h = reading - reading.mean() + np.zeros_like(expected), expected - expected.mean()
    starts = np.searchsorted(block, np.unique(block))
    return np.stack([np.add.reduceat(each, starts, axis=1) for each in (np.ones_like(h), r, h, r * r, r * h, h * h)])


def _squares(sums: Array) -> Array:
    """Least squares of a straight line from reference to readings for each lag."""
    n, r, h, rr, rh, hh = sums
    spread_h = np.maximum(hh - h * h / n, 1e-9)
    return np.asarray(rr - r * r / n - (rh - r * h / n) ** 2 / spread_h)


def _lowest(lags_s: Array, squares: Array) -> float:
    """Lag of the least squares, by a parabola through the lowest three."""
    at = int(np.argmin(squares))
    if at in (0, squares.size - 1):
        return float(lags_s[at])
    before, least, after = squares[at - 1 : at + 2]
    curvature = before - 2.0 * least + after
    step = 0.5 * (before - after) / curvature if curvature > 0.0 else 0.0
    return float(lags_s[at] + step * LAG_STEP_S)
