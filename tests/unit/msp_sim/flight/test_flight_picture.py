"""What the picture of a flight says: gaps stay gaps, edges are marked, and the title tells what happened."""

import math
from pathlib import Path

import numpy as np
import pytest

from msp_sim.flight.flight_log import FlightResult, SensorTrack
from msp_sim.flight.flight_picture import _Arrays, _edges, _interrupted, _what_happened, draw


def track(times_s: list[float], why: list[str | None]) -> SensorTrack:
    values: list[float | None] = [1.0] * len(times_s)
    return SensorTrack(times_s, list(values), list(values), list(values), why, list(values))


def test_a_line_is_interrupted_where_nothing_was_known() -> None:
    times_s, values = _interrupted(np.array([0.0, 0.5, 3.0]), np.array([1.0, 1.0, 2.0]))
    assert times_s.tolist() == [0.0, 0.5, 3.0, 3.0]
    assert math.isnan(values[2])


def test_edges_are_spans() -> None:
    times_s = [0.1 * i for i in range(100)]
    fused = track(times_s, ["edge" if 10 <= i < 20 or 60 <= i < 62 else None for i in range(100)])
    assert [(round(a, 1), round(b, 1)) for a, b in _edges(_Arrays(fused))] == [(1.0, 1.9), (6.0, 6.1)]


def test_what_was_not_used_is_counted_by_its_reason() -> None:
    left = track([0.0, 1.0, 2.0, 3.0], [None, "outlier", "outlier", "at_minimum"])
    flight = FlightResult({"left": left, "right": SensorTrack()}, SensorTrack(), [])
    assert flight.rejected == {"left": {"outlier": 2}, "right": {}}


@pytest.mark.slow
def test_the_title_tells_what_happened(tmp_path: Path) -> None:
    left = track([0.0, 1.0, 2.0, 3.0], [None, "outlier", "suspect", "at_minimum"])
    fused = track([0.0, 0.5, 4.0], [None, None, None])
    texts = [(1.0, "error", "Range left: no answer"), (2.0, "info", "Range left: good again")]
    flight = FlightResult({"left": left}, fused, texts)
    assert _what_happened(flight) == "2 of 4 readings used, 3.5 s without a distance, 1 warning to the pilot"
    calm = FlightResult({"left": track([0.0, 1.0], [None, None])}, track([0.0, 1.0], [None, None]), [])
    assert _what_happened(calm) == "2 of 2 readings used"
    for number, each in enumerate((flight, calm, FlightResult({"left": left}, SensorTrack(), []))):
        draw(each, tmp_path / f"{number}.png", "a flight")
        assert (tmp_path / f"{number}.png").stat().st_size > 1000
