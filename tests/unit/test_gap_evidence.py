"""Evidence where runs share an offset: inside runs it counts whole, between runs by as many numbers as there are runs."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from msp_lab.gap.evidence import RunOffsets, evidence_nats
from msp_lab.gap.refit import JointFit

RUNS, ROWS = 8, 100
UNIT = np.repeat(np.arange(RUNS), ROWS)


def fit(residual: np.ndarray) -> JointFit:
    """Of readings with unit variance: log-likelihood, and slopes by an offset."""
    by = np.zeros((residual.size, 8))
    by[:, 0] = residual
    made: Any = SimpleNamespace(log_likelihood=float(-0.5 * (residual**2).sum()), here=SimpleNamespace(by=by))
    return cast(JointFit, made)


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(RUNS * ROWS)


def test_integrated_offsets_are_those_of_the_normal_theory() -> None:
    """Of normal means the best deviation is known: that of the means beyond their errors."""
    residual = noise(1) + 0.8 * np.repeat(np.random.default_rng(2).standard_normal(RUNS), ROWS)
    found = RunOffsets.of(fit(residual), UNIT, 1.0)
    means = residual.reshape(RUNS, ROWS).mean(axis=1)
    error2 = 1.0 / ROWS
    tau2 = np.linspace(1e-4, 3.0, 3000)[:, None]
    density = -0.5 * (np.log(tau2 + error2) + means**2 / (tau2 + error2)).sum(axis=1)
    nothing = -0.5 * (np.log(error2) + means**2 / error2).sum()
    assert found.integrated_nats == pytest.approx(float(density.max() - nothing), rel=0.06)
    assert found.integrated_nats < found.free_nats


def test_a_gain_inside_runs_counts_whole_whatever_the_runs_share() -> None:
    inside = 0.4 * np.tile(np.sin(np.arange(ROWS)), RUNS)
    offset = np.repeat(2.0 * np.random.default_rng(3).standard_normal(RUNS), ROWS)
    larger = fit(noise(4) + offset)
    smaller = fit(noise(4) + offset + inside)
    plain = larger.log_likelihood - smaller.log_likelihood
    assert evidence_nats(smaller, larger, None, 1.0) == pytest.approx(plain)
    assert evidence_nats(smaller, larger, UNIT, 1.0) == pytest.approx(plain, rel=0.15)


def test_a_gain_between_runs_counts_by_the_runs() -> None:
    """It halves offsets that runs have anyway: thousands of readings, and eight numbers."""
    offset = np.repeat(2.0 * np.random.default_rng(5).standard_normal(RUNS), ROWS)
    smaller, larger = fit(noise(6) + offset), fit(noise(6) + 0.5 * offset)
    assert larger.log_likelihood - smaller.log_likelihood > 300.0
    assert 0.0 < evidence_nats(smaller, larger, UNIT, 1.0) < 6.0


def test_what_explains_all_that_runs_differ_by_has_large_evidence() -> None:
    offset = np.repeat(2.0 * np.random.default_rng(7).standard_normal(RUNS), ROWS)
    assert evidence_nats(fit(noise(8) + offset), fit(noise(8)), UNIT, 1.0) > 10.0
