"""An autopilot on a link, asked for its parameters and given new ones, by MAVLink's parameter protocol.

ArduPilot sends every value as a float; PX4 sends its integers (INT32) as four bytes in the place of the float
(https://mavlink.io/en/services/parameter.html). Nothing is set while the vehicle is armed, or while nobody knows.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from msp_range.clock import Clock
from msp_range.config import LinkSettings
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.frames import text_of
from msp_range.mavlink.link import Link
from msp_range.mavlink.participants import AUTOPILOTS
from msp_range.mavlink.signing import Signing, signing_of
from msp_range.mavlink.transport import Transport
from msp_range.params.settings import Firmware, Vehicle
from msp_range.yaml_file import ConfigError

COMPONENT_ID = 192
"""MAV_COMP_ID_ONBOARD_COMPUTER2: the bridge itself uses that of the first computer, and may be running."""
ANSWER_S = 1.0
"""How long an answer is waited for [s]: over a wire it takes some 10 ms, over a radio some 300 ms. Longer only
waits."""
TRIES = 3
HEARTBEAT_OLD_S = 2.0
"""A heartbeat that is older does not show that the vehicle is disarmed now [s]: it comes once a second, and a parameter
is not written for two seconds after a lost one."""
ADDRESS_IS_ID = 4 << 24 | 8 << 16
"""AUTOPILOT_VERSION's number of ArduPilot 4.8.0: major, minor, patch, kind of release (pull request 33982)."""

_VEHICLES: dict[int, Vehicle] = {
    dialect.MAV_TYPE_FIXED_WING: "plane",
    **dict.fromkeys(range(19, 26), "plane"),  # MAV_TYPE_VTOL_...: their names have changed
    dialect.MAV_TYPE_SUBMARINE: "sub",
    dialect.MAV_TYPE_GROUND_ROVER: "rover",
    dialect.MAV_TYPE_SURFACE_BOAT: "rover",
}
"""Kinds of vehicles by the heartbeat's type; all others are copters."""


class ParameterClient:
    """One autopilot's parameters.

    Parameters
    ----------
    transport
        The link, which nobody else uses.
    clock
        How long to wait.
    settings
        The airframe's link: the autopilot's system id, and the key for signing.
    wanted
        Other messages to ask the autopilot for: name -> rate [Hz].
    signing
        Replaces the signing that the airframe's key gives.

    Attributes
    ----------
    link
        The connection.
    messages
        The last message of each kind that the autopilot sent.
    end_s
        When to wait for nothing any more, whatever is missing [s].

    Raises
    ------
    ConfigError
        The airframe's key cannot be used.
    """

    def __init__(
        self,
        transport: Transport,
        clock: Clock,
        settings: LinkSettings,
        wanted: Mapping[str, float] = MappingProxyType({}),
        signing: Signing | None = None,
    ) -> None:
        self._clock = clock
        self._values: dict[str, tuple[float, int]] = {}
        self.messages: dict[str, Any] = {}
        self._heartbeat: Any = None
        self._heartbeat_s = float("-inf")
        self.end_s = float("inf")
        self.link = Link(
            transport,
            clock,
            component_id=COMPONENT_ID,
            on_message=self.on_message,
            wanted=wanted,
            system_id=settings.system_id,
            signing=signing or signing_of(settings.signing_key, clock),
        )

    def on_message(self, now_s: float, message: Any) -> None:
        """Keep a message of the autopilot."""
        kind = message.msgname
        self.messages[kind] = message
        if kind == "HEARTBEAT":
            self._heartbeat, self._heartbeat_s = message, now_s
        elif kind == "PARAM_VALUE":
            name = text_of(message.param_id)
            self._values[name] = (
                _as_type("<f", "<i", message.param_value)
                if self._is_whole(message.param_type)
                else message.param_value,
                message.param_type,
            )

    def wait(self, is_there: Callable[[], bool], limit_s: float) -> bool:
        """Serve the link until ``is_there()``, at most ``limit_s``; returns whether it came."""
        end_s = min(self._clock.now() + limit_s, self.end_s)
        while not is_there():
            if self._clock.now() >= end_s:
                return False
            self.link.service(self._clock.sleep_until(min(self.link.next_event_s, end_s), self.link.files))
        return True

    def connect(self, limit_s: float) -> bool:
        """Wait for an autopilot's heartbeat."""
        return self.wait(lambda: self._heartbeat is not None, limit_s)

    @property
    def autopilot(self) -> Autopilot | None:
        """What kind of autopilot it is; None where it is another one, or none was received."""
        return None if self._heartbeat is None else AUTOPILOTS.get(self._heartbeat.autopilot)

    @property
    def armed(self) -> bool | None:
        """Whether the vehicle is armed; None if no recent heartbeat says so."""
        if self._clock.now() - self._heartbeat_s > HEARTBEAT_OLD_S:
            return None
        return bool(self._heartbeat.base_mode & dialect.MAV_MODE_FLAG_SAFETY_ARMED)

    @property
    def vehicle(self) -> Vehicle:
        """ArduPilot's kind of vehicle, by the heartbeat."""
        return "copter" if self._heartbeat is None else _VEHICLES.get(self._heartbeat.type, "copter")

    def firmware(self) -> Firmware | None:
        """The firmware, which decides names and units of parameters; None if the autopilot is neither ArduPilot nor
        PX4.

        Whether ArduPilot has the names before 4.7 is seen by asking for one of them, since development versions changed
        names before their number. Whether it has what came with 4.8 is seen by its version; without one it counts as
        having it.
        """
        if self.autopilot != "ardupilot":
            return None if self.autopilot is None else Firmware(self.autopilot)
        centimetres = "RNGFND1_MAX_CM" in self.read_any(("RNGFND1_MAX", "RNGFND1_MAX_CM"))
        self.ask(
            [
                dialect.MAVLink_command_long_message(
                    *self.target,
                    dialect.MAV_CMD_REQUEST_MESSAGE,
                    0,
                    dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
                    *[0] * 6,
                )
            ],
            lambda: "AUTOPILOT_VERSION" in self.messages,
        )
        version = self.messages.get("AUTOPILOT_VERSION")
        return Firmware(
            "ardupilot", self.vehicle, centimetres, version is not None and version.flight_sw_version < ADDRESS_IS_ID
        )

    def read(self, name: str) -> float | None:
        """A parameter's value; None where the autopilot does not know it, or does not answer."""
        return self.read_any((name,)).get(name)

    def read_any(self, *groups: Sequence[str]) -> dict[str, float]:
        """Values by name, as soon as one name of each group was answered: firmwares name a parameter differently."""
        names = [name for group in groups for name in group]
        for name in names:
            self._values.pop(name, None)
        self.ask(
            [dialect.MAVLink_param_request_read_message(*self.target, name.encode(), -1) for name in names],
            lambda: all(any(name in self._values for name in group) for group in groups),
        )
        return {name: self._values[name][0] for name in names if name in self._values}

    def ask(self, messages: Sequence[Any], is_answered: Callable[[], bool]) -> None:
        """Send messages until they are answered, at most a few times."""
        for _ in range(TRIES):
            for message in messages:
                self.link.send(message)
            if self.wait(is_answered, ANSWER_S):
                return

    def write(self, name: str, value: float) -> float:
        """Set a parameter and read it back; returns what the autopilot has now.

        Raises
        ------
        ConfigError
            The vehicle is armed, the autopilot does not know the parameter, or it has another value afterwards.
        """
        if self.read(name) is None:
            raise ConfigError(f"the autopilot does not know {name}")
        kind = self._values[name][1]
        for _ in range(TRIES):
            # Checked for each try: somebody may arm the vehicle meanwhile.
            if self.armed is None:
                raise ConfigError("no heartbeat of the autopilot: whether the vehicle is armed is not known")
            if self.armed:
                raise ConfigError("the vehicle is armed: parameters are set only while it is disarmed")
            encoded = _as_type("<i", "<f", round(value)) if self._is_whole(kind) else value
            self.link.send(dialect.MAVLink_param_set_message(*self.target, name.encode(), encoded, kind))
            self.wait(lambda: False, 0.1)
            found = self.read(name)
            if found is not None and same(found, value):
                return found
        raise ConfigError(f"{name} was set to {value:g}, and reads back as {found}")

    @property
    def target(self) -> tuple[int, int]:
        """System and component that messages to the autopilot are for."""
        return self.link.autopilot_system or 1, dialect.MAV_COMP_ID_AUTOPILOT1

    def _is_whole(self, kind: int) -> bool:
        return self.autopilot == "px4" and kind == dialect.MAV_PARAM_TYPE_INT32


def _as_type(given: str, wanted: str, value: float) -> float:
    """A number of one type (`struct` format) whose bytes are read as another type."""
    return float(struct.unpack(wanted, struct.pack(given, value))[0])


def same(found: float, wanted: float) -> bool:
    """Whether two values are the same single-precision number, or nearly.

    Examples
    --------
    >>> same(0.1899999976158142, 0.19), same(0.2, 0.19)
    (True, False)
    """
    return abs(found - wanted) <= 1e-6 * max(1.0, abs(wanted))
