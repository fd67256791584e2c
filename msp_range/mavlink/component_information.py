"""COMPONENT_INFORMATION_BASIC (396), which pymavlink's dialects do not have yet.

Fields and their order on the wire as in MAVLink's common.xml; tests compute the checksum seed from that definition.
"""

import struct
from typing import Any

from msp_range.mavlink.dialect import dialect

MESSAGE_ID = 396
CRC_EXTRA = 50
_WIRE = struct.Struct("<QII32s32s24s24s32s")


class ComponentInformationBasic(dialect.MAVLink_message):  # type: ignore[misc]
    """Who this component is: vendor, model and version as text."""

    id = MESSAGE_ID
    msgname = "COMPONENT_INFORMATION_BASIC"
    fieldnames = ("time_boot_ms", "vendor_name", "model_name", "software_version")
    instance_field = None
    instance_offset = -1

    def __init__(self, time_boot_ms: int, vendor_name: str, model_name: str, software_version: str) -> None:
        super().__init__(MESSAGE_ID, self.msgname)
        self._fieldnames = self.fieldnames
        self._instance_field = self.instance_field
        self._instance_offset = self.instance_offset
        self.time_boot_ms = time_boot_ms
        self.vendor_name = vendor_name
        self.model_name = model_name
        self.software_version = software_version

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame; capabilities, date of manufacture, hardware version and serial number are left unknown."""
        payload = _WIRE.pack(
            0,
            self.time_boot_ms,
            0,
            self.vendor_name.encode()[:31],
            self.model_name.encode()[:31],
            self.software_version.encode()[:23],
            b"",
            b"",
        )
        frame: bytes = self._pack(mav, CRC_EXTRA, payload, force_mavlink1)
        return frame
