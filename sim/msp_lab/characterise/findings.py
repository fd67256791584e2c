"""The findings of a characterisation: values only, for the model file, the terminal, the page and other programs.

The analyses make these; nothing here computes or draws. Every interval is a 95 % one unless its field says otherwise,
errors are reading minus truth (a positive one reads too far), and None is 'not known from these data'. `as_json` turns
all of it into plain JSON. What was found at single points is in `point_findings.py`.
"""

import json
from dataclasses import asdict, dataclass, field
from typing import Literal

from msp_lab.characterise.point_findings import PointResult
from msp_lab.estimates import IntervalEstimate
from msp_lab.readings.intake import SourceFile

Form = Literal["none", "offset and scale", "piecewise linear"]
"""Forms of a calibration, from the simplest."""


@dataclass(frozen=True)
class Baseline:
    """Accuracy on the axis with nothing varied."""

    points: tuple[PointResult, ...]
    """Set-ups, sorted by range."""
    bias: IntervalEstimate
    """Mean error over the points, which are the unit [cm]."""
    spread: IntervalEstimate
    """Standard deviation of readings about their point's mean, without the rounding [cm]."""
    between_points: IntervalEstimate | None
    """Standard deviation of the points' mean errors about the straight line, beyond what the scatter of readings
    explains [cm]: how well ranges were set up, and how far the sensor is from linear; these data cannot part them."""
    missed: IntervalEstimate
    outliers: IntervalEstimate
    """Shares of all readings."""
    largest_error_cm: float
    largest_hit_error_cm: float
    """Largest error of a reading that is no code, and of a hit, signed."""


@dataclass(frozen=True)
class MeasuredKnot:
    """True range and the mean reading there [cm]; of sound, in air of the sensor's calibration temperature."""

    true_cm: float
    reading_cm: float


@dataclass(frozen=True)
class HeldOut:
    """How well a form of calibration fitted without some points predicts them."""

    form: Form
    rms_cm: float
    """Root mean square error over the points left out in turn [cm]."""
    gain: IntervalEstimate | None
    """Mean square error that it takes off the form that was kept before it [cm^2], by points; None for the first."""


@dataclass(frozen=True)
class CalibrationFindings:
    """Readings against the reference."""

    form: Form
    knots: tuple[MeasuredKnot, ...]
    """What the model file gets: nothing, a straight line (two knots) or a piecewise linear one."""
    reason: str
    bias: IntervalEstimate
    offset: IntervalEstimate | None
    scale: IntervalEstimate | None
    """Mean error [cm]; reading at no range [cm] and reading a true centimetre of the straight line, both None with
    fewer than three ranges. Points are the unit: their scatter about the line is in the intervals."""
    spread: IntervalEstimate
    """Standard deviation of readings about their point's mean, before rounding [cm]."""
    resolution: IntervalEstimate
    """Step of the readings, and its evidence in `resolution_note`."""
    resolution_note: str
    linearity: IntervalEstimate | None
    """Largest distance of a point's mean from the straight line [cm], and in `linearity_noise_floor_cm` what the
    scatter of readings and the stated error of the placements reach in 95 % of cases."""
    linearity_noise_floor_cm: float | None
    reference_std_cm: float | None
    """Standard deviation of the reference itself as its owner states it [cm]; None: not stated."""
    held_out: tuple[HeldOut, ...]
    """The forms tried and how each did on ranges that it had not seen."""
    held_out_unit: str
    """What was left out in turn: "range", or "range and run" where runs hold several ranges each."""
    true_cm: tuple[float, ...]
    reading_cm: tuple[float, ...]
    reading_std_cm: tuple[float, ...]
    """The points' data: apparent true range, mean of the hits, standard error of their difference as far as the
    readings and the stated error of the placement say it."""
    set_up_offset: IntervalEstimate | None = None
    """Standard deviation between set-ups about the calibration, beyond the scatter of readings and the stated error of
    their true ranges [cm]: an offset of the sensor that differs from one session to the next. None: not stated."""


@dataclass(frozen=True)
class Peak:
    """A peak of a histogram of readings: where, and the share of all readings within it."""

    reading_cm: float
    share: float


@dataclass(frozen=True)
class MaximumRange:
    """Readings at the longest range, with missed ones and without."""

    true_range_cm: float
    readings: int
    histogram: tuple[tuple[int, int], ...]
    """(reading [cm], count) of all answers."""
    no_echo: int
    saturated: int
    """Counts of 765 and 255, which are masked."""
    peaks_before: tuple[Peak, ...]
    peaks_after: tuple[Peak, ...]
    """Peaks of the histogram, the largest first."""
    peak: IntervalEstimate
    """Where the masked histogram has its peak [cm]: the most frequent reading, and those not significantly rarer."""


@dataclass(frozen=True)
class MixtureParameter:
    """One parameter of the fitted mixture: its name in the sensor model file, and the starting model's value.

    `at_bound` marks a value at the end of what it can be: the model has its bound or its floor, and not an estimate.
    """

    name: str
    fitted: IntervalEstimate
    before: float | None
    at_bound: bool = False


@dataclass(frozen=True)
class PlacementError:
    """How far the hits of one set-up are from where calibration and reference expect them [cm]."""

    condition: str
    run: str
    true_range_cm: float
    error_cm: float


@dataclass(frozen=True)
class Mixture:
    """The mixture of Thrun fitted by maximum likelihood (Probabilistic Robotics, section 6.3)."""

    parameters: tuple[MixtureParameter, ...]
    """In the order of the sensor model file."""
    readings: int
    log_likelihood: float
    """Number of readings that were fitted, and their log likelihood at the fit."""
    pit_counts: tuple[int, ...]
    """Histogram of the randomised probability integral transform over [0, 1] in equal bins; flat where the model
    fits."""
    pit_p_value: float | None
    """p-value of uniformity; a small one means that the model does not fit. None: too few readings for it."""
    shares: dict[str, float]
    """Mean share of each kind over these readings, each at its own range; rows without an answer are none of them."""
    conditional: str
    """What depends on range, and why, in a sentence."""
    notes: tuple[str, ...] = ()
    set_ups: tuple[PlacementError, ...] = ()
    """Set-ups that were fitted about their own mean, with its distance from the calibration."""


@dataclass(frozen=True)
class AnglePoint:
    """Readings at one range and one signed angle."""

    range_cm: float
    incidence_deg: float
    readings: int
    reliable: IntervalEstimate
    """Share of the readings that are of the wall, with its interval."""
    is_reliable: bool
    """Whether it fulfils the criterion of `FieldOfView`, at this angle alone."""
    reading: IntervalEstimate | None
    """Mean of those readings [cm]; None without any."""
    slant_cm: float
    nearest_cm: float
    """Mean reading that the two hypotheses expect, after the calibration."""


@dataclass(frozen=True)
class BreakawayAngle:
    """Largest angle with a reliable range, to either side and as one half angle."""

    range_cm: float
    negative: IntervalEstimate | None
    positive: IntervalEstimate | None
    """Each side's last reliable angle, as a positive number [deg]; the breakaway lies between it and the next one that
    was tried. The interval goes from the last angle before a likely step in the share of readings of the wall to the
    first one behind (profile of the binomial likelihood); its upper end is None where that was not tried."""
    half_angle: IntervalEstimate
    """The smaller side's, which the model file gets."""


@dataclass(frozen=True)
class Oblique:
    """Whether a tilted sensor reads along its axis or to the nearest point."""

    verdict: Literal["slant", "nearest", "unknown"]
    """For `oblique_reading`. The nearer of the two where its interval leaves no doubt which that is."""
    share_of_slant: IntervalEstimate | None
    """Slope of (reading - perpendicular) over (slant - perpendicular): 1 is the slant range, 0 the nearest point."""
    slant_rms_cm: float | None
    nearest_rms_cm: float | None
    reason: str


@dataclass(frozen=True)
class FieldOfView:
    """Breakaway angles."""

    criterion: str
    points: tuple[AnglePoint, ...]
    angles: tuple[BreakawayAngle, ...]
    oblique: Oblique


@dataclass(frozen=True)
class SonarRow:
    """A measured half angle, the fitted equation's, and the one that the other rows predict [deg]; None: no echo."""

    range_cm: float
    measured_deg: float
    fitted_deg: float | None
    left_out_deg: float | None


@dataclass(frozen=True)
class SonarFit:
    """The sonar equation through the breakaway angles."""

    source_level_db: float
    piston_diameter_m: float
    gain_db_per_m: float
    rows: tuple[SonarRow, ...]
    beyond: tuple[tuple[float, float], ...]
    """(range [cm], half angle [deg]) at longer ranges, as the bridge will use it."""
    within_a_step: bool
    """Every fitted angle is within the motor's step of the measured one."""
    note: str
    """Number of parameters, and of points that they were fitted to."""


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
VERDICTS: tuple[Verdict, ...] = ("matters", "cannot tell", "does not matter")
"""Verdicts; that of several effects together is the first of these that one of them has."""
NAMES: dict[Metric, str] = {
    "bias": "mean error",
    "spread": "spread",
    "missed": "odds of a missed echo",
    "outliers": "odds of an outlier",
}
"""How sentences, tables and pictures call what a factor may change; all but the first are compared as ratios."""


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
    """p-value of no effect, and that after Holm over all effects that were asked for."""
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
    """A question of the form 'does this factor change the readings?', and its answer."""

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
    effects: tuple[FactorEffect, ...] = ()
    """Bias, spread, missed, outliers, in this order; none before they are computed."""
    verdict: Verdict = "cannot tell"
    """"matters" if one effect does, "does not matter" if none does, else "cannot tell"."""
    answer: str = ""
    points: tuple[PointResult, ...] = ()
    reference_points: tuple[PointResult, ...] = ()
    """What was compared."""

    @property
    def compared(self) -> str:
        """What is compared with what, in words."""
        return f"{self.level} against {self.reference}"


@dataclass(frozen=True)
class Findings:
    """All findings. A part that the data do not allow is None or empty, and `absent` has the reason."""

    sensor: str
    date: str
    """Name of the part, and date of the characterisation, ISO 8601."""
    calibration_temperature_c: float | None
    """Air temperature that the sensor assumes [deg C]; None where the air does not change its readings: of light,
    radio, and sound if the sensor compensates itself."""
    sources: tuple[SourceFile, ...]
    points: tuple[PointResult, ...]
    """The data, and all set-ups in them."""
    baseline: Baseline | None = None
    calibration: CalibrationFindings | None = None
    mixture: Mixture | None = None
    maximum_range: MaximumRange | None = None
    field_of_view: FieldOfView | None = None
    sonar: SonarFit | None = None
    questions: tuple[Question, ...] = ()
    hot_boxes: tuple[HotBox, ...] = ()
    temperature_compensation: tuple[CompensationRow, ...] = ()
    absent: dict[str, str] = field(default_factory=dict)
    """Part -> why it is missing."""
    warnings: tuple[str, ...] = ()

    @property
    def readings(self) -> int:
        """How many readings the set-ups have: all with a true range."""
        return sum(point.readings for point in self.points)


def as_json(findings: Findings) -> str:
    """The findings as JSON text, keys as the attributes here.

    Examples
    --------
    >>> nothing = Findings("MB1242", "2026-10-05", 22.5, (), (), absent={"mixture": "no true_range_cm"})
    >>> print(as_json(nothing)[:40].replace(chr(10), " "))
    {   "sensor": "MB1242",   "date": "2026-
    """
    return json.dumps(asdict(findings), indent=2, allow_nan=False)
