"""What a step found, and what it proposes to change in the airframe file."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from msp_range.commission.edit import Edit
from msp_range.commission.motion import Measured
from msp_range.config import Airframe
from msp_range.doctor.finding import RIGHT, WRONG, Finding, Row, first_of, right, unknown, wrong


@dataclass(frozen=True)
class Proposal:
    """A change of the airframe file."""

    text: str
    """What was measured, with its interval, what the file has, and what is proposed."""
    edits: tuple[Edit, ...]
    """Changes of values in the file."""
    files: tuple[tuple[str, str], ...] = ()
    """Files to be made next to the airframe file first: name, text."""


@dataclass
class StepOutcome:
    """Outcome of one step."""

    findings: list[Finding] = field(default_factory=list)
    """What is right, wrong or unknown."""
    proposals: list[Proposal] = field(default_factory=list)
    """Changes of the airframe file that would make it right."""
    measured: dict[str, Any] = field(default_factory=dict)
    """Numbers for the state file and for other steps."""
    complete: bool = True
    """False where something has to be measured again."""
    again: "Callable[[Airframe], StepOutcome] | None" = None
    """Compares the same measurements with another airframe, such as one with the changes; None where a step measured
    nothing that depends on the file."""

    def add(self, step: str, *rows: Row) -> None:
        """Add the finding of the first row whose test holds, see `first_of`."""
        self.findings.append(first_of(step, *rows))

    def right(self, step: str, text: str) -> None:
        """Add that all is as it should be."""
        self.findings.append(right(step, text))

    def wrong(self, step: str, text: str, remedy: str) -> None:
        """Add that something has to be changed."""
        self.findings.append(wrong(step, text, remedy))

    def unknown(self, step: str, text: str, remedy: str | None = None) -> None:
        """Add that it is not known whether something has to be changed."""
        self.findings.append(unknown(step, text, remedy))

    def propose(self, text: str, *edits: Edit) -> None:
        """Add a change of the airframe file."""
        self.proposals.append(Proposal(text, edits))

    @property
    def passed(self) -> bool:
        """Whether the step is done: all was measured, a finding is right, none is wrong, and no change is proposed."""
        verdicts = [finding.verdict for finding in self.findings]
        return self.complete and not self.proposals and WRONG not in verdicts and RIGHT in verdicts

    def keep_founded(self, airframe: Airframe) -> "StepOutcome":
        """Drop and count the proposals that come from something wrong; returns itself.

        A wrong finding concerns the sensor whose name ends its step, or else everything that was measured.
        """
        named = [finding.step for finding in self.findings if finding.verdict is WRONG]
        names = [sensor.name for sensor in airframe.sensors]
        about = {next((i for i, name in enumerate(names) if step.endswith(f" {name}")), None) for step in named}
        founded = [
            proposal
            for proposal in self.proposals
            if None not in about
            and about.isdisjoint(edit.path[1] for edit in proposal.edits if edit.path[0] == "sensors")
        ]
        if len(founded) < len(self.proposals):
            text = f"{len(self.proposals) - len(founded)} not proposed, as they come from what is wrong"
            self.unknown("changes", f"{text}: {', '.join(named)}", "put that right first, then again")
        self.proposals = founded
        return self


def shown(measured: Measured, unit: str = "m", digits: int = 2) -> str:
    """A measured number with its interval, for a person.

    Examples
    --------
    >>> shown(Measured(-0.204, 0.018))
    '-0.20 m (-0.22 to -0.19)'
    """
    low, high = measured.value - measured.half_width, measured.value + measured.half_width
    return f"{measured.value:.{digits}f} {unit} ({low:.{digits}f} to {high:.{digits}f})"
