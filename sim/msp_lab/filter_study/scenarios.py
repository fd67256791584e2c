"""The report's three scenarios (table 5.3): true ranges of many runs, and readings of them.

With a random generator each makes true ranges, their segments, and readings in centimetres, one row per seed. The
report shows its random ranges without saying how they were made. Segments of 5 to 19 samples, half of them constant at
a new level and half ramps from the last level to a new one, with levels uniform from 230 to 360 cm, look the same.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from msp_range.arrays import Array, Flags
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import MixtureParameters
from msp_sim.world.profiles import SAMPLES_PER_SECTION

SAMPLES = 200
INTERVAL_S = 0.1
"""Time between two samples [s]: 10 Hz for 20 s (5.3.1)."""
FIXED_CM = 300.0
SET_CM = (275.0, 225.0, 350.0, 325.0)
RANDOM_CM = (230.0, 360.0)
NOISE_CM2 = 3.7811
"""Variance of the noise: measured by the report, which also uses it as R (table 5.2) [cm^2]."""
OUTLIER_WEIGHTS = {"hit": 0.90, "short": 0.03, "missed": 0.05, "random": 0.02}
"""Shares of the kinds of reading in the comparison with outliers: more than a bench shows, as in flight."""
SHORT_RATE_PER_M = 0.5
"""Rate of the short readings, as in the model file of the MB1242 [1/m]."""
MINIMUM_CM, MAXIMUM_CM = 20, 765
NAMES = ("fixed", "steps", "random")


@dataclass(frozen=True)
class ScenarioRuns:
    """Runs of one scenario, shape (seeds, samples)."""

    name: str
    """fixed, steps or random."""
    true_cm: Array
    """True range [cm]."""
    segment: NDArray[np.int64]
    """Number of the sample's segment, from 0."""
    ramp: Flags
    """Whether that segment is a ramp."""
    reading_cm: Array
    """Readings [cm], whole numbers; NaN where there was no echo."""


def report_readings(runs: ScenarioRuns, rng: np.random.Generator, variance_cm2: float = NOISE_CM2) -> ScenarioRuns:
    """Return runs with the report's noise: Gaussian, then rounded to whole centimetres."""
    noisy = runs.true_cm + rng.normal(0.0, np.sqrt(variance_cm2), runs.true_cm.shape)
    return replace(runs, reading_cm=np.rint(noisy))


def outlier_readings(runs: ScenarioRuns, rng: np.random.Generator) -> ScenarioRuns:
    """Return runs with the mixture of `OUTLIER_WEIGHTS`; no echo is NaN, as the status gate makes it."""
    model = ReadingModel(OUTLIERS, MINIMUM_CM, MAXIMUM_CM)
    reading_cm = model.sample({"true_range_cm": runs.true_cm.ravel()}, rng).reshape(runs.true_cm.shape)
    return replace(runs, reading_cm=np.where(reading_cm == MAXIMUM_CM, np.nan, reading_cm))


def _parameters(weights: dict[str, float]) -> MixtureParameters:
    return MixtureParameters.model_validate(
        {
            "weights": weights,
            "sigma_cm": NOISE_CM2**0.5,
            "short_rate_per_m": SHORT_RATE_PER_M,
            "saturated_fraction": 0.0,
        }
    )


GAUSSIAN = _parameters({"hit": 1.0, "short": 0.0, "missed": 0.0, "random": 0.0})
"""The reading model of the report's noise."""
OUTLIERS = _parameters(OUTLIER_WEIGHTS)
"""The reading model of `outlier_readings`."""


def truth(name: str, seeds: int, rng: np.random.Generator) -> ScenarioRuns:
    """Return runs of a scenario with the true ranges as readings."""
    shape = (seeds, SAMPLES)
    segment, ramp = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=bool)
    if name == "fixed":
        true_cm = np.full(shape, FIXED_CM)
    elif name == "steps":
        each = SAMPLES // len(SET_CM)
        true_cm = np.tile(np.repeat(SET_CM, each), (seeds, 1))
        segment[:] = np.repeat(np.arange(len(SET_CM)), each)
    elif name == "random":
        true_cm = np.empty(shape)
        for row in range(seeds):
            _random(true_cm[row], segment[row], ramp[row], rng)
    else:
        raise ValueError(f"scenario {name!r}, expected one of {', '.join(NAMES)}")
    return ScenarioRuns(name, true_cm, segment, ramp, true_cm)


def _random(true_cm: Array, segment: NDArray[np.int64], ramp: Flags, rng: np.random.Generator) -> None:
    """Fill one run; a ramp's first sample is at the last level, and its new level is the next segment's last."""
    fewest, most = SAMPLES_PER_SECTION
    start, number, last_cm = 0, 0, FIXED_CM
    while start < true_cm.size:
        length = int(rng.integers(fewest, most, endpoint=True))
        is_ramp, level_cm = rng.random() < 0.5, float(rng.uniform(*RANDOM_CM))
        part = slice(start, min(start + length, true_cm.size))
        share = np.arange(part.stop - part.start) / length
        true_cm[part] = last_cm + (level_cm - last_cm) * share if is_ramp else level_cm
        segment[part], ramp[part] = number, is_ramp
        start, number, last_cm = part.stop, number + 1, level_cm
