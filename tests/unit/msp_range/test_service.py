"""The service around the bridge: systemd's watchdog, an end by a signal."""

import io
import json
import os
import signal
import socket
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from msp_range import service
from msp_range.bus.smbus import KernelBus
from msp_range.clock import SystemClock
from msp_range.log import Log
from msp_range.replay import Nowhere
from msp_range.service import serve, stop_signals, transfers_watched
from tests.support.bench import Bench, airframe
from tests.support.service import COMMAND
from tests.support.waiting import LIMIT_S


def test_completed_turns_of_the_loop_feed_the_watchdog(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    messages: list[str] = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        bench = Bench(airframe(), 300)
        step = bench.bridge.step

        def receive() -> None:
            with suppress(BlockingIOError):
                while True:
                    messages.append(systemd.recv(100).decode())

        def step_or_end() -> list[object]:
            """Work, then turn without getting anything done, then end."""
            receive()
            if bench.now() > 4.5:
                os.kill(os.getpid(), signal.SIGTERM)
            if bench.now() > 2.5:
                bench.clock.sleep_until(bench.clock.now() + 0.002)
                return []
            return list(step())

        monkeypatch.setattr(bench.bridge, "step", step_or_end)
        with stop_signals() as stopped:
            serve(bench.bridge, bench.clock, Log("json", io.StringIO()), Nowhere(), stopped)
        receive()
    assert [messages[0], messages[-1]] == ["READY=1", "STOPPING=1"]
    assert set(messages[1:-1]) == {"WATCHDOG=1"}
    # Five times a second, a little less where a transfer is due at that moment, and only for as long as it works.
    assert 10 <= len(messages[1:-1]) <= 13


def test_why_it_cannot_start_is_a_status_of_systemd(tmp_path: Path) -> None:
    path = tmp_path / "airframe.yaml"
    path.write_text("vehicle: a\ncolour: red\n")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        environment = {**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify")}
        done = subprocess.run([COMMAND, "run", path], env=environment, capture_output=True, text=True, timeout=LIMIT_S)
        assert done.returncode == 3
        systemd.settimeout(LIMIT_S)
        assert systemd.recv(4096).decode() == f"STATUS={' '.join(done.stderr.split())}"
    assert "colour" in done.stderr


@pytest.mark.parametrize(
    ("in_transfer", "longest_s", "fed", "reports"),
    [
        pytest.param(True, 10.0, range(3, 8), range(1, 4), id="a transfer that takes long"),
        pytest.param(True, 0.6, range(1, 3), range(1, 4), id="one that never ends"),
        pytest.param(False, 10.0, range(1), range(1), id="a hang elsewhere"),
    ],
)
def test_only_a_transfer_keeps_the_watchdog_fed_and_not_for_ever(
    in_transfer: bool, longest_s: float, fed: range, reports: range, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, bus, reported = SystemClock(), KernelBus(str(tmp_path / "none")), []
    bridge: Any = SimpleNamespace(completed_s=clock.now(), on_stuck_transfer=lambda: reported.append(clock.now()))
    monkeypatch.setattr(service, "LONGEST_TRANSFER_S", longest_s)
    messages = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        with transfers_watched(bridge, bus, clock):
            if in_transfer:
                bus.waiting.release()
            time.sleep(1.9)
            if in_transfer:
                bus.waiting.acquire()
        with suppress(BlockingIOError):
            while True:
                messages.append(systemd.recv(100))
    assert set(messages) <= {b"WATCHDOG=1"}
    assert (len(messages) in fed, len(reported) in reports) == (True, True), (messages, reported)


def test_the_log_has_each_change_of_the_link_and_each_minute_whether_the_vehicle_is_armed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bench, log, link = Bench(airframe(), 300), io.StringIO(), Nowhere()

    def idle_or_end() -> list[object]:
        if bench.now() > 190.0:
            os.kill(os.getpid(), signal.SIGTERM)
        if bench.now() > 100.0:
            bench.bridge.link.autopilot_armed = True
            monkeypatch.setattr(link, "connected", False)
            monkeypatch.setattr(link, "last_error", "cable out")
        bench.clock.sleep_until(bench.clock.now() + 0.05)
        return []

    monkeypatch.setattr(bench.bridge, "step", idle_or_end)
    with stop_signals() as stopped:
        serve(bench.bridge, bench.clock, Log("json", log), link, stopped)
    lines = [json.loads(each) for each in log.getvalue().splitlines()]
    assert [(each["event"], each["level"], each.get("error")) for each in lines] == [
        ("link", "info", None),
        ("still running", "info", None),
        ("link", "warning", "cable out"),
        ("still flying", "info", None),
        ("still flying", "info", None),
        ("stopped by signal", "info", None),
    ]


def test_a_critical_state_is_a_warning_in_the_log() -> None:
    bench, lines = Bench(airframe(), 300), io.StringIO()
    log = service._LinkLog(bench.bridge, Nowhere(), Log("json", lines))
    bench.fly(7.0)  # without an autopilot
    log.update()
    critical = [json.loads(each) for each in lines.getvalue().splitlines() if '"critical"' in each]
    assert [(each["level"], "no autopilot" in each["reasons"][0]) for each in critical] == [("warning", True)]
