"""Flights whose logs are as they come: turns, edges of the ground, pauses, stamps that repeat, any rate of readings.

A random generator enters, the readings' times and true ranges leave, and the path that they were taken from.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from evaluation.second_hand.rows import Floats, Rows

LONGEST_S = 1.0
"""Paths begin and end so long before and after the readings, so that a late or early one has a range too."""
LOWEST_CM = 30.0
"""No range is shorter [cm]."""


@dataclass(frozen=True)
class Log:
    """What a log does to the readings of a table."""

    rows: int
    """Readings of all runs together, about."""
    edges: float
    """Edges of the ground per minute, up or down by 10 to 80 cm."""
    pauses: float
    """Pauses of 2 to 20 s per minute, in which nothing is recorded."""
    repeated: float
    """Share of the readings with the stamp of the one before."""
    noise_cm: float
    """Standard deviation of white noise of the reference."""
    names_noise: bool
    names_rate: bool
    """Whether the table has the reference's standard deviation, and the vehicle's vertical speed."""


def draw_log(rng: Generator, rows: int) -> Log:
    """Draw what the log of a table is like: half of them have each fault."""

    def some(low: float, high: float) -> float:
        return float(rng.uniform(low, high)) if rng.random() < 0.5 else 0.0

    return Log(
        rows, some(2, 12), some(0.5, 3), some(0.002, 0.02), some(0.3, 2.0), rng.random() < 0.5, rng.random() < 0.5
    )


def draw_flights(rng: Generator, log: Log) -> Rows:
    """Draw the runs of a table, with the reference as it is in truth."""
    runs = int(rng.integers(6, 21))
    spacing_s = float(rng.choice([0.02, 0.05, 0.1, 0.1, 0.15]))
    jitter = float(rng.choice([0.0, 0.03, 0.1]))
    counts = np.maximum(rng.dirichlet(np.full(runs, 8.0)) * log.rows, 60).astype(int)
    parts: list[tuple[Floats, Callable[[Floats], Floats], dict[str, Floats]]] = []
    for count in counts.tolist():
        time_s = _times(rng, count, spacing_s, jitter, log.pauses)
        path = _path(rng, float(time_s[-1]))
        edges = _edges(rng, float(time_s[-1]), log.edges)
        parts.append((time_s, _over(path, edges), _contexts(rng, time_s, path)))

    def range_before(delay_s: float) -> Floats:
        return np.concatenate([path(time_s - delay_s) for time_s, path, _ in parts])

    run = np.repeat(np.arange(runs), counts)
    return Rows(
        run=run,
        sensor=np.zeros(run.size, dtype=np.int64),
        block=run,
        time_s=np.concatenate([time_s for time_s, _, _ in parts]),
        true_cm=range_before(0.0),
        range_before=range_before,
        contexts={name: np.concatenate([contexts[name] for _, _, contexts in parts]) for name in parts[0][2]},
        spacing_s=spacing_s,
    )


def late(rows: Rows, delay_s: float) -> Rows:
    """The same readings of what was there a delay [s] before their stamps."""
    return replace(rows, true_cm=rows.range_before(delay_s))


def logged(rng: Generator, rows: Rows, log: Log) -> dict[str, NDArray[Any]]:
    """The columns of the log but for the readings: stamps as they repeat, and the reference with its noise."""
    again = (rng.random(len(rows)) < log.repeated) & (rows.previous() >= 0)
    stamps = np.where(again, rows.time_s[rows.previous()], rows.time_s)
    columns: dict[str, NDArray[Any]] = {
        "time_s": np.round(stamps, 4),
        "sensor": np.full(len(rows), "down"),
        "run": np.array([f"run{number + 1:02d}" for number in rows.run]),
        "true_range_cm": np.round(rows.true_cm + log.noise_cm * rng.standard_normal(len(rows)), 2),
    }
    if log.noise_cm and log.names_noise:
        columns["true_range_std_cm"] = np.full(len(rows), round(log.noise_cm, 2))
    left_out = frozenset() if log.names_rate else frozenset({"range_rate_cm_s"})
    return columns | {name: column for name, column in rows.contexts.items() if name not in left_out}


def _times(rng: Generator, count: int, spacing_s: float, jitter: float, pauses: float) -> Floats:
    steps_s = spacing_s * (1.0 + jitter * rng.standard_normal(count).clip(-3, 3))
    starts = rng.random(count) < pauses * spacing_s / 60.0
    steps_s[starts] += rng.uniform(2.0, 20.0, int(starts.sum()))
    return np.asarray(np.round(np.cumsum(steps_s), 4), dtype=np.float64)


def _path(rng: Generator, last_s: float) -> Callable[[Floats], Floats]:
    """Range [cm] over time [s]: climbs and descents with rounded or sharp turns, and a bobbing on top."""
    legs_s, time_s = [], -LONGEST_S
    while time_s < last_s + LONGEST_S:
        legs_s.append(time_s)
        time_s += float(rng.uniform(1.5, 8.0))
    knots_s = np.array([*legs_s, time_s])
    levels = np.clip(np.cumsum(rng.uniform(-1, 1, knots_s.size) * rng.uniform(60, 250)) + 220, 60, 480)
    stays = rng.random(knots_s.size) < 0.3
    stays[0] = False
    levels = levels[np.maximum.accumulate(np.where(stays, 0, np.arange(knots_s.size)))]
    turn_s = float(rng.choice([0.0, 0.3, 1.0]))
    swing_cm, period_s = rng.uniform(0, 25), rng.uniform(1.2, 8.0)
    phase = rng.uniform(0, 2 * np.pi)
    around_s = np.linspace(-0.5, 0.5, 9) * turn_s

    def path(time_s: Floats) -> Floats:
        # A mean over a window rounds the corners.
        way = np.mean([np.interp(time_s + each, knots_s, levels) for each in around_s], axis=0)
        found: Floats = way + swing_cm * np.sin(2 * np.pi * time_s / period_s + phase)
        return found

    return path


def _edges(rng: Generator, last_s: float, per_minute: float) -> tuple[Floats, Floats]:
    """Times [s] and heights [cm] of the ground from each of them on."""
    at_s = np.sort(rng.uniform(0.0, last_s, int(rng.poisson(per_minute * last_s / 60.0))))
    heights = np.where(np.arange(at_s.size) % 2 == 0, rng.uniform(10.0, 80.0, at_s.size), 0.0)
    return at_s, np.concatenate([[0.0], heights])


def _over(path: Callable[[Floats], Floats], edges: tuple[Floats, Floats]) -> Callable[[Floats], Floats]:
    at_s, heights = edges

    def over(time_s: Floats) -> Floats:
        return np.maximum(path(time_s) - heights[np.searchsorted(at_s, time_s)], LOWEST_CM)

    return over


def _contexts(rng: Generator, time_s: Floats, path: Callable[[Floats], Floats]) -> dict[str, Floats]:
    speed = (path(time_s + 0.01) - path(time_s - 0.01)) / 0.02
    knots_s = np.arange(0.0, time_s[-1] + 6.0, 3.0)
    slow = np.interp(time_s, knots_s, rng.standard_normal(knots_s.size))
    tilt = np.interp(time_s, knots_s, 6.0 * rng.standard_normal(knots_s.size))
    throttle = np.clip(0.5 + 0.1 * slow + 0.0008 * speed, 0.0, 1.0)
    return {
        "range_rate_cm_s": np.round(speed, 1),
        "throttle": np.round(throttle, 3),
        "incidence_deg": np.round(tilt, 2),
        "air_temperature_c": np.round(rng.uniform(5, 30) + 0.5 * slow, 1),
        "vibration_hz": np.where(slow > 0.4, 70.0, 0.0),
    }
