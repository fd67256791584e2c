"""What trials of an installation share: a Debian that boots, what is looked at in it, and the far end of the link."""

import re
import shutil
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp

from pymavlink.dialects.v20 import common

from evaluation import ROOT
from evaluation.install.machine import Machine, make_debian

READINGS_CM = (40, 40, 40, 40)
RESTARTED_S = 10.0
"""A killed service sends distances again within this; docs/flying.md has what it takes on an idle computer."""
SUDO = 'sudo() { "$@"; }'
PAGE = "http://127.0.0.1:8642/"
OPT_PYTHON = "/opt/msp-range/venv/bin/python"


def say(text: str) -> None:
    """Print a line at once."""
    print(text, flush=True)


def expect(condition: bool, text: str) -> None:
    """Print what was seen; raises RuntimeError where it is not so."""
    if not condition:
        raise RuntimeError(f"not so: {text}")
    say(f"    ok: {text}")


class Receiver:
    """The far end of the bridge's UDP link."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.port = self.socket.getsockname()[1]
        self._parser = common.MAVLink(None)
        self._parser.robust_parsing = True
        self.texts: list[str] = []

    def distances(self) -> list[int]:
        """Distances [cm] that have come since the last call."""
        found: list[int] = []
        while True:
            try:
                datagram = self.socket.recv(2000)
            except BlockingIOError:
                return found
            for message in self._parser.parse_buffer(datagram) or []:
                if message.get_type() == "DISTANCE_SENSOR":
                    found.append(message.current_distance)
                elif message.get_type() == "STATUSTEXT":
                    self.texts.append(message.text)

    def await_distance(self) -> float:
        """Wait for a new distance; returns how long it took [s]."""
        self.distances()
        return Machine.until("distance", lambda: bool(self.distances()))

    def await_text(self, pattern: str) -> None:
        """Wait for a text to the pilot, and forget those up to it."""

        def is_there() -> bool:
            self.distances()
            return any(re.search(pattern, text) for text in self.texts)

        Machine.until(f"text {pattern!r}", is_there)
        say(f"    ok: the pilot reads {next(text for text in self.texts if re.search(pattern, text))!r}")
        self.texts.clear()


def snapshot(machine: Machine) -> str:
    """All folders of the container, and files with sizes and times, but for git's and those that systemd writes."""
    return machine.run(
        "find /etc /opt /usr/local /var/lib /root -type d -printf '%p\\n' -o -printf '%p %s %T@\\n' | sort |"
        " grep -v -e /var/lib/systemd -e /.git/"
    ).stdout


def differences(before: str, after: str) -> str:
    """Files and folders of which two snapshots say different things."""
    return " ".join(sorted({line.split(" ")[0] for line in {*before.splitlines()} ^ {*after.splitlines()}}))


def is_active(machine: Machine, unit: str = "msp-range") -> bool:
    """Whether a service runs."""
    return machine.show("ActiveState", unit) == "active"


def is_served(machine: Machine, url: str = PAGE) -> bool:
    """Whether the page is there."""
    program = f'import urllib.request as u; print(u.urlopen("{url}").read().decode())'
    return "<!doctype html>" in machine.run(f"{OPT_PYTHON} -c '{program}'", check=False).stdout


def megabytes(machine: Machine) -> int:
    """Disk that the installation takes [MB]."""
    return int(machine.run("du -sm /opt/msp-range").stdout.split()[0])


def recordings(machine: Machine) -> list[str]:
    """Names of the recordings."""
    return machine.run("ls /var/lib/msp-range/flights").stdout.split()


@contextmanager
def booted(suite: str, keep: bool = False) -> Iterator[Machine]:
    """A Debian that has booted; ends with what came of the steps in it, and `Machine.failed`."""
    folder = Path(mkdtemp(prefix="msp-install-", dir="/var/tmp"))
    machine = Machine(make_debian(ROOT / "build/install", suite), folder)
    try:
        machine.boot()
        versions = machine.run("systemctl --version | head -1; cat /etc/debian_version").stdout
        say(f"booted: {versions.replace(chr(10), ', ')}")
        yield machine
        say("all as it should be")
    except (AssertionError, RuntimeError, subprocess.TimeoutExpired) as error:
        machine.failed = 1
        say(f"FAILED: {error}")
        if machine.leader:
            say(machine.run("journalctl -u msp-range -u msp-range-web --no-pager -n 40", check=False).stdout)
    finally:
        machine.close()
        if not keep:
            shutil.rmtree(folder, ignore_errors=True)
