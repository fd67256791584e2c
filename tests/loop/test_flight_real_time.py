"""A flight on the system's clock, with a listener on a real link."""

import json
import socket
import threading
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from msp_range.clock import SystemClock
from tests.support.programs import run
from tests.support.shipped import CONFIGS


def receive(listener: socket.socket, ended: threading.Event, received: list[Any]) -> None:
    """Parse what arrives until the flight has ended and nothing more is there."""
    parser = common.MAVLink(None)
    while True:
        was_over = ended.is_set()
        try:
            received += parser.parse_buffer(listener.recv(65535)) or []
        except TimeoutError:
            if was_over:
                return


@pytest.mark.real_time
def test_a_flight_in_real_time(tmp_path: Path) -> None:
    """Five seconds on the system's clock, with a listener on a real link: 10 Hz, and the truth."""
    short = tmp_path / "short.yaml"
    altitude = "[{kind: hold, duration_s: 1}, {kind: climb, to_m: 1.5}]"
    short.write_text(
        f"name: short\nairframe: {CONFIGS}/quad_pallet.yaml\nduration_s: 5\nflight: {{altitude: {altitude}}}\n"
    )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(0.1)
        url = f"udpout:127.0.0.1:{listener.getsockname()[1]}"
        started_s = SystemClock().now()
        received: list[Any] = []
        ended = threading.Event()
        with ThreadPoolExecutor(1) as reader:
            reading = reader.submit(receive, listener, ended, received)
            try:
                run("msp-sim fly --realtime", short, "--link", url, "--out", tmp_path / "f")
            finally:
                ended.set()
            assert SystemClock().now() - started_s >= 5
            reading.result()
    distances = [m for m in received if m.get_type() == "DISTANCE_SENSOR" and m.get_srcComponent() == 191]
    heartbeats = {(m.get_srcSystem(), m.get_srcComponent()) for m in received if m.get_type() == "HEARTBEAT"}
    assert heartbeats == {(1, 1), (1, 191)}
    # 50 on an idle computer; a busy one lets some go, and the rest keep their time.
    assert len(distances) >= 25
    times_ms = [each.time_boot_ms for each in distances]
    assert median(after - before for before, after in pairwise(times_ms)) == pytest.approx(100, abs=20)
    summary = json.loads((tmp_path / "f" / "summary.json").read_text())
    assert summary["fused"]["error"]["p95_cm"] < 6
