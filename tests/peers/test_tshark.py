"""Wireshark's tshark takes the bridge's bytes apart, with the dissector that pymavlink's generator writes for it."""

import ipaddress
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pymavlink.dialects.v20
import pytest

from tests.support.kernel_bus import kernel_bus
from tests.support.service import VARIED, Arrived, LinkEnd, missing, running_service

PORT = 14550
"""The generated dissector listens here."""
DEFINITIONS = Path(pymavlink.dialects.v20.__path__[0]) / "common.xml"
LINKTYPE_IPV4 = 228
PROTOCOL_UDP = 17
QUATERNION = [f"quaternion_{i}" for i in range(4)]


@pytest.fixture(scope="module")
def dissector(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("tshark") is None:
        missing("no tshark, Debian's package of that name: apt-get install tshark")
    lua = tmp_path_factory.mktemp("wireshark") / "mavlink.lua"
    generator = [sys.executable, "-m", "pymavlink.tools.mavgen", "--lang", "WLua", "--wire-protocol", "2.0"]
    subprocess.run([*generator, "-o", lua, DEFINITIONS], check=True, stdout=subprocess.DEVNULL)
    return lua


def test_tshark_reads_every_field(dissector: Path, tmp_path: Path) -> None:
    with (
        kernel_bus(VARIED) as testbed,
        LinkEnd() as end,
        running_service(testbed, end.url, tmp_path) as service,
    ):
        end.run_until(lambda: len(end.distances) >= 16)
        assert service.stop() == 0
    capture = tmp_path / "flight.pcap"
    write_capture(capture, end.arrived)

    names = [name for name in end.distances[0] if name != "quaternion"] + QUATERNION
    rows = dissect(dissector, capture, [f"DISTANCE_SENSOR_{name}" for name in names])
    read = [dict(zip(names, map(float, row), strict=True)) for row in rows if row[0]]
    sent = [
        {
            **{name: each[name] for name in names if name in each},
            **dict(zip(QUATERNION, each["quaternion"], strict=True)),
        }
        for each in end.distances
    ]
    # Text of single precision has at least six digits.
    assert [pytest.approx(each, rel=1e-5, abs=1e-9) for each in sent] == read

    headers = dissect(dissector, capture, ["magic", "sequence", "sysid", "compid", "msgid"])
    assert [[int(value, 0) for value in row] for row in headers] == [
        [253, number, 1, 191, each.message.get_msgId()] for number, each in enumerate(end.arrived)
    ]


def dissect(dissector: Path, capture: Path, fields: list[str]) -> list[list[str]]:
    """Values of the dissector's fields, one row a packet."""
    wanted = [option for field in fields for option in ("-e", f"mavlink_proto.{field}")]
    ended = subprocess.run(
        ["tshark", "-n", "-X", f"lua_script:{dissector}", "-r", capture, "-T", "fields", *wanted],
        capture_output=True,
        text=True,
        check=True,
    )
    return [line.split("\t") for line in ended.stdout.splitlines()]


def write_capture(path: Path, arrived: list[Arrived]) -> None:
    """The datagrams as a capture of IPv4 packets (pcap 2.4)."""
    records = [struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, LINKTYPE_IPV4)]
    for each in arrived:
        packet = ip_packet(each.frame)
        seconds, microseconds = divmod(round(each.time_s * 1e6), 1_000_000)
        records.append(struct.pack("<IIII", seconds, microseconds, len(packet), len(packet)) + packet)
    path.write_bytes(b"".join(records))


def ip_packet(payload: bytes) -> bytes:
    """IPv4 and UDP around a payload, without checksums, which tshark does not ask for."""
    address: Any = ipaddress.IPv4Address("127.0.0.1").packed
    udp = struct.pack(">HHHH", 40000, PORT, 8 + len(payload), 0) + payload
    return struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + len(udp), 0, 0, 64, PROTOCOL_UDP, 0, address, address) + udp
