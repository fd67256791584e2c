"""What `msp-range doctor` prints: each finding as soon as it is known, or all of them as JSON."""

import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path

from msp_range.clock import SystemClock
from msp_range.doctor.bench import measure
from msp_range.doctor.computer import Computer
from msp_range.doctor.examination import examine
from msp_range.doctor.finding import Finding, Verdict
from msp_range.terminal import wrapped

INDENT = 9
"""Columns of the verdict in front of a finding [characters]."""


def lines_of(finding: Finding) -> list[str]:
    """A finding for a person, at most 80 columns wide."""
    lines = wrapped(f"{finding.verdict.value:<{INDENT}}", f"{finding.step}: {finding.text}")
    if finding.remedy is not None and finding.verdict is not Verdict.RIGHT:
        lines += wrapped(" " * INDENT + "-> ", finding.remedy)
    return lines


def show(path: Path, computer: Computer, as_json: bool, bench: bool = False) -> int:
    """Examine, or measure what the bridge costs here, and print; 1 where something is wrong, else 0."""
    findings = []
    for finding in measure(path) if bench else examine(path, computer, SystemClock()):
        findings.append(finding)
        if not as_json:
            print("\n".join(lines_of(finding)), flush=True)
    counts = Counter(finding.verdict.value for finding in findings)
    if as_json:
        print(json.dumps({"findings": [asdict(finding) for finding in findings], "counts": counts}, indent=2))
    else:
        print(f"\n{counts['right']} right, {counts['wrong']} wrong, {counts['unknown']} unknown")
    return int(counts["wrong"] > 0)
