"""Wires, bus, sensors, port and autopilot, as `msp-range doctor` looks at them."""

from msp_range.commission.outcome import StepOutcome
from msp_range.commission.session import Session
from msp_range.doctor.examination import examine
from msp_range.doctor.finding import Verdict, unknown

LATER = {
    "parameters": "the step parameters sets them",
    "distances": "the step parameters comes first; the lift looks at them again",
    "latency": "the step parameters sets it",
}
"""What doctor finds wrong and later steps put right."""


def run(session: Session) -> StepOutcome:
    """Everything that doctor looks at; what later steps put right does not count yet."""
    session.operator.begin(
        "Wires: bus, sensors, port and autopilot, as 'msp-range doctor' looks at them. Propellers off."
    )
    outcome = StepOutcome()
    for finding in examine(session.path, session.computer, session.clock, session.make_bus, session.make_transport):
        if finding.verdict is Verdict.WRONG and finding.step in LATER:
            finding = unknown(finding.step, finding.text, LATER[finding.step])
        outcome.findings.append(finding)
    return outcome
