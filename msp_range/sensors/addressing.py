"""List the devices on the bus, and change a sensor's address without losing it.

Two sensors at one address answer together and cannot be separated again, so a change that could lead to that is
refused, and every change is verified. The drivers contain how their kind of sensor is recognised and moved.
"""

from collections.abc import Sequence

from msp_range.bus import Bus
from msp_range.clock import Clock
from msp_range.sensors.base import OTHERS, AddressError, Driver, FoundDevice, acknowledges
from msp_range.sensors.table import drivers_at, longest_busy_s

FIRST_ADDRESS, LAST_ADDRESS = 0x03, 0x77
"""First and last 7-bit address of a device; the others are reserved by the I2C specification."""


def scan(bus: Bus, clock: Clock, *, identify: bool, driver: type[Driver] | None = None) -> list[FoundDevice]:
    """List every device that acknowledges.

    Parameters
    ----------
    identify
        Trigger a measurement of every device that acknowledges, to find out whether it is a range finder. Other devices
        may interpret that as a command of theirs; False only reads.
    driver
        The kind of sensor to look for; None: at each address those with this default address, then the default kind.

    Raises
    ------
    BusError
        The bus itself does not work.
    """
    return [
        _identify(bus, clock, address, drivers_at(address) if driver is None else [driver])
        if identify
        else FoundDevice(address, False, OTHERS.get(address, ""))
        for address in _present(bus, clock, range(FIRST_ADDRESS, LAST_ADDRESS + 1))
    ]


def _identify(bus: Bus, clock: Clock, address: int, drivers: list[type[Driver]]) -> FoundDevice:
    """The result of the first of these kinds that recognises the device; otherwise the result of the first kind."""
    found = (driver.identify(bus, clock, address) for driver in drivers)
    first = next(found)
    return first if first.ranged else next((device for device in found if device.ranged), first)


def _present(bus: Bus, clock: Clock, addresses: Sequence[int]) -> list[int]:
    """The addresses among these at which a device acknowledges, in ascending order."""
    there = {address for address in addresses if acknowledges(bus, address)}
    if len(there) < len(addresses):
        # A sensor that is measuring does not acknowledge.
        clock.sleep_until(clock.now() + longest_busy_s())
        there |= {address for address in addresses if address not in there and acknowledges(bus, address)}
    return sorted(there)


def check_new_address(new: int, driver: type[Driver]) -> None:
    """Refuse a 7-bit address that the sensor would ignore.

    Raises
    ------
    AddressError
        The address is reserved, or this kind of sensor ignores it.
    """
    if not FIRST_ADDRESS <= new <= LAST_ADDRESS:
        raise AddressError(
            f"0x{new:02x} is not an address for a device; expected the 7-bit form, "
            f"0x{FIRST_ADDRESS:02x} to 0x{LAST_ADDRESS:02x} (0x70 is 0xE0 in the 8-bit form of some data sheets)"
        )
    if driver.ignores_address(new):
        raise AddressError(f"{driver.part} ignores the address 0x{new:02x}; choose another one")


def change_address(bus: Bus, clock: Clock, old: int, new: int, driver: type[Driver]) -> FoundDevice:
    """Give the sensor at ``old`` the address ``new`` (both 7-bit), and verify it there.

    Raises
    ------
    AddressError
        ``new`` is invalid or in use, there is no such sensor at ``old``, or it did not move.
    BusError
        The bus itself does not work.
    """
    check_new_address(new, driver)
    if old == new:
        raise AddressError(f"the sensor is to move from 0x{old:02x} to the same address; nothing to do")
    if not _present(bus, clock, [old]):
        raise AddressError(f"nothing acknowledges at 0x{old:02x}; 'msp-range scan' shows what is on the bus")
    if _present(bus, clock, [new]):
        raise AddressError(f"0x{new:02x} is in use; two devices at one address could not be separated again")
    before = driver.identify(bus, clock, old)
    if not before.ranged:
        raise AddressError(f"the device at 0x{old:02x} is left alone: {before.answer}")
    driver.move(bus, clock, old, new)
    after = driver.identify(bus, clock, new) if _present(bus, clock, [new]) else None
    if _present(bus, clock, [old]):
        state = "nothing is" if after is None else "a device is too"
        raise AddressError(
            f"a device still answers at 0x{old:02x}, and {state} at 0x{new:02x}: were two sensors at 0x{old:02x}? "
            "Connect one at a time"
        )
    if after is None:
        raise AddressError(
            f"the sensor answers neither at 0x{old:02x} nor at 0x{new:02x}; switch its power off and on, then scan"
        )
    if not after.ranged:
        raise AddressError(f"the device at 0x{new:02x} does not behave as {driver.part}: {after.answer}")
    return after
