"""Set-ups of owners for `msp-range doctor`: 15 with a mistake that people make, and five with none.

They were written from what forums and data sheets report, without a look at `msp_range.doctor`, its tests or its
documents, and before the doctor was run on any of them. A mistake is named right if one line that is reported as wrong
or unknown contains all expressions of `cause`, in its text or its remedy: so much must be in it for an engineer to
know what to do. A set-up without a mistake may have no line that is wrong.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from msp_sim.device import lidar_lite_v3
from tests.support.fake_computer import FakeComputer
from tests.support.far_ends import (
    DeafAutopilot,
    SigningAutopilot,
    StreamingAutopilot,
    by_tcp,
    by_udp,
    by_udp_towards_here,
    cable_at_other_baud,
    on_cable,
    silent_cable,
)
from tests.support.kernel_bus import Other, Sonar
from tests.support.parameter_autopilot import RANGE_FINDER, ParameterAutopilot

CONFIGS = Path(__file__).parents[2] / "configs"

ARDUPILOT = {
    "MAV_SYSID": 1.0,
    "SERIAL1_PROTOCOL": 2.0,
    "SERIAL1_BAUD": 57.0,
    "SERIAL2_PROTOCOL": 2.0,
    "SERIAL2_BAUD": 921.0,
    **RANGE_FINDER,
    "PRX1_TYPE": 0.0,
}
"""ArduCopter 4.7 as its owner has set it for the pallet."""

PX4 = {
    "MAV_SYS_ID": 1,
    "MAV_1_CONFIG": 102,
    "MAV_1_MODE": 2,
    "SER_TEL2_BAUD": 921600,
    "EKF2_RNG_CTRL": 2,
    "EKF2_HGT_REF": 1,
    "EKF2_MIN_RNG": 0.2,
    "EKF2_RNG_DELAY": 40.0,
    "EKF2_RNG_POS_Z": 0.05,
}
"""PX4 as its owner has set it for the canted pallet."""

BENCH_CM = ((118, 119, 118), (121, 121, 122), (117, 118, 117), (120, 119, 120))
"""What the four sensors report with the vehicle on a stand, a good metre above the floor."""


@dataclass(frozen=True)
class SetUp:
    """A computer, what is on its I2C bus, and what is at the far end of its link."""

    name: str
    story: str
    """what the owner has done, and where such a mistake is reported"""
    far_end: Callable[[], AbstractContextManager[str]]
    """makes the far end; gives the URL that stands for the airframe's"""
    airframe: str = "quad_pallet.yaml"
    """the owner's file in configs/"""
    edits: Sequence[tuple[str, str]] = ()
    """what the owner has changed in it: old text, new text"""
    devices: Sequence[Sonar | Other] = ()
    """what is on the bus"""
    computer: Callable[[FakeComputer], None] = lambda _: None
    """what is different on the computer"""
    service: bool = False
    """whether `msp-range run` is running on it"""
    cause: Sequence[str] = ()
    """regular expressions, all of which are in one line that is wrong or unknown; none: nothing is wrong"""

    def airframe_text(self) -> str:
        """The owner's airframe file."""
        text = (CONFIGS / self.airframe).read_text().replace("model: sensors/", f"model: {CONFIGS}/sensors/")
        for old, new in self.edits:
            assert old in text, f"{self.name}: {self.airframe} has no {old}"
            text = text.replace(old, new)
        return text


def pallet(*addresses: int) -> list[Sonar]:
    """Sensors on a stand, by their addresses."""
    return [Sonar(address, readings) for address, readings in zip(addresses, BENCH_CM, strict=False)]


def copter(
    kind: Callable[..., ParameterAutopilot] = StreamingAutopilot, /, **changes: float
) -> partial[ParameterAutopilot]:
    """ArduCopter with other values of some parameters."""
    return partial(kind, values={**ARDUPILOT, **changes})


def px4(kind: Callable[..., ParameterAutopilot] = StreamingAutopilot, /) -> partial[ParameterAutopilot]:
    """PX4 as set for the canted pallet."""
    return partial(kind, values=PX4, px4=True)


PALLET = pallet(0x70, 0x71, 0x72, 0x73)


def _usb(computer: FakeComputer) -> None:
    """A USB adapter to the autopilot's TELEM2."""
    computer.device("/dev/ttyUSB0")
    computer.link("/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0", "../../ttyUSB0")


def _not_restarted(computer: FakeComputer) -> None:
    """config.txt has the slow clock, the kernel was started before."""
    computer.bus("brcm,bcm2711-i2c\0brcm,bcm2835-i2c\0", 100_000)


def _not_logged_in_again(computer: FakeComputer) -> None:
    """`usermod -aG i2c,dialout pi` in the same session."""
    gid = computer.gids[0]
    computer.user = "pi"
    computer.gids = [54321]
    computer.write("/etc/group", f"i2c:x:{gid}:pi,msp-range\ndialout:x:{gid}:pi,msp-range\n")


def _plugged_in_again(computer: FakeComputer) -> None:
    """The autopilot was ttyACM0, and is ttyACM1 since the plug was out for a moment."""
    computer.device("/dev/ttyACM1")
    computer.link("/dev/serial/by-id/usb-ArduPilot_CubeOrange_3E0033001751383339373138-if00", "../../ttyACM1")


def _bluetooth(computer: FakeComputer) -> None:
    """A Pi 3 whose good UART is Bluetooth's; the pins have the other one."""
    computer.write("/proc/device-tree/model", "Raspberry Pi 3 Model B Plus Rev 1.3\0")
    computer.bus("brcm,bcm2835-i2c\0", 50_000)
    computer.device("/dev/ttyS0")
    computer.remove("/dev/serial0")
    computer.link("/dev/serial0", "ttyS0")
    computer.link("/dev/serial1", "ttyAMA0")
    # It runs as root: others do not see what it has open.
    computer.write("/proc/612/cmdline", "/usr/bin/hciattach\0/dev/serial1\0bcm43xx\0003000000\0flow\0-\0")


def _one_wire_at_85(computer: FakeComputer) -> None:
    """A DS18B20 without its supply wire reports what it has after power-on."""
    computer.write("/sys/bus/w1/devices/28-0316a2795af1/temperature", "85000\n")


def _jetson(computer: FakeComputer) -> None:
    """A Jetson Nano: no config.txt, another I2C adapter, no serial0."""
    computer.write("/proc/device-tree/model", "NVIDIA Jetson Nano Developer Kit\0")
    computer.write("/proc/cmdline", "root=/dev/mmcblk0p1 rw rootwait console=ttyS0,115200n8 console=tty0\n")
    computer.bus("nvidia,tegra210-i2c\0", 400_000)
    computer.remove("/boot/firmware/config.txt")
    computer.remove("/dev/serial0")
    computer.remove("/dev/ttyAMA0")
    computer.device("/dev/ttyTHS1")


BROKEN = [
    SetUp(
        "factory addresses",
        "Four new sensors on the bus, none given an address yet: all answer at 0x70. Asked in "
        "https://discuss.px4.io/t/how-to-connect-multiple-maxbotix-sensors-on-px4/21913",
        partial(on_cable, copter()),
        devices=pallet(0x70),
        cause=[
            r"0x70",
            r"factory|same address|delivered|new sensor",
            r"one (sensor )?at a time|alone|single|msp-range",
        ],
    ),
    SetUp(
        "data line at ground",
        "SDA touches ground at a connector: every address seems to answer, with zeros. "
        "https://raspberrypi.stackexchange.com/questions/113402 and /32719",
        partial(on_cable, copter()),
        devices=[Other(address, "0000") for address in range(0x03, 0x78)],
        cause=[r"SDA|data line", r"ground|low|short|pull"],
    ),
    SetUp(
        "address halved",
        "One sensor was given its address by an Arduino sketch, which wants the 8-bit form, and 0x72 was typed: the "
        "sensor is at 0x39.",
        partial(on_cable, copter()),
        devices=pallet(0x70, 0x71, 0x39, 0x73),
        cause=[r"0x39", r"rear_left|0x72"],
    ),
    SetUp(
        "servo driver",
        "A PCA9685 for servos is on the same bus: at 0x40, and with its all-call address at 0x70, where the front left "
        "sensor should be, whose plug is out.",
        partial(on_cable, copter()),
        devices=[*pallet(0x70, 0x71, 0x72, 0x73)[1:], Other(0x40, "1111"), Other(0x70, "1111")],
        cause=[r"0x70", r"PCA9685|servo|not (a|an) (MB1242|range finder|sonar|sensor)|(an)?other (device|chip)"],
    ),
    SetUp(
        "not restarted",
        "i2c_arm_baudrate=50000 was written into config.txt, the Pi not started again: the bus is still at 100 kHz.",
        partial(on_cable, copter()),
        devices=PALLET,
        computer=_not_restarted,
        cause=[r"100[ 0]?[0k]", r"re-?boot|restart|start.* again"],
    ),
    SetUp(
        "leg in the beam",
        "The front right sensor looks at a landing leg: 24 cm, whatever the others read.",
        partial(on_cable, copter()),
        devices=[Sonar(0x70, BENCH_CM[0]), Sonar(0x71, (24, 24, 24)), *PALLET[2:]],
        cause=[
            r"front_right",
            r"0\.24 m|24 cm|0\.2 m|20 cm",
            r"beam|in front|in the way|obstruct|object|other sensors",
        ],
    ),
    SetUp(
        "not logged in again",
        "`sudo usermod -aG i2c,dialout pi`, and the doctor run in the same session.",
        partial(on_cable, copter()),
        devices=PALLET,
        computer=_not_logged_in_again,
        cause=[r"log(ged)? (in|out|off)|new session|re-?boot|newgrp"],
    ),
    SetUp(
        "another USB name",
        "The autopilot's USB plug was out for a moment: /dev/ttyACM0 has become /dev/ttyACM1.",
        silent_cable,
        edits=[("serial:/dev/serial0:921600", "serial:/dev/ttyACM0:115200")],
        devices=PALLET,
        computer=_plugged_in_again,
        cause=[r"/dev/ttyACM0", r"ttyACM1|by-id|/dev/autopilot"],
    ),
    SetUp(
        "Bluetooth's UART",
        "On a Pi 3 ttyAMA0 belongs to Bluetooth, and the pins are ttyS0: "
        "https://discuss.ardupilot.org/t/rpi3-to-pixhawk-baudrate-issue/25422",
        silent_cable,
        edits=[("serial:/dev/serial0:921600", "serial:/dev/ttyAMA0:921600")],
        devices=PALLET,
        computer=_bluetooth,
        cause=[r"[Bb]luetooth|hciattach|disable-bt|serial0|ttyS0"],
    ),
    SetUp(
        "baud rate",
        "SERIAL2_BAUD was left at its default 57 (57600), the file says 921600: "
        "https://discuss.ardupilot.org/t/rpi3-to-pixhawk-baudrate-issue/25422",
        partial(cable_at_other_baud, 57600, 921600),
        devices=PALLET,
        cause=[r"bytes|garbage|garbled|no(t|thing) MAVLink|unreadable|noise", r"[Bb]aud|BAUD"],
    ),
    SetUp(
        "one wire",
        "The wire from the Pi's TX pin is loose: PX4 is received, and receives nothing.",
        partial(on_cable, px4(DeafAutopilot)),
        airframe="canted_pallet.yaml",
        devices=PALLET,
        computer=_usb,
        cause=[r"(not|never|nothing|no answer).*(reach|arriv|answer|receiv|get)|answers nothing", r"\bTX\b|wire|cable"],
    ),
    SetUp(
        "signing",
        "The autopilot has a signing key from a ground station, the airframe file names none.",
        partial(on_cable, copter(SigningAutopilot)),
        devices=PALLET,
        cause=[r"sign(ed|ing|s\b|ature)", r"key"],
    ),
    SetUp(
        "type of the maker",
        "RNGFND1_TYPE is 2 (MaxBotix I2C), since the sensors are MaxBotix': "
        "https://discuss.ardupilot.org/t/maxbotix-i2c-range-sensor-parameters/12732",
        partial(on_cable, copter(partial(StreamingAutopilot, uses_range_finder=False), RNGFND1_TYPE=2.0)),
        devices=PALLET,
        cause=[r"RNGFND1_TYPE", r"10"],
    ),
    SetUp(
        "both send",
        "mavlink-router sends to this computer's UDP port (Mode = Normal), the airframe file has udpout to the same "
        "port: nobody listens.",
        partial(by_udp_towards_here, copter()),
        airframe="loopback.yaml",
        devices=PALLET,
        cause=[r"udpin"],
    ),
    SetUp(
        "85 degrees",
        "A DS18B20 without its supply wire: 85 C, the value after power-on. "
        "https://raspberrypi.stackexchange.com/questions/65828",
        partial(on_cable, copter()),
        edits=[("/sys/bus/i2c/devices/1-0044/hwmon/hwmon*/temp1_input", "/sys/bus/w1/devices/28-*/temperature")],
        devices=PALLET,
        computer=_one_wire_at_85,
        cause=[r"85", r"[Tt]hermometer|DS18B20|w1|temperature"],
    ),
]

GOOD = [
    SetUp("serial", "The pallet on a Pi 4, ArduPilot on serial0.", partial(on_cable, copter()), devices=PALLET),
    SetUp(
        "UDP",
        "One sensor forward, three down, through a router on UDP; temperature from the barometer.",
        partial(by_udp, copter(PRX1_TYPE=2.0)),
        airframe="forward_and_down.yaml",
        edits=[("serial:/dev/serial0:921600", "udpout:127.0.0.1:14550")],
        devices=PALLET,
    ),
    SetUp(
        "TCP",
        "A LIDAR-Lite on a Jetson Nano at 400 kHz, the autopilot behind a serial server on the network.",
        partial(by_tcp, copter(RNGFND1_MIN=0.04, RNGFND1_MAX=39.9, RNGFND1_GNDCLR=0.05)),
        airframe="lidar_down.yaml",
        edits=[("serial:/dev/serial0:921600", "tcp:127.0.0.1:5760")],
        devices=[Sonar(0x62, (118, 119, 120), timing=lidar_lite_v3.TIMING, kind="lidar_lite_v3")],
        computer=_jetson,
    ),
    SetUp(
        "PX4",
        "The canted pallet, PX4 by a USB adapter; temperature from its airspeed sensor.",
        partial(on_cable, px4()),
        airframe="canted_pallet.yaml",
        devices=PALLET,
        computer=_usb,
    ),
    SetUp(
        "service",
        "The bridge is running while the doctor is asked.",
        partial(by_udp, copter()),
        airframe="loopback.yaml",
        devices=PALLET,
        service=True,
    ),
]
