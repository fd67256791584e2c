"""The reference's path: how far the true range was from that at a reading's stamp, so long before it.

From times and true ranges of one sensor in one run after another follow changes of the range at any time and for any of
the rows. Between two rows a path is a cubic. There is none across jumps, pauses and stamps that repeat: there it goes
on at its own rate from the nearer side.

A reference with noise from row to row is smoothed first. Through its rows, a delay of half an interval would explain
the readings better than the true one: what is between two rows has less noise than a row has. It is noise if a table
states an error as large, or if readings do not follow it: those of rough ground do.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from msp_range.arrays import Array, Column, Flags, Indices, numbered
from msp_sim.effects.base import PATH, REFERENCE_STD, TRUE_RANGE

CLOSEST_S = 1e-6
"""Rows of a sensor that are closer in time than this have the same stamp [s]: one of them is wrong, and nobody knows
which one. Above the rounding of times since 1970, below any interval of readings."""
FARTHEST_S = 1.0
"""Between rows that are farther apart in time there is no path [s]: a vehicle turns round meanwhile, and in a campaign
at a bench the next place begins."""
SLOPE_S = 0.1
"""Rows up to this long before and after one give the rate of the true range there [s]. Shorter, and the noise of the
truth is taken for motion: of 2 cm, 50 times a second, +-70 cm/s from neighbouring rows and +-14 from these. Longer
flattens how a vehicle moves up and down: sin(x)/x with x = 2 pi f 0.1 s, which is 2 % less at 0.5 Hz and 6 % at 1
Hz."""
LONGEST_SLOPE_S = 0.4
"""Where the nearest rows on both sides are farther apart than this, a recorded rate is taken [s]: a vehicle turns in
between, and the ranges alone do not say how it moves at a row. Shorter: where the ground is no plane, a vertical speed
is taken for the rate of the range; longer: of readings twice a second delays stay unseen."""
LARGEST_CM_S2 = 500.0
"""A range whose rate changes by more than this next to how it changed before and after has jumped, at an edge of the
ground or to the next place of a campaign; of 10 rows a second that is an edge of 5 cm. A turn that is taken for one
costs little, as either side goes on at its rate. Higher: between the rows at an edge the range is half-way; lower: of
quick turns the cubic is lost."""
JUMP_TIMES = 10.0
"""A jump also exceeds the usual change, which noise of the reference makes, by this many times its median. Lower: noise
cuts paths; higher: edges in noise are motion."""
NOISIEST_CM = 5.0
"""If half of the ranges differ by more than this from what their neighbours give, the rows are in no order of time, and
no path is made of them [cm]. Any value from 4 to 20 decides alike: references have 2 cm of noise, and ranges in random
order are 50 cm off."""
SMOOTHED_ROWS = 3, 10
"""Fewest and most rows to either side over which a reference with noise is smoothed, among those within twice
`SLOPE_S`. With two, 5 % of the noise's variance counts for half intervals; more than ten take time."""
NOISE_CM = 0.05
"""A reference is smoothed if half of its rows are off such a parabola by more than this [cm], and by no more than its
noise, as fourth differences show it: of quick motion the parabola would be off by more. Higher: noise of a tenth of the
sensor's moves delays towards half intervals; lower: sharp turns of an exact reference are rounded."""
SEEN_SHARE = 0.3
"""What differs from row to row in a reference is ground, and not noise, if by any delay readings follow it by this
share or more. They follow noise by 0.17 at most in ten tables, ground by 0.44 and more in forty. Lower: noise counts as
ground where readings are few; higher: ground under a wide beam is smoothed."""
MEDIAN_SIGMAS = 0.6745
"""Median of a normal error's size, in standard deviations."""


@dataclass(frozen=True)
class Knots:
    """The paths of a table."""

    time_s: Array
    """Time of each row of the table [s], the series one after another on one axis, (n,)."""
    at_s: Array
    """Times of the rows that paths go through, in order, (m,)."""
    range_cm: Array
    slope: Array
    """The path there [cm], and its slope [cm/s]."""
    rate: Array
    """Rate over `SLOPE_S` before and after [cm/s]; NaN for a row that is alone."""
    goes_on: Flags
    """Whether there is a path from each to the next one, (m - 1,)."""
    rows: Indices
    """Their places in the table, (m,)."""
    smoothed_cm2: float
    """Variance of the noise that smoothing has taken off the reference; 0: none was taken off."""

    def at(self, time_s: Array) -> tuple[Array, Array]:
        """Range [cm] at some times, and the rate at the nearest row [cm/s]."""
        left = np.clip(np.searchsorted(self.at_s, time_s, "right") - 1, 0, self.at_s.size - 2)
        length_s = self.at_s[left + 1] - self.at_s[left]
        part = (time_s - self.at_s[left]) / length_s
        near = left + (part >= 0.5)
        beyond_cm = self.range_cm[near] + self.rate[near] * (time_s - self.at_s[near])
        rise_cm = self.range_cm[left + 1] - self.range_cm[left]
        first_cm, last_cm = self.slope[left] * length_s - rise_cm, self.slope[left + 1] * length_s - rise_cm
        bent_cm = part * (1.0 - part) * (first_cm * (1.0 - part) - last_cm * part)
        inside = self.goes_on[left] & (part >= 0.0) & (part <= 1.0)
        return np.where(inside, self.range_cm[left] + part * rise_cm + bent_cm, beyond_cm), self.rate[near]


class ReferencePath(np.ndarray[Any, np.dtype[np.int64]]):
    """A column of the places of readings on the paths of their table, which any part of the column keeps."""

    knots: Knots | None
    _stamped: tuple[Array, Array, Array] | None

    def __array_finalize__(self, whole: Any) -> None:
        self.knots, self._stamped = getattr(whole, "knots", None), None

    @classmethod
    def of(cls, columns: Mapping[str, Any]) -> "ReferencePath | None":
        """The paths of a table, from ``time_s`` and the true range, and ``run`` and ``sensor`` where they are known;
        None where no row goes on to the next one, as in a single ping or a random order."""
        path = np.arange(np.size(columns[TRUE_RANGE])).view(cls)
        path.knots = _knots(columns)
        return None if path.knots is None else path

    def moved_cm(self, ago_s: Any) -> Array:
        """How far the range was from that at each stamp, so long before it [cm]."""
        assert self.knots is not None
        time_s, range_cm, _ = self._at_stamps
        return self.knots.at(time_s - ago_s)[0] - range_cm

    @property
    def rate(self) -> Array:
        """Rate at each stamp [cm/s]."""
        return self._at_stamps[2]

    @property
    def _at_stamps(self) -> tuple[Array, Array, Array]:
        """Time, range and rate at each stamp, worked out once: a fit asks for many other times."""
        if self._stamped is None:
            assert self.knots is not None
            time_s = self.knots.time_s[np.asarray(self)]
            self._stamped = time_s, *self.knots.at(time_s)
        return self._stamped


def with_path(columns: Mapping[str, Any]) -> Mapping[str, Any]:
    """Columns with the paths that they have, where they come without, and then with true ranges on these paths."""
    path = None if PATH in columns else ReferencePath.of(columns)
    if path is None or path.knots is None:
        return columns
    knots, found = path.knots, {**columns, PATH: path}
    if knots.smoothed_cm2 > 0.0:
        found[TRUE_RANGE] = np.array(columns[TRUE_RANGE], dtype=np.float64)
        found[TRUE_RANGE][knots.rows] = knots.range_cm
        if REFERENCE_STD in columns:
            left_cm2 = np.square(columns[REFERENCE_STD]) - knots.smoothed_cm2
            found[REFERENCE_STD] = np.sqrt(np.maximum(left_cm2, 0.0))
    return found


def _knots(columns: Mapping[str, Any]) -> Knots | None:
    if "time_s" not in columns:
        return None
    range_cm = columns[TRUE_RANGE]
    time_s = _one_after_another(columns["time_s"], [columns[name] for name in ("run", "sensor") if name in columns])
    order = np.argsort(time_s, kind="stable")
    order = order[np.isfinite(range_cm[order]) & np.isfinite(time_s[order])]
    apart = np.diff(time_s[order]) > CLOSEST_S
    order = order[np.append(True, apart) & np.append(apart, True)] if apart.size else order[:0]
    if order.size < 2:
        return None
    at_s, at_cm = time_s[order], range_cm[order]
    goes_on = _goes_on(at_s, at_cm)
    if not goes_on.any():
        return None
    unknown = np.full(range_cm.size, math.nan)
    stated_cm, reading_cm, recorded = (
        columns.get(name, unknown)[order] for name in (REFERENCE_STD, "reading_cm", "range_rate_cm_s")
    )
    path_cm = _smoothed_cm(at_s, at_cm, goes_on, float(np.median(np.nan_to_num(stated_cm))), reading_cm)
    slope, rate = (_rate(at_s, path_cm, goes_on, within_s, recorded) for within_s in (0.0, SLOPE_S))
    smoothed_cm2 = (float(np.median(np.abs(path_cm - at_cm))) / MEDIAN_SIGMAS) ** 2
    return Knots(time_s, at_s, path_cm, slope, rate, goes_on, order, smoothed_cm2)


def _one_after_another(time_s: Array, words: list[Column]) -> Array:
    """Times with the series in a row, so far apart that no path goes from one to the next."""
    series = np.zeros(time_s.size, dtype=np.intp)
    for word in words:
        series = numbered(series * (time_s.size + 1) + numbered(word))
    first_s, last_s = (np.full(int(series.max(initial=0)) + 1, end) for end in (math.inf, -math.inf))
    np.minimum.at(first_s, series, time_s)
    np.maximum.at(last_s, series, time_s)
    lasts_s = last_s - first_s + 100.0 * FARTHEST_S
    return np.asarray(time_s + (np.cumsum(lasts_s) - lasts_s - first_s)[series])


def _goes_on(time_s: Array, range_cm: Array) -> Flags:
    """From which rows the range moves on to the next row, at a rate that follows from that before or after."""
    step_s, step_cm = np.diff(time_s), np.diff(range_cm)
    rate = np.where(step_s <= FARTHEST_S, step_cm / step_s, math.nan)
    around = np.pad(rate, 2, constant_values=math.nan)
    before, after = around[1:-3], around[3:-1]
    # As steady as the rate next to it, or as the change of that rate.
    expected = (before, 2.0 * before - around[:-4], after, 2.0 * after - around[4:])
    off_cm = np.fmin.reduce([np.abs(rate - each) for each in expected]) * step_s
    usual_cm = float(np.median(off_cm[np.isfinite(off_cm)])) if np.isfinite(off_cm).any() else 0.0
    found: Flags = off_cm <= LARGEST_CM_S2 * step_s * np.maximum(step_s, SLOPE_S) + JUMP_TIMES * usual_cm
    return found & (usual_cm < NOISIEST_CM)


def _smoothed_cm(time_s: Array, range_cm: Array, goes_on: Flags, stated_cm: float, reading_cm: Array) -> Array:
    """The parabola through the rows around each one on its path, or the ranges as they are if they have no noise."""
    # Fourth differences are noise alone, and the sum of the squares of their weights is 70.
    noise_cm = float(np.median(np.abs(np.diff(range_cm, 4)))) / math.sqrt(70.0) if range_cm.size > 4 else 0.0
    is_stated = noise_cm < stated_cm
    if noise_cm < NOISE_CM or not (is_stated or np.isfinite(reading_cm).any()):
        return range_cm
    rows = int(np.clip(np.ceil(2.0 * SLOPE_S / np.median(np.diff(time_s))), *SMOOTHED_ROWS))
    stretch = np.pad(np.cumsum(~goes_on), (1 + rows, rows), constant_values=(0, -1))
    stretch[:rows] = -1
    stretch[rows] = 0
    times, ranges = (np.pad(each, rows) for each in (time_s, range_cm))
    powers, sums = np.zeros((5, time_s.size)), np.zeros((3, time_s.size))
    for k in range(2 * rows + 1):
        there = slice(k, k + time_s.size)
        # Weights that end in nothing: what enters the parabola at a row must not show there.
        own = (stretch[there] == stretch[rows : rows + time_s.size]) * (1.0 - ((k - rows) / (rows + 1)) ** 2) ** 2
        weights = own * np.vander(np.where(own, (times[there] - time_s) / SLOPE_S, 0.0), 5, increasing=True).T
        powers += weights
        sums += weights[:3] * (ranges[there] - range_cm)
    normal = powers[np.add.outer(np.arange(3), np.arange(3))].transpose(2, 0, 1)
    # The weights of two rows are less than two.
    enough = powers[0] > 2.0
    normal[~enough] = np.eye(3)
    off_cm = np.where(enough, np.linalg.solve(normal, sums.T[:, :, None])[:, 0, 0], 0.0)
    is_noise = NOISE_CM < np.median(np.abs(off_cm)) < noise_cm
    if not is_noise or not (
        is_stated or _seen_share(time_s, -off_cm, reading_cm - range_cm - off_cm, goes_on) < SEEN_SHARE
    ):
        return range_cm
    return range_cm + off_cm


def _seen_share(time_s: Array, detail_cm: Array, error_cm: Array, goes_on: Flags) -> float:
    """By how much readings follow a detail of the reference at most, of all delays and leads up to a second."""
    moves = np.diff(error_cm)
    known = goes_on & np.isfinite(moves)
    if not known.any():
        return 0.0
    middle = float(np.median(moves[known]))
    most_cm = 3.0 * float(np.median(np.abs(moves[known] - middle))) / MEDIAN_SIGMAS
    moves = np.where(known, np.clip(moves - middle, -most_cm, most_cm), 0.0)
    detail = np.where(goes_on, np.diff(detail_cm), 0.0)
    rows = min(round(FARTHEST_S / float(np.median(np.diff(time_s)))), moves.size - 1)
    follows = [float(moves[k:] @ detail[: moves.size - k]) for k in range(rows + 1)]
    leads = [float(moves[: moves.size - k] @ detail[k:]) for k in range(1, rows + 1)]
    return max(follows + leads) / max(float(detail @ detail), 1e-300)


def _rate(time_s: Array, range_cm: Array, goes_on: Flags, within_s: float, recorded: Array) -> Array:
    """Rate at each row over so long to either side, of a row at least, on its own path; where it is alone or others are
    far the recorded one, NaN if there is none."""
    place = np.arange(time_s.size)
    stretch = np.concatenate([[0], np.cumsum(~goes_on)])
    first, after = (np.searchsorted(stretch, stretch, side) for side in ("left", "right"))
    before = np.minimum(np.searchsorted(time_s, time_s - within_s - CLOSEST_S), place - 1)
    beyond = np.maximum(np.searchsorted(time_s, time_s + within_s + CLOSEST_S), place + 2)
    one, other = np.maximum(before, first), np.minimum(beyond, after) - 1
    lasts_s = time_s[other] - time_s[one]
    rate = np.where(other > one, range_cm[other] - range_cm[one], math.nan) / np.maximum(lasts_s, CLOSEST_S)
    is_near = (lasts_s > 0.0) & (lasts_s <= LONGEST_SLOPE_S)
    return np.where(is_near | ~np.isfinite(recorded), rate, recorded)
