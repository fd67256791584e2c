"""Frames in bytes of every kind, against pymavlink, and what crafted bytes can cost."""

import random

import pymavlink.dialects.v20.ardupilotmega as ardupilotmega
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from msp_range.mavlink import frames as module
from msp_range.mavlink.frames import FrameReader
from tests.support.mavlink_ends import Component

ATTITUDE = common.MAVLink_attitude_message(1000, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)

MAX_FRAME_BYTES = 280
"""MAVLink 2 with the longest payload and a signature."""


def texts(version: int, signed: bool) -> list[bytes]:
    """Three frames of different lengths."""
    mav = common.MAVLink(None, srcSystem=1, srcComponent=191)
    if signed:
        mav.signing.secret_key = bytes(32)
        mav.signing.link_id = 0
        mav.signing.timestamp = 1
        mav.signing.sign_outgoing = True
    return [
        common.MAVLink_statustext_message(6, b"x" * length).pack(mav, force_mavlink1=version == 1)
        for length in (1, 3, 50)
    ]


@pytest.mark.parametrize(("version", "signed"), [(1, False), (2, False), (2, True)])
def test_frames_are_found_whole_however_they_are_cut(version: int, signed: bool) -> None:
    sent = texts(version, signed)
    stream = b"".join(sent)
    ends = [sum(map(len, sent[:count])) for count in range(len(sent) + 1)]
    for split in range(len(stream) + 1):
        reader = FrameReader()
        first = reader.read(stream[:split])
        assert sum(len(frame.data) for frame in first) == max(end for end in ends if end <= split)
        assert [frame.data for frame in first + reader.read(stream[split:])] == sent
        assert reader._incomplete == b""


def test_a_frame_shows_what_it_is_and_who_sent_it() -> None:
    for mavlink1 in (False, True):
        (frame,) = FrameReader().read(Component(7, 154).frame(ATTITUDE, mavlink1=mavlink1))
        assert frame[:3] == (common.MAVLINK_MSG_ID_ATTITUDE, 7, 154)


@pytest.mark.parametrize("mavlink1", [False, True])
@pytest.mark.parametrize(
    ("component", "autopilot", "expected"), [(1, 3, True), (1, 12, True), (1, 0, True), (1, 8, False), (190, 3, False)]
)
def test_an_autopilots_heartbeat_is_known_by_component_and_field(
    component: int, autopilot: int, expected: bool, mavlink1: bool
) -> None:
    beat = common.MAVLink_heartbeat_message(2, autopilot, 0, 0x08080808, 4, 3)
    (frame,) = FrameReader().read(Component(1, component).frame(beat, mavlink1=mavlink1))
    assert frame.is_autopilot_heartbeat is expected
    (frame,) = FrameReader().read(Component(1, component).frame(ATTITUDE, mavlink1=mavlink1))
    assert not frame.is_autopilot_heartbeat


@pytest.mark.parametrize("version", [1, 2])
def test_a_frame_with_any_bit_wrong_is_none(version: int) -> None:
    whole = texts(version, False)[1]
    for bit in range(8 * len(whole)):
        broken = bytearray(whole)
        broken[bit // 8] ^= 1 << bit % 8
        assert FrameReader().read(bytes(broken)) == []


def test_a_frame_with_a_flag_that_is_not_known_is_none() -> None:
    """The checksum is good, but nobody knows what the flag means."""
    mav = common.MAVLink(None, 7, 1)
    for flag in range(1, 8):
        body = bytes([0xFD, 28, 1 << flag, *ATTITUDE.pack(mav)[3:-2]])
        checksum = common.x25crc(body[1:] + bytes([ATTITUDE.crc_extra])).crc
        assert FrameReader().read(body + checksum.to_bytes(2, "little")) == []


def test_a_frame_that_begins_inside_a_false_one_is_found() -> None:
    beat = Component(7).heartbeat()
    for false_start in (b"\xfd\xff\x00", b"\xfe\xff", b"\xfd\x40\x01"):
        reader = FrameReader()
        found = reader.read(false_start + beat * 14)
        assert [frame.data for frame in found] == [beat] * 14


def test_frames_of_another_dialect_are_passed_over_whole() -> None:
    autopilot = Component(7, dialect=ardupilotmega)
    unknown = autopilot.frame(ardupilotmega.MAVLink_rangefinder_message(1.0, 2.0))
    beat = autopilot.heartbeat()
    assert [frame.data for frame in FrameReader().read(unknown + beat + unknown + beat + unknown)] == [beat] * 2


@given(st.lists(st.one_of(st.binary(max_size=60), st.just(Component(7).heartbeat()), st.just(b"\xfd\xff\x00"))))
def test_pymavlink_agrees_that_what_is_found_is_a_frame(chunks: list[bytes]) -> None:
    reader = FrameReader()
    for chunk in chunks:
        for frame in reader.read(chunk):
            message = common.MAVLink(None).decode(bytearray(frame.data))
            assert (message.get_msgId(), message.get_srcSystem(), message.get_srcComponent()) == frame[:3]
        assert len(reader._incomplete) < MAX_FRAME_BYTES


@pytest.mark.parametrize("version", [1, 2])
def test_every_message_is_decoded_as_pymavlink_does(version: int) -> None:
    draw = random.Random(1)
    packer = common.MAVLink(None, srcSystem=7, srcComponent=1)
    for message_id, kind in common.mavlink_map.items():
        if version == 1 and message_id > 255:
            continue
        for length in (kind.unpacker.size, draw.randrange(1, kind.unpacker.size + 1)):
            payload = draw.randbytes(length)
            data = common.MAVLink_message(message_id, kind.msgname)._pack(packer, kind.crc_extra, payload, version == 1)
            [frame] = FrameReader().read(data)
            ours, theirs = frame.decode()._asdict(), common.MAVLink(None).decode(bytearray(data))
            assert (ours.pop("msgname"), frame.system, frame.component) == (kind.msgname, 7, 1)
            assert ours.keys() == set(kind.fieldnames)
            for name, value in ours.items():
                expected = getattr(theirs, f"_{name}_raw", getattr(theirs, name))
                if isinstance(value, bytes):
                    value, expected = value.rstrip(b"\0"), expected.rstrip(b"\0")
                # As text, in which a not-a-number is equal to itself.
                assert str(value) == str(tuple(expected) if isinstance(expected, list) else expected)


CRAFTED = {
    "false long frames": (b"\xfd\xff\x00" + bytes(264)) * 31,
    "good frames": Component(7).frame(ATTITUDE) * 205,
    "starts only": b"\xfd" * 8192,
    "short false starts": b"\xfd\x00\x00" * 2731,
    "version 1 starts": b"\xfe\x09\x1e" * 2731,
    "overlapping headers": (b"\xfd\xff\x00" + bytes(4) + b"\x1e\0\0") * 820,
    "noise": random.Random(1).randbytes(8192),
}
"""What ends inside a frame, or seems to, once it is cut to 8191 bytes."""


@pytest.mark.parametrize("kind", CRAFTED)
def test_crafted_bytes_make_no_buffer_grow(kind: str) -> None:
    """16 MB of false long frames were 16 MB of buffer."""
    reader = FrameReader()
    content = CRAFTED[kind][:8191]
    for _ in range(200):
        reader.read(content)
        assert len(reader._incomplete) < MAX_FRAME_BYTES


@pytest.mark.parametrize("kind", CRAFTED)
def test_crafted_bytes_cost_little_more_than_frames_do(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A false start each few bytes, each of a long frame, would be a checksum over 267 bytes each few bytes."""
    checked: list[int] = []
    real = module.mcrf4xx

    def counted(covered: bytes) -> int:
        checked.append(len(covered))
        return real(covered)

    monkeypatch.setattr(module, "mcrf4xx", counted)
    content = CRAFTED[kind][:8191]
    FrameReader().read(content)
    assert sum(checked) <= len(content) + module.MAX_FALSE_STARTS * MAX_FRAME_BYTES
    assert len(checked) <= len(content) / 8 + module.MAX_FALSE_STARTS
