"""Evidence where runs share an offset: inside runs it counts whole, between runs by the number of runs."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import multivariate_normal, norm
from scipy.stats import t as student

from msp_lab.gap import rules
from msp_lab.gap.evidence import between_share, evidence_nats, lead_nats, of_one_run, offsets_of, wander_inflation
from msp_lab.gap.refit import JointFit
from msp_lab.gap.run_offsets import p_beyond_wander

RUNS, ROWS = 8, 100
UNIT = np.repeat(np.arange(RUNS), ROWS)


def fit(residual: np.ndarray) -> JointFit:
    """Of normal readings, with their spread fitted: log-likelihood, and slopes by an offset."""
    variance = float((residual**2).mean())
    log_likelihood = -0.5 * residual.size * (np.log(variance) + 1.0)
    log_p = -0.5 * (np.log(variance) + residual**2 / variance)
    slope = residual / variance
    here = SimpleNamespace(log_p=log_p, rows=SimpleNamespace(centre_cm=-residual), own_centre=slope)
    made: Any = SimpleNamespace(log_likelihood=log_likelihood, offset_slope=slope, here=here)
    return cast(JointFit, made)


def noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(RUNS * ROWS)


def test_integrated_offsets_are_those_of_the_normal_theory() -> None:
    """Against the density of the whole vector, whose covariance has blocks of the variance between runs."""
    residual = noise(1)[: 4 * 50] + 0.8 * np.repeat(np.random.default_rng(2).standard_normal(4), 50)
    unit = np.repeat(np.arange(4), 50)
    same = (unit[:, None] == unit).astype(float)

    def density(within: float, between: float) -> float:
        return float(multivariate_normal(np.zeros(200), within * np.eye(200) + between * same).logpdf(residual))

    best = minimize(lambda at: -density(*np.exp(at)), np.zeros(2), method="Nelder-Mead")
    alone = density(float((residual**2).mean()), 0.0)
    assert offsets_of(fit(residual), unit).nats == pytest.approx(-best.fun - alone, abs=0.02)
    assert offsets_of(fit(noise(1)), UNIT).nats < 1.0


def test_a_gain_inside_runs_counts_whole_whatever_the_runs_share() -> None:
    inside = 0.4 * np.tile(np.sin(np.arange(ROWS)), RUNS)
    offset = np.repeat(2.0 * np.random.default_rng(3).standard_normal(RUNS), ROWS)
    larger, smaller = fit(noise(4) + offset), fit(noise(4) + offset + inside)
    assert between_share(smaller, larger, UNIT) < 0.05
    plain = larger.log_likelihood - smaller.log_likelihood
    assert evidence_nats(smaller, larger, None) == pytest.approx(plain)
    assert evidence_nats(smaller, larger, UNIT) > plain


def test_a_gain_between_runs_counts_by_the_runs() -> None:
    """It halves offsets that runs have anyway: thousands of readings, and eight numbers."""
    offset = np.repeat(2.0 * np.random.default_rng(5).standard_normal(RUNS), ROWS)
    smaller, larger = fit(noise(6) + offset), fit(noise(6) + 0.5 * offset)
    assert between_share(smaller, larger, UNIT) == pytest.approx(1.0)
    assert larger.log_likelihood - smaller.log_likelihood > 200.0
    assert 0.0 < evidence_nats(smaller, larger, UNIT) < 6.0


def test_what_differs_between_runs_alone_gains_nothing_inside_them() -> None:
    """A refit of the spread along with it is no evidence: of ten runs one of two groups is always a little higher."""
    offset = np.repeat(np.array([-0.6, -0.8, -0.2, 0.1, 0.1, 0.2, 0.3, 0.5]), ROWS)
    group = np.repeat(np.where(np.arange(RUNS) < 2, -0.7, 1.0 / 6.0), ROWS)
    smaller, larger = fit(noise(6) + offset), fit(noise(6) + offset - group)
    before, after = ((noise(6) + each).reshape(RUNS, ROWS).mean(axis=1) for each in (offset, offset - group))
    t = float(np.sqrt((RUNS - 2) * ((before**2).sum() / (after**2).sum() - 1.0)))
    expected = 0.5 * norm.isf(student.sf(t, RUNS - 2)) ** 2
    assert larger.log_likelihood - smaller.log_likelihood > 40.0
    assert evidence_nats(smaller, larger, UNIT) == pytest.approx(expected, abs=0.6)


def test_a_scatter_over_runs_is_known_from_those_that_the_gain_is_about() -> None:
    """Of forty runs two are moved, by what runs differ by: two say nothing of how that scatters."""
    rng = np.random.default_rng(12)
    unit = np.repeat(np.arange(40), ROWS)
    offset = 0.5 * rng.standard_normal(40)
    offset[:2] = -1.1
    moved = np.where(np.arange(40) < 2, -1.1, 0.0)
    readings = rng.standard_normal(unit.size)
    smaller, larger = fit(readings + offset[unit]), fit(readings + (offset - moved)[unit])
    t = float(np.sqrt(38.0) * np.sqrt((moved**2).sum() / ((offset - moved) ** 2).sum()))
    expected = 0.5 * norm.isf(student.sf(t, 38)) ** 2
    assert evidence_nats(smaller, larger, unit) == pytest.approx(expected, abs=0.8)


def test_of_two_fits_that_differ_in_some_runs_only_neither_leads_by_much() -> None:
    offset = np.repeat(np.where(np.arange(RUNS) % 2, 0.5, -0.5) * (1.0 + 0.2 * np.arange(RUNS)), ROWS)
    one, other = fit(noise(6) + np.maximum(offset, 0.0)), fit(noise(6) + np.minimum(offset, 0.0))
    plain = one.log_likelihood - other.log_likelihood
    assert abs(plain) > 20.0
    assert lead_nats(one, other, None) == pytest.approx(plain)
    assert abs(lead_nats(one, other, UNIT)) < 2.0
    assert lead_nats(one, other, UNIT) == pytest.approx(-lead_nats(other, one, UNIT))
    # And one that is better in every reading leads by what it is better.
    better, worse = fit(noise(6)), fit(noise(6) + 0.4 * np.tile(np.sin(np.arange(ROWS)), RUNS))
    assert lead_nats(better, worse, UNIT) > 5.0


def test_what_explains_all_that_runs_differ_by_has_large_evidence() -> None:
    offset = np.repeat(2.0 * np.random.default_rng(7).standard_normal(RUNS), ROWS)
    assert evidence_nats(fit(noise(8) + offset), fit(noise(8)), UNIT) > 10.0


def test_a_gain_that_follows_a_wander_counts_for_less_and_a_fast_one_does_not() -> None:
    wander = np.concatenate([np.repeat(np.random.default_rng(run).standard_normal(5), 20) for run in range(RUNS)])
    slow = np.tile(np.sin(2.0 * np.pi * np.arange(ROWS) / ROWS), RUNS)
    fast = np.tile(np.sin(np.arange(ROWS)), RUNS)
    readings = noise(9) + wander
    assert wander_inflation(fit(noise(9) + 0.2 * slow), fit(noise(9)), UNIT) == 1.0
    of_slow, of_fast = (wander_inflation(fit(readings + 0.2 * each), fit(readings), UNIT) for each in (slow, fast))
    assert of_slow > 5.0
    assert of_fast < 3.0


def test_inside_runs_a_gain_that_follows_a_wander_counts_by_the_blocks() -> None:
    wander = np.concatenate([np.repeat(np.random.default_rng(run).standard_normal(5), 20) for run in range(RUNS)])
    slow = 0.4 * np.tile(np.sin(2.0 * np.pi * np.arange(ROWS) / ROWS), RUNS)
    smaller, larger = fit(noise(9) + wander + slow), fit(noise(9) + wander)
    plain = larger.log_likelihood - smaller.log_likelihood
    inflation = wander_inflation(smaller, larger, UNIT)
    assert plain > 20.0
    assert inflation > 5.0
    assert evidence_nats(smaller, larger, UNIT) == pytest.approx(plain / inflation, rel=0.1)


def test_a_gain_over_blocks_of_one_run_counts_at_least_by_its_own_scatter() -> None:
    """A drift through forty blocks with offsets of their own: normal offsets could be the drift as well."""
    rng = np.random.default_rng(4)
    unit = np.repeat(np.arange(40), 20)
    readings = rng.standard_normal(800) + np.repeat(rng.standard_normal(40), 20)
    drift = 1.8 * (np.linspace(0.0, 1.0, 800) - 0.5)
    smaller, larger = fit(readings + drift), fit(readings)
    gain = larger.here.log_p - smaller.here.log_p
    plain, gain = gain.sum(), gain - gain.mean()
    variance = (np.bincount(unit, gain) ** 2).sum() / (gain**2).sum()
    held = np.bincount(unit, gain**2)
    p_value = student.sf(np.sqrt(2.0 * plain / variance), held.sum() ** 2 / (held**2).sum() - 2.0)
    by_scatter = 0.5 * norm.isf(p_value) ** 2
    by_offsets = plain + offsets_of(larger, unit).nats - offsets_of(smaller, unit).nats
    assert by_scatter > by_offsets
    assert evidence_nats(smaller, larger, unit) == pytest.approx(by_scatter, rel=1e-6)
    # Blocks of one run are all of them.
    of_blocks = 0.5 * norm.isf(student.sf(np.sqrt(2.0 * plain / variance), 40 - 2)) ** 2
    assert evidence_nats(smaller, larger, unit, of_blocks=True) == pytest.approx(of_blocks, rel=1e-6)
    assert of_blocks > by_scatter + 0.5


@pytest.mark.slow
def test_offsets_of_runs_are_told_from_a_wander_by_the_blocks_inside_runs() -> None:
    """A wander that hardly forgets itself in a run moves the runs' means as offsets do, and blocks of them less."""
    runs, rows = 14, 150
    unit = np.repeat(np.arange(runs), rows)
    p_values: dict[str, list[float]] = {"quick": [], "slow": [], "offset": [], "still": []}
    for seed in range(10):
        rng = np.random.default_rng([seed, 4])
        noise = rng.standard_normal(unit.size)
        p_values["still"].append(p_beyond_wander(noise, unit))
        p_values["offset"].append(p_beyond_wander(noise + 0.7 * rng.standard_normal(runs)[unit], unit))
        for name, readings in (("quick", 15.0), ("slow", 60.0)):
            keeps = np.exp(-1.0 / readings)
            wander = rng.standard_normal((runs, rows))
            wander[:, 1:] *= np.sqrt(1.0 - keeps**2)
            for row in range(1, rows):
                wander[:, row] += keeps * wander[:, row - 1]
            p_values[name].append(p_beyond_wander(noise + 0.7 * wander.ravel(), unit))
    named = {name: np.mean(np.array(found) < rules.WANDER_P) for name, found in p_values.items()}
    assert named == {"quick": 0.0, "slow": 0.0, "offset": 1.0, "still": 0.0}


def test_offsets_of_runs_do_not_hide_by_how_much_one_of_two_names_is_ahead() -> None:
    """One has the right form inside runs, and offsets of the runs hide nothing of that."""
    rng = np.random.default_rng(11)
    slope, along = rng.uniform(-2.0, 2.0, RUNS), np.linspace(-0.5, 0.5, ROWS)
    difference = (slope[:, None] * (along + 0.5)).ravel()
    offset = np.repeat(3.0 * rng.standard_normal(RUNS), ROWS)
    inside = lead_nats(fit(noise(11)), fit(noise(11) + (slope[:, None] * along).ravel()), UNIT)
    assert inside > 5.0
    assert lead_nats(fit(noise(11) + offset), fit(noise(11) + offset + difference), UNIT) == pytest.approx(inside, 0.3)


def test_an_offset_of_one_run_counts_by_what_the_others_scatter() -> None:
    """With runs that differ as slow noise makes them, one of them is always the farthest off."""
    unit = np.repeat(np.arange(12), ROWS)
    alike, apart = (
        np.random.default_rng(1).standard_normal(12 * ROWS) + size * np.repeat(np.resize([1.0, -1.0], 12), ROWS)
        for size in (0.0, 0.2)
    )
    nats = {}
    for name, slope in (("alike", alike), ("apart", apart)):
        made: Any = SimpleNamespace(offset_slope=slope)
        nats[name] = of_one_run(12.0, cast(JointFit, made), unit, unit == 3)
    # Student's t of 14 degrees of freedom: of the ten other runs and of four more by the model.
    expected = 0.5 * norm.isf(student.sf(np.sqrt(24.0), 14)) ** 2
    assert nats["alike"] == pytest.approx(expected, abs=1.5)
    # Where they scatter more than the model says, that they should not is no further run: eleven runs, of variance 5.
    others = np.delete(apart.reshape(12, ROWS), 3, axis=0)
    scatter = float((others.sum(axis=1) ** 2 / (others**2).sum(axis=1)).sum()) / 10
    assert nats["apart"] == pytest.approx(0.5 * norm.isf(student.sf(np.sqrt(24.0 / scatter), 10)) ** 2)
    assert of_one_run(-1.0, cast(JointFit, made), unit, unit == 3) <= 0.0
