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
from typing import Any

from msp_sim.device.bus import EmulatedBus
from msp_sim.device.device import DeviceTiming, Fault, PlainDevice
from msp_sim.device.table import emulated_kind

# linux/i2c-dev.h and linux/i2c.h
I2C_RETRIES, I2C_TIMEOUT, I2C_SLAVE, I2C_FUNCS = 0x0701, 0x0702, 0x0703, 0x0705
I2C_SLAVE_FORCE, I2C_RDWR, I2C_SMBUS = 0x0706, 0x0707, 0x0720
I2C_M_RD = 0x0001
FUNCTIONS = 0x0C7F0001  # I2C_FUNC_I2C and the SMBus transfers below
SMBUS_QUICK, SMBUS_BYTE, SMBUS_BYTE_DATA, SMBUS_WORD_DATA, SMBUS_I2C_BLOCK_DATA = 0, 1, 2, 3, 8
SMBUS_DATA_LENGTH = 34
SMBUS_COUNTS = {SMBUS_BYTE: 1, SMBUS_BYTE_DATA: 1, SMBUS_WORD_DATA: 2}


class TimeSinceOpened:
    """Seconds since a program first opened the bus: the clock of the devices and of their faults."""

    def __init__(self):
        self.start_s = None

    def opened(self):
        if self.start_s is None:
            self.start_s = time.monotonic()

    def __call__(self):
        return time.monotonic() - self.start_s


class KernelInterface:
    """Turns the ioctl calls of i2c-dev into transfers of an EmulatedBus."""

    def __init__(self, bus, timeout_s):
        self.bus = bus
        self.timeout_s = timeout_s
        self.journal: deque[Any] = deque(maxlen=200_000)
        self.addresses = {}

    def handle(self, _device, client):
        """Answer one ioctl. Nothing may be raised from here: the client would wait for ever."""
        try:
            # Two objects of the binding may stand for one client; their hash is the client's.
            result, error = self.ioctl(hash(client), client.get_request(), client.get_arg()), 0
        except OSError as failure:
            result, error = -1, failure.errno
        except Exception:
            traceback.print_exc()
            result, error = -1, errno.EIO
        client.complete(result, error)
        return True

    def ioctl(self, client, request, argument):
        """Return what the system call returns; raises OSError with its errno."""
        if request in (I2C_SLAVE, I2C_SLAVE_FORCE):
            (self.addresses[client],) = struct.unpack("L", bytes(argument.retrieve()))
            return 0
        if request in (I2C_RETRIES, I2C_TIMEOUT):
            return 0
        if request == I2C_FUNCS:
            argument.resolve(0, 8).update(0, list(struct.pack("L", FUNCTIONS)))
            return 0
        if request == I2C_RDWR:
            return self.combined(argument.resolve(0, 16))
        if request == I2C_SMBUS:
            self.smbus(self.addresses.get(client, 0), argument.resolve(0, 16))
            return 0
        raise OSError(errno.ENOTTY, f"ioctl 0x{request:x}")

    def combined(self, argument):
        """struct i2c_rdwr_ioctl_data: messages with a repeated start between them."""
        _, count = struct.unpack("PI4x", bytes(argument.retrieve()))
        messages = argument.resolve(0, 16 * count)
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

    def smbus(self, address, argument):
        """struct i2c_smbus_ioctl_data, carried out as the kernel does on an adapter without SMBus hardware."""
        is_read, command, size, _ = struct.unpack("BB2xIP", bytes(argument.retrieve()))
        data = argument.resolve(8, SMBUS_DATA_LENGTH)
        if size == SMBUS_QUICK:
            return self.read(address, 0) if is_read else self.write(address, b"")
        if size not in (*SMBUS_COUNTS, SMBUS_I2C_BLOCK_DATA):
            raise OSError(errno.EOPNOTSUPP, f"SMBus transfer {size}")
        register = bytes([command])
        if size == SMBUS_BYTE and not is_read:
            return self.write(address, register)
        content = bytes(data.retrieve())
        is_block = size == SMBUS_I2C_BLOCK_DATA
        first, count = (1, content[0]) if is_block else (0, SMBUS_COUNTS[size])
        if not is_read:
            return self.write(address, register + content[first : first + count])
        if size != SMBUS_BYTE:
            self.write(address, register)
        return data.update(first, list(self.read(address, count)))

    def write(self, address, data):
        self.transfer("write", address, lambda: self.bus.write(address, data) or data)

    def read(self, address, count):
        return self.transfer("read", address, lambda: self.bus.read(address, count))

    def transfer(self, verb, address, act):
        """Carry out one message and note it in the journal."""
        time_s = time.monotonic()
        try:
            data = act()
        except OSError as failure:
            self.journal.append((time_s, verb, address, "", failure.errno))
            if failure.errno == errno.ETIMEDOUT:
                time.sleep(self.timeout_s)
            raise
        self.journal.append((time_s, verb, address, data.hex(), 0))
        return data


class Echo:
    """What a sonar's pings report: readings one after the other, and then again."""

    def __init__(self, readings_cm):
        self.set(readings_cm)

    def set(self, readings_cm):
        self.readings_cm = itertools.cycle(readings_cm)

    def __call__(self, _ping_time_s):
        return next(self.readings_cm)


def make_device(spec, now, chance, echoes):
    """One device from its specification; what a sonar reports is appended to ``echoes``."""
    faults = [Fault(**fault) for fault in spec["faults"]]
    if "readings_cm" not in spec:
        return PlainDevice(spec["address"], bytes.fromhex(spec["answer"]), faults)
    echoes.append(Echo(spec["readings_cm"]))
    kind = emulated_kind(spec["kind"])
    return kind(spec["address"], now, echoes[-1], DeviceTiming(**spec["timing"]), faults, chance)


def main():
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
    echoes: list[Any] = []
    devices = [make_device(device, now, chance, echoes) for device in spec["devices"]]
    interface = KernelInterface(EmulatedBus(devices, now, spec["nack_errno"]), spec["timeout_s"])

    def opened(_device, _client):
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

    def command(_source, _condition):
        line = sys.stdin.readline()
        if not line:
            loop.quit()
            return False
        if line == "journal\n":
            print(json.dumps(list(interface.journal)), flush=True)
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
