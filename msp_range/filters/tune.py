"""Fit Q and R of a Kalman filter to recorded readings by the likelihood of its innovations.

A correct filter predicts each reading with the spread that it states. So the fit maximises the likelihood of the
readings, log L = sum log N(innovation; 0, S), over all readings of all sensors. Single
outliers, which the filter's gate rejects in flight, are removed first, the same ones for all parameters.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import differentiate
from scipy.optimize import minimize

from msp_range.filters.chain import MEMORY_S
from msp_range.filters.kalman import START_SPEED_STD_M_S, KalmanParameters

OUTLIER_SIGMAS = 6.0
"""Factor on the typical distance from the mean of the neighbours beyond which a reading is an outlier."""
MAD_TO_STD = 1.4826
"""Ratio of the standard deviation of a normal variable to its median absolute deviation."""
PASSES = 20
"""Largest number of passes, each of which removes one of several adjacent outliers."""
NOT_COUNTED = 3
"""Number of innovations that are not counted after each start or gap, because they depend on the initial state."""
FEWEST = 100
"""Smallest number of readings for a fit."""
BOUNDS = {
    "acceleration_std_m_s2": (1e-3, 100.0),
    "process_variance_cm2": (1e-6, 1e6),
    "measurement_variance_cm2": (1e-3, 1e6),
}
"""Limits of the search, as in `KalmanParameters`."""
NORMAL_95 = 1.959964

Track = Sequence[tuple[float, float]]
"""One sensor's readings in order: time [s], range [m]."""


@dataclass(frozen=True, slots=True)
class FittedParameter:
    """One parameter."""

    name: str
    """Name in the airframe file."""
    before: float
    value: float
    """Previous value, and the most likely value."""
    low: float
    high: float
    """95 % interval from the curvature of the likelihood; 0 or infinite if the readings set no limit."""


@dataclass(frozen=True, slots=True)
class Tuned:
    """The outcome."""

    parameters: KalmanParameters
    """The filter with the fitted values."""
    fitted: tuple[FittedParameter, FittedParameter]
    """The fitted values: Q, then R."""
    innovations: int
    outliers: int
    """Numbers of innovations counted, and of readings removed as outliers."""
    before: float
    after: float
    """Log likelihood with the given and with the fitted values; only their difference is meaningful."""


def tune(tracks: Sequence[Track], parameters: KalmanParameters, variance_cm2: float) -> Tuned:
    """Fit Q and R.

    Parameters
    ----------
    tracks
        Each sensor's readings, corrected but not filtered.
    parameters
        The present filter; its model is kept.
    variance_cm2
        R if the parameters leave it to the sensor model [cm^2].

    Raises
    ------
    ValueError
        Fewer than `FEWEST` readings.

    Examples
    --------
    >>> draw = np.random.default_rng(1)
    >>> hover = [(0.1 * i, 2.0 + draw.normal(scale=0.02)) for i in range(2000)]
    >>> tuned = tune([hover], KalmanParameters(filter="kalman", model="constant"), 1.0)
    >>> print(f"{math.sqrt(tuned.fitted[1].value):.1f} cm")
    2.0 cm
    """
    moving = parameters.model == "constant_velocity"
    of_q = "acceleration_std_m_s2" if moving else "process_variance_cm2"
    names = (of_q, "measurement_variance_cm2")
    given = (getattr(parameters, of_q), parameters.measurement_variance_cm2 or variance_cm2)
    readings = sum(len(track) for track in tracks)
    tracks = [without_outliers(track) for track in tracks]
    outliers = readings - sum(len(track) for track in tracks)
    count = sum(max(len(track) - NOT_COUNTED, 0) for track in tracks)
    if readings < FEWEST:
        raise ValueError(f"found {readings} readings with a range; expected {FEWEST} or more")

    def cost(logs: np.ndarray) -> float:
        q, r_m2 = math.exp(logs[0]), math.exp(logs[1]) * 1e-4
        return -sum(log_likelihood(track, moving, q if moving else q * 1e-4, r_m2) for track in tracks)

    start = np.log(given)
    limits = np.log([BOUNDS[name] for name in names]).T
    found = min(
        (
            minimize(cost, start_logs, method="Nelder-Mead", bounds=limits.T, options={"xatol": 1e-3, "fatol": 1e-3})
            for start_logs in (start, np.array([start[0] - 2.0, _differences(tracks)]))
        ),
        key=lambda result: float(result.fun),
    )
    best = np.asarray(found.x)
    reach = np.where(np.isclose(best, limits, atol=0.02).any(axis=0), np.inf, _reach(cost, best))
    low, high = np.exp(best - reach).tolist(), np.exp(best + reach).tolist()
    fitted = [FittedParameter(*row) for row in zip(names, given, np.exp(best).tolist(), low, high, strict=True)]
    changed = parameters.model_copy(update={parameter.name: float(f"{parameter.value:.3g}") for parameter in fitted})
    return Tuned(changed, (fitted[0], fitted[1]), count, outliers, -cost(start), -float(found.fun))


def without_outliers(track: Track) -> Track:
    """The track without readings that differ from both neighbours while those agree."""
    kept = np.array(track, dtype=float).reshape(-1, 2)
    for _ in range(PASSES):
        if len(kept) < 5:
            break
        time_s, range_m = kept.T
        before_m, after_m = range_m[:-2], range_m[2:]
        share = (time_s[1:-1] - time_s[:-2]) / np.maximum(time_s[2:] - time_s[:-2], 1e-6)
        off_m = np.abs(range_m[1:-1] - before_m - share * (after_m - before_m))
        typical_m = MAD_TO_STD * np.median(off_m)
        is_outlier = (off_m > OUTLIER_SIGMAS * max(typical_m, 0.005)) & (np.abs(after_m - before_m) < off_m)
        neighbours_m = np.maximum(np.append(off_m[1:], 0.0), np.append(0.0, off_m[:-1]))
        worst = np.flatnonzero(is_outlier & (off_m >= neighbours_m)) + 1
        if not worst.size:
            break
        kept = np.delete(kept, worst, axis=0)
    return [(time_s, range_m) for time_s, range_m in kept.tolist()]


def _differences(tracks: Sequence[Track]) -> float:
    """Log of a first R [cm^2]: half the mean square of second differences over three, outliers left out."""
    squares = [
        (c[1] - 2 * b[1] + a[1]) ** 2 / 6
        for track in tracks
        for a, b, c in zip(track, track[1:], track[2:], strict=False)
    ]
    return math.log(max(float(np.median(squares)) / 0.455 * 1e4, 0.01))


def _reach(cost: Callable[[np.ndarray], float], best: np.ndarray) -> np.ndarray:
    """Half widths of the 95 % intervals of the logarithms, from the matrix of second derivatives; infinite if flat."""
    found = differentiate.hessian(
        lambda logs: np.apply_along_axis(cost, 0, logs), best, initial_step=0.05, order=2, maxiter=1
    )
    hessian = np.asarray(found.ddf, dtype=np.float64)
    if np.diag(hessian).min() <= 0 or np.linalg.det(hessian) <= 0:
        alone = np.where(np.diag(hessian) > 1e-3, np.diag(hessian), 0.0)
        with np.errstate(divide="ignore"):
            return NORMAL_95 / np.sqrt(alone)
    return NORMAL_95 * np.sqrt(np.diag(np.linalg.inv(hessian)))


def log_likelihood(track: Track, moving: bool, q: float, r_m2: float) -> float:
    """Log likelihood of a track's innovations under the filter of `msp_range.filters.kalman`, with one or two states.

    Parameters
    ----------
    moving
        True: constant velocity, ``q`` is the standard deviation of the acceleration [m/s^2]. False: constant, ``q`` is
        the variance added at each reading [m^2].
    r_m2
        Variance of a reading [m^2].
    """
    total, innovations, last_s = 0.0, 0, -math.inf
    x = v = pxx = pxv = pvv = 0.0
    for time_s, range_m in track:
        elapsed_s = time_s - last_s
        last_s = time_s
        if elapsed_s > MEMORY_S:
            x, v, pxx, pxv, pvv = range_m, 0.0, r_m2, 0.0, START_SPEED_STD_M_S**2 if moving else 0.0
            innovations = 0
            continue
        if moving:
            noise = q * q * elapsed_s * elapsed_s
            x += v * elapsed_s
            pxx += elapsed_s * (2 * pxv + elapsed_s * pvv) + noise * elapsed_s * elapsed_s / 4
            pxv += elapsed_s * pvv + noise * elapsed_s / 2
            pvv += noise
        else:
            pxx += q
        s_m2 = pxx + r_m2
        off_m = range_m - x
        innovations += 1
        if innovations > NOT_COUNTED:
            total -= 0.5 * (off_m * off_m / s_m2 + math.log(2 * math.pi * s_m2))
        kx, kv = pxx / s_m2, pxv / s_m2
        x, v = x + kx * off_m, v + kv * off_m
        pxx, pxv, pvv = pxx - kx * pxx, pxv - kx * pxv, pvv - kv * pxv
    return total
