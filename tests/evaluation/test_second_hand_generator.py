"""The second generator draws what it says: noise, correlation, outliers, and sizes in its own standard errors."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize, stats

from evaluation.second_hand import generator
from evaluation.second_hand.base import MAXIMUM_CM, SATURATED_CM, Base, draw_base
from evaluation.second_hand.density import base_law, log_probability, normal_score
from evaluation.second_hand.effect import Effect, Kind, law_with
from evaluation.second_hand.flights import TAPE_RANGES, TAPE_STD_CM, draw_bench, draw_flights
from evaluation.second_hand.physics import KNOWN
from evaluation.second_hand.rows import Rows
from evaluation.second_hand.sample import MISSED, RANDOM, SHORT, draw
from evaluation.second_hand.size import NUISANCE, known_from_bench, scores, sizes_of, standard_errors
from evaluation.second_hand.unknown import UNKNOWN

pytestmark = pytest.mark.slow
"""Tests of the tests' own tools."""

BASE = Base(offset_cm=0.4, sigma_cm=1.5, degrees=6.0, correlation=0.6, saturated=0.3)


def rows_at(range_cm: float, count: int, block_rows: int = 500) -> Rows:
    """Rows of a still target in blocks, a ping each 0.1 s."""
    block = np.arange(count) // block_rows
    true = np.full(count, float(range_cm))
    time = np.asarray(0.1 * (np.arange(count) % block_rows), dtype=float)
    return Rows(block, np.zeros(count, dtype=int), block, time, true, lambda delay_s: true)


def of_title(title: str) -> Kind:
    return next(kind for kind in (*KNOWN, *UNKNOWN) if kind.title == title)


def hidden(title: str, seed: int, **numbers: Any) -> tuple[Rows, Base, Effect]:
    """Rows, base and effect as the generator draws them."""
    rng = np.random.default_rng(seed)
    kind = of_title(title)
    base = replace(draw_base(rng, 0.0), **numbers)
    rows = draw_flights(rng, kind.design)
    return rows, base, kind.draw(rng, rows)


def test_noise_is_student_t_of_its_degrees_of_freedom() -> None:
    rows = rows_at(300, 40_000)
    drawn = draw(rows, BASE, base_law(rows, BASE), np.random.default_rng(1))
    noise = (drawn.exact_cm - 300.4) / 1.5
    assert noise.std() == pytest.approx(1.0, abs=0.03)
    # Correlated readings do not change the distribution of each; the fit's own scatter is 0.2 to 0.3 here.
    degrees, _, _ = stats.t.fit(noise[::7], floc=0)
    assert degrees == pytest.approx(6.0, abs=1.0)


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.5, 0.8])
def test_successive_hits_are_correlated_as_asked(correlation: float) -> None:
    base = replace(BASE, correlation=correlation)
    rows = rows_at(300, 40_000)
    drawn = draw(rows, base, base_law(rows, base), np.random.default_rng(2))
    score = normal_score((drawn.exact_cm - 300.4) / 1.5, 6.0)
    inside = rows.block[1:] == rows.block[:-1]
    assert np.corrcoef(score[:-1][inside], score[1:][inside])[0, 1] == pytest.approx(correlation, abs=0.02)
    two = rows.block[2:] == rows.block[:-2]
    assert np.corrcoef(score[:-2][two], score[2:][two])[0, 1] == pytest.approx(correlation**2, abs=0.02)
    assert abs(np.corrcoef(score[:-1][~inside], score[1:][~inside])[0, 1]) < 0.3


def test_correlation_by_elapsed_time_decays_over_a_gap() -> None:
    base = replace(BASE, correlation_time="elapsed", correlation=0.8)
    rows = rows_at(300, 40_000)
    late = replace(rows, time_s=rows.time_s + 0.4 * (np.arange(40_000) % 500 // 2))
    score = normal_score((draw(late, base, base_law(late, base), np.random.default_rng(3)).exact_cm - 300.4) / 1.5, 6.0)
    assert np.corrcoef(score[::2], score[1::2])[0, 1] == pytest.approx(0.8, abs=0.02)
    assert np.corrcoef(score[1:-1:2], score[2::2])[0, 1] == pytest.approx(0.8**5, abs=0.03)


def test_shares_of_outliers_are_those_of_the_base() -> None:
    rows = rows_at(400, 60_000)
    drawn = draw(rows, BASE, base_law(rows, BASE), np.random.default_rng(4))
    share = np.exp(-4) / (1 + 3 * np.exp(-4))
    for kind in (SHORT, MISSED, RANDOM):
        assert np.mean(drawn.kind == kind) == pytest.approx(share, rel=0.12)
    missed = drawn.reading_cm[drawn.kind == MISSED]
    assert set(missed) == {MAXIMUM_CM, SATURATED_CM}
    assert np.mean(missed == SATURATED_CM) == pytest.approx(0.3, abs=0.04)
    assert drawn.reading_cm[drawn.kind == SHORT].max() < 400


def test_bases_have_one_to_eight_percent_of_outliers() -> None:
    for seed in range(200):
        base = draw_base(np.random.default_rng(seed))
        odds = np.exp([base.short, base.missed, base.random]).sum()
        assert 0.009 < odds / (1 + odds) < 0.085
        assert 5 <= base.degrees <= 15
        assert 0 <= base.correlation <= 0.8
        assert 0 <= base.saturated <= 0.5


@pytest.mark.parametrize("title", ["stale", "crosstalk", "coarse_rounding", "cycle_slip"])
def test_probabilities_of_all_readings_sum_to_one(title: str) -> None:
    rows, base, effect = hidden(title, 5, correlation=0.5)
    law = law_with(rows, base, [effect], [0.2])
    drawn = draw(rows, base, law, np.random.default_rng(5))
    total = np.zeros(len(rows))
    for reading in range(20, 766):
        every = drawn._replace(reading_cm=np.full(len(rows), float(reading)))
        total += np.exp(log_probability(rows, base, law, every))
    # A reading of a coarse step next to a limit loses a little of its cell.
    assert np.median(total) == pytest.approx(1.0, abs=1e-9)
    assert np.quantile(np.abs(total - 1), 0.95) < 2e-3


@pytest.mark.parametrize("title", ["latency", "stale", "crosstalk", "place_missed"])
def test_scores_at_the_truth_have_mean_zero_and_the_variance_of_the_information(title: str) -> None:
    rng = np.random.default_rng(6)
    kind = of_title(title)
    base = replace(draw_base(rng, 0.5), wander=0.0)
    rows = draw_flights(rng, kind.design)
    effect = kind.draw(rng, rows)
    law = law_with(rows, base, [effect], [effect.kind.start])
    totals, outer = [], np.zeros((len(NUISANCE) + 1, len(NUISANCE) + 1))
    for seed in range(15):
        drawn = draw(rows, base, law, np.random.default_rng(100 + seed))
        each = scores(rows, base, [effect], [effect.kind.start], drawn)
        totals.append(each.sum(axis=0))
        outer = outer + each.T @ each / 15
    scale = np.sqrt(np.diag(outer))
    assert np.abs(np.mean(totals, axis=0) / scale * np.sqrt(15)).max() < 4.0
    # Of 11 numbers and 15 tables: chi-squared to about 0.1 %.
    assert 0.75 < np.mean(np.std(totals, axis=0, ddof=1) / scale) < 1.3


def test_standard_error_of_an_offset_is_that_of_its_best_estimate() -> None:
    rows, base, effect = hidden("sensor_offset", 7, growth_per_m=0.0)
    size = 0.5
    error = standard_errors(rows, base, [effect], [size], 1)[0]
    law, plain = law_with(rows, base, [effect], [size]), base_law(rows, base)
    side = np.sign(np.abs(law.centre_cm - plain.centre_cm) - 1e-9)
    sign = np.sign((law.centre_cm - plain.centre_cm).sum())
    estimates = []
    for seed in range(60):
        residual = draw(rows, base, law, np.random.default_rng(seed)).reading_cm - plain.centre_cm

        # Student's own weights on what is within 8 sigma: the best estimate of a shift of t noise.
        def shift(values: NDArray[np.float64]) -> float:
            near = values[np.abs(values) < 8 * base.sigma_cm]
            best = optimize.minimize_scalar(
                lambda place: np.log1p((near - place) ** 2 / ((base.degrees - 2) * base.sigma_cm**2)).sum(),
                bounds=(-3, 3),
                method="bounded",
            )
            return float(best.x)

        estimates.append(sign * (shift(residual[side > 0]) - shift(residual[side < 0])))
    assert np.mean(estimates) == pytest.approx(size, abs=4 * error / np.sqrt(60))
    assert np.std(estimates, ddof=1) == pytest.approx(error, rel=0.3)


def test_correlation_costs_information_of_an_offset() -> None:
    rows, base, effect = hidden("sensor_offset", 7)
    free = standard_errors(rows, base, [effect], [0.5], 1)[0]
    correlated = standard_errors(rows, replace(base, correlation=0.8), [effect], [0.5], 1)[0]
    assert 1.5 < correlated / free < 4.0


@pytest.mark.parametrize("kind", ["one:10", "unknown:10", "two:10"])
def test_a_case_is_the_same_every_time(kind: str) -> None:
    made = generator.case(kind, 5)
    again = generator.case(kind, 5)
    assert made.truth == again.truth
    for name, column in made.runs.items():
        np.testing.assert_array_equal(column, again.runs[name])
    assert len(made.truth["effects"]) == generator.COUNTS[kind.partition(":")[0]]


def test_an_effect_has_the_standard_errors_that_were_asked() -> None:
    rng = np.random.default_rng(11)
    kind = of_title("slant_axis")
    base, rows = draw_base(rng, 0.5), draw_flights(rng, kind.design)
    effect = kind.draw(rng, rows)
    sizes = sizes_of(rows, draw_bench(rng, rows), base, [effect], 10.0, 1)
    assert sizes is not None
    # Averaged over other tables than those of the search.
    assert sizes[0] / standard_errors(rows, base, [effect], sizes, 2)[0] == pytest.approx(10.0, rel=0.05)


def test_tables_have_the_form_that_was_asked() -> None:
    for seed in range(12):
        made = generator.case("null:0.5", seed)
        runs, counts = np.unique(made.runs["run"], return_counts=True)
        assert 6 <= len(runs) <= 20
        assert counts.min() >= 100
        assert counts.max() <= 600
        reading = made.runs["reading_cm"][~np.isnan(made.runs["reading_cm"])]
        np.testing.assert_array_equal(reading, np.rint(reading))
        assert len(np.unique(made.bench["true_range_cm"])) == 48
        assert made.truth["effects"] == []


def test_effects_between_runs_come_with_many_runs() -> None:
    for kind in KNOWN:
        rng = np.random.default_rng(9)
        rows = draw_flights(rng, kind.design)
        if kind.between_runs:
            assert rows.run.max() + 1 >= 12, kind.title


def test_a_scale_is_known_from_the_bench_only() -> None:
    rng = np.random.default_rng(10)
    kind = of_title("scale")
    base, rows = draw_base(rng, 0.0), draw_flights(rng, kind.design)
    effect = kind.draw(rng, rows)
    known = known_from_bench(draw_bench(rng, rows), base, [effect], 1)
    assert np.flatnonzero(known).tolist() == [list(NUISANCE).index("scale")]
    assert standard_errors(rows, base, [effect], [0.5], 1)[0] > 100
    bench_error_pct = 100 / np.sqrt(known.max())
    assert bench_error_pct < standard_errors(rows, base, [effect], [0.5], 1, known=known)[0] < 2 * bench_error_pct


def test_a_tape_leaves_the_scale_open() -> None:
    """The table says other ranges than the sensor is at, and a scale is known by a straight line through them."""
    rng = np.random.default_rng(10)
    kind = of_title("scale")
    base, rows = draw_base(rng, 0.0), draw_flights(rng, kind.design)
    bench = draw_bench(rng, rows, tape=True)
    error_cm = bench.columns(bench.true_cm, "bench{}")["true_range_cm"] - bench.true_cm
    placed, first = np.unique(bench.true_cm, return_index=True)
    assert placed.size == TAPE_RANGES
    assert 0.6 < error_cm[first].std() / TAPE_STD_CM < 1.5
    slopes = np.polyfit(placed, TAPE_STD_CM * rng.standard_normal((placed.size, 2000)), 1)[0]
    known = known_from_bench(bench, base, [kind.draw(rng, rows)], 1)
    assert 1.0 / np.sqrt(known.max()) == pytest.approx(slopes.std(), rel=0.1)
    assert generator.case("one:10@tape", 1).truth["base"]["correlation"] == 0.0


def test_vapour_is_at_the_bench_too_and_not_in_its_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Air of 22.5 deg C holds 2.7 % of vapour at most, in which sound is 0.43 % faster."""
    made = {}
    for percent in (0.0, 100.0):
        monkeypatch.setattr(generator, "BENCH_HUMIDITY_PCT", percent)
        made[percent] = generator.case("humid:10", 2)
    (effect,) = made[0.0].truth["effects"]
    assert effect["title"] == "humidity"
    dry, humid = (each.bench for each in made.values())
    assert "humidity_pct" not in dry
    nearer = np.nanmedian((dry["reading_cm"] - humid["reading_cm"]) / dry["true_range_cm"])
    assert nearer == pytest.approx(0.0043 * effect["size"], rel=0.1)
    np.testing.assert_array_equal(made[0.0].runs["true_range_cm"], made[100.0].runs["true_range_cm"])


def test_last_seeds_are_kept_for_a_final_run() -> None:
    with pytest.raises(generator.SeedError, match="--final"):
        generator.case("null:0", generator.FINAL_SEED)
    assert generator.case("null:0", generator.FINAL_SEED, final=True).truth["seed"] == generator.FINAL_SEED


def test_a_kind_may_say_how_successive_readings_are_correlated() -> None:
    assert generator.case("one:10@0.9", 1).truth["base"]["correlation"] == 0.9
    assert generator.case("null:0.95", 1).truth["base"]["correlation"] == 0.95
    for kind in ("one:10@", "one:10@x", "null:0.5@0.9", "null:", "four:10"):
        with pytest.raises(ValueError, match="expected null:R"):
            generator.case(kind, 1)
