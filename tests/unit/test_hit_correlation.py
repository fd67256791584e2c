"""Characterisation finds how alike neighbouring errors are, about each set-up's own mean, and writes it."""

import numpy as np
import pytest

from msp_lab.characterise.correlation import hit_correlation
from msp_lab.characterise.points import sort_into_points
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData
from tests.support.measured import MODEL

SENSOR = load_sensor_model(MODEL)


def bench(correlation: float, seed: int, set_ups: int = 12, each: int = 120, step_s: float = 0.1) -> MeasuredData:
    """Set-ups with an error of their placement each, read with errors of this correlation."""
    rng = np.random.default_rng(seed)
    range_cm = np.repeat(np.linspace(60.0, 280.0, set_ups), each)
    error = np.empty(range_cm.size)
    for i in range(range_cm.size):
        before = error[i - 1] if i % each else rng.standard_normal()
        error[i] = correlation * before + np.sqrt(1.0 - correlation**2) * rng.standard_normal()
    reading_cm = np.round(range_cm + np.repeat(rng.normal(0.0, 0.5, set_ups), each) + 2.0 * error)
    missed = rng.random(range_cm.size) < 0.03
    time_s = step_s * np.arange(range_cm.size) + 60.0 * (np.arange(range_cm.size) // each)
    columns = {
        "time_s": time_s,
        "sensor": np.full(range_cm.size, "down"),
        "reading_cm": np.where(missed, 765.0, reading_cm),
        "true_range_cm": range_cm,
    }
    return MeasuredData(columns)


@pytest.mark.parametrize("correlation", [0.3, 0.7])
def test_correlated_errors_are_found_with_their_size(correlation: float) -> None:
    data = bench(correlation, 1)
    found = hit_correlation(sort_into_points(data, SENSOR), data)
    assert found is not None
    # Rounding to a centimetre takes a fiftieth away.
    assert found.correlation == pytest.approx(correlation, abs=0.06)
    assert found.spacing_s == pytest.approx(0.1)
    assert found.z > 8.0


def test_independent_errors_about_wrong_placements_have_none() -> None:
    for seed in range(5):
        data = bench(0.0, seed)
        assert hit_correlation(sort_into_points(data, SENSOR), data) is None


def test_without_times_nothing_is_said() -> None:
    data = bench(0.7, 1)
    untimed = MeasuredData({name: column for name, column in data.columns.items() if name != "time_s"})
    assert hit_correlation(sort_into_points(untimed, SENSOR), untimed) is None
