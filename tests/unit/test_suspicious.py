"""Tables that look wrong are reported in a sentence, and good ones are not."""

from typing import Any

import numpy as np
import pytest

from msp_lab.readings.suspicious import suspicious
from msp_range.recording.csv_form import MeasuredData

N = 600


def flown(seed: int, lag_s: float = 0.0, runs: int = 6) -> dict[str, Any]:
    """Runs before a wall that comes and goes, with a reference that is behind by so long."""
    rng = np.random.default_rng(seed)
    run, time_s = np.arange(N) * runs // N, 0.1 * (np.arange(N) % (N // runs))

    def true_cm(at: Any) -> Any:
        return 200.0 + 80.0 * np.sin(at / 2.0 + run)

    return {
        "time_s": time_s,
        "run": np.array([f"run{k}" for k in run]),
        "sensor": np.full(N, "front"),
        "reading_cm": np.where(rng.random(N) < 0.05, 765.0, np.rint(true_cm(time_s) + rng.normal(0.0, 1.5, N))),
        "true_range_cm": true_cm(time_s - lag_s),
    }


def said(columns: dict[str, Any]) -> str:
    return " ".join(suspicious(MeasuredData(columns)))


def test_good_tables_are_not_suspicious() -> None:
    # Late readings are a sensor's, and sorted rows are as good as others.
    for seed in range(20):
        for lag_s in (0.0, -0.1):
            assert said(flown(seed, lag_s, runs=1 + seed % 6)) == ""


@pytest.mark.parametrize("runs", [1, 6])
def test_a_reference_that_lags_is_reported_with_its_lag(runs: int) -> None:
    text = said(flown(1, 0.15, runs))
    assert text.startswith("Readings are 0.15 s ahead of true_range_cm (")
    assert "the reference lags" in text


def test_shuffled_time_is_reported_and_nothing_that_follows_from_it() -> None:
    columns = flown(2, 0.15)
    for run in np.unique(columns["run"]):
        here = columns["run"] == run
        columns["time_s"][here] = np.random.default_rng(2).permutation(columns["time_s"][here])
    assert said(columns).startswith("true_range_cm jumps in the order of time_s and not in that of the rows: time_s is")
    assert "ahead" not in said(columns)


def test_rows_in_another_order_than_time_are_no_shuffled_time() -> None:
    columns = flown(3)
    order = np.random.default_rng(3).permutation(N)
    assert said({name: column[order] for name, column in columns.items()}) == ""


def test_time_that_runs_backwards_is_seen_in_the_rate() -> None:
    columns = flown(4)
    columns["range_rate_cm_s"] = 40.0 * np.cos(columns["time_s"] / 2.0 + np.arange(N) * 6 // N)
    assert said(columns) == ""
    columns["time_s"] = columns["time_s"].max() - columns["time_s"]
    assert "time runs backwards or the sign is wrong" in said(columns)
