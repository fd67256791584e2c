"""What can be hidden in a flight: each mechanism by its own physics, at a size.

A `Flight` with nothing hidden enters `act` and is changed. Sizes are in each mechanism's own unit;
`evaluation.blind.size` finds the one that makes an effect as large as wanted. Which name of a catalogue stands for
which mechanism is in `names.yaml`, not here.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from evaluation.blind import air
from evaluation.blind.flight import AIR, Columns, Flight, run_numbers
from evaluation.blind.ping import tone_crossing_s
from evaluation.blind.sound import Array

Shape = Callable[[Flight], Array]
Act = Callable[[Flight, float, Generator], None]
Prepare = Callable[[Columns, float, Generator], None]


@dataclass(frozen=True)
class Mechanism:
    """Something that may be hidden."""

    act: Act
    """Changes staged flights, given a size."""
    guess: float
    most: float = np.inf
    """A size to begin with, and the largest that is physical."""
    prepare: Prepare | None = None
    """Changes the contexts first: flights in which it can show at all."""
    place_cm: Callable[[Flight], Array] | None = None
    """Where its readings lie, if it makes readings of its own."""
    without: Act | None = None
    """What takes it away where its contexts alone bring it."""
    channel: str = ""
    variables: tuple[str, ...] = ()
    """For a mechanism in no catalogue: what it changes, and with which columns."""


# What moves the echo.


def _farther(shape: Shape) -> Act:
    """Farther by a size [cm] times a shape."""

    def act(flight: Flight, size_cm: float, rng: Generator) -> None:
        flight.ping.range_m += 0.01 * size_cm * shape(flight)

    return act


def _later(shape: Shape) -> Act:
    """Later by as much, whatever the speed of sound is."""

    def act(flight: Flight, size_cm: float, rng: Generator) -> None:
        flight.ping.late_s += 58e-6 * size_cm * shape(flight)

    return act


def _scattered(shape: Shape) -> Act:
    """Farther or nearer by a normal deviation of a size [cm] times a shape."""

    def act(flight: Flight, size_cm: float, rng: Generator) -> None:
        flight.ping.range_m += 0.01 * size_cm * shape(flight) * rng.standard_normal(flight.rows)

    return act


def _hangs_lower(flight: Flight) -> Array:
    found: Array = flight["sensor"] == "rear"
    return found


def _slow_clock(flight: Flight, size_pct: float, rng: Generator) -> None:
    flight.clock *= 1.0 - 0.01 * size_pct


def _believe(
    flight: Flight, near_off_c: Array | float = 0.0, far_off_c: Array | float = 0.0, humid: float = 1.0
) -> None:
    """The sensor takes another air for the true one, on top of what it is wrong about already."""
    near_c, far_c, humidity = (flight[each] for each in AIR)
    believed = air.mean_slowness_s_m(near_c + near_off_c, far_c + far_off_c, humidity * humid)
    flight.believed_s_m = flight.believed_s_m * believed / air.mean_slowness_s_m(near_c, far_c, humidity)


def _air_not_compensated(flight: Flight, share: float, rng: Generator) -> None:
    short_c = share * (22.5 - flight["air_temperature_c"])
    _believe(flight, short_c, short_c)


def _wrong_thermometer(flight: Flight, size_c: float, rng: Generator) -> None:
    _believe(flight, size_c, size_c)


def _one_thermometer_for_the_path(flight: Flight, share: float, rng: Generator) -> None:
    _believe(flight, far_off_c=share * (flight["air_temperature_c"] - flight["target_temperature_c"]))


def _humidity_ignored(flight: Flight, share: float, rng: Generator) -> None:
    _believe(flight, humid=1.0 - share)


def _hot_and_humid(columns: Columns, size: float, rng: Generator) -> None:
    for name in ("air_temperature_c", "target_temperature_c"):
        columns[name] = columns[name] + 14.0


def _read_late(flight: Flight, size_ms: float, rng: Generator) -> None:
    flight.ping.range_m -= 1e-5 * size_ms * flight["range_rate_cm_s"]


def _stamped_at_the_echo(flight: Flight, size: float, rng: Generator) -> None:
    """The true range is that of the moment at which the echo comes in; the reading is that of the reflection."""
    way_back_s = flight.ping.range_m * flight.ping.slowness()
    flight.ping.range_m -= 0.01 * size * flight["range_rate_cm_s"] * way_back_s


def _rough_ground(flight: Flight, share: float, rng: Generator) -> None:
    """Ground that scatters instead of mirroring answers where the beam points, which a tilt makes farther."""
    tilt = np.radians(flight["incidence_deg"])
    flight.ping.range_m *= 1.0 + share * (1.0 / np.cos(tilt) - 1.0)


def _cold_start(flight: Flight) -> Array:
    """The amplifier's group delay settles as it warms up, over five minutes."""
    return np.exp(-flight["uptime_s"] / 300.0)


def _bent_counter(flight: Flight) -> Array:
    """A counter that changes its prescaler at 12 ms runs at another rate from there on: a size of 1 is 1 %."""
    found: Array = np.maximum(flight.ping.range_m - 2.07, 0.0)
    return found


def _stuck_gain(flight: Flight, share: float, rng: Generator) -> None:
    """A gain that follows the falling level only in part: a far echo is found later on its rise."""
    ping = flight.ping
    fall_db = 20.0 * np.log10(np.maximum(ping.range_m, 0.2)) + 2.8 * (ping.range_m - 1.0)
    ping.reflection_db -= share * fall_db


def _second_lobe(flight: Flight, share: float, rng: Generator) -> None:
    """A burst that beats has two lobes, and now and then the first is not counted: 24 periods later."""
    late = rng.random(flight.rows) < share
    flight.ping.late_s += np.where(late, 24.0 / flight.ping.receiver.frequency_hz, 0.0)


# What scatters it.


def _turbulent_air(flight: Flight, size_k: float, rng: Generator) -> None:
    flight.ping.eddies_k = np.hypot(flight.ping.eddies_k, size_k)


def _gravel(flight: Flight, size_cm: float, rng: Generator) -> None:
    """Stones: a tilted beam meets them over a depth that grows with the tilt, and one of them answers."""
    depth_m = 0.01 * size_cm * np.abs(np.tan(np.radians(flight["incidence_deg"]))) / np.tan(np.radians(5.0))
    flight.ping.range_m += depth_m * rng.standard_normal(flight.rows)


def _thrust(flight: Flight) -> Array:
    """It goes with the square of throttle; and the dynamic pressure of eddies in the rotors' wash goes with it."""
    return (flight["throttle"] / 0.5) ** 2


def _some_rotors_off(columns: Columns, size: float, rng: Generator) -> None:
    """Half of the runs are carried by hand: nothing vibrates."""
    if (columns["vibration_hz"] == 0.0).any():
        return
    run = run_numbers(columns)
    by_hand = (rng.random(run.max() + 1) < 0.5)[run]
    columns["vibration_hz"] = np.where(by_hand, 0.0, columns["vibration_hz"])


def _shaken(flight: Flight, size_cm: float, rng: Generator) -> None:
    """A loose mount, whose play limits the stroke: a sine of any phase."""
    stroke_m = 0.01 * size_cm * (flight["vibration_hz"] > 0.0)
    flight.ping.range_m += stroke_m * np.sin(rng.uniform(0.0, 2.0 * np.pi, flight.rows))


def _remounted(flight: Flight, size_cm: float, rng: Generator) -> None:
    run = run_numbers(flight.columns)
    flight.ping.range_m += 0.01 * size_cm * rng.standard_normal(run.max() + 1)[run]


# What hides it, or is heard in its place.


def _exhaust(flight: Flight, size_per_m: float, rng: Generator) -> None:
    """Puffs of hot exhaust drift through the beam, and each bends the echo away."""
    _lose(flight, -np.expm1(-size_per_m * flight.ping.range_m), rng)


def _lose(flight: Flight, share: Array, rng: Generator) -> None:
    flight.ping.reflection_db = np.where(rng.random(flight.rows) < share, -80.0, flight.ping.reflection_db)


def _steep(columns: Columns, size: float, rng: Generator) -> None:
    """Flights in gusts, that tilt the vehicle by a multiple of what is usual."""
    columns["incidence_deg"] = columns["incidence_deg"] * size


def _nothing(flight: Flight, size: float, rng: Generator) -> None:
    """The contexts do it all: the mirror point leaves the opening of the tube."""


def _without_its_shroud(flight: Flight, size: float, rng: Generator) -> None:
    """The same flights without the tube about the sensor."""
    flight.ping.reflection_db = np.maximum(flight.ping.reflection_db, -0.5)


def _long_grass(flight: Flight, share: float, rng: Generator) -> None:
    """Blades scatter: on a share of the spots no front of the echo is left."""
    grass = flight["target"] == "grass"
    _lose(flight, share * grass, rng)


def _changed_share(share: float, change: Callable[[Array], Array], rng: Generator) -> Callable[[Array], Array]:
    def fault(reading_cm: Array) -> Array:
        return np.where(rng.random(reading_cm.size) < share, change(reading_cm), reading_cm)

    return fault


def _bytes_on_top_of_each_other(flight: Flight, share: float, rng: Generator) -> None:
    flight.codes.append(_changed_share(share, _either_byte, rng))


def _either_byte(reading_cm: Array) -> Array:
    word = reading_cm.astype(int)
    return ((word >> 8) | (word & 255)).astype(float)


def _high_byte_lost(flight: Flight, share: float, rng: Generator) -> None:
    flight.codes.append(_changed_share(share, lambda reading_cm: reading_cm % 256.0, rng))


def _top_bit(flight: Flight, share: float, rng: Generator) -> None:
    flight.codes.append(_changed_share(share, lambda reading_cm: reading_cm + 32768.0, rng))


def _rings_on(flight: Flight, share: float, rng: Generator) -> None:
    """A cracked housing rings for longer at times: the counter stops at once where the echo comes while it does."""
    drowned = (flight.ping.range_m < 0.75) & (rng.random(flight.rows) < share)
    flight.ping.crossings_s.append(np.where(drowned, 20.0 * flight.ping.receiver.tick_s, np.inf))


def _neighbour_heard(flight: Flight, share: float, rng: Generator) -> None:
    """The other sensor's echo crosses over on a share of the pings, as the beams swing."""
    ping = flight.ping
    arrival_s = 0.02 * flight["neighbour_range_cm"] * ping.slowness() - 1e-3 * flight["neighbour_lag_ms"]
    scatter_s = 1e-4 * rng.standard_normal(flight.rows)
    audible = (rng.random(flight.rows) < share) & (arrival_s > 22.0 * ping.receiver.tick_s)
    pressure = 0.5 * ping.level_at_pa(0.02 * flight["neighbour_range_cm"]) * audible
    ping.add_sound(pressure, arrival_s + scatter_s)


def _neighbour_place_cm(flight: Flight) -> Array:
    early_cm = flight["neighbour_lag_ms"] / (2.0 * 10.0 * flight.ping.slowness())
    found: Array = flight["neighbour_range_cm"] - early_cm
    return found


def _second_bounce(flight: Flight, share: float, rng: Generator) -> None:
    """The first echo drowns in a gust, the one that went twice is found; the frame that mirrors it is 2 cm higher."""
    ping = flight.ping
    twice = rng.random(flight.rows) < share
    way_m = 4.0 * ping.range_m + 0.04
    ping.reflection_db = np.where(twice, -80.0, ping.reflection_db)
    pressure = 0.7 * ping.level_at_pa(way_m) * twice
    ping.add_sound(pressure, way_m * ping.slowness())


def _strut(flight: Flight, share: float, rng: Generator) -> None:
    """A strut of the landing gear at 33 cm glints when the frame flexes."""
    ping = flight.ping
    glints = rng.random(flight.rows) < share
    pressure = np.where(glints, 4.0 * ping.receiver.threshold_pa(33.0 * 58e-6), 0.0)
    arrival_s = 2.0 * (0.33 + 0.004 * rng.standard_normal(flight.rows)) * ping.slowness()
    ping.add_sound(pressure, arrival_s)


def _blown_about(flight: Flight, share: float, rng: Generator) -> None:
    """Clippings that the wash throws up: as many as its thrust can lift."""
    _in_the_way(flight, share * _thrust(flight), rng)


def _in_the_way(flight: Flight, share: Array, rng: Generator) -> None:
    there = rng.random(flight.rows) < share
    depth_m = 0.2 + rng.beta(1.2, 1.5, flight.rows) * (flight.ping.range_m - 0.2)
    flight.ping.crossings_s.append(np.where(there, 2.0 * depth_m * flight.ping.slowness(), np.inf))


def _repeated(flight: Flight, share: float, rng: Generator) -> None:
    """The master reads before the new ranging is done and gets the sensor's one before."""
    series = np.char.add(flight["run"], flight["sensor"])
    order = np.argsort(series, kind="stable")
    before = np.full(flight.rows, -1)
    follows = series[order][1:] == series[order][:-1]
    before[order[1:][follows]] = order[:-1][follows]

    def fault(reading_cm: Array) -> Array:
        stale = (before >= 0) & (rng.random(reading_cm.size) < share)
        return np.where(stale, reading_cm[before], reading_cm)

    flight.codes.append(fault)


def _transmitter_about(columns: Columns, size: float, rng: Generator) -> None:
    """A door opener or a parking car near the pad in a third of the flights, louder or farther."""
    run = run_numbers(columns)
    runs = run.max() + 1
    there = rng.random(runs) < 0.35
    for name, values in (
        ("external_level_db", rng.uniform(85.0, 110.0, runs)),
        ("external_duty", rng.choice((0.1, 0.2, 0.4), runs)),
        ("external_distance_cm", rng.uniform(50.0, 300.0, runs)),
        ("external_frequency_khz", rng.choice((40.0, 41.0, 42.0), runs)),
    ):
        columns[name] = np.where(there, values, np.nan)[run]


def _transmitter(flight: Flight, share: float, rng: Generator) -> None:
    ping = flight.ping
    level, duty, distance_cm, khz = (
        flight[f"external_{name}"] for name in ("level_db", "duty", "distance_cm", "frequency_khz")
    )
    (on,) = np.nonzero(level == level)
    crossing_s = np.full(flight.rows, np.inf)
    loss_db = 20.0 * np.log10(distance_cm[on] / 30.0) + 0.014 * (distance_cm[on] - 30.0)
    tone_s = tone_crossing_s(ping.receiver, level[on] - loss_db, 1000.0 * khz[on], duty[on], 0.05, rng)
    crossing_s[on] = np.where(rng.random(on.size) < share, tone_s, np.inf)
    ping.crossings_s.append(crossing_s)


KNOWN: dict[str, Mechanism] = {
    "one_hangs_lower": Mechanism(_farther(_hangs_lower), 0.3),
    "slow_clock": Mechanism(_slow_clock, 0.3),
    "air_not_compensated": Mechanism(_air_not_compensated, 0.2, 1.2),
    "wrong_thermometer": Mechanism(_wrong_thermometer, 1.0),
    "one_thermometer_for_the_path": Mechanism(_one_thermometer_for_the_path, 0.4, 1.2),
    "humidity_ignored": Mechanism(_humidity_ignored, 0.5, 1.0, _hot_and_humid),
    "read_late": Mechanism(_read_late, 5.0),
    "stamped_at_the_echo": Mechanism(_stamped_at_the_echo, 1.0, 2.0),
    "rough_ground": Mechanism(_rough_ground, 0.3, 1.0),
    "cold_start": Mechanism(_later(_cold_start), 0.5),
    "bent_counter": Mechanism(_farther(_bent_counter), 0.3),
    "stuck_gain": Mechanism(_stuck_gain, 1.0, 1.3),
    "second_lobe": Mechanism(_second_lobe, 0.02, 1.0, place_cm=lambda f: f["true_range_cm"] + 9.9),
    "turbulent_air": Mechanism(_turbulent_air, 1.0, 10.0),
    "gravel": Mechanism(_gravel, 0.4),
    "wash_across_the_path": Mechanism(_scattered(_thrust), 0.5, 1.5),
    "shaken": Mechanism(_shaken, 0.8, prepare=_some_rotors_off),
    "remounted": Mechanism(_remounted, 0.3),
    "exhaust": Mechanism(_exhaust, 0.02),
    "steep": Mechanism(_nothing, 1.2, 4.0, _steep, without=_without_its_shroud),
    "long_grass": Mechanism(_long_grass, 0.05, 1.0),
    "bytes_on_top_of_each_other": Mechanism(
        _bytes_on_top_of_each_other, 0.02, 1.0, place_cm=lambda f: _either_byte(f["true_range_cm"])
    ),
    "high_byte_lost": Mechanism(_high_byte_lost, 0.02, 1.0, place_cm=lambda f: f["true_range_cm"] % 256.0),
    "top_bit": Mechanism(_top_bit, 0.01, 1.0),
    "rings_on": Mechanism(_rings_on, 0.3, 1.0),
    "neighbour_heard": Mechanism(_neighbour_heard, 0.03, 1.0, place_cm=_neighbour_place_cm),
    "second_bounce": Mechanism(_second_bounce, 0.02, 1.0, place_cm=lambda f: 200.0 * f.ping.range_m + 2.0),
    "strut": Mechanism(_strut, 0.02, 1.0, place_cm=lambda f: np.full(f.rows, 33.0)),
    "blown_about": Mechanism(_blown_about, 0.05, 0.4),
    "repeated": Mechanism(_repeated, 0.1, 1.0),
    "transmitter": Mechanism(_transmitter, 0.1, 1.0, _transmitter_about),
}
"""In the catalogue under one name or another."""


# What no catalogue has.


def _swollen_cap(flight: Flight) -> Array:
    return (np.maximum(flight["humidity_pct"] - 50.0, 0.0) / 30.0) ** 2


def _resonant_housing(flight: Flight) -> Array:
    return 1.0 / (1.0 + ((flight["vibration_hz"] - 66.0) / 5.0) ** 2)


def _sagging_supply(flight: Flight) -> Array:
    return np.exp((flight["throttle"] - 0.5) / 0.08)


def _hum_of_the_neighbour(flight: Flight) -> Array:
    return -np.exp(-flight["neighbour_lag_ms"] / 8.0)


def _standing_wave(flight: Flight) -> Array:
    found: Array = np.sin(2.0 * np.pi * flight.ping.range_m / 0.7)
    return found


def _wash_pushes_the_beam(flight: Flight) -> Array:
    found: Array = (flight["throttle"] - 0.5) / 0.1 * flight["incidence_deg"] / 4.0
    return found


def _dew(flight: Flight) -> Array:
    return 1.0 / (1.0 + np.exp((flight["air_temperature_c"] - 10.0) / 2.0))


def _loose_cap(flight: Flight) -> Array:
    return flight["uptime_s"] / 600.0


def _fog(flight: Flight, share: float, rng: Generator) -> None:
    _lose(flight, share / (1.0 + np.exp(-(flight["humidity_pct"] - 80.0) / 5.0)), rng)


def _loose_plug(flight: Flight, share: float, rng: Generator) -> None:
    shaken = 1.0 / (1.0 + np.exp(-(flight["vibration_hz"] - 75.0) / 2.0))
    flight.ping.misfire = np.maximum(flight.ping.misfire, share * shaken)


def _dust(flight: Flight, share: float, rng: Generator) -> None:
    sinking = np.maximum(-flight["range_rate_cm_s"] / 50.0, 0.0)
    _in_the_way(flight, 1.0 - np.exp(-share * sinking), rng)


def _loosening_strap(flight: Flight, share: float, rng: Generator) -> None:
    _in_the_way(flight, share * (flight["uptime_s"] / 1200.0) ** 2, rng)


def _hot_amplifier(flight: Flight, share: float, rng: Generator) -> None:
    hot = 1.0 / (1.0 + np.exp(-(flight["air_temperature_c"] - 24.0) / 2.0))
    recovers_s = rng.uniform(20.0, 765.0, flight.rows) * flight.ping.receiver.tick_s
    locked = rng.random(flight.rows) < share * hot
    flight.ping.locked_s = np.where(locked, recovers_s, flight.ping.locked_s)


UNKNOWN: dict[str, Mechanism] = {
    "swollen_cap": Mechanism(_later(_swollen_cap), 0.3, channel="bias", variables=("humidity_pct",)),
    "resonant_housing": Mechanism(_later(_resonant_housing), 0.4, channel="bias", variables=("vibration_hz",)),
    "sagging_supply": Mechanism(_later(_sagging_supply), 0.2, channel="bias", variables=("throttle",)),
    "hum_of_the_neighbour": Mechanism(
        _later(_hum_of_the_neighbour), 0.4, channel="bias", variables=("neighbour_lag_ms",)
    ),
    "standing_wave": Mechanism(_farther(_standing_wave), 0.3, channel="bias", variables=("true_range_cm",)),
    "wash_pushes_the_beam": Mechanism(
        _farther(_wash_pushes_the_beam), 0.2, channel="bias", variables=("incidence_deg", "throttle")
    ),
    "dew": Mechanism(_scattered(_dew), 0.7, channel="spread", variables=("air_temperature_c",)),
    "loose_cap": Mechanism(_scattered(_loose_cap), 0.4, channel="spread", variables=("uptime_s",)),
    "fog": Mechanism(_fog, 0.1, 1.0, channel="missed", variables=("humidity_pct",)),
    "loose_plug": Mechanism(_loose_plug, 0.1, 1.0, channel="missed", variables=("vibration_hz",)),
    "dust": Mechanism(_dust, 0.03, channel="short", variables=("range_rate_cm_s",)),
    "loosening_strap": Mechanism(_loosening_strap, 0.06, 1.0, channel="short", variables=("uptime_s",)),
    "hot_amplifier": Mechanism(_hot_amplifier, 0.06, 1.0, channel="random", variables=("air_temperature_c",)),
}
"""In no catalogue: to be called unknown, with channel and variables."""

MECHANISMS = KNOWN | UNKNOWN
