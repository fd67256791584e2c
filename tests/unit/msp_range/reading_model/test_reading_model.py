"""The base mixture: what it samples is what it scores, and both are the report's equations as corrected."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.stats import chisquare, norm

from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import MixtureParameters, SensorModel, Weights, load_sensor_model
from tests.support.shipped import MB1242

CODES = np.arange(20, 766)
RANGES_CM = [-3.0, 18.7, 20.0, 20.4, 21.3, 57.2, 254.6, 300.0, 762.9, 764.6, 765.0, 768.0, 900.0, math.inf, math.nan]


def model(
    hit: float = 1.0, short: float = 0.0, missed: float = 0.0, random: float = 0.0, **parameters: float
) -> ReadingModel:
    """Reading model with an MB1242's limits."""
    usual = {"sigma_cm": 1.9, "short_rate_per_m": 0.7, "saturated_fraction": 0.0}
    shares = Weights(hit=hit, short=short, missed=missed, random=random)
    mixture = MixtureParameters.model_validate({"weights": shares} | usual | parameters)
    return ReadingModel(mixture, minimum_cm=20, maximum_cm=765)


ROUGH = model(0.45, 0.25, 0.15, 0.15, saturated_fraction=0.3)
GROWING = model(0.45, 0.25, 0.15, 0.15, saturated_fraction=0.3, sigma_growth_cm_per_m=1.2, missed_growth_per_m=0.4)


def probabilities(of: ReadingModel, true_range_cm: float) -> NDArray[np.float64]:
    """Probability of each code."""
    return np.exp(of.log_prob(CODES, {"true_range_cm": np.full(CODES.size, true_range_cm)}))


def p_value(readings_cm: NDArray[np.float64], expected: NDArray[np.float64]) -> float:
    """Chi-square of readings against probabilities, neighbouring codes pooled until 20 readings are expected."""
    observed = np.bincount(readings_cm.astype(int) - 20, minlength=CODES.size)
    assert observed.size == CODES.size
    assert observed[expected == 0.0].sum() == 0
    counts = expected * readings_cm.size
    group = np.floor(np.cumsum(counts) / 20.0).astype(int)
    # Each group that is jumped over is empty; the last one may hold less than the rest and joins the one before it.
    group = np.unique(group, return_inverse=True)[1]
    group[group == group.max()] = max(group.max() - 1, 0)
    sums = np.bincount(group, observed), np.bincount(group, counts)
    return float(chisquare(*sums).pvalue) if sums[0].size > 1 else 1.0


weights = st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4).filter(lambda w: sum(w) > 0.01)


@given(
    weights=weights,
    parameters=st.fixed_dictionaries(
        {
            "sigma_cm": st.floats(0.01, 100.0),
            "short_rate_per_m": st.floats(0.001, 1000.0),
            "saturated_fraction": st.floats(0.0, 1.0),
            "sigma_growth_cm_per_m": st.floats(0.0, 100.0),
            "missed_growth_per_m": st.floats(-100.0, 100.0),
        }
    ),
    true_range_cm=st.one_of(st.floats(-100.0, 2000.0), st.sampled_from(RANGES_CM)),
)
def test_the_probabilities_of_all_codes_sum_to_one(
    weights: list[float], parameters: dict[str, float], true_range_cm: float
) -> None:
    of = model(*(weight / sum(weights) for weight in weights), **parameters)
    # A weight next to 0 that grows to the odds of 1 leaves eight digits.
    assert probabilities(of, true_range_cm).sum() == pytest.approx(1.0, abs=1e-7)


def test_hits_beyond_the_maximum_count_once_where_every_such_code_is_garbled() -> None:
    assert probabilities(model(1.0, 0.0, 0.0, 0.0, sigma_cm=29.0, saturated_fraction=1.0), 740.0).sum() == (
        pytest.approx(1.0, abs=1e-9)
    )


@pytest.mark.parametrize(
    "of", [ROUGH, GROWING, ReadingModel.of(load_sensor_model(MB1242))], ids=["rough", "growing", "mb1242.yaml"]
)
@pytest.mark.parametrize("true_range_cm", RANGES_CM)
def test_samples_follow_log_prob(of: ReadingModel, true_range_cm: float) -> None:
    readings_cm = of.sample({"true_range_cm": np.full(200_000, true_range_cm)}, np.random.default_rng(20))
    assert p_value(readings_cm, probabilities(of, true_range_cm)) > 1e-3


def test_random_samples_reach_both_ends() -> None:
    noise, rng = model(hit=0.0, random=1.0), np.random.default_rng(23)
    readings_cm = noise.sample({"true_range_cm": np.full(100_000, 300.0)}, rng)
    # 134 of each are expected, to 12 (one standard deviation).
    assert (readings_cm == 20).sum() == pytest.approx(134, abs=60)
    assert (readings_cm == 765).sum() == pytest.approx(134, abs=60)


def test_mixed_contexts_are_each_their_own() -> None:
    true_range_cm = np.tile(RANGES_CM, 20_000)
    readings_cm = ROUGH.sample({"true_range_cm": true_range_cm}, np.random.default_rng(22))
    for i, range_cm in enumerate(RANGES_CM):
        assert p_value(readings_cm[i :: len(RANGES_CM)], probabilities(ROUGH, range_cm)) > 1e-3
    together = ROUGH.log_prob(readings_cm[:300], {"true_range_cm": true_range_cm[:300]})
    alone = [ROUGH.log_prob(readings_cm[[i]], {"true_range_cm": true_range_cm[[i]]})[0] for i in range(300)]
    assert together == pytest.approx(alone, rel=1e-12)


def test_spread_and_missed_echoes_grow_with_range() -> None:
    at_500 = probabilities(model(sigma_cm=1.5, sigma_growth_cm_per_m=0.4), 500.0)
    # sqrt(1.5^2 + (0.4 * 5)^2) = 2.5
    assert at_500[503 - 20] == pytest.approx(norm.cdf(1.4) - norm.cdf(1.0), rel=1e-9)
    missing = model(0.5, 0.1, 0.2, 0.2, missed_growth_per_m=0.5)
    assert missing.shares(300.0)[2] == pytest.approx(0.2, rel=1e-12)
    # Odds of 1 : 4 at 3 m, times e at 5 m.
    share = 0.25 * math.e / (1.0 + 0.25 * math.e)
    p = probabilities(missing, 500.0)
    assert p[-1] == pytest.approx(share + (1.0 - share) / 0.8 * 0.2 / 746, rel=1e-9)
    assert p[600 - 20] == pytest.approx((1.0 - share) / 0.8 * 0.2 / 746, rel=1e-9)
    # Nothing heard is as far as the sensor can reach.
    assert missing.shares(math.nan) == missing.shares(2000.0) == missing.shares(765.0)


def test_a_hit_is_the_normal_probability_of_its_centimetre() -> None:
    p = probabilities(model(sigma_cm=1.9), 300.3)
    assert p[300 - 20] == pytest.approx(norm.cdf(300.5, 300.3, 1.9) - norm.cdf(299.5, 300.3, 1.9), rel=1e-9)
    assert p[304 - 20] == pytest.approx(norm.cdf(304.5, 300.3, 1.9) - norm.cdf(303.5, 300.3, 1.9), rel=1e-9)


def test_hits_beyond_the_limits_read_the_limits() -> None:
    p = probabilities(model(sigma_cm=2.0), 19.0)
    assert p[0] == pytest.approx(norm.cdf(20.5, 19.0, 2.0), rel=1e-9)
    p = probabilities(model(sigma_cm=2.0), 766.0)
    assert p[-1] == pytest.approx(norm.sf(764.5, 766.0, 2.0), rel=1e-9)


def test_a_hit_far_from_the_truth_keeps_a_finite_score() -> None:
    contexts = {"true_range_cm": np.array([300.0, 300.0])}
    far = model(sigma_cm=1.0).log_prob(np.array([400, 200]), contexts)
    # From 99.5 standard deviations on, the bin's other end does not matter.
    assert far == pytest.approx([norm.logsf(99.5)] * 2, rel=1e-9)


def test_a_short_reading_is_the_exponential_cut_at_the_expected_range() -> None:
    p = probabilities(model(hit=0.0, short=1.0, short_rate_per_m=0.7), 300.3)
    cut = 1.0 - math.exp(-0.007 * 280.3)
    assert p[0] == pytest.approx((1.0 - math.exp(-0.007 * 0.5)) / cut, rel=1e-9)
    assert p[100] == pytest.approx((math.exp(-0.007 * 99.5) - math.exp(-0.007 * 100.5)) / cut, rel=1e-9)
    assert p[280] == pytest.approx((math.exp(-0.007 * 279.5) - math.exp(-0.007 * 280.3)) / cut, rel=1e-9)
    assert p[281:].sum() == 0.0


@pytest.mark.parametrize("true_range_cm", [20.0, 12.0])
def test_nothing_reads_short_nearer_than_the_minimum(true_range_cm: float) -> None:
    assert probabilities(model(hit=0.0, short=1.0), true_range_cm)[0] == 1.0


def test_random_readings_are_alike_and_missed_echoes_are_a_code() -> None:
    p = probabilities(model(hit=0.0, missed=0.4, random=0.6), 300.0)
    assert p[:-1] == pytest.approx(np.full(745, 0.6 / 746), rel=1e-12)
    assert p[-1] == pytest.approx(0.4 + 0.6 / 746, rel=1e-12)


def test_where_nothing_can_be_heard_hits_read_as_no_echo() -> None:
    p = probabilities(model(0.5, 0.2, 0.2, 0.1, short_rate_per_m=0.7), math.nan)
    cut = 1.0 - math.exp(-0.007 * 745.0)
    last_short = (math.exp(-0.007 * 744.5) - math.exp(-0.007 * 745.0)) / cut
    assert p[-1] == pytest.approx(0.7 + 0.1 / 746 + 0.2 * last_short, rel=1e-12)
    nearer = (math.exp(-0.007 * 99.5) - math.exp(-0.007 * 100.5)) / cut
    assert p[100] == pytest.approx(0.2 * nearer + 0.1 / 746, rel=1e-12)


@pytest.mark.parametrize("true_range_cm", [300.0, 764.0, math.nan])
def test_a_fraction_of_no_echoes_of_every_cause_reads_255(true_range_cm: float) -> None:
    clean = probabilities(model(0.6, 0.1, 0.2, 0.1), true_range_cm)
    saturated = probabilities(model(0.6, 0.1, 0.2, 0.1, saturated_fraction=0.3), true_range_cm)
    assert saturated[-1] == pytest.approx(0.7 * clean[-1], rel=1e-12)
    assert saturated[255 - 20] == pytest.approx(clean[255 - 20] + 0.3 * clean[-1], rel=1e-12)
    others = (CODES != 255) & (CODES != 765)
    assert saturated[others] == pytest.approx(clean[others], rel=1e-12)


def test_what_the_sensor_cannot_report_has_no_probability() -> None:
    readings_cm = [19.0, 766.0, 300.5, math.nan, 33068.0, -20.0]
    log_p = ROUGH.log_prob(readings_cm, {"true_range_cm": np.full(6, 300.0)})
    assert (log_p == -math.inf).all()


def test_log_prob_is_the_same_for_a_scene_moved_by_whole_centimetres() -> None:
    hits = model(sigma_cm=2.3)
    reading_cm, true_range_cm = np.array([200.0, 203.0, 190.0]), np.array([201.2, 199.0, 200.0])
    moved = hits.log_prob(reading_cm + 150.0, {"true_range_cm": true_range_cm + 150.0})
    assert moved == pytest.approx(hits.log_prob(reading_cm, {"true_range_cm": true_range_cm}), rel=1e-9)


def test_the_same_seed_gives_the_same_readings_and_another_gives_others() -> None:
    contexts = {"true_range_cm": np.linspace(10.0, 800.0, 1000)}
    first = ROUGH.sample(contexts, np.random.default_rng(5))
    assert (first == ROUGH.sample(contexts, np.random.default_rng(5))).all()
    assert (first != ROUGH.sample(contexts, np.random.default_rng(6))).any()
    assert ROUGH.sample({"true_range_cm": []}, np.random.default_rng(5)).shape == (0,)


def test_contexts_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ValueError, match=r"found the context columns \['range'\], expected 'true_range_cm'"):
        ROUGH.sample({"range": np.zeros(3)}, np.random.default_rng(5))
    with pytest.raises(ValueError, match=r"found readings of shape \(2,\) and true_range_cm of shape \(3,\)"):
        ROUGH.log_prob([20, 30], {"true_range_cm": np.zeros(3)})
    with pytest.raises(ValueError, match=r"expected one dimension"):
        ROUGH.sample({"true_range_cm": 300.0}, np.random.default_rng(5))


def test_a_model_is_that_of_a_file_its_name_or_what_was_read_of_it() -> None:
    read = ReadingModel.of(load_sensor_model(MB1242))
    assert ReadingModel.of("mb1242") == ReadingModel.of(MB1242) == read


def test_limits_that_are_no_whole_centimetres() -> None:
    """Of a sensor without a driver, whose readings are in a finer step."""
    changes = {"driver": "none", "minimum_cm": 20.5, "maximum_cm": 400.5, "resolution_cm": 0.5}
    sensor = SensorModel.model_validate(load_sensor_model(MB1242).model_dump() | changes | {"heard_on_axis_cm": None})
    model = ReadingModel.of(sensor)
    every_cm = np.arange(20.5, 401.0, 0.5)
    for true_cm in (10.0, 200.0, 399.8):
        shares = np.exp(model.log_prob(every_cm, {"true_range_cm": np.full(every_cm.size, true_cm)}))
        assert shares.sum() == pytest.approx(1.0, abs=1e-9)
    drawn = model.sample({"true_range_cm": np.full(2000, 399.0)}, np.random.default_rng(1))
    assert drawn.max() == 400.5
    assert np.isin(drawn, every_cm).all()


@pytest.mark.parametrize("outside", [2, 40])
def test_readings_out_of_limits_change_nothing_of_the_others(outside: int) -> None:
    codes = np.concatenate([np.full(outside, 3.0), [255.0, 765.0, 20.0, 100.0, np.inf, np.nan]])
    rows = ROUGH.rows(np.full(codes.size, 254.0))
    for part in (type(rows).probability, type(rows).slopes):
        together = rows.of_readings(codes, part)
        alone = [rows.take(np.array([i])).of_readings(codes[i : i + 1], part) for i in range(codes.size)]
        np.testing.assert_array_equal(together, np.hstack(alone))
        assert not together[:, :outside].any()
