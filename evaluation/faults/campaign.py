"""Fly plans with the real bridge in virtual time, on several processes, and keep what became of each.

Indices enter, dictionaries of a flight leave in their order: what was flown and its `Verdict`, one line each of
flights.jsonl.
"""

import json
import math
from bisect import bisect
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

from pymavlink.dialects.v20 import common as mavlink

from evaluation.faults.families import FAMILIES, Family
from evaluation.faults.judge import PROBABILITIES, Conditions, Event, Received, judge
from evaluation.faults.observer import GRAVITY_M_S2, Messages, decide
from evaluation.faults.plans import Plan, draw_plan, group_of, row_of, turn_of
from evaluation.faults.truth import Truth
from evaluation.runner import run_cases
from msp_range.bridge import Step
from msp_range.clock import Clock, VirtualClock
from msp_range.config import Airframe
from msp_range.fusion import above, belief, fusion, modes, odd, response
from msp_range.mavlink.transport import Transport, Wrapped
from msp_range.recording.writer import Recorder
from msp_sim.flight.autopilot import BOOTED_BEFORE_S, REBOOT_S
from msp_sim.flight.flight import Simulation
from msp_sim.flight.scenario import Scenario, load_scenario
from msp_sim.flight.summary import summarise

BELIEVE = modes, response, belief, fusion, odd, above
"""Modules of the fusion with constants that may be given other values: each has those that it imports, too."""
Constants = Mapping[str, float]
"""Name of a constant of the belief -> another value of it."""
SATURATES_CM = 8
"""Noise takes readings this close to the sensor's maximum beyond it [cm]: four of its standard deviations."""
HOSTILE_WRONG_M, HOSTILE_WRONG_SHARE = 0.2, 0.05
"""Tolerance of the hostile families [m, share of the true distance]: an autopilot lands and follows terrain by it. The
groups keep 50 cm, so that their figures stay comparable with earlier ones."""
ON_THE_GROUND_M = 0.195
"""The vehicle stands with 20 cm below the reference point, the sensors' minimum [m]."""
MOST_LEAN_RAD = math.radians(75.0)
"""Attitudes beyond this are faults of the message."""


def fly_plan(plan: Plan, out: Path | None = None) -> dict[str, Any]:
    """Fly one plan; its line in flights.jsonl. With ``out`` everything about the flight is written there."""
    with TemporaryDirectory() as name:
        folder = out or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        scenario = load_scenario(plan.write(folder))
        clock = VirtualClock()
        recorder = None
        if out is not None:
            recording = out / "flight.mcap"
            recording.unlink(missing_ok=True)
            recorder = Recorder(recording, clock, files=scenario.airframe.files, waits=True)
        log = _BridgeLog(scenario, clock)
        simulation = Simulation(scenario, clock, plan.flight_seed, recorder=recorder, link=log.on_link)
        if out is not None:
            simulation.transport.open_log(out / "link.tlog")
        crashed = None
        try:
            for steps in simulation.fly():
                log.steps += steps
        except Exception as error:
            crashed = f"{type(error).__name__}: {error}"
        if recorder is not None:
            recorder.close()
    boots_s = [-BOOTED_BEFORE_S, *(scenario.autopilot.reboots_at_s if scenario.autopilot else ())]
    received = Received(simulation.received, boots_s)
    family, turn = FAMILIES.get(group_of(plan.index)), turn_of(plan.index)
    only_below = family is not None and family.objects_are_objects
    truth = Truth(scenario, simulation.world, simulation.vehicle, only_below=only_below)
    conditions = conditions_of(scenario, family)
    verdict = judge(received, truth, conditions)
    decided: list[float | None] = []
    if family is not None and any(event.reported is None for event in verdict.wrong):
        decided = decide(log.messages(simulation), received.distances, verdict.wrong, conditions.tolerance_m)
    line = {
        "again": f"{plan.seed}:{plan.index}",
        "group": group_of(plan.index),
        "row": row_of(plan.index),
        "facts": plan.facts,
        "healthy": family is not None and turn in family.healthy,
        "faults": plan.scenario["faults"],
        "crashed": crashed,
        "verdict": asdict(verdict) | {"wrong": verdict.wrong, "silences": verdict.silences},
        "decidable_s": decided,
        "probable": log.probable(verdict.wrong),
    }
    if out is not None:
        _write(out, plan, line, received, truth, simulation)
    return line


class _Listening(Wrapped):
    """A transport that keeps what the bridge receives, with the times at which it does."""

    def __init__(self, transport: Transport, clock: Clock) -> None:
        super().__init__(transport)
        self._clock = clock
        self.received: list[tuple[float, bytes]] = []

    def receive(self) -> bytes:
        data = super().receive()
        if data:
            self.received.append((self._clock.now(), data))
        return data


class _BridgeLog:
    """What the bridge receives in a flight: for the observer, and parsed only when it asks."""

    def __init__(self, scenario: Scenario, clock: Clock) -> None:
        self._scenario, self._clock, self._start_s = scenario, clock, clock.now()
        self.steps: list[Step] = []

    def on_link(self, transport: Transport) -> Transport:
        """The link with a listener."""
        self._link = _Listening(transport, self._clock)
        return self._link

    def probable(self, wrong: Sequence[Event]) -> list[tuple[int, int]]:
        """Fused distances, and those of them during a wrong one, by `PROBABILITIES`."""
        counts = [[0, 0] for _ in PROBABILITIES]
        for step in self.steps:
            if step.fused is not None:
                time_s = step.corrected.time_s - self._start_s
                count = counts[bisect(PROBABILITIES, step.fused.probability) - 1]
                count[0] += 1
                count[1] += any(0.0 <= time_s - event.from_s <= event.for_s for event in wrong)
        return [(all_, off) for all_, off in counts]

    def messages(self, simulation: Simulation) -> Messages:
        """All that came from sensors, autopilot and thermometer, by the time of the flight."""
        airframe, vehicle, world = self._scenario.airframe, simulation.vehicle, simulation.world
        names = [sensor.name for sensor in airframe.downward]
        answers = [
            (reading.time_s - self._start_s, names.index(reading.sensor), round(reading.raw))
            for reading in (step.ranging.reading for step in self.steps)
            if reading.raw is not None and reading.sensor in names
        ]
        attitudes, forces, pressures = [], [], []
        parser = mavlink.MAVLink(None)
        for now_s, data in self._link.received:
            time_s = now_s - self._start_s
            for message in parser.parse_buffer(bytearray(data)) or ():
                kind = message.get_type()
                if kind == "ATTITUDE" and max(abs(message.roll), abs(message.pitch)) < MOST_LEAN_RAD:
                    attitudes.append((time_s, message.roll, message.pitch))
                elif kind == "SCALED_PRESSURE":
                    pressures.append((time_s, message.press_abs))
                elif kind in ("RAW_IMU", "HIGHRES_IMU"):
                    unit = GRAVITY_M_S2 / 1000 if kind == "RAW_IMU" else 1.0
                    forces.append((time_s, message.xacc * unit, message.yacc * unit, message.zacc * unit))
        temperatures = [
            (
                time_s,
                self._scenario.thermometer.reading_c(
                    time_s, lambda at_s: world.air_temperature_c(-vehicle.pose(at_s).position_ned_m[2])
                ),
            )
            for time_s in map(float, range(math.ceil(self._scenario.duration_s) + 1))
        ]
        down_m = airframe.reference_down_m
        positions_m = [(x, y, z - down_m) for x, y, z in (each.position_m for each in airframe.downward)]
        breakaway_rad = airframe.downward[0].sensor_model.beam.half_angle_rad
        return Messages(answers, attitudes, forces, pressures, temperatures, positions_m, breakaway_rad)


def conditions_of(scenario: Scenario, family: Family | None = None) -> Conditions:
    """Limits of a scenario's airframe in its air, and of its hostile family; and when its autopilot listens."""
    airframe = scenario.airframe
    polling = airframe.polling
    turns = len(polling.groups or airframe.sensors)
    interval_s = polling.ping_interval_s or max(each.sensor_model.timing.ping_interval_s for each in airframe.sensors)
    turn_s = turns * max(interval_s, max(each.sensor_model.timing.deadline_s for each in airframe.sensors))
    reboots_s = sorted(scenario.autopilot.reboots_at_s) if scenario.autopilot else []
    starts_s = [0.0, *(each + REBOOT_S for each in reboots_s)]
    limit_s = max(1.0, 2.0 * turn_s)
    if family is not None and family.silence_s is not None:
        starts_s[0], limit_s = limit_s, family.silence_s
    faulty_from_s = dict.fromkeys([sensor.name for sensor in airframe.sensors], math.inf)
    for fault in scenario.faults:
        faulty_from_s[fault.sensor] = min(faulty_from_s[fault.sensor], fault.from_s)
    conditions = Conditions(
        scenario.duration_s,
        limit_s,
        ON_THE_GROUND_M,
        max(_farthest_m(airframe, i, scenario.air.ground_c) for i in range(len(airframe.downward))),
        list(zip(starts_s, [*reboots_s, scenario.duration_s], strict=True)),
        [(fault.from_s, fault.to_s) for fault in scenario.faults],
        faulty_from_s,
    )
    if family is None:
        return conditions
    return replace(conditions, wrong_m=HOSTILE_WRONG_M, wrong_share=HOSTILE_WRONG_SHARE, stamp_counts=True)


def _farthest_m(airframe: Airframe, i: int, air_c: float) -> float:
    """How far a sensor can measure along the down axis: in cold air the sound is slower, and less far."""
    sensor = airframe.downward[i]
    model = sensor.sensor_model
    assert airframe.send.fused is not None
    slower = math.sqrt((273.15 + air_c) / (273.15 + model.calibration_temperature_c))
    reach_m = (model.maximum_cm - SATURATES_CM) / 100 * slower
    return reach_m * math.cos(sensor.tilt_from_down_rad) + sensor.position_m[2] - airframe.send.fused.reference_down_m


def _write(
    out: Path, plan: Plan, line: dict[str, Any], received: Received, truth: Truth, simulation: Simulation
) -> None:
    """Summary, verdict, texts and messages of a flight that is flown again."""
    summary = summarise(simulation.flight, row_of(plan.index), plan.flight_seed)
    (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    (out / "verdict.json").write_text(json.dumps(line, indent=2) + "\n", encoding="utf-8")
    texts = [f"{time_s:8.2f} s  severity {severity}: {text}\n" for time_s, severity, text in received.texts]
    (out / "texts.txt").write_text("".join(texts), encoding="utf-8")
    rows = ["time_s,stamp_s,current_m,maximum_m,std_m,quality,true_m\n"]
    for each in received.distances:
        true_m = truth.distances_m(each.stamp_s)[0]
        std = "" if each.std_m is None else f"{each.std_m:.3f}"
        stated = f"{each.time_s:.3f},{each.stamp_s:.3f},{each.current_m:.2f},{each.maximum_m:.2f},{std},{each.quality}"
        rows.append(f"{stated},{true_m:.3f}\n")
    (out / "messages.csv").write_text("".join(rows), encoding="utf-8")


@contextmanager
def other_constants(constants: Constants) -> Iterator[None]:
    """Fly with other values of constants of the belief, by their names, in each module that has them."""
    with ExitStack() as patched:
        for module in BELIEVE:
            for name in constants.keys() & vars(module).keys():
                patched.enter_context(patch.object(module, name, constants[name]))
        yield


def fly_drawn(seed: int, index: int, sends_motion: bool, constants: Constants) -> dict[str, Any]:
    """Draw and fly one flight, see `draw_plan` and `other_constants`."""
    with other_constants(constants):
        return fly_plan(draw_plan(seed, index, sends_motion))


def fly_all(
    seed: int,
    indices: Sequence[int],
    jobs: int,
    sends_motion: bool = True,
    file: Path | None = None,
    constants: Constants | None = None,
) -> list[dict[str, Any]]:
    """Fly many, in the order of their indices, in ``jobs`` processes, with a line of the file for each."""
    flights = {f"{seed}:{index}": (seed, index, sends_motion, constants or {}) for index in indices}
    return run_cases(flights, fly_drawn, jobs, file, resume=False)
