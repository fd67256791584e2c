"""The findings of a characterisation: values only, for the model file, the terminal, the page and other programs.

The analyses make these; nothing here computes or draws. Every interval is a 95 % one unless its field says otherwise,
errors are reading minus truth (a positive one reads too far), and None is 'not known from these data'. `as_json` turns
all of it into plain JSON.
"""

import json
from dataclasses import asdict, dataclass, field
from typing import Literal

from msp_lab.readings.intake import SourceFile


@dataclass(frozen=True)
class IntervalEstimate:
    """A number with its 95 % interval.

    Attributes
    ----------
    value
        The estimate.
    low, high
        Ends of the interval; None where the data give none on that side.
    unit
        Of all three; "" for a share or a ratio.
    n
        How many independent things it rests on, which `of` names.
    of
        What was counted: "readings" or "points" (a point is one set-up: a range, an angle, a target).
    """

    value: float
    low: float | None
    high: float | None
    unit: str
    n: int
    of: str = "readings"

    @classmethod
    def about(cls, value: float, half: float, unit: str, n: int, of: str = "readings") -> "IntervalEstimate":
        """A number with an interval that reaches as far to both sides."""
        return cls(value, value - half, value + half, unit, n, of)


@dataclass(frozen=True)
class PointResult:
    """One set-up of the bench and its readings.

    Attributes
    ----------
    condition
        Experiment of the campaign, as the CSV form's column `condition` names it.
    sensor, run
        As in the data.
    level
        Of what the experiment varies, as a word: "concrete", "46 C", "60 Hz"; "" where nothing is varied.
    true_range_cm
        Of the reference.
    incidence_deg, air_temperature_c, target_temperature_c
        Means over the point; None where unknown.
    readings
        All rows; the next six add up to it.
    hits
        Readings of the surface: within a gate about the middle of the point's fullest 16 cm (`points.GATE_CM`).
    short, long
        Readings before and after the gate: of something else.
    no_echo, saturated, no_answer
        Readings of the maximum (765), of 255 where that cannot be the range, and rows without a reading.
    error, spread
        Mean error of the hits [cm] and their standard deviation with the rounding taken out [cm]; their intervals
        contain the scatter of readings, not the error of the placement. None without hits.
    compensated_error
        The mean error compensated for the air's temperature; None without an air temperature.
    worst_error_cm
        Largest error of a reading that is no code, signed.
    """

    condition: str
    sensor: str
    run: str
    level: str
    true_range_cm: float
    incidence_deg: float | None
    air_temperature_c: float | None
    target_temperature_c: float | None
    readings: int
    hits: int
    short: int
    long: int
    no_echo: int
    saturated: int
    no_answer: int
    error: IntervalEstimate | None
    spread: IntervalEstimate | None
    compensated_error: IntervalEstimate | None
    worst_error_cm: float | None


Form = Literal["none", "offset and scale", "piecewise linear"]
"""Forms of a calibration, from the simplest."""


@dataclass(frozen=True)
class Baseline:
    """Accuracy on the axis with nothing varied.

    Attributes
    ----------
    points
        By range.
    bias
        Mean error over the points, which are the unit [cm].
    spread
        Of readings about their point's mean, without the rounding [cm].
    between_points
        Standard deviation of the points' mean errors about the straight line, beyond what the scatter of readings
        explains [cm]: how well ranges were set up, and how far the sensor is from linear; these data cannot part them.
    missed, outliers
        Shares of all readings.
    largest_error_cm, largest_hit_error_cm
        Largest error of a reading that is no code, and of a hit, signed.
    """

    points: tuple[PointResult, ...]
    bias: IntervalEstimate
    spread: IntervalEstimate
    between_points: IntervalEstimate | None
    missed: IntervalEstimate
    outliers: IntervalEstimate
    largest_error_cm: float
    largest_hit_error_cm: float


@dataclass(frozen=True)
class Knot:
    """True range and the mean reading there [cm], in air of the sensor's calibration temperature."""

    true_cm: float
    reading_cm: float


@dataclass(frozen=True)
class HeldOut:
    """How well a form of calibration fitted without some points predicts them.

    Attributes
    ----------
    form
        Of the calibration.
    rms_cm
        Root mean square error over the points left out in turn [cm].
    gain
        Mean square error that it takes off the next simpler form [cm^2], by points; None for the simplest.
    """

    form: Form
    rms_cm: float
    gain: IntervalEstimate | None


@dataclass(frozen=True)
class CalibrationFindings:
    """Readings against the reference.

    Attributes
    ----------
    form, knots
        What the model file gets: nothing, a straight line (two knots) or a piecewise linear one.
    reason
        Why this form, in a sentence.
    bias, offset, scale
        Mean error [cm]; reading at no range [cm] and reading a true centimetre of the straight line. Points are the
        unit: their scatter about the line is in the intervals.
    spread
        Standard deviation of readings about their point's mean, before rounding [cm].
    resolution
        Step of the readings, and its evidence in `resolution_note`.
    linearity
        Largest distance of a point's mean from the straight line [cm], and in `linearity_noise_floor_cm` what the
        scatter of readings alone reaches in 95 % of cases.
    reference_std_cm
        Standard deviation of the reference itself as its owner states it [cm]; None: not stated.
    set_up_offset
        Standard deviation between set-ups about the calibration, beyond the scatter of readings and the stated error
        of their true ranges [cm]: an offset of the sensor that differs from one session to the next. None: not stated.
    held_out
        The forms tried and how each did on ranges that it had not seen.
    held_out_unit
        What was left out in turn: "range", or "range and run" where runs hold several ranges each.
    true_cm, reading_cm, reading_std_cm
        The points' data: apparent true range, mean of the hits, standard error of that mean.
    """

    form: Form
    knots: tuple[Knot, ...]
    reason: str
    bias: IntervalEstimate
    offset: IntervalEstimate | None
    scale: IntervalEstimate | None
    spread: IntervalEstimate
    resolution: IntervalEstimate
    resolution_note: str
    linearity: IntervalEstimate | None
    linearity_noise_floor_cm: float | None
    reference_std_cm: float | None
    held_out: tuple[HeldOut, ...]
    held_out_unit: str
    true_cm: tuple[float, ...]
    reading_cm: tuple[float, ...]
    reading_std_cm: tuple[float, ...]
    set_up_offset: IntervalEstimate | None = None


@dataclass(frozen=True)
class Peak:
    """A peak of a histogram of readings: where, and the share of all readings within it."""

    reading_cm: float
    share: float


@dataclass(frozen=True)
class MaximumRange:
    """Readings at the longest range, with missed ones and without.

    Attributes
    ----------
    true_range_cm
        Where.
    histogram
        (reading [cm], count) of all answers.
    no_echo, saturated
        Counts of 765 and 255, which are masked.
    peaks_before, peaks_after
        Peaks of the histogram, the largest first.
    peak
        Where the masked histogram has its peak [cm]: the most frequent reading, and those not significantly rarer.
    """

    true_range_cm: float
    readings: int
    histogram: tuple[tuple[int, int], ...]
    no_echo: int
    saturated: int
    peaks_before: tuple[Peak, ...]
    peaks_after: tuple[Peak, ...]
    peak: IntervalEstimate


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
    """The mixture of Thrun fitted by maximum likelihood (Probabilistic Robotics, section 6.3).

    Attributes
    ----------
    parameters
        In the order of the sensor model file.
    readings
        How many were fitted.
    log_likelihood
        At the fit.
    pit_counts
        Histogram of the randomised probability integral transform over [0, 1] in equal bins; flat where the model fits.
    pit_p_value
        Of uniformity; a small one means that the model does not fit. None: too few readings for it.
    conditional
        What depends on range, and why, in a sentence.
    notes
        What to know of these numbers.
    set_ups
        Set-ups that were fitted about their own mean, with its distance from the calibration.
    """

    parameters: tuple[MixtureParameter, ...]
    readings: int
    log_likelihood: float
    pit_counts: tuple[int, ...]
    pit_p_value: float | None
    conditional: str
    notes: tuple[str, ...] = ()
    set_ups: tuple[PlacementError, ...] = ()


@dataclass(frozen=True)
class AnglePoint:
    """Readings at one range and one signed angle.

    Attributes
    ----------
    reliable
        Share of the readings that are of the wall, with its interval.
    is_reliable
        By the criterion of `FieldOfView`.
    reading
        Mean of those readings [cm]; None without any.
    slant_cm, nearest_cm
        Its value by the two hypotheses, after the calibration.
    """

    range_cm: float
    incidence_deg: float
    readings: int
    reliable: IntervalEstimate
    is_reliable: bool
    reading: IntervalEstimate | None
    slant_cm: float
    nearest_cm: float


@dataclass(frozen=True)
class BreakawayAngle:
    """Largest angle with a reliable range, to either side and as one half angle.

    Attributes
    ----------
    negative, positive
        Each side's last reliable angle, as a positive number [deg]; the breakaway lies between it and the next one that
        was tried. The interval goes from the last angle before a likely step in the share of readings of the wall to
        the first one behind (profile of the binomial likelihood); its upper end is None where that was not tried.
    half_angle
        The smaller side's, which the model file gets.
    """

    range_cm: float
    negative: IntervalEstimate | None
    positive: IntervalEstimate | None
    half_angle: IntervalEstimate


@dataclass(frozen=True)
class Oblique:
    """Whether a tilted sensor reads along its axis or to the nearest point.

    Attributes
    ----------
    verdict
        For `oblique_reading`.
        The nearer of the two where its interval leaves no doubt which that is.
    share_of_slant
        Slope of (reading - perpendicular) over (slant - perpendicular): 1 is the slant range, 0 the nearest point.
    """

    verdict: Literal["slant", "nearest", "unknown"]
    share_of_slant: IntervalEstimate | None
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
    """The sonar equation through the breakaway angles.

    Attributes
    ----------
    beyond
        (range [cm], half angle [deg]) at longer ranges, as the bridge will use it.
    within_a_step
        Every fitted angle is within the motor's step of the measured one.
    note
        How many parameters for how many points.
    """

    source_level_db: float
    piston_diameter_m: float
    gain_db_per_m: float
    rows: tuple[SonarRow, ...]
    beyond: tuple[tuple[float, float], ...]
    within_a_step: bool
    note: str


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
    """A box of hot or cold air about the sensor.

    Attributes
    ----------
    box_c, room_c
        Air temperatures in the box and beyond.
    depth
        Length of the box's air that explains the shifts [cm].
    per_cent, uniform_per_cent
        Error in per cent of range as measured (slope) and as expected of that air all the way.
    best
        Which idea is nearest: "uniform", "gradient", "confined", or "none" where no shift is seen.
    """

    level: str
    box_c: float
    room_c: float
    room_is_assumed: bool
    depth: IntervalEstimate
    per_cent: IntervalEstimate
    uniform_per_cent: float
    rows: tuple[HotBoxRow, ...]
    best: AirBefore | Literal["none"]
    answer: str


@dataclass(frozen=True)
class CompensationRow:
    """Mean error at a range without and with temperature compensation [cm].

    Attributes
    ----------
    thermometer_c
        Air temperature that the compensation used; None: no thermometer, and no compensated error.
    implied_c
        The one air temperature that would bring the mean error to 0 with this calibration temperature.
    note
        What to know of this row; "": nothing.
    """

    range_cm: float
    uncompensated: IntervalEstimate
    compensated: IntervalEstimate | None
    thermometer_c: float | None
    implied_c: IntervalEstimate
    note: str


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


@dataclass(frozen=True)
class Findings:
    """All findings. A part that the data do not allow is None or empty, and `absent` has the reason.

    Attributes
    ----------
    sensor
        Name of the part.
    date
        Of the characterisation, ISO 8601.
    sources
        The data.
    points
        All set-ups.
    absent
        Part -> why it is missing.
    warnings
        Warnings about the use of these numbers.
    """

    sensor: str
    date: str
    calibration_temperature_c: float
    sources: tuple[SourceFile, ...]
    points: tuple[PointResult, ...]
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
    warnings: tuple[str, ...] = ()


def as_json(findings: Findings) -> str:
    """The findings as JSON text, keys as the attributes here.

    Examples
    --------
    >>> nothing = Findings("MB1242", "2026-10-05", 22.5, (), (), absent={"mixture": "no true_range_cm"})
    >>> print(as_json(nothing)[:40].replace(chr(10), " "))
    {   "sensor": "MB1242",   "date": "2026-
    """
    return json.dumps(asdict(findings), indent=2, allow_nan=False)
