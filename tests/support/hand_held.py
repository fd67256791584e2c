"""A vehicle that somebody holds in his hands: what is mounted and what the airframe file says may differ.

Emulated sensors at their true places, over a flat floor, and an autopilot that knows how the vehicle is turned. Time is
virtual, unless a clock is given. `Person` does what commissioning asks for.
"""

import io
import math
import random
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from numpy.random import SeedSequence, default_rng

from msp_range.bus import Address, Bus
from msp_range.bus.smbus import KernelBus
from msp_range.clock import Clock, VirtualClock
from msp_range.commission.operator import PersonAtTerminal
from msp_range.commission.steps.directions import SIDES
from msp_range.config import Airframe
from msp_range.geometry import angle_between, boresight
from msp_range.mavlink.dialect import dialect
from msp_sim.device.bus import EmulatedBus as Devices
from msp_sim.device.emulated import EmulatedSensor, Surroundings, ranging_timing
from msp_sim.device.table import emulated_kind
from msp_sim.flight.autopilot import AutopilotSection, LoopbackAutopilot
from msp_sim.world.surfaces import GroundSection
from msp_sim.world.vehicle import Pose
from msp_sim.world.world import AirSection, World

RESTS_M = 0.25
"""Height of the reference point when the vehicle stands on the floor."""
FREE, COVER, STILL, FLOOR, HOLD = "Hands off", "Cover ", "Leave it still", "Leave it on the floor", "Lift it"
NOSE_UP, RIGHT_DOWN, ROCK, DONE = "Tilt its nose up", "Level, then tilt its right side down", "Rock it", "Done"
BOARD = "Hold the board"
MOTIONS = (FREE, COVER, STILL, FLOOR, HOLD, NOSE_UP, RIGHT_DOWN, ROCK, DONE, BOARD)
"""First words of the instructions."""


@dataclass(frozen=True)
class Held:
    """How the vehicle is held: height of the reference point [m], roll and pitch [deg]."""

    height_m: float = RESTS_M
    roll_deg: float = 0.0
    pitch_deg: float = 0.0


Course = Callable[[float], Held]
"""From the time since it began [s]."""


class HandHeld:
    """The vehicle, its sensors and its autopilot.

    Parameters
    ----------
    mounted
        The airframe as it is built.
    seed
        Of noise, tremor and the autopilot's sensors.
    air_c
        Temperature of the air [deg C].
    clock
        The time; None: a virtual one.
    """

    def __init__(self, mounted: Airframe, seed: int = 1, air_c: float = 20.0, clock: Clock | None = None) -> None:
        self.mounted = mounted
        self.clock = clock or VirtualClock(100.0)
        self.world = World(GroundSection(surface="concrete"), AirSection(ground_c=air_c, lapse_c_per_m=0.0))
        self.covered: str | None = None
        self.walls_cm: dict[str, int] = {}
        """Sensors that see a wall at this distance, however the vehicle is held."""
        self.board: str | None = None
        """Side of the vehicle at which somebody holds a board half a metre away."""
        self.armed = False
        self.is_silent = False
        self.parameters: dict[str, float] = {}
        self.returns_distances = True
        self.seed = seed
        self.attitude_sign = (1.0, 1.0)
        """By which the autopilot's roll and pitch are multiplied: -1 for one that is mounted backwards."""
        self.attitude_late_s = 0.0
        """Age of the attitude that the autopilot sends as the present one [s]."""
        self._course: Course = lambda time_s: Held()
        self._since_s = self.clock.now()
        self._start_s = self.clock.now()
        self._tremor = random.Random(seed)
        self._phases = [self._tremor.uniform(0, 2 * math.pi) for _ in range(9)]
        self.steady = True

    def move(self, course: Course, steady: bool = False) -> None:
        """Hold it so from now on."""
        self._course, self._since_s, self.steady = course, self.clock.now(), steady

    def held(self, flight_s: float) -> Held:
        """How it is held at a time since the start [s]."""
        now_s = flight_s + self._start_s
        held = self._course(max(now_s - self._since_s, 0.0))
        if self.steady:
            return held
        wobble = [math.sin((0.9 + 0.37 * i) * 2 * math.pi * 0.5 * now_s + self._phases[i]) for i in range(9)]
        return replace(
            held,
            height_m=held.height_m + 0.012 * (wobble[0] + wobble[1]),
            roll_deg=held.roll_deg + 0.8 * (wobble[3] + wobble[4]),
            pitch_deg=held.pitch_deg + 0.8 * (wobble[6] + wobble[7]),
        )

    def pose(self, flight_s: float) -> Pose:
        """The vehicle's true pose at a time since the start [s]."""
        held = self.held(flight_s)
        later = self.held(flight_s + 0.01)
        rate_m_s = -(later.height_m - held.height_m) / 0.01
        return Pose(
            flight_s,
            (0.0, 0.0, -held.height_m),
            math.radians(held.roll_deg),
            math.radians(held.pitch_deg),
            0.3,
            (0.0, 0.0, rate_m_s),
        )

    def bus(self) -> Bus:
        """The sensors as they are mounted and addressed."""
        now = self.flight_s
        others: dict[str, tuple[float, float | None]] = {}
        devices = []
        for sensor, seed in zip(
            self.mounted.sensors, SeedSequence(self.seed).spawn(len(self.mounted.sensors)), strict=True
        ):
            model = sensor.sensor_model
            around = Surroundings(self.world, self.pose)
            emulated = EmulatedSensor(sensor, model, around, default_rng(seed), others)
            kind = emulated_kind(model.driver)
            devices.append(
                kind(
                    sensor.address,
                    now,
                    self._under_a_hand(sensor.name, emulated.echo, round(model.minimum_cm)),
                    ranging_timing(kind, model),
                    (),
                    random.Random(self.seed),
                )
            )
        return Devices(devices, now, reports_busy=True)

    def transport(self) -> "Autopilot":
        """The autopilot's end of the link."""
        roll_sign, pitch_sign = self.attitude_sign

        def sent(pose: Pose) -> Pose:
            return pose._replace(roll_rad=roll_sign * pose.roll_rad, pitch_rad=pitch_sign * pose.pitch_rad)

        # The autopilot's time starts when it is made; the vehicle's, when it is.
        made_s = self.flight_s()
        return Autopilot(
            self,
            self.clock,
            lambda time_s: self.pose(max(time_s + made_s - self.attitude_late_s, 0.0)),
            lambda pose: self.world.air_temperature_c(1.0),
            AutopilotSection(),
            sent=sent,
            draw=random.Random(self.seed),
        )

    def flight_s(self) -> float:
        """Time since the start [s]."""
        return self.clock.now() - self._start_s

    def _under_a_hand(self, name: str, echo: Callable[[float], float], minimum_cm: int) -> Callable[[float], float]:
        axis = next(sensor.boresight for sensor in self.mounted.sensors if sensor.name == name)

        def answer(ping_s: float) -> float:
            reading_cm = self.walls_cm.get(name, echo(ping_s))
            if self.board is not None:
                pitch, yaw = (math.radians(each) for each in SIDES[self.board])
                if angle_between(axis, boresight(0.0, pitch, yaw)) < math.radians(20):
                    return 50
            return minimum_cm if self.covered == name else reading_cm

        return answer


class Autopilot(LoopbackAutopilot):
    """The simulated autopilot with what commissioning asks it for besides: parameters, its own distance, arming."""

    def __init__(self, vehicle: HandHeld, *arguments: Any, sent: Callable[[Pose], Pose], **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._sent_pose = sent
        self._vehicle = vehicle
        self._returned_s = float("-inf")

    def send(self, frame: bytes) -> bool:
        """Receive a frame from the bridge."""
        super().send(frame)
        message = self._decode(frame)
        kind, known = message.get_type(), self._vehicle.parameters
        if kind == "DISTANCE_SENSOR" and self._vehicle.returns_distances and message.orientation == 25:
            if self.flight_s() - self._returned_s >= 0.2:
                self._returned_s = self.flight_s()
                own = 0, 19, 760, message.current_distance, 0, 0, message.orientation, 0
                self._put_message(dialect.MAVLink_distance_sensor_message(*own))
        elif kind == "PARAM_REQUEST_READ" and message.param_id in known:
            self._put_parameter(message.param_id)
        elif kind == "PARAM_SET" and message.param_id in known:
            known[message.param_id] = message.param_value
            self._put_parameter(message.param_id)
        return True

    def receive(self) -> bytes:
        """What it has sent; nothing while it is silent."""
        sent = super().receive()
        return b"" if self._vehicle.is_silent else sent

    def flight_s(self) -> float:
        """Time since the vehicle's start [s]."""
        return self._vehicle.flight_s()

    def _put_measured(self, what: str, boot_ms: int, now_s: float, pose: Pose) -> None:
        super()._put_measured(what, boot_ms, now_s, self._sent_pose(pose) if what == "attitude" else pose)

    def _put_parameter(self, name: str) -> None:
        value = self._vehicle.parameters[name]
        real = dialect.MAV_PARAM_TYPE_REAL32
        count = len(self._vehicle.parameters)
        self._put_message(dialect.MAVLink_param_value_message(name.encode(), value, real, count, 0))

    def _put_message(self, message: Any) -> None:
        self._outgoing += message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256

    def _put(self, kind: Any, *values: float) -> None:
        if kind is dialect.MAVLink_heartbeat_message and self._vehicle.armed:
            values = (*values[:2], dialect.MAV_MODE_FLAG_SAFETY_ARMED, *values[3:])
        super()._put(kind, *values)


class EmulatedBus(KernelBus):
    """The vehicle's sensors as the bridge's own bus, without smbus2 and the kernel."""

    def __init__(self, vehicle: HandHeld) -> None:
        super().__init__("/dev/emulated")
        self._devices = vehicle.bus()

    def claim(self) -> None:
        """Nobody else is there."""

    def reopen(self) -> None:
        """It is always open."""

    def write(self, address: Address, data: bytes) -> None:
        """Write to the emulated sensors."""
        self._devices.write(address, data)

    def read(self, address: Address, count: int) -> bytes:
        """Read from the emulated sensors."""
        return self._devices.read(address, count)


class Person(PersonAtTerminal):
    """Does what commissioning asks for, not quite exactly, and agrees to everything.

    Parameters
    ----------
    vehicle
        What she moves.
    heights_m
        Heights at which she puts the vehicle, one after the other.
    seed
        Of what she does a little differently.
    """

    def __init__(self, vehicle: HandHeld, heights_m: tuple[float, ...] = (0.7, 1.6), seed: int = 1) -> None:
        super().__init__(True, (), io.StringIO())
        self._vehicle = vehicle
        self.heights = list(heights_m)
        self._draw = random.Random(seed)
        self.is_idle = False
        """Whether she does nothing that she is asked to."""
        self.asked: list[str] = []
        self.instructed: list[str] = []
        self.shown: list[str] = []
        self.when: dict[str, Callable[[], object]] = {}
        """What happens at an instruction, by its text."""
        self.agrees_to: Callable[[str], bool] = lambda text: True

    def begin(self, text: str) -> None:
        """She has read it."""

    def show(self, text: str) -> None:
        """Read what was found."""
        self.shown.append(text)

    def height_m(self, text: str) -> float | None:
        """Put it on a stand, and read the tape to some millimetres."""
        if not self.heights:
            return None
        height_m = self.heights.pop(0)
        self._vehicle.move(lambda time_s: Held(height_m), steady=True)
        return round(height_m + self._draw.gauss(0.0, 0.004), 3)

    def agrees(self, text: str) -> bool:
        """Agree."""
        self.asked.append(text)
        return self.agrees_to(text)

    def instruct(self, text: str) -> None:
        """Move the vehicle as the instruction's first words say."""
        self.instructed.append(text)
        self.when.get(text, bool)()
        if self.is_idle:
            return
        vehicle, draw = self._vehicle, self._draw
        motion = next(words for words in MOTIONS if text.startswith(words))
        subject = text.split()[-1].removesuffix(".")
        vehicle.covered = subject if motion == COVER else None
        vehicle.board = subject if motion == BOARD else None
        before = vehicle.held(vehicle.flight_s())
        tilt_deg = draw.uniform(12, 18)
        periods_s = draw.uniform(3.0, 4.0), draw.uniform(4.0, 5.0)
        swing_deg = draw.uniform(15, 19)
        goals = {
            FREE: Held(2.0),
            COVER: Held(2.0),
            BOARD: Held(0.9),
            FLOOR: Held(RESTS_M),
            DONE: Held(RESTS_M),
            HOLD: Held(draw.uniform(0.85, 1.05)),
            NOSE_UP: Held(before.height_m, 0.0, tilt_deg),
            RIGHT_DOWN: Held(before.height_m, tilt_deg, 0.0),
            ROCK: Held(before.height_m),
        }
        if motion == STILL:
            return
        goal = goals[motion]

        def course(time_s: float) -> Held:
            share = 0.5 - 0.5 * math.cos(math.pi * min(max((time_s - 0.5) / 2.0, 0.0), 1.0))
            swing = share * swing_deg if motion == ROCK else 0.0
            return Held(
                before.height_m + share * (goal.height_m - before.height_m),
                before.roll_deg
                + share * (goal.roll_deg - before.roll_deg)
                + swing * math.sin(2 * math.pi * time_s / periods_s[0]),
                before.pitch_deg
                + share * (goal.pitch_deg - before.pitch_deg)
                + swing * math.sin(2 * math.pi * time_s / periods_s[1] + 1.0),
            )

        vehicle.move(course, steady=motion in (FREE, COVER, BOARD, FLOOR, DONE))
