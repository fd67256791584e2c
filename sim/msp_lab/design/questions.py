"""What a gap run left open: questions with their possible answers.

They are made of the findings of ``gap.json``. A question has two answers or more, each an effect or none; an experiment
decides it if the readings of the experiment fit one answer and not the others.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from msp_lab.gap.findings import FoundEffect, GapFindings, UnknownEffect
from msp_lab.gap.findings_file import NUMBERS
from msp_lab.gap.labels import effect_label
from msp_range.yaml_file import ConfigError
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import Effect

OPEN_VERDICTS = frozenset({"absorbed", "partly explained", "unexplained"})
"""Verdicts that leave something without a name: effects that could not be tested may be its cause, where there is no
other question. With another verdict nothing points to them, and no session is designed for them."""


@dataclass(frozen=True)
class Answer:
    """One possible answer."""

    name: str | None
    of: str | None = None
    """Effect of the catalogue, and the sensor, run or target that it is of; None: none of the effects, only the model's
    own numbers."""

    @property
    def label(self) -> str:
        """For a person."""
        return "none of them" if self.name is None else effect_label(self.name, self.of)

    @property
    def effect(self) -> Effect | None:
        """The catalogue's entry."""
        return None if self.name is None else CATALOGUE[self.name]


NONE = Answer(None)


@dataclass(frozen=True)
class OpenQuestion:
    """What the readings could not decide."""

    kind: Literal["indistinguishable", "suggested", "absorbed", "not testable"]
    """Why not: alternatives fit as well; an effect is only suggested; a number of the model absorbed it; its column is
    not recorded."""
    answers: tuple[Answer, ...]
    """Two or more."""
    why: str
    """What is missing, in a sentence."""

    @property
    def label(self) -> str:
        """The answers in words."""
        names = [answer.label for answer in self.answers if answer.name is not None]
        return " or ".join([*names, *(["none"] if len(names) == 1 else [])])

    @property
    def folder(self) -> str:
        """A name for files."""
        return "-or-".join(answer.name or "none" for answer in self.answers[:2])

    @property
    def columns(self) -> frozenset[str]:
        """Context columns that the answers depend on."""
        return frozenset(column for answer in self.answers if answer.effect for column in answer.effect.columns)


def open_questions(findings: GapFindings, folder: Path) -> tuple[OpenQuestion, ...]:
    """What a gap run left open, what is nearest to a name first.

    Parameters
    ----------
    findings, folder
        Of a run up to the step `name` or later, and where they are.

    Raises
    ------
    ConfigError
        The run did not come to names, or it left nothing open.
    """
    if findings.verdict is None:
        raise ConfigError(f"{folder / NUMBERS}: the run did not end; run 'msp-lab add {folder}' first")
    found: dict[frozenset[Answer], OpenQuestion] = {}
    # What nothing points to is asked only where nothing else is.
    for question in [*_all(findings)] or _not_testable(findings):
        known = all(answer.name is None or answer.name in CATALOGUE for answer in question.answers)
        if known and len(question.answers) > 1:
            found.setdefault(frozenset(question.answers), question)
    if not found:
        raise ConfigError(f"{folder / NUMBERS}: nothing to decide ({findings.verdict}); next: {findings.next_step}")
    return tuple(found.values())


def _all(findings: GapFindings) -> Iterator[OpenQuestion]:
    for effect in findings.effects:
        if effect.verdict != "named":
            yield _of_effect(effect)
    for cause in findings.causes:
        state = "hardly varied" if cause.recorded else "is not recorded"
        yield OpenQuestion(
            "absorbed", (Answer(cause.effect), NONE), f"{cause.number} changed, and {cause.column} {state}"
        )
    for unknown in findings.unknown:
        yield from _of_unknown(unknown)


def _not_testable(findings: GapFindings) -> Iterator[OpenQuestion]:
    for untested in findings.not_testable if findings.verdict in OPEN_VERDICTS else ():
        if untested.name in CATALOGUE and CATALOGUE[untested.name].per is None:
            missing = " and ".join(untested.columns)
            are = "are" if len(untested.columns) > 1 else "is"
            yield OpenQuestion("not testable", (Answer(untested.name), NONE), f"{missing} {are} not recorded")


def _of_effect(effect: FoundEffect) -> OpenQuestion:
    answers = [
        Answer(effect.name, effect.of),
        *(Answer(alternative.name, alternative.of) for alternative in effect.alternatives),
    ]
    if effect.verdict == "suggested":
        why = effect.doubt or "held-out runs do not confirm it"
        return OpenQuestion("suggested", (*dict.fromkeys(answers), NONE), why)
    losses = ", ".join(f"{alternative.name} {alternative.loss_nats:.1f}" for alternative in effect.alternatives)
    return OpenQuestion("indistinguishable", tuple(dict.fromkeys(answers)), f"nats behind {effect.name}: {losses}")


def _of_unknown(unknown: UnknownEffect) -> Iterator[OpenQuestion]:
    over = " and ".join(unknown.variables)
    for name, column in unknown.likely_causes:
        why = f"a curve of {unknown.channel} over {over} has no name, and {column} is not recorded"
        yield OpenQuestion("not testable", (Answer(name), NONE), why)
