"""Effects that are in nobody's catalogue: over columns of one's own, fine ripples, thresholds, and drift."""

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from evaluation.second_hand.effect import Apply, Kind, favours, moves, widens
from evaluation.second_hand.flights import Design
from evaluation.second_hand.rows import Floats, Rows

Shape = Callable[[Generator, Rows], Floats]


def _kind(title: str, channel: str, variable: str, shape: Shape, smooth: bool = False) -> Kind:
    """An effect that adds ``size * shape`` to a channel: cm to a hit, a factor of e to sigma, log odds to a share."""
    design = Design(frozenset({variable} - {"true_range_cm", "time_s"}), smooth=smooth)
    limit, start = {"bias": (12.0, 0.3), "spread": (3.0, 0.2)}.get(channel, (5.0, 1.0))

    def change(rng: Generator, rows: Rows) -> tuple[Apply, dict[str, float]]:
        curve = shape(rng, rows)
        if channel not in ("bias", "spread"):
            return favours(channel, lambda size: size * curve), {}
        curve = curve * rng.choice([-1.0, 1.0])
        return moves(lambda size: size * curve) if channel == "bias" else widens(lambda size: np.exp(size * curve)), {}

    return Kind(title, design, change, limit, start, channel=channel, variable=variable)


def _linear(column: str) -> Shape:
    """The column with mean 0 and standard deviation 1."""

    def shape(rng: Generator, rows: Rows) -> Floats:
        values: Floats = rows.contexts[column]
        found: Floats = (values - values.mean()) / max(float(values.std()), 1e-9)
        return found

    return shape


def _one_anchor(rng: Generator, rows: Rows) -> Floats:
    return np.asarray(rows.contexts["anchor"] == rng.choice(["a1", "a2", "a3", "a4"]), dtype=float)


def _bump(rng: Generator, rows: Rows) -> Floats:
    width, place = rng.uniform(1.0, 3.0), rng.uniform(-4, 4)
    return np.exp(-(((rows.contexts["x_m"] - place) / width) ** 2))


def _beyond(column: str, low: float, high: float) -> Shape:
    def shape(rng: Generator, rows: Rows) -> Floats:
        values = rows.contexts[column]
        return np.asarray(values > np.quantile(values, rng.uniform(low, high)), dtype=float)

    return shape


def _ripple_over_range(rng: Generator, rows: Rows) -> Floats:
    found: Floats = np.sin(2 * np.pi * rows.true_cm / rng.uniform(10, 40) + rng.uniform(0, 2 * np.pi))
    return found


def _ripple_over_time(rng: Generator, rows: Rows) -> Floats:
    found: Floats = np.sin(2 * np.pi * rows.time_s / rng.uniform(1.5, 12) + rng.uniform(0, 2 * np.pi))
    return found


def _drift(rng: Generator, rows: Rows) -> Floats:
    found: Floats = rows.time_s / rows.time_s.max()
    return found


def _speed(rng: Generator, rows: Rows) -> Floats:
    found: Floats = np.abs(rows.contexts["range_rate_cm_s"]) / 50
    return found


def _climbing(rng: Generator, rows: Rows) -> Floats:
    return (rows.contexts["range_rate_cm_s"] > 5).astype(float)


UNKNOWN = (
    _kind("supply_bias", "bias", "supply_v", _linear("supply_v")),
    _kind("anchor_bias", "bias", "anchor", _one_anchor),
    _kind("place_bias", "bias", "x_m", _bump),
    _kind("throttle_threshold", "bias", "throttle", _beyond("throttle", 0.4, 0.8)),
    _kind("ripple_over_range", "bias", "true_range_cm", _ripple_over_range, smooth=True),
    _kind("ripple_over_time", "bias", "time_s", _ripple_over_time),
    _kind("drift_in_run", "bias", "time_s", _drift),
    _kind("speed_spread", "spread", "range_rate_cm_s", _speed),
    _kind("supply_spread", "spread", "supply_v", _linear("supply_v")),
    _kind("anchor_spread", "spread", "anchor", _one_anchor),
    _kind("place_missed", "missed", "x_m", _bump),
    _kind("anchor_missed", "missed", "anchor", _one_anchor),
    _kind("climbing_short", "short", "range_rate_cm_s", _climbing),
    _kind("supply_random", "random", "supply_v", _linear("supply_v")),
    _kind("throttle_random", "random", "throttle", _linear("throttle")),
)
