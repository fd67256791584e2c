"""What the fits say of one sensor of a vehicle, by session, on readings that numpy draws."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from msp_lab.fleet.statistics import over_sessions
from msp_lab.fleet.terms import SCALE, FleetTerm
from msp_lab.fleet.unit import Unit, UnitEstimates, estimate, search
from msp_lab.readings.dataset import record_runs, write_tables
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData
from msp_sim.model.model import Model
from tests.support.measured import MODEL as SENSOR

MODEL = Model.of(load_sensor_model(SENSOR).model_copy(update={"effects": ()}))
SESSIONS, ROWS = 6, 400
SIGMA_CM = MODEL.sensor.reading_model.sigma_cm
STALE = FleetTerm("stale", "share", start=0.02)
MULTIPATH = FleetTerm("multipath", "share", shape=(("sigma_cm", 5.0),), start=0.02)


def flown(
    folder: Path, offset_cm: float = 0.0, later_cm: float = 0.0, scale: float = 0.0, repeats: float = 0.0
) -> Unit:
    """A sensor of six sessions with an offset, one more from the fourth session on, a scale and repeated readings."""
    rng = np.random.default_rng(5)
    names = tuple(f"V1/{number}" for number in range(SESSIONS))
    for k, name in enumerate(names):
        time_s = 0.1 * np.arange(ROWS)
        true_cm = 250.0 + 80.0 * np.sin(0.8 * time_s + rng.uniform(0.0, 6.0))
        shift_cm = offset_cm + later_cm * (k >= 3) + SIGMA_CM * rng.standard_normal(ROWS)
        reading_cm = np.rint((1.0 + scale) * true_cm + shift_cm)
        for place in np.flatnonzero(rng.random(ROWS) < repeats).tolist():
            reading_cm[place] = reading_cm[max(place - 1, 0)]
        columns = {"time_s": time_s, "true_range_cm": true_cm, "reading_cm": reading_cm}
        write_tables(folder, name, {"down": MeasuredData(columns)})
        record_runs(folder, [name], {"file": f"{name}.csv"})
    return Unit(folder, "V1", "down", names, 1)


def number(found: UnitEstimates, effect: str) -> tuple[float, float]:
    """A number and its error."""
    k = [each.effect for each in found.terms].index(effect)
    return float(found.value[k]), float(found.error[k])


def test_offset_and_scale_are_told_apart_and_known_to_their_errors(tmp_path: Path) -> None:
    found = estimate(MODEL, (flown(tmp_path, offset_cm=1.0, scale=0.01), (SCALE,)))
    for effect, truth in (("offset", 1.0), ("range_scale", 1.0)):
        value, error = number(found, effect)
        assert abs(value - truth) < 3.0 * error
    # The standard errors of a line through 2,400 points over +-80 cm whose noise is known.
    slope = 100.0 * SIGMA_CM / (np.sqrt(SESSIONS * ROWS) * 80.0 / np.sqrt(2.0))
    assert number(found, "range_scale")[1] == pytest.approx(slope, rel=0.5)
    assert found.readings.tolist() == [ROWS] * SESSIONS
    # Without a scale each session's readings still have one offset: that at 250 cm.
    plain = estimate(MODEL, (flown(tmp_path / "plain", offset_cm=1.0), ()))
    error = SIGMA_CM / np.sqrt(ROWS)
    assert plain.session_value[:, 0] == pytest.approx(1.0, abs=4.0 * error)
    assert plain.session_error[:, 0] == pytest.approx(error, rel=0.3)


def test_a_sensor_that_moved_after_its_third_session_has_changed_there(tmp_path: Path) -> None:
    unit = flown(tmp_path, later_cm=2.0)
    found = estimate(MODEL, (unit, ()))
    change = over_sessions(found.session_value[:, 0], found.session_error[:, 0], 0.0)
    assert change is not None
    assert (change.kind, change.first) == ("change", 3)
    assert change.size == pytest.approx(2.0, abs=4.0 * change.error)
    assert change.log_p < -20.0
    # Before it the offset is nothing, and the search has nothing to explain but what the noise is.
    before = replace(unit, sessions=unit.sessions[:3])
    value, error = number(estimate(MODEL, (before, ())), "offset")
    assert abs(value) < 4.0 * error
    assert not [each for each in search(MODEL, (before, 0.01)) if not each.is_base]


def test_a_share_is_estimated_and_one_that_is_not_there_is_nothing_for_certain(tmp_path: Path) -> None:
    found = estimate(MODEL, (flown(tmp_path, repeats=0.05), (STALE, MULTIPATH)))
    value, error = number(found, "stale")
    # 120 repeats, of which most are off the truth by several sigma.
    assert abs(value - 0.05) < 3.0 * error
    assert error < 0.01
    value, error = number(found, "multipath")
    assert value < 0.001
    # No second echo in 2,400 readings: a share of 1 / 2,400 is as likely as a standard error is.
    assert 0.0 < error < 5.0 / (SESSIONS * ROWS)
