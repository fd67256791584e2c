"""How far apart two answers are in a session's readings: the expected log-likelihood ratio.

It is counted in nats, for two fitted answers and a session's contexts. Readings are drawn from the first answer, and
both are fitted to them; the second one with all of its numbers and those of the base free, so that what it can imitate
does not count (T-optimality, Atkinson and Fedorov 1975).
"""

from dataclasses import dataclass
from functools import cache
from math import sqrt
from typing import Any

import numpy as np
from scipy.stats import chi2, norm
from scipy.stats import t as student

from msp_lab.design.answers import FittedAnswer
from msp_lab.design.session import Columns
from msp_lab.gap import rules
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.refit import refit
from msp_lab.gap.runs import previous
from msp_lab.readings.intake import PREVIOUS
from msp_range.arrays import numbered
from msp_sim.model.model import Model

DRAWN_ROWS = 3_000
"""Readings that are drawn to find the nats per reading: 27 nats, those of a power of 95 %, in a session of so many
readings are then known to 7. More: slower."""
FIND_NATS = 8.0
"""What an effect has to gain to be named where it may also be absent: what the largest of some 70 candidates gains by
random variation is 6, and the shapes that are searched cost 1 or 2. Higher: longer sessions."""

DEPENDENT_P = 0.1
"""Offsets of runs are expected to show if their mean statistic has a smaller p-value. `gap` asks for 0.001, and the
statistic scatters about its mean. Higher: more sessions are planned with the run as the unit, which need more runs."""


@dataclass(frozen=True)
class Separation:
    """How far a wrong answer is from the right one."""

    truth: int
    alternative: int
    """Places of the right answer and of the wrong one."""
    within_nats: float
    between_nats: float
    """Nats per reading by what differs inside runs, and by what differs between runs."""
    offsets: float
    """Variance of what runs differ by anyway, over that of a single reading."""
    correlation: float
    """Correlation of neighbouring readings' errors."""
    run_scatter: float | None = None
    """Variance of the runs' mean lead of the right answer without offsets, over that of a single reading's; None: the
    wrong answer is that there is no effect, which `gap` decides by the offsets' own likelihood."""
    other_runs: int = 0
    """Runs of the old readings, if they go in."""

    @property
    def pair(self) -> tuple[int, int]:
        """Places of both answers, that of the right one first."""
        return self.truth, self.alternative

    def nats(self, readings: int, runs: int) -> float:
        """Expected nats between the two in a session; the gap workflow selects effects on all of its readings.

        Correlated readings count as fewer; runs that have offsets of their own count as ``1 / (1 + n offsets)``. Where
        these show, `gap` takes the run as the unit of evidence: it integrates the offsets out and compares alternatives
        by the scatter of what is left of their lead over runs (Vuong 1989), as `msp_lab.gap.evidence.lead_nats` does.
        Alternatives are compared on `rules.READINGS` at most.
        """
        if self.run_scatter is not None:
            readings = min(readings, rules.READINGS)
        independent = readings * (1.0 - self.correlation) / (1.0 + self.correlation)
        in_run = independent / max(runs, 1)
        nats = independent * (self.within_nats + self.between_nats / (1.0 + in_run * self.offsets))
        between = (runs - 1) * (1.0 + in_run * self.offsets)
        if self.run_scatter is None or float(chi2.sf(between, max(runs - 1, 1))) > DEPENDENT_P:
            return nats
        return nats / (1.0 + in_run * self.run_scatter) * _worth_by_run(runs + self.other_runs)


@cache
def _worth_by_run(runs: int) -> float:
    """What a nat is worth if its error is known from so many runs only: Student's t in place of a normal number."""
    if runs < 3:
        return 0.0
    tail = float(norm.sf(sqrt(2.0 * rules.ALTERNATIVE_NATS)))
    threshold = 0.5 * float(student.isf(tail, runs - 2)) ** 2
    return needed_nats(0.95, rules.ALTERNATIVE_NATS) / needed_nats(0.95, threshold)


def separation(
    given: Model,
    answers: tuple[FittedAnswer, FittedAnswer],
    places: tuple[int, int],
    contexts: Columns,
    offset_cm: float,
    rng: np.random.Generator,
    other_runs: int = 0,
) -> Separation:
    """How far the second answer is from the first one, which is true.

    Parameters
    ----------
    given
        Model to which the answers are added.
    answers, places
        The right answer and the wrong one, and which they are.
    contexts
        Of a session, (n,).
    offset_cm
        Standard deviation of what runs differ by: placements of the target, and offsets that were found.
    rng
        Draws the readings.
    other_runs
        Runs of the old readings, if they go in.
    """
    truth, alternative = answers
    columns: dict[str, Any] = dict(contexts)
    reading_cm = truth.model.sample(columns, rng)
    columns[PREVIOUS] = previous(columns, reading_cm)
    prepared = Prepared.of(given, columns, reading_cm)
    right = refit(prepared, truth.terms, truth.base)
    start = max((alternative.base, right.base), key=lambda base: prepared.log_likelihood(base, alternative.terms))
    wrong = refit(prepared, alternative.terms, start)
    nats = max(right.log_likelihood - wrong.log_likelihood, 0.0) / reading_cm.size
    right_rows, wrong_rows = prepared.at(right.base, right.effects), prepared.at(wrong.base, wrong.effects)
    sigma_cm = np.broadcast_to(right_rows.sigma_cm, reading_cm.shape)
    shift = np.nan_to_num((right_rows.centre_cm - wrong_rows.centre_cm) / sigma_cm)
    unit = numbered(columns["run"])
    counts = np.bincount(unit)
    # Offsets hide shifts alone, not a wider scatter. A shift of many sigma makes a reading an outlier, and counts for
    # less than its square.
    whole = float((shift**2).sum())
    of_shifts = min(0.5 * whole / reading_cm.size, nats)
    between = of_shifts * float((np.bincount(unit, shift) ** 2 / counts).sum()) / max(whole, 1e-12)
    offsets = offset_cm**2 / float(np.mean(sigma_cm**2))
    correlation = given.sensor.reading_model.correlation
    scatter = None
    if alternative.answer.name is not None:
        gain = right.here.log_p - wrong.here.log_p
        of_run = np.bincount(unit, gain) / counts
        random = float(np.mean(np.var(gain) / counts))
        scatter = max(float(np.var(of_run)) - random, 0.0) / max(float(np.var(gain)), 1e-12)
    return Separation(*places, nats - between, between, offsets, correlation, scatter, other_runs)


def needed_nats(power: float, threshold_nats: float) -> float:
    """Expected nats D at which the ratio, about normal with mean D and variance 2 D, passes a threshold this often.

    Examples
    --------
    >>> print(f"{needed_nats(0.95, 5.0):.1f}")
    13.6
    """
    z = float(norm.ppf(power))
    return ((z * sqrt(2.0) + sqrt(2.0 * z * z + 4.0 * threshold_nats)) / 2.0) ** 2


def power_of(nats: float, threshold_nats: float) -> float:
    """How often the ratio passes the threshold; `needed_nats` backwards."""
    return float(norm.cdf((nats - threshold_nats) / sqrt(2.0 * nats))) if nats > 0.0 else 0.0


def threshold_nats(truth: FittedAnswer, alternative: FittedAnswer) -> float:
    """What the new readings have to say for the right answer: to name it, and what the old ones say against it."""
    if alternative.answer.name is None:
        return FIND_NATS
    against = 0.0
    if truth.log_likelihood is not None and alternative.log_likelihood is not None:
        against = alternative.log_likelihood - truth.log_likelihood
    return rules.ALTERNATIVE_NATS + float(np.clip(against, 0.0, rules.ALTERNATIVE_NATS))
