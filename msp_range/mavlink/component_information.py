"""COMPONENT_INFORMATION_BASIC (396), which pymavlink's dialects do not have yet.

Fields and their order on the wire as in MAVLink's common.xml; tests compute the checksum seed from that definition.
"""

import struct

from msp_range.mavlink.dialect import dialect

MESSAGE_ID = 396
CRC_EXTRA = 50
_WIRE = struct.Struct("<QII32s32s24s24s32s")


class ComponentInformationBasic(dialect.MAVLink_message):  # type: ignore[misc]
    """Vendor, model and version of this component as text; other fields are unknown."""

    id = MESSAGE_ID
    msgname = "COMPONENT_INFORMATION_BASIC"
    fieldnames = ("time_boot_ms", "vendor_name", "model_name", "software_version")
    ordered_fieldnames = (
        "capabilities",
        "time_boot_ms",
        "time_manufacture_s",
        "vendor_name",
        "model_name",
        "software_version",
        "hardware_version",
        "serial_number",
    )
    array_lengths = (0, 0, 0, 32, 32, 24, 24, 32)
    lengths = (1,) * len(ordered_fieldnames)
    unpacker = _WIRE
    crc_extra = CRC_EXTRA
    instance_field = None
    instance_offset = -1
    capabilities = time_manufacture_s = 0
    hardware_version = serial_number = b""

    def __init__(self, time_boot_ms: int, vendor_name: str, model_name: str, software_version: str) -> None:
        super().__init__(MESSAGE_ID, self.msgname)
        self._fieldnames = self.fieldnames
        self._instance_field = self.instance_field
        self._instance_offset = self.instance_offset
        self.time_boot_ms = time_boot_ms
        self.vendor_name = vendor_name.encode()[:31]
        self.model_name = model_name.encode()[:31]
        self.software_version = software_version.encode()[:23]
