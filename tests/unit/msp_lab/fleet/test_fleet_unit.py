"""Numbers of one sensor: what its search finds, the fit of it, and that by session, against the truth."""

from pathlib import Path

import numpy as np
import pytest

from msp_lab.fleet.terms import BASE, FleetTerm
from msp_lab.fleet.unit import Unit, examine, search
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
        record_runs(tmp_path, {name: {"file": f"{name}.csv"}})
    return Unit(tmp_path, "V1", "down", SESSIONS, 1)


def test_repeated_readings_are_found_and_their_share_is_fitted(unit: Unit) -> None:
    own = search(MODEL, (unit, (), 11.0))
    ((term, lost), *_), *others = own.effects
    assert (term.effect, term.number, lost, others) == ("stale", "share", 0.0, [])
    assert own.gain_nats > 50.0
    assert search(MODEL, (unit, (term,), 11.0)) == ((), 0.0)
    fitted = examine(MODEL, (unit, (term,)))
    assert [each.effect for each, _ in fitted.numbers] == [*BASE, "stale"]
    assert 50.0 < fitted.gain_nats <= own.gain_nats + 1.0
    # 100 repeats, of which most are off the truth by several sigma.
    value, error = fitted.numbers[-1][1].estimate(0.0)
    assert abs(value - SHARE) < 3.0 * error
    assert error < 0.01


def test_a_number_of_the_base_is_estimated_in_each_session(unit: Unit) -> None:
    found = examine(MODEL, (unit, ()))
    offset = dict(found.numbers)[FleetTerm("offset", "value")]
    assert found.sessions == SESSIONS
    assert offset.share.tolist() == [0.25] * 4
    assert (found.readings, found.gain_nats) == (2000, 0.0)
    error = np.sqrt(offset.variance)
    assert offset.value[3] - offset.value[:3].mean() == pytest.approx(4.0, abs=4.0 * error.max())
    value, of_all = offset.estimate(0.0)
    assert value == pytest.approx(offset.value.mean())
    # A session of a quarter of the readings is known half as well.
    assert error[:3] == pytest.approx(2.0 * of_all, rel=0.3)
    # Where sessions differ by much more than their errors, four of them are known half as well as one.
    assert offset.estimate(100.0)[1] == pytest.approx(5.0, rel=0.01)


def drawn(folder: Path, name: str, scale: float, rng: np.random.Generator, without_missed: bool = False) -> Unit:
    """Four sessions of a vehicle whose ranges are read larger by a factor; if wanted, without its missed echoes."""
    sessions = tuple(f"{name}/{number}" for number in range(4))
    for session in sessions:
        contexts = {"time_s": 0.1 * np.arange(500), "true_range_cm": rng.uniform(60.0, 500.0, 500)}
        reading_cm = MODEL.sample(contexts, rng)
        if without_missed:
            # 255 cm is the damaged form of a missed echo.
            missed = (reading_cm >= MODEL.sensor.maximum_cm) | (reading_cm == 255.0)
            reading_cm[missed] = np.rint(contexts["true_range_cm"][missed])
        reading_cm += np.rint((scale - 1.0) * contexts["true_range_cm"])
        write_tables(folder, session, {"down": MeasuredData({**contexts, "reading_cm": reading_cm})})
        record_runs(folder, {session: {"file": f"{session}.csv"}})
    return Unit(folder, name, "down", sessions, 1)


def test_a_number_is_compared_beyond_its_bound_too(tmp_path: Path) -> None:
    """A scale of either sign looks like a walk of the threshold, which by its physics is none below 0."""
    rng = np.random.default_rng(7)
    walk = FleetTerm("threshold_walk", "walk_cm_per_10db", shape=(("exponent", 0.0),))
    units = [drawn(tmp_path, f"V{k}", scale, rng) for k, scale in enumerate((0.992, 1.008))]
    (near, near_error), (far, far_error) = (
        dict(examine(MODEL, (unit, (walk,))).numbers)[walk].estimate(0.0) for unit in units
    )
    assert far > 5.0 * far_error
    assert near < -5.0 * near_error
    assert near_error == pytest.approx(far_error, rel=0.5)


def test_odds_of_what_never_came_are_those_of_about_half_an_event(tmp_path: Path) -> None:
    unit = drawn(tmp_path, "V1", 1.0, np.random.default_rng(7), without_missed=True)
    value, error = dict(examine(MODEL, (unit, ())).numbers)[FleetTerm("missed", "value")].estimate(0.0)
    expected = 2000 * MODEL.sensor.reading_model.weights.missed
    assert expected > 5.0
    assert np.log(0.5 / expected) < value < -1.0
    assert 0.5 < error < 1.5


def test_an_effect_of_the_same_name_as_a_number_of_the_base_is_another_term() -> None:
    effect, number = FleetTerm("missed", "log_odds"), FleetTerm("missed", "value")
    assert (effect.is_base, number.is_base) == (False, True)
    assert effect.parameter.name == "log_odds"
