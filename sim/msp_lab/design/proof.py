"""The simulator holds a session first: how often the gap workflow then names the right answer.

Readings of the design are drawn from each answer in turn, put with the old ones and named as `msp-lab gap` names them.
The result is the share that was right, with its interval.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from msp_lab.design.answers import FittedAnswer, OldReadings
from msp_lab.design.choose import Design
from msp_lab.design.session import Columns, PlannedSession
from msp_lab.gap import naming, rules
from msp_lab.gap.findings import FoundEffect, GapFindings
from msp_lab.gap.intake import Comparison, Readings
from msp_lab.gap.problem import Progress
from msp_range.arrays import numbered
from msp_range.recording.csv_form import MeasuredData, join_tables
from msp_sim.effects.base import PATH
from msp_sim.model.derived import sample_in_order
from msp_sim.model.model import Model


@dataclass(frozen=True)
class Proof:
    """How often the right answer was named."""

    right: int
    held: int
    """Sessions with the right answer, and all that were simulated."""
    wrong: tuple[str, ...] = ()
    """What was found in the others, in words."""

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the power (Clopper and Pearson 1934).

        Examples
        --------
        >>> print("{:.2f} {:.2f}".format(*Proof(20, 20).interval))
        0.83 1.00
        """
        found = binomtest(self.right, self.held).proportion_ci()
        return float(found.low), float(found.high)


def with_old(old: OldReadings, answers: Sequence[FittedAnswer], new_rows: int) -> bool:
    """Whether the old readings can go in with the new ones.

    Not where they lack a column that an effect needs, since readings without it are left out; and not where they are so
    many that the workflow would compare alternatives on only some of the new ones.
    """
    effects = [answer.answer.effect for answer in answers if answer.answer.effect is not None]
    required = {column for effect in effects for column in effect.requires}
    rows = old.columns["reading_cm"].size
    most = rules.READINGS if len(effects) > 1 else 2 * rules.READINGS
    return required <= {*old.columns} and rows + new_rows <= most


def prove(old: OldReadings, design: Design, joined: bool, sessions: int, seed: int, report: Progress) -> Proof:
    """Hold a design's session several times, each answer true in turn.

    Parameters
    ----------
    old
        Readings of the gap run, its model and its settings.
    design
        With a session.
    joined
        With the old readings.
    sessions
        How many.
    seed
        Of all draws.
    report
        Progress.
    """
    session = design.session
    assert session is not None
    right, wrong = 0, []
    for number in range(sessions):
        report(f"simulating session {number + 1} of {sessions}", number / sessions)
        truth = number % len(design.answers)
        rng = np.random.default_rng([seed, number])
        new = held(session, design.answers[truth].model, rng)
        data = MeasuredData(new)
        if joined:
            # Paths are those of one table, and found again for both.
            columns = {name: column for name, column in old.columns.items() if name != PATH}
            data = join_tables([MeasuredData(columns), data])
        comparison = Comparison.of(Readings(data, ()), old.model, old.comparison.settings)
        findings, _ = naming.name(comparison, GapFindings(None, rows=0, runs=0), lambda what, share: None)
        if is_right(findings.effects, design, truth):
            right += 1
        else:
            names = ", ".join(" or ".join(sorted(names_of(effect))) for effect in findings.effects) or "nothing"
            wrong.append(f"{design.answers[truth].answer.label}: found {names}")
    return Proof(right, sessions, tuple(wrong))


def held(session: PlannedSession, model: Model, rng: np.random.Generator) -> Columns:
    """A session with readings drawn from a model; the table's true ranges err by an offset of each run."""
    contexts = dict(session.contexts)
    unit = numbered(contexts["run"])
    offset_cm = session.offset_cm * rng.standard_normal(int(unit.max()) + 1)
    shifted = {**contexts, "true_range_cm": contexts["true_range_cm"] + offset_cm[unit]}
    contexts["reading_cm"] = sample_in_order(model, shifted, int(rng.integers(2**31)))
    return contexts


def names_of(found: FoundEffect) -> frozenset[str]:
    """A finding's name with its alternatives."""
    return frozenset({found.name, *(alternative.name for alternative in found.alternatives)})


def is_right(effects: Sequence[FoundEffect], design: Design, truth: int) -> bool:
    """Whether the true answer was found, and none of those that the session tells from it."""
    classes = [names_of(effect) for effect in effects if effect.verdict != "suggested"]
    alike = {design.answers[place].answer.name for place in design.class_of(truth)}
    others = {answer.answer.name for answer in design.answers} - alike - {None}
    if any(found & others for found in classes):
        return False
    return None in alike or any(found & alike for found in classes)
