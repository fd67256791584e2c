"""A few odd rows, blank cells, copies and causes that do not vary change no answer, or are reported."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.gap.before_after import add, compare
from msp_lab.gap.findings import Gap, GapFindings, Measure, OddsMeasures, Settings
from msp_lab.gap.intake import Comparison, read_readings
from msp_lab.gap.naming import AllReadings, NamedModel, name, name_effects
from msp_lab.gap.runs import draw_splits
from msp_lab.gap.verdict import verdict
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import write_csv
from msp_sim.model.model import Model
from tests.support.measured import MODEL as FILE
from tests.support.measured import sensor
from tests.unit.test_gap_findings import EFFECT

Array = NDArray[np.float64]
MODEL = Model.of(load_sensor_model(FILE).model_copy(update={"effects": ()}))
N, RUNS = 1400, 14


def quiet(what: str, share: float) -> None:
    """Report nothing."""


def flown(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    run = np.arange(N) * RUNS // N
    return {
        "time_s": 0.1 * np.arange(N),
        "sensor": np.full(N, "front"),
        "run": np.array([f"run{k:02d}" for k in run]),
        "true_range_cm": rng.uniform(60.0, 350.0, N),
        "incidence_deg": rng.uniform(0.0, 20.0, N),
        "air_temperature_c": np.round(rng.uniform(0.0, 35.0, RUNS)[run], 1),
    }


def read(contexts: dict[str, Any], seed: int, bias_cm: Array | float = 0.0) -> Array:
    return np.array(sensor().readings((contexts["true_range_cm"] + bias_cm).tolist(), seed))


def named(contexts: dict[str, Any], reading_cm: Array) -> NamedModel:
    rng = np.random.default_rng(1)
    return name_effects(MODEL, AllReadings(contexts, reading_cm, draw_splits(contexts, rng)), rng)


def names(found: NamedModel) -> set[str]:
    return {each.name for each in found.effects} | {one.name for each in found.effects for one in each.alternatives}


@pytest.mark.slow
def test_nine_rows_do_not_remove_slant_range() -> None:
    contexts = flown(1)
    slant_cm = contexts["true_range_cm"] * (1.0 / np.cos(np.radians(contexts["incidence_deg"])) - 1.0)
    reading_cm = read(contexts, 1, slant_cm)
    held_out = np.flatnonzero(draw_splits(contexts, np.random.default_rng(1)).held_out)
    strange = np.random.default_rng([1, 1]).choice(held_out, 9, replace=False)
    # At a tilt where the effect is largest, and read as if there were none.
    contexts["incidence_deg"][strange] = 25.0
    reading_cm[strange] = np.rint(contexts["true_range_cm"][strange])
    assert "slant_range" in names(named(contexts, reading_cm))


@pytest.mark.slow
def test_a_temperature_with_blank_cells_is_named_as_without(tmp_path: Path) -> None:
    contexts = flown(2)
    # Fast enough that the rows before and after say nothing of a blank one.
    contexts["air_temperature_c"] = np.round(np.random.default_rng([2, 2]).uniform(0.0, 35.0, N), 1)
    reading_cm = read(contexts, 2, contexts["true_range_cm"] * (22.5 - contexts["air_temperature_c"]) * 0.0017)
    contexts["air_temperature_c"][np.random.default_rng([2, 1]).random(N) < 0.3] = np.nan
    write_csv(tmp_path / "flights.csv", contexts | {"reading_cm": reading_cm})
    comparison = Comparison.of(read_readings([tmp_path / "flights.csv"], MODEL), MODEL, Settings("model.yaml"))
    findings, models = name(comparison, compare(comparison, "2026-01-01", quiet), quiet)
    assert [each.name for each in findings.effects] == ["air_temperature"]
    share = findings.effects[0].parameters["share"]
    assert (share.low or 0.0) < 1.0 < (share.high or 0.0)
    assert any("air_temperature_c: 4" in each and "without it are left out" in each for each in findings.messages)
    gap = add(comparison, findings, models, quiet).gap
    assert gap is not None
    assert (gap.bias_cm.after or 0.0) < 0.3 < (gap.bias_cm.before or 0.0)


@pytest.mark.slow
def test_blank_cells_of_what_does_nothing_leave_nothing_out(tmp_path: Path) -> None:
    contexts = flown(8)
    slant_cm = contexts["true_range_cm"] * (1.0 / np.cos(np.radians(contexts["incidence_deg"])) - 1.0)
    reading_cm = read(contexts, 8, slant_cm)
    contexts["air_temperature_c"][np.random.default_rng([8, 1]).random(N) < 0.5] = np.nan
    contexts["humidity_pct"] = np.where(np.arange(N) < 100, 50.0, np.nan)
    write_csv(tmp_path / "flights.csv", contexts | {"reading_cm": reading_cm})
    comparison = Comparison.of(read_readings([tmp_path / "flights.csv"], MODEL), MODEL, Settings("model.yaml"))
    shares: list[float] = []
    before = compare(comparison, "2026-01-01", quiet)
    findings, models = name(comparison, before, lambda what, share: shares.append(share))
    # It names twice, the second time without that column, and the progress does not go back.
    assert shares == sorted(shares)
    assert "slant_range" in {each.name for each in findings.effects}
    assert comparison.known_to(models.training_fit) is comparison
    assert not any("left out" in each for each in findings.messages)
    assert any("humidity_pct is blank in most readings" in each for each in findings.messages)


def test_copies_radians_and_backward_time_are_reported(tmp_path: Path) -> None:
    contexts = flown(3)
    reading_cm = read(contexts, 3)
    last, first = contexts["run"] == "run13", contexts["run"] == "run00"
    contexts["true_range_cm"][last] = contexts["true_range_cm"][first]
    reading_cm[last] = reading_cm[first]
    contexts["incidence_deg"] = np.radians(contexts["incidence_deg"])
    contexts["true_range_cm"] = np.sort(contexts["true_range_cm"])
    contexts["range_rate_cm_s"] = -np.gradient(contexts["true_range_cm"], 0.1)
    contexts["true_range_cm"][last] = contexts["true_range_cm"][first]
    write_csv(tmp_path / "flights.csv", contexts | {"reading_cm": np.rint(contexts["true_range_cm"])})
    found = read_readings([tmp_path / "flights.csv"], MODEL)
    assert any("Run run13 has the readings of run run00 and is left out" in each for each in found.messages)
    assert any("in radians" in each for each in found.messages)
    assert any("time runs backwards" in each for each in found.messages)
    assert "run13" not in found.data["run"]


@pytest.mark.slow
def test_what_varies_in_one_run_only_is_not_validated() -> None:
    """One cold run among warm ones: whichever part has it, the other part knows nothing of the cold."""
    contexts = flown(4)
    cold = contexts["run"] == "run07"
    contexts["air_temperature_c"] = np.where(cold, 2.0, 22.5)
    bias_cm = contexts["true_range_cm"] * (22.5 - contexts["air_temperature_c"]) * 0.0017
    found = named(contexts, read(contexts, 4, bias_cm))
    assert "air_temperature" not in names(found)
    contexts["air_temperature_c"] = np.where(cold | (contexts["run"] == "run11"), 2.0, 22.5)
    bias_cm = contexts["true_range_cm"] * (22.5 - contexts["air_temperature_c"]) * 0.0017
    both = named(contexts, read(contexts, 4, bias_cm))
    assert "air_temperature" in names(both)


@pytest.mark.parametrize(("before", "expected"), [(0.004, "improved"), (0.4, "explained")])
def test_explained_needs_a_gap_that_was_there(before: float, expected: str) -> None:
    one = Measure(1.0, 1.0, 1.0)
    gap = Gap(Measure(before, 0.001, 0.002), Measure(0.1, 0.05, 0.02), one, OddsMeasures(one, one, one, one))
    found = GapFindings(None, rows=20_000, runs=10, gap=gap, effects=(EFFECT,))
    assert verdict(found, MODEL) == expected


def test_one_run_has_no_offsets_between_runs() -> None:
    """A drift within one run makes its blocks differ; they are no runs."""
    contexts = flown(5) | {"run": np.full(N, "one")}
    drift_cm = np.repeat(np.random.default_rng([5, 1]).uniform(-4.0, 4.0, 60), N // 60 + 1)[:N]
    found = named(contexts, read(contexts, 5, drift_cm))
    assert "run_offsets" not in names(found)


@pytest.mark.slow
def test_a_target_that_stands_still_does_not_show_stale_readings() -> None:
    """Noise that hardly changes from reading to reading repeats whole centimetres by itself."""
    contexts = flown(6)
    rng = np.random.default_rng([6, 1])
    contexts["true_range_cm"] = np.repeat(rng.uniform(60.0, 350.0, N // 50), 50)
    slow_cm = np.concatenate([np.cumsum(rng.normal(0.0, 0.25, 50)) for _ in range(N // 50)])
    assert "stale" not in names(named(contexts, np.rint(contexts["true_range_cm"] + slow_cm)))
    # The same share of repeats before a wall that moves is a sensor's.
    contexts = flown(6)
    reading_cm = read(contexts, 6)
    again = rng.random(N) < 0.3
    again[:: N // RUNS] = False
    for row in np.flatnonzero(again).tolist():
        reading_cm[row] = reading_cm[row - 1]
    assert "stale" in names(named(contexts, reading_cm))


def test_repeats_are_those_of_the_file_and_not_of_its_rounding(tmp_path: Path) -> None:
    contexts = flown(7)
    rng = np.random.default_rng(7)
    # Before a target that stands still, rounding makes most of the repeats.
    contexts["true_range_cm"] = np.repeat(rng.integers(60, 350, N // 50).astype(float), 50)
    fine_cm = np.round(contexts["true_range_cm"] + rng.normal(0.0, 0.4, N), 1)
    fine_cm[1::4] = fine_cm[::4]
    write_csv(tmp_path / "flights.csv", contexts | {"reading_cm": fine_cm})
    found = read_readings([tmp_path / "flights.csv"], MODEL).data
    order = np.lexsort((contexts["time_s"], contexts["run"]))
    exact = np.zeros(N, dtype=bool)
    exact[1:] = (fine_cm[order][1:] == fine_cm[order][:-1]) & (
        contexts["run"][order][1:] == contexts["run"][order][:-1]
    )
    assert (found["reading_cm"] == found["previous_reading_cm"]).tolist() == exact.tolist()
    assert np.nanmax(np.abs(found["previous_reading_cm"][1:] - np.rint(fine_cm)[:-1])[~exact[1:]]) <= 1.0
