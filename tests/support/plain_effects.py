"""Flights with effects whose parameters are known, drawn the plain way: one reading at a time, by school arithmetic.

Parameters enter, columns in the CSV form leave. It shares no code with msp_range or msp_sim; an effect is what the
catalogue's sentence on it says, worked out anew.
"""

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from tests.support.plain_sampler import PlainSensor

BASE = PlainSensor(
    hit=0.93, short=0.03, missed=0.02, random=0.02, sigma_cm=1.6, short_rate_per_m=0.5, second_share=0.25
)
CALIBRATED_C = 22.5

Row = dict[str, float | str]
Values = Mapping[str, float]


@dataclass
class Ping:
    """One ping on its way: its sensor, what moves its hit, and what replaces or spoils its reading."""

    sensor: PlainSensor
    shift_cm: float = 0.0
    short_odds: float = 1.0
    missed_odds: float = 1.0
    twice: float = 0.0
    """Chance of the echo that went twice."""
    twice_sigma_cm: float = 3.0
    byte_lost: float = 0.0


def _mounting_offset(ping: Ping, row: Row, values: Values) -> None:
    if row["sensor"] == "rear":
        ping.shift_cm += values["offset_cm"]


def _latency(ping: Ping, row: Row, values: Values) -> None:
    ping.shift_cm -= values["delay_ms"] / 1000.0 * _number(row, "range_rate_cm_s")


def _air_temperature(ping: Ping, row: Row, values: Values) -> None:
    ratio = math.sqrt((CALIBRATED_C + 273.15) / (_number(row, "air_temperature_c") + 273.15))
    ping.shift_cm += values["share"] * _number(row, "true_range_cm") * (ratio - 1.0)


def _slant_range(ping: Ping, row: Row, values: Values) -> None:
    slope = math.radians(abs(_number(row, "incidence_deg")))
    ping.shift_cm += values["share"] * _number(row, "true_range_cm") * (1.0 / math.cos(slope) - 1.0)


def _warm_up(ping: Ping, row: Row, values: Values) -> None:
    ping.shift_cm += values["offset_cm"] * math.exp(-_number(row, "uptime_s") / values["time_constant_s"])


def _rotor_noise(ping: Ping, row: Row, values: Values) -> None:
    times = 1.0 + values["growth"] * _number(row, "throttle")
    ping.sensor = replace(ping.sensor, sigma_cm=ping.sensor.sigma_cm * times)


def _missed_by_target(ping: Ping, row: Row, values: Values) -> None:
    if row["target"] == "grass":
        ping.missed_odds *= math.exp(values["log_odds"])


def _prop_wash(ping: Ping, row: Row, values: Values) -> None:
    ping.short_odds *= math.exp(values["log_odds"] * _number(row, "throttle"))


def _multipath(ping: Ping, row: Row, values: Values) -> None:
    if 2.0 * _number(row, "true_range_cm") < ping.sensor.maximum_cm:
        ping.twice, ping.twice_sigma_cm = values["share"], values["sigma_cm"]


def _lost_high_byte(ping: Ping, row: Row, values: Values) -> None:
    ping.byte_lost = values["share"]


EFFECTS: Mapping[str, Callable[[Ping, Row, Values], None]] = {
    "mounting_offset": _mounting_offset,
    "latency": _latency,
    "air_temperature": _air_temperature,
    "slant_range": _slant_range,
    "warm_up": _warm_up,
    "rotor_noise": _rotor_noise,
    "missed_by_target": _missed_by_target,
    "prop_wash": _prop_wash,
    "multipath": _multipath,
    "lost_high_byte": _lost_high_byte,
}


def fly(hidden: Mapping[str, Values], runs: int, rows: int, seed: int) -> dict[str, list[float] | list[str]]:
    """Columns of flights, each of `runs` with `rows` readings; contexts do not hang together."""
    chance = random.Random(seed)
    table: list[Row] = []
    for run in range(runs):
        air_c, started_s = chance.gauss(17.0, 8.0), chance.uniform(0.0, 900.0)
        for k in range(rows):
            row: Row = {
                "time_s": 0.5 * k,
                "sensor": chance.choice(("front", "rear")),
                "run": f"flight{run:03d}",
                "true_range_cm": chance.uniform(40.0, 380.0),
                "air_temperature_c": air_c + chance.gauss(0.0, 0.5),
                "incidence_deg": chance.gauss(0.0, 4.0),
                "range_rate_cm_s": chance.gauss(0.0, 60.0),
                "throttle": chance.uniform(0.2, 0.8),
                "uptime_s": started_s + 0.5 * k,
                "target": chance.choice(("asphalt", "concrete", "grass")),
            }
            table.append(row | {"reading_cm": _reading(row, hidden, chance)})
    return {name: [row[name] for row in table] for name in table[0]}  # type: ignore[misc]


def _reading(row: Row, hidden: Mapping[str, Values], chance: random.Random) -> float:
    true_cm = _number(row, "true_range_cm")
    ping = Ping(BASE)
    for name, values in hidden.items():
        EFFECTS[name](ping, row, values)
    if chance.random() < ping.twice:
        echo = replace(ping.sensor, hit=1.0, short=0.0, missed=0.0, random=0.0, sigma_cm=ping.twice_sigma_cm)
        reading_cm = echo.reading(2.0 * true_cm, chance)
    else:
        odds = {
            "hit": ping.sensor.hit,
            "short": ping.sensor.short * ping.short_odds,
            "missed": ping.sensor.missed * ping.missed_odds,
            "random": ping.sensor.random,
        }
        total = sum(odds.values())
        shares = {name: each / total for name, each in odds.items()}
        reading_cm = replace(ping.sensor, offset_cm=ping.shift_cm, **shares).reading(true_cm, chance)
    return reading_cm % 256.0 if chance.random() < ping.byte_lost else reading_cm


def _number(row: Row, name: str) -> float:
    return float(row[name])
