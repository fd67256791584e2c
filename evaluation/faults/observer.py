"""An ideal observer: whether somebody who knows the fault families could have known that a distance is wrong.

What the bridge received in a flight enters (answers of the sensors, attitudes, accelerations, pressures, temperatures)
with the distances that it sent; for each of these the log odds leave that it is wrong. The observer knows the families:
which faults exist, in which ranges, how often, which grounds and flights there are, and the noise of each sensor. It
does not know which flight has what. It shares no code with the bridge's fusion.

Hypotheses
    Each gives every sensor a mode (ground, or one of nine faults) and has a Kalman filter of its own: height, climb and
    accelerometer bias of the vehicle, height of the ground and its rise, the barometer's drift, gust and ground effect,
    and the level of the ground below each sensor. At every answer each hypothesis branches: the answer is of the
    ground, an outlier, or of another level (an edge, a box), or the sensor's mode changes, each with its prior and its
    likelihood. Those with the same modes are merged, and the likeliest go on. In a flight of a minute a fault is about
    as likely as none; all kinds of fault are equally likely, and one of a sensor is often one of the next sensor too.
Gain
    The log odds that a distance is off by more than half of the judge's tolerance: all hypotheses together, each with
    its mean and variance of the ground. The distance to the level below any sensor is right. A distance that rests on
    answers which do not follow the ground, while the height is not known otherwise, is not right: it would be a
    coincidence. Only gains while the distance is wrong count.
Thermometer
    One that settles is a hypothesis of its own: an exponential of 60 to 120 s against a constant, by the marginal
    likelihood of the temperatures received. Of one that jumps or flaps the value before that is right.

Simplifications that make it slower than the ideal: any acceleration of the vehicle is as likely as any other; its
horizontal motion is not used, so that a box below some sensors is not distinguished from an edge; the barometer counts
little below 1.2 m; an object that swings, a noisy sensor and damaged bytes are broad distributions; the ground's slope
is a slow rise of the ground and a level below each sensor; the thermometer is read once a second.
Simplifications that can make it quicker or slower: of merged hypotheses the likeliest one's estimate is kept, and
dropped ones could have become likely again.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr

from evaluation.faults.hypotheses import Array, Hypotheses
from evaluation.faults.judge import Distance, Event

DECIDED_NATS = 10.0
"""Gain from which on the observer would report a distance: it would be wrong once in 22,000 times."""
JUMPS_C = 2.0
"""A thermometer that changes by more than this in a second jumps or flaps [K]; one that settles, by up to 0.7 K."""
GRAVITY_M_S2, SCALE_HEIGHT_M, CALIBRATED_K = 9.80665, 8434.0, 295.65


class Messages(NamedTuple):
    """What the bridge received: answers (time of the echo, sensor, raw word), attitudes (time, roll, pitch), specific
    forces (time, x, y, z), pressures (time, hPa), temperatures (time, deg C); and where the sensors are from the
    reference point, body FRD, and the lean from which a range gives no echo [rad at m]."""

    answers: Sequence[tuple[float, int, int]]
    attitudes: Sequence[tuple[float, float, float]]
    forces: Sequence[tuple[float, float, float, float]]
    pressures: Sequence[tuple[float, float]]
    temperatures: Sequence[tuple[float, float]]
    positions_m: Sequence[tuple[float, float, float]]
    breakaway_rad: Callable[[float], float]


def gains(
    messages: Messages, distances: Sequence[Distance], half_m: Callable[[float], float], until_s: float
) -> list[float]:
    """Log odds that each distance is wrong [nats], of those whose time stamp is before ``until_s``."""
    hypotheses = Hypotheses(len(messages.positions_m))
    attitude_s = [time_s for time_s, roll, pitch in messages.attitudes]
    temperatures = _without_jumps(messages.temperatures)
    temperature_s = [time_s for time_s, _ in temperatures]

    def down(time_s: float) -> tuple[float, float, float]:
        """The vertical in the body frame by the last attitude."""
        i = max(bisect_right(attitude_s, time_s) - 1, 0)
        _, roll, pitch = messages.attitudes[i] if messages.attitudes else (0.0, 0.0, 0.0)
        return -math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll)

    def temperature_c(time_s: float) -> float:
        return temperatures[max(bisect_right(temperature_s, time_s) - 1, 0)][1]

    events: list[tuple[float, int, Any]] = [(each[0], 0, each[1:]) for each in messages.forces]
    events += [(each[0], 1, each[1]) for each in messages.pressures]
    events += [(each[0], 2, each[1:]) for each in messages.answers]
    events += [(each.stamp_s + 0.002, 3, each) for each in distances]
    found: list[float] = []
    for time_s, kind, content in sorted(events, key=lambda each: each[:2]):
        if time_s > until_s + 0.01:
            break
        axis, kelvin = down(time_s), 273.15 + temperature_c(time_s)
        if kind == 0:
            hypotheses.on_acceleration(time_s, -float(np.dot(axis, content)) - GRAVITY_M_S2)
        elif kind == 1:
            height_m = -SCALE_HEIGHT_M * math.log(content / messages.pressures[0][1])
            hypotheses.on_pressure(time_s, height_m, 288.15 / kelvin)
        elif kind == 2:
            sensor, raw = content
            scale = math.sqrt(kelvin / CALIBRATED_K)
            over_rad = math.acos(min(axis[2], 1.0)) - messages.breakaway_rad(max(raw / 100, 0.5))
            lost = 1 / (1 + math.exp(-math.degrees(over_rad) / 1.5))
            hypotheses.on_answer(time_s, sensor, raw, scale, float(np.dot(axis, messages.positions_m[sensor])), lost)
        else:
            distance_m = min(content.current_m, content.maximum_m + 0.01)
            half = half_m(distance_m)
            wrong = hypotheses.log_odds_wrong(distance_m, content.maximum_m, half, axis[2])
            received = temperatures[: bisect_right(temperature_s, time_s)]
            found.append(max(wrong, _thermometer_wrong(received, half / max(distance_m, 0.2))))
    return found


def decide(
    messages: Messages, distances: Sequence[Distance], events: Sequence[Event], tolerance_m: Callable[[float], float]
) -> list[float | None]:
    """By event, how long after its beginning the gain reaches `DECIDED_NATS` while it lasts [s]; None: never."""
    by_stamp = sorted(distances, key=lambda each: each.stamp_s)
    last_s = max((event.from_s + event.for_s for event in events), default=-1.0)
    gained = gains(messages, by_stamp, lambda distance_m: 0.5 * tolerance_m(distance_m), last_s)
    known = list(zip(by_stamp, gained, strict=False))
    decided: list[float | None] = []
    for event in events:
        during = [
            max(each.time_s - event.from_s, 0.0)
            for each, nats in known
            if -0.5 < each.time_s - event.from_s < event.for_s and nats >= DECIDED_NATS
        ]
        decided.append(round(min(during), 3) if during else None)
    return decided


def _without_jumps(temperatures: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """Temperatures, with the value before it while one has jumped away: in the families that one is right."""
    steady = list(temperatures[:1])
    for time_s, value_c in temperatures[1:]:
        before_c = steady[-1][1]
        steady.append((time_s, value_c if abs(value_c - before_c) <= JUMPS_C else before_c))
    return steady


def _thermometer_wrong(received: Sequence[tuple[float, float]], half_share: float) -> float:
    """Log odds that a settling thermometer makes a distance wrong by more than a share of it."""
    if len(received) < 3:
        return -math.inf
    times_s, values_c = np.array(received).T
    one, noise = np.ones_like(times_s), 0.1**2 * np.eye(len(times_s))
    right = _log_normal(values_c - 15.0, 15.0**2 * np.outer(one, one) + noise)
    wrong = -math.inf
    limit_c = half_share * 2 * (273.15 + values_c[-1])
    for tau_s, (air_c, by_c) in product((60.0, 75.0, 90.0, 105.0, 120.0), ((-15.0, 35.0), (20.0, -35.0))):
        decay = np.exp(-times_s / tau_s)
        covariance = 3.0**2 * np.outer(one, one) + 4.0**2 * np.outer(decay, decay) + noise
        off_c = values_c - air_c - by_c * decay
        gain = 4.0**2 * np.linalg.solve(covariance, decay)
        error_c = (by_c + float(gain @ off_c)) * decay[-1]
        std_c = math.sqrt(max(4.0**2 * (1.0 - float(gain @ decay)), 1e-6)) * decay[-1]
        is_off = float(ndtr((abs(error_c) - limit_c) / std_c))
        weight = _log_normal(off_c, covariance) - math.log(10)
        wrong = float(np.logaddexp(wrong, weight + math.log(max(is_off, 1e-12))))
        right = float(np.logaddexp(right, weight + math.log(max(1.0 - is_off, 1e-12))))
    return wrong - right


def _log_normal(off: Array, covariance: Array) -> float:
    _, log_determinant = np.linalg.slogdet(2 * math.pi * covariance)
    return float(-0.5 * (log_determinant + off @ np.linalg.solve(covariance, off)))
