"""How the vehicle moves up and down by its accelerometer and its barometer: a witness that no range has a part in.

It uses vertical accelerations and pressures as the autopilot sends them, never its estimate of the height, which may
rest on the stream that is to be judged. The ground filter predicts with the acceleration between two readings; how far
the vehicle has climbed since some time is for decisions that ranges alone cannot make.

A Kalman filter of height z [m], climb w [m/s] and accelerometer bias b [m/s^2] joins them:

    z' = w    w' = a - b    b' = white noise    barometer: y = z + white noise

The barometer's slow drift is not separated from z; it is counted where a climb is quoted (`VerticalMotion.climbed`).
"""

import math
from bisect import bisect_left
from collections import deque
from typing import NamedTuple

GRAVITY_M_S2 = 9.80665
CURRENT_S = 0.3
"""An acceleration or a pressure this old says nothing of now [s]: seven samples of the accelerations that are asked
for, three of the pressures."""
GREATEST_M_S2 = 80.0
"""A vertical acceleration beyond this is a fault of the message and not a motion [m/s^2]."""
FASTEST_M_S, SHORTEST_S = 30.0, 0.1
"""A pressure that changes faster than this is another level of pressure and no climb [m/s]; over at least this time
[s], so that the noise of two that follow at once is no speed."""
FORGOTTEN_S = 2.0
"""After this long without a pressure the filter starts anew [s]: by accelerations alone 2 m are soon lost."""
ACCELERATION_STD_M_S2 = 0.4
"""Of one acceleration, vibration and the turning of the body included [m/s^2]; larger trusts the barometer sooner."""
UNKNOWN_ACCELERATION_STD_M_S2 = 2.0
"""Of the vehicle's acceleration where no accelerometer says it [m/s^2]."""
BIAS_STD_M_S2, BIAS_WALK_M_S2 = 0.15, 0.01
"""Of the accelerometer's bias at the start [m/s^2], and how it wanders in a second [m/s^2 per root second]. Autopilots
calibrate it and assume 0.2 of what is left (EKF2_ABIAS_INIT); with that, pressure that the rotors change by 2.5 m at a
take-off soon after a start is taken for a bias."""
PRESSURE_STD_M = 0.3
"""Of one pressure as a height [m]: a barometer in the wash of rotors."""
CLIMB_STD_M, DRIFT_M = 0.3, 0.1
"""Standard deviation of a climb that is quoted: by the noise of the barometer [m], or by the speed's where that is
less, and what the barometer's drift adds, growing with the root of time [m per root second]: 1 m in a minute and a
half. Smaller values decide sooner, and wrongly in gusts."""
SAMPLES_KEPT = 64
"""Accelerations that are kept: 2.5 s at 25 Hz, longer than any time between readings that they are used for."""

_START = (PRESSURE_STD_M**2, 0.0, 0.0, 1.0, 0.0, BIAS_STD_M_S2**2)
"""Covariance of a filter that knows one pressure: zz, zw, zb, ww, wb, bb in SI units."""


class Mark(NamedTuple):
    """A height to compare later ones with: when [s], how high [m], and since which start of the filter."""

    time_s: float
    height_m: float
    start: int


class Known(NamedTuple):
    """The ground when it was last seen, and where the vehicle was."""

    time_s: float
    """Time at which it was seen [s]."""
    range_m: float
    height_m: float
    climb_m_s: float
    """How far away the ground was along the vehicle's down axis and straight down [m], and how fast that grew [m/s]."""
    mark: Mark | None
    """The height by the barometer; None where it reported nothing."""


class Climb(NamedTuple):
    """How much higher the vehicle is than at an earlier time [m], and the standard deviation of that [m]."""

    height_m: float
    std_m: float


class Rate(NamedTuple):
    """How fast the vehicle climbs [m/s], and the variance of the error of that [m^2/s^2]."""

    m_s: float
    variance: float


Covariance = tuple[float, float, float, float, float, float]
"""Of height, rate and a slow acceleration: zz, zw, zb, ww, wb, bb in SI units."""


def moved(covariance: Covariance, t: float) -> Covariance:
    """F P F^T after ``t`` [s], with F = [[1, t, -t^2/2], [0, 1, -t], [0, 0, 1]]."""
    zz, zw, zb, ww, wb, bb = covariance
    half = 0.5 * t * t
    # F P, then its last column first: the others contain it.
    fzz, fzw, fww = zz + t * zw - half * zb, zw + t * ww - half * wb, ww - t * wb
    zb, wb = zb + t * wb - half * bb, wb - t * bb
    return fzz + t * fzw - half * zb, fzw - t * zb, zb, fww - t * wb, wb, bb


def corrected(covariance: Covariance, variance_m2: float) -> tuple[tuple[float, float, float], Covariance]:
    """Gains of the three by a measured height with a variance [m^2], and their covariance after it."""
    zz, zw, zb, ww, wb, bb = covariance
    total_m2 = zz + variance_m2
    k_z, k_w, k_b = zz / total_m2, zw / total_m2, zb / total_m2
    return (k_z, k_w, k_b), (
        zz - k_z * zz,
        zw - k_z * zw,
        zb - k_z * zb,
        ww - k_w * zw,
        wb - k_w * zb,
        bb - k_b * zb,
    )


class Acceleration(NamedTuple):
    """The vehicle's acceleration upwards, gravity taken off [m/s^2], and when it was received [s]."""

    time_s: float
    up_m_s2: float


class PressureHeight(NamedTuple):
    """The pressure as a height over any level [m], and when it was received [s]."""

    time_s: float
    pressure_height_m: float


class VerticalMotion:
    """Height changes of the vehicle, by accelerometer and barometer.

    Examples
    --------
    >>> motion = VerticalMotion()
    >>> for i in range(201):
    ...     _ = motion.on_acceleration(i * 0.04, 0.0)
    ...     _ = motion.on_pressure_height(i * 0.04, 120.0 + 0.5 * i * 0.04)
    ...     mark = motion.mark(i * 0.04) if i == 150 else mark if i > 150 else None
    >>> climb = motion.climbed(mark, 8.0)
    >>> print(f"{climb.height_m:.1f} m, standard deviation {climb.std_m:.1f} m")
    1.0 m, standard deviation 0.2 m
    """

    def __init__(self) -> None:
        self._time_s = float("-inf")
        self._acceleration_s = self._pressure_s = float("-inf")
        self._acceleration_m_s2 = self._pressure_m = 0.0
        self._z = self._w = self._b = 0.0
        self._covariance = _START
        self._start = 0
        # When each acceleration came, it, and the speed that they add up to.
        self._samples_s: deque[float] = deque(maxlen=SAMPLES_KEPT)
        self._samples: deque[tuple[float, float]] = deque(maxlen=SAMPLES_KEPT)

    def update(self, moved: Acceleration | PressureHeight) -> bool:
        """Update with either; False where it makes no sense."""
        if isinstance(moved, Acceleration):
            return self.on_acceleration(*moved)
        return self.on_pressure_height(*moved)

    def on_acceleration(self, time_s: float, up_m_s2: float) -> bool:
        """Update with the vehicle's acceleration upwards, gravity taken off [m/s^2]; False where it makes no sense."""
        if not abs(up_m_s2) < GREATEST_M_S2 or time_s < self._time_s:
            return False
        self._predict(time_s)
        speed_m_s = self._samples[-1][1] + up_m_s2 * (time_s - self._acceleration_s) if self._samples else 0.0
        self._acceleration_m_s2, self._acceleration_s = up_m_s2, time_s
        self._samples_s.append(time_s)
        self._samples.append((up_m_s2, speed_m_s))
        return True

    def on_pressure_height(self, time_s: float, height_m: float) -> bool:
        """Update with the pressure as a height over any level [m]; False where it makes no sense."""
        if not math.isfinite(height_m) or time_s < self._time_s:
            return False
        elapsed_s = time_s - self._pressure_s
        jumped = abs(height_m - self._pressure_m) > FASTEST_M_S * max(elapsed_s, SHORTEST_S)
        self._pressure_m, self._pressure_s = height_m, time_s
        if elapsed_s > FORGOTTEN_S or jumped:
            # Another level of pressure is no climb: nothing is known of how it compares with the heights before.
            self._start += 1
            self._time_s, self._z, self._w, self._covariance = time_s, height_m, 0.0, _START
            return not jumped
        self._predict(time_s)
        (k_z, k_w, k_b), self._covariance = corrected(self._covariance, PRESSURE_STD_M * PRESSURE_STD_M)
        off_m = height_m - self._z
        self._z += k_z * off_m
        self._w += k_w * off_m
        self._b += k_b * off_m
        return True

    def measured(self, from_s: float, to_s: float) -> float | None:
        """Mean acceleration upwards between two times as it was measured [m/s^2]; None where it is not known.

        Each is the mean since the one before.
        """
        if to_s - self._acceleration_s > CURRENT_S:
            return None
        if to_s <= from_s:
            return self._samples[-1][0]
        return (self._speed_m_s(to_s) - self._speed_m_s(from_s)) / (to_s - from_s)

    def covers(self, from_s: float) -> bool:
        """Whether the accelerations since a time are kept."""
        return bool(self._samples_s) and self._samples_s[0] <= from_s

    def _speed_m_s(self, time_s: float) -> float:
        """By the accelerations alone, from any speed."""
        i = bisect_left(self._samples_s, time_s, 0, len(self._samples_s) - 1)
        up_m_s2, speed_m_s = self._samples[i]
        return speed_m_s + up_m_s2 * (time_s - self._samples_s[i])

    def acceleration(self, from_s: float, to_s: float) -> float | None:
        """As `measured`, with the bias taken off that the barometer shows."""
        up_m_s2 = self.measured(from_s, to_s)
        return None if up_m_s2 is None else up_m_s2 - self._b

    def rate(self, time_s: float) -> Rate | None:
        """How fast the vehicle climbs at a time close to now; None where the barometer says nothing."""
        return Rate(self._w, self._covariance[3]) if time_s - self._pressure_s <= CURRENT_S else None

    def mark(self, time_s: float) -> Mark | None:
        """The height at a time close to now, for `climbed` later; None where the barometer says nothing."""
        if not time_s - self._pressure_s <= CURRENT_S:
            return None
        return Mark(time_s, self._z + self._w * (time_s - self._time_s), self._start)

    def climbed(self, since: Mark | None, now_s: float) -> Climb | None:
        """How much higher the vehicle is now than at a mark; None where that is not known."""
        if since is None:
            return None
        now = self.mark(now_s)
        if now is None or now.start != since.start:
            return None
        elapsed_s = max(now_s - since.time_s, 0.0)
        short_m = min(math.sqrt(self._covariance[3]) * elapsed_s, CLIMB_STD_M)
        return Climb(now.height_m - since.height_m, math.hypot(short_m, DRIFT_M * math.sqrt(elapsed_s)))

    def _predict(self, time_s: float) -> None:
        """x' = F x, P' = F P F^T + Q for (z, w, b); see `moved`."""
        t = time_s - self._time_s
        self._time_s = time_s
        if not 0.0 < t < float("inf"):
            return
        known = time_s - self._acceleration_s <= CURRENT_S
        net_m_s2 = self._acceleration_m_s2 - self._b if known else 0.0
        self._z += (self._w + 0.5 * net_m_s2 * t) * t
        self._w += net_m_s2 * t
        if known:
            zz, zw, zb, ww, wb, bb = moved(self._covariance, t)
        else:
            zz, zw, zb, ww, wb, bb = self._covariance
            zz, zw, zb = zz + t * (2 * zw + t * ww), zw + t * ww, zb + t * wb
        speed = (ACCELERATION_STD_M_S2 if known else UNKNOWN_ACCELERATION_STD_M_S2) * t
        way = 0.5 * speed * t
        self._covariance = (
            zz + way * way,
            zw + way * speed,
            zb,
            ww + speed * speed,
            wb,
            bb + BIAS_WALK_M_S2 * BIAS_WALK_M_S2 * t,
        )
