"""What is on the bus, and changing a sensor's address without losing it.

An MB1242 takes a new address from one write of 0xAA 0xA5 and the address in its 8-bit form, and keeps it without
power. Two sensors at one address answer together and cannot be told apart again, so a change is refused wherever that
could come of it, and verified afterwards.
"""

from dataclasses import dataclass

from msp_range.bus import Bus, BusError
from msp_range.clock import Clock
from msp_range.sensors.mb1242 import ANSWER_BYTES, COMMAND_RANGE, decode

FIRST_ADDRESS, LAST_ADDRESS = 0x03, 0x77
"""The 7-bit addresses that devices may have; the rest are reserved by the I2C specification."""
ILLEGAL_8BIT = frozenset({0, 80, 164, 170})
"""Addresses in 8-bit form that the sensor ignores."""
UNLOCK = b"\xaa\xa5"
CHANGE_S = 0.125
"""Time that the sensor needs to store a new address."""
RANGING_S = 0.080
"""A ranging is over by then."""
RANGES_STILL_S = 0.008
"""No ranging is over by then."""
POLL_INTERVAL_S = 0.002
OTHERS = {
    0x70: "also the address of an SHTC3, a PCA9685 (all call) or a TCA9548A",
    0x71: "also an address of a TCA9548A",
    0x76: "also an address of a BME280",
    0x77: "also an address of a BME280",
}


class AddressError(ValueError):
    """An address change that was refused, or whose outcome is not the one wanted."""


@dataclass(frozen=True, slots=True)
class Found:
    """A device that acknowledged.

    Attributes
    ----------
    address
        7-bit address.
    ranged
        True where it behaved as an MB1242 does: took the range command, did not acknowledge while it ranged, and
        answered what can be a range.
    answer
        What it answered, in words.
    """

    address: int
    ranged: bool
    answer: str


def scan(bus: Bus, clock: Clock, *, identify: bool) -> list[Found]:
    """Every device that acknowledges.

    Parameters
    ----------
    identify
        Send the range command to every device that acknowledges, to see whether it is a range finder. Other devices
        may take that for a command of theirs; False only reads.

    Raises
    ------
    BusError
        The bus itself does not work.
    """
    addresses = range(FIRST_ADDRESS, LAST_ADDRESS + 1)
    there = {address for address in addresses if _acknowledges(bus, address)}
    # A sensor that was ranging did not acknowledge.
    clock.sleep_until(clock.now() + RANGING_S)
    there |= {address for address in addresses if address not in there and _acknowledges(bus, address)}
    return [
        _identify(bus, clock, address) if identify else Found(address, False, OTHERS.get(address, ""))
        for address in sorted(there)
    ]


def _present(bus: Bus, clock: Clock, address: int) -> bool:
    if _acknowledges(bus, address):
        return True
    clock.sleep_until(clock.now() + RANGING_S)
    return _acknowledges(bus, address)


def _acknowledges(bus: Bus, address: int) -> bool:
    try:
        bus.read(address, 1)
    except BusError as error:
        if error.bus_at_fault:
            raise
        return False
    return True


def _identify(bus: Bus, clock: Clock, address: int) -> Found:
    note = OTHERS.get(address, "")
    try:
        bus.write(address, COMMAND_RANGE)
        pinged_s = clock.now()
        clock.sleep_until(pinged_s + RANGES_STILL_S)
        busy = not _acknowledges(bus, address)
        first = _first_answer(bus, clock, address, pinged_s + RANGING_S)
        clock.sleep_until(pinged_s + RANGING_S)
        answer = bus.read(address, ANSWER_BYTES)
    except BusError as error:
        return Found(address, False, f"no answer to the range command (errno {error.errno}); {note}".rstrip("; "))
    if not busy:
        return Found(address, False, f"not an MB1242: it answers while it should be ranging; {note}".rstrip("; "))
    if first not in (None, answer):
        return Found(address, False, "its answer changes without a new ranging: are two sensors at this address?")
    decoded = decode(answer)
    if decoded.status.is_fault:
        return Found(address, False, f"ranges, but answers 0x{decoded.raw or 0:04x} ({decoded.status.value})")
    return Found(address, True, f"MB1242: {decoded.raw} cm" + (" (no echo)" if decoded.range_m is None else ""))


def _first_answer(bus: Bus, clock: Clock, address: int, until_s: float) -> bytes | None:
    """What is read as soon as somebody acknowledges: of two sensors the one that is nearer to something."""
    while clock.now() < until_s:
        try:
            return bus.read(address, ANSWER_BYTES)
        except BusError:
            clock.sleep_until(clock.now() + POLL_INTERVAL_S)
    return None


def check_new_address(new: int) -> None:
    """Refuse a 7-bit address that the sensor would ignore.

    Raises
    ------
    AddressError
        It is reserved, or one of those that an MB1242 ignores.
    """
    if not FIRST_ADDRESS <= new <= LAST_ADDRESS:
        raise AddressError(
            f"0x{new:02x} is not an address for a device; expected the 7-bit form, "
            f"0x{FIRST_ADDRESS:02x} to 0x{LAST_ADDRESS:02x} (0x70 is 0xE0 in the 8-bit form of some data sheets)"
        )
    if new << 1 in ILLEGAL_8BIT:
        raise AddressError(f"an MB1242 ignores the address 0x{new:02x}; choose another one")


def change_address(bus: Bus, clock: Clock, old: int, new: int) -> Found:
    """Give the sensor at ``old`` the address ``new`` (both 7-bit), and verify it there.

    Raises
    ------
    AddressError
        ``new`` is illegal or taken, nothing that behaves as an MB1242 is at ``old``, or the sensor did not move.
    BusError
        The bus itself does not work.
    """
    check_new_address(new)
    if old == new:
        raise AddressError(f"the sensor is to move from 0x{old:02x} to the same address; nothing to do")
    if not _present(bus, clock, old):
        raise AddressError(f"nothing acknowledges at 0x{old:02x}; 'msp-range scan' shows what is on the bus")
    if _present(bus, clock, new):
        raise AddressError(f"0x{new:02x} is taken already; two devices there could not be told apart again")
    before = _identify(bus, clock, old)
    if not before.ranged:
        raise AddressError(f"the device at 0x{old:02x} is left alone: {before.answer}")
    bus.write(old, UNLOCK + bytes([new << 1]))
    clock.sleep_until(clock.now() + CHANGE_S)
    after = _identify(bus, clock, new) if _present(bus, clock, new) else None
    if _present(bus, clock, old):
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
        raise AddressError(f"the device at 0x{new:02x} does not behave as an MB1242: {after.answer}")
    return after
