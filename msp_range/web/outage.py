"""Why no bridge runs, as systemd knows it: the bridge's error message, which it sends as its status when it ends."""

import asyncio
import json
from asyncio.subprocess import DEVNULL, PIPE
from contextlib import suppress
from typing import Any

from msp_range.watch.newest import GONE

PROPERTIES = "Id,ActiveState,StatusText,ExecMainStatus"
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
    >>> _fault({"Id": "a", "ActiveState": "deactivating"})["remedy"]
    'sudo systemctl start a'
    """
    name, state, reason = (unit.get(key, "") for key in ("Id", "ActiveState", "StatusText"))
    text, remedy = "no bridge runs", "start it: msp-range run AIRFRAME.yaml"
    if state in ("inactive", "deactivating"):
        text, remedy = f"{name} is stopped", f"sudo systemctl start {name}"
    elif state == "failed" and reason:
        text, remedy = reason, f"repair this, then: sudo systemctl restart {name}"
    elif state:
        text = f"{name} is {state}, exit code {unit['ExecMainStatus']}"
        remedy = f"journalctl -u {name} -n 20 says why"
    return {"text": f"No distances: {text}", "remedy": remedy, "severity": "error", "cause": None}
