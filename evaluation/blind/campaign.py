"""The report's campaign (Table 4.1 and its section 5.1), staged in sound.

A seed enters, columns in the CSV form leave: what a person would have measured on that bench, with a tape that errs by
a millimetre and rooms whose air is never quite the same.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from evaluation.blind import air
from evaluation.blind.flight import Columns
from evaluation.blind.ping import REFLECTION_DB, Ping, tone_crossing_s
from evaluation.blind.receiver import Receiver
from evaluation.blind.sound import Array

ROOM_C, HOT_C, COLD_C = 21.1, 46.1, 8.3
"""70, 115 and 47 F."""

RANGES_CM = tuple(range(40, 261, 20))
SHEET_CM = (20.3, 20.3)
BOARD_CM = (101.6, 61.0)

BOX_M, BOX_BLUR_M = 0.30, 0.02
"""How far hot or cold air reaches from the sensor, and how sharply it ends."""

APART_M = 0.1524
"""Between the two sensors of the crosstalk test, 6 inches."""

COMMAND_S = (3.5e-4, 6.5e-4)
"""Between the commands to two sensors that are to fire at once: a transfer on the bus and what the program does."""

SOUNDING_S = 0.05
"""Period of the external transmitter's bursts."""

COMPENSATION_ROWS = (
    (305, 20.46, False),
    (335, 17.47, True),
    (366, 17.89, True),
    (396, 18.19, True),
    (427, 15.56, True),
)
"""Table 5.1: range [cm], the air in which this sensor errs by what the report has uncompensated [deg C], and whether
a thermometer was there. The first row is the same with and without compensation: nobody measured its air."""


@dataclass(frozen=True)
class Surroundings:
    """What goes on in the room besides the experiment."""

    misfire: float = 0.001
    click_hz: float = 0.0
    passers_per_m: float = 0.0
    lock_up: float = 0.0
    """Chance that the amplifier locks up on a spike and reports when it recovers, at any time."""
    saturated: float = 0.2
    tape_cm: float = 0.1
    """Standard deviation of where a target really stands."""


QUIET = Surroundings()
BUSY = Surroundings(misfire=0.02, click_hz=0.2, passers_per_m=0.02, lock_up=0.01, saturated=0.3)
"""People, insects, a bad supply: all four densities of the report's mixture occur."""


@dataclass(frozen=True)
class Point:
    """One set-up of the bench; NaN is what does not apply."""

    condition: str
    range_cm: float
    level: str = ""
    target: str = "plywood"
    size_cm: tuple[float, float] = SHEET_CM
    incidence_deg: float = 0.0
    air_c: float = ROOM_C
    far_c: float = np.nan
    measured_air: bool = True
    vibration_hz: float = np.nan
    sensor: str = "sensor_1"
    lag_s: float = np.nan
    """Of the own ping behind the other sensor's; negative: drawn anew for each ping from `COMMAND_S`."""
    external: tuple[float, float, float, float] | None = None
    """Level at 30 cm [dB], duty, distance [cm], frequency [kHz]."""
    rough_air: float = 1.0
    """How much stronger the eddies are than on a quiet day."""
    readings: int | None = None


def table_4_1(maximum_range_readings: int = 20_000, widest_deg: float = 23.4) -> list[Point]:
    """Every set-up of the report's campaign.

    Parameters
    ----------
    maximum_range_readings
        Readings at 500 cm, over four days.
    widest_deg
        Of the field of view; the report's is 23.4.
    """
    points = [Point("baseline", cm) for cm in RANGES_CM]
    for day, (day_c, rough) in enumerate(((19.4, 4.0), (18.8, 5.0), (19.0, 4.0), (19.2, 6.0))):
        points.append(
            Point(
                "maximum_range",
                500.0,
                level=f"day{day + 1}",
                size_cm=BOARD_CM,
                air_c=day_c,
                rough_air=rough,
                readings=maximum_range_readings // 4,
            )
        )
    steps = round(widest_deg / 1.8)
    for cm in (50.0, 100.0, 150.0, 200.0):
        for step in range(-steps, steps + 1):
            points.append(
                Point("field_of_view", cm, target="wall", size_cm=(np.inf, np.inf), incidence_deg=round(step * 1.8, 1))
            )
    points += [Point("material", cm, each, each) for each in ("plywood", "asphalt", "concrete") for cm in RANGES_CM]
    for word, celsius in (("room", ROOM_C), ("hot", HOT_C), ("cold", COLD_C)):
        points += [Point("temperature", cm, word, air_c=celsius, far_c=ROOM_C) for cm in RANGES_CM]
    points += [Point("vibration", cm, vibration_hz=60.0) for cm in RANGES_CM]
    for cm in RANGES_CM:
        for firing, lag_s in (("simultaneous", -1.0), ("sequential", 0.1)):
            condition = f"crosstalk_{firing}"
            first_lag_s = 0.0995 if lag_s < 0.0 else lag_s
            points.append(Point(condition, cm, lag_s=first_lag_s))
            points.append(Point(condition, cm, sensor="sensor_2", lag_s=lag_s))
    points += list(external_points())
    for cm, celsius, measured in COMPENSATION_ROWS:
        points.append(
            Point("temperature_compensation", float(cm), size_cm=BOARD_CM, air_c=celsius, measured_air=measured)
        )
    return points


def external_points() -> Iterator[Point]:
    """A transmitter at the far end that faces the sensor, by level, duty, distance and frequency, and without it."""
    for cm in (100.0, 200.0):
        yield Point("external_interference", cm, "quiet")
        for level in (70.0, 90.0, 110.0):
            for duty in (0.1, 0.5, 1.0):
                for distance in (100.0, 300.0):
                    yield Point("external_interference", cm, "42 kHz", external=(level, duty, distance, 42.0))
        for khz in (40.0, 44.0):
            yield Point("external_interference", cm, f"{khz:.0f} kHz", external=(90.0, 0.5, 100.0, khz))


def campaign(
    seed: int,
    readings: int = 100,
    points: Sequence[Point] | None = None,
    receiver: Receiver | None = None,
    surroundings: Surroundings = QUIET,
) -> Columns:
    """Readings of a campaign.

    Parameters
    ----------
    seed
        Of everything that is random.
    readings
        At each point that does not say otherwise.
    points
        Set-ups; `table_4_1()` unless given.
    receiver, surroundings
        Sensor and room.

    Returns
    -------
    dict of ndarray
        In the CSV form; `condition`, `sensor`, `run` and `target` are words. A run is one sensor in one condition at
        one level, its ranges one after the other.
    """
    rng = default_rng(np.random.SeedSequence(seed))
    points = table_4_1() if points is None else points
    counts = [point.readings or readings for point in points]
    row = np.repeat(np.arange(len(points)), counts)
    columns = _columns(points, row, rng)
    columns["reading_cm"] = _read(points, row, columns, receiver or Receiver(), surroundings, rng)
    columns["true_range_cm"] = np.array([point.range_cm for point in points])[row]
    return columns


def _columns(points: Sequence[Point], row: NDArray[np.intp], rng: Generator) -> Columns:
    def number(values: Iterable[float]) -> Array:
        return np.array(list(values), dtype=float)[row]

    def word(values: Iterable[str]) -> NDArray[np.str_]:
        return np.array(list(values))[row]

    run = word(f"{p.condition}-{p.level}-{p.sensor}".replace(" ", "") for p in points)
    lag_s = number(p.lag_s for p in points)
    lag_s = np.where(lag_s < 0.0, rng.uniform(*COMMAND_S, row.size), lag_s)
    small = number(min(p.size_cm) for p in points)
    external = np.array([p.external or (np.nan,) * 4 for p in points])[row]
    columns: Columns = {
        "time_s": _time_s(run),
        "sensor": word(p.sensor for p in points),
        "run": run,
        "condition": word(p.condition for p in points),
        "air_temperature_c": number(p.air_c if p.measured_air else np.nan for p in points),
        "target_temperature_c": number(p.far_c for p in points),
        "incidence_deg": number(p.incidence_deg for p in points),
        "vibration_hz": number(p.vibration_hz for p in points),
        "target": word(p.target for p in points),
        "target_size_cm": np.where(np.isinf(small), np.nan, small),
        "neighbour_lag_ms": 1000.0 * lag_s,
        "neighbour_range_cm": number(p.range_cm if p.lag_s == p.lag_s else np.nan for p in points),
    }
    for k, name in enumerate(("level_db", "duty", "distance_cm", "frequency_khz")):
        columns[f"external_{name}"] = external[:, k]
    return columns


def _time_s(run: NDArray[np.str_]) -> Array:
    """A reading each 100 ms in every run."""
    time_s = np.zeros(run.size)
    for each in np.unique(run):
        (rows,) = np.nonzero(run == each)
        time_s[rows] = 0.1 * np.arange(rows.size)
    return time_s


def _read(
    points: Sequence[Point],
    row: NDArray[np.intp],
    columns: Columns,
    receiver: Receiver,
    surroundings: Surroundings,
    rng: Generator,
) -> Array:
    stands_cm = np.array([p.range_cm for p in points]) + surroundings.tape_cm * rng.standard_normal(len(points))
    ping = Ping(receiver, stands_cm[row] / 100.0)
    room_c = np.array([p.far_c if p.far_c == p.far_c else p.air_c for p in points])
    near_c = np.array([p.air_c for p in points])
    ping.temperature_c = room_c[row]
    slowness = air.boxed_slowness_s_m(near_c, room_c, stands_cm / 100.0, BOX_M, BOX_BLUR_M)
    ping.slowness_s_m = np.where(near_c == room_c, 1.0 / air.speed_m_s(room_c), slowness)[row]
    ping.off_axis_rad = np.radians([p.incidence_deg for p in points])[row]
    ping.width_m = np.array([p.size_cm[0] for p in points])[row] / 100.0
    ping.height_m = np.array([p.size_cm[1] for p in points])[row] / 100.0
    ping.reflection_db = np.array([REFLECTION_DB[p.target] for p in points])[row]
    rough = np.array([p.rough_air for p in points])[row]
    ping.eddies_k *= rough
    ping.fade *= np.sqrt(rough / 2.0 + 0.5)
    _surround(ping, surroundings, rng)
    _vibrate(ping, np.array([p.vibration_hz for p in points])[row], rng)
    _neighbour(ping, columns["neighbour_lag_ms"] / 1000.0)
    _transmitter(ping, columns, rng)
    return ping.listen(rng)


def _surround(ping: Ping, surroundings: Surroundings, rng: Generator) -> None:
    ping.misfire[:] = surroundings.misfire
    ping.click_hz[:] = surroundings.click_hz
    ping.passers_per_m[:] = surroundings.passers_per_m
    ping.saturated = surroundings.saturated
    recovers_s = rng.uniform(20.0, 765.0, ping.range_m.size) * ping.receiver.tick_s
    ping.locked_s = np.where(rng.random(ping.range_m.size) < surroundings.lock_up, recovers_s, np.nan)


def _vibrate(ping: Ping, vibration_hz: Array, rng: Generator) -> None:
    """The housing moves by 0.2 mm, and its mount hums: at harmonics of 60 Hz, none of them near 42 kHz."""
    phase = rng.uniform(0.0, 2.0 * np.pi, vibration_hz.size)
    ping.range_m += np.where(vibration_hz > 0.0, 2e-4 * np.sin(phase), 0.0)
    ping.noise_pa = ping.noise_pa * np.where(vibration_hz > 0.0, 1.1, 1.0)


def _neighbour(ping: Ping, lag_s: Array) -> None:
    """The other sensor's ping, mirrored half-way between the two, is early by its lead."""
    way_m = np.hypot(2.0 * ping.range_m, APART_M)
    aside = np.arctan2(APART_M, 2.0 * ping.range_m)
    pressure = ping.level_at_pa(way_m) * ping.beam(aside) ** 2
    near = lag_s < 0.05  # later, the room has gone quiet
    amplitude = np.where(near, pressure, 0.0)
    ping.add_sound(amplitude, way_m * ping.slowness() - np.nan_to_num(lag_s))


def _transmitter(ping: Ping, columns: Columns, rng: Generator) -> None:
    level, duty, distance_cm, khz = (
        np.asarray(columns[f"external_{name}"], dtype=float)
        for name in ("level_db", "duty", "distance_cm", "frequency_khz")
    )
    (sounding,) = np.nonzero(level == level)
    crossing_s = np.full(level.size, np.inf)
    loss_db = air.absorption_db_m(ROOM_C) * (distance_cm[sounding] - 30.0) / 100.0
    at_sensor_db = level[sounding] - 20.0 * np.log10(distance_cm[sounding] / 30.0) - loss_db
    crossing_s[sounding] = tone_crossing_s(
        ping.receiver, at_sensor_db, 1000.0 * khz[sounding], duty[sounding], SOUNDING_S, rng
    )
    ping.crossings_s.append(crossing_s)


def over_ranges(
    seed: int,
    count: int,
    low_cm: float = 40.0,
    high_cm: float = 300.0,
    surroundings: Surroundings = BUSY,
    receiver: Receiver | None = None,
    rough_air: float = 4.0,
) -> Columns:
    """Readings of a wall straight ahead at ranges drawn evenly, among people and insects: one run, for a fit.

    Parameters
    ----------
    seed
        Of everything that is random.
    count
        Readings.
    low_cm, high_cm
        Between which the wall stands.
    surroundings, receiver, rough_air
        Room, sensor, and how much stronger the eddies are than on a quiet day.
    """
    rng = default_rng(np.random.SeedSequence(seed))
    true_cm = rng.uniform(low_cm, high_cm, count)
    ping = Ping(receiver or Receiver(), (true_cm + surroundings.tape_cm * rng.standard_normal(count)) / 100.0)
    ping.eddies_k *= rough_air
    ping.fade *= np.sqrt(rough_air / 2.0 + 0.5)
    _surround(ping, surroundings, rng)
    return {
        "time_s": 0.1 * np.arange(count),
        "sensor": np.full(count, "sensor_1"),
        "run": np.full(count, "busy"),
        "reading_cm": ping.listen(rng),
        "true_range_cm": true_cm,
        "air_temperature_c": ping.temperature_c,
    }
