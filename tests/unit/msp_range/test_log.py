"""Log lines: what a person reads, what a machine reads, and a stream that takes no more."""

import io
import json
import os
from pathlib import Path

import pytest

from msp_range.clock import VirtualClock
from msp_range.log import Log

CLOCK = VirtualClock(1.7e9)


def test_a_machine_reads_every_value_back() -> None:
    lines = io.StringIO()
    log = Log("json", lines, CLOCK)
    log.info("still flying", frames={"sent": 3}, error=None)
    log.error("recording not finished", error="disk\nfull")
    assert [json.loads(line) for line in lines.getvalue().splitlines()] == [
        {
            "timestamp": "2023-11-14T22:13:20.000000Z",
            "level": "info",
            "event": "still flying",
            "frames": {"sent": 3},
            "error": None,
        },
        {
            "timestamp": "2023-11-14T22:13:20.000000Z",
            "level": "error",
            "event": "recording not finished",
            "error": "disk\nfull",
        },
    ]


def test_a_person_reads_one_line_for_each_event() -> None:
    lines = io.StringIO()
    Log("text", lines, CLOCK).info("started", vehicle="quad\x1b[2J pallet", bus="/dev/i2c-1", pid=7)
    assert lines.getvalue() == (
        '2023-11-14T22:13:20.000000Z info     started  vehicle="quad\\u001b[2J pallet" bus=/dev/i2c-1 pid=7\n'
    )


def test_the_journal_gets_each_level_in_its_own_form_and_no_second_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (tmp_path / "journal").open("w+") as stream:
        file = os.fstat(stream.fileno())
        monkeypatch.setenv("JOURNAL_STREAM", f"{file.st_dev}:{file.st_ino}")
        for form in ("text", "json"):
            Log(form, stream, CLOCK).warning("link", connected=False)
        stream.seek(0)
        assert stream.read() == (
            '<4>warning  link  connected=false\n<4>{"level": "warning", "event": "link", "connected": false}\n'
        )


def test_a_log_elsewhere_has_times_also_in_a_service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JOURNAL_STREAM", "8:1")
    with (tmp_path / "log").open("w+") as stream:
        Log("text", stream, CLOCK).info("started")
        stream.seek(0)
        assert stream.read() == "2023-11-14T22:13:20.000000Z info     started\n"


def test_a_log_that_nobody_takes_does_not_end_the_flight() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    stream = os.fdopen(writer, "w")
    Log("text", stream, CLOCK).error("lost")
    os.dup2(os.open(os.devnull, os.O_WRONLY), writer)
    stream.close()
