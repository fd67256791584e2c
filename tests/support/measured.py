"""Readings with contexts and runs, drawn by the plain sampler, as tables that the gap workflow reads."""

from pathlib import Path
from typing import Any

import numpy as np

from tests.support.plain_sampler import PlainSensor
from tests.support.slow import slow_but

MODEL = Path(__file__).parents[2] / "configs" / "sensors" / "mb1242.yaml"
ROOT = MODEL.parents[2]
QUICK_SENSORS = [MODEL.with_name(f"{name}.yaml") for name in ("hcsr04", "lidar_lite_v3", "mb1242")]
"""Sound with a driver and without one, and light; the shortest reading is 1, 5 and 20 cm, the longest 4 to 40 m."""
SENSORS = sorted(MODEL.parent.glob("*.yaml"))
"""The files of all shipped sensors."""
EVERY_SENSOR = slow_but(QUICK_SENSORS, SENSORS)
"""Values of a test's parameter: the files of all shipped sensors."""


def sensor(**changes: float) -> PlainSensor:
    """The sensor of mb1242.yaml as the plain sampler has it."""
    usual = {
        "hit": 0.96,
        "short": 0.01,
        "missed": 0.02,
        "random": 0.01,
        "sigma_cm": 1.9445,
        "short_rate_per_m": 0.5,
        "second_share": 0.25,
    }
    return PlainSensor(**(usual | changes))


def readings(n: int, seed: int = 1, runs: int = 10, bias: Any = None, **changes: float) -> dict[str, Any]:
    """A table of n readings in some runs over range and throttle.

    Parameters
    ----------
    n, seed, runs
        How many, of which random seed, in how many runs.
    bias
        Function of the columns: centimetres that are added to the range that is read.
    changes
        Of the sensor.
    """
    rng = np.random.default_rng(seed)
    columns: dict[str, Any] = {
        "time_s": np.arange(n) * 0.1,
        "sensor": np.full(n, "down"),
        "run": np.array([f"flight-{1 + i * runs // n}" for i in range(n)]),
        "true_range_cm": np.round(rng.uniform(40.0, 500.0, n), 1),
        "throttle": np.round(rng.uniform(0.0, 1.0, n), 3),
    }
    heard_cm = columns["true_range_cm"] + (0.0 if bias is None else bias(columns))
    columns["reading_cm"] = np.array(sensor(**changes).readings(heard_cm.tolist(), seed))
    return columns
