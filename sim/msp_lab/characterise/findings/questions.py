"""Does it matter? Effects of what was varied, with a verdict for each."""

from dataclasses import dataclass
from typing import Literal

from msp_lab.characterise.findings.estimate import IntervalEstimate
from msp_lab.characterise.findings.points import PointResult

Metric = Literal["bias", "spread", "missed", "outliers"]
Verdict = Literal["matters", "does not matter", "cannot tell"]


@dataclass(frozen=True)
class FactorEffect:
    """What a factor does to one property of the readings.

    Attributes
    ----------
    metric
        "bias" (mean error of the hits, cm), "spread" (ratio of standard deviations), "missed" and "outliers" (odds
        ratios).
    estimate
        Size; no effect is 0 for the bias and 1 for a ratio. 95 % interval, not corrected for the number of questions.
    p_value, p_adjusted
        Of no effect, and after Holm over all effects that were asked for.
    bound
        What is small enough not to matter, in the estimate's unit: |bias| below it, a ratio within 1/bound to bound.
    verdict
        "matters": there is an effect by the adjusted p-value, and it may exceed the bound. "does not matter": its 90 %
        interval (two one-sided tests) lies within the bound. Else "cannot tell".
    smallest_detectable
        Effect that these data would have shown in 80 % of cases at the adjusted level; None: not even a metre or a
        thousandfold, or it is not known.
    """

    metric: Metric
    estimate: IntervalEstimate | None
    p_value: float | None
    p_adjusted: float | None
    bound: float
    verdict: Verdict
    smallest_detectable: float | None


@dataclass(frozen=True)
class Question:
    """Does it matter?

    Attributes
    ----------
    name
        material, temperature, vibration, crosstalk_simultaneous, crosstalk_sequential, external_interference.
    level, reference
        What is compared with what: "concrete" with "plywood", "60 Hz" with "0 Hz".
    sensor
        Whose readings; "" for all.
    pairs
        Points of equal range that were compared; the unit of the bias.
    effects
        bias, spread, missed, outliers, in this order.
    verdict
        "matters" if one effect does, "does not matter" if none does, else "cannot tell".
    answer
        In a sentence.
    points, reference_points
        What was compared.
    """

    name: str
    question: str
    level: str
    reference: str
    sensor: str
    pairs: int
    effects: tuple[FactorEffect, ...]
    verdict: Verdict
    answer: str
    points: tuple[PointResult, ...] = ()
    reference_points: tuple[PointResult, ...] = ()
