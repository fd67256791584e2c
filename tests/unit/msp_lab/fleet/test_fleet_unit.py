"""Numbers of one sensor: what the screen sees of an effect, its fit, and that by session, against the truth."""

from pathlib import Path

import numpy as np
import pytest

from msp_lab.fleet.terms import BASE_NUMBERS, FleetTerm
from msp_lab.fleet.unit import Unit, compare, examine, held
from msp_lab.readings.dataset import record_runs, write_tables
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData
from msp_sim.model.model import Model
from tests.support.measured import MODEL as SENSOR

MODEL = Model.of(load_sensor_model(SENSOR).model_copy(update={"effects": ()}))
SESSIONS = tuple(f"V1/{number}" for number in range(4))
SHARE = 0.05


@pytest.fixture
def unit(tmp_path: Path) -> Unit:
    """Four sessions of 500 readings of which some repeat the one before; in the last all are 4 cm farther."""
    rng = np.random.default_rng(5)
    for name in SESSIONS:
        time_s = 0.1 * np.arange(500)
        contexts = {"time_s": time_s, "true_range_cm": 250.0 + 80.0 * np.sin(0.8 * time_s + rng.uniform(0.0, 6.0))}
        reading_cm = MODEL.sample(contexts, rng)
        for k in np.flatnonzero(rng.random(500) < SHARE).tolist():
            reading_cm[k] = reading_cm[max(k - 1, 0)]
        reading_cm += 4.0 * (name == SESSIONS[-1])
        write_tables(tmp_path, name, {"down": MeasuredData({**contexts, "reading_cm": reading_cm})})
        record_runs(tmp_path, [name], {"file": f"{name}.csv"})
    return Unit(tmp_path, "V1", "down", SESSIONS, 1)


def test_repeated_readings_are_seen_by_the_screen_and_their_share_is_fitted(unit: Unit) -> None:
    since = FleetTerm("offset", "value", sessions=SESSIONS[3:], start=4.0)
    found = examine(MODEL, (unit, (since,), True))
    deviation = dict(zip([each.effect for each in found.terms], found.value / found.error, strict=True))
    assert deviation["stale"] > 10.0
    # Of the other shares there is nothing.
    assert max(abs(deviation.get(name, 0.0)) for name in ("multipath", "dead_zone_minimum", "clutter")) < 4.0
    (gained,) = compare(MODEL, (unit, (since,), (FleetTerm("stale", "share"),)))
    assert gained.gain_nats > 50.0
    stale = FleetTerm("stale", "share", start=dict(gained.values)["share"])
    fitted = examine(MODEL, (unit, (since, stale), False))
    assert [each.effect for each in fitted.terms] == [*BASE_NUMBERS, "offset", "stale"]
    # 100 repeats, of which most are off the truth by several sigma.
    assert abs(fitted.value[-1] - SHARE) < 3.0 * fitted.error[-1]
    assert fitted.error[-1] < 0.01
    # Held where it is nothing is lost; elsewhere as much as a parabola has, where the likelihood is one.
    value, error = float(fitted.value[-1]), float(fitted.error[-1])
    lost = [held(MODEL, (unit, (since, stale), 1, value + off * error)) for off in (0.0, 2.0, 30.0)]
    assert lost[0] == pytest.approx(0.0, abs=0.1)
    assert lost[1] == pytest.approx(2.0, abs=1.5)
    assert lost[2] > 50.0


def test_a_number_of_the_base_is_estimated_in_each_session(unit: Unit) -> None:
    found = examine(MODEL, (unit, (), False))
    offset = dict(found.over_sessions())[FleetTerm("offset", "value")]
    assert found.sessions == SESSIONS
    assert found.readings.tolist() == [500] * 4
    error = np.sqrt(offset.variance)
    assert offset.value[3] - offset.value[:3].mean() == pytest.approx(4.0, abs=4.0 * error.max())
    assert found.value[0] == pytest.approx(offset.value.mean())
    # A session of a quarter of the readings is known half as well.
    assert error[:3] == pytest.approx(2.0 * found.error[0], rel=0.3)
