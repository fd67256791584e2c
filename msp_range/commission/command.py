"""What `msp-range commission` does: the steps in their order, each printed, corrected, verified and remembered."""

import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from msp_range.commission import edit
from msp_range.commission.outcome import Proposal, StepOutcome
from msp_range.commission.session import Session
from msp_range.commission.state import PassedSteps
from msp_range.commission.steps.table import STEPS
from msp_range.config import load_airframe
from msp_range.doctor.command import INDENT, text_of
from msp_range.yaml_file import ConfigError, place_of


def commission(session: Session, step: str | None) -> dict[str, Any]:
    """Do one step, or all that have not passed; ``steps`` is the report of each, by name, and ``next`` what is due now.

    Parameters
    ----------
    session
        Vehicle and person.
    step
        The one to do, whether it has passed or not; None: all that have not passed, until one does not.

    Raises
    ------
    ConfigError
        A step cannot go on: the vehicle is armed, or is not received; or the file cannot be used or changed.
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
    show = session.operator.show
    show(_overview(state, session, due))
    while name is not None:
        show(f"\n--- {name} ({list(STEPS).index(name) + 1} of {len(STEPS)}) ---")
        outcome = STEPS[name].run(session).keep_founded(session.airframe())
        _show_findings(session, outcome)
        changes, outcome = _correct(session, outcome)
        report[name] = {
            "passed": outcome.passed,
            "findings": [asdict(finding) for finding in outcome.findings],
            "changes": changes,
            "proposals_left": [proposal.text for proposal in outcome.proposals],
            "measured": outcome.measured,
        }
        session.measured[name] = outcome.measured
        if not outcome.passed:
            show(f"\n{name}: not passed. The same command goes on here; --step {name} repeats it")
            break
        state.save(name, session.airframe(), outcome.measured, session.clock)
        show(f"{name}: passed")
        # The next one due by the file as it is now: a change may concern an earlier step, too.
        name = state.next_step(session.airframe()) if step is None else None
    left = state.next_step(session.airframe())
    if left is None:
        show("\nall steps passed")
    elif all(each["passed"] for each in report.values()):
        show(f"\nnext: {left}. The same command goes on there")
    return {"steps": report, "next": left}


def _show_findings(session: Session, outcome: StepOutcome) -> None:
    for finding in outcome.findings:
        session.operator.show(text_of(finding))


def _correct(session: Session, outcome: StepOutcome) -> tuple[list[dict[str, str]], StepOutcome]:
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
    session.operator.show(f"saved in {session.path}; as it was: {backup.name}")
    changes = [{"text": proposal.text, "backup": str(backup)} for proposal in agreed]
    if outcome.again is None:
        return changes, outcome
    verified = outcome.again(changed).keep_founded(changed)
    session.operator.show("with the changed file:")
    _show_findings(session, verified)
    for proposal in verified.proposals:
        session.operator.show(f"{'left':{INDENT}}{proposal.text}")
    return changes, verified


def _asked(session: Session, proposal: Proposal) -> str:
    edits = [f"{'':{INDENT}}{place_of(change.path)}: {edit.as_yaml(change.value)}" for change in proposal.edits]
    return "\n".join([f"{'change':{INDENT}}{proposal.text}", *edits])


def _overview(state: PassedSteps, session: Session, due: Sequence[str]) -> str:
    passed = [f"{name} ({state.steps[name]['passed']})" for name in STEPS if name not in due and name in state.steps]
    text = f"{session.path}: {len(due)} of {len(STEPS)} steps to do: {', '.join(due) or 'none'}"
    return f"{text}\npassed: {', '.join(passed)}" if passed else text
