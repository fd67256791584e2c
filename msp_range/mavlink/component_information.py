"""COMPONENT_INFORMATION_BASIC (396), which pymavlink's dialects do not have yet.

Fields and their order on the wire as in MAVLink's common.xml; tests compute the checksum seed from that definition.
"""

import struct
from typing import Any

from msp_range import __version__
from msp_range.mavlink.dialect import dialect

MESSAGE_ID = 396
CRC_EXTRA = 50
_WIRE = struct.Struct("<QII32s32s24s24s32s")


class ComponentInformationBasic(dialect.MAVLink_message):  # type: ignore[misc]
    """Vendor, model and version of this component as text; other fields are unknown."""

    id = MESSAGE_ID
    msgname = "COMPONENT_INFORMATION_BASIC"

    def __init__(self, time_boot_ms: int) -> None:
        super().__init__(MESSAGE_ID, self.msgname)
        self._time_boot_ms = time_boot_ms

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame, as pymavlink's messages make it."""
        version = __version__.encode()[:23]
        payload = _WIRE.pack(0, self._time_boot_ms, 0, b"msp-range", b"range finder bridge", version, b"", b"")
        frame: bytes = self._pack(mav, CRC_EXTRA, payload, force_mavlink1)
        return frame
