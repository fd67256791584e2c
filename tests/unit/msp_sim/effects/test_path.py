"""A delay shifts the scene along the reference's path: exactly where there is one, and not across what breaks it."""

from unittest.mock import Mock

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.effects.base import PATH, Scene
from msp_sim.effects.curve import knot_weights
from msp_sim.effects.path import ReferencePath, with_path
from msp_sim.model.model import Model, make_term
from tests.support.measured import MODEL

Array = NDArray[np.float64]
PLAIN = Model.of(load_sensor_model(MODEL).model_copy(update={"effects": ()}))
RNG = np.random.default_rng(3)
TIME_S = np.cumsum(0.1 + 0.02 * RNG.random(600))
EDGE_S = float(TIME_S[300]) - 0.01


def height_cm(time_s: Array) -> Array:
    """Up and down by 60 cm within 5 s."""
    return np.asarray(200.0 + 60.0 * np.sin(2.0 * np.pi * time_s / 5.0))


def table(true_cm: Array, **more: Array) -> dict[str, Array]:
    rate = np.gradient(true_cm, TIME_S) if true_cm.size == TIME_S.size else np.zeros(true_cm.size)
    return {"time_s": TIME_S, "true_range_cm": true_cm, "range_rate_cm_s": rate, **more}


def centre_cm(columns: dict[str, Array], **effects: dict[str, float]) -> Array:
    terms = tuple(make_term(name, None, values) for name, values in effects.items())
    return np.asarray(Model(PLAIN.sensor, terms).rows(columns).centre_cm)


@pytest.mark.parametrize("delay_ms", [-230.0, 15.0, 150.0, 500.0])
def test_a_delay_is_a_shift_and_no_multiple_of_the_rate(delay_ms: float) -> None:
    columns = table(height_cm(TIME_S))
    inner = slice(8, -8)
    late_cm = centre_cm(columns, latency={"delay_ms": delay_ms})
    np.testing.assert_allclose(late_cm[inner], height_cm(TIME_S - delay_ms / 1e3)[inner], atol=0.15)
    # Before the first row and after the last one the path goes on at its rate.
    assert np.abs(late_cm - height_cm(TIME_S - delay_ms / 1e3)).max() < 15.0


def test_there_is_no_path_across_an_edge() -> None:
    true_cm = height_cm(TIME_S) - np.where(np.arange(600) >= 300, 80.0, 0.0)
    late_cm = centre_cm(table(true_cm), latency={"delay_ms": 250.0})
    expected_cm = height_cm(TIME_S - 0.25)
    either = np.minimum(np.abs(late_cm - expected_cm), np.abs(late_cm - expected_cm + 80.0))
    # Beyond the edge a row is on one of the two sides, and on the right one but for the row at the edge.
    assert either[8:-8].max() < 1.0
    wrong = np.abs(late_cm - (expected_cm - np.where(TIME_S - 0.25 > EDGE_S, 80.0, 0.0))) > 40.0
    assert wrong[8:-8].sum() <= 1


def test_stamps_that_repeat_and_pauses_move_nothing_else() -> None:
    stamps = TIME_S.copy()
    stamps[250] = stamps[249]
    stamps[400:] += 60.0
    columns = table(height_cm(TIME_S)) | {"time_s": stamps}
    late_cm = centre_cm(columns, latency={"delay_ms": 200.0})
    off_cm = np.abs(late_cm - height_cm(TIME_S - 0.2))
    others = np.r_[8:247, 255:400, 404:590]
    assert off_cm[others].max() < 1.0
    assert off_cm.max() < 20.0


def test_a_part_of_a_table_is_shifted_by_the_path_of_the_whole() -> None:
    columns = with_path(table(height_cm(TIME_S)))
    whole_cm = columns[PATH].moved_cm(0.3)
    for part in (slice(100, 110), np.arange(0, 600, 37), TIME_S > 30.0):
        some = columns[PATH][part]
        assert isinstance(some, ReferencePath)
        np.testing.assert_array_equal(some.moved_cm(0.3), whole_cm[part])


def test_other_effects_are_those_of_the_scene_that_was() -> None:
    """A scale acts on the range at that time, and motion during the ping goes on from there."""
    columns = table(height_cm(TIME_S))
    scaled_cm = centre_cm(columns, range_scale={"scale_pct": 10.0}, latency={"delay_ms": 300.0})
    np.testing.assert_allclose(scaled_cm[8:-8], 1.1 * height_cm(TIME_S - 0.3)[8:-8], atol=0.2)
    both_cm = centre_cm(columns, motion_during_ping={"share": 1.0}, latency={"delay_ms": 300.0})
    then_s = TIME_S - 0.3 + height_cm(TIME_S - 0.3) / 34_470.0
    np.testing.assert_allclose(both_cm[8:-8], height_cm(then_s)[8:-8], atol=0.2)


def test_ranges_in_no_order_of_time_are_shifted_by_their_rates() -> None:
    true_cm = RNG.uniform(50.0, 400.0, 600)
    columns = table(true_cm) | {"range_rate_cm_s": RNG.normal(0.0, 50.0, 600)}
    late_cm = centre_cm(columns, latency={"delay_ms": 100.0})
    np.testing.assert_allclose(late_cm, true_cm - 0.1 * columns["range_rate_cm_s"])


def test_noise_of_the_reference_is_smoothed_and_prefers_no_delay() -> None:
    """An exact reference stays as it is; of one with noise, half an interval has no less of it than a whole one."""
    exact = with_path(table(height_cm(TIME_S)))
    np.testing.assert_array_equal(exact["true_range_cm"], height_cm(TIME_S))
    time_s: Array = np.arange(20_000, dtype=np.float64) * 0.05
    noisy_cm = height_cm(time_s) + RNG.normal(0.0, 2.0, time_s.size)
    given = {"time_s": time_s, "true_range_cm": noisy_cm, "true_range_std_cm": np.full(time_s.size, 2.0)}
    found = with_path(given)
    left_cm = np.std(found["true_range_cm"] - height_cm(time_s))
    assert left_cm < 1.3
    assert found["true_range_std_cm"][0] == pytest.approx(left_cm, abs=0.2)
    scatter = [
        np.std((found["true_range_cm"] + found[PATH].moved_cm(each) - height_cm(time_s - each))[20:-20])
        for each in (0.0, 0.05, 0.125, 0.2, 0.225)
    ]
    np.testing.assert_allclose(scatter, scatter[0], rtol=0.03)


def test_noise_that_no_table_states_is_smoothed_unless_readings_follow_it() -> None:
    time_s: Array = np.arange(4000, dtype=np.float64) * 0.05
    detail_cm = RNG.normal(0.0, 2.0, time_s.size)
    smooth_cm = height_cm(time_s - 0.2)
    given = {"time_s": time_s, "true_range_cm": height_cm(time_s) + detail_cm}
    blind = smooth_cm + RNG.normal(0.0, 2.0, time_s.size)
    assert np.std(with_path(given | {"reading_cm": blind})["true_range_cm"] - height_cm(time_s)) < 1.3
    # Rough ground: four rows later the sensor reads it.
    seen = given | {"reading_cm": blind + np.roll(detail_cm, 4)}
    np.testing.assert_array_equal(with_path(seen)["true_range_cm"], given["true_range_cm"])
    np.testing.assert_array_equal(with_path(given)["true_range_cm"], given["true_range_cm"])


def test_rows_far_from_each_other_go_on_at_their_recorded_rate() -> None:
    time_s: Array = np.arange(400, dtype=np.float64) * 0.5
    turns = 2.0 * np.pi * time_s / 5.0
    columns = {"time_s": time_s, "true_range_cm": height_cm(time_s)}
    wanted_cm = height_cm(time_s - 0.2)

    def off_cm(given: dict[str, Array]) -> float:
        found = with_path(given)
        return float(np.abs(found["true_range_cm"] + found[PATH].moved_cm(0.2) - wanted_cm)[2:-2].max())

    rate = 60.0 * 2.0 * np.pi / 5.0 * np.cos(turns)
    assert off_cm(columns | {"range_rate_cm_s": rate}) < 0.05 < 0.2 < off_cm(columns)


def test_at_another_time_only_what_follows_from_the_range_is_worked_out_again() -> None:
    scene = Scene(PLAIN.sensor, with_path(table(height_cm(TIME_S), throttle=np.linspace(0.0, 1.0, TIME_S.size))))
    for column, knots in (("throttle", (0.0, 0.5, 1.0)), ("true_range_cm", (150.0, 200.0, 250.0))):
        weights = knot_weights(scene, (column,), (knots,))
        assert knot_weights(scene, (column,), (knots,)) is weights
        later = knot_weights(scene.at(0.4), (column,), (knots,))
        assert (later is weights) == (column == "throttle")
        assert np.array_equal(later, weights) == (column == "throttle")


def test_ranges_at_the_stamps_are_worked_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    path = with_path(table(height_cm(TIME_S)))[PATH]
    asked = Mock(wraps=path.knots.at)
    monkeypatch.setattr(type(path.knots), "at", lambda _, time_s: asked(time_s))
    moved_cm = [path.moved_cm(ago_s) for ago_s in (0.1, 0.2, 0.1)]
    assert asked.call_count == 4
    np.testing.assert_array_equal(moved_cm[0], moved_cm[2])
    np.testing.assert_array_equal(path[5:9].moved_cm(0.1), moved_cm[0][5:9])
