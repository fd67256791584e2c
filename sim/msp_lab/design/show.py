"""The command's results on the terminal."""

from collections.abc import Sequence
from pathlib import Path

from rich.padding import Padding
from rich.text import Text

from msp_lab.design.designing import Plan
from msp_lab.design.files import commands, folder_of
from msp_lab.gap.findings import GapFindings
from msp_range.terminal import PlainConsole, console
from msp_sim.page.text import and_list


def print_plans(plans: Sequence[Plan], findings: GapFindings, out: Path) -> None:
    """Each question with the session that decides it, or why none does."""
    shown = console()
    for number, plan in enumerate(plans, start=1):
        question = plan.design.question
        shown.print(Text(f"{number}. {question.label} ({question.kind})", style="bold"))
        for line in (f"{question.why}", *_lines(plan)):
            shown.print(Padding(Text(line), (0, 0, 0, 3)))
        if plan.design.session is not None:
            # Commands in one line, so that they can be copied.
            for command in commands(plan, number, findings, out):
                PlainConsole().print(f"   {command}", soft_wrap=True)
            where = folder_of(plan, number, out)
            PlainConsole().print(f"   in {where}: what to do, and session.png", soft_wrap=True)


def _lines(plan: Plan) -> list[str]:
    design = plan.design
    labels = [answer.answer.label for answer in design.answers]
    lines = []
    for pair in design.same:
        how = "the same in every session" if pair.structural else "too alike for a session"
        lines.append(
            f"{labels[pair.one]} and {labels[pair.other]} are {how} here ({pair.nats:.1f} nats in the longest)"
        )
    assumed = [labels[place] for place, answer in enumerate(design.answers) if answer.assumed and answer.answer.name]
    session = design.session
    if session is None:
        return [*lines, f"No session: {design.why}"]
    if assumed:
        lines.append(f"Nothing is known of the strength of {and_list(assumed)}; planned for the smallest that matters")
    varied = "; ".join(f"{name}: {words}" for name, words in session.varied.items())
    of = "flights" if session.kind == "flight" else "points"
    lines.append(f"{session.kind.capitalize()}, {session.minutes:.0f} min: {varied}")
    lines.append(f"{session.runs} {of}, {session.readings} readings in all; expected power {_per_cent(design.power)}")
    if plan.proof is not None:
        low, high = plan.proof.interval
        proof = plan.proof
        interval = f"95 % interval of the power {_per_cent(low)} to {_per_cent(high)}"
        lines.append(f"Simulated: right in {proof.right} of {proof.held} sessions ({interval})")
        lines += [f"  wrong with {what}" for what in proof.wrong[:3]]
        if proof.right < design.wanted * proof.held:
            lines.append(f"That is less often than the {_per_cent(design.wanted)} asked for: not promised")
    if not plan.joined:
        lines.append("Its readings are compared alone: the old ones lack a column of it, or are too many")
    return lines


def _per_cent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share < 0.995 else "more than 99 %" if share < 1.0 else "100 %"
