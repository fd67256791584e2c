"""`msp-range run` as a process of its own, and the far end of its UDP link: an autopilot and other programs."""

import json
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import pymavlink.dialects.v20.ardupilotmega as ardupilotmega
import pytest

from tests.support.kernel_bus import KernelTestbed, Sonar
from tests.support.mavlink_ends import Component, read_distance_sensor
from tests.support.waiting import LIMIT_S, until, until_passes

COMMAND = Path(sys.executable).with_name("msp-range")
PEERS = Path(__file__).parents[1] / "peers"
AIRFRAME = PEERS / "airframe.yaml"
FORWARD_ID, SLANTED_ID, FUSED_ID = 1, 2, 10
HEARTBEAT_INTERVAL_S = 0.25
"""Of the autopilots below: four times as often as real ones, so that nobody waits for it."""


def sonars(forward_cm: Sequence[int], slanted_cm: Sequence[int], down_cm: Sequence[int]) -> list[Sonar]:
    """The sensors of `AIRFRAME`, each with its readings."""
    return [Sonar(0x70, forward_cm), Sonar(0x71, slanted_cm), Sonar(0x72, down_cm), Sonar(0x73, down_cm)]


VARIED = sonars(forward_cm=[24, 25, 765, 22, 20], slanted_cm=[411, 765, 409], down_cm=[250, 251, 249, 252])
"""Ranges, missed echoes and the shortest report, so that messages differ from each other."""


def missing(message: str) -> NoReturn:
    """Skip the test for want of a program; a failure under CI, where all of them are."""
    if os.environ.get("CI") == "true":
        pytest.fail(message)
    pytest.skip(message)


class Service:
    """A running `msp-range run`."""

    def __init__(self, process: "subprocess.Popen[Any]", log_file: Path) -> None:
        self.process = process
        self._log_file = log_file

    def log(self) -> list[dict[str, Any]]:
        """What it has logged so far."""
        return [json.loads(line) for line in self._log_file.read_text().splitlines()]

    def stop(self, signum: signal.Signals = signal.SIGTERM, limit_s: float = LIMIT_S) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(signum)
        return self.process.wait(limit_s)


@contextmanager
def running_service(
    testbed: KernelTestbed, link: str, folder: Path, *options: str, airframe: Path = AIRFRAME
) -> Iterator[Service]:
    """Start the service on the testbed's bus 1; ``folder`` takes its log."""
    log_file = folder / "log.jsonl"
    with log_file.open("w") as log:
        process = testbed.popen(
            [COMMAND, "run", airframe, "--bus", "1", "--link", link, "--log", "json", *options], stderr=log
        )
    with process:
        try:
            yield Service(process, log_file)
        finally:
            process.kill()


class Autopilot:
    """The least that the bridge takes for an autopilot: heartbeats, and answers to TIMESYNC from its own clock."""

    def __init__(self, system: int = 1, up_s: float = 0.0) -> None:
        self.system = system
        self.armed = False
        self.booted_s = time.monotonic() - up_s
        self._component = Component(system, dialect=ardupilotmega)
        self._next_heartbeat_s = float("-inf")

    def clock_ms(self, time_s: float) -> float:
        """Its time since boot at a time of this computer's monotonic clock."""
        return (time_s - self.booted_s) * 1e3

    def due(self, now_s: float) -> list[bytes]:
        """What it says of itself."""
        if now_s < self._next_heartbeat_s:
            return []
        self._next_heartbeat_s = now_s + HEARTBEAT_INTERVAL_S
        return [self._component.heartbeat(armed=self.armed)]

    def answers(self, now_s: float, message: Any) -> list[bytes]:
        """What it says to a message of the bridge."""
        if message.get_type() != "TIMESYNC" or message.tc1 != 0:
            return []
        answer = ardupilotmega.MAVLink_timesync_message(round((now_s - self.booted_s) * 1e9), message.ts1)
        return [self._component.frame(answer)]


@dataclass(frozen=True)
class Arrived:
    """One datagram of the bridge: when it came, as it came, and as pymavlink reads it."""

    time_s: float
    frame: bytes
    message: Any

    @property
    def distance(self) -> dict[str, Any] | None:
        """Fields of a DISTANCE_SENSOR, read by hand; None for other messages."""
        return read_distance_sensor(self.frame)


class LinkEnd:
    """The far end of a `udpout` link on this computer.

    It keeps what the bridge sends, lets an autopilot speak, and passes both on to another program, whose own datagrams
    it brings to the bridge: what a MAVLink router does. All of it happens in `run_until`.

    Parameters
    ----------
    port
        UDP port to listen on; 0 for any.
    autopilot
        Who answers; None: nobody. May be changed at any time.
    passes_on_to
        UDP port of the other program.
    """

    def __init__(self, port: int = 0, autopilot: Autopilot | None = None, passes_on_to: int | None = None) -> None:
        self.arrived: list[Arrived] = []
        self.autopilot = autopilot
        self._parser = ardupilotmega.MAVLink(None)
        self._bridge = _loopback_socket(port)
        self._bridge_address: Any = None
        self._other = _loopback_socket(0)
        self._other_port = passes_on_to

    def __enter__(self) -> "LinkEnd":
        return self

    def __exit__(self, *_: object) -> None:
        self._bridge.close()
        self._other.close()

    @property
    def url(self) -> str:
        """The link's URL for the bridge."""
        return f"udpout:127.0.0.1:{self._bridge.getsockname()[1]}"

    def of(self, *kinds: str) -> list[Any]:
        """Messages of these kinds that have come, oldest first."""
        return [each.message for each in self.arrived if each.message.get_type() in kinds]

    @property
    def distances(self) -> list[dict[str, Any]]:
        """All DISTANCE_SENSOR that have come, oldest first."""
        return [each.distance for each in self.arrived if each.distance is not None]

    def run_until(self, holds: Callable[[], bool], limit_s: float = LIMIT_S) -> None:
        """Work until something holds, which is asked after every datagram."""
        until(holds, limit_s, self._work, self._summary)

    def run_until_passes(self, check: Callable[[], object]) -> None:
        """Work until all that a function asserts holds."""
        until_passes(check, work=self._work)

    def run_for(self, duration_s: float) -> None:
        """Work for a while, and take what has come by then."""
        end_s = time.monotonic() + duration_s
        self.run_until(lambda: time.monotonic() >= end_s and not self._ready(0.0))

    def _work(self) -> None:
        if self.autopilot is not None:
            self._say(self.autopilot.due(time.monotonic()))
        readable = self._ready(0.02)
        if self._bridge in readable:
            frame, self._bridge_address = self._bridge.recvfrom(2048)
            (message,) = self._parser.parse_buffer(frame)
            now_s = time.monotonic()
            self.arrived.append(Arrived(now_s, frame, message))
            self._pass_on(frame)
            if self.autopilot is not None:
                self._say(self.autopilot.answers(now_s, message))
        if self._other in readable:
            self._to_bridge(self._other.recv(2048))

    def _ready(self, limit_s: float) -> list[socket.socket]:
        return select.select([self._bridge, self._other], [], [], limit_s)[0]

    def _say(self, frames: list[bytes]) -> None:
        for frame in frames:
            self._to_bridge(frame)
            self._pass_on(frame)

    def _to_bridge(self, frame: bytes) -> None:
        if self._bridge_address is not None:
            self._bridge.sendto(frame, self._bridge_address)

    def _pass_on(self, frame: bytes) -> None:
        if self._other_port is not None:
            self._other.sendto(frame, ("127.0.0.1", self._other_port))

    def _summary(self) -> str:
        kinds = [each.message.get_type() for each in self.arrived]
        counts = {kind: kinds.count(kind) for kind in sorted(set(kinds))}
        return f"{counts}; texts {[each.text for each in self.of('STATUSTEXT')]}; last distance {self.distances[-1:]}"


def _loopback_socket(port: int) -> socket.socket:
    loopback = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    loopback.bind(("127.0.0.1", port))
    return loopback
