"""The efficient-score screen against textbook formulas and brute force."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from msp_lab.gap.candidates import CandidateEffect, candidates_of
from msp_lab.gap.prepared import BASE, Prepared
from msp_lab.gap.screen import Gains, ScoreSums, Screen, information_of, replicate, score_matrix, score_sums, screen
from msp_range.reading_model.rows import Base
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model, applies
from tests.support.measured import MODEL as SENSOR
from tests.support.plain_sampler import PlainSensor

Array = NDArray[np.float64]
MODEL = Model.of(load_sensor_model(SENSOR).model_copy(update={"effects": ()}))
NB = len(BASE)
N = 2000


def flown(seed: int, n: int = N) -> dict[str, NDArray[np.generic]]:
    rng = np.random.default_rng(seed)
    return {
        "true_range_cm": rng.uniform(60.0, 350.0, n),
        "range_rate_cm_s": 60.0 * rng.standard_normal(n),
        "throttle": rng.uniform(0.2, 0.9, n),
        "target": rng.choice(["grass", "asphalt"], n),
    }


TESTED, _ = candidates_of(MODEL, flown(1))
BY_KEY = {(candidate.key[0], candidate.key[1]): candidate for candidate in TESTED}
TWO_SIDED = [BY_KEY["latency", None], BY_KEY["range_scale", None], BY_KEY["bend", None], BY_KEY["missed", None]]


def informed(k: int, seed: int) -> Array:
    """Some information of base and k candidates, all correlated."""
    rng = np.random.default_rng(seed)
    root = np.eye(NB + k) + 0.3 * rng.standard_normal((NB + k, NB + k))
    information: Array = root @ root.T
    return information


def as_promised(asked: NDArray[np.intp]) -> Gains:
    """Gains without a limit."""
    return np.full(asked.size, np.inf), np.zeros(asked.size)


def drawn(information: Array, seed: int, units: int = 40, wider: float = 1.0) -> ScoreSums:
    """Score sums of runs where nothing is missing."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(information * N / units)
    by_unit = wider * rng.standard_normal((units, information.shape[0])) @ root.T
    return ScoreSums(by_unit, information * N, N, as_promised)


def screened(
    of: ScoreSums, information: Array, tested: list[CandidateEffect], by_run: bool = False, accepted: int | None = None
) -> Screen:
    nuisance = np.array([*range(NB), *([] if accepted is None else [NB + accepted])])
    return screen(of, information, tested, nuisance, by_run, 0.05, np.random.default_rng(1))


def efficient_z(of: ScoreSums, information: Array, j: int, nuisance: list[int]) -> float:
    """By the inverse of the whole block: the number's own estimate over its own standard error."""
    block = [*nuisance, NB + j]
    inverse = np.linalg.inv(information[np.ix_(block, block)] * of.rows)
    return float(inverse[-1] @ of.by_unit.sum(axis=0)[block] / np.sqrt(inverse[-1, -1]))


def test_z_is_that_of_the_number_fitted_beside_the_base() -> None:
    information = informed(4, 1)
    of = drawn(information, 2)
    seen = screened(of, information, TWO_SIDED)
    wanted = [efficient_z(of, information, j, list(range(NB))) for j in range(4)]
    assert seen.z == pytest.approx(wanted, rel=1e-6)
    assert seen.gain == pytest.approx(0.5 * np.square(wanted), rel=1e-6)
    assert seen.largest == pytest.approx(np.abs(wanted).max())
    inverse = np.linalg.inv(information[np.ix_([*range(NB), NB], [*range(NB), NB])] * N)
    assert seen.deviation[0] == pytest.approx(np.sqrt(inverse[-1, -1]), rel=1e-6)


def test_what_is_accepted_is_nuisance_to_the_others() -> None:
    information = informed(4, 1)
    of = drawn(information, 2)
    seen = screened(of, information, TWO_SIDED, accepted=1)
    assert seen.z[1] == 0.0
    for j in (0, 2, 3):
        assert seen.z[j] == pytest.approx(efficient_z(of, information, j, [*range(NB), NB + 1]), rel=1e-6)


def test_what_the_base_does_as_well_cannot_be_seen() -> None:
    information = informed(4, 1)
    alike = 0.5 * information[:NB].sum(axis=0)
    information[NB + 2], information[:, NB + 2] = alike, alike
    information[NB + 2, NB + 2] = 0.5 * alike[:NB].sum()
    of = drawn(informed(4, 1), 2)
    by_unit = of.by_unit.copy()
    by_unit[:, NB + 2] = 0.5 * by_unit[:, :NB].sum(axis=1) + 1e-7
    seen = screened(replace(of, by_unit=by_unit, products=information * N), information, TWO_SIDED)
    assert seen.z[2] == 0.0
    assert np.isinf(seen.deviation[2])
    assert np.abs(seen.z[[0, 1, 3]]).min() > 0.0


def test_a_number_that_cannot_be_negative_is_not() -> None:
    one_sided = [BY_KEY["multipath", None], BY_KEY["rotor_noise", None]]
    assert all(candidate.one_sided for candidate in one_sided)
    assert not any(candidate.one_sided for candidate in TWO_SIDED)
    information = np.eye(NB + 2)
    by_unit = np.zeros((40, NB + 2))
    by_unit[:, NB:] = [-8.0, 8.0]
    of = ScoreSums(by_unit, information * N, N, as_promised)
    seen = screened(of, information, one_sided)
    assert seen.z[0] == 0.0
    assert seen.z[1] == pytest.approx(40 * 8.0 / np.sqrt(N))
    # The larger of two numbers that are positive at random in half of all cases.
    assert seen.critical == pytest.approx(float(norm.isf(1.0 - np.sqrt(0.95))), abs=0.1)


def test_the_critical_value_is_that_of_the_largest() -> None:
    seen = screened(drawn(np.eye(NB + 4), 3), np.eye(NB + 4), TWO_SIDED)
    assert seen.critical == pytest.approx(float(norm.isf(0.5 * (1.0 - 0.95**0.25))), abs=0.1)
    # Entries with the same scores count as one.
    alike = np.eye(NB + 4)
    alike[NB:, NB:] = 0.999 + 0.001 * np.eye(4)
    seen = screened(drawn(alike, 3), alike, TWO_SIDED)
    assert seen.critical == pytest.approx(1.96, abs=0.12)


@pytest.mark.parametrize(
    ("by_run", "wider", "of_readings"), [(False, 1.0, 1.0), (True, 1.0, 1.0), (True, 3.0, 1.0), (False, 3.0, 3.0)]
)
def test_p_values_are_even_where_nothing_is_missing(by_run: bool, wider: float, of_readings: float) -> None:
    information = informed(4, 4)
    tested = [BY_KEY["latency", None], BY_KEY["range_scale", None], BY_KEY["bend", None], BY_KEY["bend", None]]
    rejected = []
    for seed in range(150):
        of = drawn(information, seed, 20, wider)
        of = replace(of, products=of_readings**2 * of.products)
        rejected.append(screened(of, information, tested, by_run).p_value < 0.05)
    share = np.mean(rejected)
    # 0.05 give or take three standard errors; by runs it may be less.
    assert share <= 0.105
    if not by_run:
        assert share >= 0.005


def test_runs_that_scatter_more_than_their_readings_count_less() -> None:
    information = informed(4, 1)
    of = drawn(information, 2, 200, 3.0)
    alone, by_run = screened(of, information, TWO_SIDED), screened(of, information, TWO_SIDED, True)
    assert (by_run.deviation / alone.deviation) ** 2 == pytest.approx(np.full(4, 9.0), rel=0.3)
    assert by_run.z == pytest.approx(alone.z / 3.0, rel=0.2)
    # What all runs show is no scatter of theirs, and runs that scatter less are random all the same.
    in_all = of.by_unit + np.append(np.zeros(NB), np.full(4, 30.0))
    shown = screened(replace(of, by_unit=in_all), information, TWO_SIDED, True)
    assert shown.deviation == pytest.approx(by_run.deviation)
    even = screened(drawn(information, 2, 200, 0.3), information, TWO_SIDED, True)
    assert even.deviation == pytest.approx(alone.deviation)


def test_the_p_value_is_of_the_largest_that_is_no_number_of_the_base() -> None:
    def p_value(key: str, other: str, sum_of_scores: float, products: float = 1.0) -> float:
        by_unit = np.zeros((40, NB + 2))
        by_unit[:, NB] = sum_of_scores / 40.0
        of = ScoreSums(by_unit, products * N * np.eye(NB + 2), N, as_promised)
        return screened(of, np.eye(NB + 2), [BY_KEY[key, None], BY_KEY[other, None]]).p_value

    assert p_value("latency", "missed", 1000.0) == 1.0 / 2001.0
    assert p_value("missed", "latency", 1000.0) > 0.5
    # The search for a shape is taken off; what is rare is limited by its gain, and what is not by its own scatter.
    sure = 2.5 * np.sqrt(N)
    assert p_value("clutter", "latency", sure) > 5.0 * p_value("multipath", "latency", sure)
    assert p_value("multipath", "latency", sure, 4.0) == p_value("multipath", "latency", sure)
    assert p_value("latency", "multipath", sure, 4.0) > 5.0 * p_value("latency", "multipath", sure)


def test_runs_of_readings_that_scatter_more_do_not_count_less_for_it() -> None:
    information = informed(4, 1)
    of = drawn(information, 2, 200, 3.0)
    as_they_are = replace(of, products=9.0 * of.products)
    alone, by_run = screened(as_they_are, information, TWO_SIDED), screened(as_they_are, information, TWO_SIDED, True)
    assert (by_run.deviation / alone.deviation) ** 2 == pytest.approx(np.ones(4), abs=0.25)


def test_an_effect_whose_column_is_absent_or_empty_is_not_testable() -> None:
    contexts = flown(1) | {"humidity_pct": np.full(N, np.nan), "air_temperature_c": np.full(N, 20.0)}
    tested, missing = candidates_of(MODEL, contexts)
    columns = dict(missing)
    assert columns["humidity"] == ("humidity_pct",)
    assert columns["stale"] == ("previous_reading_cm",)
    assert not {"humidity", "stale"} & {candidate.key[0] for candidate in tested}
    assert not {"latency", "multipath", "missed_by_target"} & columns.keys()


def test_a_time_of_day_is_nothing_to_record_where_times_are_of_one_day() -> None:
    with_times = flown(1) | {"time_s": np.arange(float(N))}
    without = {name: column for name, column in with_times.items() if name != "time_s"}
    assert "day_cycle" not in dict(candidates_of(MODEL, with_times)[1])
    assert dict(candidates_of(MODEL, without)[1])["day_cycle"] == ("time_of_day_h",)


def test_what_rests_on_a_few_readings_is_worth_what_it_gains() -> None:
    by_unit = np.zeros((40, NB + 4))
    by_unit[:, NB:] = [-8.0, 8.0, -8.0, 8.0]
    information = np.eye(NB + 4)
    of = ScoreSums(by_unit, information * N, N, lambda asked: (np.array([0.125, 2.0]), np.array([-0.1, 0.3])))
    seen = screened(of, information, [BY_KEY["missed", None], BY_KEY["missed_by_target", "grass"], *TWO_SIDED[:2]])
    whole = 40 * 8.0 / np.sqrt(N)
    assert seen.z == pytest.approx([-0.5, 2.0, -whole, whole])
    assert seen.best == pytest.approx([-0.1, 0.3, np.nan, np.nan], nan_ok=True)
    by_unit[:, NB:] += 14.0 * np.array([1.0, -1.0] * 20)[:, None]
    tested = [BY_KEY["missed", None], BY_KEY["missed_by_target", "grass"], *TWO_SIDED[:2]]
    by_run = screened(replace(of, by_unit=by_unit), information, tested, True)
    # The scatter of runs is 14^2 of 50 for each.
    assert by_run.z[:2] == pytest.approx(seen.z[:2] / np.sqrt(14.0**2 / 50.0 * 40 / 39), rel=1e-3)


def plain(contexts: dict[str, NDArray[np.generic]], seed: int) -> Array:
    """Readings of the base by a sampler that shares no code with it."""
    mixture = MODEL.sensor.reading_model
    weights = mixture.weights
    sensor = PlainSensor(
        hit=weights.hit,
        short=weights.short,
        missed=weights.missed,
        random=weights.random,
        sigma_cm=mixture.sigma_cm,
        short_rate_per_m=mixture.short_rate_per_m,
        second_share=mixture.saturated_fraction,
    )
    return np.array(sensor.readings(np.asarray(contexts["true_range_cm"], dtype=float).tolist(), seed))


def profile(contexts: dict[str, NDArray[np.generic]], reading_cm: Array, asked: list[int]) -> Gains:
    base = Base()
    simulated = replicate(MODEL, base, [], contexts, np.random.default_rng(5))
    information = information_of(simulated, base, [], TESTED)
    unit = np.zeros(reading_cm.size, dtype=np.intp)
    prepared = Prepared.of(MODEL, contexts, reading_cm)
    here = prepared.slopes(base, [])
    return score_sums(prepared, base, here, TESTED, unit, information).profile(np.array(asked))


def test_a_search_along_odds_and_shares_finds_their_sign_and_size() -> None:
    contexts = flown(6)
    rng = np.random.default_rng(6)
    reading_cm = plain(contexts, 6)
    grass = np.asarray(contexts["target"]) == "grass"
    lost = grass & (rng.random(N) < 0.15)
    twice = ~lost & (rng.random(N) < 0.1)
    true_cm = np.asarray(contexts["true_range_cm"], dtype=float)
    reading_cm = np.where(lost, 765.0, np.where(twice, np.minimum(np.rint(2.0 * true_cm), 765.0), reading_cm))
    at = {candidate.key: j for j, candidate in enumerate(TESTED)}
    asked = [at["missed_by_target", "grass"], at["missed_by_target", "asphalt"], at["multipath", None]]
    assert all(TESTED[j].is_rare for j in asked)
    assert not TESTED[at["latency", None]].is_rare
    gains, best = profile(contexts, reading_cm, asked)
    # Odds are of grass against asphalt, so the one is as the other with the other sign.
    assert 1.0 <= best[0] <= 4.0
    assert best[1] < 0.0
    assert best[2] == pytest.approx(0.1)
    assert gains[0] > 25.0
    assert gains[2] > 250.0
    nothing, _ = profile(contexts, plain(contexts, 7), asked)
    assert nothing[0] < 7.5


def test_gains_of_rare_candidates_are_those_of_the_model_with_them() -> None:
    contexts = flown(6, 800) | {"previous_reading_cm": np.full(800, 150.0)}
    reading_cm = plain(contexts, 6)
    reading_cm[::9], reading_cm[5::80] = 765.0, 40.0
    tested, _ = candidates_of(MODEL, contexts)
    base = Base(0.3, 0.1, 0.2, 0.3, -0.2, 0.0, 0.0, 0.0)
    prepared = Prepared.of(MODEL, contexts, reading_cm)
    scores = score_matrix(prepared, prepared.slopes(base, []), tested)
    information = scores.T @ scores / 800
    acts = np.any(scores[:, NB:] != 0.0, axis=0).tolist()
    asked = np.array([j for j, each in enumerate(tested) if each.is_rare and not each.is_base and acts[j]], np.intp)
    unit = np.arange(800) % 3
    sums = score_sums(prepared, base, prepared.slopes(base, []), tested, unit, information, prior=0.01)
    prior = np.append(0.01 * np.array(base) * 800 / 3, np.zeros(len(tested)))
    assert sums.by_unit == pytest.approx(np.array([scores[unit == k].sum(axis=0) - prior for k in range(3)]))
    assert sums.products == pytest.approx(scores.T @ scores)
    gains, best = sums.profile(asked)
    here = prepared.log_prob(base, []).sum()
    odds = np.array([0.1, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0])
    for j, gain, number in zip(asked.tolist(), gains, best, strict=True):
        each = tested[j]
        numbers = np.array([1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3])
        mean = 0.0
        if each.odds is not None:
            field = ("log_odds_short", "log_odds_missed", "log_odds_random")[each.odds - 1]
            moved = getattr(each.at(1.0).change(prepared.scene), field)
            template = np.broadcast_to(np.where(applies(prepared.scene, each.at(1.0)), moved, 0.0), 800)
            numbers, mean = np.concatenate([odds, -odds]) / np.abs(template).max(), float(template.mean())
            numbers = numbers[np.abs(numbers) <= each.parameter.high]
        of_model = []
        for value in numbers.tolist():
            there = np.array(base)
            there[1 + (each.odds or 1)] -= value * mean
            of_model.append(prepared.log_prob(Base(*there), [each.at(value)]).sum() - here)
        block = [2, 3, 4, NB + j]
        inverse = np.linalg.inv(information[np.ix_(block, block)])
        # The score next to the odds, over its standard error, and its gain by steps along it.
        efficient = scores[:, block] @ (inverse[-1] / np.sqrt(inverse[-1, -1]))
        towards = np.sign(sums.by_unit[:, block].sum(axis=0) @ inverse[-1])
        change = np.outer([0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6], towards * efficient)
        along = np.where(change > -0.9, np.log1p(np.maximum(change, -0.9)), np.log(0.1) + 10.0 * (change + 0.9))
        wanted = max(0.0, along.sum(axis=1).max(), *of_model)
        assert gain == pytest.approx(wanted, rel=0.01, abs=0.05), each
        if max(of_model) > 0.5:
            assert number == pytest.approx(numbers[int(np.argmax(of_model))]), each


def test_scores_of_faults_and_of_squares_are_slopes() -> None:
    contexts = flown(3) | {"previous_reading_cm": np.full(N, 150.0)}
    reading_cm = plain(contexts, 3)
    reading_cm[:20] = np.mod(np.asarray(contexts["true_range_cm"], dtype=float)[:20].round(), 256.0)
    tested, _ = candidates_of(MODEL, contexts)
    prepared = Prepared.of(MODEL, contexts, reading_cm)
    zero = Base()
    here = prepared.log_prob(zero, [])
    scores = score_matrix(prepared, prepared.slopes(zero, []), tested)
    seen = set()
    for j, candidate in enumerate(tested):
        code = "code" in candidate.effect.channels
        if not code and candidate.parameter.power == 1:
            continue
        step = 1e-4 if code else 0.05 * min(candidate.parameter.high, 1.0)
        there = prepared.log_prob(zero, [candidate.at(candidate.neutral + step)])
        slope = (there - here) / step**candidate.parameter.power
        usual = np.abs(slope) < 20.0
        assert usual.mean() > 0.9
        size = np.abs(slope[usual]).max()
        np.testing.assert_allclose(
            scores[usual, NB + j], slope[usual], atol=0.05 * size + 0.01, err_msg=str((candidate.key, candidate.shape))
        )
        seen.add(candidate.key[0])
    assert {"lost_high_byte", "saturated_byte", "clock_fault", "or_ed_bytes"} <= seen
