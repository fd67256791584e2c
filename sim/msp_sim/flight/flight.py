"""A simulated flight: a scenario's vehicle, world and emulated sensors around the real bridge.

Everything that varies is an argument: with a virtual clock and a seed, the same flight gives the same bytes on the
link. The result is a `FlightResult`: what became of each reading, together with the truth.
"""

import hashlib
import math
import random
from collections.abc import Callable, Generator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from numpy.random import SeedSequence, default_rng

from msp_range.bridge import Bridge, Records, Step
from msp_range.clock import Clock
from msp_range.config import Airframe
from msp_range.correction.thermometer import LoopReader
from msp_range.mavlink.transport import Transport, Wrapped
from msp_range.pilot_texts import Severity
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.device.device import Fault
from msp_sim.device.emulated import Surroundings, emulated_bus
from msp_sim.flight.autopilot import AutopilotSection, LoopbackAutopilot
from msp_sim.flight.flight_log import FlightLog, FlightResult
from msp_sim.flight.scenario import Scenario
from msp_sim.world.vehicle import Pose
from msp_sim.world.world import World


class LoggingTransport(Wrapped):
    """A transport that also hashes what is sent and, where asked, writes the frames to a telemetry log.

    The log has the format of ground stations' tlog files: before each frame the microseconds since 1970 as eight bytes,
    most significant first.
    """

    def __init__(self, transport: Transport, clock: Clock) -> None:
        super().__init__(transport)
        self._clock = clock
        self._utc_s = clock.utc() - clock.now()
        self._tlog: BinaryIO | None = None
        self.sha256 = hashlib.sha256()

    def open_log(self, tlog: Path) -> None:
        """Write the frames to this file too."""
        self._tlog = tlog.open("wb")

    def send(self, frame: bytes) -> bool:
        self.sha256.update(frame)
        if self._tlog is not None:
            self._tlog.write(round((self._clock.now() + self._utc_s) * 1e6).to_bytes(8, "big") + frame)
        return super().send(frame)

    def close(self) -> None:
        if self._tlog is not None:
            self._tlog.close()
        super().close()


class EmulatedFlight:
    """The real bridge on emulated sensors, and what becomes of their readings: what all simulated flights share.

    Parameters
    ----------
    airframe, clock
        The vehicle; its time starts at the clock's present one, and it flies by that clock.
    world
        The true world.
    pose
        The vehicle's pose at a time of the flight [s].
    model
        Sensor model for all sensors; None: each sensor's own model file.
    recorder
        Records every stage of every reading, and the truth.
    """

    def __init__(
        self,
        airframe: Airframe,
        clock: Clock,
        world: World,
        pose: Callable[[float], Pose],
        model: SensorModel | None,
        recorder: Records | None,
    ) -> None:
        self.clock = clock
        self._start_s = clock.now()
        self.world = world
        self._pose = pose
        self._airframe = airframe
        self._models = {sensor.name: model or sensor.sensor_model for sensor in airframe.sensors}
        self._recorder = recorder
        self._log = FlightLog(airframe, self._models, world, pose, self._start_s, recorder)
        self.flight = self._log.flight

    def _make_bridge(
        self,
        transport: Transport,
        seed: SeedSequence,
        faults: Mapping[str, Sequence[Fault]],
        sensed_pose: Callable[[float], Pose],
        **options: Any,
    ) -> None:
        """Make the bridge, with the emulated sensors on its bus at the pose that they sense."""
        around = Surroundings(self.world, sensed_pose, self._log.record_truth)
        bus = emulated_bus(self._airframe, self._models, around, self.now_s, seed, faults)
        thermometer = LoopReader(lambda source: self._displayed_c() / source.scale)
        self.bridge = Bridge(
            self._airframe,
            bus,
            self.clock,
            transport,
            recorder=self._recorder,
            thermometer=thermometer,
            report=self._record_text,
            **options,
        )

    def now_s(self) -> float:
        """Time of the flight [s]."""
        return self.clock.now() - self._start_s

    def height_m(self) -> float:
        """Present vertical distance from the vehicle's reference point to the surface below [m]."""
        return self.world.height_m(self._pose(self.now_s()))

    def _record_text(self, severity: Severity, text: str) -> None:
        self._log.record_text(self.now_s(), severity, text)

    def step(self) -> list[Step]:
        """Run one step of the bridge and record it."""
        steps = self.bridge.step()
        for step in steps:
            self._log.record_step(step)
        return steps

    def finish(self) -> FlightResult:
        """Complete the result of the flight and return it."""
        self._log.finish(self.now_s(), self.bridge)
        return self.flight

    def _air_c(self, time_s: float) -> float:
        """Air temperature at the vehicle at a time of the flight [deg C]."""
        return self.world.air_temperature_c(-self._pose(time_s).position_ned_m[2])

    def _displayed_c(self) -> float:
        """Present reading of the vehicle's thermometers, instead of this computer's own files [deg C]."""
        return self._air_c(self.now_s())


class Simulation(EmulatedFlight):
    """One flight of a scenario.

    Parameters
    ----------
    scenario
        The flight.
    clock
        Virtual, or the system's for a flight in real time.
    seed
        Random seed: the same seed gives the same flight.
    model
        Sensor model for all sensors; None: each sensor's own model file.
    recorder
        Records every stage of every reading, and the truth.
    link
        Opens a real link that also gets all messages; None: no real link.

    Attributes
    ----------
    world, vehicle
        The true world, and the vehicle, which knows its true pose at any time of the flight.
    bridge, transport
        The bridge that flies, and its link.
    """

    def __init__(
        self,
        scenario: Scenario,
        clock: Clock,
        seed: int,
        *,
        model: SensorModel | None = None,
        recorder: Records | None = None,
        link: Callable[[LoopbackAutopilot], Transport] | None = None,
    ) -> None:
        airframe = scenario.airframe
        for_vehicle, for_sensors, for_autopilot = SeedSequence(seed).spawn(3)
        world = scenario.world()
        self.vehicle = scenario.vehicle(world, default_rng(for_vehicle))
        super().__init__(airframe, clock, world, self.vehicle.pose, model, recorder)
        self._duration_s = scenario.duration_s
        self._thermometer = scenario.thermometer
        # Without one, nothing is ever received.
        plan = scenario.autopilot or AutopilotSection().model_copy(update={"first_heartbeat_s": math.inf})
        self._autopilot = LoopbackAutopilot(
            clock,
            self.vehicle.pose,
            lambda pose: self._thermometer.reading_c(pose.time_s, self._air_c),
            plan.model_copy(update={"kind": plan.kind or airframe.link.autopilot}),
            draw=random.Random(int(for_autopilot.generate_state(1)[0])),
            ground_c=scenario.air.ground_c,
        )
        transport = link(self._autopilot) if link is not None else self._autopilot
        self.transport = LoggingTransport(transport, clock)
        self._make_bridge(self.transport, for_sensors, scenario.device_faults(), self.vehicle.pose)

    def height_m(self) -> float:
        """Present vertical distance from where the fused stream measures to the surface below [m]."""
        return super().height_m() - self._airframe.reference_down_m

    def fly(self) -> Generator[list[Step], None, None]:
        """Fly to the end, yielding after each step of the bridge; `flight` is complete when the iterator ends."""
        end_s = self._start_s + self._duration_s
        try:
            while self.clock.now() < end_s:
                yield self.step()
        finally:
            self.finish()

    def _displayed_c(self) -> float:
        return self._thermometer.reading_c(self.now_s(), self._air_c)

    def finish(self) -> FlightResult:
        """Complete the result of the flight, close its link and return it."""
        flight = super().finish()
        flight.autopilot_received = dict(self._autopilot.received_counts())
        flight.frames_sha256 = self.transport.sha256.hexdigest()
        self.transport.close()
        return flight

    @property
    def received(self) -> list[tuple[float, Any]]:
        """Messages received by the autopilot: time of the flight [s], message."""
        return self._autopilot.received
