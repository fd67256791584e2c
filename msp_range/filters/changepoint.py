"""The changepoint filter: level, slope and sudden step of the ground, from readings that are not all of the ground.

One reading and its variance enter, the range now and the variance of its error leave. It is a Bayesian mixture over
runs (Adams and MacKay 2007, Fearnhead and Liu 2007), each with a constant range or a constant rate, with the sensor's
own reading model as the likelihood; `msp_range.filters.runs` has the equations. There is nothing to tune.
"""

import math
from typing import TYPE_CHECKING, Literal

from msp_range.filters.base import Estimate
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import Section

if TYPE_CHECKING:
    from msp_range.filters.runs import Likelihood


class ChangepointParameters(Section):
    """Follows levels, slopes and steps; how it takes a surprising reading comes from the sensor model file."""

    filter: Literal["changepoint"]
    """the word changepoint"""

    def make(self, sensor: SensorModel | None = None) -> "Changepoint":
        """A filter in its starting state."""
        if sensor is None:
            raise ValueError("filter changepoint: needs the sensor model, whose reading model is its likelihood")
        # Brings numpy, which checking a file can do without.
        from msp_range.filters.runs import Likelihood

        return Changepoint(
            Likelihood.of(sensor.reading_model, sensor.minimum_cm, sensor.maximum_cm, sensor.resolution_cm)
        )


class Changepoint:
    """One stream of `Runs`.

    Where the reading model knows readings that are not of the surface, the first reading after a start is held back
    until a second one has confirmed it: a wrong distance is worse than none.
    """

    def __init__(self, likelihood: "Likelihood") -> None:
        import numpy as np

        self._likelihood = likelihood
        self._variance_m2 = likelihood.variance_m2
        self._elapsed_s, self._reading_m, self._reading_variance_m2 = np.zeros(1), np.zeros(1), np.zeros(1)
        self._time_s: float | None = None
        self.reset()

    def update(self, time_s: float, measured: Estimate) -> Estimate | None:
        """Range and variance after this reading; None where it is not believed, or no level is known yet."""
        variance_m2 = measured.variance_m2
        before_s = time_s if self._time_s is None else self._time_s
        self._time_s = max(time_s, before_s)
        self._elapsed_s[0] = self._time_s - before_s
        self._reading_m[0] = measured.range_m
        self._reading_variance_m2[0] = variance_m2 if variance_m2 < math.inf else self._variance_m2
        estimate = self._runs.update(self._elapsed_s, self._reading_m, self._reading_variance_m2)
        if not estimate.sure[0]:
            return None
        return Estimate(float(estimate.range_m[0]), float(estimate.variance_m2[0]))

    def reset(self) -> None:
        """Know nothing."""
        from msp_range.filters.runs import Runs

        self._runs = Runs(self._likelihood, 1)
        self._time_s = None
