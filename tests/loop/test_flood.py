"""20,000 messages a second at the whole bridge, through real sockets and in real time."""

import contextlib
import gc
import itertools
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np
import pytest

from msp_range.bridge import Bridge
from msp_range.clock import SystemClock
from msp_range.config import load_airframe
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.transport import open_transport
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.mb1242 import EmulatedMB1242
from tests.support.mavlink_ends import Component
from tests.support.shipped import CONFIGS
from tests.support.slow import slow, slow_but
from tests.support.transports import free_port
from tests.support.waiting import without_processor_s

MESSAGES_PER_S = 20_000
FLOOD_S = 3.0
SLOT_S = 0.100
"""One ping of the quad pallet's polling."""

FLOOD = """
import socket, sys, time
kind, port, frames = sys.argv[1], int(sys.argv[2]), [bytes.fromhex(each) for each in sys.argv[5:]]
rate, end_s = int(sys.argv[3]), time.monotonic() + float(sys.argv[4])
if kind == "tcpin":
    ends = [socket.create_connection(("127.0.0.1", port))]
else:
    ends = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(16)]
    for end in ends:
        end.connect(("127.0.0.1", port))
start_s, sent = time.monotonic(), 0
while (now_s := time.monotonic()) < end_s:
    while sent < (now_s - start_s) * rate:
        try:
            ends[sent % len(ends)].send(frames[sent % len(frames)])
        except ConnectionError:
            sys.exit(f"cut off after {sent}")
        sent += 1
    time.sleep(0.001)
print(sent)
"""


@contextlib.contextmanager
def flood(kind: str, port: int, frames: list[bytes]) -> Iterator["subprocess.Popen[str]"]:
    """A program that sends these frames in turn, from 16 sockets or over one connection."""
    arguments = [sys.executable, "-c", FLOOD, kind, str(port), str(MESSAGES_PER_S), str(FLOOD_S)]
    command = arguments + [frame.hex() for frame in frames]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield process


class Autopilot:
    """An autopilot at the other end, which sends a heartbeat each 0.2 s and counts distances."""

    def __init__(self, kind: str, port: int) -> None:
        stream = socket.SOCK_STREAM if kind == "tcpin" else socket.SOCK_DGRAM
        self._socket = socket.socket(socket.AF_INET, stream)
        self._socket.connect(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._component = Component(7)
        self._parser = dialect.MAVLink(None)
        self._parser.robust_parsing = True
        self._next_s = 0.0
        self.distances = 0

    def work(self, now_s: float) -> None:
        if now_s >= self._next_s:
            self._next_s = now_s + 0.2
            self._socket.send(self._component.heartbeat())
        with contextlib.suppress(BlockingIOError):
            for message in self._parser.parse_buffer(self._socket.recv(65536)) or ():
                self.distances += message.get_type() == "DISTANCE_SENSOR"

    def close(self) -> None:
        self._socket.close()


def attitudes(sender: Component) -> list[bytes]:
    return [sender.frame(dialect.MAVLink_attitude_message(i, 0, 0, 0, 0, 0, 0)) for i in range(50)]


def strangers() -> list[bytes]:
    """All kinds that the bridge takes from others than its autopilot."""
    ground_station, command = Component(255, 190), dialect.MAV_CMD_REQUEST_MESSAGE
    asks = dialect.MAVLink_command_long_message(7, 191, command, 0, 0, 0, 0, 0, 0, 0, 0)
    own = dialect.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
    return [ground_station.frame(asks), Component(8).heartbeat(), Component(7, 191).frame(own)]


FRAMES = {"the autopilot's": attitudes(Component(7)), "strangers'": strangers()}


@pytest.mark.real_time
@pytest.mark.parametrize("whose", slow_but({"strangers'"}, FRAMES))
@pytest.mark.parametrize("kind", ["udpin", *slow("tcpin")])
def test_a_flood_does_not_hold_up_the_polling(kind: str, whose: str) -> None:
    """The work of each step is counted in CPU time, and the flood lasts for as long as there was a processor."""
    clock = SystemClock()
    pings_s: list[float] = []

    def echo(ping_s: float) -> int:
        pings_s.append(ping_s)
        return 300

    sonars = [EmulatedMB1242(address, clock.now, echo) for address in range(0x70, 0x74)]
    port = free_port(socket.SOCK_STREAM if kind == "tcpin" else socket.SOCK_DGRAM)
    transport = open_transport(f"{kind}:127.0.0.1:{port}", clock)
    bridge = Bridge(load_airframe(CONFIGS / "quad_pallet.yaml"), EmulatedBus(sonars, clock.now), clock, transport)
    autopilot = Autopilot(kind, port)
    begin_s = clock.now()
    while clock.now() < begin_s + 1.0:
        bridge.step()
        autopilot.work(clock.now())
    assert bridge.link.autopilot_is_present
    pings_s.clear()
    autopilot.distances = 0
    spent_s: list[float] = []
    # As the service does once it has started: this process holds the modules of all tests.
    gc.freeze()
    before_s = without_processor_s()
    with flood(kind, port, FRAMES[whose]) as process:
        while process.poll() is None:
            start_s = time.thread_time()
            bridge.step()
            spent_s.append(time.thread_time() - start_s)
            autopilot.work(clock.now())
    took_s = pings_s[-1] - pings_s[0] - (without_processor_s() - before_s)
    autopilot.close()
    transport.close()
    # One step in a hundred may be interrupted: a virtual computer counts what its host takes.
    assert np.quantile(spent_s, 0.99) < SLOT_S / 4
    assert np.median(spent_s) < SLOT_S / 20
    gaps_s = [after_s - before_s for before_s, after_s in itertools.pairwise(pings_s)]
    print(f"{kind}, {whose}: longest step {1e3 * max(spent_s):.1f} ms CPU, {sum(spent_s) / took_s:.2f} of a core; gaps")
    print(f"between pings {1e3 * min(gaps_s):.0f} to {1e3 * max(gaps_s):.0f} ms; {autopilot.distances} distances")
    assert len(pings_s) >= 0.5 * took_s / SLOT_S
    assert autopilot.distances >= 0.4 * took_s / SLOT_S
    assert bridge.link.autopilot_system == 7
    assert len(bridge.link._frames._incomplete) < 300
