"""Speed of the reading model: drawing many readings at once, and one at a time as an emulated sensor does."""

import statistics
import time

import numpy as np

from evaluation import CONFIGS
from evaluation.benchmarks.figure import Figures, at_most, figure
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model
from msp_sim.model.sampler import Sampler

READINGS = 1_000_000
REPEATS = 9
SINGLE_READINGS = 20_000
SENSOR = CONFIGS / "sensors" / "mb1242.yaml"


def run() -> Figures:
    """Measure `ReadingModel.sample` against numpy's own draws in the same run, and `Sampler.sample_one`."""
    sensor = load_sensor_model(SENSOR).model_copy(update={"effects": ()})
    model = ReadingModel.of(sensor)
    rng = np.random.default_rng(1)
    true_range_cm = rng.uniform(10.0, 800.0, READINGS)
    true_range_cm[rng.random(READINGS) < 0.02] = np.nan
    contexts = {"true_range_cm": true_range_cm}

    ratios = []
    for _ in range(REPEATS):
        start_s = time.perf_counter()
        rng.standard_normal(READINGS)
        rng.random(READINGS)
        numpy_s = time.perf_counter() - start_s
        start_s = time.perf_counter()
        model.sample(contexts, rng)
        ratios.append((time.perf_counter() - start_s) / numpy_s)
    ratio = statistics.median(ratios)

    sampler, singles_us = Sampler(Model.of(sensor), rng), []
    ranges_cm = [None if np.isnan(range_cm) else float(range_cm) for range_cm in true_range_cm[:SINGLE_READINGS]]
    for _ in range(REPEATS):
        start_s = time.perf_counter()
        for range_cm in ranges_cm:
            sampler.sample_one({"true_range_cm": range_cm})
        singles_us.append(1e6 * (time.perf_counter() - start_s) / SINGLE_READINGS)
    single_us = statistics.median(singles_us)

    return [
        figure("reading_model_sample_over_numpy", ratio, "times one normal and one uniform a reading", at_most(5)),
        figure("reading_model_sample_one", single_us, "us a reading", at_most(10)),
    ]
