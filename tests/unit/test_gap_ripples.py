"""Ripples over range and time are found with their period, and noise that wanders slowly is none."""

from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from msp_lab.gap.conclusion import with_words
from msp_lab.gap.curve_test import ripples
from msp_lab.gap.extended_model import to_sensor
from msp_lab.gap.findings import GapFindings
from msp_lab.gap.naming import AllReadings, name_effects
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.problem import Problem, first_state
from msp_lab.gap.refit import refit
from msp_lab.gap.runs import draw_splits
from msp_lab.gap.search import add_curves
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.yaml_file import ConfigError
from msp_sim.effects.curve import Ripple
from msp_sim.model.model import Model, load_model
from msp_sim.model.sampler import Sampler
from tests.support.curves import with_curve
from tests.support.measured import MODEL as FILE
from tests.support.measured import sensor
from tests.support.slow import slow

Array = NDArray[np.float64]
MODEL = Model.of(load_sensor_model(FILE).model_copy(update={"effects": ()}))
N, RUNS = 2400, 12


def flown(seed: int) -> dict[str, Any]:
    """Twelve runs of 200 readings, up and down a slope."""
    rng = np.random.default_rng(seed)
    run = np.arange(N) * RUNS // N
    time_s = 0.1 * (np.arange(N) % (N // RUNS)) + 0.01 * rng.random(N)
    return {
        "time_s": time_s,
        "run": np.array([f"run{k:02d}" for k in run]),
        "true_range_cm": 200.0 + 140.0 * np.sin(2.0 * np.pi * (time_s / rng.uniform(15.0, 40.0, RUNS)[run] + run / 7)),
        "time_in_run_s": time_s,
    }


def read(contexts: dict[str, Any], seed: int, bias_cm: Array | float) -> Array:
    return np.array(sensor().readings((np.asarray(contexts["true_range_cm"]) + bias_cm).tolist(), seed))


def found(contexts: dict[str, Any], reading_cm: Array) -> list[tuple[str, float, float]]:
    """Variable, period and log probability of each ripple, the likeliest first."""
    forms = ripples(contexts, refit(Prepared.of(MODEL, contexts, reading_cm), []).here)
    return [
        (each.variables[0], ripple.period, each.corrected)
        for each in forms
        for (ripple,) in each.forms
        if isinstance(ripple, Ripple)
    ]


@pytest.mark.parametrize(("column", "period"), [("true_range_cm", 23.1), ("time_in_run_s", 1.7)])
def test_a_ripple_is_found_with_its_period(column: str, period: float) -> None:
    contexts = flown(1)
    wave_cm = 0.6 * np.sin(2.0 * np.pi * contexts[column] / period + 0.4)
    variable, at, log_p = found(contexts, read(contexts, 1, wave_cm))[0]
    assert variable == column
    assert at == pytest.approx(period, rel=0.01)
    assert log_p < np.log(1e-5)


def test_what_is_slower_than_the_slowest_ripple_is_none() -> None:
    contexts = flown(1)
    wave_cm = 0.8 * np.sin(2.0 * np.pi * contexts["true_range_cm"] / 57.0)
    assert min((log_p for _, _, log_p in found(contexts, read(contexts, 1, wave_cm))), default=0.0) > np.log(0.004)


def test_noise_has_a_ripple_no_more_often_than_its_probability_says() -> None:
    rng = np.random.default_rng(1)
    drawn = [cast(Any, SimpleNamespace(own_centre=rng.standard_normal(N), carry=None)) for _ in range(100)]
    likeliest = [ripples(flown(k % 5), here)[0].corrected for k, here in enumerate(drawn)]
    assert np.mean(np.array(likeliest) < np.log(0.1)) < 0.12


def test_noise_that_wanders_slowly_is_no_ripple() -> None:
    likeliest = []
    for seed in range(20):
        contexts = flown(seed)
        rng = np.random.default_rng([seed, 1])
        wander_cm = 0.8 * np.concatenate(
            [
                np.interp(contexts["time_s"][:200], np.arange(0.0, 40.0, 5.0), rng.standard_normal(8))
                for _ in range(RUNS)
            ]
        )
        likeliest.append(found(contexts, read(contexts, seed, wander_cm))[0][2])
    assert min(likeliest) > np.log(0.003)


def lit(n: int, jitter: float) -> dict[str, Any]:
    """Six runs of readings every 50 ms, give or take a share of that, with a lamp on in every second one."""
    rng = np.random.default_rng(7)
    time_s = 0.05 * (np.arange(n) % (n // 6) + jitter * rng.standard_normal(n))
    return {
        "time_s": time_s,
        "run": np.array([f"run{k}" for k in np.arange(n) * 6 // n]),
        "true_range_cm": rng.uniform(60.0, 350.0, n),
        "time_in_run_s": time_s,
        "lamp": (np.arange(n) % 2).astype(float),
    }


def curves_of(contexts: dict[str, Any], reading_cm: Array) -> list[str]:
    unit = np.unique(contexts["run"], return_inverse=True)[1]
    problem = Problem.of(MODEL, contexts, reading_cm, unit, np.random.default_rng(1))
    return [each.label for each in add_curves(problem, first_state(problem), 6.0, 6).terms]


LIT = [(3000, 0.02, 1.0)]
SLOW_LIT = [(3000, 0.02, 3.0), (3000, 0.1, 1.0), *product([3000, 24_000], [0.0], [1.0, 3.0]), (24_000, 0.02, 1.0)]


@pytest.mark.parametrize("words", [False, True])
@pytest.mark.parametrize("drawn", [*LIT, *slow(*SLOW_LIT)])
def test_what_a_column_that_alternates_explains_is_no_ripple(drawn: tuple[int, float, float], words: bool) -> None:
    n, jitter, size_cm = drawn
    contexts = lit(n, jitter)
    reading_cm = read(contexts, 7, size_cm * contexts["lamp"])
    if words:
        contexts["lamp"] = np.where(contexts["lamp"] > 0.0, "on", "off")
    assert curves_of(contexts, reading_cm) == ["bias over lamp"]


def test_a_column_that_alternates_at_exactly_even_times_is_named() -> None:
    contexts = lit(3000, 0.0)
    reading_cm, rng = read(contexts, 7, 3.0 * contexts["lamp"]), np.random.default_rng(1)
    named = name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)
    assert [each.variables for each in named.unknown] == [("lamp",)]
    assert not named.effects


def test_a_ripple_of_which_a_column_explains_less_stays_one() -> None:
    """A lamp that is on while the wave is up has 81 % of its variance."""
    contexts = flown(1)
    wave_cm = 0.8 * np.sin(2.0 * np.pi * contexts["time_in_run_s"] / 1.7)
    contexts["lamp"] = (wave_cm > 0.0).astype(float)
    assert curves_of(contexts, read(contexts, 1, wave_cm))[0] == "ripple of 1.7 over time_in_run_s"


def test_a_ripple_of_two_readings_has_the_amplitude_that_they_show() -> None:
    """Times that are even to 1 % say little of its phase: a fit of 2 cm says no more than half a centimetre of them."""
    contexts = lit(3000, 0.01)
    reading_cm, rng = read(contexts, 7, contexts.pop("lamp")), np.random.default_rng(1)
    (found,) = name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng).unknown
    assert found.formula.startswith("ripple of 0.1 s over time_in_run_s, amplitude ")
    assert float(found.formula.split()[-2]) == pytest.approx(0.5, abs=0.15)


@pytest.mark.slow
def test_a_named_ripple_has_its_period_and_amplitude_in_words() -> None:
    contexts = flown(2)
    wave_cm = 1.2 * np.cos(2.0 * np.pi * contexts["true_range_cm"] / 23.1 + 1.0)
    reading_cm, rng = read(contexts, 2, wave_cm), np.random.default_rng(1)
    named = name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)
    assert [(each.channel, each.variables) for each in named.unknown] == [("bias", ("true_range_cm",))]
    ripple = named.unknown[0]
    assert ripple.formula.startswith("ripple of 23.")
    amplitude_cm = float(ripple.formula.partition("cm over true_range_cm, amplitude ")[2].removesuffix(" cm"))
    assert amplitude_cm == pytest.approx(1.2, abs=0.4)
    words = with_words(GapFindings(None, rows=N, runs=RUNS, unknown=named.unknown)).unknown[0].plain
    assert "with every 23" in words
    assert words.endswith(" cm of true range, in an unknown way")
    # The curve that is drawn has the phase that was hidden.
    at, curve = np.array(ripple.curve).T[:2]
    assert np.corrcoef(curve, np.cos(2.0 * np.pi * at / 23.1 + 1.0))[0, 1] > 0.95


def test_a_ripple_in_a_model_file_flies(tmp_path: Path) -> None:
    model = with_curve(MODEL, "bias", ["true_range_cm"], [Ripple(40.0)], [0.0, 25.0])
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(to_sensor(model).model_dump(mode="json")))
    loaded = load_model(tmp_path / "model.yaml")
    assert loaded.effects[-1].shape == ("bias", ("true_range_cm",), (Ripple(40.0),))
    alone = Sampler(loaded, np.random.default_rng(1))
    for at_cm, expected_cm in ((210.0, 235.0), (230.0, 205.0), (220.0, 220.0)):
        one = np.median([alone.sample_one({"true_range_cm": at_cm}) for _ in range(25)])
        many = np.median(loaded.sample({"true_range_cm": np.full(25, at_cm)}, np.random.default_rng(1)))
        assert [one, many] == pytest.approx([expected_cm, expected_cm], abs=2.0)


def test_a_period_that_is_none_is_refused(tmp_path: Path) -> None:
    model = with_curve(MODEL, "bias", ["true_range_cm"], [Ripple(40.0)], [0.0, 25.0])
    content = to_sensor(model).model_dump(mode="json")
    content["effects"][0]["knots"] = [{"period": -1}]
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(ConfigError, match=r"effects\[0\].knots: .*or a mapping with the 'period' of a ripple"):
        load_model(tmp_path / "model.yaml")
