"""Kalman filter (report eq 15-19) on filterpy, with a constant or a constant-velocity model.

The report's filter is ``model: constant`` with a process variance per step. In flight the constant-velocity model is
better: it follows a climb without lag, and accepts readings at any times.
"""

import math
from typing import Any, Literal

from pydantic import Field

from msp_range.filters.base import Estimate
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import Section

START_SPEED_STD_M_S = 2.0
"""Standard deviation of the speed at the first reading [m/s]."""
SPEED_CHANGE_STD_M_S = 0.2
"""Standard deviation of the change of speed between two outliers that agree [m/s]."""
SOONEST_S = 1e-4
"""Two readings of a sensor that are no farther apart say nothing of a speed [s]: the quickest sensors take some
milliseconds. It affects only time stamps that are wrong; over much less a speed's variance is no number."""


class KalmanParameters(Section):
    """The state is the range, or the range and its rate; an outlier is rejected until a second reading agrees with
    it."""

    filter: Literal["kalman"]
    """the word kalman"""
    model: Literal["constant", "constant_velocity"] = "constant_velocity"
    """constant (F = 1, as in the report) or constant_velocity"""
    process_variance_cm2: float = Field(1.0, gt=0, le=1e6)
    """constant model: Q, variance added at each reading [cm^2]"""
    acceleration_std_m_s2: float = Field(1.0, gt=0, le=100)
    """constant_velocity model: standard deviation of the acceleration between readings [m/s^2]"""
    measurement_variance_cm2: float | None = Field(None, gt=0, le=1e6)
    """R [cm^2]; default: the sensor model's"""
    gate_sigmas: float | None = Field(4.0, gt=0)
    """readings further from the prediction than this many standard deviations are rejected until a second one agrees;
    null: none are"""

    def make(self, sensor: SensorModel) -> "Kalman":
        """Make a filter in its initial state."""
        return Kalman(self)


class Kalman:
    """filterpy's KalmanFilter, started at the first reading with P = R."""

    def __init__(self, parameters: KalmanParameters) -> None:
        # filterpy takes a second to import, and is needed only if an airframe names this filter.
        import numpy as np
        from filterpy.kalman import KalmanFilter

        self._parameters = parameters
        self._moving = parameters.model == "constant_velocity"
        size = 2 if self._moving else 1
        self._kalman: Any = KalmanFilter(dim_x=size, dim_z=1)
        self._kalman.H = np.eye(1, size)
        # The innovation's variance is 1 x 1. filterpy allows another function for its inverse; this one is ten times
        # faster.
        self._kalman.inv = np.reciprocal
        self._transition = np.eye(size)
        self._noise = np.empty((size, size))
        self._time_s: float | None = None
        self._waiting: tuple[float, Estimate] | None = None

    def update(self, time_s: float, measured: Estimate) -> Estimate | None:
        """Predict to ``time_s``, gate, update."""
        parameters = self._parameters
        if parameters.measurement_variance_cm2 is not None:
            measured = Estimate(measured.range_m, parameters.measurement_variance_cm2 * 1e-4)
        elif not math.isfinite(measured.variance_m2):
            raise ValueError(
                "filter kalman: the readings have no variance; give measurement_variance_cm2, or a sensor model with "
                "sigma_cm"
            )
        if self._time_s is None:
            return self._start(time_s, measured, 0.0, START_SPEED_STD_M_S**2)
        kalman = self._kalman
        self._predict(max(time_s - self._time_s, 0.0))
        self._time_s = max(time_s, self._time_s)
        if parameters.gate_sigmas is not None:
            innovation_m = measured.range_m - float(kalman.x[0, 0])
            bound_m2 = parameters.gate_sigmas**2 * (float(kalman.P[0, 0]) + measured.variance_m2)
            if innovation_m * innovation_m > bound_m2:
                return self._wait(time_s, measured, parameters.gate_sigmas)
        self._waiting = None
        kalman.update(measured.range_m, R=measured.variance_m2)
        return Estimate(float(kalman.x[0, 0]), float(kalman.P[0, 0]))

    def _predict(self, elapsed_s: float) -> None:
        """Q of a constant acceleration a over T: a^2 [[T^4/4, T^3/2], [T^3/2, T^2]]; or the report's, a step."""
        noise = self._noise
        if self._moving:
            self._transition[0, 1] = elapsed_s
            variance = self._parameters.acceleration_std_m_s2**2 * elapsed_s * elapsed_s
            noise[0, 0] = variance * elapsed_s * elapsed_s / 4
            noise[0, 1] = noise[1, 0] = variance * elapsed_s / 2
            noise[1, 1] = variance
        else:
            noise[0, 0] = self._parameters.process_variance_cm2 * 1e-4
        self._kalman.predict(F=self._transition, Q=noise)

    def _start(self, time_s: float, measured: Estimate, speed_m_s: float, speed_variance: float) -> Estimate:
        self._time_s = time_s
        self._waiting = None
        kalman = self._kalman
        kalman.x[:, 0] = (measured.range_m, speed_m_s)[: kalman.dim_x]
        kalman.P[:] = 0.0
        kalman.P[0, 0] = measured.variance_m2
        if self._moving:
            kalman.P[1, 1] = speed_variance
        return measured

    def _wait(self, time_s: float, measured: Estimate, gate_sigmas: float) -> Estimate | None:
        """Reject an outlier; accept the second of two successive ones that agree.

        They agree if the speed between them is zero or the vehicle's, within the gate. A step of the ground does not
        change the vehicle's speed, but may have falsified its estimate.
        """
        before, self._waiting = self._waiting, (time_s, measured)
        elapsed_s = 0.0 if before is None else time_s - before[0]
        if before is None or elapsed_s < SOONEST_S:
            return None
        speed_m_s = (measured.range_m - before[1].range_m) / elapsed_s
        noise = (measured.variance_m2 + before[1].variance_m2) / elapsed_s**2
        slack_m_s = gate_sigmas * math.sqrt(noise + SPEED_CHANGE_STD_M_S**2)
        known_m_s = float(self._kalman.x[1, 0]) if self._moving else 0.0
        if abs(speed_m_s) > slack_m_s and abs(speed_m_s - known_m_s) > slack_m_s:
            return None
        return self._start(time_s, measured, speed_m_s, noise)

    def reset(self) -> None:
        """Restart at the next reading."""
        self._time_s = None
        self._waiting = None
