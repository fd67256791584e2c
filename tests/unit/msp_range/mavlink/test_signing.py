"""MAVLink signing against pymavlink's own: what the bridge signs it accepts, and what it signs the bridge accepts."""

import hashlib
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega

from msp_range.clock import VirtualClock
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.frames import FrameReader
from msp_range.mavlink.link import Link
from msp_range.mavlink.signing import (
    EPOCH_S,
    RESERVED_UNITS,
    UNITS_PER_S,
    Signing,
    read_key,
    signing_of,
)
from msp_range.params.keys import make
from msp_range.yaml_file import ConfigError
from tests.support.known import known
from tests.support.mavlink_ends import Component, MemoryTransport
from tests.support.parameter_autopilot import ParameterAutopilot
from tests.support.shipped import CONFIGS, write_airframe
from tests.support.transports import free_port
from tests.support.waiting import LIMIT_S, until

PASSPHRASE = "a passphrase"
KEY = hashlib.sha256(PASSPHRASE.encode()).digest()
NOW_S = EPOCH_S + 3.6e8
NOW = round(3.6e8 * UNITS_PER_S)


def peer(key: bytes = KEY, timestamp: int = NOW) -> Any:
    """pymavlink as an autopilot that signs, and accepts nothing that is not signed."""
    mav = ardupilotmega.MAVLink(None, 1, 1)
    mav.robust_parsing = True
    mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = key, True, timestamp
    return mav


UNSIGNED = ardupilotmega.MAVLink(None, 1, 1)


def heartbeat(mav: Any, mavlink1: bool = False) -> bytes:
    frame: bytes = ardupilotmega.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(mav, force_mavlink1=mavlink1)
    return frame


@pytest.fixture
def key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A key, in the folder in which the signing time is kept."""
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    make(tmp_path / "key", PASSPHRASE)
    return tmp_path / "key"


def our_heartbeat(signing: Signing | None = None) -> bytes:
    mav = ardupilotmega.MAVLink(None, 1, 191)
    if signing is not None:
        signing.sign_next(mav)
    frame: bytes = ardupilotmega.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(mav)
    return frame


class Linked:
    """A link in memory; it signs unless the keeper of its key is None."""

    def __init__(self, signs: bool = True, keep: Callable[[int], None] = lambda timestamp: None, **more: Any) -> None:
        self.transport, self.clock = MemoryTransport(), VirtualClock(NOW_S)
        signing = Signing(KEY, self.clock, keep=keep) if signs else None
        self.link = Link(
            self.transport, self.clock, component_id=191, on_message=lambda *_: None, wanted={}, signing=signing, **more
        )

    def receive(self, frame: bytes = b"") -> None:
        """Let a frame arrive."""
        self.transport.arrived += frame
        self.link.service()

    @property
    def texts(self) -> list[str]:
        """What it reports."""
        return [each.text for each in self.link.conditions() if each.text]


def received(frame: bytes) -> Any:
    (found,) = FrameReader().read(frame)
    return found


def test_pymavlink_accepts_what_is_signed() -> None:
    signing = Signing(KEY, VirtualClock(NOW_S))
    autopilot = peer()
    for _ in range(3):
        (message,) = autopilot.parse_buffer(our_heartbeat(signing))
        assert message.get_type() == "HEARTBEAT"
        assert message.get_signed()
    (wrong,) = peer(b"x" * 32).parse_buffer(our_heartbeat(signing))
    assert wrong.get_type() == "BAD_DATA"
    (unsigned,) = autopilot.parse_buffer(our_heartbeat())
    assert unsigned.get_type() == "BAD_DATA"


def test_what_pymavlink_signs_is_accepted_once() -> None:
    signing = Signing(KEY, VirtualClock(NOW_S))
    frame = received(heartbeat(peer()))
    assert frame.is_signed
    assert signing.accepts(frame)
    assert not signing.accepts(frame), "the same frame again, as somebody would send it who has recorded it"
    assert signing.verified == 1


def test_what_is_not_signed_with_the_key_is_refused() -> None:
    signing = Signing(KEY, VirtualClock(NOW_S))
    good = heartbeat(peer())
    assert not signing.accepts(received(our_heartbeat()))
    assert not signing.accepts(received(heartbeat(peer(b"x" * 32))))
    assert not signing.accepts(received(good[:-1] + bytes((good[-1] ^ 1,))))
    assert not signing.accepts(received(heartbeat(UNSIGNED, mavlink1=True)))
    assert signing.verified == 0


def test_a_frame_of_mavlink_1_is_never_signed_whatever_its_sequence_number() -> None:
    """Its sequence number stands where a frame of MAVLink 2 has the flag."""
    mav = ardupilotmega.MAVLink(None, 1, 1)
    for sequence in range(4):
        mav.seq = sequence
        assert not received(heartbeat(mav, mavlink1=True)).is_signed


def test_a_key_in_the_airframe_lets_nothing_in_that_is_not_signed(key: Path) -> None:
    unsigned = received(our_heartbeat())
    clock = VirtualClock(NOW_S)
    strict, setting_up = (known(signing_of(str(key), clock, **each)) for each in ({}, {"accepts_unsigned": True}))
    assert not strict.accepts(unsigned)
    assert setting_up.accepts(unsigned)
    assert signing_of(None, clock) is None


def test_timestamps_begin_in_2015_as_the_standard_says() -> None:
    assert datetime(2015, 1, 1, tzinfo=UTC).timestamp() == EPOCH_S
    assert Signing(KEY, VirtualClock(EPOCH_S + 1.0)).timestamp() == 100_000


def test_a_sender_that_was_not_received_before_may_be_a_minute_behind() -> None:
    signing = Signing(KEY, VirtualClock(NOW_S))
    signing.timestamp()
    assert not signing.accepts(received(heartbeat(peer(timestamp=NOW - 61 * UNITS_PER_S))))
    assert signing.accepts(received(heartbeat(peer(timestamp=NOW - 59 * UNITS_PER_S))))


def test_timestamps_follow_the_one_that_is_ahead() -> None:
    signing = Signing(KEY, VirtualClock(NOW_S))
    assert signing.timestamp() == NOW
    assert signing.timestamp() == NOW + 1
    assert signing.accepts(received(heartbeat(peer(timestamp=NOW + 10 * UNITS_PER_S))))
    assert signing.timestamp() > NOW + 10 * UNITS_PER_S


def test_timestamps_rise_over_restarts_of_a_computer_without_a_clock(key: Path) -> None:
    """Each run starts at 1970, as a Raspberry Pi without a network does, and is killed after some time."""
    last = 0
    for run_s in (0.0, 5.0, 45.0, 200.0):
        clock = VirtualClock(0.0)
        signing = known(signing_of(str(key), clock))
        first = signing.timestamp()
        assert first > last
        for step in range(1, 101):
            clock.sleep_until(run_s * step / 100)
            last = signing.timestamp()
        until_kept(key.with_name("signing-time"), last)
    assert last < 4 * 2 * RESERVED_UNITS + 400 * UNITS_PER_S, "no farther ahead than the runs and their reserves"


def test_the_newest_time_is_kept_last_though_a_disk_was_slow_before() -> None:
    asked: list[int] = []
    kept: list[int] = []

    def keep(timestamp: int) -> None:
        asked.append(timestamp)
        if len(asked) == 1:
            time.sleep(0.5)
        kept.append(timestamp)

    clock = VirtualClock(NOW_S)
    signing = Signing(KEY, clock, keep=keep)
    for at_s in (0.0, 100.0, 200.0):
        clock.sleep_until(NOW_S + at_s)
        last = signing.timestamp()
        until(lambda: len(asked) > 0)
    until(lambda: len(kept) == 3)
    assert kept == sorted(kept)
    assert kept[-1] > last


def until_kept(path: Path, timestamp: int) -> None:
    """Wait for all threads that write: one of a run that has ended must not write into the next run's time."""
    until(lambda: all(each.name != "signing" for each in threading.enumerate()))
    assert int(path.read_text()) > timestamp


@pytest.mark.parametrize("timestamp", [2**48 - 2, 2**47])
def test_a_timestamp_that_no_clock_shows_does_not_end_signing(timestamp: int, key: Path) -> None:
    """The bridge followed it to the end of the six bytes, kept that, and could not start again."""
    for _ in range(2):
        signing = known(signing_of(str(key), VirtualClock(NOW_S)))
        assert not signing.accepts(received(heartbeat(peer(timestamp=timestamp))))
        last = signing.timestamp()
        assert NOW <= last < NOW + 3 * RESERVED_UNITS
        assert signing.accepts(received(heartbeat(peer(timestamp=last + 1))))
        until_kept(key.with_name("signing-time"), last)


@pytest.mark.parametrize("kept", ["", "x", "-5", str(2**48 - 2), str(2**90), "9" * 5000, b"\xff\xfe", None])
def test_a_damaged_time_is_replaced_by_the_clocks(kept: str | bytes | None, key: Path) -> None:
    if kept is None:
        os.mkfifo(key.with_name("signing-time"))
    else:
        (key.with_name("signing-time")).write_bytes(kept.encode() if isinstance(kept, str) else kept)
    for utc_s, first in ((NOW_S, NOW), (0.0, 1)):
        signing = known(signing_of(str(key), VirtualClock(utc_s)))
        (message,) = peer(timestamp=0).parse_buffer(our_heartbeat(signing))
        assert message.get_type() == "HEARTBEAT"
        assert signing.timestamp() == first + 1
        for thread in threading.enumerate():
            if thread.name == "signing":  # which keeps the time
                thread.join(LIMIT_S)
        assert int((key.with_name("signing-time")).read_text()) > first
        (key.with_name("signing-time")).write_text("damaged again")


def test_a_date_that_no_clock_shows_is_not_followed() -> None:
    """A real-time clock whose battery is empty may show any year."""
    signing = Signing(KEY, VirtualClock(EPOCH_S + 2**48 / UNITS_PER_S), kept=NOW)
    assert signing.timestamp() == NOW + 1
    assert len(our_heartbeat(signing)) > len(our_heartbeat())


def test_a_disk_that_keeps_nothing_is_reported_and_no_reason_not_to_sign() -> None:
    def keep(timestamp: int) -> None:
        raise OSError(28, os.strerror(28))

    linked = Linked(keep=keep)
    linked.receive()
    until(lambda: any("signing time" in each for each in linked.texts))
    assert peer().parse_buffer(linked.transport.frames[0])[0].get_type() == "HEARTBEAT"


def test_a_link_with_a_key_ignores_what_is_not_signed_and_says_so() -> None:
    linked = Linked()
    linked.receive(heartbeat(UNSIGNED))
    assert not linked.link.autopilot_is_present
    assert "Range: autopilot does not sign with this key" in linked.texts
    linked.receive(heartbeat(peer()))
    assert linked.link.autopilot_is_present
    assert "Range: autopilot signs, signing_key is missing" not in linked.texts
    assert all(received(frame).is_signed for frame in linked.transport.frames)


def test_a_program_with_the_bridges_ids_and_without_its_key_is_reported() -> None:
    linked = Linked()
    for _ in range(3):
        linked.receive(Component(1, 191).heartbeat())
        linked.clock.sleep_until(linked.clock.now() + 1.0)
    assert "Range: another program sends as 1/191" in linked.texts


@pytest.mark.parametrize(
    ("autopilot", "remedy"),
    [("ardupilot", "gives both the same key"), ("px4", "PX4 1.17 has no MAVLink signing: take link.signing_key out")],
)
def test_a_running_bridge_says_what_to_do_about_an_autopilot_that_does_not_sign(
    autopilot: Autopilot, remedy: str
) -> None:
    linked = Linked(autopilot=autopilot)
    linked.receive(heartbeat(UNSIGNED))
    (found,) = [each for each in linked.link.conditions() if each.text and "does not sign" in each.text]
    assert remedy in found.remedy


def test_a_link_without_a_key_says_that_the_autopilot_has_one() -> None:
    linked = Linked(signs=False)
    linked.receive(heartbeat(peer()))
    assert linked.link.autopilot_is_present
    assert linked.texts == ["Range: autopilot signs, signing_key is missing"]
    assert len(linked.texts[0]) <= 50


def test_a_key_that_others_may_read_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "key"
    make(path, PASSPHRASE)
    assert path.stat().st_mode & 0o777 == 0o600
    assert read_key(path) == KEY
    path.chmod(0o640)
    with pytest.raises(ConfigError, match="found mode 640; expected 600"):
        read_key(path)
    path.chmod(0o600)
    with pytest.raises(ConfigError, match="File exists"):
        make(path, PASSPHRASE)
    for wrong in ("", "abc", "zz" * 32, "00" * 31, "ä" * 64):
        path.write_text(wrong)
        with pytest.raises(ConfigError, match="expected 64 hexadecimal digits"):
            read_key(path)
    with pytest.raises(ConfigError, match="msp-range sign' makes the key"):
        read_key(tmp_path / "none")


def test_a_key_in_what_is_no_file_is_refused_at_once(tmp_path: Path) -> None:
    """Opening a pipe waited for a writer for ever, in the service as in the commands."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe, 0o600)
    for path, found in ((pipe, "a pipe"), (tmp_path, "a directory"), (Path("/dev/zero"), "a device")):
        with pytest.raises(ConfigError, match=f"{path}: found {found}, expected a file"):
            read_key(path)
    airframe = write_airframe(tmp_path, "loopback", ("\nlink:\n", f"\nlink:\n  signing_key: {pipe}\n"))
    done = msp_range("run", airframe, tmp_path)
    assert done.returncode == 3
    assert f"{pipe}: found a pipe, expected a file" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_command_says_that_px4_cannot_sign(tmp_path: Path) -> None:
    """It advised to clear the other key, which there is not."""
    port = free_port(socket.SOCK_DGRAM)
    link = f"\nlink:\n  signing_key: {tmp_path / 'key'}\n"
    airframe = write_airframe(tmp_path, "loopback", ("\nlink:\n", link), ("autopilot: ardupilot", "autopilot: px4"))
    with ParameterAutopilot(f"udpin:127.0.0.1:{port}", px4=True):
        done = msp_range("sign", airframe, tmp_path, "--link", f"udpout:127.0.0.1:{port}")
    assert done.returncode == 3
    assert "PX4 1.17 has no MAVLink signing: take link.signing_key out of the airframe file" in done.stderr
    assert "another key" not in done.stderr


def msp_range(verb: str, airframe: Path, folder: Path, *options: str) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", "from msp_range.cli import main; main()", verb, str(airframe), *options]
    environment = os.environ | {"STATE_DIRECTORY": str(folder)}
    return subprocess.run(command, capture_output=True, text=True, timeout=30.0, cwd=folder, env=environment)


def test_the_command_needs_a_place_for_the_key(tmp_path: Path) -> None:
    done = msp_range("sign", CONFIGS / "loopback.yaml", tmp_path)
    assert done.returncode == 3
    assert done.stderr.startswith("link.signing_key is missing; add it")
