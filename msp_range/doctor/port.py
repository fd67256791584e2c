"""The serial port to the autopilot: there, allowed, and nobody else's. It is not opened here."""

import re
from collections.abc import Iterator

from msp_range.doctor.computer import SERVICE_USER, Computer
from msp_range.doctor.finding import RIGHT, UNKNOWN, Finding, first_of, right, wrong
from msp_range.mavlink.transport.serial import UARTS
from msp_range.mavlink.transport.url import SerialUrl, TransportUrl

PORTS = ("/dev/serial/by-id/*", "/dev/ttyACM*", "/dev/ttyUSB*", "/dev/ttyAMA*", "/dev/ttyTHS*")
"""Where an autopilot may be: by USB, at a Raspberry Pi's pins, at a Jetson's. ttyS names are there without a port."""
LOGIN = "raspi-config: Interface Options, Serial Port, no login shell, then restart the computer"
STEP = "serial port in use"
_CONSOLE = re.compile(r"console=(tty[A-Z]+\d+|serial\d)")


def check_port(computer: Computer, url: SerialUrl) -> Iterator[Finding]:
    """The steps before the port is opened; the first one that is not right ends them."""
    for finding in _looks(computer, url):
        yield finding
        if finding.verdict is not RIGHT:
            return


def _looks(computer: Computer, url: SerialUrl) -> Iterator[Finding]:
    yield _there(computer, url.path)
    yield computer.permission("serial permission", computer.target(url.path), "dialout")
    yield _free(computer, url)


def _there(computer: Computer, path: str) -> Finding:
    target, pins, other = (computer.target(each) for each in (path, "/dev/serial0", "/dev/serial1"))
    is_there, is_pi, config = computer.exists(target), computer.raspberry_pi, computer.boot_config
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
