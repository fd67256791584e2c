"""A simulated flight: a scenario's vehicle, world and emulated sensors around the real bridge.

Everything that varies is an argument: with a virtual clock and a seed, the same flight gives the same bytes on the
link. The result is a `FlightResult`: what became of each reading, together with the truth.
"""

import hashlib
import random
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

from numpy.random import SeedSequence, default_rng

from msp_range.bridge import Bridge, Records, Step
from msp_range.clock import Clock
from msp_range.correction.temperature import FileSource
from msp_range.correction.thermometer import LoopReader
from msp_range.mavlink.transport import Transport, Wrapped
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.device.emulated import emulated_bus
from msp_sim.flight.autopilot import LoopbackAutopilot
from msp_sim.flight.flight_log import FlightLog
from msp_sim.flight.scenario import Scenario


class _LoggingTransport(Wrapped):
    """A transport that also hashes what is sent and writes the frames to a telemetry log.

    The log has the format of ground stations' tlog files: before each frame the microseconds since 1970 as eight bytes,
    most significant first.
    """

    def __init__(self, transport: Transport, clock: Clock, tlog: Path | None) -> None:
        super().__init__(transport)
        self._clock = clock
        self._utc_s = clock.utc() - clock.now()
        self._tlog = tlog.open("wb") if tlog is not None else None
        self.sha256 = hashlib.sha256()

    def send(self, frame: bytes) -> bool:
        self.sha256.update(frame)
        if self._tlog is not None:
            self._tlog.write(round((self._clock.now() + self._utc_s) * 1e6).to_bytes(8, "big") + frame)
        return super().send(frame)

    def close(self) -> None:
        if self._tlog is not None:
            self._tlog.close()
        super().close()


class Simulation:
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
    tlog
        File for the frames sent; None: no file.

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
        tlog: Path | None = None,
    ) -> None:
        airframe = scenario.airframe
        for_vehicle, for_sensors, for_autopilot = SeedSequence(seed).spawn(3)
        self._clock = clock
        self._start_s = clock.now()
        self._duration_s = scenario.duration_s
        self.world = scenario.world()
        self.vehicle = scenario.vehicle(self.world, default_rng(for_vehicle))
        models = {sensor.name: model or sensor.sensor_model for sensor in airframe.sensors}
        self._log = FlightLog(airframe, models, self.world, self.vehicle.pose, self._start_s, recorder)
        self.flight = self._log.flight
        bus = emulated_bus(
            airframe,
            models,
            self.world,
            self.vehicle.pose,
            self.now_s,
            for_sensors,
            self._log.record_truth,
            scenario.device_faults(),
        )
        self._reference_down_m = airframe.reference_down_m
        self._displayed_c = scenario.thermometer.reading_c
        self._autopilot = LoopbackAutopilot(
            clock,
            self.vehicle.pose,
            lambda pose: self._displayed_c(pose.time_s, self._air_c),
            scenario.autopilot,
            kind=airframe.link.autopilot,
            draw=random.Random(int(for_autopilot.generate_state(1)[0])),
            clearance_m=self.vehicle.clearance_m,
            ground_c=scenario.air.ground_c,
        )
        transport = link(self._autopilot) if link is not None else self._autopilot
        self.transport = _LoggingTransport(transport, clock, tlog)
        self.bridge = Bridge(
            airframe,
            bus,
            clock,
            self.transport,
            recorder=recorder,
            report=lambda severity, text: self._log.record_text(self.now_s(), severity, text),
            thermometer=LoopReader(self._thermometer),
        )

    def now_s(self) -> float:
        """Time of the flight [s]."""
        return self._clock.now() - self._start_s

    def height_m(self) -> float:
        """Present vertical distance from where the fused stream measures to the surface below [m]."""
        return self.world.height_m(self.vehicle.pose(self.now_s())) - self._reference_down_m

    def fly(self) -> Generator[list[Step], None, None]:
        """Fly to the end, yielding after each step of the bridge; `flight` is complete when the iterator ends."""
        end_s = self._start_s + self._duration_s
        now, step = self._clock.now, self.bridge.step
        try:
            while now() < end_s:
                steps = step()
                for each in steps:
                    self._log.record_step(each)
                yield steps
        finally:
            self._finish()

    def _thermometer(self, source: FileSource) -> float:
        """Reading of the vehicle's thermometers, instead of this computer's own files."""
        return self._displayed_c(self.now_s(), self._air_c) / source.scale

    def _air_c(self, time_s: float) -> float:
        """Air temperature at the vehicle at a time of the flight [deg C]."""
        return self.world.air_temperature_c(-self.vehicle.pose(time_s).position_ned_m[2])

    def _finish(self) -> None:
        self._log.finish(self.now_s(), self.bridge)
        flight = self.flight
        flight.autopilot_received = dict(self._autopilot.received_counts())
        flight.frames_sha256 = self.transport.sha256.hexdigest()
        self.transport.close()

    @property
    def received(self) -> list[tuple[float, Any]]:
        """Messages received by the autopilot: time of the flight [s], message."""
        return self._autopilot.received
