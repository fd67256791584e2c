"""What was found by varying one thing: whether it matters, and what the temperature of the air does; values only."""

from dataclasses import dataclass
from typing import Literal

from msp_lab.characterise.point_findings import IntervalEstimate, PointResult

AirBefore = Literal["uniform", "gradient", "confined"]
"""How the air before a sensor in a box may be: like the box's all the way, changing all the way, or only near."""


@dataclass(frozen=True)
class HotBoxRow:
    """Error at a range with the air hot or cold at the sensor, against three ideas of where that air is [cm].

    `shift` is the mean error minus the one at room temperature where that was measured. `uniform_cm` is expected with
    the box's air all the way, `gradient_cm` with a linear fall to room temperature at the target, `confined_cm` with
    that air over `HotBox.depth` only.
    """

    range_cm: float
    shift: IntervalEstimate
    uniform_cm: float
    gradient_cm: float
    confined_cm: float


@dataclass(frozen=True)
class HotBox:
    """A box of hot or cold air about the sensor."""

    level: str
    box_c: float
    room_c: float
    """Air temperatures in the box and beyond."""
    room_is_assumed: bool
    depth: IntervalEstimate
    """Length of the box's air that explains the shifts [cm]."""
    per_cent: IntervalEstimate
    uniform_per_cent: float
    """Correction in per cent of range: what the readings call for (minus the slope of their shift), and what that air
    all the way would."""
    compared: Literal["as", "and not"]
    """Whether the first may be the second, as words of a sentence."""
    rows: tuple[HotBoxRow, ...]
    best: AirBefore | Literal["none"]
    """Which idea is nearest: "uniform", "gradient", "confined", or "none" where no shift is seen."""
    answer: str


@dataclass(frozen=True)
class CompensationRow:
    """Mean error at a range without and with temperature compensation [cm]."""

    range_cm: float
    uncompensated: IntervalEstimate
    compensated: IntervalEstimate | None
    thermometer_c: float | None
    """Air temperature that the compensation used; None: no thermometer, and no compensated error."""
    implied_c: IntervalEstimate
    """The one air temperature that would bring the mean error to 0 with this calibration temperature."""
    note: str
    """What to know of this row; "": nothing."""


Metric = Literal["bias", "spread", "missed", "outliers"]
Verdict = Literal["matters", "does not matter", "cannot tell"]
NAMES: dict[Metric, str] = {
    "bias": "bias",
    "spread": "spread",
    "missed": "odds of a missed echo",
    "outliers": "odds of an outlier",
}


@dataclass(frozen=True)
class FactorEffect:
    """What a factor does to one property of the readings."""

    metric: Metric
    """"bias" (mean error of the hits, cm), "spread" (ratio of standard deviations), "missed" and "outliers" (odds
    ratios)."""
    estimate: IntervalEstimate | None
    """Size; no effect is 0 for the bias and 1 for a ratio. 95 % interval, not corrected for the number of questions."""
    p_value: float | None
    p_adjusted: float | None
    """Of no effect, and after Holm over all effects that were asked for."""
    bound: float
    """What is small enough not to matter, in the estimate's unit: |bias| below it, a ratio within 1/bound to bound."""
    verdict: Verdict
    """"matters": there is an effect by the adjusted p-value, and it may exceed the bound. "does not matter": it is
    within the bound by two one-sided tests, after Holm. Else "cannot tell"."""
    smallest_detectable: float | None
    """Effect that these data would have shown in 80 % of cases at the adjusted level; None: not even a metre or a
    thousandfold, or it is not known."""

    @property
    def is_ratio(self) -> bool:
        """Whether no effect is 1, and not 0."""
        return self.metric != "bias"

    def mirrored(self, size: float) -> float:
        """An effect of this size in the other direction."""
        return 1.0 / size if self.is_ratio else -size


@dataclass(frozen=True)
class Question:
    """Does it matter?"""

    name: str
    """Its experiment, one of `experiments.QUESTIONS`."""
    question: str
    level: str
    reference: str
    """What is compared with what: "concrete" with "plywood", "60 Hz" with "0 Hz"."""
    sensor: str
    """Whose readings; "" for all."""
    pairs: int
    """Points of equal range that were compared; the unit of the bias."""
    effects: tuple[FactorEffect, ...]
    """Bias, spread, missed, outliers, in this order."""
    verdict: Verdict
    """"matters" if one effect does, "does not matter" if none does, else "cannot tell"."""
    answer: str
    """In a sentence."""
    points: tuple[PointResult, ...] = ()
    reference_points: tuple[PointResult, ...] = ()
    """What was compared."""
