"""Log lines: what a person reads, what a machine reads, and a stream that takes no more."""

import io
import json
import os

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


def test_a_log_that_nobody_takes_does_not_end_the_flight() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    stream = os.fdopen(writer, "w")
    Log("text", stream, CLOCK).error("lost")
    os.dup2(os.open(os.devnull, os.O_WRONLY), writer)
    stream.close()
