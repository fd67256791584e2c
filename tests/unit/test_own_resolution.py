"""Readings are compared in their own step: which one that is, and what is named in such tables."""

from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.characterise.from_files import characterise
from msp_lab.gap.intake import Comparison, Readings, Settings, read_readings
from msp_lab.gap.naming import AllReadings, NamedModel, name_effects
from msp_lab.readings.resolution import compared_step, to_step
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import write_csv
from msp_sim.model.history import History
from msp_sim.model.model import Model
from tests.support.measured import MODEL, readings
from tests.support.plain_sampler import PlainSensor
from tests.support.slow import slow

GIVEN = Model.of(load_sensor_model(MODEL).model_copy(update={"effects": ()}))
Array = NDArray[np.float64]


def step_of_runs(*runs: Array, model_step_cm: float = 1.0) -> float:
    number = np.repeat(np.arange(len(runs)), [each.size for each in runs])
    return compared_step(np.concatenate(runs), number, model_step_cm)


def swept(seed: int) -> Array:
    """Ranges that go up and down once a minute, ten a second, with noise."""
    turn = np.sin(np.linspace(0.0, 20.0, 2000))
    return np.asarray(85.0 + 35.0 * turn + np.random.default_rng(seed).standard_normal(2000))


def test_the_step_of_a_file_is_found() -> None:
    range_cm = swept(1)
    for step_cm in (0.1, 0.2, 0.5, 1.0):
        assert step_of_runs(step_cm * np.rint(range_cm / step_cm)) == step_cm
        # Through 32-bit numbers, in metres.
        metres = (0.01 * step_cm * np.rint(range_cm / step_cm)).astype(np.float32).astype(float)
        assert step_of_runs(100.0 * metres) == step_cm
        # A calibration added a constant, another one to each half.
        assert step_of_runs(*(step_cm * (np.rint(range_cm / step_cm) + part) for part in (0.34, 0.8))) == step_cm
    assert step_of_runs(range_cm) == 0.1
    # A timer's microsecond, at two temperatures.
    assert step_of_runs(0.0173 * np.rint(range_cm / 0.0173), 0.0175 * np.rint(range_cm / 0.0175)) == 0.1


def test_a_step_that_is_none_stays_in_whole_centimetres() -> None:
    rng, range_cm = np.random.default_rng(2), swept(2)
    whole_cm = np.rint(range_cm)
    odd = rng.random(2000) < 0.03
    tenths_cm = np.round(range_cm, 1)
    assert step_of_runs(np.where(odd, tenths_cm, whole_cm)) == 1.0, "a few means of readings"
    assert step_of_runs(whole_cm + 0.3) == 1.0, "an offset that was added"
    assert step_of_runs(np.round(1.013 * whole_cm, 2)) == 1.0, "corrected for the temperature"
    assert step_of_runs(np.round(0.34 * np.rint(range_cm / 0.34), 1)) == 1.0, "0.34 cm written to 0.1"
    outliers_cm = np.where(odd, np.rint(rng.uniform(20.0, 700.0, 2000)), np.round(1.013 * whole_cm, 1))
    assert step_of_runs(outliers_cm) == 1.0, "written to 0.1 cm, with outliers"
    drifting = np.round(np.linspace(1.0, 1.02, 2000) * whole_cm, 1)
    assert step_of_runs(drifting) == 1.0, "corrected for a temperature that drifts"
    assert step_of_runs(tenths_cm, whole_cm[:200]) == 1.0, "one run in whole centimetres"
    assert step_of_runs(tenths_cm, np.full(500, 100.0)) == 0.1, "a run that stands still says nothing"
    assert step_of_runs(5.0 * np.rint(range_cm / 5.0)) == 1.0, "coarser readings are an effect"
    assert step_of_runs(5.0 * np.rint(range_cm / 5.0), model_step_cm=5.0) == 5.0, "or what the model says"
    assert step_of_runs(whole_cm, model_step_cm=5.0) == 1.0
    assert step_of_runs(whole_cm, model_step_cm=0.1) == 1.0
    assert step_of_runs(np.zeros(0)) == 1.0


def test_readings_are_multiples_that_equal_their_decimals() -> None:
    assert to_step(np.array([12.25, 12.34, 12.3499, 0.3]), 0.1).tolist() == [12.3, 12.3, 12.3, 0.3]
    assert to_step(np.array([120.5, 121.5, 119.49]), 1.0).tolist() == [121.0, 122.0, 119.0]
    assert to_step(np.array([12.4, 12.6]), 5.0).tolist() == [10.0, 15.0]


def taken(folder: Path, columns: dict[str, Any], model: Model = GIVEN) -> Readings:
    write_csv(folder / "flight.csv", columns)
    return read_readings([folder / "flight.csv"], model)


@pytest.mark.parametrize(
    ("decimals", "limits_cm", "step_cm"),
    [(0, (20.5, 400.5), 0.5), (0, (20.2, 400.2), 0.2), (0, (20.0, 400.0), 1.0), (1, (20.5, 400.5), 0.1)],
)
def test_the_step_is_one_of_which_the_models_limits_are_multiples(
    tmp_path: Path, decimals: int, limits_cm: tuple[float, float], step_cm: float
) -> None:
    """Readings in whole centimetres, and limits that are none, ended the gap by a traceback."""
    changes = {"driver": "none", "minimum_cm": limits_cm[0], "maximum_cm": limits_cm[1], "heard_on_axis_cm": None}
    sensor = GIVEN.sensor.model_validate(GIVEN.sensor.model_dump() | changes | {"resolution_cm": step_cm})
    table = readings(400)
    table["reading_cm"] = np.round(table["true_range_cm"] + np.random.default_rng(2).normal(size=400), decimals)
    assert taken(tmp_path, table, Model.of(sensor)).step_cm == step_cm


def test_a_table_in_millimetres_and_its_model_stay_in_millimetres(tmp_path: Path) -> None:
    columns = readings(3000, step_cm=0.1, sigma_cm=0.5)
    found = taken(tmp_path, columns)
    assert found.step_cm == 0.1
    assert sorted(found.data["reading_cm"].tolist()) == sorted(np.round(columns["reading_cm"], 1).tolist())
    (resolution,) = found.calibration
    assert (resolution.before, resolution.after) == (1.0, 0.1)
    compared = Comparison.of(found, GIVEN, Settings(str(MODEL)))
    assert compared.model.sensor.resolution_cm == 0.1
    assert compared.impossible == 0.0


def with_constants() -> tuple[dict[str, Any], Array]:
    """Millimetres to which 0.034 cm were added in four of eight runs, -0.02 cm in the others; some are no echo."""
    columns = readings(3000, runs=8, step_cm=0.1, sigma_cm=0.5, missed=0.03, hit=0.95)
    constant_cm = np.where(np.arange(3000) < 1500, 0.034, -0.02)
    constant_cm[columns["reading_cm"] == 765.0] = 0.0
    return columns | {"reading_cm": columns["reading_cm"] + constant_cm}, constant_cm


def test_what_was_added_to_millimetres_does_not_hide_their_step(tmp_path: Path) -> None:
    """They were compared in steps of 0.5 cm, of which they are multiples no more than of 0.1."""
    columns, constant_cm = with_constants()
    found = taken(tmp_path, columns)
    assert found.step_cm == 0.1
    np.testing.assert_allclose(found.data["reading_cm"], np.round(columns["reading_cm"] - constant_cm, 1), atol=1e-9)
    np.testing.assert_allclose(
        found.data["reading_cm"] - found.data["true_range_cm"],
        columns["reading_cm"] - columns["true_range_cm"],
        atol=1e-9,
        err_msg="nothing is rounded away",
    )
    before = found.data["previous_reading_cm"]
    np.testing.assert_allclose(before, np.round(before, 1), atol=1e-9)
    (resolution,) = found.calibration
    assert "-0.02 to 0.034 cm is added to the multiples of 0.1 cm in 98.3 % of" in resolution.finding
    assert (resolution.before, resolution.after) == (1.0, 0.1)


def test_a_constant_is_no_spread_of_a_characterised_sensor(tmp_path: Path) -> None:
    """And the model agrees with the readings that it was made of."""
    ranges_cm = np.repeat(np.linspace(60.0, 300.0, 9), 120) + 0.37
    sensor = PlainSensor(0.97, 0.01, 0.01, 0.01, sigma_cm=0.06, short_rate_per_m=0.5, step_cm=0.1)
    reading_cm = np.array(sensor.readings(ranges_cm.tolist(), 5))
    columns = {
        "time_s": np.arange(ranges_cm.size, dtype=float),
        "sensor": np.full(ranges_cm.size, "down"),
        "reading_cm": np.where(reading_cm == 765.0, 765.0, reading_cm + 0.044),
        "true_range_cm": ranges_cm,
    }
    write_csv(tmp_path / "bench.csv", columns)
    made = characterise(tmp_path / "bench.csv", sensor=MODEL)["model"]
    assert made["resolution_cm"] == 0.1
    assert made["reading_model"]["sigma_cm"] == pytest.approx(0.06, abs=0.005)


def test_only_what_repeats_exactly_is_a_repeat(tmp_path: Path) -> None:
    columns = readings(3000, runs=1, step_cm=0.1)
    slow_cm = 100.0 + 0.13 * np.arange(3000) % 90.0
    columns |= {"true_range_cm": slow_cm, "reading_cm": np.round(slow_cm, 1)}
    data = taken(tmp_path, columns).data
    assert (data["reading_cm"] == data["previous_reading_cm"]).mean() < 0.01
    columns["reading_cm"] = np.repeat(np.round(slow_cm, 1)[::2], 2)
    (tmp_path / "flight.csv").unlink()
    data = taken(tmp_path, columns).data
    assert (data["reading_cm"] == data["previous_reading_cm"]).mean() == pytest.approx(0.5, abs=0.01)


def test_a_model_with_faults_of_bytes_is_compared_in_whole_centimetres(tmp_path: Path) -> None:
    found = taken(tmp_path, readings(1500, step_cm=0.1), GIVEN.adding("lost_high_byte", share=0.1))
    assert found.step_cm == 1.0
    assert (found.data["reading_cm"] % 1.0 == 0.0).all()


def named(folder: Path, columns: dict[str, Any]) -> NamedModel:
    compared = Comparison.of(taken(folder, columns), GIVEN, Settings(str(MODEL)))
    contexts = {name: column for name, column in compared.data.items() if name != "reading_cm"}
    reading_cm = compared.data["reading_cm"]
    return name_effects(compared.model, AllReadings(contexts, reading_cm, compared.splits), np.random.default_rng(1))


def flight(seed: int, step_cm: float, held: float, delay_s: float, n: int = 4000) -> dict[str, Any]:
    """A vehicle that goes up and down; a reading is late, and is repeated with a probability of ``held``."""
    rng, chance = np.random.default_rng(seed), Random(seed)
    sensor = PlainSensor(0.97, 0.01, 0.0, 0.02, sigma_cm=1.9445, short_rate_per_m=0.5, step_cm=step_cm)
    time_s, run = 0.1 * np.arange(n), np.arange(n) * 8 // n
    phase = rng.uniform(0.0, 6.0, 8)[run]

    def height_cm(at_s: NDArray[Any]) -> NDArray[Any]:
        return 200.0 + 90.0 * np.sin(0.5 * at_s + phase) + 20.0 * np.sin(1.7 * at_s + 2.0 * phase)

    new_cm = [sensor.reading(each, chance) for each in height_cm(time_s - delay_s).tolist()]
    repeated = (rng.random(n) < held) & (np.diff(run, prepend=-1) == 0)
    last_new = np.maximum.accumulate(np.where(repeated, 0, np.arange(n)))
    return {
        "time_s": time_s,
        "run": np.array([f"flight-{each}" for each in run]),
        "sensor": np.full(n, "down"),
        "true_range_cm": height_cm(time_s),
        "range_rate_cm_s": (height_cm(time_s + 0.01) - height_cm(time_s - 0.01)) / 0.02,
        "reading_cm": np.array(new_cm)[last_new],
    }


@pytest.mark.parametrize("step_cm", [0.5, *slow(0.1)])
def test_nothing_is_named_in_fine_readings_of_the_model(tmp_path: Path, step_cm: float) -> None:
    found = named(tmp_path, flight(1, step_cm, held=0.0, delay_s=0.0, n=2000))
    assert [each.name for each in found.effects] == []
    assert found.models.final_fit.sensor.resolution_cm == step_cm


@pytest.mark.slow
@pytest.mark.parametrize("step_cm", [0.1, 1.0])
def test_held_and_late_readings_are_named_in_any_step(tmp_path: Path, step_cm: float) -> None:
    found = {each.name: each for each in named(tmp_path, flight(2, step_cm, held=0.5, delay_s=0.3)).effects}
    assert set(found) == {"stale", "latency"}
    assert found["stale"].parameters["share"].value == pytest.approx(0.5, abs=0.04)
    assert found["latency"].parameters["delay_ms"].value == pytest.approx(300.0, abs=10.0)


def held_noise(seed: int) -> tuple[dict[str, Any], Array]:
    """Errors with a correlation of 0.8 from one row to the next, and rows that repeat the reading before."""
    rng, n = np.random.default_rng(seed), 4000
    error = np.empty(n)
    error[0] = rng.standard_normal()
    for i in range(1, n):
        error[i] = 0.8 * error[i - 1] + 0.6 * rng.standard_normal()
    true_cm = 200.0 + 80.0 * np.sin(0.05 * np.arange(n))
    reading_cm = np.rint(true_cm + 3.0 * error)
    for i in (np.flatnonzero(rng.random(n - 1) < 0.6) + 1).tolist():
        reading_cm[i] = reading_cm[i - 1]
    contexts = {"true_range_cm": true_cm, "time_s": 0.1 * np.arange(n), "run": np.full(n, "a")}
    return contexts | {"previous_reading_cm": np.concatenate([[np.nan], reading_cm[:-1]])}, reading_cm


def test_a_repeated_reading_has_no_error_of_its_own() -> None:
    """The noise of new readings is found again next to repeats, whose distance to the truth grows as it moves."""
    contexts, reading_cm = held_noise(3)
    mixture = GIVEN.sensor.reading_model.model_copy(update={"sigma_cm": 3.0})
    heights = {}
    for correlation in (0.6, 0.7, 0.8, 0.9):
        own = mixture.model_copy(update={"correlation": correlation, "correlation_spacing_s": 0.1})
        model = Model.of(GIVEN.sensor.model_copy(update={"reading_model": own, "effects": ()}))
        heights[correlation] = model.adding("stale", share=0.6).log_prob(reading_cm, contexts).sum()
    assert max(heights, key=lambda each: heights[each]) == 0.8
    # Without repeats among the effects they count as hits.
    assert History.of(contexts, reading_cm.size, 0.8, 0.1).before(np.ones(4000, dtype=bool))[0][1:].tolist() == list(
        range(3999)
    )


@pytest.mark.parametrize("step_cm", [0.1, 0.5, 1.0])
def test_a_characterised_model_has_the_step_of_its_readings(tmp_path: Path, step_cm: float) -> None:
    """And the spread that the plain sampler drew with, which whole centimetres hide."""
    ranges_cm = np.repeat(np.linspace(60.0, 300.0, 9), 120) + 0.37
    sensor = PlainSensor(0.97, 0.01, 0.01, 0.01, sigma_cm=0.4, short_rate_per_m=0.5, step_cm=step_cm)
    columns = {
        "time_s": np.arange(ranges_cm.size, dtype=float),
        "sensor": np.full(ranges_cm.size, "down"),
        "reading_cm": np.array(sensor.readings(ranges_cm.tolist(), 5)),
        "true_range_cm": ranges_cm,
    }
    write_csv(tmp_path / "bench.csv", columns)
    out = tmp_path / "model.yaml"
    characterise(tmp_path / "bench.csv", sensor=MODEL, out=out)
    written = load_sensor_model(out)
    assert written.resolution_cm == step_cm
    assert written.reading_model.sigma_cm == pytest.approx(0.4, abs=0.03)
    assert ("# Step of the readings." in out.read_text(encoding="utf-8")) == (step_cm != 1.0)
