"""The bench: sensors that are polled as by the bridge, and the context of each of their readings.

For a point and its columns it gives rangings, each with its columns. The true range of a moving target follows from the
time of the echo, and the lag behind another sensor from the times at which the pings were sent.
"""

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol

from msp_lab.campaigns.campaign import Campaign
from msp_lab.campaigns.plan import Point
from msp_range.assembly import answer_timing
from msp_range.bus import Address, Bus, BusError
from msp_range.bus.smbus import BusInUse, KernelBus
from msp_range.clock import Clock, SystemClock
from msp_range.correction.temperature import COLDEST_C, HOTTEST_C, FileSource
from msp_range.correction.thermometer import Sample, ThreadReader
from msp_range.reading import Decoded
from msp_range.sensors.base import RangeSensor
from msp_range.sensors.polling import Poller, Ranging
from msp_range.sensors.schedule import PolledSensor, RoundRobin
from msp_range.yaml_file import ConfigError

Columns = Mapping[str, float | str]
"""Context of a reading by column of the CSV form."""


class Bench(Protocol):
    """Sensors, and the set-up in front of them."""

    @property
    def description(self) -> str:
        """Description of the bench; recordings of different benches are never mixed."""

    @property
    def clock(self) -> Clock:
        """Clock of the bench."""

    def begin(self, point: Point, attempt: int, columns: Columns, done: int) -> tuple[Bus, int]:
        """Prepare a point.

        Parameters
        ----------
        point, columns
            The set-up, and its context.
        attempt
            1, or more where the point is read again.
        done
            Rangings of this attempt that are already recorded, before an interruption.

        Returns
        -------
        tuple
            The bus, and how many of the next rangings repeat recorded ones: 0 at a real bench, ``done`` where every
            point is simulated again from its beginning.
        """

    def air_c(self, now_s: float) -> float | None:
        """Air temperature at the sensor from a thermometer [deg C]; None without a valid one."""


class KernelBench:
    """Real sensors on this computer's bus and serial ports.

    Parameters
    ----------
    bus
        Number of the I2C bus, or its path.
    addresses
        Those of the sensors; without one on the bus it is left alone.
    thermometer
        That of the bench, or None.
    """

    def __init__(self, bus: int | str, addresses: Sequence[Address], thermometer: FileSource | None) -> None:
        self._bus = KernelBus(bus)
        self._ports = [address for address in addresses if isinstance(address, str)]
        self._on_i2c = len(self._ports) < len(addresses)
        self.clock: Clock = SystemClock()
        self._thermometer = thermometer
        self._reader = ThreadReader(self.clock)
        self._sample: Sample | None = None
        self.description = "sensors on a bus"

    def open(self) -> None:
        """Open bus and ports of the sensors and read the thermometer, before anything is set up.

        Raises
        ------
        ConfigError
            One of them cannot be opened.
        BusInUse
            Another process uses the bus.
        """
        self.air_c(self.clock.now())
        try:
            if self._on_i2c:
                self._bus.reopen()
            for port in self._ports:
                self._bus.write(port, b"")
        except BusInUse:
            raise
        except BusError as error:
            is_port = isinstance(error.address, str)
            question = "is it plugged in and the right one" if is_port else "is I2C switched on, is --bus the right one"
            raise ConfigError(
                f"{error.address if is_port else self._bus.path}: cannot be opened: {os.strerror(error.errno or 0)}; "
                f"{question}, and do you have access? msp-lab collect --simulate runs a campaign without sensors"
            ) from None

    def begin(self, point: Point, attempt: int, columns: Columns, done: int) -> tuple[Bus, int]:
        """Return the open bus."""
        return self._bus, 0

    def air_c(self, now_s: float) -> float | None:
        """Return the newest value while it is recent. Jumps are accepted: at a bench people cause them."""
        if self._thermometer is None:
            return None
        self._sample = self._reader.newest(self._thermometer, now_s) or self._sample
        if self._sample is None or now_s - self._sample.time_s > self._thermometer.max_age_s:
            return None
        air_c = self._sample.reported_c - self._thermometer.bias_c
        return air_c if COLDEST_C <= air_c <= HOTTEST_C else None

    def close(self) -> None:
        """Release bus and ports."""
        self._reader.close()
        self._bus.close()


class KnownRanging(NamedTuple):
    """A ranging and its context."""

    ranging: Ranging
    columns: dict[str, float | str]


class _RecordedSensor:
    """A `RangeSensor` that also keeps ``lag_s``, the time from the last ping of another sensor to its own ping [s];
    None if its ping was not sent, or is the first.

    ``pings_s`` has the time of each sensor's last ping [s], taken right after its command was written.
    """

    def __init__(self, name: str, device: RangeSensor, clock: Clock, pings_s: dict[str, float]) -> None:
        self._name = name
        self._device = device
        self._clock = clock
        self._pings_s = pings_s
        self.address = device.address
        self.lag_s: float | None = None

    def ping(self) -> None:
        """Start a ranging."""
        self.lag_s = None
        self._device.ping()
        now_s = self._clock.now()
        self._pings_s.pop(self._name, None)
        if self._pings_s:
            self.lag_s = now_s - max(self._pings_s.values())
        self._pings_s[self._name] = now_s

    def answer(self) -> Decoded:
        """Return the result of the ranging."""
        return self._device.answer()


def rangings(campaign: Campaign, point: Point, columns: Columns, bus: Bus, clock: Clock) -> Iterator[KnownRanging]:
    """Ping the sensors of a point until the caller stops.

    Parameters
    ----------
    campaign, point
        Sensors, their models, and the order of their pings.
    columns
        Context of all readings; ``true_range_cm`` is where a movement starts, now.
    bus, clock
        Bus and clock of the bench.

    Yields
    ------
    KnownRanging
        In the order in which they ended, unanswered ones included.
    """
    pings_s: dict[str, float] = {}
    devices: dict[str, _RecordedSensor] = {}
    polled: list[PolledSensor] = []
    interval_s = 0.0
    for name in point.setup.sensors:
        sensor = campaign.sensor(name)
        devices[name] = _RecordedSensor(name, sensor.driver(bus, sensor.address), clock, pings_s)
        polled.append(PolledSensor(name, devices[name], answer_timing(sensor)))
        interval_s = max(interval_s, sensor.sensor_model.timing.ping_interval_s)
    groups = [polled] if point.firing == "simultaneous" else [[single] for single in polled]
    start_s = clock.now()
    # The order of the pings is part of the set-up: a sensor that does not answer keeps its slot.
    poller = Poller(bus, clock, RoundRobin(groups, interval_s, start_s, dead_after=math.inf))
    rate_cm_s = 0.0 if point.setup.movement is None else point.setup.movement.rate_cm_s
    while True:
        clock.sleep_until(poller.next_event_s)
        for ranging in poller.step():
            device = devices[ranging.reading.sensor]
            yield KnownRanging(ranging, _columns(columns, ranging, device, rate_cm_s, start_s))


def _columns(
    columns: Columns, ranging: Ranging, device: _RecordedSensor, rate_cm_s: float, start_s: float
) -> dict[str, float | str]:
    def range_cm(time_s: float) -> float:
        start_cm = float(columns["true_range_cm"])
        return round(start_cm + rate_cm_s * (time_s - start_s), 3) if rate_cm_s else start_cm

    known = {**columns, "true_range_cm": range_cm(ranging.reading.time_s)}
    if device.lag_s is not None:
        known["neighbour_lag_ms"] = round(device.lag_s * 1e3, 3)
        # They face the same target.
        known["neighbour_range_cm"] = range_cm(ranging.ping_s - device.lag_s)
    return known
