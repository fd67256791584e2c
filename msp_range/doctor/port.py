"""The serial port to the autopilot: there, allowed, and nobody else's. It is not opened here."""

import re
from collections.abc import Iterator

from msp_range.doctor.computer import SERVICE_USER, Computer
from msp_range.doctor.finding import Finding, Verdict, right, unknown, wrong
from msp_range.mavlink.transport.serial import UARTS
from msp_range.mavlink.transport.url import SerialUrl, TransportUrl

PORTS = ("/dev/serial/by-id/*", "/dev/ttyACM*", "/dev/ttyUSB*", "/dev/ttyAMA*", "/dev/ttyTHS*")
"""Where an autopilot may be: by USB, at a Raspberry Pi's pins, at a Jetson's. ttyS names are there without a port."""
LOGIN = "raspi-config: Interface Options, Serial Port, no login shell, then restart the computer"
_CONSOLE = re.compile(r"console=(tty[A-Z]+\d+|serial\d)")


def check_port(computer: Computer, url: SerialUrl) -> Iterator[Finding]:
    """The steps before the port is opened; the first one that is not right ends them."""
    for step in (_there, _allowed, _free):
        finding = step(computer, url)
        yield finding
        if finding.verdict is not Verdict.RIGHT:
            return


def _there(computer: Computer, url: SerialUrl) -> Finding:
    step, path = "serial port", url.path
    target = computer.target(path)
    if computer.exists(target):
        pins, other = computer.target("/dev/serial0"), computer.target("/dev/serial1")
        if computer.raspberry_pi and target == other != pins:
            text = f"{path} is /dev/serial1, the port of Bluetooth; the pins have /dev/serial0, which is {pins}"
            overlay = f"dtoverlay=disable-bt in {computer.boot_config} gives the pins the better port after a restart"
            return wrong(step, text, f"link.url: serial:/dev/serial0:BAUD; {overlay}")
        return right(step, path if target == path else f"{path} is {target}")
    if path.startswith(UARTS) and computer.raspberry_pi:
        config = computer.boot_config
        if not computer.boots_with(r"enable_uart=1"):
            how = f"enable_uart=1 in {config} (or raspi-config: Interface Options, Serial Port)"
            return wrong(step, f"there is no {path}: the serial port is off", f"{how}, then restart the computer")
        return wrong(step, f"there is no {path}, although {config} has enable_uart=1", "restart the computer")
    others = [name for pattern in PORTS for name in computer.names(pattern)]
    there = f"; there is {', '.join(others)}" if others else "; no other serial port is there"
    remedy = "name one of these as link.url; names in /dev/serial/by-id stay"
    if not others:
        remedy = "plug the autopilot in, or switch the computer's serial port on"
    return wrong(step, f"there is no {path}{there}", remedy)


def _allowed(computer: Computer, url: SerialUrl) -> Finding:
    return computer.permission("serial permission", computer.target(url.path), "dialout")


def _free(computer: Computer, url: SerialUrl) -> Finding:
    step, path = "serial port in use", url.path
    target = computer.target(path)
    for name in _CONSOLE.findall(computer.text("/proc/cmdline") or ""):
        if computer.target(f"/dev/{name}") == target:
            return wrong(step, f"the kernel's console is on {path}: it writes there, and a login reads", LOGIN)
    return check_holders(computer, url) or right(step, f"no console and no other program on {path}")


def check_holders(computer: Computer, url: TransportUrl) -> Finding | None:
    """Who else has the port, or a connection to one of this number; None: nobody is seen.

    A serial port serves one program at a time, and so do many servers: a second one connects, and receives nothing.
    """
    step, place = (
        ("serial port in use", url.path) if isinstance(url, SerialUrl) else ("link in use", f"port {url.port}")
    )
    for process, command in computer.holders(url):
        who = f"process {process} ({command.strip()})"
        if "getty" in command:
            return wrong(step, f"a login shell has {place} open: {who}", LOGIN)
        if f"{SERVICE_USER} run" in command:
            return unknown(step, f"the bridge runs and has {place}: {who}", "sudo systemctl stop msp-range, then again")
        remedy = "end it, then again"
        if "ModemManager" in command:
            remedy = "sudo systemctl disable --now ModemManager, or the udev rule of install.sh"
        return wrong(step, f"another program uses {place}: {who}", remedy)
    return None
