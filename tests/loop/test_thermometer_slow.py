"""A thermometer that takes long for a value, next to the polling in real time."""

import threading

from msp_range.bridge import Bridge
from msp_range.clock import SystemClock
from msp_range.correction.temperature import FileSource
from msp_range.correction.thermometer import ThreadReader
from msp_range.replay import Nowhere
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.mb1242 import EmulatedMB1242
from tests.support.bench import airframe
from tests.support.waiting import LIMIT_S, until

READINGS = 7
"""While one value is read: a DS18B20 takes 0.75 s for it, and four sensors are read 9.1 times a second."""


def test_a_slow_thermometer_does_not_slow_the_polling() -> None:
    """Each read ends when so many readings have come since it began: with a polling that waited for it, none would."""
    clock, readings, reads = SystemClock(), 0, 0
    go_on = threading.Semaphore(0)

    def slow(source: FileSource) -> float:
        nonlocal reads
        reads += 1
        assert go_on.acquire(timeout=LIMIT_S), "the polling waits for the thermometer"
        return 21000.0

    reader = ThreadReader(clock, slow)
    devices = [EmulatedMB1242(address, clock.now, lambda ping_s: 300) for address in range(0x70, 0x74)]
    vehicle = airframe(temperature={"sources": [{"source": "file", "path": "temp1_input"}]})
    bridge = Bridge(vehicle, EmulatedBus(devices, clock.now), clock, Nowhere(), thermometer=reader)

    def work() -> None:
        nonlocal readings
        readings += len(bridge.step())

    def poll_while_it_is_read(count: int) -> None:
        until(lambda: reads == count, work=work)
        wanted = readings + READINGS
        until(lambda: readings >= wanted, work=work)
        go_on.release()

    poll_while_it_is_read(1)
    poll_while_it_is_read(2)
    reader.close()
