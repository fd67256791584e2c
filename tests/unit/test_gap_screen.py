"""The efficient-score screen against textbook formulas and brute force."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from msp_lab.gap.candidates import CandidateEffect, candidates_of
from msp_lab.gap.prepared import BASE, Prepared
from msp_lab.gap.screen import ScoreSums, Screen, information_of, replicate, score_matrix, score_sums, screen
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model
from tests.support.measured import MODEL as SENSOR
from tests.support.plain_sampler import PlainSensor

Array = NDArray[np.float64]
MODEL = Model.of(load_sensor_model(SENSOR).model_copy(update={"effects": ()}))
NB = len(BASE)
FREE = np.ones(NB, dtype=bool)
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


def drawn(information: Array, seed: int, units: int = 40, wider: float = 1.0) -> ScoreSums:
    """Score sums of runs where nothing is missing."""
    rng = np.random.default_rng(seed)
    root = np.linalg.cholesky(information * N / units)
    by_unit = wider * rng.standard_normal((units, information.shape[0])) @ root.T
    k = information.shape[0] - NB
    return ScoreSums(by_unit, information * N, np.full(k, np.inf), np.full(k, np.nan), N)


def screened(
    of: ScoreSums, information: Array, tested: list[CandidateEffect], by_run: bool = False, accepted: int | None = None
) -> Screen:
    held = [] if accepted is None else [accepted]
    return screen(of, information, tested, held, FREE, by_run, 0.05, np.random.default_rng(1))


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
    seen = screened(ScoreSums(by_unit, information * N, of.profile, of.best, N), information, TWO_SIDED)
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
    of = ScoreSums(by_unit, information * N, np.full(2, np.inf), np.full(2, np.nan), N)
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


@pytest.mark.parametrize(("by_run", "wider"), [(False, 1.0), (True, 1.0), (True, 3.0)])
def test_p_values_are_even_where_nothing_is_missing(by_run: bool, wider: float) -> None:
    information = informed(4, 4)
    rejected = np.mean(
        [
            screened(drawn(information, seed, 20, wider), information, TWO_SIDED, by_run).p_value < 0.05
            for seed in range(150)
        ]
    )
    # 0.05 give or take three standard errors; by runs it may be less.
    assert rejected <= 0.105
    if not by_run:
        assert rejected >= 0.005


def test_runs_that_scatter_more_than_their_readings_count_less() -> None:
    information = informed(4, 1)
    of = drawn(information, 2, 200, 3.0)
    alone, by_run = screened(of, information, TWO_SIDED), screened(of, information, TWO_SIDED, True)
    assert (by_run.deviation / alone.deviation) ** 2 == pytest.approx(np.full(4, 9.0), rel=0.3)
    assert by_run.z == pytest.approx(alone.z / 3.0, rel=0.2)


def test_runs_of_readings_that_scatter_more_do_not_count_less_for_it() -> None:
    information = informed(4, 1)
    of = drawn(information, 2, 200, 3.0)
    as_they_are = ScoreSums(of.by_unit, 9.0 * of.products, of.profile, of.best, N)
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


def test_what_rests_on_a_few_readings_is_worth_what_it_gains() -> None:
    by_unit = np.zeros((40, NB + 4))
    by_unit[:, NB:] = [-8.0, 8.0, -8.0, 8.0]
    information = np.eye(NB + 4)
    of = ScoreSums(by_unit, information * N, np.array([0.25, 4.0, np.inf, np.inf]), np.full(4, np.nan), N)
    seen = screened(of, information, TWO_SIDED)
    whole = 40 * 8.0 / np.sqrt(N)
    assert seen.z == pytest.approx([-0.5, 2.0, -whole, whole])


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


def profile(contexts: dict[str, NDArray[np.generic]], reading_cm: Array) -> ScoreSums:
    base = np.zeros(NB)
    simulated = replicate(MODEL, base, [], contexts, np.random.default_rng(5))
    information = information_of(simulated, base, [], TESTED)
    unit = np.zeros(reading_cm.size, dtype=np.intp)
    return score_sums(MODEL, base, [], TESTED, contexts, reading_cm, unit, information)


def test_a_search_along_odds_and_shares_finds_their_sign_and_size() -> None:
    contexts = flown(6)
    rng = np.random.default_rng(6)
    reading_cm = plain(contexts, 6)
    grass = np.asarray(contexts["target"]) == "grass"
    lost = grass & (rng.random(N) < 0.15)
    twice = ~lost & (rng.random(N) < 0.1)
    true_cm = np.asarray(contexts["true_range_cm"], dtype=float)
    reading_cm = np.where(lost, 765.0, np.where(twice, np.minimum(np.rint(2.0 * true_cm), 765.0), reading_cm))
    found = profile(contexts, reading_cm)
    at = {candidate.key: j for j, candidate in enumerate(TESTED)}
    grass_at, asphalt_at = at["missed_by_target", "grass"], at["missed_by_target", "asphalt"]
    # Odds are of grass against asphalt, so the one is as the other with the other sign.
    assert 1.0 <= found.best[grass_at] <= 4.0
    assert found.best[asphalt_at] < 0.0
    assert found.best[at["multipath", None]] == pytest.approx(0.1)
    assert found.profile[grass_at] > 50.0
    assert found.profile[at["multipath", None]] > 500.0
    assert np.isinf(found.profile[at["latency", None]])
    nothing = profile(contexts, plain(contexts, 7))
    assert nothing.profile[grass_at] < 15.0


def test_scores_of_faults_and_of_squares_are_slopes() -> None:
    contexts = flown(3) | {"previous_reading_cm": np.full(N, 150.0)}
    reading_cm = plain(contexts, 3)
    reading_cm[:20] = np.mod(np.asarray(contexts["true_range_cm"], dtype=float)[:20].round(), 256.0)
    tested, _ = candidates_of(MODEL, contexts)
    prepared = Prepared.of(MODEL, contexts, reading_cm)
    zero = np.zeros(NB)
    here = prepared.log_prob(zero, [])
    scores = score_matrix(prepared, zero, [], tested)
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
