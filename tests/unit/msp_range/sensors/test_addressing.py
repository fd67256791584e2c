"""What is on the bus, and address changes that must not lose a sensor."""

import errno
from collections.abc import Callable, Sequence

import pytest

from msp_range.bus import BusError
from msp_range.clock import VirtualClock
from msp_range.sensors.addressing import change_address, check_new_address, scan
from msp_range.sensors.base import AddressError, FoundDevice
from msp_range.sensors.mb1242 import MB1242 as DRIVER
from msp_sim.device.bus import Device, EmulatedBus
from msp_sim.device.device import Fault, NotAcknowledged
from msp_sim.device.mb1242 import EmulatedMB1242
from tests.support.plain_device import PlainDevice

NACK_ERRNOS = [errno.EREMOTEIO, errno.ENXIO, errno.ENODEV]
Making = Callable[[VirtualClock], Device]


def sonar(address: int, reading_cm: int = 258, *faults: Fault) -> Making:
    return lambda clock: EmulatedMB1242(address, clock.now, lambda ping_s: reading_cm, faults=faults)


def other(address: int, answer: bytes = b"\x00\x00", *faults: Fault) -> Making:
    return lambda clock: PlainDevice(address, answer, faults)


def wires(*making: Making, nack_errno: int = errno.EREMOTEIO) -> tuple[EmulatedBus, VirtualClock, list[Device]]:
    clock = VirtualClock(10.0)
    devices = [make(clock) for make in making]
    return EmulatedBus(devices, clock.now, nack_errno), clock, devices


@pytest.mark.parametrize("nack_errno", NACK_ERRNOS)
def test_scan_distinguishes_sonars_from_other_devices(nack_errno: int) -> None:
    bus, clock, _ = wires(
        sonar(0x77, 765), sonar(0x03), other(0x70, b"\x01\x00"), other(0x44, b"\xff\xff"), nack_errno=nack_errno
    )
    found = {each.address: each for each in scan(bus, clock, identify=True)}
    assert sorted(found) == [0x03, 0x44, 0x70, 0x77]
    assert [address for address, each in found.items() if each.ranged] == [0x03, 0x77]
    assert found[0x03].answer == "MB1242: 258 cm"
    assert "no echo" in found[0x77].answer
    assert "answers while it should be ranging" in found[0x70].answer
    assert "SHTC3" in found[0x70].answer


def test_scan_without_identifying_only_reads() -> None:
    bus, clock, (device,) = wires(sonar(0x70))
    assert [(each.address, each.ranged) for each in scan(bus, clock, identify=False)] == [(0x70, False)]
    assert isinstance(device, EmulatedMB1242)
    assert device.pings == 0


def test_scan_finds_a_sensor_that_is_ranging() -> None:
    bus, clock, _ = wires(sonar(0x70))
    bus.write(0x70, b"\x51")
    assert [each.ranged for each in scan(bus, clock, identify=True)] == [True]


def test_scan_reports_a_bus_that_does_not_work() -> None:
    bus, clock, _ = wires(sonar(0x70, 258, Fault("locked_up", 0.0, 100.0)))
    with pytest.raises(BusError, match="errno 110"):
        scan(bus, clock, identify=True)


def test_a_sonar_with_a_clock_fault_is_not_taken_for_a_good_one() -> None:
    bus, clock, _ = wires(sonar(0x70, 258, Fault("clock_fault", 0.0, 100.0)))
    (found,) = scan(bus, clock, identify=True)
    assert not found.ranged
    assert "0x8102 (clock_fault)" in found.answer


@pytest.mark.parametrize("nack_errno", NACK_ERRNOS)
@pytest.mark.parametrize("ranging", [False, True])
def test_a_sensor_moves_and_is_verified_there(ranging: bool, nack_errno: int) -> None:
    bus, clock, (device, still) = wires(sonar(0x70), sonar(0x72, 100), nack_errno=nack_errno)
    if ranging:
        bus.write(0x70, b"\x51")
    assert change_address(bus, clock, 0x70, 0x71, DRIVER) == FoundDevice(0x71, True, "MB1242: 258 cm")
    assert (device.address, still.address) == (0x71, 0x72)


@pytest.mark.parametrize("new", [-1, 0x00, 0x02, 0x78, 0xE2])
def test_an_address_that_no_device_may_have(new: int) -> None:
    with pytest.raises(AddressError, match="7-bit"):
        check_new_address(new, DRIVER)


@pytest.mark.parametrize("new", [80 >> 1, 164 >> 1, 170 >> 1])
def test_an_address_that_the_sensor_ignores(new: int) -> None:
    with pytest.raises(AddressError, match=f"ignores the address 0x{new:02x}"):
        check_new_address(new, DRIVER)


@pytest.mark.parametrize("new", [0x03, 0x27, 0x29, 0x70, 0x77])
def test_any_other_address_will_do(new: int) -> None:
    check_new_address(new, DRIVER)


@pytest.mark.parametrize("busy", [False, True])
@pytest.mark.parametrize("there", [sonar(0x71, 765), other(0x71)])
def test_no_move_to_an_address_that_is_taken(there: Making, busy: bool) -> None:
    bus, clock, (device, _) = wires(sonar(0x70), there)
    if busy:
        bus.write(0x71, b"\x51")
    with pytest.raises(AddressError, match="0x71 is in use"):
        change_address(bus, clock, 0x70, 0x71, DRIVER)
    assert device.address == 0x70


class Mute(PlainDevice):
    """A device that can be read and takes no command."""

    def write(self, data: bytes) -> None:
        raise NotAcknowledged


@pytest.mark.parametrize(
    ("making", "old", "new", "message"),
    [
        ([sonar(0x70)], 0x70, 0x70, "nothing to do"),
        ([sonar(0x70)], 0x71, 0x72, "nothing acknowledges at 0x71"),
        ([sonar(0x70)], 0x70, 0x28, "ignores"),
        ([other(0x70)], 0x70, 0x71, "left alone: not an MB1242"),
        (
            [lambda clock: Mute(0x70, b"\x01\x02")],
            0x70,
            0x71,
            r"left alone: no answer to the range command \(errno 121",
        ),
        ([sonar(0x70, 258, Fault("impossible", 0.0, 100.0))], 0x70, 0x71, r"left alone: ranges, but answers 0x03e8"),
        ([sonar(0x70, 100), sonar(0x70, 300)], 0x70, 0x71, "left alone: .*two sensors at this address"),
    ],
)
def test_a_refused_change_writes_nothing_but_pings(making: list[Making], old: int, new: int, message: str) -> None:
    bus, clock, devices = wires(*making)
    addresses = [device.address for device in devices]
    with pytest.raises(AddressError, match=message):
        change_address(bus, clock, old, new, DRIVER)
    assert [device.address for device in devices] == addresses


class Deaf(EmulatedMB1242):
    """A sonar that acknowledges everything and takes range commands only."""

    def write(self, data: bytes) -> None:
        if len(data) == 1:
            super().write(data)


class Gone(EmulatedMB1242):
    """A sonar that an address change makes vanish."""

    def write(self, data: bytes) -> None:
        super().write(data)
        if len(data) == 3:
            self.address = 0x00


@pytest.mark.parametrize(
    ("kinds", "message"),
    [
        ([Deaf], "still answers at 0x70, and nothing is at 0x71"),
        ([Deaf, EmulatedMB1242], "still answers at 0x70, and a device is too at 0x71: were two sensors"),
        ([Gone], "neither at 0x70 nor at 0x71"),
    ],
)
def test_a_move_that_went_wrong_is_noticed(kinds: list[type[EmulatedMB1242]], message: str) -> None:
    clock = VirtualClock()
    bus = EmulatedBus([kind(0x70, clock.now, lambda ping_s: 258) for kind in kinds], clock.now)
    with pytest.raises(AddressError, match=message):
        change_address(bus, clock, 0x70, 0x71, DRIVER)


def test_a_move_to_something_that_does_not_range_is_noticed() -> None:
    """A device that was switched on at the new address at the same moment."""
    bus, clock, (device, plain) = wires(sonar(0x70), other(0x00))

    def write(data: bytes) -> None:
        type(device).write(device, data)
        if len(data) == 3:
            device.address, plain.address = 0x00, 0x71

    device.write = write  # type: ignore[method-assign]
    with pytest.raises(AddressError, match="0x71 does not behave as an MB1242"):
        change_address(bus, clock, 0x70, 0x71, DRIVER)


class BusyClock(VirtualClock):
    """The clock of a computer that wakes a program up late, the first ``late`` times."""

    def __init__(self, late: int) -> None:
        super().__init__(10.0)
        self._late = late

    def sleep_until(self, time_s: float, files: Sequence[int] = ()) -> bool:
        if 0.0 < time_s - self.now() < 0.02 and self._late > 0:
            self._late -= 1
            time_s += 0.2
        return super().sleep_until(time_s, files)


@pytest.mark.parametrize(("late", "ranged"), [(1, True), (4, True), (99, False)])
def test_a_sonar_that_a_busy_computer_asks_too_late_is_no_other_device(late: int, ranged: bool) -> None:
    clock = BusyClock(late)
    found = DRIVER.identify(EmulatedBus([sonar(0x70)(clock)], clock.now), clock, 0x70)
    assert found.ranged is ranged
    assert "not an" not in found.answer
