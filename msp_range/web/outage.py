"""Why the page has no bridge, as systemd knows it: the error message that it sends as its status when it ends."""

import asyncio
import json
import signal
from asyncio.subprocess import DEVNULL, PIPE
from contextlib import suppress
from typing import Any

from msp_range.watch.newest import GONE

PROPERTIES = "Id,ActiveState,StatusText,ExecMainCode,ExecMainStatus"
KILLED = ("2", "3")
"""ExecMainCode of a process that a signal ended, without and with a core file (CLD_KILLED and CLD_DUMPED of waitid(2)):
ExecMainStatus is the signal then."""
Unit = dict[str, str]


async def unit_state(unit: str) -> Unit:
    """Properties of a unit by name; none without systemd."""
    with suppress(OSError):
        show = await asyncio.create_subprocess_exec(
            "systemctl", "show", "-p", PROPERTIES, unit, stdin=DEVNULL, stdout=PIPE, stderr=DEVNULL
        )
        answer, _ = await show.communicate()
        return dict(line.split("=", 1) for line in answer.decode().splitlines() if "=" in line)
    return {}


def gone_packet(unit: Unit | None) -> bytes:
    """The packet in place of a bridge that does not run.

    Parameters
    ----------
    unit
        Its unit, as `unit_state` gives it; None: it is no service.
    """
    return json.dumps({"topic": GONE, "time_s": 0, "message": {"faults": [_fault(unit or {})]}}).encode()


def _fault(unit: Unit) -> dict[str, Any]:
    """The reason in the form of a status's faults.

    Examples
    --------
    >>> _fault({"Id": "a.service", "ActiveState": "failed", "ExecMainStatus": "2", "StatusText": ""})["text"]
    'No distances: a.service is failed, exit code 2'
    >>> _fault({"Id": "a", "ActiveState": "failed", "StatusText": "a.yaml:3: speed: unknown key"})["text"]
    'No distances: a.yaml:3: speed: unknown key'
    >>> _fault({"Id": "a", "ActiveState": "activating", "ExecMainStatus": "0", "StatusText": "good"})["text"]
    'No distances: a is activating, exit code 0'
    >>> _fault({"Id": "a", "ActiveState": "activating", "ExecMainCode": "2", "ExecMainStatus": "6"})["text"]
    'No distances: a is activating, ended by SIGABRT'
    >>> _fault({"Id": "a", "ActiveState": "active"})["text"]
    'No distances on this page: the bridge runs, and its socket cannot be reached'
    >>> _fault({"Id": "a", "ActiveState": "deactivating"})["remedy"]
    'sudo systemctl start a'
    """
    name, state, reason = (unit.get(key, "") for key in ("Id", "ActiveState", "StatusText"))
    text, remedy, where = "no bridge runs", "start it: msp-range run AIRFRAME.yaml", ""
    if state in ("active", "reloading", "refreshing"):
        text, where = "the bridge runs, and its socket cannot be reached", " on this page"
        remedy = f"journalctl -u {name} -u msp-range-web -n 40 says why"
    elif state in ("inactive", "deactivating"):
        text, remedy = f"{name} is stopped", f"sudo systemctl start {name}"
    elif state == "failed" and reason:
        text, remedy = reason, f"repair this, then: sudo systemctl restart {name}"
    elif state:
        text = f"{name} is {state}{_ending(unit)}"
        remedy = f"journalctl -u {name} -n 20 says why"
    return {"text": f"No distances{where}: {text}", "remedy": remedy, "severity": "error", "cause": None}


def _ending(unit: Unit) -> str:
    """How its process ended last: by an exit code or a signal; empty if systemd does not report it."""
    status = unit.get("ExecMainStatus", "")
    if unit.get("ExecMainCode") not in KILLED:
        return f", exit code {status}" if status else ""
    with suppress(ValueError):
        return f", ended by {signal.Signals(int(status)).name}"
    return f", ended by signal {status}"
