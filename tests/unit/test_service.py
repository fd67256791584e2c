"""The service around the bridge: systemd's watchdog, the name of a recording, an end by a signal."""

import io
import os
import signal
import socket
from pathlib import Path

import pytest

from msp_range.log import Log
from msp_range.mavlink.transport.base import Nowhere
from msp_range.service import open_recording, serve
from tests.support.bench import Bench, airframe


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning")
def test_systemd_hears_from_the_loop_that_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(0)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        bench = Bench(airframe(), 300)
        step = bench.bridge.step

        def step_or_end() -> list[object]:
            if bench.now() > 4.5:
                os.kill(os.getpid(), signal.SIGTERM)
            return list(step())

        monkeypatch.setattr(bench.bridge, "step", step_or_end)
        assert serve(bench.bridge, bench.clock, Log("json", io.StringIO()), Nowhere()) == 0
        told = [systemd.recv(100).decode() for _ in range(6)]
    assert told == ["READY=1", *["WATCHDOG=1"] * 4, "STOPPING=1"]


def test_a_recording_of_the_same_second_gets_a_name_of_its_own(tmp_path: Path) -> None:
    """A computer without a clock starts at the same time again and again."""
    bench = Bench(airframe(), 300)
    recorders = [open_recording(airframe(), tmp_path / "flights", bench.clock) for _ in range(3)]
    assert len({recorder.path for recorder in recorders if recorder is not None}) == 3
    for recorder in recorders:
        assert recorder is not None
        recorder.close()
