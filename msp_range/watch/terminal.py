"""What `msp-range status` prints: the state of a running bridge, once or until Ctrl-C, within 80 columns."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from msp_range.clock import SystemClock
from msp_range.health import BridgeState
from msp_range.terminal import NARROW, PlainConsole, plain_table, wrapped
from msp_range.watch.client import connect, packets, read_once
from msp_range.watch.facts import DISTANCE, facts_of
from msp_range.watch.newest import Newest
from msp_range.watch.place import sockets

REFRESH_S = 0.2
"""Time between two updates of the display [s]."""
EXIT_NOT_RUNNING, EXIT_NOT_ACTIVE = 1, 4


def show(socket: Path | None, once: bool, as_json: bool) -> int:
    """Print the state of the bridge; returns the exit code."""
    paths = [socket] if socket is not None else sockets()
    connection = connect(paths)
    if connection is None:
        places = " or ".join(map(str, paths))
        print(f"no bridge runs: nobody listens at {places}; sudo systemctl status msp-range says why", file=sys.stderr)
        return EXIT_NOT_RUNNING
    newest = Newest()
    out = PlainConsole(width=min(PlainConsole().width, NARROW))
    with connection:
        if as_json or once or not out.is_terminal:
            newest = read_once(connection)
            if as_json:
                print(json.dumps(as_object(newest)))
            else:
                out.print(shown(newest))
            if newest.status:
                return 0 if newest.state == BridgeState.ACTIVE else EXIT_NOT_ACTIVE
            print("the bridge does not answer, or ended while it was asked", file=sys.stderr)
            return EXIT_NOT_RUNNING
        clock = SystemClock()
        next_s = clock.now()
        with Live(console=out, auto_refresh=False) as live:
            for packet in packets(connection):
                newest.update(packet)
                if clock.now() >= next_s:
                    next_s = clock.now() + REFRESH_S
                    live.update(shown(newest), refresh=True)
    print("the bridge has ended")
    return EXIT_NOT_RUNNING


def as_object(newest: Newest) -> dict[str, Any]:
    """All of it, for a program."""
    return {
        "airframe": newest.airframe,
        "status": newest.status,
        "readings": newest.readings,
        "fused": newest.distance,
        "autopilot": newest.received,
        "texts": [{"time_s": time_s, **text} for time_s, text in newest.texts],
    }


def shown(newest: Newest) -> Group:
    """All of it, for a reader: what is wrong comes first, where a short window still shows it."""
    title = f"{newest.airframe.get('vehicle', '?')}: {newest.state}", "bold"
    above = [Text(*line) for line in (title, *_wrong(newest))]
    style = "bold red" if newest.distance is None else "bold"
    below = [Text(fact.name + fact.text, style * (fact.name == DISTANCE)) for fact in facts_of(newest)]
    return Group(*above, _sensors(newest), *below)


def _wrong(newest: Newest) -> Iterator[tuple[str, str]]:
    """What is wrong, each cause with its remedy and what follows from it; each line with its style."""
    for fault in newest.status.get("faults", []):
        style = "red" if fault["severity"] == "error" else "yellow"
        if fault["cause"] is not None:
            yield f"   so {fault['text']}", style
        else:
            yield f"{fault['severity']}: {fault['text']}", f"bold {style}"
            yield "\n".join(wrapped(f"   -> {fault['remedy']}")), ""


def _sensors(newest: Newest) -> Table:
    status = newest.status
    table = plain_table(("sensor", "raw m", "corrected m", "used", "readings", "rejected"), align="lrrlr")
    table.width = NARROW
    for sensor in newest.airframe.get("sensors", []):
        name = sensor["name"]
        reading = newest.readings.get(name, {})
        counts = status.get("sensors", {}).get(name, {"readings": 0, "rejected": {}, "fault": None})
        table.add_row(
            name,
            _metres(reading.get("range_m")),
            _metres(reading.get("corrected_m")),
            counts["fault"] or _use(reading),
            str(counts["readings"]),
            str(sum(counts["rejected"].values())),
            style="red" if counts["fault"] else None,
        )
    return table


def _use(reading: dict[str, Any]) -> str:
    if not reading:
        return "no reading yet"
    if reading["status"] != "ok":
        return str(reading["status"]).replace("_", " ")
    return str(reading.get("rejected", "yes")).replace("_", " ")


def _metres(range_m: float | None) -> str:
    return "" if range_m is None else f"{range_m:.2f}"
