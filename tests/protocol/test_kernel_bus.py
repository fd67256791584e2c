"""The MB1242's protocol through the stock smbus2 and the kernel's I2C interface, in a program of its own."""

import errno
import json
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace

import pytest

from msp_sim.device.device import Fault
from msp_sim.device.mb1242 import NO_ECHO_CM, PART_INFO, TIMING
from tests.support.kernel_bus import HWMON_FILE, IIO_FILE, KernelTestbed, Other, Sonar, kernel_bus
from tests.support.known import known
from tests.support.waiting import LIMIT_S

FRONT, REAR = 0x70, 0x71
LONG = replace(TIMING, ready_s=60.0)
"""A ranging that does not end within a test."""

PROGRAM_START = """
import json, time
from msp_range.bus.base import BusError
from msp_range.bus.smbus import KernelBus

def attempt(transfer, *arguments):
    "The bytes in hexadecimal, None for a write, the errno of a failure."
    try:
        answer = transfer(*arguments)
    except OSError as error:
        return error.errno
    return answer.hex() if isinstance(answer, bytes) else answer

def read_when_ready(address):
    "What the sensor reports at the end of its ranging."
    while True:
        try:
            return bus.read(address, 2).hex()
        except BusError:
            time.sleep(0.001)

def show(*values):
    print(json.dumps(values))

bus = KernelBus(1)
"""


def program(testbed: KernelTestbed, code: str) -> list[object]:
    """Run ``code`` in another Python on the testbed and return what it shows, flat."""
    done = testbed.run([sys.executable, "-c", PROGRAM_START + textwrap.dedent(code)])
    assert done.returncode == 0, done.stderr
    return [value for line in done.stdout.splitlines() for value in json.loads(line)]


def pings(testbed: KernelTestbed, address: int) -> int:
    """Range commands that the sensor took."""
    return sum(t.verb == "write" and t.address == address and t.data == b"\x51" for t in testbed.journal())


def test_ping_wait_read() -> None:
    with kernel_bus([Sonar(FRONT, [258, 765]), Sonar(REAR, [20])]) as testbed:
        shown = program(
            testbed,
            """
            show(bus.read(0x70, 2).hex())
            for address in (0x70, 0x71, 0x70):
                bus.write(address, b"\\x51")
                show(read_when_ready(address))
            show(bus.read(0x70, 2).hex(), bus.read(0x71, 2).hex())
            """,
        )
        assert shown == [PART_INFO.hex(), "0102", "0014", "02fd", "02fd", "0014"]
        assert pings(testbed, FRONT) == 2


def test_nothing_is_acknowledged_while_ranging() -> None:
    with kernel_bus([Sonar(FRONT, timing=LONG), Sonar(REAR)]) as testbed:
        shown = program(
            testbed,
            """
            bus.write(0x70, b"\\x51")
            show(attempt(bus.read, 0x70, 2), attempt(bus.write, 0x70, b"\\x51"), attempt(bus.read, 0x71, 2))
            """,
        )
        assert shown == [errno.EREMOTEIO, errno.EREMOTEIO, PART_INFO.hex()]
        messages = [(transfer.verb, transfer.errno) for transfer in testbed.journal()]
        assert messages == [("write", 0), ("read", 121), ("write", 121), ("read", 0)]


def test_the_ranging_lasts_as_long_as_the_timing_says() -> None:
    timing = replace(TIMING, ready_s=0.1)
    with kernel_bus([Sonar(FRONT, [500], timing=timing)]) as testbed:
        program(testbed, 'bus.write(0x70, b"\\x51"); read_when_ready(0x70)')
        ping, *polls = testbed.journal()
        assert polls[-1].errno == 0
        assert all(poll.errno == errno.EREMOTEIO for poll in polls[:-1])
        # The margin is for a server that loses the processor between noting the time and asking the device.
        assert polls[-1].time_s - ping.time_s > timing.ranging_s(500, NO_ECHO_CM) - 0.05


@pytest.mark.parametrize("nack_errno", [errno.EREMOTEIO, errno.ENXIO, errno.ENODEV])
def test_absent_device_and_absent_bus(nack_errno: int) -> None:
    with kernel_bus([Sonar(FRONT)], nack_errno=nack_errno) as testbed:
        shown = program(
            testbed,
            """
            show(attempt(bus.read, 0x72, 2), attempt(bus.write, 0x72, b"\\x51"))
            try:
                KernelBus(9).read(0x70, 2)
            except BusError as error:
                show(error.errno, "/dev/i2c-9" in str(error))
            """,
        )
        assert shown == [nack_errno, nack_errno, errno.ENOENT, True]


def test_address_change() -> None:
    with kernel_bus([Sonar(FRONT, timing=replace(TIMING, address_change_s=2.0))]) as testbed:
        shown = program(
            testbed,
            """
            bus.write(0x70, bytes([0xAA, 0xA5, 164]))
            show(attempt(bus.read, 0x70, 2))
            bus.write(0x70, bytes([0xAA, 0xA5, 0xE5]))
            show(attempt(bus.read, 0x70, 2), attempt(bus.read, 0x72, 2))
            show(read_when_ready(0x72), attempt(bus.read, 0x70, 2))
            """,
        )
        not_there = errno.EREMOTEIO
        assert shown == [PART_INFO.hex(), not_there, not_there, PART_INFO.hex(), not_there]


def test_register_read_pings_again_or_reads_the_same_for_ever() -> None:
    """Why the driver uses one plain message: a register read writes the register first, and swaps the bytes."""
    with kernel_bus([Sonar(FRONT, [258, 300])]) as testbed:
        shown = program(
            testbed,
            """
            from smbus2 import SMBus
            bus.write(0x70, b"\\x51")
            show(read_when_ready(0x70))
            with SMBus(1) as registers:
                show(*(attempt(registers.read_word_data, 0x70, 0) for _ in range(2)))
                show(attempt(registers.read_word_data, 0x70, 0x51))
            show(read_when_ready(0x70))
            """,
        )
        assert shown == ["0102", 0x0201, 0x0201, errno.EREMOTEIO, "012c"]
        assert pings(testbed, FRONT) == 2


def test_smbus_transfers_that_need_no_register() -> None:
    with kernel_bus([Sonar(FRONT, [258]), Other(REAR, "0a0b0c")]) as testbed:
        shown = program(
            testbed,
            """
            from smbus2 import SMBus, i2c_msg
            with SMBus(1) as smbus:
                smbus.write_byte(0x70, 0x51)
                show(read_when_ready(0x70), smbus.read_byte(0x70))
                show(smbus.read_i2c_block_data(0x71, 0, 3))
                show(attempt(smbus.write_quick, 0x71), attempt(smbus.write_quick, 0x72))
                write, read = i2c_msg.write(0x71, [1]), i2c_msg.read(0x71, 2)
                smbus.i2c_rdwr(write, read)
                show(bytes(read).hex(), attempt(smbus.read_block_data, 0x71, 0))
            """,
        )
        assert shown == ["0102", 1, [10, 11, 12], None, errno.EREMOTEIO, "0a0b", errno.EOPNOTSUPP]


def test_lock_up_until_reopened() -> None:
    lock_up = Fault("locked_up", 0.0, 2.0)
    with kernel_bus([Sonar(FRONT), Other(0x40, faults=[lock_up])]) as testbed:
        shown = program(
            testbed,
            """
            show(attempt(bus.read, 0x70, 2))
            time.sleep(2.0)
            show(attempt(bus.read, 0x70, 2), attempt(bus.write, 0x72, b""))
            bus.reopen()
            show(attempt(bus.read, 0x70, 2))
            """,
        )
        assert shown == [errno.ETIMEDOUT, errno.ETIMEDOUT, errno.ETIMEDOUT, PART_INFO.hex()]


def test_a_program_that_polls_ends_on_sigterm() -> None:
    with kernel_bus([Sonar(FRONT)]) as testbed:
        code = PROGRAM_START + "print(flush=True)\nwhile True: attempt(bus.read, 0x70, 2)"
        polling = testbed.popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
        with polling:
            known(polling.stdout).readline()
            polling.terminate()
            assert polling.wait(LIMIT_S) == -signal.SIGTERM


def test_temperature_files() -> None:
    read_files = f'show(*(int(open(path).read()) for path in ("{HWMON_FILE}", "{IIO_FILE}")))'
    with kernel_bus([], temperature_c=15.25) as testbed:
        assert program(testbed, read_files) == [15250, 15250]
        testbed.set_temperature(-3.5)
        assert program(testbed, read_files) == [-3500, -3500]
