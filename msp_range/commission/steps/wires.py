"""Wires, bus, sensors, port and autopilot, as `msp-range doctor` looks at them."""

from msp_range.clock import Clock
from msp_range.commission.edit import Edit
from msp_range.commission.outcome import StepOutcome
from msp_range.commission.session import Session
from msp_range.doctor.autopilot import Tap
from msp_range.doctor.examination import examine
from msp_range.doctor.finding import WRONG, unknown

LATER = {
    "parameters": "the step parameters sets them",
    "distances": "the step parameters comes first; the lift looks at them again",
    "latency": "the step parameters sets it",
}
"""What doctor finds wrong and later steps put right."""


def run(session: Session) -> StepOutcome:
    """Everything that doctor looks at; what later steps put right does not count yet.

    The autopilot's system id is proposed for the file, so that the bridge joins no other vehicle on the link.
    """
    session.operator.begin(
        "Wires: bus, sensors, port and autopilot, as 'msp-range doctor' looks at them. Propellers off."
    )
    outcome, received, in_file = _examined(session)
    if received not in (set(), {in_file}) and len(received) == 1:
        (system,) = received
        text = f"the autopilot received is system {system}; the bridge then joins no other one"
        outcome.propose(text, Edit(("link", "system_id"), system))
        outcome.again = lambda airframe: _examined(session)[0]
        # What the change corrects is a reason for it, and not against it.
        outcome.findings = [
            unknown(finding.step, finding.text, "the change below corrects it")
            if finding.verdict is WRONG and finding.step == "heartbeat"
            else finding
            for finding in outcome.findings
        ]
    return outcome


def _examined(session: Session) -> tuple[StepOutcome, set[int], int | None]:
    """What doctor finds, the systems of the autopilots that it receives, and the one in the file."""
    outcome = StepOutcome()
    taps: list[Tap] = []

    def tapped(url: str, clock: Clock) -> Tap:
        taps.append(Tap(session.make_transport(url, clock)))
        return taps[-1]

    for finding in examine(session.path, session.computer, session.clock, session.make_bus, tapped):
        if finding.verdict is WRONG and finding.step in LATER:
            finding = unknown(finding.step, finding.text, LATER[finding.step])
        outcome.findings.append(finding)
    received = {frame.system for tap in taps for frame in tap.frames if frame.is_autopilot_heartbeat}
    return outcome, received, session.airframe().link.system_id if received else None
