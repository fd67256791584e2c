"""What a sensor model says of the readings of a sensor, as plain numbers."""

import math
from typing import NamedTuple

from msp_range.geometry import Vector
from msp_range.numbers import limited

MOST_LOG_ODDS = 600.0
"""Growth with range of the log odds of a missed echo, at most: what the exponential function bears."""
WEIGHTS_M = 3.0
"""Range to which the share of missed echoes in a model file refers [m], but at most the sensor's longest:
`sensor_model.WEIGHTS_RANGE_CM`."""


class Expected(NamedTuple):
    """What a sensor's model says of its readings, as plain numbers."""

    short: float
    missed: float
    random: float
    """Shares of short, missed and random readings."""
    missed_growth_per_m: float
    """Growth of the log odds of a missed echo with range, from 3 m on [1/m]."""
    correlation: float
    """Correlation of the errors of two readings a turn apart."""
    spread: float
    """Deviation of the readings in flight over the one that they come with."""
    minimum_m: float
    maximum_m: float
    """Limits of the ranges [m]."""
    boresight: Vector
    """Unit vector along which it looks, body FRD."""
    facing_cosine: float
    """Cosine of the largest angle between it and straight down at which level ground gives an echo for sure."""

    def missed_at(self, range_m: float) -> float:
        """Share of missed echoes at a range."""
        missed, growth = self.missed, self.missed_growth_per_m * (range_m - min(WEIGHTS_M, self.maximum_m))
        return missed / (missed + (1.0 - missed) * math.exp(limited(-growth, -MOST_LOG_ODDS, MOST_LOG_ODDS)))
