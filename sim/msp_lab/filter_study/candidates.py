"""The changepoint filter and the oracle on many runs at once, in centimetres."""

import numpy as np

from msp_lab.filter_study.scenarios import INTERVAL_S, MAXIMUM_CM, MINIMUM_CM, ScenarioRuns
from msp_range.arrays import Array
from msp_range.filters.runs import Posterior, RangeLikelihood, RunHistories
from msp_range.reading_model.sensor_model import MixtureParameters


def changepoint(reading_cm: Array, parameters: MixtureParameters) -> tuple[Array, Array]:
    """Estimates [cm] and variances [cm^2]; NaN before the first; later estimates hold where there is no new one.

    The same class as in the bridge (`msp_range.filters.changepoint`), with one stream per run.
    """
    likelihood = RangeLikelihood.of(parameters, MINIMUM_CM, MAXIMUM_CM, 1)
    runs, samples = reading_cm.shape
    hypotheses = RunHistories(likelihood, runs)
    last = np.full(runs, -1)
    estimate_cm, variance_cm2 = np.full((2, runs, samples), np.nan)
    for sample in range(samples):
        if sample:
            estimate_cm[:, sample] = estimate_cm[:, sample - 1]
        answered = np.flatnonzero(~np.isnan(reading_cm[:, sample]))
        if answered.size == 0:
            continue
        elapsed_s = np.where(last[answered] < 0, 0, sample - last[answered]) * INTERVAL_S
        last[answered] = sample
        some = hypotheses.take(answered)
        noise_m2 = np.full(answered.size, likelihood.variance_m2)
        posterior: Posterior = some.update(elapsed_s, reading_cm[answered, sample] / 100.0, noise_m2)
        hypotheses.put(answered, some)
        converged = answered[posterior.converged]
        estimate_cm[converged, sample] = 100.0 * posterior.range_m[posterior.converged]
        variance_cm2[converged, sample] = 1e4 * posterior.variance_m2[posterior.converged]
    return estimate_cm, variance_cm2


def oracle(runs: ScenarioRuns) -> Array:
    """Least squares from each segment's first reading to the newest, with known segments and ramps [cm]; no reading may
    be missing.

    Closed forms: with k readings so far, numbered j = 1 ... k, the mean of y, or the line's value at j = k,
    (6 sum j y - 2 (k + 1) sum y) / (k (k + 1)).
    """
    reading_cm, samples = runs.reading_cm, runs.reading_cm.shape[1]
    estimate_cm = np.empty_like(reading_cm)
    total, weighted, count = (np.zeros(reading_cm.shape[0]) for _ in range(3))
    for sample in range(samples):
        begins = runs.segment[:, sample] != runs.segment[:, sample - 1] if sample else np.ones(total.shape, dtype=bool)
        total, weighted, count = (np.where(begins, 0.0, each) for each in (total, weighted, count))
        count = count + 1.0
        total = total + reading_cm[:, sample]
        weighted = weighted + count * reading_cm[:, sample]
        line = (6 * weighted - 2 * (count + 1) * total) / (count * (count + 1))
        is_line = runs.ramp[:, sample] & (count > 1)
        estimate_cm[:, sample] = np.where(is_line, line, total / count)
    return estimate_cm
