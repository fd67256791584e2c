"""The computer's I2C bus and its serial port to the autopilot: there, allowed, and nobody else's; the bus's clock.

Nothing is transferred here, and the port is not opened.
"""

import re
from collections.abc import Iterator

from msp_range.doctor.computer import Computer
from msp_range.doctor.finding import UNKNOWN, Finding, first_of, right, wrong
from msp_range.mavlink.transport.serial import UARTS
from msp_range.mavlink.transport.url import SerialUrl, TransportUrl
from msp_range.state_folder import SERVICE_USER

SLOW_HZ = 50_000
"""A Raspberry Pi 1-4 reads a sensor that stretches the clock correctly up to this rate (docs/flying.md)."""
FAST_HZ = 400_000
"""The sensor's own limit, for a bus that waits while the clock is stretched."""
DEFAULT_HZ = 100_000
"""Rate of an adapter that states none: the kernel's default."""
_ON = r"(dtparam=.*\bi2c(_arm)?=on|dtoverlay=i2c-gpio)"
PORTS = ("/dev/serial/by-id/*", "/dev/ttyACM*", "/dev/ttyUSB*", "/dev/ttyAMA*", "/dev/ttyTHS*")
"""Where an autopilot may be: by USB, at a Raspberry Pi's pins, at a Jetson's. ttyS names are there without a port."""
LOGIN = "raspi-config: Interface Options, Serial Port, no login shell, then restart the computer"
STEP = "serial port in use"
_CONSOLE = re.compile(r"console=(tty[A-Z]+\d+|serial\d)")


def check_interface(computer: Computer, path: str) -> Iterator[Finding]:
    """The steps before the first transfer; each is tried only while those before it are right, see `while_right`."""
    yield _device_file(computer, path)
    yield computer.permission("I2C permission", path, "i2c")


def _device_file(computer: Computer, path: str) -> Finding:
    name, config, is_pi = path.removeprefix("/dev/"), computer.boot_config, computer.is_raspberry_pi
    others = computer.names("/dev/i2c-*")
    text = f"there is no {path}{'; there is ' * bool(others)}{', '.join(others)}"
    how = f"dtparam=i2c_arm=on,i2c_arm_baudrate={SLOW_HZ} in {config}"
    return first_of(
        "I2C interface",
        (computer.exists(path), path),
        (
            computer.exists(f"/sys/bus/i2c/devices/{name}"),
            f"there is a bus {name}, but no {path}: the module i2c-dev is not loaded",
            "sudo modprobe i2c-dev, and at each boot by install.sh or /etc/modules",
        ),
        (
            is_pi and not computer.boots_with(_ON),
            f"{text}: I2C is off",
            f"enable I2C: {how} (or raspi-config), then restart the computer",
        ),
        (is_pi, f"{text}, although {config} enables one", "restart the computer, or check the bus number"),
        (others, text, "name one of these as bus: in the airframe file"),
        (True, text, "enable I2C in the computer's firmware or device tree, and load the module i2c-dev"),
    )


def check_clock(computer: Computer, path: str) -> Finding:
    """Whether the bus is slow enough for a sensor that holds the clock low while it is not ready."""
    node = f"/sys/bus/i2c/devices/{path.removeprefix('/dev/')}/of_node"
    compatible = computer.text(f"{node}/compatible") or ""
    stated_hz = computer.number(f"{node}/clock-frequency")
    is_pi = "bcm2835" in compatible or "bcm2711" in compatible
    rate_hz = stated_hz or DEFAULT_HZ
    rate = f"{rate_hz / 1e3:g} kHz"
    return first_of(
        "I2C clock",
        ("i2c-gpio" in compatible, "bit-banged: it waits while a sensor stretches the clock"),
        (
            is_pi and rate_hz > SLOW_HZ,
            f"{rate}: a Raspberry Pi 1-4 reads 328 m where a sensor stretches the clock",
            f"dtparam=i2c_arm=on,i2c_arm_baudrate={SLOW_HZ} in {computer.boot_config}, then restart the computer",
        ),
        (is_pi, rate),
        (stated_hz is None, "this computer does not report its rate; the sensors take 400 kHz at most", None, UNKNOWN),
        (
            rate_hz > FAST_HZ,
            f"{rate}, and the sensors take {FAST_HZ / 1e3:g} at most",
            "clock-frequency of the bus in the device tree",
        ),
        (True, rate),
    )


def check_port(computer: Computer, url: SerialUrl) -> Iterator[Finding]:
    """The steps before the port is opened; each is tried only while those before it are right, see `while_right`."""
    yield _there(computer, url.path)
    yield computer.permission("serial permission", computer.target(url.path), "dialout")
    yield _free(computer, url)


def _there(computer: Computer, path: str) -> Finding:
    target, pins, other = (computer.target(name) for name in (path, "/dev/serial0", "/dev/serial1"))
    is_there, is_pi, config = computer.exists(target), computer.is_raspberry_pi, computer.boot_config
    is_uart = is_pi and path.startswith(UARTS)
    ports = [name for pattern in PORTS for name in computer.names(pattern)]
    return first_of(
        "serial port",
        (
            is_there and is_pi and target == other != pins,
            f"{path} is /dev/serial1, the port of Bluetooth; the pins have /dev/serial0, which is {pins}",
            f"link.url: serial:/dev/serial0:BAUD; dtoverlay=disable-bt in {config} gives the pins the better port "
            "after a restart",
        ),
        (is_there, path if target == path else f"{path} is {target}"),
        (
            is_uart and not computer.boots_with(r"enable_uart=1"),
            f"there is no {path}: the serial port is off",
            f"enable_uart=1 in {config} (or raspi-config: Interface Options, Serial Port), then restart the computer",
        ),
        (is_uart, f"there is no {path}, although {config} has enable_uart=1", "restart the computer"),
        (
            ports,
            f"there is no {path}; there is {', '.join(ports)}",
            "name one of these as link.url; names in /dev/serial/by-id stay",
        ),
        (
            True,
            f"there is no {path}; no other serial port is there",
            "plug the autopilot in, or switch the computer's serial port on",
        ),
    )


def _free(computer: Computer, url: SerialUrl) -> Finding:
    path, target = url.path, computer.target(url.path)
    consoles = _CONSOLE.findall(computer.text("/proc/cmdline") or "")
    if any(computer.target(f"/dev/{name}") == target for name in consoles):
        return wrong(STEP, f"the kernel's console is on {path}: it writes there, and a login reads", LOGIN)
    return check_holders(computer, url) or right(STEP, f"no console and no other program on {path}")


def check_holders(computer: Computer, url: TransportUrl) -> Finding | None:
    """Who else has the port, or a connection to one of this number; None: nobody is seen.

    A serial port serves one program at a time, and so do many servers: a second one connects, and receives nothing.
    """
    step, place = (STEP, url.path) if isinstance(url, SerialUrl) else ("link in use", f"port {url.port}")
    for process, command in computer.holders(url):
        who = f"process {process} ({command.strip()})"
        in_use = f"another program uses {place}: {who}"
        return first_of(
            step,
            ("getty" in command, f"a login shell has {place} open: {who}", LOGIN),
            (
                f"{SERVICE_USER} run" in command,
                f"the bridge runs and has {place}: {who}",
                "sudo systemctl stop msp-range, then again",
                UNKNOWN,
            ),
            (
                "ModemManager" in command,
                in_use,
                "sudo systemctl disable --now ModemManager, or the udev rule of install.sh",
            ),
            (True, in_use, "end it, then again"),
        )
    return None
