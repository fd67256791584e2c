"""An autopilot for tests of `msp-range params` and `doctor`: pymavlink's own connection in a thread, with parameters.

Written from MAVLink's documents and not from the client: it keeps parameters with a type each, as PX4 sends integers
byte by byte in the place of a float, and as ArduPilot refuses what it does not know by silence.
"""

import os
import struct
import threading
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any, Self

os.environ.setdefault("MAVLINK20", "1")
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

INTEGER_NAMES = ("MAV_", "SER_", "EKF2_RNG_CTRL", "EKF2_HGT_REF")
"""Beginnings of the names of PX4's parameters that are integers; all others are floats."""

RANGE_FINDER = {
    "RNGFND1_TYPE": 10.0,
    "RNGFND1_ORIENT": 25.0,
    "RNGFND1_ADDR": 0.0,
    "RNGFND1_MIN": 0.19,
    "RNGFND1_MAX": 7.6,
    "RNGFND1_GNDCLR": 0.2,
    "RNGFND1_POS_Z": 0.05,
}
"""ArduPilot's parameters for the pallet's fused stream."""


class ParameterAutopilot:
    """An autopilot on a pymavlink connection.

    Parameters
    ----------
    url
        As pymavlink has it: ``udpin:127.0.0.1:14550``, or a serial port's path.
    values
        Parameters that it knows.
    px4
        PX4 instead of ArduPilot.
    kind
        MAV_TYPE of its heartbeat.
    armed
        What its heartbeat says.
    uses_range_finder
        Whether it sends the distances that come back, as its own DISTANCE_SENSOR and in SYS_STATUS.
    system
        Its system id.
    version
        What AUTOPILOT_VERSION says; None: it is not answered.
    mission
        Frame, command and height of each item; None: nobody answers for it.
    """

    def __init__(
        self,
        url: str,
        values: Mapping[str, float] | None = None,
        *,
        px4: bool = False,
        kind: int = mavlink.MAV_TYPE_QUADROTOR,
        armed: bool = False,
        uses_range_finder: bool = True,
        system: int = 1,
        baud: int = 57600,
        version: tuple[int, int] | None = (4, 7),
        mission: Sequence[tuple[int, int, float]] | None = None,
    ) -> None:
        self.values = dict(values or {})
        self.px4 = px4
        self.version = version
        self.mission = mission
        self.armed = armed
        self.set_names: list[str] = []
        self.received: list[Any] = []
        self.lossy = 0
        """So many of the next PARAM_SET messages are lost."""
        self.stubborn: set[str] = set()
        """Parameters that keep their value."""
        self._kind = kind
        self._uses_range_finder = uses_range_finder
        self._connection = mavutil.mavlink_connection(url, baud=baud, source_system=system, source_component=1)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def port(self) -> int:
        """Where it listens: what the kernel gave where the URL's port is 0."""
        of = self._connection
        return int((of.listen if hasattr(of, "listen") else of.port).getsockname()[1])

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()
        self._connection.close()

    def _run(self) -> None:
        next_heartbeat_s = 0.0
        while not self._stop.is_set():
            if time.monotonic() >= next_heartbeat_s:
                next_heartbeat_s = time.monotonic() + 0.2
                self._send_heartbeat()
            message = self._connection.recv_match(blocking=True, timeout=0.02)
            if message is not None:
                self.received.append(message)
                self._take(message)

    def _send_heartbeat(self) -> None:
        autopilot = mavlink.MAV_AUTOPILOT_PX4 if self.px4 else mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
        mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0
        self._connection.mav.heartbeat_send(self._kind, autopilot, mode, 0, mavlink.MAV_STATE_STANDBY)

    def _take(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "PARAM_REQUEST_READ":
            self._send_value(message.param_id)
        elif kind == "PARAM_SET":
            if self.lossy:
                self.lossy -= 1
            elif message.param_id in self.values and message.param_id not in self.stubborn:
                self.set_names.append(message.param_id)
                self.values[message.param_id] = self._decoded(message.param_value, message.param_type)
                self._send_value(message.param_id)
        elif kind == "COMMAND_LONG" and message.param1 == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION and self.version:
            number = self.version[0] << 24 | self.version[1] << 16
            self._connection.mav.autopilot_version_send(0, number, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)
        elif kind == "MISSION_REQUEST_LIST" and self.mission is not None:
            # A ground station reads the fence meanwhile.
            for component, type_ in ((190, 0), (192, mavlink.MAV_MISSION_TYPE_FENCE)):
                self._connection.mav.mission_count_send(message.get_srcSystem(), component, 99, type_)
                time.sleep(0.05)
            self._connection.mav.mission_count_send(message.get_srcSystem(), 192, len(self.mission))
        elif kind == "MISSION_REQUEST_INT" and self.mission is not None:
            frame, command, height_m = self.mission[message.seq]
            where = message.get_srcSystem(), 192, message.seq, frame, command, 0, 1
            self._connection.mav.mission_item_int_send(*where, 0, 0, 0, 0, 473977000, 85456000, height_m)
        elif kind == "SETUP_SIGNING" and not self.px4:  # PX4 1.17 has no signing
            self._connection.setup_signing(bytes(message.secret_key), sign_outgoing=True)
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self._connection.mav.timesync_send(time.monotonic_ns(), message.ts1)
        elif kind == "DISTANCE_SENSOR" and self._uses_range_finder and self._takes(message.id):
            self._connection.mav.distance_sensor_send(
                message.time_boot_ms, 20, 760, message.current_distance, 1, 0, message.orientation, 0
            )
            bit = mavlink.MAV_SYS_STATUS_SENSOR_LASER_POSITION
            self._connection.mav.sys_status_send(bit, bit, bit, 0, 12000, 0, 90, 0, 0, 0, 0, 0, 0)

    def _takes(self, sensor_id: int) -> bool:
        """Whether it takes distances with this id, as ArduPilot from 4.8 on decides by the address."""
        takes_one = not self.px4 and self.version is not None and self.version >= (4, 8)
        return not takes_one or self.values.get("RNGFND1_ADDR", 0.0) in (0.0, sensor_id)

    def _type_of(self, name: str) -> int:
        whole = self.px4 and name.startswith(INTEGER_NAMES)
        return int(mavlink.MAV_PARAM_TYPE_INT32 if whole else mavlink.MAV_PARAM_TYPE_REAL32)

    def _send_value(self, name: str) -> None:
        if name not in self.values:
            return
        value = self.values[name]
        if self._type_of(name) == mavlink.MAV_PARAM_TYPE_INT32:
            (value,) = struct.unpack("f", struct.pack("i", int(value)))
        self._connection.mav.param_value_send(name.encode(), value, self._type_of(name), len(self.values), 0)

    def _decoded(self, value: float, kind: int) -> float:
        if kind == mavlink.MAV_PARAM_TYPE_INT32:
            (whole,) = struct.unpack("i", struct.pack("f", value))
            return float(whole)
        return value
