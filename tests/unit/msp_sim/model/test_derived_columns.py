"""Columns that `msp-sim sample` computes where a model uses them and the contexts lack them."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import read_csv, write_csv
from msp_sim.model.derived import derived_columns, sample_in_order
from msp_sim.model.model import Model
from tests.support.curves import with_curve
from tests.support.programs import run

N = 2000
SENSOR = load_sensor_model("configs/sensors/mb1242.yaml").model_copy(update={"effects": ()})


def contexts() -> dict[str, NDArray[Any]]:
    run = np.repeat(["a", "b"], N // 2)
    time_s = np.tile(0.1 * np.arange(N // 2), 2) + np.where(run == "a", 5.0, 100.0)
    true_cm = 300.0 + 150.0 * np.sin(time_s)
    return {"time_s": time_s, "run": run, "sensor": np.full(N, "left"), "true_range_cm": true_cm}


def test_repeats_are_of_the_readings_that_were_drawn() -> None:
    model, given = Model(SENSOR).adding("stale", share=0.6), contexts()
    reading_cm = sample_in_order(model, given, 1)
    np.testing.assert_array_equal(reading_cm, sample_in_order(model, given, 1))
    repeats = reading_cm[1:] == reading_cm[:-1]
    assert 0.55 < repeats.mean() < 0.72
    # The first of a run has none before it: it is near its own range, and not the other run's last.
    assert abs(reading_cm[N // 2] - given["true_range_cm"][N // 2]) < 10.0
    # Repeats of repeats: half of all chains are longer than one.
    assert (repeats[1:] & repeats[:-1]).mean() == pytest.approx(repeats.mean() ** 2, abs=0.06)
    recorded = {**given, "previous_reading_cm": np.full(N, 400.0)}
    assert (sample_in_order(model, recorded, 1) == 400.0).mean() > 0.5


def test_order_is_that_of_time_and_not_of_the_file() -> None:
    model, given = Model(SENSOR).adding("stale", share=0.6), contexts()
    shuffled = np.random.default_rng(2).permutation(N)
    mixed = {name: column[shuffled] for name, column in given.items()}
    reading_cm = np.empty(N)
    reading_cm[shuffled] = sample_in_order(model, mixed, 1)
    assert 0.55 < (reading_cm[1:] == reading_cm[:-1]).mean() < 0.72


def test_rate_time_incidence_and_lag_follow_from_other_columns() -> None:
    given = contexts()
    given |= {"roll_deg": np.full(N, 3.0), "pitch_deg": np.full(N, -4.0)}
    model = Model(SENSOR).adding("latency", delay_ms=100.0).adding("slant_range", share=1.0)
    model = with_curve(model, "bias", ["time_in_run_s"], [[0.0, 100.0]], [0.0, 5.0])
    columns, added = derived_columns(model.columns, given)
    assert added.keys() == {"range_rate_cm_s", "incidence_deg", "time_in_run_s"}
    inner = np.r_[1 : N // 2 - 1, N // 2 + 1 : N - 1]
    np.testing.assert_allclose(columns["range_rate_cm_s"][inner], 150.0 * np.cos(given["time_s"][inner]), atol=0.3)
    assert np.abs(columns["range_rate_cm_s"]).max() < 160.0
    np.testing.assert_allclose(columns["incidence_deg"], np.hypot(3.0, 4.0), rtol=1e-3)
    assert columns["time_in_run_s"][[0, 1, N // 2]] == pytest.approx([0.0, 0.1, 0.0])
    crosstalk = Model(SENSOR).adding("crosstalk", share=0.5)
    two = {"time_s": np.array([0.0, 0.1, 0.25]), "sensor": np.array(["a", "b", "b"]), "true_range_cm": np.full(3, 90.0)}
    lag_ms = derived_columns(crosstalk.columns, two)[0]["neighbour_lag_ms"]
    np.testing.assert_allclose(lag_ms, [np.nan, 100.0, 250.0])
    known = {**given, "range_rate_cm_s": np.full(N, 7.0)}
    assert "range_rate_cm_s" not in derived_columns(model.columns, known)[0]


def test_a_rate_is_that_of_the_motion_and_not_of_noise_pauses_or_jumps() -> None:
    time_s = np.append(0.02 * np.arange(500), 20.0 + 0.02 * np.arange(500))
    true_cm = np.where(time_s < 15.0, 100.0 * time_s, 150.0)
    true_cm[250:500] += 400.0  # over an edge
    true_cm[700:] += 100.0  # and at the next place of a bench
    noisy_cm = true_cm + np.random.default_rng(3).normal(0.0, 2.0, 1000)
    rate = derived_columns({"range_rate_cm_s"}, {"time_s": time_s, "true_range_cm": noisy_cm})[0]["range_rate_cm_s"]
    near_jump = np.abs(np.arange(1000)[:, None] - [249.5, 699.5]).min(axis=1) < 5.0
    assert np.abs(rate[near_jump] - np.where(np.arange(1000) < 500, 100.0, 0.0)[near_jump]).max() < 100.0
    moving = np.arange(1000) < 500
    assert np.nanstd(rate[moving & ~near_jump] - 100.0) < 20.0
    assert abs(np.nanmean(rate[moving & ~near_jump]) - 100.0) < 2.0
    assert abs(np.nanmean(rate[~moving & ~near_jump])) < 2.0
    alone = {"time_s": 2.0 * np.arange(9), "true_range_cm": 50.0 * np.arange(9)}
    assert "range_rate_cm_s" not in derived_columns({"range_rate_cm_s"}, alone)[0]


def test_the_command_says_what_it_computed(tmp_path: Path) -> None:
    content = yaml.safe_load(Path("configs/sensors/mb1242.yaml").read_text())
    effects = [{"name": "stale", "parameters": {"share": 0.5}}, {"name": "latency", "parameters": {"delay_ms": 300.0}}]
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(content | {"effects": effects}))
    write_csv(tmp_path / "contexts.csv", contexts())
    arguments = (tmp_path / "model.yaml", "--contexts", tmp_path / "contexts.csv", "--out", tmp_path / "out.csv")
    done = run("msp-sim sample", *arguments)
    assert "range_rate_cm_s was computed from true_range_cm over time_s" in done.stderr
    assert "has no effect" not in done.stderr
    drawn = read_csv(tmp_path / "out.csv")
    repeats = drawn["reading_cm"][1:] == drawn["reading_cm"][:-1]
    assert 0.45 < repeats.mean() < 0.65
    lag = np.polyfit(drawn["range_rate_cm_s"], drawn["reading_cm"] - drawn["true_range_cm"], 1)[0]
    assert lag < -0.2


def test_a_time_of_day_is_that_of_tables_of_several_days() -> None:
    time_s = np.array([3600.0, 7200.0, 90_000.0, 180_000.0])
    columns, _ = derived_columns({"time_of_day_h"}, {"time_s": time_s})
    np.testing.assert_allclose(columns["time_of_day_h"], [1.0, 2.0, 1.0, 2.0])
    # Within one day what comes with the hour is a drift.
    assert derived_columns({"time_of_day_h"}, {"time_s": time_s[:3]}) == ({}, {})
