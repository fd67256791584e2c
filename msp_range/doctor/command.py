"""What `msp-range doctor` prints: each finding as soon as it is known, or all of them as JSON."""

import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from msp_range.clock import SystemClock
from msp_range.doctor.bench import measure
from msp_range.doctor.computer import Computer
from msp_range.doctor.examination import examine
from msp_range.doctor.finding import RIGHT, UNKNOWN, WRONG, Finding
from msp_range.terminal import wrapped

NEEDED = ("running bridge", "I2C bus in use", "autopilot")
"""Steps that may not be unknown for a go: nobody has seen the sensors or the autopilot then."""
INDENT = 9
"""Columns of the verdict in front of a finding [characters]."""


def text_of(finding: Finding) -> str:
    """A finding for a person, with the remedy in a line of its own."""
    text = f"{finding.verdict.value:<{INDENT}}{finding.step}: {finding.text}"
    return text if finding.remedy is None else f"{text}\n{'':{INDENT}}-> {finding.remedy}"


def show(path: Path, computer: Computer, as_json: bool, bench: bool = False) -> int:
    """Examine, or measure what the bridge costs here, and print; 1 where something is wrong, else 0."""
    findings = []
    for finding in measure(path) if bench else examine(path, computer, SystemClock()):
        findings.append(finding)
        if not as_json:
            print(*wrapped(text_of(finding)), sep="\n", flush=True)
    counts = Counter(finding.verdict.value for finding in findings)
    if as_json:
        print(json.dumps({"findings": [asdict(finding) for finding in findings], "counts": counts}, indent=2))
    else:
        print(f"\n{counts['right']} right, {counts['wrong']} wrong, {counts['unknown']} unknown")
    return int(counts["wrong"] > 0)


def show_preflight(path: Path, computer: Computer, as_json: bool) -> int:
    """Print go or no-go, then each finding, the worst first; 0 for go, else 1."""
    findings = list(examine(path, computer, SystemClock(), preflight=True))
    against = [each for each in findings if each.verdict is WRONG or (each.verdict is UNKNOWN and each.step in NEEDED)]
    if as_json:
        print(json.dumps({"go": not against, "findings": [asdict(finding) for finding in findings]}, indent=2))
        return int(bool(against))
    print(*wrapped(f"NO-GO    {', '.join(each.step for each in against)}" if against else "GO"), sep="\n")
    for finding in sorted(findings, key=lambda each: (each not in against, each.verdict is RIGHT)):
        # One screen: of what is right the first line is enough, but for the heights, which the pilot is to read.
        shown = 1 if finding.verdict is RIGHT and finding.step != "heights" else None
        print(*wrapped(text_of(finding))[:shown], sep="\n")
    return int(bool(against))
