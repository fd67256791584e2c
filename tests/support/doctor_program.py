"""`msp_range.doctor` on a computer that a test has made: its specification is the first argument, in JSON.

Prints the findings as JSON, or what a preflight prints. The bus is that of the process, so umockdev's where it runs
under its wrapper.
"""

import json
import os
import sys
from pathlib import Path
from types import SimpleNamespace

from msp_range.clock import SystemClock
from msp_range.doctor.command import show_preflight
from msp_range.doctor.computer import Computer, User
from msp_range.doctor.examination import examine
from msp_range.mavlink.transport import open_transport


def main() -> None:
    """Examine, and print."""
    spec = SimpleNamespace(**json.loads(sys.argv[1]))
    user = User(spec.user, 54321, frozenset(spec.gids))
    computer = Computer(Path(spec.root), user, lambda: spec.utc_s, lambda _: os.statvfs_result(spec.disk))
    if spec.preflight:
        sys.exit(show_preflight(Path(spec.airframe), computer, as_json=False))
    findings = examine(
        Path(spec.airframe),
        computer,
        SystemClock(),
        make_transport=lambda url, clock: open_transport(spec.link or url, clock),
    )
    print(json.dumps([[each.step, each.verdict.value, each.text, each.remedy or ""] for each in findings]))


if __name__ == "__main__":
    main()
