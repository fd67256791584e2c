"""By how much the clocks of two logs differ, from the same flight in both.

Readings of a range finder and a height on another clock enter; the difference of the clocks leaves, to half a second,
or why it cannot be known. All differences at which the two overlap are tried at once, by Fourier transforms. The finer
step, with its interval, is `msp_lab.logs.alignment`.
"""

import numpy as np

from msp_lab.logs.log import Series
from msp_range.arrays import Array
from msp_range.recording.error import RecordingError

STEP_S = 0.1
"""Both are compared on a grid of such steps [s], which is finer than what `align` searches through."""
LEAST_OVERLAP_S = 20.0
"""Both have to overlap by so long [s]: in less, any two climbs look alike."""
LEAST_CORRELATION = 0.8
"""Refuse a best difference with a smaller correlation: the two do not show the same flight. A sensor that misses half
of its echoes still has 0.9."""
APART_S = 3.0
"""A second difference counts as another one where it is farther from the best than this [s]: a climb is as long."""
CERTAIN_NATS = 10.0
"""The best difference has to be more likely than any other by this [nat], one to 20,000, for as many independent
samples as there are seconds. Lower: flights that repeat themselves are taken for each other."""
LONGEST_S = 86_400.0
"""Longer logs are refused [s]: a day takes 100 MB. Flights have an hour."""
SMOOTHED = 5
"""Readings are replaced by the median of so many, which takes single outliers away."""


def clock_difference_s(readings: Series, height: Series) -> float:
    """What is to be added to the times of the height, to have them on the clock of the readings [s].

    Parameters
    ----------
    readings
        Of a range finder, in any unit; no-echo readings are not a number.
    height
        Of the same flight, at least in part.

    Raises
    ------
    RecordingError
        They do not show the same flight, fit each other in several ways, or are longer than a day; the text follows a
        file's name.
    """
    known = readings.known()
    if len(known) < 2 * SMOOTHED or len(height.known()) < 2 * SMOOTHED:
        raise RecordingError("hardly any readings or heights to compare the clocks by")
    windows = np.lib.stride_tricks.sliding_window_view(known.values, SMOOTHED)
    middle = SMOOTHED // 2
    smooth = Series(known.source, known.time_s[middle : middle + len(windows)], np.median(windows, axis=1))
    (r, r_known), (h, h_known) = _grid(smooth), _grid(height)
    # At lag k, reading i + k meets height i.
    size = 1 << int(r.size + h.size).bit_length()

    def sums(first: Array, second: Array) -> Array:
        product = np.fft.rfft(first, size) * np.conj(np.fft.rfft(second, size))
        return np.asarray(np.fft.irfft(product, size))

    n = np.rint(sums(r_known, h_known))
    enough = n * STEP_S >= LEAST_OVERLAP_S
    if not enough.any():
        raise RecordingError(f"both overlap by less than {LEAST_OVERLAP_S:.0f} s at any difference of the clocks")
    n = np.where(enough, n, 1.0)
    mean_r, mean_h = sums(r, h_known) / n, sums(r_known, h) / n
    spread_r = sums(r * r, h_known) / n - mean_r**2
    spread_h = sums(r_known, h * h) / n - mean_h**2
    # Where one of them hardly moves, nothing can be seen.
    moves = enough & (spread_r > 1e-3 * spread_r[enough].max()) & (spread_h > 1e-3 * spread_h[enough].max())
    both = np.where(moves, spread_r * spread_h, 1.0)
    correlation = np.where(moves, (sums(r, h) / n - mean_r * mean_h) / np.sqrt(both), 0.0)
    correlation = np.clip(correlation, 0.0, 0.9999)
    nats = -0.5 * n * STEP_S * np.log1p(-(correlation**2))
    best = int(np.argmax(nats))
    if correlation[best] < LEAST_CORRELATION:
        raise RecordingError(
            f"the two do not show the same flight: at best their correlation is {correlation[best]:.2f}, expected "
            f"{LEAST_CORRELATION:g}"
        )
    lags = np.where(np.arange(size) > size // 2, np.arange(size) - size, np.arange(size))
    elsewhere = np.abs(lags - lags[best]) * STEP_S > APART_S
    other = int(np.argmax(np.where(elsewhere, nats, -np.inf)))
    if nats[best] - nats[other] < CERTAIN_NATS:
        away_s = abs(lags[best] - lags[other]) * STEP_S
        raise RecordingError(
            f"the two fit each other about as well {away_s:.0f} s away from the best fit: "
            "fly something that does not repeat itself, such as three quick climbs at the start"
        )
    return float(smooth.time_s[0] - height.known().time_s[0] + lags[best] * STEP_S)


def _grid(series: Series) -> tuple[Array, Array]:
    """Values on the grid about their mean, 0 where they are not known, and where they are."""
    known = series.known()
    length_s = float(known.time_s[-1] - known.time_s[0])
    if length_s > LONGEST_S:
        raise RecordingError(
            f"{known.source} spans {length_s / 3600.0:.0f} h, expected at most {LONGEST_S / 3600.0:.0f}"
        )
    time_s = np.arange(known.time_s[0], known.time_s[-1], STEP_S)
    values = known.at(time_s)
    good = np.isfinite(values)
    return np.where(good, values - np.nanmean(values), 0.0), good.astype(float)
