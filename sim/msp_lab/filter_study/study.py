"""The study: every filter in every scenario on the same readings, compared with the changepoint filter.

For a number of seeds it computes RMS errors and delays of all filters and the figures of the changepoint filter. All
filters of a scenario get the same readings. At missing readings the estimates hold, and a sample counts as soon as
every filter has an estimate.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.special import ndtr, ndtri

from msp_lab.filter_study.candidates import changepoint, oracle
from msp_lab.filter_study.nine import CAUSAL, CENTRED, apply, behind_the_gate, over_samples
from msp_lab.filter_study.scenarios import (
    GAUSSIAN,
    INTERVAL_S,
    NAMES,
    OUTLIERS,
    Array,
    ScenarioRuns,
    outlier_readings,
    report_readings,
    truth,
)
from msp_lab.filter_study.statistics import delay_samples, error_statistics
from msp_range.filters.runs import RangeLikelihood, RunHistories

CHANGEPOINT, ORACLE = "changepoint", "oracle"
STEP_CM, NEAR_CM, OUTLIER_CM = 50.0, 10.0, 100.0
"""Height of the steps, the error within which a step counts as followed, and the error of the single outlier [cm]."""
STEPS_PER_SEED = 10
"""Steps up, and as many down, per seed of the study; more narrow the shares that are reported."""


@dataclass(frozen=True)
class FilterComparison:
    """One scenario with one kind of readings."""

    rms_cm: Mapping[str, Array]
    """RMS error of each run, by filter: the nine, those that look ahead as 'centred ...', 'changepoint', 'oracle'; with
    outliers also windows counted in samples instead of readings, as '... in time'."""
    delay: dict[str, float]
    """Mean delay [samples] by filter; NaN where the truth does not change."""
    covered: float
    """Share of samples with an error within 1.96 of its stated standard deviations."""

    def mean(self, name: str) -> float:
        """Mean RMS of one filter [cm]."""
        return float(self.rms_cm[name].mean())

    def best(self, *, centred: bool = False, in_time: bool = False) -> tuple[str, float]:
        """The best of the nine and its mean RMS [cm]; centred: with the medians that look ahead in place of theirs."""
        names = [name for name in CAUSAL if not (centred and name.startswith("median"))]
        if centred:
            names += [f"centred {name}" for name in CENTRED if name.startswith("median")]
        if in_time:
            names = [f"{name} in time" if f"{name} in time" in self.rms_cm else name for name in names]
        return min(((name, self.mean(name)) for name in names), key=lambda each: each[1])


def compare_report_noise(name: str, seeds: int, rng: np.random.Generator) -> FilterComparison:
    """Compare with the report's Gaussian noise, which is the changepoint filter's model too."""
    runs = report_readings(truth(name, seeds, rng), rng)
    estimates = {filter_name: apply(variant, runs.reading_cm) for filter_name, variant in CAUSAL.items()}
    estimates |= {f"centred {filter_name}": apply(variant, runs.reading_cm) for filter_name, variant in CENTRED.items()}
    estimates[CHANGEPOINT], variance_cm2 = changepoint(runs.reading_cm, GAUSSIAN)
    estimates[ORACLE] = oracle(runs)
    return _compared(runs, estimates, variance_cm2)


def compare_with_outliers(name: str, seeds: int, rng: np.random.Generator) -> FilterComparison:
    """Compare with some readings missing, short or random; all filters are behind the same status gate."""
    runs = outlier_readings(truth(name, seeds, rng), rng)
    estimates = {
        filter_name: behind_the_gate(partial(apply, variant), runs.reading_cm)
        for filter_name, variant in CAUSAL.items()
    }
    estimates |= {
        f"{filter_name} in time": over_samples(variant, runs.reading_cm)
        for filter_name, variant in CAUSAL.items()
        if variant.family != "kalman"
    }
    estimates[CHANGEPOINT], variance_cm2 = changepoint(runs.reading_cm, OUTLIERS)
    return _compared(runs, estimates, variance_cm2)


def _compared(runs: ScenarioRuns, estimates: Mapping[str, Array], variance_cm2: Array) -> FilterComparison:
    counts = np.all([~np.isnan(estimate) for estimate in estimates.values()], axis=0)
    errors = {name: np.where(counts, cm - runs.true_cm, np.nan) for name, cm in estimates.items()}
    stated = counts & ~np.isnan(variance_cm2)
    normalised = errors[CHANGEPOINT][stated] ** 2 / variance_cm2[stated]
    return FilterComparison(
        {name: error_statistics(error)[0] for name, error in errors.items()},
        {name: float(delay_samples(cm, runs.true_cm).mean()) for name, cm in estimates.items()},
        float((normalised < 1.96**2).mean()),
    )


@dataclass(frozen=True)
class Response:
    """Response of the changepoint filter to steps and single outliers, with the mixture with outliers as its model."""

    arrived: tuple[float, ...]
    """Share of steps of `STEP_CM` after which the output is within `NEAR_CM` of the new level, after 1 to 4 readings of
    which some are missing or outliers."""
    moved_cm: float
    """Largest movement of the output by one reading with an error of `OUTLIER_CM` [cm]."""


def responses(rng: np.random.Generator, steps: int) -> Response:
    """Return the response to steps and outliers, up and down, after 4 s at one level."""
    before, after = 40, 4
    arrived, moved = [], []
    for sign in (1.0, -1.0):
        runs = truth("fixed", steps, rng)
        true_cm = runs.true_cm[:, : before + after].copy()
        quiet_cm = np.rint(true_cm + rng.normal(0.0, GAUSSIAN.sigma_cm, true_cm.shape))
        quiet_cm[:, before] += sign * OUTLIER_CM
        estimate_cm, _ = changepoint(quiet_cm, OUTLIERS)
        moved.append(np.abs(estimate_cm[:, before] - estimate_cm[:, before - 1]).max())
        true_cm[:, before:] += sign * STEP_CM
        stepping = ScenarioRuns("step", true_cm, runs.segment, runs.ramp, true_cm)
        estimate_cm, _ = changepoint(outlier_readings(stepping, rng).reading_cm, OUTLIERS)
        arrived.append((np.abs(estimate_cm - true_cm)[:, before:] < NEAR_CM).mean(axis=0))
    return Response(tuple(float(each) for each in np.mean(arrived, axis=0)), float(max(moved)))


def innovations(name: str, seeds: int, rng: np.random.Generator) -> Array:
    """Mean of the squared normalised innovations of each run, noise as in the report; 1 for a consistent filter.

    The predictive distribution is a mixture, so an innovation is normalised by what it is under that mixture: the
    normal deviate of its cumulative probability. A run's 199 have a mean within 0.81 and 1.21 in 95 of 100 runs.
    """
    runs = report_readings(truth(name, seeds, rng), rng)
    likelihood = RangeLikelihood.of(GAUSSIAN, 20, 765, 1)
    hypotheses = RunHistories(likelihood, seeds)
    noise_m2 = np.full(seeds, likelihood.variance_m2)
    total = np.zeros(seeds)
    for sample in range(runs.reading_cm.shape[1]):
        reading_m = runs.reading_cm[:, sample] / 100.0
        elapsed_s = np.full(seeds, INTERVAL_S if sample else 0.0)
        if sample:
            total += _innovation(hypotheses, elapsed_s, reading_m, noise_m2) ** 2
        hypotheses.update(elapsed_s, reading_m, noise_m2)
    mean: Array = total / (runs.reading_cm.shape[1] - 1)
    return mean


def _innovation(histories: RunHistories, elapsed_s: Array, reading_m: Array, variance_m2: Array) -> Array:
    """The next reading's normalised innovation before the update, shape (streams,), by a likelihood without outliers.

    The normal quantile of the reading's cumulative probability under the mixture of predictions.
    """
    likelihood = histories.likelihood
    runs, level_change, _ = histories.take(np.arange(reading_m.size)).predict(elapsed_s[:, None])
    below = ndtr((reading_m[:, None] - runs[1]) / np.sqrt(runs[3] + variance_m2[:, None]))
    share = np.clip((reading_m - likelihood.minimum_m) / likelihood.length_m, 0.0, 1.0)
    cumulative = (runs[0] * below).sum(axis=1) + (level_change[:, 0] + histories.unlocated) * share
    return np.asarray(ndtri(np.clip(cumulative, 1e-12, 1.0 - 1e-12)))


@dataclass(frozen=True)
class Study:
    """All results by scenario."""

    report_noise: Mapping[str, FilterComparison]
    outliers: Mapping[str, FilterComparison]
    innovations: Mapping[str, Array]
    response: Response


def run_study(seeds: int, seed: int) -> Study:
    """Run the study; every part has its own random numbers."""
    parts = [np.random.default_rng(sequence) for sequence in np.random.SeedSequence(seed).spawn(3 * len(NAMES) + 1)]
    return Study(
        {name: compare_report_noise(name, seeds, parts[index]) for index, name in enumerate(NAMES)},
        {name: compare_with_outliers(name, seeds, parts[3 + index]) for index, name in enumerate(NAMES)},
        {name: innovations(name, seeds, parts[6 + index]) for index, name in enumerate(NAMES)},
        responses(parts[9], STEPS_PER_SEED * seeds),
    )


def delays(results: Study) -> Mapping[str, Mapping[str, float]]:
    """Delay [samples] by scenario and filter, of the filters as the report states them: its medians look ahead."""
    return {
        name: compared.delay
        | {name: compared.delay[f"centred {name}"] for name in CENTRED if name.startswith("median")}
        for name, compared in results.report_noise.items()
    }
