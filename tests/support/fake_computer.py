"""The files of a computer that concern msp-range, below a folder: a Raspberry Pi as its owner should have set it up.

A test takes away or changes what its owner has forgotten or got wrong.
"""

import os
import shutil
from pathlib import Path

GROUP_ID = os.getgid()
"""Files that a test makes belong to this group: it stands for i2c and dialout."""


class FakeComputer:
    """A Raspberry Pi 4 with I2C at 50 kHz, a serial port and a thermometer, all allowed to the user msp-range."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.user = "msp-range"
        self.gids = [GROUP_ID]
        self.utc_s = 4e9
        self.free_bytes = 20 * 10**9
        self.disk_is_read_only = False
        self.write("/proc/device-tree/model", "Raspberry Pi 4 Model B Rev 1.4\0")
        self.write("/proc/cmdline", "console=tty1 root=PARTUUID=0a rootwait\n")
        self.write("/etc/group", f"i2c:x:{GROUP_ID}:msp-range\ndialout:x:{GROUP_ID}:msp-range\n")
        self.write(
            "/boot/firmware/config.txt",
            "# For more options see config.txt's documentation\ndtparam=i2c_arm=on,i2c_arm_baudrate=50000\n"
            "enable_uart=1\n[all]\n",
        )
        self.device("/dev/i2c-1")
        self.device("/dev/ttyAMA0")
        self.link("/dev/serial0", "ttyAMA0")
        self.bus("brcm,bcm2711-i2c\0brcm,bcm2835-i2c\0", 50_000)
        self.write("/sys/class/hwmon/hwmon0/name", "cpu_thermal\n")
        self.write("/sys/class/hwmon/hwmon0/temp1_input", "48312\n")
        self.thermometer("21450\n")
        self.write("/run/systemd/timesync/synchronized", "")
        self.folder("/var/lib/msp-range")

    def disk(self, path: Path) -> os.statvfs_result:
        """The only disk, with blocks of a byte."""
        return os.statvfs_result((1, 1, 0, 0, self.free_bytes, 0, 0, 0, os.ST_RDONLY * self.disk_is_read_only, 255))

    def at(self, path: str) -> Path:
        """Where a file of the computer is."""
        return self.root / path.lstrip("/")

    def write(self, path: str, text: str | bytes) -> None:
        """Make a file."""
        self.at(path).parent.mkdir(parents=True, exist_ok=True)
        self.at(path).write_bytes(text.encode() if isinstance(text, str) else text)

    def device(self, path: str, mode: int = 0o660) -> None:
        """Make what stands for a device file."""
        self.write(path, "")
        self.at(path).chmod(mode)

    def folder(self, path: str, mode: int = 0o775) -> None:
        """Make a folder of the group's."""
        self.at(path).mkdir(parents=True, exist_ok=True)
        self.at(path).chmod(mode)

    def link(self, path: str, to: str) -> None:
        """Make a link."""
        self.at(path).parent.mkdir(parents=True, exist_ok=True)
        self.at(path).symlink_to(to)

    def bus(self, compatible: str, rate_hz: int | None) -> None:
        """What the device tree says of bus 1."""
        node = "/sys/bus/i2c/devices/i2c-1/of_node"
        self.remove(node)
        self.write(f"{node}/compatible", compatible)
        if rate_hz is not None:
            self.write(f"{node}/clock-frequency", rate_hz.to_bytes(4, "big"))

    def thermometer(self, text: str) -> None:
        """An SHT4x at address 0x44."""
        self.write("/sys/bus/i2c/devices/1-0044/hwmon/hwmon2/name", "sht4x\n")
        self.write("/sys/bus/i2c/devices/1-0044/hwmon/hwmon2/temp1_input", text)

    def process(self, number: int, command: str, opened: str) -> None:
        """A program that has a file open."""
        self.write(f"/proc/{number}/cmdline", command.replace(" ", "\0") + "\0")
        self.link(f"/proc/{number}/fd/3", opened)

    def remove(self, path: str) -> None:
        """Take away a file, a link or a folder."""
        if self.at(path).is_dir() and not self.at(path).is_symlink():
            shutil.rmtree(self.at(path))
        else:
            self.at(path).unlink(missing_ok=True)
