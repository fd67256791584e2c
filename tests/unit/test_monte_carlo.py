"""Many flights: what is counted in one, how they are kept, and the numbers of all, without flying any."""

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binomtest

from msp_range.config import load_airframe
from msp_range.mavlink.dialect import dialect
from msp_range.yaml_file import ConfigError
from msp_sim.flight.autopilot import AutopilotSection
from msp_sim.flight.flight_log import FlightResult, SensorTrack
from msp_sim.intervals import quantile, wilson
from msp_sim.monte_carlo.outcome import judged
from msp_sim.monte_carlo.store import FLIGHTS, NUMBER, FlightStore
from msp_sim.monte_carlo.summary import Quantile, summarise

AIRFRAME = load_airframe("quad_pallet")
COLUMNS = ("wrong_s", "silent_s", "longest_silence_s", "error_p95_cm", "faults")
DURATION_S = 20.0


def message(current_cm: int, quality: int = 90) -> Any:
    """A DISTANCE_SENSOR of the fused stream."""
    assert AIRFRAME.send.fused is not None
    values = {"id": AIRFRAME.send.fused.id, "min_distance": 20, "max_distance": 700, "current_distance": current_cm}
    return SimpleNamespace(get_type=lambda: "DISTANCE_SENSOR", signal_quality=quality, **values)


def text(severity: int) -> Any:
    return SimpleNamespace(get_type=lambda: "STATUSTEXT", severity=severity)


def heartbeat(state: int) -> Any:
    return SimpleNamespace(get_type=lambda: "HEARTBEAT", system_status=state)


def numbers(received: list[tuple[float, Any]], below_m: float | None = 3.0) -> dict[str, Any]:
    """The numbers of a flight at one true distance, with a reading every 0.1 s."""
    times_s = [0.1 * i for i in range(round(10 * DURATION_S))]
    track = SensorTrack(times_s, [], [], [], [], [below_m] * len(times_s))
    flight = FlightResult({"front_left": track}, SensorTrack(), [])
    return judged(flight, received, AIRFRAME, AutopilotSection(), DURATION_S)


def sent(*changes: tuple[float, float, Any], every_s: float = 0.1) -> list[tuple[float, Any]]:
    """A right distance every 0.1 s, but other messages (None: no message) from a time to another."""
    found = []
    for time_s in np.arange(0.05, DURATION_S, every_s):
        others = [other for from_s, to_s, other in changes if from_s <= time_s < to_s]
        each = others[0] if others else message(301)
        if each is not None:
            found.append((float(time_s), each))
    return found


def test_a_right_flight_has_its_error_and_nothing_else() -> None:
    found = numbers(sent())
    assert (found["wrong_s"], found["silent_s"], found["unreported_silences"]) == (0.0, 0.0, 0)
    assert [found[key] for key in ("error_bias_cm", "error_rms_cm", "error_p95_cm", "error_worst_cm")] == [1.0] * 4


@pytest.mark.parametrize(
    ("current_cm", "lasts_s", "wrong_s"),
    [(352, 2.0, 2.0), (352, 0.5, 0.0), (350, 2.0, 0.0), (248, 2.0, 2.0), (765, 2.0, 2.0)],
    ids=["too far", "too short a time", "not far enough", "too near", "above the maximum"],
)
def test_wrong_distances_are_timed(current_cm: int, lasts_s: float, wrong_s: float) -> None:
    quality = 1 if current_cm > 700 else 90
    found = numbers(sent((5.0, 5.0 + lasts_s, message(current_cm, quality))))
    assert found["wrong_s"] == pytest.approx(wrong_s, abs=0.11)
    assert (found["wrong_s"] > 0) == (wrong_s > 0)


def test_nothing_is_wrong_where_there_is_no_true_distance() -> None:
    found = numbers(sent((5.0, 9.0, message(600))), below_m=None)
    assert found["wrong_s"] == 0.0
    assert found["error_rms_cm"] is None


def test_silences_are_timed_and_must_be_reported_in_time() -> None:
    quiet = sent((5.0, 8.0, None), (10.0, 10.7, None))
    silence = numbers(quiet)
    assert silence["longest_silence_s"] == silence["silent_s"] == pytest.approx(3.1, abs=0.01)
    assert silence["unreported_silences"] == 1
    for extra, unreported in (
        ((5.5, text(dialect.MAV_SEVERITY_WARNING)), 0),
        ((5.5, text(dialect.MAV_SEVERITY_INFO)), 1),
        ((7.9, text(dialect.MAV_SEVERITY_WARNING)), 1),
        ((5.5, heartbeat(dialect.MAV_STATE_CRITICAL)), 0),
        ((5.5, heartbeat(dialect.MAV_STATE_ACTIVE)), 1),
    ):
        received = sorted([*quiet, extra], key=lambda each: each[0])
        assert numbers(received)["unreported_silences"] == unreported


def test_a_message_of_no_use_does_not_end_a_silence() -> None:
    assert numbers(sent((5.0, 8.0, message(0, 1))))["longest_silence_s"] == pytest.approx(3.1, abs=0.01)


def row(number: int) -> dict[str, Any]:
    """A flight that is the worse the larger its number is; every tenth is wrong."""
    wrong_s = 1.0 * number if number % 10 == 0 else 0.0
    return {"wrong_s": wrong_s, "silent_s": 0.0, "longest_silence_s": 0.0, "error_p95_cm": number / 4, "faults": ""}


def test_flights_are_kept_and_an_interrupted_table_is_resumed(tmp_path: Path) -> None:
    store = FlightStore(tmp_path, COLUMNS, {"seed": 1})
    for number in (0, 1, 4):
        store.add(number, row(number))
    store.close()
    table = tmp_path / FLIGHTS
    # Killed while it wrote: the last row is not complete.
    table.write_text(table.read_text(encoding="utf-8") + "5,0.0,0.", encoding="utf-8")
    again = FlightStore(tmp_path, COLUMNS, {"seed": 1})
    assert [each[NUMBER] for each in again.rows] == [0, 1, 4]
    for number in (2, 3):
        again.add(number, row(number))
    again.close()
    whole = FlightStore(tmp_path / "whole", COLUMNS, {"seed": 1})
    for number in range(5):
        whole.add(number, row(number))
    whole.close()
    assert table.read_bytes() == (tmp_path / "whole" / FLIGHTS).read_bytes()
    assert again.rows == whole.rows


@pytest.mark.parametrize("value", [3, 0.25, math.inf, -math.inf, True, False, None, "grass", "[1, 2]", "(1)", "None"])
def test_a_value_of_a_flight_is_read_as_it_was_written(value: object, tmp_path: Path) -> None:
    store = FlightStore(tmp_path, ["drawn"], {"seed": 1})
    store.add(0, {"drawn": value})
    store.close()
    again = FlightStore(tmp_path, ["drawn"], {"seed": 1})
    again.close()
    found = again.rows[0]["drawn"]
    assert (found, type(found)) == (value, type(value))


@pytest.mark.parametrize(("count", "of"), [(0, 20), (81, 263), (20, 20), (9, 10)])
def test_the_interval_of_a_share_is_scipy_s(count: int, of: int) -> None:
    low, high = binomtest(count, of).proportion_ci(0.95, "wilson")
    assert wilson(count, of) == pytest.approx((low, high), abs=1e-12)


def test_the_interval_of_a_weighted_count_keeps_its_fraction() -> None:
    (low, high), (lower, higher) = wilson(0.9, 10.0), wilson(0.0, 10.0)
    assert low > lower
    assert high > higher


def test_flights_of_another_seed_are_not_mixed(tmp_path: Path) -> None:
    FlightStore(tmp_path, COLUMNS, {"seed": 1, "version": "a"}).close()
    with pytest.raises(ConfigError, match="holds flights with another seed; name another --out"):
        FlightStore(tmp_path, COLUMNS, {"seed": 2, "version": "a"})


def test_the_summary_counts_flights() -> None:
    rows = [{NUMBER: number, **row(number)} for number in range(1, 101)]
    found = summarise(rows, {200: "why"})
    shares = {each.what: each for each in found.shares}
    wrong = shares["a distance 50 cm off for over 0.5 s"]
    assert (wrong.flights, wrong.of) == (10, 100)
    assert (wrong.low, wrong.high) == pytest.approx((0.0552, 0.1744), abs=1e-4)
    assert shares["a time without a distance"].flights == 0
    errors = next(each for each in found.distributions if each.column == "error_p95_cm")
    assert errors.quantiles[0] == Quantile(0.5, 12.5, 10.0, 15.25)
    assert errors.quantiles[2].high is None
    assert [each[NUMBER] for each in found.worst] == [100, 90, 80, 70, 60]
    assert found.failed == {200: "why"}


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_intervals_of_quantiles_contain_the_true_one_in_95_of_100_cases(share: float) -> None:
    generator = np.random.default_rng(3)
    inside = 0
    for _ in range(400):
        _, low, high = quantile(generator.random(60).tolist(), share)
        assert low is not None
        inside += low <= share <= (1.0 if high is None else high)
    low, high = wilson(inside, 400)
    assert high > 0.95
    assert inside / 400 < 0.995
