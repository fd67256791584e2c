"""pymavlink's MAVLink 2 dialect ``common``: the one import of it, typed as Any because pymavlink has no types.

The dialect alone is imported, not mavutil, which costs half a second and 44 MB and chooses the protocol by an
environment variable. The v20 module always speaks MAVLink 2, without which DISTANCE_SENSOR has no field of view.
"""

import struct
from types import SimpleNamespace
from typing import Any

import pymavlink.dialects.v20.common as _common

dialect: Any = _common

MESSAGES: dict[int, Any] = {
    **dialect.mavlink_map,
    # ArduPilot's, whose dialect takes 6 MB more: as much of it as `msp_range.mavlink.frames` needs to read it.
    193: SimpleNamespace(
        msgname="EKF_STATUS_REPORT",
        ordered_fieldnames=(
            "velocity_variance",
            "pos_horiz_variance",
            "pos_vert_variance",
            "compass_variance",
            "terrain_alt_variance",
            "flags",
            "airspeed_variance",
        ),
        unpacker=struct.Struct("<5fHf"),
        lengths=[1] * 7,
        crc_extra=71,
    ),
}
"""Messages that can be received, by their ids."""
MESSAGE_IDS = {kind.msgname: message_id for message_id, kind in MESSAGES.items()}
