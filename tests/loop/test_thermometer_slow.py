"""A thermometer that takes long for a value, next to the polling in real time."""

import time
from collections.abc import Callable

from msp_range.bridge import Bridge
from msp_range.clock import SystemClock
from msp_range.correction.temperature import FileSource
from msp_range.correction.thermometer import ThreadReader
from msp_range.mavlink.transport import Nowhere
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.mb1242 import EmulatedMB1242
from tests.support.bench import airframe

DS18B20_S = 0.75


def readings_a_second(thermometer: Callable[[FileSource], float]) -> float:
    """Of four sensors in real time, with a file that is read like this."""
    clock = SystemClock()
    reader = ThreadReader(clock, thermometer)
    devices = [EmulatedMB1242(address, clock.now, lambda ping_s: 300) for address in range(0x70, 0x74)]
    vehicle = airframe(temperature={"sources": [{"source": "file", "path": "temp1_input"}]})
    bridge = Bridge(vehicle, EmulatedBus(devices, clock.now), clock, Nowhere(), thermometer=reader)
    start_s, readings = clock.now(), 0
    while clock.now() < start_s + 3.0:
        readings += len(bridge.step())
    reader.close()
    return readings / 3.0


def test_a_slow_thermometer_does_not_slow_the_polling() -> None:
    """A DS18B20 takes 0.75 s for a value: 2.4 readings a second instead of 9.1."""

    def slow(source: FileSource) -> float:
        time.sleep(DS18B20_S)
        return 21000.0

    assert readings_a_second(slow) > 8.0
