"""Correlated noise: what the error of one hit says about the next hit of the same sensor in the same run.

The contexts show which reading came before which, and how long before. The errors of the hits, in standard deviations,
are an autoregressive process of first order in time (Ornstein-Uhlenbeck): over a time t the correlation is ``rho(t) =
correlation ** (t / spacing)``. The same object draws the errors and gives each reading's distribution after the last
hit before it, so that sampling and scoring are one model.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from msp_range.arrays import Array, Flags, Indices, numbered
from msp_sim.model.streams import RandomStreams

HISTORY_COLUMNS = ("run", "sensor", "time_s")
"""Columns from which the order of readings follows; any may be missing."""
MAX_CORRELATION = 0.98
"""The correlation of neighbouring hits is at most this, in files, fits and for readings at the same time. Beyond it the
noise is an offset, and what is left of the spread is smaller than the rounding. Lower values cut off slow noise."""
HIT_SIGMAS = 4.0
"""A reading this many standard deviations from its centre is no hit, so its error says nothing about the next one. With
3 the error of one hit in 370 is lost; with 6 more short and random readings pass for hits."""


@dataclass(frozen=True)
class History:
    """Readings in the order of their time, series by series; a series is one sensor in one run."""

    order: Indices
    """Places of the readings, series by series and in order of time, (n,)."""
    series: Indices
    """Number of the series of each reading in that order, (n,), from 0."""
    time_s: Array
    """Time of each reading in that order [s], (n,); its number within the series where no time is recorded."""
    names: tuple[str, ...]
    """Name of each series."""
    correlation: float
    """Correlation of two hits that are `spacing_s` apart."""
    spacing_s: float
    """The time to which `correlation` refers [s]."""

    @classmethod
    def of(cls, columns: Mapping[str, Any], size: int, correlation: float, spacing_s: float) -> "History":
        """The history of n readings from their columns ``run``, ``sensor`` and ``time_s``, as far as recorded."""
        words = [columns[name].astype(str) for name in ("run", "sensor") if name in columns]
        pair = np.zeros(size, dtype=np.intp)
        for word in words:
            pair = pair * (size + 1) + numbered(word)
        _, first, own = np.unique(pair, return_index=True, return_inverse=True)
        keys = ["/".join(word[i] for word in words) for i in first]
        names, place = np.unique(np.array(keys, dtype=str), return_inverse=True)
        series = place[own]
        time_s = columns.get("time_s", np.full(size, np.nan))
        known = bool(np.isfinite(time_s).all())
        order = np.lexsort((np.arange(size), time_s if known else np.zeros(size), series)).astype(np.intp)
        ordered = series[order].astype(np.intp)
        if known:
            time_s = time_s[order]
        else:
            starts = np.searchsorted(ordered, np.arange(names.size))
            time_s = (np.arange(size) - starts[ordered]) * spacing_s
        return cls(order, ordered, time_s, tuple(names.tolist()), correlation, spacing_s)

    def correlation_over(self, time_s: Array) -> Array:
        """Correlation of the errors of two hits that are so far apart in time [s], same shape."""
        if self.correlation <= 0.0:
            return np.zeros_like(time_s)
        powers: Array = self.correlation ** (np.maximum(time_s, 0.0) / self.spacing_s)
        return np.minimum(powers, MAX_CORRELATION)

    def slope_over(self, time_s: Array) -> Array:
        """Derivative of `correlation_over` by `correlation`."""
        number = max(self.correlation, 1e-3)
        power = np.maximum(time_s, 0.0) / self.spacing_s
        slope: Array = power * number ** (power - 1.0)
        return np.where(number**power < MAX_CORRELATION, slope, 0.0)

    def before(self, is_hit: Flags) -> tuple[Indices, Array]:
        """The last hit before each reading, and how long before.

        Parameters
        ----------
        is_hit
            (n,), by place.

        Returns
        -------
        before : ndarray, shape (n,)
            Place of the last hit of the same series; -1 where there is none.
        age_s : ndarray, shape (n,)
            Time since then [s]; infinite where there is none.
        """
        n = self.order.size
        before, age_s = np.full(n, -1, dtype=np.intp), np.full(n, np.inf)
        if n < 2:
            return before, age_s
        last = np.maximum.accumulate(np.where(is_hit[self.order], np.arange(n), -1))[:-1]
        has = (last >= 0) & (self.series[np.maximum(last, 0)] == self.series[1:])
        here, there = np.flatnonzero(has) + 1, last[has]
        before[self.order[here]] = self.order[there]
        age_s[self.order[here]] = self.time_s[here] - self.time_s[there]
        return before, age_s

    def correlated(self, normal: Array, streams: RandomStreams) -> Array:
        """Errors of the hits from independent standard normal numbers, (n,); a series goes on where it was left."""
        errors = np.empty(normal.size)
        number, time_s = -1, -np.inf
        error = 0.0
        step_s = np.diff(self.time_s, prepend=-np.inf)
        over = self.correlation_over(step_s)
        left = np.sqrt(1.0 - over**2)
        for i, (place, series) in enumerate(zip(self.order.tolist(), self.series.tolist(), strict=True)):
            keep, rest = float(over[i]), float(left[i])
            if series != number:
                if number >= 0:
                    streams.last_error[self.names[number]] = time_s, error
                number = series
                time_s, error = streams.last_error.get(self.names[series], (-np.inf, 0.0))
                keep = float(self.correlation_over(np.array(self.time_s[i] - time_s)))
                rest = float(np.sqrt(1.0 - keep**2))
            error = keep * error + rest * float(normal[place])
            errors[place] = error
            time_s = float(self.time_s[i])
        if number >= 0:
            streams.last_error[self.names[number]] = time_s, error
        return errors
