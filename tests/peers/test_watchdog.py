"""`msp-range run` under a watchdog as systemd/msp-range.service sets it: what restarts the bridge and what does not."""

import configparser
import itertools
import resource
import signal
import socket
import struct
import threading
import time
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from msp_range.service import LONGEST_TRANSFER_S
from msp_sim.device.device import Fault
from tests.support.kernel_bus import Sonar, kernel_bus
from tests.support.service import FUSED_ID, Arrived, LinkEnd, running_service
from tests.support.waiting import without_processor_s

UNIT = Path(__file__).parents[2] / "systemd" / "msp-range.service"
KERNEL_TIMEOUT_S = 1.0
"""After which I2C drivers of the kernel give a transfer up [s]: the default of an adapter."""


def unit() -> configparser.SectionProxy:
    """The section Service of the unit file."""
    parser = configparser.ConfigParser(interpolation=None, strict=False)  # DeviceAllow is there twice
    parser.read(UNIT, encoding="utf-8")
    return parser["Service"]


_CREDENTIALS = struct.Struct("3i")
"""Process, user and group of a sender (unix(7))."""
WATCHDOG_S = float(unit()["WatchdogSec"])


class Systemd:
    """The end of the notification socket that systemd has: when READY=1 and WATCHDOG=1 came.

    Its times leave out in which the bridge could run and had no processor, so that a busy computer is no hang.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / "notify"
        self.fed_s: list[float] = []
        self._bridge = 0
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        self._socket.bind(str(self.path))
        self._thread = threading.Thread(target=self._receive, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Systemd":
        return self

    def __exit__(self, *_: object) -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as last:
            last.sendto(b"", str(self.path))
        self._thread.join()
        self._socket.close()

    def _receive(self) -> None:
        while (received := self._socket.recvmsg(100, socket.CMSG_SPACE(_CREDENTIALS.size)))[0]:
            state, ((_, _, sender), *_), *_ = received
            self._bridge = _CREDENTIALS.unpack(sender)[0]
            if state in (b"READY=1", b"WATCHDOG=1"):
                self.fed_s.append(self._now())

    def _now(self) -> float:
        with suppress(FileNotFoundError, ProcessLookupError):
            return time.monotonic() - without_processor_s(self._bridge)
        return time.monotonic()

    def waits_s(self) -> float:
        """Time since it was fed last [s]."""
        return self._now() - self.fed_s[-1] if self.fed_s else 0.0

    def longest_wait_s(self) -> float:
        """Longest time between two feeds so far [s]."""
        return max(after - before for before, after in itertools.pairwise(self.fed_s))


def locked_up(start_s: float, end_s: float) -> list[Sonar]:
    """Four sensors on a bus that is locked up for a while after it was first opened."""
    lock_up = Fault("locked_up", start_s, end_s)
    return [Sonar(0x70 + number, [250, 251], [lock_up] if number == 0 else []) for number in range(4)]


@pytest.mark.slow
def test_equipment_that_fails_does_not_restart_the_bridge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bus that locks up, a disk that is full and an autopilot that never speaks, all at once."""
    with (
        Systemd(tmp_path) as systemd,
        kernel_bus(locked_up(1.0, 3.5), timeout_s=KERNEL_TIMEOUT_S) as testbed,
        LinkEnd() as end,
    ):
        monkeypatch.setenv("NOTIFY_SOCKET", str(systemd.path))
        recordings = tmp_path / "recordings"

        def texts() -> list[str]:
            return [each.text for each in end.of("STATUSTEXT")]

        with running_service(testbed, end.url, tmp_path, "--record", str(recordings)) as service:
            end.run_until(lambda: len(end.distances) >= 2)
            resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, (4096, 4096))
            end.run_until(lambda: "Range: I2C bus works again" in texts())
            distances = len(end.distances)
            end.run_until(lambda: len(end.distances) >= distances + 2)
            assert service.stop() == 0
        assert any(text.startswith("Range: I2C bus locked up") for text in texts())
        assert any("recording" in text for text in texts())
        timeouts = [each for each in testbed.journal() if each.errno == 110]
        assert len(timeouts) >= 2
        assert systemd.longest_wait_s() < WATCHDOG_S


@pytest.mark.slow
def test_a_transfer_longer_than_the_watchdog_is_reported_and_does_not_restart_the_bridge(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An adapter that gives up after 3 s: systemd restarted the bridge for ever, and no text named the bus."""
    with (
        Systemd(tmp_path) as systemd,
        kernel_bus(locked_up(0.3, 60.0), timeout_s=3.0) as testbed,
        LinkEnd() as end,
    ):
        monkeypatch.setenv("NOTIFY_SOCKET", str(systemd.path))

        def about_the_bus() -> list[Arrived]:
            texts = [each for each in end.arrived if each.message.get_type() == "STATUSTEXT"]
            return [each for each in texts if "I2C bus" in each.message.text]

        def stuck_s() -> list[float]:
            return [each.time_s for each in testbed.journal() if each.errno == 110]

        with running_service(testbed, end.url, tmp_path) as service:
            end.run_until(lambda: bool(about_the_bus()) and len(stuck_s()) >= 3)
            assert service.stop() == 0
        assert [each.message.text for each in about_the_bus()] == ["Range: I2C bus locked up, transfer does not end"]
        assert about_the_bus()[0].time_s < stuck_s()[0] + 3.0, "before the transfer ended"
        assert systemd.longest_wait_s() < WATCHDOG_S


def test_an_adapter_that_is_not_there_does_not_restart_the_bridge(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Systemd(tmp_path) as systemd, kernel_bus([]) as testbed, LinkEnd() as end:
        monkeypatch.setenv("NOTIFY_SOCKET", str(systemd.path))
        with running_service(testbed, end.url, tmp_path, "--bus", "7") as service:
            end.run_until(lambda: any("no I2C bus" in each.text for each in end.of("STATUSTEXT")))
            end.run_until(lambda: len(end.of("HEARTBEAT")) >= 3)
            assert service.stop() == 0
        assert systemd.longest_wait_s() < WATCHDOG_S


@pytest.mark.slow
@pytest.mark.parametrize("ended", [True, False])
def test_a_hang_of_the_loop_is_seen(ended: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A driver that does not return: nobody feeds until it does, and whoever ends it reads where it hung."""
    with (
        Systemd(tmp_path) as systemd,
        kernel_bus([Sonar(0x70 + number) for number in range(4)], timeout_s=LONGEST_TRANSFER_S + 4.0) as testbed,
        LinkEnd() as end,
    ):
        monkeypatch.setenv("NOTIFY_SOCKET", str(systemd.path))
        with running_service(testbed, end.url, tmp_path) as service:
            end.run_until(lambda: len(systemd.fed_s) >= 5)
            testbed.time_out()
            end.run_until(lambda: systemd.waits_s() > WATCHDOG_S)
            if ended:
                assert service.stop(signal.SIGABRT) == -signal.SIGABRT
                assert "in _transfer" in (tmp_path / "log.jsonl").read_text()
            else:
                fed = len(systemd.fed_s)
                end.run_until(lambda: len(systemd.fed_s) >= fed + 5)
                assert service.stop() == 0


def _received(end: LinkEnd, count: int) -> bool:
    return len(end.distances) >= count


def test_killed_in_flight_it_starts_again_on_sensors_that_range(tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    with kernel_bus([Sonar(0x70 + number, [250, 251]) for number in range(4)]) as testbed, LinkEnd() as end:
        for flight in (1, 2):
            enough = len(end.distances) + 4
            with running_service(testbed, end.url, tmp_path, "--record", str(recordings)) as service:
                end.run_until(partial(_received, end, enough))
                assert service.stop(signal.SIGKILL) == -signal.SIGKILL
            assert len(list(recordings.glob("*.mcap"))) == flight
    assert {each["current_distance"] for each in end.distances if each["id"] == FUSED_ID} <= {249, 250, 251}


def test_what_systemd_restarts() -> None:
    service = unit()
    assert (service["Type"], service["Restart"], service["RestartSec"]) == ("notify", "always", "100ms")
    # A wrong command line and a file that cannot be used.
    assert service["RestartPreventExitStatus"] == "2 3"
