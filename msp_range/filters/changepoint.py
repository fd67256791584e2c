"""The changepoint filter: follows level, slope and steps of the ground in readings with outliers.

It is updated with readings and their variances, and estimates the present range with its variance. It is a Bayesian
mixture over runs (Adams and MacKay 2007, Fearnhead and Liu 2007), each with a constant range or a constant rate, with
the sensor's own reading model as the likelihood; `msp_range.filters.runs` has the equations. It has no parameters to
tune.
"""

import math
from typing import TYPE_CHECKING, Literal

from msp_range.filters.base import Estimate
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import Section

if TYPE_CHECKING:
    from msp_range.filters.runs import RangeLikelihood


class ChangepointParameters(Section):
    """Follows levels, slopes and steps; the probability of outliers comes from the sensor model file."""

    filter: Literal["changepoint"]
    """the word changepoint"""

    def make(self, sensor: SensorModel) -> "Changepoint":
        """Make a filter in its initial state."""
        # Imports numpy, which is not needed to check a file.
        from msp_range.filters.runs import RangeLikelihood

        return Changepoint(
            RangeLikelihood.of(sensor.reading_model, sensor.minimum_cm, sensor.maximum_cm, sensor.answered_cm)
        )


class Changepoint:
    """The filter of one stream, with `RunHistories` for one stream.

    If the reading model has outliers, the first reading after a start is rejected until a second one confirms it,
    because a wrong distance is worse than none.
    """

    def __init__(self, likelihood: "RangeLikelihood") -> None:
        import numpy as np

        self._likelihood = likelihood
        self._variance_m2 = likelihood.variance_m2
        self._elapsed_s, self._reading_m, self._reading_variance_m2 = np.zeros(1), np.zeros(1), np.zeros(1)
        self._time_s: float | None = None
        self.reset()

    def update(self, time_s: float, measured: Estimate) -> Estimate | None:
        """Range and variance after this reading; None if it is probably an outlier, or no level is known yet."""
        variance_m2 = measured.variance_m2
        before_s = time_s if self._time_s is None else self._time_s
        self._time_s = max(time_s, before_s)
        self._elapsed_s[0] = self._time_s - before_s
        self._reading_m[0] = measured.range_m
        self._reading_variance_m2[0] = variance_m2 if variance_m2 < math.inf else self._variance_m2
        estimate = self._runs.update(self._elapsed_s, self._reading_m, self._reading_variance_m2)
        if not estimate.converged[0]:
            return None
        return Estimate(float(estimate.range_m[0]), float(estimate.variance_m2[0]))

    def reset(self) -> None:
        """Forget everything."""
        from msp_range.filters.runs import RunHistories

        self._runs = RunHistories(self._likelihood, 1)
        self._time_s = None
