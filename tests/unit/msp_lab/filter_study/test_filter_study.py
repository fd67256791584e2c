"""The report's filter study: the nine filters, their statistics, and what explains a table, against plain loops.

The tables to be explained are made here by an implementation that shares no code with the study.
"""

import json
import math
import random
import statistics as plain
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from msp_lab.cli import app
from msp_lab.filter_study.candidates import changepoint, oracle
from msp_lab.filter_study.explain import FilterResult, explain_rows
from msp_lab.filter_study.nine import CAUSAL, CENTRED, Variant, apply, behind_the_gate, over_samples
from msp_lab.filter_study.scenarios import GAUSSIAN, ScenarioRuns, report_readings, truth
from msp_lab.filter_study.statistics import delay_samples, error_statistics
from msp_lab.filter_study.table import REPORT, read_table, report_table
from msp_range.yaml_file import ConfigError
from tests.docs.shown import shown

READINGS = np.random.default_rng(5).normal(300.0, 20.0, (3, 40)).round()


def window_of(reading_cm: list[float], first: int, last: int) -> list[float]:
    return [reading_cm[index] for index in range(first, last + 1) if 0 <= index < len(reading_cm)]


@pytest.mark.parametrize("name", [name for name in CAUSAL if not name.startswith("kalman")])
def test_windowed_filters(name: str) -> None:
    statistic = plain.fmean if name.startswith("moving") else plain.median
    variant = CAUSAL[name]
    half = variant.window // 2
    for row, causal, centred in zip(READINGS, apply(variant, READINGS), apply(CENTRED[name], READINGS), strict=True):
        values = row.tolist()
        for index, value in enumerate(values):
            assert causal[index] == pytest.approx(statistic(window_of(values, index - variant.window + 1, index)))
            whole = half <= index < len(values) - half
            expected = statistic(window_of(values, index - half, index + half)) if whole else value
            assert centred[index] == pytest.approx(expected)


@pytest.mark.parametrize("name", [name for name in CAUSAL if name.startswith("kalman")])
@pytest.mark.parametrize("start_cm", [None, 0.0])
def test_kalman_is_equations_15_to_19(name: str, start_cm: float | None) -> None:
    q = CAUSAL[name].parameter
    estimates = apply(Variant("kalman", q, start_cm=start_cm), READINGS)
    for row, estimate in zip(READINGS, estimates, strict=True):
        x, p = (row[0], 3.7811) if start_cm is None else (start_cm, 3.7811)
        for index, value in enumerate(row):
            if index or start_cm is not None:
                p += q
                gain = p / (p + 3.7811)
                x, p = x + gain * (value - x), (1 - gain) * p
            assert estimate[index] == pytest.approx(x)


def test_delay_and_boundaries() -> None:
    plain_mean = apply(Variant("moving average", 3), READINGS)
    late = apply(Variant("moving average", 3, delay=4), READINGS)
    np.testing.assert_array_equal(late[:, 4:], plain_mean[:, :-4])
    np.testing.assert_array_equal(late[:, :4], READINGS[:, :4])
    early = apply(Variant("moving average", 3, delay=-2), READINGS)
    np.testing.assert_array_equal(early[:, :-2], plain_mean[:, 2:])
    zero = apply(Variant("moving average", 4, boundary="zero"), READINGS)
    assert zero[:, 0] == pytest.approx(READINGS[:, 0] / 4)
    first = apply(Variant("median", 5, boundary="first"), READINGS)
    assert first[:, 1] == pytest.approx(READINGS[:, 0])


def test_filters_behind_the_gate_hold_where_a_reading_is_missing() -> None:
    reading_cm = np.array([[np.nan, 300.0, 306.0, np.nan, 303.0, 300.0]])
    mean = Variant("moving average", 3)
    held = behind_the_gate(lambda cm: apply(mean, cm), reading_cm)[0]
    np.testing.assert_allclose(held, [np.nan, 300.0, 303.0, 303.0, 303.0, 303.0])
    np.testing.assert_allclose(over_samples(mean, reading_cm)[0], [np.nan, 300.0, 303.0, 303.0, 304.5, 301.5])


def test_the_oracle_is_least_squares_of_each_segment() -> None:
    rng = np.random.default_rng(3)
    runs = report_readings(truth("random", 4, rng), rng)
    estimates = oracle(runs)
    for row in range(4):
        for sample in range(0, 200, 7):
            begin = int(np.flatnonzero(runs.segment[row] == runs.segment[row, sample])[0])
            part = runs.reading_cm[row, begin : sample + 1]
            degree = 1 if runs.ramp[row, sample] and part.size > 1 else 0
            line = np.polyfit(np.arange(part.size), part, degree)
            assert estimates[row, sample] == pytest.approx(np.polyval(line, part.size - 1), abs=1e-6)


def test_random_ranges_are_what_the_scenario_says() -> None:
    runs = truth("random", 50, np.random.default_rng(1))
    assert runs.true_cm.min() >= 230.0
    assert runs.true_cm.max() <= 360.0
    for row in range(50):
        lengths = np.bincount(runs.segment[row])
        assert lengths[:-1].min() >= 5
        assert lengths.max() <= 19
        for number in range(1, lengths.size):
            inside = runs.true_cm[row][runs.segment[row] == number]
            slopes = np.diff(inside)
            assert slopes.size == 0 or np.ptp(slopes) < 1e-9
            if not runs.ramp[row][runs.segment[row] == number][0]:
                assert np.ptp(inside) == 0.0
    assert runs.ramp[:, 0].mean() == pytest.approx(0.5, abs=0.2)


def test_statistics_and_delay() -> None:
    error_cm = np.random.default_rng(4).normal(1.0, 3.0, (5, 200))
    rms, p90, median, mean, variance = error_statistics(error_cm)
    for index, row in enumerate(error_cm):
        assert rms[index] == pytest.approx(math.sqrt(plain.fmean(each * each for each in row)))
        assert p90[index] == pytest.approx(np.quantile(row, 0.9))
        assert (median[index], mean[index]) == (pytest.approx(plain.median(row)), pytest.approx(plain.fmean(row)))
        assert variance[index] == pytest.approx(plain.variance(row))
    runs = truth("random", 20, np.random.default_rng(6))
    for delay in (0, 3):
        late = apply(Variant("moving average", 1, delay=delay), runs.true_cm)
        assert delay_samples(late, runs.true_cm) == pytest.approx(delay, abs=0.5)


def test_the_changepoint_filter_beats_the_nine_in_all_scenarios() -> None:
    """A short form of the study; the whole one is `msp-lab filters`."""
    for index, name in enumerate(("fixed", "steps", "random")):
        rng = np.random.default_rng([8, index])
        runs = report_readings(truth(name, 40, rng), rng)
        medians = {key: CENTRED[key] for key in CENTRED if key.startswith("median")}
        nine = [*CAUSAL.values(), *medians.values()]
        best_cm = min(rms(apply(variant, runs.reading_cm), runs) for variant in nine)
        newest_cm = rms(changepoint(runs.reading_cm, GAUSSIAN)[0], runs)
        assert newest_cm < best_cm
        assert newest_cm < 1.25 * rms(oracle(runs), runs)


def rms(estimate_cm: np.ndarray, runs: ScenarioRuns) -> float:
    return float(error_statistics(estimate_cm - runs.true_cm)[0].mean())


# An implementation of the study that shares nothing with the one above: plain lists, `random`, one run.


def a_run(scenario: str, rng: random.Random) -> list[float]:
    if scenario == "fixed":
        return [300.0] * 200
    if scenario == "steps":
        return [level for level in (275.0, 225.0, 350.0, 325.0) for _ in range(50)]
    levels: list[float] = []
    last = 300.0
    while len(levels) < 200:
        count, level = rng.randint(5, 19), rng.uniform(230.0, 360.0)
        ramp = rng.random() < 0.5
        levels += [last + (level - last) * step / count if ramp else level for step in range(count)]
        last = level
    return levels[:200]


def kalman(reading: list[float], q: float, r: float = 3.7811, start: float | None = None) -> list[float]:
    estimate, spread, out = reading[0] if start is None else start, r, []
    for index, value in enumerate(reading):
        if index or start is not None:
            spread += q
            gain = spread / (spread + r)
            estimate += gain * (value - estimate)
            spread *= 1 - gain
        out.append(estimate)
    return out


def trailing(reading: list[float], window: int, statistic: Callable[[list[float]], float]) -> list[float]:
    return [statistic(reading[max(0, index - window + 1) : index + 1]) for index in range(len(reading))]


def delayed(estimate: list[float], reading: list[float], samples: int) -> list[float]:
    return reading[:samples] + estimate[: len(estimate) - samples]


def table_of(filters: dict[str, Callable[[list[float]], list[float]]], seed: int, sign: int = 1) -> str:
    lines = ["scenario,filter,rms,p90,median,mean,variance"]
    for scenario in ("fixed", "steps", "random"):
        rng = random.Random(f"{seed} {scenario}")
        true = a_run(scenario, rng)
        reading = [float(round(value + rng.gauss(0.0, math.sqrt(3.7811)))) for value in true]
        for name, one in filters.items():
            error = [sign * (a - b) for a, b in zip(one(reading), true, strict=True)]
            values = (
                math.sqrt(plain.fmean(each * each for each in error)),
                plain.quantiles(error, n=10, method="inclusive")[-1],
                plain.median(error),
                plain.fmean(error),
                plain.variance(error),
            )
            lines.append(",".join([scenario, name, *(f"{each:.3f}" for each in values)]))
    return "\n".join(lines) + "\n"


def verdicts_of(text: str, folder: Path) -> tuple[bool, dict[str, FilterResult]]:
    path = folder / "table.csv"
    path.write_text(text, encoding="utf-8")
    reverse, verdicts = explain_rows(read_table(path))
    return reverse, {verdict.filter: verdict for verdict in verdicts}


def changes_of(verdict: FilterResult) -> list[tuple[str, object]]:
    assert verdict.changes is not None
    return [(change.kind, change.value) for change in verdict.changes]


def test_a_table_made_as_stated_needs_no_explanation(tmp_path: Path) -> None:
    text = table_of(
        {"kalman 2": lambda x: kalman(x, 1.0), "moving average 11": lambda x: trailing(x, 11, plain.fmean)}, 1
    )
    reverse, verdicts = verdicts_of(text, tmp_path)
    assert not reverse
    assert [verdict.changes for verdict in verdicts.values()] == [(), ()]


def test_a_factor_in_a_variance_is_found(tmp_path: Path) -> None:
    _, verdicts = verdicts_of(table_of({"kalman 2": lambda x: kalman(x, 0.2)}, 2), tmp_path)
    [(kind, value)] = changes_of(verdicts["kalman 2"])
    assert kind == "q_factor"
    assert value == pytest.approx(0.2, rel=0.2)


@pytest.mark.slow
def test_a_causal_median_and_a_start_value_are_found(tmp_path: Path) -> None:
    text = table_of(
        {
            "median 7": lambda x: trailing(x, 7, plain.median),
            "kalman 3": lambda x: kalman(x, 0.01, start=0.0),
        },
        6,
    )
    _, verdicts = verdicts_of(text, tmp_path)
    assert ("centred", False) in changes_of(verdicts["median 7"])
    assert changes_of(verdicts["kalman 3"]) == [("start_cm", 0.0)]


@pytest.mark.slow
def test_a_factor_and_a_delay_together_are_found(tmp_path: Path) -> None:
    text = table_of({"kalman 2": lambda x: delayed(kalman(x, 10.0), x, 4)}, 7)
    _, verdicts = verdicts_of(text, tmp_path)
    found = dict(changes_of(verdicts["kalman 2"]))
    assert found.pop("delay") == 4
    assert found.pop("q_factor") == pytest.approx(10.0, rel=0.4)
    assert not found


@pytest.mark.slow
def test_what_nothing_explains_is_reported_as_unexplained(tmp_path: Path) -> None:
    """Each scenario with another fault."""
    text = table_of({"kalman 2": lambda x: kalman(x, 1.0)}, 8).splitlines()
    other = table_of({"kalman 2": lambda x: [0.5 * value for value in kalman(x, 1.0)]}, 8).splitlines()
    _, verdicts = verdicts_of("\n".join([*text[:2], other[2], text[3]]), tmp_path)
    verdict = verdicts["kalman 2"]
    assert verdict.changes is None
    assert verdict.nearest is not None
    assert verdict.tried > 500
    assert verdict.alone["fixed"] == verdict.alone["random"] == ()
    assert verdict.alone["steps"] is None


@pytest.mark.slow
def test_the_command_explains_the_report_and_draws_its_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        app([*shown("msp-lab filters --out study").split()[1:], "--seeds", "10"])
    assert not ended.value.code
    printed = capsys.readouterr().out
    study = Path("study")
    found = json.loads((study / "filters.json").read_text())
    explained = {each["filter"]: each for each in found["explanations"]}
    assert found["errors_are_truth_less_estimate"] is True
    for name, late in (("moving average 5", 3), ("moving average 11", 6), ("moving average 15", 8)):
        assert [(each["what"], each["value"]) for each in explained[name]["changes"]] == [("delay", late)]
        assert f"{name}: {late} samples late" in printed
    for name in ("kalman 2", "kalman 3"):
        assert [(each["what"], each["value"]) for each in explained[name]["changes"]] == [("q_factor", 10.0)]
    for name in ("median 3", "median 7", "median 11", "kalman 1"):
        assert explained[name]["changes"] == []
        assert f"{name}: within the bands as stated" in printed
    assert explained["kalman 3"]["rows"]["steps"]["gap_before"] > 20
    assert explained["kalman 3"]["rows"]["steps"]["gap_after"] < 4
    for number in range(7, 16):
        assert (study / f"figure_5_{number}.png").stat().st_size > 10_000
    # Its own table of middles has nothing to explain.
    assert len(read_table(study / "table.csv")) == 27


def test_the_report_s_columns_are_put_in_order() -> None:
    """Erratum 7: swapped in tables 5.5 and 5.6, and in the row Kalman 3 of table 5.4."""
    swapped = {key for key, row in report_table().items() if row.swapped}
    assert {key for key in swapped if key[0] == "fixed"} == {("fixed", "kalman 3")}
    assert len(swapped) == 1 + 2 * 9


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found the columns none"),
        ("scenario,filter,rms\n", "expected scenario, filter, rms, p90"),
        (REPORT.replace("0.978", "wide"), "line 2: rms: found 'wide', expected a number"),
        (REPORT.replace("0.978", "nan"), "line 2: rms: found 'nan'"),
        (REPORT.replace("0.978", "-1"), "expected neither below 0"),
        (REPORT.replace("fixed,kalman 1", "fixed,kalman 9"), "found the filter 'kalman 9'"),
        (REPORT.replace("steps,median 3", "stairs,median 3"), "found the scenario 'stairs'"),
        (REPORT.replace("fixed,median 7,", "fixed,median 3,"), "occurs twice"),
        (REPORT.replace(",0.938", ""), "found 6 cells, expected 7"),
        ("scenario,filter,rms,p90,median,mean,variance\n", "contains no rows"),
    ],
)
def test_user_errors_in_a_table_are_reported_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        read_table(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(ConfigError, match="cannot be read"):
        read_table(tmp_path / "none.csv")
