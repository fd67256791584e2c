"""The command's results on the terminal."""

from collections.abc import Sequence

from rich.text import Text

from msp_lab.design.questions import Question
from msp_range.terminal import console


def print_questions(questions: Sequence[Question]) -> None:
    """What the readings left open, and what is missing."""
    out = console()
    out.print(f"{len(questions)} open question{'s' if len(questions) != 1 else ''}", style="bold", highlight=False)
    for number, each in enumerate(questions, start=1):
        out.print(Text(f"{number}. {each.label} ({each.kind}): {each.why}"), highlight=False)
