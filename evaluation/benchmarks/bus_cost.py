"""Processor time of a transfer on /dev/i2c-1, in a program that does nothing else: ``python bus_cost.py SECONDS``.

It pings four MB1242 3 m above the ground in turn and asks each when it answers, as the bridge does. Only the system
calls are counted, which under umockdev are the emulation's share of a program. Prints microseconds a transfer.
"""

import fcntl
import sys
import time

from smbus2 import SMBus, i2c_msg
from smbus2.smbus2 import I2C_RDWR, i2c_rdwr_ioctl_data

FIRST_ANSWER_S, POLL_S, SLOT_S = 0.038, 0.003, 0.1


def main(seconds: float) -> None:
    """Measure for so long, and print."""
    bus = SMBus("/dev/i2c-1")
    assert bus.fd is not None
    used_ns = transfers = 0
    start_s = time.monotonic()
    for slot in range(round(seconds / SLOT_S)):
        address = 0x70 + slot % 4
        time.sleep(max(start_s + slot * SLOT_S - time.monotonic(), 0.0))
        message, delay_s, is_answered = i2c_msg.write(address, [0x51]), FIRST_ANSWER_S, False
        while not is_answered:
            request = i2c_rdwr_ioctl_data.create(message)  # type: ignore[arg-type]
            began_ns = time.thread_time_ns()
            try:
                fcntl.ioctl(bus.fd, I2C_RDWR, request)
                is_answered = delay_s == POLL_S
            except OSError:
                pass  # it still ranges
            used_ns += time.thread_time_ns() - began_ns
            transfers += 1
            time.sleep(delay_s)
            message, delay_s = i2c_msg.read(address, 2), POLL_S
    print(used_ns / transfers / 1e3)


if __name__ == "__main__":
    main(float(sys.argv[1]))
