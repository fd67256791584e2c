"""A ground station that sends commands to an autopilot and keeps what it receives."""

import contextlib
import socket
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from tests.support.waiting import until

CONFIGS = Path(__file__).parents[2] / "configs"
AUTOPILOT, BRIDGE = 1, 191
"""Component ids."""

SITL_LIMIT_S = 180.0
"""How long a flight waits for what must come [s]. An estimator that settles or a landing take 45 s on an idle computer;
less fails flights on a busy one, more only delays the message of a flight that fails."""

Found = TypeVar("Found")


def connected_tcp(port: int) -> socket.socket:
    """A connection to a program that may still be starting."""
    made: list[socket.socket] = []

    def is_connected() -> bool:
        with contextlib.suppress(ConnectionRefusedError):
            made.append(socket.create_connection(("127.0.0.1", port)))
        return bool(made)

    until(is_connected, SITL_LIMIT_S, seen=lambda: f"nobody listens at TCP port {port}")
    return made[0]


def connected_udp(port: int) -> socket.socket:
    """A socket at ``port`` that answers the first who sends to it."""
    udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind(("127.0.0.1", port))
    udp.settimeout(SITL_LIMIT_S)
    _, peer = udp.recvfrom(2048)
    udp.connect(peer)
    return udp


class GroundStation:
    """A MAVLink ground station (system 255) on a connected socket.

    Attributes
    ----------
    received
        Every message with the time [s, monotonic] at which it came.
    """

    def __init__(self, link: socket.socket) -> None:
        self.received: list[tuple[float, Any]] = []
        self._sorted: defaultdict[tuple[str, int], list[tuple[float, Any]]] = defaultdict(list)
        self._link = link
        self._link.settimeout(0.05)
        self._mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._mav.robust_parsing = True
        self._sending = threading.Lock()
        self._ended = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ended = True
        self._thread.join()
        self._link.close()

    def all(self, kind: str, component: int = AUTOPILOT) -> list[tuple[float, Any]]:
        """Messages of one kind from one component, with their times."""
        return self._sorted[kind, component]

    def wait(self, what: str, find: Callable[[], Found | None], limit_s: float = SITL_LIMIT_S) -> Found:
        """What ``find`` returns once it is true; AssertionError with the autopilot's last words after a while."""
        found: list[Found] = []

        def is_found() -> bool:
            found[:] = filter(None, [find()])
            return bool(found)

        def seen() -> str:
            texts = [message.text for _, message in self.all("STATUSTEXT")[-10:]]
            return f"no {what}; the last texts of the autopilot: {texts}"

        until(is_found, limit_s, lambda: time.sleep(0.05), seen)
        return found[0]

    def ask(self, name: str, rate_hz: float) -> None:
        """Ask the autopilot for a message."""
        message_id = getattr(mavlink, f"MAVLINK_MSG_ID_{name}")
        self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz)

    def command(self, command: int, *parameters: float) -> None:
        """Send a command, without waiting for its acknowledgement."""
        seven = [*parameters, *[0.0] * (7 - len(parameters))]
        self.send(mavlink.MAVLink_command_long_message(1, AUTOPILOT, command, 0, *seven))

    def command_until_accepted(self, what: str, command: int, *parameters: float) -> None:
        """Send a command each second until the autopilot accepts it: it may still be starting."""
        sent_s = float("-inf")
        first_s = time.monotonic()

        def accepted() -> bool:
            nonlocal sent_s
            if time.monotonic() - sent_s > 1.0:
                sent_s = time.monotonic()
                self.command(command, *parameters)
            return any(
                message.command == command and message.result == mavlink.MAV_RESULT_ACCEPTED
                for time_s, message in self.all("COMMAND_ACK")
                if time_s > first_s
            )

        self.wait(what, accepted)

    def is_armed(self) -> bool:
        heartbeats = self.all("HEARTBEAT")
        return bool(heartbeats and heartbeats[-1][1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)

    def _run(self) -> None:
        heartbeat_s = float("-inf")
        while not self._ended:
            if time.monotonic() - heartbeat_s >= 1.0:
                heartbeat_s = time.monotonic()
                self.send(
                    mavlink.MAVLink_heartbeat_message(
                        mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
                    )
                )
            try:
                received = self._link.recv(65535)
            except TimeoutError:
                continue
            except OSError:
                time.sleep(0.05)
                continue
            now_s = time.monotonic()
            for message in self._mav.parse_buffer(received) or ():
                self.received.append((now_s, message))
                self._sorted[message.get_type(), message.get_srcComponent()].append((now_s, message))

    def send(self, message: Any) -> None:
        """Send one message; one that cannot be sent is lost."""
        with self._sending, contextlib.suppress(OSError):
            self._link.send(message.pack(self._mav))
            self._mav.seq = (self._mav.seq + 1) % 256
