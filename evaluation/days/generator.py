"""Cases: readings whose noise is correlated for minutes and whose runs are days, or whose runs have words of their own.

``case("slow:scale", 7)`` is always the same case. A table of ``slow`` is a sensor over water: one reading every one to
five minutes for 6 to 14 days, each a run. A table of ``words`` is 8 to 20 flights, each over a surface and with one of
five batteries; one of ``weather`` has five more columns that are the same all over a flight. All noise is normal:
white, one Ornstein-Uhlenbeck process, and an offset of each run. The bench table is minutes long and still, so that it
shows the white part alone. An effect has the size of ten standard errors by generalised least squares with that noise,
next to an offset and a scale. No number here comes from another generator.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from evaluation.second_hand.generator import Case, rng_of

Array = NDArray[np.floating[Any]]
Columns = dict[str, NDArray[Any]]

STANDARD_ERRORS = 10.0
DAY_S = 86_400.0
MISSED_CM = 765.0
"""A reading without an echo (MB1242 datasheet)."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations [cm] of white noise, of the process that lasts, and of the runs' offsets; its time [s]."""

    white_cm: float
    lasting_cm: float
    lasts_s: float
    of_runs_cm: float

    def covariance(self, time_s: Array) -> Array:
        """Of the readings of one run, (n, n) [cm^2]."""
        apart_s = np.abs(np.subtract.outer(time_s, time_s))
        lasting = self.lasting_cm**2 * np.exp(-apart_s / self.lasts_s)
        return lasting + self.of_runs_cm**2 + self.white_cm**2 * np.eye(time_s.size)


@dataclass(frozen=True)
class Table:
    """What is drawn before an effect: columns, the run of each row, and the noise."""

    columns: Columns
    run: NDArray[np.intp]
    noise: Noise

    @property
    def time_s(self) -> Array:
        """Of each row, (n,)."""
        return np.asarray(self.columns["time_s"], dtype=float)

    @property
    def true_cm(self) -> Array:
        """The true range, (n,)."""
        return np.asarray(self.columns["true_range_cm"], dtype=float)


@dataclass(frozen=True)
class Hidden:
    """An effect: how much each row moves by a size of 1 [cm], largest plausible size, and what it may be called.

    ``names`` are effects of `msp-lab effects`; where there are none, ``variable`` is what a curve has to be over.
    """

    title: str
    moves: Callable[[Table], Array]
    largest: float
    names: frozenset[str] = frozenset()
    variable: str = ""


def _scale(table: Table) -> Array:
    return table.true_cm / 100.0


def _temperature(table: Table) -> Array:
    """Of what is left of a bare sensor's error, by the calibration temperature in ``sensor.yaml``, 22.5 C."""
    air_c = table.columns["air_temperature_c"]
    return table.true_cm * (np.sqrt(295.65 / (273.15 + air_c)) - 1.0)


def _day(table: Table) -> Array:
    found: Array = np.cos(2.0 * np.pi * (table.time_s / DAY_S - 0.6))
    return found


def _supply(table: Table) -> Array:
    return table.columns["supply_v"] - 5.0


def _warm_up(table: Table) -> Array:
    return np.exp(-table.columns["uptime_s"] / 900.0)


def _grass(table: Table) -> Array:
    return np.asarray(table.columns["surface"] == "grass", dtype=float)


def _session(table: Table) -> Array:
    return np.asarray(table.run == table.run.max() // 2, dtype=float)


def _battery(table: Table) -> Array:
    return np.asarray(table.columns["battery"], dtype=float) - 3.0


SLOW = (
    Hidden("scale", _scale, 4.0, frozenset({"range_scale", "thermometer_offset"})),
    Hidden("temperature", _temperature, 1.2, frozenset({"air_temperature"})),
    Hidden("day", _day, 6.0, frozenset({"day_cycle"}), "time_of_day_h"),
    Hidden("supply", _supply, 30.0, variable="supply_v"),
    Hidden("warm_up", _warm_up, 20.0, frozenset({"warm_up"})),
)
WORDS = (
    Hidden("surface", _grass, 12.0, variable="surface"),
    Hidden("battery", _battery, 8.0, variable="battery"),
    Hidden("scale", _scale, 6.0, frozenset({"range_scale", "thermometer_offset"})),
)
WEATHER = (
    Hidden("session", _session, 12.0, frozenset({"session_offset"})),
    Hidden("scale", _scale, 6.0, frozenset({"range_scale", "thermometer_offset"})),
)


def case(kind: str, seed: int) -> Case:
    """Make a case.

    Raises
    ------
    ValueError
        There is no such kind.
    """
    table, hidden, size, rng = drawn(kind, seed)
    moved_cm = size * hidden.moves(table) if hidden is not None else 0.0
    effects = []
    if hidden is not None:
        effects = [{"title": hidden.title, "names": sorted(hidden.names), "variable": hidden.variable, "size": size}]
    noise = table.noise
    truth = {
        "kind": kind,
        "seed": seed,
        "rows": table.run.size,
        "runs": int(table.run.max()) + 1,
        "white_cm": noise.white_cm,
        "lasting_cm": noise.lasting_cm,
        "lasts_s": noise.lasts_s,
        "of_runs_cm": noise.of_runs_cm,
        "effects": effects,
    }
    seen_cm = table.true_cm + moved_cm + error_cm(rng, table)
    at_bench = bench(rng, noise)
    return Case(at_bench, table.columns | {"reading_cm": read(rng, seen_cm)}, truth)


def drawn(kind: str, seed: int) -> tuple[Table, Hidden | None, float, Generator]:
    """What a case is made of before its readings are drawn: the table, the effect, its size, and the randomness."""
    if kind not in KINDS:
        raise ValueError(f"kind {kind!r}: expected one of {', '.join(KINDS)}")
    family, _, title = kind.partition(":")
    rng, (draw, effects) = rng_of(kind, seed), FAMILIES[family]
    while True:
        table = draw(rng)
        hidden = next((each for each in effects if each.title == title), None)
        size = 0.0
        if hidden is not None:
            size = STANDARD_ERRORS * _standard_error(table, hidden.moves(table)) * (1.0 if rng.random() < 0.5 else -1.0)
            if hidden.title == "temperature":
                size = abs(size)
            if abs(size) > hidden.largest:
                continue
        return table, hidden, size, rng


def _standard_error(table: Table, moves_cm: Array) -> float:
    """Of a size, by generalised least squares next to an offset and a scale."""
    design = np.column_stack([moves_cm, np.ones(moves_cm.size), table.true_cm])
    if np.ptp(moves_cm / table.true_cm) < 1e-9:
        design = design[:, :2]
    information = np.zeros((design.shape[1], design.shape[1]))
    for run in np.unique(table.run):
        rows = table.run == run
        covariance = table.noise.covariance(table.time_s[rows])
        information += design[rows].T @ np.linalg.solve(covariance, design[rows])
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))


def error_cm(rng: Generator, table: Table) -> Array:
    """Noise of a table's readings, (n,)."""
    drawn_cm = np.empty(table.run.size)
    for run in np.unique(table.run):
        rows = table.run == run
        covariance = table.noise.covariance(table.time_s[rows])
        drawn_cm[rows] = np.linalg.cholesky(covariance) @ rng.standard_normal(len(covariance))
    return drawn_cm


def read(rng: Generator, seen_cm: Array) -> Array:
    """Whole centimetres, one in a hundred without an echo and one in two hundred too short."""
    which = rng.random(seen_cm.size)
    short = rng.uniform(20.0, seen_cm)
    seen_cm = np.where(which < 0.005, short, seen_cm)
    return np.where(which > 0.99, MISSED_CM, np.maximum(np.round(seen_cm), 20.0))


def _slow(rng: Generator) -> Table:
    days, every_s = int(rng.integers(6, 15)), float(rng.choice([120.0, 180.0, 300.0]))
    hours = float(rng.uniform(8.0, 20.0))
    of_day = int(hours * 3600.0 / every_s)
    noise = Noise(
        white_cm=rng.uniform(0.5, 1.2),
        lasting_cm=rng.uniform(0.3, 0.9),
        lasts_s=rng.uniform(900.0, 3 * 3600.0),
        of_runs_cm=rng.uniform(0.0, 0.3),
    )
    level_cm, columns = float(rng.uniform(120.0, 300.0)), []
    for day in range(days):
        time_s = day * DAY_S + rng.uniform(3.0, 5.0) * 3600.0 + every_s * np.arange(of_day) + rng.uniform(-2, 2, of_day)
        # Water that is drawn off and filled up, and a tide.
        slow = np.cumsum(rng.standard_normal(of_day)) * 60.0 / np.sqrt(of_day)
        tide = rng.uniform(10.0, 40.0) * np.sin(2.0 * np.pi * time_s / 44_700.0)
        true_cm = np.clip(level_cm + slow + tide, 60.0, 500.0)
        level_cm = float(np.clip(level_cm + rng.uniform(-60.0, 60.0), 120.0, 300.0))
        air_c = rng.uniform(8.0, 20.0) + rng.uniform(3.0, 8.0) * np.cos(2.0 * np.pi * (time_s / DAY_S - 0.6))
        columns.append(
            {
                "time_s": np.round(time_s, 1),
                "run": np.full(of_day, f"day{day + 1:02d}"),
                "true_range_cm": np.round(true_cm, 2),
                "air_temperature_c": np.round(air_c + 0.3 * rng.standard_normal(of_day), 2),
                "supply_v": np.round(5.0 + 0.1 * np.sin(np.arange(of_day) / rng.uniform(5, 40) + rng.uniform(0, 6)), 3),
                "uptime_s": np.round(time_s - time_s[0] + rng.uniform(5.0, 60.0), 1),
            }
        )
    return _joined(columns, noise)


def _flights(rng: Generator) -> Table:
    flights, rows = int(rng.integers(8, 21)), int(rng.integers(150, 400))
    noise = Noise(
        white_cm=rng.uniform(0.5, 1.2),
        lasting_cm=rng.uniform(0.3, 1.5),
        lasts_s=rng.uniform(0.1, 2.0),
        of_runs_cm=rng.uniform(0.0, 0.3),
    )
    grass = rng.permutation(np.arange(flights) < max(3, flights // 4))
    battery = rng.permutation(np.arange(flights) % 5 + 1)
    columns, start_s = [], 0.0
    for flight in range(flights):
        time_s = start_s + 0.1 * np.arange(rows) + rng.uniform(-0.01, 0.01, rows)
        start_s = float(time_s[-1]) + rng.uniform(300.0, 3600.0)
        knots = np.linspace(0, rows, 8)
        true_cm = np.interp(np.arange(rows), knots, rng.uniform(60.0, 450.0, knots.size))
        columns.append(
            {
                "time_s": np.round(time_s, 3),
                "run": np.full(rows, f"flight{flight + 1:02d}"),
                "true_range_cm": np.round(true_cm, 2),
                "surface": np.full(rows, "grass" if grass[flight] else "concrete"),
                "battery": np.full(rows, float(battery[flight])),
                "air_temperature_c": np.full(rows, round(float(rng.uniform(15.0, 22.0)), 1)),
            }
        )
    return _joined(columns, noise)


def _weather(rng: Generator) -> Table:
    """Flights that differ from each other by more, and in each of which the weather is another one."""
    table = _flights(rng)
    names = ("humidity_pct", "wind_m_s", "pressure_hpa", "sun_deg", "heading_deg")
    of_flights = rng.uniform(20.0, 90.0, (len(names), int(table.run.max()) + 1)).round(1)
    columns = table.columns | dict(zip(names, of_flights[:, table.run], strict=True))
    return Table(columns, table.run, replace(table.noise, of_runs_cm=rng.uniform(0.0, 0.6)))


def _joined(columns: list[Columns], noise: Noise) -> Table:
    run = np.repeat(np.arange(len(columns)), [each["time_s"].size for each in columns])
    joined = {name: np.concatenate([each[name] for each in columns]) for name in columns[0]}
    return Table({**joined, "sensor": np.full(run.size, "down")}, run, noise)


def bench(rng: Generator, noise: Noise) -> Columns:
    """Forty ranges of fifty readings each."""
    true_cm = np.repeat(np.linspace(50.0, 500.0, 40), 50)
    return {
        "time_s": np.round(0.1 * np.arange(true_cm.size), 1),
        "sensor": np.full(true_cm.size, "down"),
        "run": np.char.add("bench", (np.arange(true_cm.size) // 50).astype(str)),
        "reading_cm": read(rng, true_cm + noise.white_cm * rng.standard_normal(true_cm.size)),
        "true_range_cm": true_cm,
    }


FAMILIES: dict[str, tuple[Callable[[Generator], Table], tuple[Hidden, ...]]] = {
    "slow": (_slow, SLOW),
    "words": (_flights, WORDS),
    "weather": (_weather, WEATHER),
}
"""How a table of each family is drawn, and what may be hidden in it."""
KINDS = tuple(
    f"{family}:{title}" for family, (_, effects) in FAMILIES.items() for title in ("null", *(e.title for e in effects))
)
