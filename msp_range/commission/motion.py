"""Positions of the sensors, measured while somebody lifts and tilts the vehicle over a flat floor.

With d the direction of straight down in the body's axes (from the attitude), h the unknown height of the reference
point over the floor at that time and q a sensor's place, a sensor that looks at the floor reads

    r = h - q . d

since the nearest point of the floor is straight below it. h is free at every time (a straight line between knots), so
only differences between sensors are measured. A common shift of all of them is not seen; that one is chosen with which
most sensors agree with the airframe file. How much later the attitudes are than the readings is measured too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from msp_range.acoustics.air import TWO_SIDED_95_PERCENT
from msp_range.arrays import Array, Indices
from msp_range.commission.samples import Samples

KNOT_S = 0.4
"""Time between two heights of the reference point [s]. A hand that swings by 5 cm in 3 s is followed to 4 mm. With less
the heights take over what a tilt does, with more a quick lift becomes noise."""
BEND_M = 0.05
"""Standard deviation of the second difference of the height at three knots [m]: an acceleration of 0.3 m/s^2, a calm
hand. It carries the height over gaps in the readings."""
NOISE_M = 0.006
"""Least standard deviation of a reading [m]: they are rounded to 1 cm, and a floor is not flatter."""
OTHER_M = 0.10
"""A sensor whose readings are typically this far from the floor [m] looks at something else. A wrong place does not
count, since places are fitted."""
FARTHEST_M = 1.5
"""A sensor that was found this far from its place in the file [m] looks at something else: no mistake in a file of a
vehicle that two hands lift is larger."""
OUTLIER = 4.7
"""Readings this many standard deviations away have no weight (Tukey's biweight, 95 % efficient)."""
OF_MANY = 3.0
"""A delay that fits worse than the best one by fewer standard deviations than this counts as fitting equally well: the
best of some twenty is often two away from the true one by chance. Less takes the motion of a hover for a delay, more
leaves delays unmeasured."""
MARGIN = 1.5
"""Intervals are this much wider than the fit's: neighbouring errors go together, a floor has joints, and a tilted beam
reads a little differently. In 37 simulated lifts 95 % intervals with 1.0 contained the truth of 86 % of the numbers,
with 1.5 of 96 %."""
LAG_STEP_S = 0.02
LAGS_S = np.arange(-0.30, 0.301, LAG_STEP_S)
"""Delays of the attitude that are tried first [s]. While the longest one fits best, the next longer one is tried."""
LONGEST_LAG_S = 2.0
"""The longest delay that is tried [s]: a vehicle that is rocked in 4 s leans the other way 2 s later. An attitude that
is later than the longest one counts as in time, and gives false places."""


@dataclass(frozen=True)
class Measured:
    """A measured number with its 95 % interval."""

    value: float
    half_width: float

    def contains(self, value: float) -> bool:
        """Whether the interval contains a value."""
        return abs(value - self.value) <= self.half_width

    def differs_from(self, value: float, least: float) -> bool:
        """Whether a value is wrong by more than ``least``, and by more than three standard deviations."""
        return abs(value - self.value) > max(1.5 * self.half_width, least)


@dataclass(frozen=True)
class Places:
    """Positions of the sensors, with their intervals."""

    position_m: Mapping[str, tuple[Measured, ...]]
    """Measured place of each sensor that sees the floor, forward, right and down [m], by name."""
    elsewhere: tuple[str, ...]
    """Sensors whose readings are not of the floor."""
    lag: Measured
    """How much later than the readings the attitudes are [s]."""
    std_m: Mapping[str, Measured]
    """Standard deviation of a single reading about the fit, by name [m]."""
    height: Array
    """Height of the reference point over the floor at some times: rows of (time [s], height [m])."""

    def height_at(self, time_s: Array) -> Array:
        """Height of the reference point over the floor, shape (n,) [m]; NaN outside of the motion."""
        return np.interp(time_s, self.height[:, 0], self.height[:, 1], left=np.nan, right=np.nan)


class NotMeasured(Exception):
    """What was received is not enough; the text says why, for the person who moves the vehicle."""


@dataclass(frozen=True)
class _Rows:
    """All readings with a distance: time, distance, index of the sensor."""

    time_s: Array
    range_m: Array
    sensor: Indices
    names: tuple[str, ...]
    from_file: Array

    @cached_property
    def knots(self) -> Array:
        """Times of the free heights [s]."""
        first, last = float(self.time_s.min()), float(self.time_s.max())
        return np.linspace(first, last, max(2, round((last - first) / KNOT_S) + 1))

    @cached_property
    def between_knots(self) -> Array:
        """Matrix from heights at the knots to heights at the readings, shape (n, k)."""
        off = np.abs(self.time_s[:, None] - self.knots) / (self.knots[1] - self.knots[0])
        shares: Array = np.clip(1 - off, 0.0, None)
        return shares

    @cached_property
    def assumed(self) -> Array:
        """Prior rows of the least-squares problem: heights bend little, and the mean displacement of the sensors is
        zero."""
        knots, sensors = len(self.knots), len(self.names)
        bends = np.diff(np.eye(knots), 2, axis=0) / BEND_M
        together = np.tile(np.eye(3), sensors) / 1e-4
        # Within a metre or so of where the file has them.
        moves = np.vstack([together, np.eye(3 * sensors)])
        return np.vstack([np.pad(bends, ((0, 0), (0, 3 * sensors))), np.pad(moves, ((0, 0), (knots, 0)))])


@dataclass(frozen=True)
class _Fit:
    solution: Array
    normal: Array
    residual_m: Array
    std_m: float


def places(samples: Samples, from_file: Mapping[str, Sequence[float]]) -> Places:
    """Measure where the sensors sit.

    Parameters
    ----------
    samples
        Readings and attitudes of the motion: lifted, tilted to all sides.
    from_file
        The sensors to be placed, with their places in the airframe file, forward, right, down [m].

    Raises
    ------
    NotMeasured
        Too few sensors see the floor, or no attitude was received.
    """
    names = [name for name in from_file if name in samples.readings]
    elsewhere: list[str] = []
    while True:
        rows = _rows(samples, names, from_file)
        if len(rows.names) < 2:
            raise NotMeasured(
                "fewer than two sensors see the floor: places are measured by comparing sensors. Hold the vehicle over "
                "a flat hard floor, 0.5 to 1.5 m high"
            )
        fit = _robust(samples, rows)
        typical_m = [np.median(np.abs(fit.residual_m[rows.sensor == i])) for i in range(len(rows.names))]
        moved_m = np.abs(fit.solution[len(rows.knots) :].reshape(-1, 3)).max(axis=1)
        off_m = np.maximum(typical_m, OTHER_M * moved_m / FARTHEST_M)
        worst = int(np.argmax(off_m))
        if off_m[worst] <= OTHER_M:
            break
        if len(rows.names) == 2:
            raise NotMeasured(
                f"{rows.names[0]} and {rows.names[1]} do not see the same floor, and there is no third one"
            )
        elsewhere.append(rows.names[worst])
        names.remove(rows.names[worst])
    elsewhere += [name for name in from_file if name not in rows.names and name not in elsewhere]
    lag = _lag(samples, rows, fit)
    if not lag.contains(0.0):
        fit = _robust(samples, rows, lag.value)
    return _result(rows, fit, lag, elsewhere)


def _rows(samples: Samples, names: Sequence[str], from_file: Mapping[str, Sequence[float]]) -> _Rows:
    found = {
        name: np.flatnonzero(readings.is_distance & np.isfinite(samples.down_at(readings.time_s)[:, 0]))
        for name, readings in ((name, samples.readings[name]) for name in names)
    }
    # Three numbers each, and a person sees some of the motion.
    kept = [name for name in names if len(found[name]) >= 12]
    if not kept:
        if len(samples.attitude) < 2:
            raise NotMeasured("no attitude of the autopilot is received: 'msp-range doctor' looks for the reason")
        raise NotMeasured("no sensor sees the floor: hold the vehicle over a flat hard floor, 0.5 to 1.5 m high")
    time_s, range_m = (
        np.concatenate([getattr(samples.readings[name], column)[found[name]] for name in kept])
        for column in ("time_s", "range_m")
    )
    sensor = np.repeat(np.arange(len(kept)), [len(found[name]) for name in kept])
    return _Rows(time_s, range_m, sensor, tuple(kept), np.array([from_file[name] for name in kept], dtype=float))


def _robust(samples: Samples, rows: _Rows, lag_s: float = 0.0) -> _Fit:
    """Weights of absolute values first, so that one sensor that sees something else does not bend the others."""
    down = samples.down_at(rows.time_s, lag_s)
    weights = np.isfinite(down[:, 0]).astype(float)
    usable = weights.copy()
    fit = _solve(rows, down, weights, NOISE_M)
    for _ in range(12):
        weights = usable * np.sqrt(NOISE_M / np.maximum(np.abs(fit.residual_m), NOISE_M))
        fit = _solve(rows, down, weights, NOISE_M)
    for _ in range(6):
        std_m = max(NOISE_M, 1.4826 * float(np.median(np.abs(fit.residual_m[usable > 0]))))
        weights = usable * np.clip(1 - (fit.residual_m / (OUTLIER * std_m)) ** 2, 0, None)
        fit = _solve(rows, down, weights, std_m)
    return fit


def _solve(rows: _Rows, down: Array, weights: Array, std_m: float) -> _Fit:
    """Weighted least squares of h(t) - d . (q - q_file) = r + d . q_file."""
    down = np.nan_to_num(down)
    of_sensor = np.eye(len(rows.names))[rows.sensor]
    places = -of_sensor[:, :, None] * down[:, None, :]
    matrix = np.hstack([rows.between_knots, places.reshape(len(down), -1)])
    wanted = rows.range_m + (down * rows.from_file[rows.sensor]).sum(axis=1)
    full = np.vstack([matrix * (weights / std_m)[:, None], rows.assumed])
    right = np.concatenate([wanted * weights / std_m, np.zeros(len(rows.assumed))])
    normal = full.T @ full
    solution = np.linalg.solve(normal, full.T @ right)
    return _Fit(solution, normal, wanted - matrix @ solution, std_m)


def _lag(samples: Samples, rows: _Rows, fit: _Fit) -> Measured:
    """The delay with the smallest sum of squares; its interval by the sum's curvature, and by all that fit as well."""
    good = np.abs(fit.residual_m) < OUTLIER * fit.std_m

    def squares(lag_s: float) -> float:
        down = samples.down_at(rows.time_s, lag_s)
        weights = (good & np.isfinite(down[:, 0])).astype(float)
        tried = _solve(rows, down, weights, fit.std_m)
        return float((weights * tried.residual_m**2).sum() / max(weights.sum(), 1.0)) * float(good.sum())

    lags_s = LAGS_S.tolist()
    sums = [squares(lag_s) for lag_s in lags_s]
    while np.argmin(sums) == len(sums) - 1 and lags_s[-1] < LONGEST_LAG_S:
        lags_s.append(lags_s[-1] + LAG_STEP_S)
        sums.append(squares(lags_s[-1]))
    best = int(np.clip(np.argmin(sums), 1, len(sums) - 2))
    curve, slope, _ = np.polyfit(lags_s[best - 1 : best + 2], sums[best - 1 : best + 2], 2)
    curvature = max(2 * float(curve), 1e-12)
    lag_s = float(np.clip(-slope / curvature, lags_s[0], lags_s[-1]))
    error_m = MARGIN * TWO_SIDED_95_PERCENT * fit.std_m
    # In a hover that hardly leans, delays far from the best one may fit nearly as well.
    most_m2 = sums[best] + (MARGIN * OF_MANY * fit.std_m) ** 2
    as_good_s = [abs(each_s - lag_s) for each_s, each in zip(lags_s, sums, strict=True) if each < most_m2]
    return Measured(lag_s, max(error_m * float(np.sqrt(2 / curvature)), *as_good_s))


def _result(rows: _Rows, fit: _Fit, lag: Measured, elsewhere: Sequence[str]) -> Places:
    knots, sensors = len(rows.knots), len(rows.names)
    moved = fit.solution[knots:].reshape(sensors, 3)
    half = MARGIN * TWO_SIDED_95_PERCENT * np.sqrt(np.diag(np.linalg.inv(fit.normal))[knots:]).reshape(sensors, 3)
    shift = np.array([common_shift(rows.from_file[:, axis], moved[:, axis], half[:, axis]) for axis in range(3)])
    places_m = rows.from_file + moved - shift
    height = fit.solution[:knots] - shift[2]  # r + q . d is the height
    stds = {
        name: _scatter(fit.residual_m[rows.sensor == i], len(rows.knots) / sensors) for i, name in enumerate(rows.names)
    }
    found = {name: tuple(map(Measured, places_m[i].tolist(), half[i].tolist())) for i, name in enumerate(rows.names)}
    return Places(found, tuple(elsewhere), lag, stds, np.stack([rows.knots, height], axis=1))


def _scatter(residual_m: Array, fitted: float) -> Measured:
    """Standard deviation of residuals without outliers, after ``fitted`` numbers were fitted to them."""
    kept = without_outliers(residual_m, NOISE_M)
    # Heights that bend little cost less than one number each.
    free = max(len(kept) - 0.5 * fitted, 0.5 * len(kept))
    std = max(float(np.sqrt(np.mean(kept**2))), NOISE_M) * float(np.sqrt(len(kept) / free))
    return Measured(std, TWO_SIDED_95_PERCENT * MARGIN * std / float(np.sqrt(2 * free)))


def without_outliers(off_m: Array, least_m: float) -> Array:
    """The deviations within three times their own scatter, which is taken as at least ``least_m`` [m]."""
    kept, spread_m = off_m, max(1.4826 * float(np.median(np.abs(off_m))), least_m)
    for _ in range(5):
        kept = off_m[np.abs(off_m) <= 3 * spread_m]
        spread_m = max(float(np.sqrt(np.mean(kept**2))), least_m)
    return kept


def common_shift(from_file: Array, moved: Array, half_width: Array) -> float:
    """The shift of all sensors along one axis that the motion cannot show, so that most of them agree with the file.

    Parameters
    ----------
    from_file, moved, half_width
        Place of each sensor in the file, how far away it was found, and half of the interval, shape (n,) [m].

    Returns
    -------
    float
        To be subtracted from ``moved`` [m]: the one that leaves the fewest mistakes in the file. Of several the one
        that leaves the sensors nearest to the reference point, as vehicles are built around theirs.

    Examples
    --------
    >>> one_wrong = common_shift(np.array([0.2, 0.2, -0.2]), np.array([0.1, 0.1, -0.2]), np.full(3, 0.01))
    >>> print(f"{one_wrong:.2f}")
    0.10
    """
    margin = np.maximum(half_width, 0.03)
    # A whole file with the wrong sign is one mistake, not several.
    mirrored = float(np.median(moved + 2 * from_file))
    all_mirrored = np.all(np.abs(moved + 2 * from_file - mirrored) <= margin)
    tried = [(mirrored, 1)] if all_mirrored else []
    for candidate in (float(np.median(moved)), *map(float, moved)):
        agree = np.abs(moved - candidate) <= margin
        if agree.any():
            tried.append((float(np.median(moved[agree])), int((~agree).sum())))
    return min(tried, key=lambda each: (each[1], round(float(np.abs(from_file + moved - each[0]).max()), 2)))[0]
