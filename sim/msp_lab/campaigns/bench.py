"""The bench: sensors that ping through the bridge's own polling, and what is known of each of their readings.

A point and its columns enter, rangings leave, each with the columns that hold for it. True ranges of a moving target
follow from the time of the echo, and the lag behind another sensor from the times at which pings really went out.
"""

import math
import os
from collections.abc import Iterator, Mapping
from typing import NamedTuple, Protocol

from msp_lab.campaigns.campaign import Campaign
from msp_lab.campaigns.plan import Point
from msp_range.bus import Bus, BusError
from msp_range.bus.smbus import BusInUse, KernelBus
from msp_range.clock import Clock, SystemClock
from msp_range.correction.temperature import COLDEST_C, HOTTEST_C, FileSource
from msp_range.correction.thermometer import Sample, ThreadReader
from msp_range.sensors.base import Decoded, RangeSensor
from msp_range.sensors.polling import Poller, Ranging
from msp_range.sensors.schedule import AnswerTiming, PolledSensor, RoundRobin, Spacing
from msp_range.yaml_file import ConfigError

Columns = Mapping[str, float | str]
"""What is known of a reading, by the CSV form's names."""


class Bench(Protocol):
    """Where the sensors are."""

    @property
    def description(self) -> str:
        """What it is; collections of different benches never mix."""
        ...

    @property
    def clock(self) -> Clock:
        """Its time."""
        ...

    def begin(self, point: Point, attempt: int, columns: Columns, done: int) -> tuple[Bus, int]:
        """Make ready for a point.

        Parameters
        ----------
        point, columns
            The set-up, and what is known of it.
        attempt
            1, or more where the point is read again.
        done
            Rangings of this attempt that are already recorded, before an interruption.

        Returns
        -------
        tuple
            The bus, and how many of the coming rangings are those that are already recorded: 0 where time goes on,
            ``done`` where every point happens again from its beginning.
        """
        ...

    def air_c(self, now_s: float) -> float | None:
        """Air temperature at the sensor from a thermometer [deg C]; None where there is none that is to be trusted."""
        ...


class KernelBench:
    """Real sensors on this computer's bus."""

    def __init__(self, bus: int | str, thermometer: FileSource | None) -> None:
        self._bus = KernelBus(bus)
        self.clock: Clock = SystemClock()
        self._thermometer = thermometer
        self._reader = ThreadReader(self.clock)
        self._sample: Sample | None = None
        self.description = "sensors on a bus"

    def open(self) -> None:
        """Open the bus, and have the thermometer read, before anybody sets anything up.

        Raises
        ------
        ConfigError
            It cannot be opened.
        BusInUse
            Another process works on it.
        """
        self.air_c(self.clock.now())
        try:
            self._bus.reopen()
        except BusInUse:
            raise
        except BusError as error:
            raise ConfigError(
                f"{self._bus.path}: cannot be opened: {os.strerror(error.errno or 0)}; is I2C switched on, is --bus "
                "the right one, and may you use it? msp-lab collect --simulate goes through a campaign without sensors"
            ) from None

    def begin(self, point: Point, attempt: int, columns: Columns, done: int) -> tuple[Bus, int]:
        """The bus as it is."""
        return self._bus, 0

    def air_c(self, now_s: float) -> float | None:
        """The thermometer's newest value, while it is new. No jump is refused: at a bench people cause them."""
        if self._thermometer is None:
            return None
        self._sample = self._reader.newest(self._thermometer, now_s) or self._sample
        if self._sample is None or now_s - self._sample.time_s > self._thermometer.max_age_s:
            return None
        air_c = self._sample.reported_c - self._thermometer.bias_c
        return air_c if COLDEST_C <= air_c <= HOTTEST_C else None

    def close(self) -> None:
        """Release the bus."""
        self._reader.close()
        self._bus.close()


class KnownRanging(NamedTuple):
    """A ranging, whether its ping went out, and what is known of it."""

    ranging: Ranging
    pinged: bool
    columns: dict[str, float | str]


class _Pings:
    """When each sensor pinged last, as noted right after its command was written."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._last_s: dict[str, float] = {}

    def note(self, sensor: str) -> tuple[float, str] | None:
        """Note a ping; returns the time since the last one of another sensor [s], and which, where there is one."""
        now_s = self._clock.now()
        others = [(ping_s, name) for name, ping_s in self._last_s.items() if name != sensor]
        self._last_s[sensor] = now_s
        if not others:
            return None
        last_s, name = max(others)
        return now_s - last_s, name


class _Noted:
    """A `RangeSensor` that notes its pings."""

    def __init__(self, name: str, device: RangeSensor, pings: _Pings) -> None:
        self._name = name
        self._device = device
        self._pings = pings
        self.address = device.address
        self.pinged = False
        self.neighbour: tuple[float, str] | None = None

    def ping(self) -> None:
        """Start a ranging."""
        self.pinged = False
        self._device.ping()
        self.pinged = True
        self.neighbour = self._pings.note(self._name)

    def answer(self, since_ping_s: float) -> Decoded:
        """The ranging's result."""
        return self._device.answer(since_ping_s)


def rangings(campaign: Campaign, point: Point, columns: Columns, bus: Bus, clock: Clock) -> Iterator[KnownRanging]:
    """Ping the sensors of a point for as long as the caller goes on asking.

    Parameters
    ----------
    campaign, point
        Sensors, their models, and who waits for whom.
    columns
        What holds for all readings; ``true_range_cm`` is where a movement begins, now.
    bus, clock
        Where the sensors answer, and what time is.

    Yields
    ------
    Known
        In the order in which they ended; an unanswered one too.
    """
    pings = _Pings(clock)
    devices: dict[str, _Noted] = {}
    polled: list[PolledSensor] = []
    interval_s = 0.0
    for name in point.setup.sensors:
        sensor = campaign.sensor(name)
        model = sensor.sensor_model
        timing = model.timing
        devices[name] = _Noted(name, sensor.driver(bus, sensor.address), pings)
        first_answer_s = timing.ready_s + model.minimum_cm * timing.s_per_cm
        asked = AnswerTiming(first_answer_s, timing.deadline_s, timing.s_per_cm * 100)
        polled.append(PolledSensor(name, devices[name], asked))
        interval_s = max(interval_s, timing.ping_interval_s)
    groups = [polled] if point.firing == "simultaneous" else [[each] for each in polled]
    start_s = clock.now()
    # Who pings before whom is part of the set-up: a sensor that does not answer keeps its slot.
    poller = Poller(bus, clock, RoundRobin(groups, Spacing(interval_s), start_s, dead_after=math.inf))
    rate_cm_s = 0.0 if point.setup.movement is None else point.setup.movement.rate_cm_s
    while True:
        clock.sleep_until(poller.next_event_s)
        for ranging in poller.step():
            device = devices[ranging.reading.sensor]
            yield KnownRanging(ranging, device.pinged, _columns(columns, ranging, device, rate_cm_s, start_s))


def _columns(
    columns: Columns, ranging: Ranging, device: _Noted, rate_cm_s: float, start_s: float
) -> dict[str, float | str]:
    known = dict(columns)
    start_cm = columns["true_range_cm"]
    if rate_cm_s and isinstance(start_cm, float):
        known["true_range_cm"] = round(start_cm + rate_cm_s * (ranging.reading.time_s - start_s), 3)
    if device.pinged and device.neighbour is not None:
        lag_s, _ = device.neighbour
        known["neighbour_lag_ms"] = round(lag_s * 1e3, 3)
        # They face the same target.
        neighbour_cm = start_cm
        if rate_cm_s and isinstance(start_cm, float):
            neighbour_cm = round(start_cm + rate_cm_s * (ranging.ping_s - lag_s - start_s), 3)
        known["neighbour_range_cm"] = neighbour_cm
    return known
