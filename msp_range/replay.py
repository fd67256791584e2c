"""A recording, or a table of measured readings, through the same bridge again.

The readings are played through a bus whose sensors answer with them, at their own times on a virtual clock; so a
change to a filter or a gate is tried on what really happened.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

from msp_range.bridge import polled_sensors
from msp_range.bus.replay import RecordedPing, ReplayBus
from msp_range.config import Airframe
from msp_range.reading import Reading
from msp_range.recording.error import RecordingError
from msp_range.sensors.polling import PolledSensor

TOGETHER_S = 0.005
"""Pings of several sensors that are no farther apart than this were one group's [s]."""


class RecordedOrder:
    """A `Schedule`: sensors ping when they did."""

    def __init__(self, airframe: Airframe, bus: ReplayBus) -> None:
        self._bus = bus
        polled = polled_sensors(airframe, bus)
        self._sensors = {sensor.address: polled[sensor.name] for sensor in airframe.sensors}

    def turn(self, last_ping_s: float) -> tuple[float, Sequence[PolledSensor]]:
        """The sensors that come next in the record; at infinity where it has ended."""
        pings = {address: self._bus.next_ping_s(address) for address in self._sensors}
        times_s = {address: ping_s for address, ping_s in pings.items() if ping_s is not None}
        if not times_s:
            return float("inf"), ()
        first_s = min(times_s.values())
        return first_s, [self._sensors[each] for each, ping_s in times_s.items() if ping_s - first_s <= TOGETHER_S]

    def hear(self, reading: Reading) -> None:
        """A record does not change with what is heard."""


def by_address(
    airframe: Airframe, pings: Mapping[str, Sequence[RecordedPing]], source: Path
) -> dict[int, Sequence[RecordedPing]]:
    """Recorded pings by sensor name -> by the addresses of the airframe's sensors.

    Raises
    ------
    RecordingError
        The record has a sensor that the airframe has not.
    """
    addresses = {sensor.name: sensor.address for sensor in airframe.sensors}
    strangers = [name for name in pings if name not in addresses]
    if strangers:
        raise RecordingError(
            f"{source}: has readings of {', '.join(strangers)}, but the airframe's sensors are "
            f"{', '.join(addresses)}; name an airframe whose sensors have these names with --airframe"
        )
    return {addresses[name]: each for name, each in pings.items()}
