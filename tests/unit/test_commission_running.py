"""Commissioning with the readings of a bridge that runs already, through its socket."""

import json
import socket
import threading
import time
from collections.abc import Mapping
from contextlib import suppress

import pytest

from msp_range.clock import SystemClock
from msp_range.commission.samples import samples_of
from msp_range.commission.session import RunningBridge
from msp_range.config import load_airframe
from msp_range.yaml_file import ConfigError
from tests.support.waiting import until

AIRFRAME = load_airframe("configs/quad_pallet.yaml")


def bridge_that_says(*packets: tuple[str, Mapping[str, object]]) -> RunningBridge:
    """The socket of a running bridge that sends these packets again and again, the first one once."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ours.send(json.dumps({"topic": packets[0][0], "time_s": 0.0, "message": packets[0][1]}).encode())

    def run() -> None:
        with suppress(OSError), ours:
            while len(packets) > 1:
                for topic, message in packets[1:]:
                    ours.send(json.dumps({"topic": topic, "time_s": 1.0, "message": message}).encode())
                time.sleep(0.01)

    threading.Thread(target=run, daemon=True).start()
    return RunningBridge(theirs, SystemClock().now)


def test_a_running_bridge_is_read_through_its_socket() -> None:
    greeting = {"sensors": [{"name": each.name, "address": f"0x{each.address:02x}"} for each in AIRFRAME.sensors]}
    measured = {"time_s": 0.9, "read_s": 0.93, "status": "ok", "range_m": 2.0, "corrected_m": 2.0}
    disarmed, armed, lost = ({"link": {"armed": is_armed}} for is_armed in (False, True, None))

    good = bridge_that_says(("/airframe", greeting), ("/range/front_left", measured), ("/status", disarmed))
    good.begin(AIRFRAME)
    until(lambda: any(each.range_m[0] == 2.0 for each in samples_of(good.record(0.1)).readings.values()))
    good._connection.close()

    up = bridge_that_says(("/airframe", greeting), ("/status", armed))
    up.begin(AIRFRAME)
    with pytest.raises(ConfigError, match="disarm"):
        up.record(0.1)
    up._connection.close()

    alone = bridge_that_says(("/airframe", greeting), ("/status", lost))
    alone.begin(AIRFRAME)
    with pytest.raises(ConfigError, match="heartbeat is lost"):
        alone.record(0.1)
    alone._connection.close()

    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    silent = RunningBridge(theirs, SystemClock().now)
    theirs.settimeout(0.01)
    with pytest.raises(ConfigError, match="hangs"):
        silent.begin(AIRFRAME)
    silent = RunningBridge(theirs, SystemClock().now)
    theirs.send(b"a mark that is not read")
    ours.close()
    with pytest.raises(ConfigError, match="ended"):
        silent.begin(AIRFRAME)
    silent._connection.close()

    old = bridge_that_says(("/airframe", {"sensors": greeting["sensors"][:3]}))
    with pytest.raises(ConfigError, match="reload"):
        old.begin(AIRFRAME)
    with pytest.raises(ConfigError, match="ended"):
        old.record(0.1)
    old._connection.close()
