"""Naming looks at some of very many readings: which ones depends on no period of a context, and it is reported."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap import rules
from msp_lab.gap.naming import AllReadings, NamedModel, name_effects
from msp_lab.gap.runs import dependence, draw_splits, sample
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model
from tests.support.measured import MODEL as FILE
from tests.support.measured import sensor
from tests.support.slow import slow

Array = NDArray[np.float64]
MODEL = Model.of(load_sensor_model(FILE).model_copy(update={"effects": ()}))
RUNS = 8


def flown(n: int, throttle: Array) -> dict[str, Any]:
    run = np.arange(n) * RUNS // n
    return {
        "time_s": 0.1 * np.arange(n),
        "run": np.array([f"run{k}" for k in run]),
        "true_range_cm": np.random.default_rng(n).uniform(60.0, 350.0, n),
        "throttle": throttle,
    }


def named(contexts: dict[str, Any], error_cm: Array) -> NamedModel:
    reading_cm = np.array(sensor().readings((contexts["true_range_cm"] + error_cm).tolist(), 1))
    rng = np.random.default_rng(1)
    return name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)


def names(found: NamedModel) -> set[str]:
    return {each.name for each in found.effects} | {one.name for each in found.effects for one in each.alternatives}


def noisy(on: Array) -> NamedModel:
    """Named where the readings scatter more with the rotors on."""
    return named(flown(on.size, on), 4.0 * on * np.random.default_rng(2).standard_normal(on.size))


@pytest.mark.slow
def test_rotors_that_are_on_in_every_second_of_24000_readings_are_found() -> None:
    found = noisy((np.arange(24_000) % 2).astype(float))
    assert "rotor_noise" in names(found)
    assert any("20,000 of 24,000 readings" in each for each in found.messages)


@pytest.mark.slow
def test_an_offset_of_one_of_two_sensors_that_read_in_turn_is_found_in_24000_readings() -> None:
    left = np.arange(24_000) % 2 == 1
    contexts = flown(left.size, np.random.default_rng(3).uniform(0.0, 1.0, left.size))
    found = named({**contexts, "sensor": np.where(left, "left", "right")}, 1.0 * left)
    assert [(each.name, each.of) for each in found.effects] == [("mounting_offset", "left")]
    assert found.effects[0].parameters["offset_cm"].may_be(1.0)
    assert not found.unknown


@pytest.mark.parametrize("period", [3, *slow(2, 7)])
def test_no_period_of_a_context_hides_it(period: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rules, "READINGS", 2000)
    assert "rotor_noise" in names(noisy((np.arange(2000 * period - 400) % period == 1).astype(float)))


def test_a_context_of_few_blocks_has_its_share() -> None:
    on = np.zeros(100_000)
    for first in (7_000, 41_017, 90_400):
        on[first : first + 60] = 1.0
    contexts = flown(on.size, on)
    for seed in range(5):
        rows = sample(contexts, np.arange(on.size), 20_000, np.random.default_rng(seed))
        assert rows.size == 20_000 == np.unique(rows).size
        # Each block and each run has a fifth of its readings in the sample.
        assert on[rows].sum() == pytest.approx(36, abs=3)
        assert np.unique(contexts["run"][rows], return_counts=True)[1].tolist() == pytest.approx([2500] * RUNS, abs=2)


def test_a_sample_keeps_neighbours_of_one_sensor() -> None:
    """Sensors that read in turn, errors that last: the correlation of neighbours is that of all readings."""
    n, rng = 60_000, np.random.default_rng(4)
    error = np.zeros((n // 2, 2))
    for i in range(1, n // 2):
        error[i] = 0.6 * error[i - 1] + 0.8 * rng.standard_normal(2)
    run = np.arange(n) * RUNS // n
    contexts = flown(n, np.zeros(n)) | {"sensor": np.array(["left", "right"] * (n // 2)), "time_s": np.arange(n) // 2.0}
    rows = sample(contexts, np.arange(n), 20_000, rng)
    of_series = 2 * run[rows] + (contexts["sensor"][rows] == "left")
    found = dependence(error.ravel()[rows], of_series, contexts["time_s"][rows])
    assert found.lag_correlation == pytest.approx(0.6 * 0.9, abs=0.03)
