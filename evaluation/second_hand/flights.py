"""Runs of a vehicle: ranges of ramps, sinusoids and steps, contexts that drift, pings with jitter and dropouts."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from evaluation.second_hand.rows import Floats, Rows

BEFORE_S = 3.0
"""Profiles begin this long before the first reading, so that a late reading has a range too."""


@dataclass(frozen=True)
class Design:
    """What a hidden effect asks of the runs."""

    columns: frozenset[str] = frozenset()
    """Contexts that must be in the table."""
    low: bool = False
    """The ranges go down to the sensor's minimum."""
    smooth: bool = False
    """The ground has no steps: a delay has no finite information where the range jumps."""
    sensors: int = 0
    """Number of sensors in the table; 0 draws it."""
    many_runs: bool = False
    """At least 12 runs: the effect varies between runs only."""
    longest: int = 600
    """Most rows of a run."""
    tape: bool = False
    """The bench's ranges are few, and err by `TAPE_STD_CM`."""

    def __or__(self, other: "Design") -> "Design":
        return Design(
            self.columns | other.columns,
            self.low or other.low,
            self.smooth or other.smooth,
            max(self.sensors, other.sensors),
            self.many_runs or other.many_runs,
            min(self.longest, other.longest),
            self.tape or other.tape,
        )


CONTEXTS = (
    "air_temperature_c",
    "humidity_pct",
    "incidence_deg",
    "range_rate_cm_s",
    "throttle",
    "vibration_hz",
    "supply_v",
    "x_m",
    "anchor",
    "neighbour",
)
"""Contexts that a table may have; ``neighbour`` stands for the two columns of a neighbouring sensor."""
TAPE_STD_CM = 0.5
TAPE_RANGES = 16
"""Standard deviation of the error of a placement that a tape measured, and how many placements such a bench has. Its
scale is then known to 0.07 %, and that of 2,000 readings in flight to 0.03 %."""
CONTEXT_SHARE = 0.6
"""Probability of a context that no effect asks for: most tables have columns that do nothing."""


def draw_flights(rng: Generator, design: Design) -> Rows:
    """Draw the runs of a table: 6 to 20 of 100 rows to the longest."""
    runs = int(rng.integers(12 if design.many_runs else 6, 21))
    sensors = design.sensors or (2 if rng.random() < 0.25 else 1)
    spacing = rng.uniform(0.06, 0.15)
    jitter = rng.uniform(0.01, 0.1)
    ground_steps = not design.smooth and rng.random() < 0.5
    shown = {name for name in CONTEXTS if name in design.columns or rng.random() < CONTEXT_SHARE}
    wires = rng.uniform(0, 12)
    parts, profiles = [], []
    for run in range(runs):
        count = int(rng.integers(100, design.longest + 1))
        time = _ping_times(rng, count, spacing, jitter)
        profile, rate = _profile(rng, time[-1], design.low, ground_steps)
        contexts = _contexts(rng, time, profile, rate, wires, run)
        sensor = np.arange(count) % sensors
        parts.append((np.full(count, run), sensor, time, contexts))
        profiles.append((profile, time))
    run_of = np.concatenate([part[0] for part in parts])
    sensor_of = np.concatenate([part[1] for part in parts])
    contexts_of = {name: np.concatenate([part[3][name] for part in parts]) for name in parts[0][3]}

    def range_before(delay_s: float) -> Floats:
        return np.concatenate([profile(time - delay_s) for profile, time in profiles])

    return Rows(
        run=run_of,
        sensor=sensor_of,
        block=run_of * sensors + sensor_of,
        time_s=np.concatenate([part[2] for part in parts]),
        true_cm=range_before(0.0),
        range_before=range_before,
        contexts=shown_contexts(contexts_of, shown),
        spacing_s=spacing * sensors,
    )


def shown_contexts(contexts: Mapping[str, NDArray[Any]], shown: Collection[str]) -> dict[str, NDArray[Any]]:
    """Columns of these of `CONTEXTS`."""
    return {name: each for name, each in contexts.items() if {name, name.partition("_")[0]} & set(shown)}


def draw_bench(rng: Generator, flights: Rows, tape: bool = False) -> Rows:
    """The same sensors, still before a wall at 48 ranges, 50 readings each per sensor, in four sessions.

    Where a tape measured the ranges there are fewer, with as many readings in all, and each errs.
    """
    spacing_s, sensors = flights.spacing_s, int(flights.sensor.max()) + 1
    ranges, sessions = TAPE_RANGES if tape else 48, 4
    repeats = 2400 // ranges
    true = np.round(np.linspace(24, 620, ranges) + rng.uniform(-4, 4, ranges), 1)
    session = np.arange(ranges) % sessions
    order = np.lexsort((rng.permutation(ranges), session))
    pings = repeats * sensors
    place = np.repeat(order, pings)
    sensor = np.tile(np.arange(sensors), ranges * repeats)
    time = np.empty(len(place))
    clock = np.zeros(sessions)
    for number, index in enumerate(order.tolist()):
        rows = slice(number * pings, (number + 1) * pings)
        time[rows] = clock[session[index]] + np.cumsum(
            spacing_s / sensors * (1 + 0.03 * rng.standard_normal(pings).clip(-3, 3))
        )
        clock[session[index]] = time[rows][-1] + 20.0
    true_cm = true[place]
    return Rows(
        run=session[place],
        sensor=sensor,
        block=place * sensors + sensor,
        time_s=time,
        true_cm=true_cm,
        range_before=lambda delay_s: true_cm,
        contexts={
            "air_temperature_c": np.full(len(place), 22.5),
            "incidence_deg": np.zeros(len(place)),
            "range_rate_cm_s": np.zeros(len(place)),
            "throttle": np.zeros(len(place)),
        },
        spacing_s=spacing_s,
        placed_cm=TAPE_STD_CM * rng.standard_normal(ranges)[place] if tape else 0.0,
    )


def _ping_times(rng: Generator, count: int, spacing_s: float, jitter: float) -> Floats:
    steps = spacing_s * (1 + jitter * rng.standard_normal(count).clip(-3, 3))
    lost = rng.random(count) < 0.01
    steps[lost] += spacing_s * rng.integers(1, 20, lost.sum())
    return np.asarray(np.round(np.cumsum(steps), 4), dtype=np.float64)


def _wander(rng: Generator, time: Floats, period_s: float) -> Floats:
    """A smooth random function of time of about unit size."""
    knots = np.arange(0, time[-1] + 2 * period_s, period_s)
    values = rng.standard_normal(len(knots))
    return 1.2 * np.interp(time, knots, values)


def _profile(
    rng: Generator, last_s: float, low: bool, ground_steps: bool
) -> tuple[Callable[[Floats], Floats], Callable[[Floats], Floats]]:
    """True range [cm] over time [s], and its rate [cm/s] without the steps of the ground."""
    levels = int(rng.integers(4, 9))
    places = rng.uniform(60, rng.uniform(250, 520), levels)
    if low:
        places[rng.integers(levels)] = rng.uniform(22, 30)
        places[rng.integers(levels)] = rng.uniform(30, 60)
    share = np.cumsum(np.concatenate([[0.0], rng.uniform(0.3, 1.0, 2 * levels - 1)]))
    times = -BEFORE_S + share / share[-1] * (last_s + BEFORE_S)
    heights = np.repeat(places, 2)
    period = rng.uniform(4, 15)
    amplitude = rng.uniform(0, 25) if rng.random() < 0.6 else 0.0
    phase = rng.uniform(0, 2 * np.pi)
    box_edges = np.sort(rng.uniform(0, last_s, 2 * int(rng.integers(1, 5)))) if ground_steps else np.array([])
    box_height = rng.uniform(10, 45)

    def smooth(time: Floats) -> Floats:
        plain = np.interp(time, times, heights)
        # The swaying dies out near the ground, so that no range is below 20 cm.
        room = np.clip((plain - 22) / 40, 0, 1)
        found: Floats = plain + room * amplitude * np.sin(2 * np.pi * time / period + phase)
        return found

    def profile(time: Floats) -> Floats:
        z = smooth(time)
        inside = np.searchsorted(box_edges, time) % 2 == 1
        return z - np.where(inside & (z > box_height + 60), box_height, 0.0)

    def rate(time: Floats) -> Floats:
        return (smooth(time + 0.01) - smooth(time - 0.01)) / 0.02

    return profile, rate


def _contexts(
    rng: Generator,
    time: Floats,
    profile: Callable[[Floats], Floats],
    rate: Callable[[Floats], Floats],
    wires: float,
    run: int,
) -> dict[str, NDArray[Any]]:
    """Columns of one run; what they have to do with each other is what a vehicle makes of them."""
    count, last = len(time), time[-1]
    speed = rate(time)
    gusts = _wander(rng, time, rng.uniform(1, 6))
    throttle = np.clip(rng.uniform(0.35, 0.65) + 0.12 * gusts + 0.001 * speed, 0.0, 1.0)
    if rng.random() < 0.5:
        throttle = np.where(
            np.sin(2 * np.pi * time / rng.uniform(8, 30)) > 0.3, np.clip(throttle + 0.25, 0, 1), throttle
        )
    temperature = rng.uniform(-4, 36) + rng.uniform(-4, 4) * time / last + 0.4 * _wander(rng, time, 10)
    humidity = np.clip(rng.uniform(25, 95) + rng.uniform(-6, 6) * time / last, 5, 100)
    sway = rng.uniform(3, 9) * np.sin(2 * np.pi * time / rng.uniform(3, 12) + rng.uniform(0, 6))
    incidence = sway + rng.uniform(1, 6) * _wander(rng, time, 2.5)
    shaken = np.sin(2 * np.pi * time / rng.uniform(10, 40) + rng.uniform(0, 6)) > rng.uniform(-0.5, 0.7)
    supply = rng.uniform(4.8, 5.3) - rng.uniform(0, 0.3) * time / last - 0.2 * (throttle - 0.5)
    legs = np.cumsum(rng.uniform(5, 15, int(last / 5) + 2))
    x = np.interp(time, np.concatenate([[0.0], legs]), rng.uniform(-10, 10, len(legs) + 1))
    anchor = np.array(["a1", "a2", "a3", "a4"])[
        rng.integers(0, 4, int(last / 4) + 2)[(time / rng.uniform(4, 9)).astype(int)]
    ]
    lag = np.clip(wires + rng.uniform(-0.5, 0.5, count) + 4 * (rng.random(count) < 0.3), 0.2, 60)
    other = np.clip(profile(time) + rng.uniform(-30, 60) + 15 * _wander(rng, time, 5), 25, 700)
    return {
        "air_temperature_c": np.round(temperature, 2),
        "humidity_pct": np.round(humidity, 1),
        "incidence_deg": np.round(incidence, 2),
        "range_rate_cm_s": np.round(speed, 2),
        "throttle": np.round(throttle, 3),
        "vibration_hz": np.where(shaken, np.round(60 + 30 * throttle), 0.0),
        "supply_v": np.round(supply, 3),
        "x_m": np.round(x, 3),
        "anchor": anchor,
        "neighbour_lag_ms": np.round(lag, 2),
        "neighbour_range_cm": np.round(other, 1),
    }
