"""What `msp-range commission` does: the steps in their order, each printed, corrected, verified and remembered."""

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any, Protocol

from msp_range.commission import edit
from msp_range.commission.outcome import Proposal, StepOutcome
from msp_range.commission.session import Session
from msp_range.commission.state import PassedSteps
from msp_range.commission.steps.table import STEPS
from msp_range.config import load_airframe
from msp_range.doctor.command import lines_of
from msp_range.terminal import wrapped
from msp_range.yaml_file import ConfigError, place_of


class Output(Protocol):
    """A terminal, or what stands for one."""

    def write(self, text: str, /) -> object:
        """Write whole lines."""

    def flush(self) -> None:
        """Show them now."""


def commission(session: Session, step: str | None, out: Output, as_json: bool) -> int:
    """Do one step, or all that have not passed; 1 where one has not passed at the end, else 0.

    Parameters
    ----------
    session
        Vehicle and person.
    step
        The one to do, whether it has passed or not; None: all that have not passed, until one does not.
    out
        Where findings go.
    as_json
        Print one JSON object at the end instead.
    """
    airframe = session.airframe()
    if not os.access(session.path.absolute().parent, os.W_OK):
        raise ConfigError(
            f"{session.path.absolute().parent}: this user may not write there, where changes and what has passed are "
            "kept: use sudo, or a copy of the file in a folder of your own"
        )
    state = PassedSteps.of(session.path)
    session.measured.update({name: each["measured"] for name, each in state.steps.items()})
    report: dict[str, Any] = {}
    due = [step] if step is not None else [name for name in STEPS if not state.has_passed(name, airframe)]
    name = due[0] if due else None

    def show(lines: Sequence[str]) -> None:
        if not as_json:
            out.write("\n".join(lines) + "\n")
            out.flush()

    show(_overview(state, session, due))
    while name is not None:
        show(["", f"--- {name} ({list(STEPS).index(name) + 1} of {len(STEPS)}) ---"])
        outcome = STEPS[name].run(session).keep_founded(session.airframe())
        show([line for finding in outcome.findings for line in lines_of(finding)])
        changes, outcome = _correct(session, outcome, show)
        report[name] = {
            "passed": outcome.passed,
            "findings": [asdict(finding) for finding in outcome.findings],
            "changes": changes,
            "proposals_left": [proposal.text for proposal in outcome.proposals],
            "measured": outcome.measured,
        }
        session.measured[name] = outcome.measured
        if not outcome.passed:
            show(["", f"{name}: not passed. The same command goes on here; --step {name} repeats it"])
            break
        state.save(name, session.airframe(), outcome.measured, session.clock)
        show([f"{name}: passed"])
        # The next one due by the file as it is now: a change may concern an earlier step, too.
        name = state.next_step(session.airframe()) if step is None else None
    left = state.next_step(session.airframe())
    if left is None:
        show(["", "all steps passed"])
    elif all(each["passed"] for each in report.values()):
        show(["", f"next: {left}. The same command goes on there"])
    if as_json:
        out.write(json.dumps({"steps": report, "next": left}, indent=2) + "\n")
    return int(not all(each["passed"] for each in report.values()))


def _correct(
    session: Session, outcome: StepOutcome, show: Callable[[Sequence[str]], None]
) -> tuple[list[dict[str, str]], StepOutcome]:
    """Make the changes that the person agrees to, and compare the same measurements with the new file.

    Raises
    ------
    ConfigError
        The changed file would not be valid; the file is as it was.
    """
    agreed = [proposal for proposal in outcome.proposals if session.operator.agrees(_asked(session, proposal))]
    if not agreed:
        return [], outcome
    session.check_disarmed()
    edits = [one for proposal in agreed for one in proposal.edits]
    for name, text in {file: text for proposal in agreed for file, text in proposal.files}.items():
        edit.save(session.path.with_name(name), text)
    backup = edit.change(session.path, edits)
    try:
        changed = load_airframe(session.path)
    except ConfigError as error:
        backup.replace(session.path)
        raise ConfigError(f"nothing was changed, as the file would not be valid any more:\n{error}") from None
    show([f"saved in {session.path}; as it was: {backup.name}"])
    changes = [{"text": proposal.text, "backup": str(backup)} for proposal in agreed]
    if outcome.again is None:
        return changes, outcome
    verified = outcome.again(changed).keep_founded(changed)
    show(["with the changed file:"])
    show([line for finding in verified.findings for line in lines_of(finding)])
    for proposal in verified.proposals:
        show(wrapped("left     ", proposal.text))
    return changes, verified


def _asked(session: Session, proposal: Proposal) -> str:
    lines = wrapped("change   ", proposal.text)
    for change in proposal.edits:
        lines += wrapped("         ", f"{place_of(change.path)}: {edit.as_yaml(change.value)}")
    return "\n".join(lines)


def _overview(state: PassedSteps, session: Session, due: Sequence[str]) -> list[str]:
    passed = [f"{name} ({state.steps[name]['passed']})" for name in STEPS if name not in due and name in state.steps]
    lines = wrapped("", f"{session.path}: {len(due)} of {len(STEPS)} steps to do: {', '.join(due) or 'none'}")
    return lines + (wrapped("", f"passed: {', '.join(passed)}") if passed else [])
