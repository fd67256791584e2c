"""The bridge as a MAVLink component: heartbeat, time, commands, and frames out; the transport is below it.

It speaks MAVLink 2 as the autopilot's system (1 until one is heard) and a component id of its own. Everything happens
in `service`, which the working loop calls: a heartbeat says that the loop runs.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any

from msp_range import __version__
from msp_range.clock import Clock
from msp_range.mavlink.component_information import MESSAGE_ID as COMPONENT_INFORMATION_BASIC
from msp_range.mavlink.component_information import ComponentInformationBasic
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.time_sync import AutopilotClock
from msp_range.mavlink.transport import Transport

SERVICE_INTERVAL_S = 0.005
"""Between two looks at the transport [s]."""
HEARTBEAT_INTERVAL_S = 1.0
AUTOPILOT_LOST_S = 5.0
"""Without a heartbeat for this long the autopilot counts as gone [s]."""
ASK_AGAIN_S = 5.0
"""A wanted message that has not come for this long is asked for again [s]."""
STATUS_TEXT_LENGTH = 50


class Link:
    """One connection to an autopilot.

    Parameters
    ----------
    transport
        Where bytes go and come from.
    clock
        The bridge's clock.
    component_id
        This component's id; 191 is the first onboard computer.
    hear
        Called with (time [s], message) for every message of the autopilot.
    wanted
        Messages to ask the autopilot for: name -> rate [Hz].
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        *,
        component_id: int = 191,
        hear: Callable[[float, Any], None] | None = None,
        wanted: Mapping[str, float] | None = None,
    ) -> None:
        self.transport = transport
        self._clock = clock
        self._hear = hear
        self._wanted = {_message_id(name): rate_hz for name, rate_hz in (wanted or {}).items()}
        self._wanted_heard_s = dict.fromkeys(self._wanted, float("-inf"))
        self._wanted_asked_s = dict.fromkeys(self._wanted, float("-inf"))
        self._mav = dialect.MAVLink(None, srcSystem=1, srcComponent=component_id)
        self._mav.robust_parsing = True
        now_s = clock.now()
        self._start_s = now_s
        self.autopilot_clock = AutopilotClock(now_s)
        self._autopilot_heard_s = float("-inf")
        self.autopilot_system: int | None = None
        self.system_status: int = dialect.MAV_STATE_BOOT
        self._next_heartbeat_s = now_s
        self.next_event_s = now_s
        self.sent: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()

    @property
    def autopilot_heard(self) -> bool:
        """True while heartbeats of an autopilot come."""
        return self._clock.now() - self._autopilot_heard_s < AUTOPILOT_LOST_S

    def send(self, message: Any) -> bytes | None:
        """Send one message at once; the frame, or None where the transport dropped it."""
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        if self.transport.send(frame):
            self.sent[message.msgname] += 1
            return frame
        self.dropped[message.msgname] += 1
        return None

    def send_text(self, severity: int, text: str) -> None:
        """STATUSTEXT, cut to what it can hold."""
        self.send(dialect.MAVLink_statustext_message(severity, text.encode("ascii", "replace")[:STATUS_TEXT_LENGTH]))

    def service(self) -> None:
        """Take what has come, and send what is due."""
        now_s = self._clock.now()
        self.next_event_s = now_s + SERVICE_INTERVAL_S
        arrived = self.transport.receive()
        if arrived:
            for message in self._mav.parse_buffer(arrived) or ():
                self._take(now_s, message)
        if now_s >= self._next_heartbeat_s:
            self._next_heartbeat_s = max(self._next_heartbeat_s + HEARTBEAT_INTERVAL_S, now_s)
            self.send(self._heartbeat())
            self._ask(now_s)
        if now_s >= self.autopilot_clock.next_request_s and self.autopilot_heard:
            self.send(dialect.MAVLink_timesync_message(0, self.autopilot_clock.request(now_s)))

    def close(self) -> None:
        """Release the transport."""
        self.transport.close()

    def _heartbeat(self) -> Any:
        return dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, self.system_status, 3
        )

    def _ask(self, now_s: float) -> None:
        if self.autopilot_system is None or not self.autopilot_heard:
            return
        for message_id, rate_hz in self._wanted.items():
            waiting_s = now_s - max(self._wanted_heard_s[message_id], self._wanted_asked_s[message_id])
            if waiting_s >= ASK_AGAIN_S:
                self._wanted_asked_s[message_id] = now_s
                self.send(
                    dialect.MAVLink_command_long_message(
                        self.autopilot_system,
                        dialect.MAV_COMP_ID_AUTOPILOT1,
                        dialect.MAV_CMD_SET_MESSAGE_INTERVAL,
                        0,
                        message_id,
                        1e6 / rate_hz,
                        0,
                        0,
                        0,
                        0,
                        0,
                    )
                )

    def _take(self, now_s: float, message: Any) -> None:
        kind = message.get_type()
        if kind == "BAD_DATA":
            return
        source = (message.get_srcSystem(), message.get_srcComponent())
        if source == (self._mav.srcSystem, self._mav.srcComponent):
            return
        if kind == "HEARTBEAT":
            self._take_heartbeat(now_s, source, message)
        elif kind == "PING" and message.target_system == 0 and message.target_component == 0:
            self.send(dialect.MAVLink_ping_message(message.time_usec, message.seq, *source))
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self.send(dialect.MAVLink_timesync_message(round(now_s * 1e9), message.ts1))
        elif kind in ("COMMAND_LONG", "COMMAND_INT"):
            self._take_command(source, message)
        if source == (self.autopilot_system, dialect.MAV_COMP_ID_AUTOPILOT1):
            if kind == "TIMESYNC" and message.tc1 != 0:
                self.autopilot_clock.hear_timesync(now_s, message.tc1, message.ts1)
            elif kind == "SYSTEM_TIME":
                self.autopilot_clock.hear_system_time(now_s, message.time_boot_ms)
            message_id = message.get_msgId()  # not message.id, which some messages have as a field
            if message_id in self._wanted_heard_s:
                self._wanted_heard_s[message_id] = now_s
            if self._hear is not None:
                self._hear(now_s, message)

    def _take_heartbeat(self, now_s: float, source: tuple[int, int], message: Any) -> None:
        """Latch the first autopilot; another one only when the first has gone."""
        if message.autopilot == dialect.MAV_AUTOPILOT_INVALID or source[1] != dialect.MAV_COMP_ID_AUTOPILOT1:
            return
        if self.autopilot_system is None or (source[0] != self.autopilot_system and not self.autopilot_heard):
            self.autopilot_system = source[0]
            self._mav.srcSystem = source[0]
            self.autopilot_clock = AutopilotClock(self._start_s)
        if source[0] == self.autopilot_system:
            self._autopilot_heard_s = now_s

    def _take_command(self, source: tuple[int, int], command: Any) -> None:
        """Acknowledge every command to this component; of those to all, only what it can do."""
        if command.target_system not in (0, self._mav.srcSystem):
            return
        if command.target_component not in (0, self._mav.srcComponent):
            return
        answer = None
        if command.command == dialect.MAV_CMD_REQUEST_MESSAGE:
            answer = self._requested(command.param1)
            result = dialect.MAV_RESULT_DENIED if answer is None else dialect.MAV_RESULT_ACCEPTED
        else:
            result = dialect.MAV_RESULT_UNSUPPORTED
        if command.target_component == 0 and answer is None:
            return
        self.send(dialect.MAVLink_command_ack_message(command.command, result, 0, 0, *source))
        if answer is not None:
            self.send(answer)

    def _requested(self, message_id: float) -> Any | None:
        if message_id == dialect.MAVLINK_MSG_ID_HEARTBEAT:
            return self._heartbeat()
        if message_id == COMPONENT_INFORMATION_BASIC:
            time_boot_ms = self.autopilot_clock.time_boot_ms(self._clock.now())
            return ComponentInformationBasic(time_boot_ms, "msp-range", "range finder bridge", __version__)
        return None


def _message_id(name: str) -> int:
    message_id: int = getattr(dialect, f"MAVLINK_MSG_ID_{name}")
    return message_id
