"""MAVProxy, without a screen, receives what the bridge sends; its own log and its own words say so."""

import ast
import os
import re
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.peers import mavproxy_env
from tests.support.kernel_bus import kernel_bus
from tests.support.mavlink_ends import read_distance_sensor
from tests.support.service import VARIED, Autopilot, LinkEnd, missing, running_service
from tests.support.transports import free_port
from tests.support.waiting import LIMIT_S


@pytest.fixture(autouse=True)
def environment() -> None:
    if not mavproxy_env.is_made():
        missing("MAVProxy has no environment of its own: make mavproxy")


def test_mavproxy_logs_and_shows_every_field(tmp_path: Path) -> None:
    screen_file, log_file = tmp_path / "screen.txt", tmp_path / "flight.tlog"
    port = free_port(socket.SOCK_DGRAM)
    arguments: list[str | Path] = [
        *(mavproxy_env.PYTHON, "-u", mavproxy_env.MAVPROXY),
        *(f"--master=udp:127.0.0.1:{port}", "--default-modules=", "--source-system=250"),
        *(f"--state-basedir={tmp_path}", f"--logfile={log_file}", "--cmd=set flushlogs True"),
    ]
    with (
        kernel_bus(VARIED) as testbed,
        LinkEnd(autopilot=Autopilot(), passes_on_to=port) as end,
        screen_file.open("w") as screen,
        subprocess.Popen(
            arguments,
            stdin=subprocess.PIPE,
            stdout=screen,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=tmp_path,
            env={**os.environ, "HOME": str(tmp_path)},
        ) as mavproxy,
    ):
        assert mavproxy.stdin is not None
        try:
            end.run_until(lambda: "online system 1" in screen_file.read_text())
            with running_service(testbed, end.url, tmp_path) as service:
                end.run_until(lambda: len(end.distances) >= 16)
                assert service.stop() == 0
            end.run_until(lambda: len(end.arrived) >= service.log()[-1]["frames"]["sent"])

            def has_shown_all() -> bool:
                assert mavproxy.stdin is not None
                mavproxy.stdin.write("status DISTANCE_SENSOR\n")
                mavproxy.stdin.flush()
                end.run_for(0.1)
                return bool(shown(screen_file)) and int(shown(screen_file)[-1][0]) >= len(end.distances)

            end.run_until(has_shown_all)
            end.run_until(lambda: len(logged(log_file)) >= len(end.distances))
            mavproxy.terminate()
            mavproxy.stdin.close()
            mavproxy.wait(LIMIT_S)
        finally:
            mavproxy.kill()

    assert logged(log_file) == end.distances
    count, words = shown(screen_file)[-1]
    assert int(count) == len(end.distances)
    assert fields_of(words) == end.distances[-1]


def shown(screen_file: Path) -> list[tuple[str, str]]:
    """How many DISTANCE_SENSOR it reports to have had, and the fields of the last, each time that it was asked."""
    return re.findall(r"(\d+): DISTANCE_SENSOR \{(.*)\}\n", screen_file.read_text())


def logged(log_file: Path) -> list[dict[str, Any]]:
    """DISTANCE_SENSOR in a telemetry log."""
    read = [read_distance_sensor(frame) for frame in frames_of(log_file.read_bytes()) if frame[0] == 0xFD]
    return [each for each in read if each is not None]


def frames_of(log: bytes) -> Iterator[bytes]:
    """Frames of a telemetry log, in which each follows eight bytes of time."""
    start = 8
    while start + 1 < len(log):
        end = start + log[start + 1] + (12 if log[start] == 0xFD else 8)
        if end <= len(log):
            yield log[start:end]
        start = end + 8


def fields_of(words: str) -> dict[str, Any]:
    """Fields of a message as pymavlink writes it: ``name : value, name : value``."""
    return {name: ast.literal_eval(value) for name, value in re.findall(r"(\w+) : (\[.*?\]|[^,]+)", words)}
