"""Which sensor a hand covers: its readings change, those of the others do not.

Samples before and while one sensor is covered enter, the name under which the covered sensor answers leaves.
"""

import numpy as np

from msp_range.arrays import Flags
from msp_range.commission.samples import Samples, SensorReadings

NEAR_M = 0.35
"""A covered sensor reads less than this [m]: a hand on it gives the shortest report, 0.20 m for an MB1242."""
FREE_M = 0.60
"""Without a hand each sensor needs this much room [m], or the ground itself would look like a hand."""
COVERED_SHARE, FREE_SHARE = 0.6, 0.3
"""The covered sensor has at least the first share of near readings while it is covered, all others at most the second.
A hand that comes late costs a third of the readings; a sensor that sees the arm has some. Between the two nobody is
named."""


def near_share(readings: SensorReadings) -> float:
    """Share of the answers that say that something is right in front of the sensor; 0 where there are none."""
    if not readings.status:
        return 0.0
    return float(_within(readings, NEAR_M).mean())


def _within(readings: SensorReadings, distance_m: float) -> Flags:
    return np.array([each == "at_minimum" for each in readings.status]) | (readings.range_m < distance_m)


def blocked(free: Samples) -> list[str]:
    """Sensors that have something in front of them although nobody covers them, or no answer at all."""
    names = []
    for name, readings in free.readings.items():
        answers = np.array([each in ("ok", "at_minimum", "no_echo", "suspect") for each in readings.status])
        if not answers.any() or _within(readings, FREE_M)[answers].mean() > FREE_SHARE:
            names.append(name)
    return names


def covered(during: Samples) -> str | None:
    """Name of the sensor that answers as covered; None where that is not clear.

    Parameters
    ----------
    during
        What was received while a hand covered one sensor.
    """
    shares = {name: near_share(readings) for name, readings in during.readings.items()}
    first = max(shares, key=lambda name: shares[name], default=None)
    others = [share for name, share in shares.items() if name != first]
    clear = first is not None and shares[first] >= COVERED_SHARE and max(others, default=0.0) <= FREE_SHARE
    return first if clear else None
