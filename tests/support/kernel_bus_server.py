"""An emulated kernel's /dev/i2c-1 with emulated devices behind it: the server's side of kernel_bus.py.

Runs under the system's own Python, where Debian's bindings of umockdev are. The specification is one line of JSON on
standard input; the answer is one line of JSON with the testbed's folder. Then each line "journal" is answered with
the transfers so far, each line of JSON with a reading for every sonar changes what they report, and the end of
standard input ends the server.
"""

import errno
import itertools
import json
import random
import struct
import sys
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from msp_sim.device.bus import Device, EmulatedBus
from msp_sim.device.device import DeviceTiming, Fault
from msp_sim.device.table import emulated_kind
from tests.support.plain_device import PlainDevice

# linux/i2c-dev.h and linux/i2c.h
I2C_RETRIES, I2C_TIMEOUT, I2C_SLAVE, I2C_FUNCS = 0x0701, 0x0702, 0x0703, 0x0705
I2C_SLAVE_FORCE, I2C_RDWR, I2C_SMBUS = 0x0706, 0x0707, 0x0720
I2C_M_RD = 0x0001
FUNCTIONS = 0x0C7F0001  # I2C_FUNC_I2C and the SMBus transfers below
SMBUS_QUICK, SMBUS_BYTE, SMBUS_BYTE_DATA, SMBUS_WORD_DATA, SMBUS_I2C_BLOCK_DATA = 0, 1, 2, 3, 8
SMBUS_DATA_LENGTH = 34
SMBUS_COUNTS = {SMBUS_BYTE: 1, SMBUS_BYTE_DATA: 1, SMBUS_WORD_DATA: 2}


class IoctlData(Protocol):
    """A piece of the client's memory, as UMockdev.IoctlData."""

    def retrieve(self) -> Sequence[int]: ...
    def resolve(self, offset: int, length: int) -> "IoctlData | None": ...
    def update(self, offset: int, data: list[int]) -> None: ...


class IoctlClient(Protocol):
    """The program that called, as UMockdev.IoctlClient."""

    def get_request(self) -> int: ...
    def get_arg(self) -> IoctlData: ...
    def complete(self, result: int, error: int) -> None: ...


class TimeSinceOpened:
    """Seconds since a program first opened the bus: the clock of the devices and of their faults."""

    def __init__(self) -> None:
        self.start_s: float | None = None

    def opened(self) -> None:
        if self.start_s is None:
            self.start_s = time.monotonic()

    def __call__(self) -> float:
        assert self.start_s is not None
        return time.monotonic() - self.start_s


class KernelInterface:
    """Turns the ioctl calls of i2c-dev into transfers of an EmulatedBus."""

    def __init__(self, bus: EmulatedBus, timeout_s: float) -> None:
        self.bus = bus
        self.timeout_s = timeout_s
        self.journal: deque[tuple[float, str, int, str, int | None]] = deque(maxlen=200_000)
        self.addresses: dict[int, int] = {}
        self.silent: set[int] = set()
        self.times_out = False

    def handle(self, _device: object, client: IoctlClient) -> bool:
        """Answer one ioctl. Nothing may be raised from here: the client would wait for ever."""
        try:
            # Two objects of the binding may stand for one client; their hash is the client's.
            result, error = self.ioctl(hash(client), client.get_request(), client.get_arg()), 0
        except OSError as failure:
            result, error = -1, failure.errno or errno.EIO
        except Exception:
            traceback.print_exc()
            result, error = -1, errno.EIO
        client.complete(result, error)
        return True

    def ioctl(self, client: int, request: int, argument: IoctlData) -> int:
        """Return what the system call returns; raises OSError with its errno."""
        if request in (I2C_SLAVE, I2C_SLAVE_FORCE):
            (self.addresses[client],) = struct.unpack("L", bytes(argument.retrieve()))
            return 0
        if request in (I2C_RETRIES, I2C_TIMEOUT):
            return 0
        if request == I2C_FUNCS:
            _piece(argument, 0, 8).update(0, list(struct.pack("L", FUNCTIONS)))
            return 0
        if request == I2C_RDWR:
            return self.combined(_piece(argument, 0, 16))
        if request == I2C_SMBUS:
            self.smbus(self.addresses.get(client, 0), _piece(argument, 0, 16))
            return 0
        raise OSError(errno.ENOTTY, f"ioctl 0x{request:x}")

    def combined(self, argument: IoctlData) -> int:
        """struct i2c_rdwr_ioctl_data: messages with a repeated start between them."""
        count: int = struct.unpack("PI4x", bytes(argument.retrieve()))[1]
        messages = _piece(argument, 0, 16 * count)
        for index in range(count):
            address, flags, length, _ = struct.unpack_from("HHH2xP", bytes(messages.retrieve()), 16 * index)
            buffer = messages.resolve(16 * index + 8, length)
            if flags & I2C_M_RD:
                answer = self.read(address, length)
                if buffer is not None:
                    buffer.update(0, list(answer))
            else:
                self.write(address, bytes(buffer.retrieve()) if buffer is not None else b"")
        return count

    def smbus(self, address: int, argument: IoctlData) -> None:
        """struct i2c_smbus_ioctl_data, carried out as the kernel does on an adapter without SMBus hardware."""
        is_read, command, size, _ = struct.unpack("BB2xIP", bytes(argument.retrieve()))
        if size == SMBUS_QUICK:
            if is_read:
                self.read(address, 0)
            else:
                self.write(address, b"")
            return
        if size not in (*SMBUS_COUNTS, SMBUS_I2C_BLOCK_DATA):
            raise OSError(errno.EOPNOTSUPP, f"SMBus transfer {size}")
        register = bytes([command])
        if size == SMBUS_BYTE and not is_read:
            self.write(address, register)
            return
        data = _piece(argument, 8, SMBUS_DATA_LENGTH)
        content = bytes(data.retrieve())
        is_block = size == SMBUS_I2C_BLOCK_DATA
        first, count = (1, content[0]) if is_block else (0, SMBUS_COUNTS[size])
        if not is_read:
            self.write(address, register + content[first : first + count])
            return
        if size != SMBUS_BYTE:
            self.write(address, register)
        data.update(first, list(self.read(address, count)))

    def write(self, address: int, data: bytes) -> None:
        def carry_out() -> bytes:
            self.bus.write(address, data)
            return data

        self.transfer("write", address, carry_out)

    def read(self, address: int, count: int) -> bytes:
        return self.transfer("read", address, lambda: self.bus.read(address, count))

    def transfer(self, verb: str, address: int, carry_out: Callable[[], bytes]) -> bytes:
        """Carry out one message and record it in the journal."""
        time_s = time.monotonic()
        try:
            if self.times_out:
                self.times_out = False
                raise OSError(errno.ETIMEDOUT, "the bus was locked up")
            if address in self.silent:
                raise OSError(errno.EREMOTEIO, f"0x{address:02x} was silenced")
            data = carry_out()
        except OSError as failure:
            self.journal.append((time_s, verb, address, "", failure.errno))
            if failure.errno == errno.ETIMEDOUT:
                time.sleep(self.timeout_s)
            raise
        self.journal.append((time_s, verb, address, data.hex(), 0))
        return data


def _piece(of: IoctlData, offset: int, length: int) -> IoctlData:
    """The memory that a pointer at this offset points to."""
    piece = of.resolve(offset, length)
    if piece is None:
        raise OSError(errno.EFAULT, "a null pointer")
    return piece


class Echo:
    """What a sonar's pings report: readings one after the other, and then again."""

    last: "Echo | None" = None
    """Whose ping was the last on the bus."""

    def __init__(self, readings_cm: Sequence[int], disturbed_cm: int | None) -> None:
        self.set(readings_cm)
        self.disturbed_cm = disturbed_cm

    def set(self, readings_cm: Sequence[int]) -> None:
        self.readings_cm = itertools.cycle(readings_cm)

    def __call__(self, _ping_time_s: float) -> int:
        before, Echo.last = Echo.last, self
        if self.disturbed_cm is not None and before not in (None, self):
            return self.disturbed_cm
        return next(self.readings_cm)


def make_device(spec: dict[str, Any], now: Callable[[], float], chance: random.Random, echoes: list[Echo]) -> Device:
    """One device from its specification; what a sonar reports is appended to ``echoes``."""
    faults = [Fault(**fault) for fault in spec["faults"]]
    if "readings_cm" not in spec:
        return PlainDevice(spec["address"], bytes.fromhex(spec["answer"]), faults)
    echoes.append(Echo(spec["readings_cm"], spec.get("disturbed_cm")))
    kind = emulated_kind(spec["kind"])
    return kind(spec["address"], now, echoes[-1], DeviceTiming(**spec["timing"]), faults, chance)


def main() -> None:
    """Serve until standard input ends."""
    spec = json.loads(sys.stdin.readline())
    try:
        import gi

        gi.require_version("UMockdev", "1.0")
        from gi.repository import GLib, UMockdev
    except (ImportError, ValueError) as missing:
        print(json.dumps({"missing": str(missing)}), flush=True)
        return
    now = TimeSinceOpened()
    chance = random.Random(spec["seed"])
    echoes: list[Echo] = []
    devices = [make_device(device, now, chance, echoes) for device in spec["devices"]]
    interface = KernelInterface(EmulatedBus(devices, now, spec["nack_errno"]), spec["timeout_s"])

    def opened(_device: object, _client: IoctlClient) -> None:
        now.opened()
        interface.bus.reopen()

    testbed = UMockdev.Testbed.new()
    testbed.add_from_string("P: /devices/i2c-1/i2c-dev/i2c-1\nN: i2c-1\nE: DEVNAME=/dev/i2c-1\nE: SUBSYSTEM=i2c-dev\n")
    ioctls = UMockdev.IoctlBase()
    ioctls.connect("handle-ioctl", interface.handle)
    ioctls.connect("client-connected", opened)
    testbed.attach_ioctl("/dev/i2c-1", ioctls)
    milli_c = str(round(spec["temperature_c"] * 1000)) + "\n"
    testbed.add_device("hwmon", "hwmon0", None, ["name", "sht4x\n", "temp1_input", milli_c], [])
    testbed.add_device("iio", "iio:device0", None, ["name", "bme280\n", "in_temp_input", milli_c], [])

    loop = GLib.MainLoop()

    def command(_source: int, _condition: int) -> bool:
        line = sys.stdin.readline()
        if not line:
            loop.quit()
            return False
        if line == "journal\n":
            print(json.dumps(list(interface.journal)), flush=True)
        elif line == "time out\n":
            interface.times_out = True
        elif line.startswith("silence "):
            interface.silent.add(int(line.split()[1]))
        else:
            for echo, reading_cm in zip(echoes, json.loads(line), strict=True):
                echo.set([reading_cm])
        return True

    GLib.unix_fd_add_full(GLib.PRIORITY_DEFAULT, sys.stdin.fileno(), GLib.IO_IN | GLib.IO_HUP, command)
    print(json.dumps({"root": testbed.get_root_dir()}), flush=True)
    loop.run()
    testbed.detach_ioctl("/dev/i2c-1")


if __name__ == "__main__":
    main()
