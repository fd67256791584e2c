"""What matters of one flight in a few numbers: wrong distances, silence, error.

A sample of a scenario gives a dictionary of numbers. With the bridge, they are computed from what the autopilot
received, as in docs/faults.md; with the model only, from readings that are drawn for the path of the flight.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import SeedSequence, default_rng

from msp_range.arrays import Array
from msp_range.assembly import streams_of, windows_of
from msp_range.config import Airframe
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import QUALITY_INVALID
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import table_of
from msp_sim.device.emulated import Surroundings, ping_contexts
from msp_sim.effects.own import add_own_effects_once
from msp_sim.flight.autopilot import REBOOT_S, AutopilotSection
from msp_sim.flight.flight_log import FlightResult
from msp_sim.flight.sampled import Sampled, SampledFlight
from msp_sim.flight.scenario import Scenario
from msp_sim.flight.simulate import fly_through
from msp_sim.flight.summary import error_numbers
from msp_sim.model.derived import sample_in_order
from msp_sim.model.model import Model

WRONG_CM, WRONG_S = 50.0, 0.5
"""A distance is wrong if it is further off [cm] for longer [s]: the rule of the fault campaign (docs/faults.md).
Smaller limits count the edges of objects."""
TIME_OUT_S = 0.5
"""A message holds for this long at most [s], ArduPilot's time-out for range finders."""
SHORTEST_SILENCE_S = 1.0
"""Shorter times without a distance are no silence [s]; nor are those of two turns of all sensors."""
REPORTED_S = (1.0, 0.5)
"""A silence is reported if a warning comes at most this long before its begin, and at most this long after it has
become one [s], as in the fault campaign."""

ERRORS = ("error_bias_cm", "error_rms_cm", "error_p95_cm", "error_worst_cm")
FLOWN = (
    "wrong_s",
    "silent_s",
    "longest_silence_s",
    "unreported_silences",
    *ERRORS,
    "warnings",
    "sha256",
    "faults",
)
"""Columns of a flight with the bridge; see docs/simulating.md."""
DRAWN = (
    "wrong_share",
    "missed_share",
    "longest_silence_s",
    *ERRORS,
)
"""Columns of a flight with the model only, which has no faults."""

Message = tuple[float, Any]
Numbers = dict[str, Any]


@dataclass(frozen=True)
class Flights:
    """What all flights have in common."""

    sampled: Sampled
    seed: int
    """The scenario with what varies, and the random seed."""
    model: SensorModel | None = None
    """Sensor model for all sensors; None: each sensor's own."""
    effects: tuple[Path, ...] = ()
    """Files with effects that the models name, and that are not in the catalogue."""

    def sample(self, index: int) -> SampledFlight:
        """Draw a flight, with the effects added to the catalogue of this process."""
        add_own_effects_once(self.effects)
        return self.sampled.sample(self.seed, index)


def fly_sample(flights: Flights, index: int) -> Numbers:
    """Fly a sample with the bridge in virtual time.

    Parameters
    ----------
    flights
        All flights.
    index
        Number of the flight.

    Returns
    -------
    dict
        The numbers `FLOWN`, and what `about` gives.
    """
    sample = flights.sample(index)
    scenario = sample.scenario
    simulation = fly_through(scenario, sample.seed, flights.model)
    return about(sample) | judged(
        simulation.flight, simulation.received, scenario.airframe, scenario.autopilot, scenario.duration_s
    )


def draw_sample(flights: Flights, index: int) -> Numbers:
    """Draw the readings of a sample from the sensors' models, without a bridge; parameters as for `fly_sample`.

    Faults are left out: they are the emulated sensor's and the bus's, which take no part.
    """
    sample, model = flights.sample(index), flights.model
    scenario = sample.scenario
    for_vehicle, for_readings = SeedSequence(sample.seed).spawn(2)
    contexts: dict[str, list[dict[str, Any]]] = {sensor.name: [] for sensor in scenario.airframe.sensors}
    for context in pings_in_flight(scenario, model, default_rng(for_vehicle)):
        contexts[context["sensor"]].append(context)
    seeds = for_readings.generate_state(len(contexts))
    readings = [
        _drawn(model or sensor.sensor_model, contexts[sensor.name], int(seeds[i]))
        for i, sensor in enumerate(scenario.airframe.sensors)
    ]
    return about(sample) | _judged_readings(readings)


def pings_in_flight(
    scenario: Scenario, model: SensorModel | None, rng: np.random.Generator
) -> Iterator[dict[str, Any]]:
    """The contexts of a flight's pings in the order of the bridge's polling, as `ping_contexts`; rng: the vehicle's."""
    world = scenario.world()
    around = Surroundings(world, scenario.vehicle(world, rng).pose)
    groups, interval_s = scenario.airframe.polling_groups, scenario.airframe.polling_interval_s
    turns = range(math.ceil(scenario.duration_s / interval_s))
    pings = ((turn * interval_s, name) for turn in turns for name in groups[turn % len(groups)])
    return ping_contexts(scenario.airframe, model, around, pings)


def about(sample: SampledFlight) -> Numbers:
    """What was drawn: the parameters, the faults in words, and the draws that were refused before."""
    faults = [f"{fault['sensor']} {fault['kind']} {fault['from_s']:g}-{fault['to_s']:g} s" for fault in sample.faults]
    return {**sample.values, "faults": "; ".join(faults), "refused": sample.refused}


def judged(
    flight: FlightResult,
    received: Sequence[Message],
    airframe: Airframe,
    autopilot: AutopilotSection | None,
    duration_s: float,
) -> Numbers:
    """The numbers `FLOWN` of a flight, over all of its streams; None where there is nothing to compute one from."""
    singles, fused, _ = streams_of(airframe)
    # What a stream sends holds for the reading before; the fused one for that of any downward sensor.
    truths = {fused.id: _merged(flight)} if fused is not None else {}
    for name, stream in singles.items():
        truths[stream.id] = list(zip(flight.tracks[name].time_s, flight.tracks[name].truth_m, strict=True))
    wrong_s, errors_cm, silences = 0.0, [], []
    limit_s = max(SHORTEST_SILENCE_S, 2.0 * windows_of(airframe).turn_s)
    for stream_id, truth in truths.items():
        sent = [
            message for message in received if message[1].get_type() == "DISTANCE_SENSOR" and message[1].id == stream_id
        ]
        held = list(_errors(sent, truth))
        wrong_s += _wrong_s([(time_s, error) for time_s, error, _ in held])
        errors_cm += [error for _, error, is_distance in held if is_distance]
        usable_s = [time_s for time_s, message in sent if _is_distance(message) or _is_above(message)]
        silences += list(_silences(usable_s, _listens(autopilot, duration_s), limit_s))
    return {
        "wrong_s": round(wrong_s, 3),
        "silent_s": round(math.fsum(to_s - from_s for from_s, to_s in silences), 3),
        "longest_silence_s": round(max((to_s - from_s for from_s, to_s in silences), default=0.0), 3),
        "unreported_silences": sum(not _is_reported(silence, limit_s, received, duration_s) for silence in silences),
        **_error_numbers(errors_cm),
        "warnings": sum(severity in ("error", "warning") for _, severity, _ in flight.texts),
        "sha256": flight.frames_sha256,
    }


def _merged(flight: FlightResult) -> list[tuple[float, float | None]]:
    """True distances along the vehicle's down axis at the readings of all downward sensors, in order."""
    rows = [
        (time_s, i, below_m)
        for i, track in enumerate(flight.tracks.values())
        for time_s, below_m in zip(track.time_s, track.below_m, strict=True)
    ]
    # Where the ground differs between the sensors there is no true distance; sensors that look elsewhere have none.
    return [(time_s, below_m) for time_s, _, below_m in sorted(rows, key=lambda row: row[:2])]


def _errors(
    sent: Sequence[Message], truth: Sequence[tuple[float, float | None]]
) -> Iterator[tuple[float, float, bool]]:
    """Errors of messages [cm], where the truth is known: time [s], error, whether it is that of a distance.

    'Above the maximum' has an error if the truth is below it.
    """
    place = -1
    for time_s, message in sent:
        while place + 1 < len(truth) and truth[place + 1][0] <= time_s:
            place += 1
        truth_m = truth[place][1] if place >= 0 else None
        if truth_m is None:
            continue
        if _is_distance(message):
            yield time_s, message.current_distance - 100 * truth_m, True
        elif _is_above(message):
            yield time_s, max(message.max_distance - 100 * truth_m, 0.0), False


def _is_distance(message: Any) -> bool:
    in_range = message.min_distance < message.current_distance <= message.max_distance
    return bool(in_range and message.signal_quality != QUALITY_INVALID)


def _is_above(message: Any) -> bool:
    return bool(message.current_distance > message.max_distance)


def _wrong_s(errors: Sequence[tuple[float, float]]) -> float:
    """Time for which wrong distances held that lasted for longer than `WRONG_S` [s]."""
    total_s = run_s = 0.0
    followed = zip(errors, [*(time_s for time_s, _ in errors[1:]), math.inf], strict=False)
    for (time_s, error_cm), next_s in followed:
        if abs(error_cm) > WRONG_CM:
            run_s += min(next_s - time_s, TIME_OUT_S)
        if abs(error_cm) <= WRONG_CM or next_s - time_s > TIME_OUT_S:
            total_s += run_s if run_s > WRONG_S else 0.0
            run_s = 0.0
    return total_s


def _listens(autopilot: AutopilotSection | None, duration_s: float) -> list[tuple[float, float]]:
    """When the autopilot receives [s]."""
    if autopilot is None:
        return []
    reboots_s = sorted(reboot_s for reboot_s in autopilot.reboots_at_s if reboot_s < duration_s)
    starts_s = [autopilot.first_heartbeat_s, *(reboot_s + REBOOT_S for reboot_s in reboots_s)]
    return [(start, end) for start, end in zip(starts_s, [*reboots_s, duration_s], strict=True) if start < end]


def _silences(
    usable_s: Sequence[float], listens: Sequence[tuple[float, float]], limit_s: float
) -> Iterator[tuple[float, float]]:
    """Times without a distance that are longer than the limit: begin and end [s]."""
    for start_s, end_s in listens:
        times_s = [start_s, *(sent_s for sent_s in usable_s if start_s <= sent_s < end_s), end_s]
        yield from ((early, late) for early, late in pairwise(times_s) if late - early > limit_s)


def _is_reported(silence: tuple[float, float], limit_s: float, received: Sequence[Message], duration_s: float) -> bool:
    """Whether the autopilot received a warning, or that the bridge's state is critical, in time."""
    before_s, after_s = REPORTED_S
    from_s, deadline_s = silence[0] - before_s, silence[0] + limit_s + after_s
    state = None
    for time_s, message in received:
        if time_s > deadline_s:
            break
        kind = message.get_type()
        if kind == "STATUSTEXT" and time_s >= from_s and message.severity <= dialect.MAV_SEVERITY_WARNING:
            return True
        if kind == "HEARTBEAT":
            state = message.system_status
    return state == dialect.MAV_STATE_CRITICAL or deadline_s > duration_s


def _error_numbers(errors_cm: Sequence[float]) -> Numbers:
    """Bias, root mean square, 95th percentile of the magnitude and the largest error [cm]; None without errors."""
    if not errors_cm:
        return dict.fromkeys(ERRORS)
    worst_cm = max(errors_cm, key=abs)
    numbers = {f"error_{name}": value for name, value in error_numbers(errors_cm).items()}
    return numbers | {"error_worst_cm": round(worst_cm, 3)}


def _drawn(model: SensorModel, contexts: Sequence[Mapping[str, Any]], seed: int) -> Array:
    """Time [s], reading, truth (NaN where no echo is expected) and code of no echo [cm] of a sensor's pings, (4, n)."""
    columns = dict(table_of("drawn", contexts, contexts[0]).columns)
    columns["time_s"] = columns["uptime_s"]
    reading_cm = sample_in_order(Model.of(model), columns, seed)
    maximum_cm = np.full(reading_cm.shape, float(model.maximum_cm))
    return np.stack([columns["time_s"], reading_cm, columns["true_range_cm"], maximum_cm])


def _judged_readings(sensors: Sequence[Array]) -> Numbers:
    time_s, reading_cm, true_cm, maximum_cm = np.concatenate(sensors, axis=1)
    is_expected, is_answered = true_cm < maximum_cm, reading_cm < maximum_cm
    expected = int(is_expected.sum())
    errors_cm = (reading_cm - true_cm)[is_expected & is_answered]
    wrong = int((np.abs(errors_cm) > WRONG_CM).sum())
    gaps_s = np.diff(np.concatenate([[0.0], np.sort(time_s[is_answered]), [time_s.max()]]))
    return {
        "wrong_share": round(wrong / expected, 5) if expected else None,
        "missed_share": round(1.0 - errors_cm.size / expected, 5) if expected else None,
        "longest_silence_s": round(float(gaps_s.max()), 3),
        **_error_numbers(errors_cm.tolist()),
    }
