"""The bridge as a MAVLink component: heartbeat, time, commands, and frames out; the transport is below it.

It sends MAVLink 2 with the autopilot's system id (1 until one is received) and its own component id. Everything happens
in `service`, which the polling loop calls, so a heartbeat shows that the loop runs. One call does a limited amount of
work, whatever arrives.
"""

from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from msp_range.clock import Clock
from msp_range.mavlink.component_information import ComponentInformationBasic
from msp_range.mavlink.contradictions import Contradictions
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.frames import Frame, FrameReader
from msp_range.mavlink.participants import Participants
from msp_range.mavlink.signing import Signing
from msp_range.mavlink.time_sync import AutopilotClock
from msp_range.mavlink.transport import Transport
from msp_range.mavlink.wanted import WantedMessages
from msp_range.pilot_texts import LONGEST_TEXT, Condition, Text

SERVICE_INTERVAL_S = 0.005
"""Time between two reads of the transport [s] where messages are dense, or where it has no file to wait for. Shorter
wakes the bridge more often, longer delays what it does with messages."""
QUIET_INTERVAL_S = 0.05
"""Longest time between two reads of a transport that is quiet, or whose files wake the bridge [s]; requests are at most
this late."""
DENSE_S = 2.0 * SERVICE_INTERVAL_S
"""Messages that arrive within this time after the ones before are dense [s]: then the bridge reads each
`SERVICE_INTERVAL_S` instead of waiting for the file, as a serial port can be read again after every few bytes. Longer
than the interval, so that a flood stays dense."""
DECODED_FROM_AUTOPILOT, DECODED_FROM_OTHERS = 32, 4
"""Largest number of messages that one call decodes: 6400 and 800 a second, while autopilots send some hundreds.
Decoding takes 3 us on a desktop computer and some 15 us on a small one: with 32 a flood delays the polling by less than
1 ms."""
WAITING_FROM_AUTOPILOT, WAITING_FROM_OTHERS = 256, 32
"""Largest number of messages that wait for the next call; of more, the newest of each kind are kept, so that a flood
cannot hide a heartbeat. 256 arrive while a locked-up bus blocks the loop for a second; with more, messages are older in
a flood."""
ANSWERS_PER_S = 20
"""Largest number of answers per second to the autopilot's TIMESYNC and PING, and to commands. PX4 requests the time at
10 Hz."""
SENT_KEPT = 512
"""Number of own frames that are remembered to recognise them if they come back: those of 10 s or more. With fewer, a
late echo is taken for another program's."""
HEARTBEAT_INTERVAL_S = 1.0
AUTOPILOT_LOST_S = 5.0
"""Time without a heartbeat after which the autopilot counts as lost [s]."""
TIMESYNC_BYTES = 16
"""Length of TIMESYNC without the target, which newer versions of it have at the end."""

_COMMANDS = (dialect.MAVLINK_MSG_ID_COMMAND_LONG, dialect.MAVLINK_MSG_ID_COMMAND_INT)
Waiting = list[tuple[float, Frame]]
"""When each frame arrived [s], and the frame."""


class Link:
    """One connection to an autopilot.

    Parameters
    ----------
    transport
        The transport.
    clock
        The bridge's clock.
    component_id
        This component's id; 191 is the first onboard computer.
    on_message
        Called with (time [s], message) for every message of the autopilot.
    wanted
        Messages to request from the autopilot: rate [Hz] by name.
    autopilot
        Expected type of the autopilot; None: any.
    system_id
        The autopilot's system id; None: that of the first autopilot that is received. Another one is used only while
        the first is silent.
    signing
        Signs what is sent, and decides what may be received; None: nothing is signed.
    """

    autopilot_system: int | None = None
    autopilot_armed = False
    """State in its last heartbeat, even if none arrives any more."""
    system_status: int = dialect.MAV_STATE_BOOT
    _heartbeat_s = _arrived_s = float("-inf")
    _waits_for_files = False

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        *,
        component_id: int,
        on_message: Callable[[float, Any], None],
        wanted: Mapping[str, float],
        autopilot: Autopilot | None = None,
        system_id: int | None = None,
        signing: Signing | None = None,
    ) -> None:
        self.transport = transport
        self._clock = clock
        self._report_message = on_message
        self.wanted = WantedMessages(wanted)
        self._participants = Participants(autopilot)
        self._contradictions = Contradictions()
        self._pinned_system = self._first_system = system_id
        self._signing = signing
        self._frames = FrameReader()
        self._from_autopilot: Waiting = []
        self._from_others: Waiting = []
        self._ids = system_id or 1, component_id
        self._mav = dialect.MAVLink(None, *self._ids)
        now_s = clock.now()
        self._start_s = self._next_heartbeat_s = self.next_event_s = now_s
        self.autopilot_clock = AutopilotClock(now_s)
        self.sent: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        self._sent_frames: deque[bytes] = deque(maxlen=SENT_KEPT)
        self._autopilot_answers, self._command_answers = _Allowance(), _Allowance()

    @property
    def autopilot_is_present(self) -> bool:
        """True while heartbeats of an autopilot are received."""
        return self._clock.now() - self._heartbeat_s < AUTOPILOT_LOST_S

    @property
    def _autopilot(self) -> tuple[int | None, int]:
        return self.autopilot_system, dialect.MAV_COMP_ID_AUTOPILOT1

    @property
    def files(self) -> Sequence[int]:
        """Files that, as soon as one can be read, are a reason for `service` before ``next_event_s``."""
        return self.transport.files if self._waits_for_files else ()

    def send(self, message: Any) -> bytes | None:
        """Send a message at once; returns the frame, or None if the transport dropped it."""
        if self._signing is not None:
            self._signing.sign_next(self._mav)
        frame: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        self._sent_frames.append(frame)
        is_sent = self.transport.send(frame)
        (self.sent if is_sent else self.dropped)[message.msgname] += 1
        return frame if is_sent else None

    def send_text(self, severity: int, text: str) -> None:
        """Send STATUSTEXT, truncated to its maximum length."""
        self.send(dialect.MAVLink_statustext_message(severity, text.encode("ascii", "replace")[:LONGEST_TEXT]))

    def service(self, has_arrived: bool = False) -> None:
        """Process received messages, and send what is due; ``has_arrived``: one of the `files` can be read."""
        now_s = self._clock.now()
        self.next_event_s = now_s + SERVICE_INTERVAL_S
        received = self.transport.receive()
        if received:
            self._sort(now_s, self._frames.read(received))
        if self._from_autopilot:
            self._decode_first(self._from_autopilot, DECODED_FROM_AUTOPILOT, WAITING_FROM_AUTOPILOT)
        if self._from_others:
            self._decode_first(self._from_others, DECODED_FROM_OTHERS, WAITING_FROM_OTHERS)
        if now_s >= self._next_heartbeat_s:
            self._next_heartbeat_s += HEARTBEAT_INTERVAL_S
            if self._next_heartbeat_s <= now_s:  # The loop stood still: the next one is a second from now.
                self._next_heartbeat_s = now_s + HEARTBEAT_INTERVAL_S
            self.send(self._heartbeat())
        is_due = now_s >= self.wanted.next_request_s or now_s >= self.autopilot_clock.next_request_s
        if is_due and self.autopilot_is_present:
            self._ask(now_s)
        is_dense = False
        # Also where no bytes have come: a server with all the clients that it takes stays readable, and would wake the
        # loop without a pause.
        if received or has_arrived:
            is_dense = now_s < self._arrived_s + DENSE_S
            self._arrived_s = now_s
        self._waits_for_files = not is_dense and bool(self.transport.files)
        quiet_until_s = float("inf") if self._waits_for_files else self.transport.quiet_until_s
        if quiet_until_s > self.next_event_s and not self._from_autopilot and not self._from_others:
            self.next_event_s = min(quiet_until_s, now_s + QUIET_INTERVAL_S, self._next_heartbeat_s)

    def conditions(self) -> list[Condition]:
        """No autopilot, and unwanted participants on the link, for `msp_range.health.Health.set`."""
        now_s, transport = self._clock.now(), self.transport
        found = self._participants.conditions(now_s)
        missing = Text.NO_AUTOPILOT.when(now_s - max(self._heartbeat_s, self._start_s) >= AUTOPILOT_LOST_S)
        if missing.text is not None:
            state = "no heartbeat comes in" if transport.connected else "nobody has connected"
            error = None if transport.connected else transport.last_error  # which begins with the description
            how = error or f"{transport.description}: {state}"
            missing = missing._replace(remedy=f"{how}; check wires, port, baud rate and the autopilot's settings of it")
        found.append(missing)
        if self._signing is not None:
            found.append(Text.SIGNING_TIME.when(not self._signing.keeps_time))
        return found

    def _heartbeat(self) -> Any:
        return dialect.MAVLink_heartbeat_message(
            dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, self.system_status, 3
        )

    def _ask(self, now_s: float) -> None:
        """Send due requests to the autopilot: for its time, and for a message that arrives too slowly."""
        if now_s >= self.autopilot_clock.next_request_s:
            self._send_timesync(0, self.autopilot_clock.request(now_s))
        request = self.wanted.request(now_s)
        if request is not None:
            command = dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, *request, *[0] * 5
            self.send(dialect.MAVLink_command_long_message(*self._autopilot, *command))

    def _send_timesync(self, tc1: int, ts1: int) -> None:
        """TIMESYNC to the autopilot, with its target where the dialect has those fields."""
        kind = dialect.MAVLink_timesync_message
        self.send(kind(tc1, ts1, *self._autopilot) if "target_system" in kind.fieldnames else kind(tc1, ts1))

    def _sort(self, now_s: float, frames: list[Frame]) -> None:
        """Keep the frames to be decoded: all from an autopilot, and those from others that concern the bridge.

        Frames whose signature is wrong are dropped; that of an autopilot's heartbeat is reported.
        """
        autopilot, signing = self.autopilot_system or self._pinned_system, self._signing
        for frame in frames:
            message_id, system, component, _, _ = frame
            is_own = (system, component) == self._ids
            if component == dialect.MAV_COMP_ID_AUTOPILOT1 and autopilot in (None, system):
                waiting = self._from_autopilot
            elif is_own or message_id in _COMMANDS or frame.is_autopilot_heartbeat:
                waiting = self._from_others
            else:
                continue
            if is_own or signing is None or signing.accepts(frame):
                waiting.append((now_s, frame))
            elif frame.is_autopilot_heartbeat:
                self._participants.seen(now_s, Text.OTHER_KEY)

    def _decode_first(self, waiting: Waiting, most_decoded: int, most_waiting: int) -> None:
        """Decode the first messages that wait, and leave the others for the next call.

        Of more than ``most_waiting`` the newest of each type and sender are kept, in the order of their arrival.
        """
        if len(waiting) > most_waiting:
            newest: dict[tuple[int, int, int], tuple[float, Frame]] = {}
            for time_s, frame in reversed(waiting):
                newest.setdefault((frame.message_id, frame.system, frame.component), (time_s, frame))
            waiting[:] = [*newest.values()][:most_waiting][::-1]
        for time_s, frame in waiting[:most_decoded]:
            self._decode(time_s, frame)
        del waiting[:most_decoded]

    def _decode(self, now_s: float, frame: Frame) -> None:
        message_id, system, component, data, _ = frame
        if (system, component) == self._ids:
            if data not in self._sent_frames:
                self._participants.suspected(now_s, Text.OWN_IDS, system=system, component=component)
            return
        message = frame.decode()
        if frame.is_autopilot_heartbeat:
            self._take_heartbeat(now_s, frame, message)
        elif message_id in _COMMANDS:
            self._take_command(now_s, frame, message)
        if component == dialect.MAV_COMP_ID_AUTOPILOT1 and system == self.autopilot_system:
            self._take_autopilots(now_s, frame, message)

    def _take_autopilots(self, now_s: float, frame: Frame, message: Any) -> None:
        if self._contradictions.update(message):
            self._participants.suspected(now_s, Text.AUTOPILOT_IDS, system=frame.system)
        kind = message.msgname
        if kind == "PING" and message.target_system == 0 and message.target_component == 0:
            if self._autopilot_answers.take(now_s):
                self.send(dialect.MAVLink_ping_message(message.time_usec, message.seq, frame.system, frame.component))
        # Older senders and dialects do not have TIMESYNC's target, which is 0 for all.
        elif kind == "TIMESYNC" and self._is_for(*frame.payload[TIMESYNC_BYTES:].ljust(2, b"\0")[:2]):
            if message.tc1:
                self.autopilot_clock.on_timesync(now_s, message.tc1, message.ts1)
            elif self._autopilot_answers.take(now_s):
                self._send_timesync(round(now_s * 1e9), message.ts1)
        elif kind == "SYSTEM_TIME":
            self.autopilot_clock.on_system_time(now_s, message.time_boot_ms)
        elif (
            kind == "COMMAND_ACK"
            and message.command == dialect.MAV_CMD_SET_MESSAGE_INTERVAL
            and self._is_for(message.target_system, message.target_component)
        ):
            self.wanted.on_answer(now_s, message.result)
        self.wanted.on_message(now_s, frame.message_id)
        self._report_message(now_s, message)

    def _take_heartbeat(self, now_s: float, frame: Frame, message: Any) -> None:
        """Use the autopilot stated in the file, or the first one, and another one only while the first is lost."""
        is_present, system = self.autopilot_is_present, frame.system
        if frame.is_signed and self._signing is None:
            self._participants.seen(now_s, Text.NO_KEY)
        self._first_system = self._first_system or system
        if system != self._first_system:
            if self._pinned_system is not None or (is_present and system != self.autopilot_system):
                other = Text.SECOND_AUTOPILOT if is_present else Text.OTHER_AUTOPILOT
                self._participants.seen(now_s, other, system=system, own=self._ids[0])
                return
            self._participants.seen(now_s, Text.AUTOPILOT_LOST, first=self._first_system, system=system)
        if system != self.autopilot_system:
            self.autopilot_system = self._mav.srcSystem = system
            self._ids = system, self._ids[1]
            self.autopilot_clock = AutopilotClock(self._start_s)
            self._contradictions = Contradictions()
            is_present = False
        if not is_present:
            self.wanted.ask_anew(now_s)
        if now_s - self._heartbeat_s > 2.0 * HEARTBEAT_INTERVAL_S:
            self.autopilot_clock.ask_soon()
        self._heartbeat_s = now_s
        self.autopilot_armed = bool(message.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)
        self._participants.on_autopilot(now_s, message.autopilot)

    def _take_command(self, now_s: float, frame: Frame, command: Any) -> None:
        """Acknowledge every command to this component, and commands to all components if it supports them."""
        if not self._is_for(command.target_system, command.target_component):
            return
        answer: Any = None
        result = dialect.MAV_RESULT_UNSUPPORTED
        if command.command == dialect.MAV_CMD_REQUEST_MESSAGE:
            if command.param1 == dialect.MAVLINK_MSG_ID_HEARTBEAT:
                answer = self._heartbeat()
            elif command.param1 == ComponentInformationBasic.id:
                answer = ComponentInformationBasic(self.autopilot_clock.time_boot_ms(self._clock.now()))
            result = dialect.MAV_RESULT_DENIED if answer is None else dialect.MAV_RESULT_ACCEPTED
        if (command.target_component == 0 and answer is None) or not self._command_answers.take(now_s):
            return
        self.send(dialect.MAVLink_command_ack_message(command.command, result, 0, 0, frame.system, frame.component))
        if answer is not None:
            self.send(answer)

    def _is_for(self, system: int, component: int) -> bool:
        """Whether a target is this component, or all."""
        own_system, own_component = self._ids
        return system in (0, own_system) and component in (0, own_component)


class _Allowance:
    """Limits answers to `ANSWERS_PER_S`, and to the same number at once.

    Examples
    --------
    >>> allowance = _Allowance()
    >>> [sum(allowance.take(time_s) for _ in range(30)) for time_s in (0.0, 0.5, 9.0)]
    [20, 10, 20]
    """

    _left, _last_s = 0.0, float("-inf")

    def take(self, now_s: float) -> bool:
        """Whether one more is allowed; if so, it is counted."""
        self._left = min(self._left + (now_s - self._last_s) * ANSWERS_PER_S, ANSWERS_PER_S)
        self._last_s = now_s
        is_allowed = self._left >= 1.0
        self._left -= is_allowed
        return is_allowed
