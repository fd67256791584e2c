"""`msp-range doctor` on a computer that is busy: what it does late is no fault of a sensor."""

from collections.abc import Sequence

import pytest

from msp_range.bus import Address
from msp_range.clock import VirtualClock
from msp_range.config import load_airframe
from msp_range.doctor.sensors import examine_sensors
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.mb1242 import EmulatedMB1242


class LateBus(EmulatedBus):
    """A range command reaches its sensor when the program has had to wait for a processor."""

    def __init__(self, clock: VirtualClock, late_s: float) -> None:
        devices = [EmulatedMB1242(0x70 + number, clock.now, lambda ping_s: 700) for number in range(4)]
        super().__init__(devices, clock.now)
        self._clock, self._late_s = clock, late_s

    def write(self, address: Address, data: bytes) -> None:
        self._clock.sleep_until(self._clock.now() + self._late_s)
        super().write(address, data)


class BusyClock(VirtualClock):
    """Every n-th sleep takes longer, since the program has had to wait for a processor."""

    def __init__(self, every: int) -> None:
        super().__init__()
        self._every, self._sleeps = every, 0

    def sleep_until(self, time_s: float, files: Sequence[int] = ()) -> bool:
        self._sleeps += 1
        return super().sleep_until(time_s + 0.25 * (self._sleeps % self._every == 0), files)


@pytest.mark.parametrize(("every", "verdict"), [(3, "unknown"), (30, "right")])
def test_an_answer_that_is_read_late_is_no_fault(every: int, verdict: str) -> None:
    """It is asked for again; where all are late, nothing is known of the sensors."""
    clock = BusyClock(every)
    found = examine_sensors(load_airframe("configs/quad_pallet.yaml"), LateBus(clock, 0.0), clock).findings
    assert [f"{each.step}: {each.text}" for each in found if each.verdict == "wrong"] == []
    assert {str(each.verdict) for each in found if each.step.startswith("readings of")} == {verdict}


@pytest.mark.parametrize("late_s", [0.0, 0.07])
def test_a_range_command_that_is_written_late_is_answered_all_the_same(late_s: float) -> None:
    clock = VirtualClock()
    found = examine_sensors(load_airframe("configs/quad_pallet.yaml"), LateBus(clock, late_s), clock).findings
    assert [f"{each.step}: {each.text}" for each in found if each.verdict == "wrong"] == []
