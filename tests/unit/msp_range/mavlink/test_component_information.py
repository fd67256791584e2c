"""COMPONENT_INFORMATION_BASIC against MAVLink's definition of it, worked out by pymavlink's own generator."""

import struct
from pathlib import Path
from typing import Any

import pytest
from pymavlink.generator import mavparse

from msp_range import __version__
from msp_range.mavlink import component_information
from msp_range.mavlink.component_information import ComponentInformationBasic
from tests.support.mavlink_ends import Component

# MAVLink's common.xml, without the descriptions.
DEFINITION = """<?xml version="1.0"?>
<mavlink>
  <messages>
    <message id="396" name="COMPONENT_INFORMATION_BASIC">
      <description/>
      <field type="uint32_t" name="time_boot_ms" units="ms"/>
      <field type="uint64_t" name="capabilities"/>
      <field type="uint32_t" name="time_manufacture_s" units="s"/>
      <field type="char[32]" name="vendor_name"/>
      <field type="char[32]" name="model_name"/>
      <field type="char[24]" name="software_version"/>
      <field type="char[24]" name="hardware_version"/>
      <field type="char[32]" name="serial_number"/>
    </message>
  </messages>
</mavlink>
"""
STRUCT_LETTERS = {"uint64_t": "Q", "uint32_t": "I"}


@pytest.fixture(scope="module")
def definition(tmp_path_factory: pytest.TempPathFactory) -> Any:
    path: Path = tmp_path_factory.mktemp("definition") / "basic.xml"
    path.write_text(DEFINITION)
    parsed = mavparse.MAVXML(str(path), wire_protocol_version="2.0")
    mavparse.check_duplicates([parsed])
    (message,) = parsed.message
    return message


def wire_of(definition: Any) -> struct.Struct:
    letters = [f"{f.array_length}s" if f.array_length else STRUCT_LETTERS[f.type] for f in definition.ordered_fields]
    return struct.Struct("<" + "".join(letters))


def payload_of(frame: bytes, length: int) -> bytes:
    assert int.from_bytes(frame[7:10], "little") == 396
    return frame[10 : 10 + frame[1]].ljust(length, b"\0")


def test_checksum_seed_is_that_of_the_definition(definition: Any) -> None:
    assert mavparse.message_checksum(definition) == component_information.CRC_EXTRA
    assert definition.id == component_information.MESSAGE_ID


def test_fields_lie_where_the_definition_puts_them(definition: Any) -> None:
    wire = wire_of(definition)
    assert wire.size == definition.wire_length
    frame = Component(7, 191).frame(ComponentInformationBasic(0x01020304))
    texts = dict(zip(definition.ordered_fieldnames, wire.unpack(payload_of(frame, wire.size)), strict=True))
    assert texts.pop("time_boot_ms") == 0x01020304
    assert texts.pop("capabilities") == texts.pop("time_manufacture_s") == 0
    assert {name: text.rstrip(b"\0") for name, text in texts.items()} == {
        "vendor_name": b"msp-range",
        "model_name": b"range finder bridge",
        "software_version": __version__.encode(),
        "hardware_version": b"",
        "serial_number": b"",
    }


def test_a_long_version_is_cut_and_stays_terminated(definition: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(component_information, "__version__", "1" * 40)
    wire = wire_of(definition)
    frame = Component(7, 191).frame(ComponentInformationBasic(0))
    texts = dict(zip(definition.ordered_fieldnames, wire.unpack(payload_of(frame, wire.size)), strict=True))
    assert texts["software_version"] == b"1" * 23 + b"\0"
