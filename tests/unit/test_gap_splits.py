"""Splits of the runs that are alike, and what sums by run say of a part in place of a fit of it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap import rules
from msp_lab.gap.candidates import SelectedTerm, candidates_of
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.problem import Problem, first_state, reinformed, screened
from msp_lab.gap.refit import JointFit, refit
from msp_lab.gap.runs import draw_splits
from msp_lab.gap.validation import CrossFits, CrossScore, validated
from msp_range.reading_model.rows import Base
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model, make_curve_term
from tests.support.measured import MODEL as FILE
from tests.support.measured import sensor

Array = NDArray[np.float64]
MODEL = Model.of(load_sensor_model(FILE).model_copy(update={"effects": ()}))


def flown(temperature_c: list[float], rows: int = 100) -> dict[str, Any]:
    rng = np.random.default_rng(1)
    run = np.repeat(np.arange(len(temperature_c)), rows)
    return {
        "time_s": 0.1 * np.arange(run.size),
        "run": np.array([f"run{k:02d}" for k in run]),
        "true_range_cm": rng.uniform(60.0, 350.0, run.size),
        "throttle": rng.uniform(0.2, 0.9, run.size),
        "air_temperature_c": np.array(temperature_c)[run],
        "range_rate_cm_s": 60.0 * rng.standard_normal(run.size),
    }


@pytest.mark.parametrize("seed", range(5))
def test_no_part_has_both_of_two_cold_days(seed: int) -> None:
    splits = draw_splits(flown([20.0, 21.0, 2.0, 19.0, 20.0, 2.5, 21.0, 20.0]), np.random.default_rng(seed))
    assert len(splits) == rules.SPLITS
    assert np.all(splits.part[:, 2] != splits.part[:, 5])
    assert all(set(part) == set(range(rules.PARTS)) for part in splits.part.tolist())
    # And the half on which the gap is measured has one of them.
    assert splits.measured[2] != splits.measured[5]
    assert splits.measured.sum() == 4


def test_splits_differ_and_each_run_meets_all_others() -> None:
    splits = draw_splits(flown(np.random.default_rng(3).uniform(0.0, 30.0, 20).tolist()), np.random.default_rng(1))
    same = splits.part[:, :, None] == splits.part[:, None, :]
    assert len({row.tobytes() for row in same}) == len(splits) == rules.SPLITS
    assert np.all(same.sum(axis=2) == 4)
    # Of the 19 others three are in its part, and of its group of five none ever is.
    of_others = same.mean(axis=0)[~np.eye(20, dtype=bool)]
    assert (of_others == 0.0).sum() >= 20 * 4
    assert of_others.mean() == pytest.approx(3 / 19)


def test_readings_of_the_halves_are_about_as_many() -> None:
    contexts = flown([20.0] * 9)
    keep = np.ones(900, dtype=bool)
    keep[contexts["run"] == "run03"] = np.arange(100) < 20
    keep[contexts["run"] == "run08"] = np.arange(100) < 25
    splits = draw_splits({name: column[keep] for name, column in contexts.items()}, np.random.default_rng(1))
    assert 0.4 < splits.held_out.mean() < 0.6


def test_few_runs_are_reported_with_what_they_cost() -> None:
    few = draw_splits(flown([20.0] * 6), np.random.default_rng(1))
    assert len(few) == 5
    (message,) = few.messages
    # Student's t of 4 degrees of freedom at 0.001 is 7.17, and the normal quantile 3.09.
    assert "6 runs are few: what is named is validated in 5 splits of them" in message
    assert "about 2.3 times as large" in message
    assert not draw_splits(flown([20.0] * 8), np.random.default_rng(1)).messages


@pytest.mark.parametrize("runs", [4, 5])
def test_of_few_runs_each_is_left_out_alone(runs: int) -> None:
    splits = draw_splits(flown([20.0] * runs), np.random.default_rng(1))
    (part,) = splits.part
    assert sorted(part.tolist()) == list(range(runs))


def test_sums_by_run_say_what_a_fit_of_a_part_does() -> None:
    contexts = flown(np.random.default_rng(3).uniform(0.0, 30.0, 12).tolist(), rows=200)
    bias_cm = -0.02 * contexts["range_rate_cm_s"]
    reading_cm = np.array(sensor().readings((contexts["true_range_cm"] + bias_cm).tolist(), 5))
    splits = draw_splits(contexts, np.random.default_rng(1))
    problem = Problem.of(MODEL, contexts, reading_cm, splits.unit, np.random.default_rng(1))
    (latency,) = [each for each in problem.candidates if each.effect.name == "latency"]
    unit = problem.unit
    with_it, without_it = problem.refit([latency.at(20.0)], Base()), problem.refit([], Base())

    def readings_of(rows: NDArray[np.bool_]) -> Prepared:
        return Prepared.of(MODEL, {name: column[rows] for name, column in contexts.items()}, reading_cm[rows])

    def of_sums(crossed: CrossFits, split: int, exact: bool) -> tuple[float, float]:
        """Log-likelihood of all runs by the fits without their parts, as they are and with one base for all."""
        ways = crossed.ways(split)
        assert all(crossed.tells(way) for way in ways)
        whole = crossed.recalibrated(ways, [exact] * len(ways), np.ones(12, dtype=bool))
        return float(sum(crossed.score(way, exact).by_run.sum() for way in ways)), whole

    def of_fits(fit: JointFit, split: int) -> float:
        total = 0.0
        for part in range(rules.PARTS):
            left_out = (splits.part[split] == part)[unit]
            own = refit(readings_of(~left_out), fit.effects, fit.base)
            total += float(readings_of(left_out).log_prob(own.base, own.effects).sum())
        return total

    sums, before = CrossFits(problem, splits, with_it), CrossFits(problem, splits, without_it)
    for split in range(3):
        expected = of_fits(with_it, split) - of_fits(without_it, split)
        assert expected > 150.0
        for exact in (False, True):
            gains = np.subtract(of_sums(sums, split, exact), of_sums(before, split, exact))
            assert gains[0] == pytest.approx(expected, abs=3.0)
            # With one base for all parts the effect gains a little more, at most what it gains where all is fitted.
            assert gains[1] == pytest.approx(expected, abs=8.0)
            assert gains[1] < with_it.log_likelihood - without_it.log_likelihood + 3.0


def test_an_offset_of_a_run_is_integrated_out_of_its_score() -> None:
    """Against the integral over the offset, of a quadratic in it and one more number."""
    slope, information = np.array([30.0, -4.0]), np.array([[50.0, 10.0], [10.0, 8.0]])
    score = CrossScore(np.array([-70.0]), np.zeros(2), slope[None], information[None])
    variance_cm2 = 0.3
    offsets = np.linspace(-8.0, 8.0, 16001)

    def marginal(other: float) -> float:
        at = np.stack([offsets, np.full(offsets.size, other)])
        log_p = -70.0 + slope @ at - 0.5 * np.einsum("in,ij,jn->n", at, information, at)
        log_p -= 0.5 * offsets**2 / variance_cm2 + 0.5 * np.log(2.0 * np.pi * variance_cm2)
        return float(np.log(np.exp(log_p + 70.0).sum() * 1e-3) - 70.0)

    found = score.with_offsets(variance_cm2)
    assert found.by_run[0] == pytest.approx(marginal(0.0), abs=1e-6)
    low, middle, high = (marginal(other) for other in (-0.01, 0.0, 0.01))
    assert found.slope[0, 1] == pytest.approx((high - low) / 0.02, rel=1e-4)
    assert found.information[0, 1, 1] == pytest.approx((2.0 * middle - low - high) / 1e-4, rel=1e-3)


def test_offsets_of_runs_do_not_hide_an_effect_inside_them() -> None:
    """Runs that are off by a sigma say the less of an effect the more they scatter; what it does inside them holds."""
    contexts = flown(np.full(12, 20.0).tolist(), rows=200)
    rng = np.random.default_rng(8)
    late_cm = -0.008 * contexts["range_rate_cm_s"]
    off_cm = np.repeat(2.0 * rng.standard_normal(12), 200)
    reading_cm = np.array(sensor().readings((contexts["true_range_cm"] + late_cm + off_cm).tolist(), 5))
    splits = draw_splits(contexts, np.random.default_rng(1))
    problem = Problem.of(MODEL, contexts, reading_cm, splits.unit, np.random.default_rng(1))
    (latency,) = [each for each in problem.candidates if each.effect.name == "latency"]
    state = first_state(problem)
    assert state.by_run
    state = state.having(problem.refit([latency.at(8.0)], state.fit.base), [SelectedTerm(latency.at(8.0), latency)])
    assert validated(problem, state, splits).agreement[latency.key].share == 1.0
    assert not validated(problem, replace(state, by_run=False), splits).agreement


@pytest.mark.parametrize(("runs", "asked"), [(2, 0), (3, 0), (4, 4), (20, 20), (40, 0)])
def test_of_two_runs_nobody_knows_which_one_is_off(runs: int, asked: int) -> None:
    candidates, _ = candidates_of(MODEL, flown([20.0] * runs, rows=3))
    assert sum(each.effect.name == "session_offset" for each in candidates) == asked


def test_of_a_run_that_alone_has_the_cause_a_fit_of_the_others_knows_nothing() -> None:
    contexts = flown([20.0] * 12, rows=200)
    reading_cm = np.array(sensor().readings(contexts["true_range_cm"].tolist(), 5))
    splits = draw_splits(contexts, np.random.default_rng(1))
    problem = Problem.of(MODEL, contexts, reading_cm, splits.unit, np.random.default_rng(1))
    (one_run,) = [each for each in problem.candidates if each.key == ("session_offset", "run03")]
    fit = problem.refit([one_run.at(0.5)], Base())
    offset = CrossFits(problem, splits, fit)
    left_out = np.arange(12) == 3
    assert offset.learnt(left_out, ["0.offset_cm"])[3] < 1e-4
    assert offset.learnt(np.arange(12) == 4, ["0.offset_cm"])[3] == pytest.approx(1.0, abs=0.02)
    # It stays as it is then, whatever the rounding of sums: a part without the run has no opinion of it.
    rounded = replace(fit, slopes=lambda: fit.at._replace(information=fit.at.information * (1.0 + 1e-12)))
    assert CrossFits(problem, splits, rounded).step(~left_out)[-1] == 0.0
    # Of the end of a curve that one run alone reaches as little; of the rest the others know nearly all.
    far = np.where(contexts["run"] == "run03", 500.0, contexts["true_range_cm"])
    contexts = {**contexts, "true_range_cm": far}
    reading_cm = np.array(sensor().readings(far.tolist(), 6))
    problem = Problem.of(MODEL, contexts, reading_cm, splits.unit, np.random.default_rng(1))
    curve = make_curve_term("bias", ("true_range_cm",), ((60.0, 200.0, 350.0, 500.0),), [0.1, 0.0, 0.1, 0.2])
    sums = CrossFits(problem, splits, problem.refit([curve], Base()))
    values = [f"0.value_{k}" for k in range(4)]
    assert sums.learnt(left_out, values)[3] < rules.LEARNT_SHARE
    others = sums.learnt(np.arange(12) == 4, values)
    assert np.all(others > 0.7)


def test_what_is_in_the_model_is_nuisance_for_the_screen() -> None:
    """An effect next to which another one is asked is not asked itself, and the others are, as before."""
    contexts = flown(np.random.default_rng(3).uniform(0.0, 30.0, 12).tolist(), rows=50)
    reading_cm = np.array(sensor().readings(contexts["true_range_cm"].tolist(), 5))
    splits = draw_splits(contexts, np.random.default_rng(1))
    problem = Problem.of(MODEL, contexts, reading_cm, splits.unit, np.random.default_rng(1))
    (j,) = [j for j, each in enumerate(problem.candidates) if each.effect.name == "latency"]
    latency = problem.candidates[j]
    first = first_state(problem)
    fit = problem.refit([latency.at(5.0)], Base())
    state = reinformed(problem, first.having(fit, [SelectedTerm(fit.effects[0], latency)]))
    asked = [np.isfinite(screened(problem, each).deviation) for each in (first, state)]
    assert asked[0][j]
    assert not asked[1][j]
    assert np.flatnonzero(asked[0] != asked[1]).tolist() == [j]
