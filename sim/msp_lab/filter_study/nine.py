"""The report's nine filters (eq 13-19), for many runs at once.

Readings and estimates have the shape (runs, samples). A `Variant` has the differences that an implementation may have
from the report's text: `msp_lab.filter_study.explain` searches over them. Missing readings are NaN; the filters get the
others (`behind_the_gate`), as in the bridge, and hold their last estimate.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from msp_lab.filter_study.scenarios import NOISE_CM2
from msp_range.arrays import Array

Family = Literal["moving average", "median", "kalman"]
Boundary = Literal["grow", "raw", "zero", "first"]


@dataclass(frozen=True)
class Variant:
    """One filter with its parameters, and the differences of its implementation and of how it was studied."""

    family: Family
    parameter: float
    """The filter; its window M, or its process variance Q [cm^2]."""
    centred: bool = False
    """Moving average and median: the window reaches as far ahead as back; otherwise it ends at its reading."""
    boundary: Boundary = "grow"
    """Replacement of readings before the first (and after the last, if centred). grow: the window is shorter there.
    raw: the reading itself until the window is full, the report's 'not processing the boundary'. zero: zeros. first:
    the first (last) reading repeated."""
    delay: int = 0
    """Samples by which the estimate comes late, on top of the filter's own delay; negative: early. Before there is one,
    the output is the reading."""
    q_factor: float = 1.0
    """Kalman: factor of Q. P at the start is R."""
    start_cm: float | None = None
    """Kalman: estimate at the first sample [cm]; None: the first reading."""
    noise_factor: float = 1.0
    """Factor of the variance of the readings' noise."""
    reversed: bool = False
    """True if the error is truth less estimate; the estimates are the same."""

    @property
    def window(self) -> int:
        """M, the number of readings in the window."""
        return int(self.parameter)


PROCESS_CM2 = {1: 100.0, 2: 1.0, 3: 0.01}
"""Q of the report's Kalman 1, 2 and 3 (table 5.2) [cm^2]."""
CAUSAL: dict[str, Variant] = (
    {f"moving average {window}": Variant("moving average", window) for window in (5, 11, 15)}
    | {f"median {window}": Variant("median", window) for window in (3, 7, 11)}
    | {f"kalman {number}": Variant("kalman", process_cm2) for number, process_cm2 in PROCESS_CM2.items()}
)
"""The nine in causal form, as a vehicle can run them; windows grow until they are full."""
CENTRED = {
    name: replace(variant, centred=True, boundary="raw")
    for name, variant in CAUSAL.items()
    if variant.family != "kalman"
}
"""The two windowed families as eq 14 has it: half of the window is ahead, and the boundary is not processed."""
AS_REPORTED = CAUSAL | {name: variant for name, variant in CENTRED.items() if variant.family == "median"}
"""The filters as the report states them: a median that looks ahead (eq 14), the others causal."""


def apply(variant: Variant, reading_cm: Array) -> Array:
    """Return the estimates of one filter [cm]; no reading may be missing.

    Examples
    --------
    >>> readings = np.array([[300.0, 300.0, 306.0, 300.0]])
    >>> print(apply(Variant("moving average", 3), readings))
    [[300. 300. 302. 302.]]
    >>> print(apply(Variant("median", 3, centred=True, boundary="raw"), readings))
    [[300. 300. 300. 300.]]
    """
    filtered = _kalman if variant.family == "kalman" else _windowed
    return _delayed(filtered(variant, reading_cm), reading_cm, variant.delay)


def behind_the_gate(filter_: Callable[[Array], Array], reading_cm: Array) -> Array:
    """Apply a filter to the readings that are not missing; it holds at missing ones, and is NaN before the first."""
    there = ~np.isnan(reading_cm)
    order = np.argsort(~there, axis=1, kind="stable")
    packed = np.take_along_axis(reading_cm, order, axis=1)
    newest = np.cumsum(there, axis=1) - 1
    # Values after the last reading have no influence, since these filters are causal.
    packed = np.where(np.isnan(packed), 0.0, packed)
    estimate_cm: Array = np.take_along_axis(filter_(packed), np.maximum(newest, 0), axis=1)
    return np.where(newest >= 0, estimate_cm, np.nan)


def over_samples(variant: Variant, reading_cm: Array) -> Array:
    """A causal window over the last M samples, of which some are missing, instead of the last M readings.

    Where a reading is missing the estimate holds.
    """
    padded = np.pad(reading_cm, ((0, 0), (variant.window - 1, 0)), constant_values=np.nan)
    windows = sliding_window_view(padded, variant.window, axis=1)
    there = ~np.isnan(reading_cm)
    estimate_cm = np.full_like(reading_cm, np.nan)
    # A window that ends at a reading is never empty.
    estimate_cm[there] = (np.nanmean if variant.family == "moving average" else np.nanmedian)(windows[there], axis=1)
    newest = np.maximum.accumulate(np.where(there, np.arange(reading_cm.shape[1]), -1), axis=1)
    return np.take_along_axis(estimate_cm, np.maximum(newest, 0), axis=1)


def _windowed(variant: Variant, reading_cm: Array) -> Array:
    window, samples = variant.window, reading_cm.shape[1]
    ahead = (window - 1) // 2 if variant.centred else 0
    back = window - 1 - ahead
    if variant.boundary == "first":
        padded = np.pad(reading_cm, ((0, 0), (back, ahead)), mode="edge")
    else:
        fill = 0.0 if variant.boundary == "zero" else np.nan
        padded = np.pad(reading_cm, ((0, 0), (back, ahead)), constant_values=fill)
    windows = sliding_window_view(padded, window, axis=1)
    average = np.mean if variant.family == "moving average" else np.median
    estimate_cm: Array = average(windows, axis=2)
    for sample in (*range(min(back, samples)), *range(max(samples - ahead, 0), samples)):
        if variant.boundary == "raw":
            estimate_cm[:, sample] = reading_cm[:, sample]
        elif variant.boundary == "grow":
            estimate_cm[:, sample] = average(reading_cm[:, max(sample - back, 0) : sample + ahead + 1], axis=1)
    return estimate_cm


def _kalman(variant: Variant, reading_cm: Array) -> Array:
    """Eq 15-19 with F = H = 1; the gain does not depend on the readings."""
    q_cm2, r_cm2 = variant.parameter * variant.q_factor, NOISE_CM2
    estimate_cm = np.empty_like(reading_cm)
    p_cm2 = r_cm2
    start_cm = variant.start_cm
    latest_cm = reading_cm[:, 0] if start_cm is None else np.full(reading_cm.shape[0], start_cm)
    for sample in range(reading_cm.shape[1]):
        if sample or start_cm is not None:
            p_cm2 += q_cm2
            gain = p_cm2 / (p_cm2 + r_cm2)
            latest_cm = latest_cm + gain * (reading_cm[:, sample] - latest_cm)
            p_cm2 *= 1.0 - gain
        estimate_cm[:, sample] = latest_cm
    return estimate_cm


def _delayed(estimate_cm: Array, reading_cm: Array, delay: int) -> Array:
    if delay == 0:
        return estimate_cm
    delayed_cm = reading_cm.copy()
    if delay > 0:
        delayed_cm[:, delay:] = estimate_cm[:, :-delay]
    else:
        delayed_cm[:, :delay] = estimate_cm[:, -delay:]
    return delayed_cm
