"""The findings of a characterisation: values only, for the model file, the terminal, the page and other programs.

The analyses make these; nothing here computes or draws. Every interval is a 95 % one unless its field says otherwise,
errors are reading minus truth (a positive one reads too far), and None is 'not known from these data'. `as_json` turns
all of it into plain JSON. What was found at single points, of the beam and of what was varied has files of its own:
`point_findings.py`, `beam_findings.py`, `question_findings.py`.
"""

import json
from dataclasses import asdict, dataclass, field
from typing import Literal

from msp_lab.characterise.beam_findings import FieldOfView, SonarFit
from msp_lab.characterise.point_findings import IntervalEstimate, PointResult
from msp_lab.characterise.question_findings import CompensationRow, HotBox, Question
from msp_lab.readings.intake import SourceFile

Form = Literal["none", "offset and scale", "piecewise linear"]
"""Forms of a calibration, from the simplest."""


@dataclass(frozen=True)
class Baseline:
    """Accuracy on the axis with nothing varied."""

    points: tuple[PointResult, ...]
    """By range."""
    bias: IntervalEstimate
    """Mean error over the points, which are the unit [cm]."""
    spread: IntervalEstimate
    """Of readings about their point's mean, without the rounding [cm]."""
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
    """Of the calibration."""
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
    """Why this form, in a sentence."""
    bias: IntervalEstimate
    offset: IntervalEstimate | None
    scale: IntervalEstimate | None
    """Mean error [cm]; reading at no range [cm] and reading a true centimetre of the straight line. Points are the
    unit: their scatter about the line is in the intervals."""
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
    """Where."""
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
    """How many were fitted."""
    log_likelihood: float
    """At the fit."""
    pit_counts: tuple[int, ...]
    """Histogram of the randomised probability integral transform over [0, 1] in equal bins; flat where the model
    fits."""
    pit_p_value: float | None
    """Of uniformity; a small one means that the model does not fit. None: too few readings for it."""
    conditional: str
    """What depends on range, and why, in a sentence."""
    notes: tuple[str, ...] = ()
    """What to know of these numbers."""
    set_ups: tuple[PlacementError, ...] = ()
    """Set-ups that were fitted about their own mean, with its distance from the calibration."""


@dataclass(frozen=True)
class Findings:
    """All findings. A part that the data do not allow is None or empty, and `absent` has the reason."""

    sensor: str
    """Name of the part."""
    date: str
    """Of the characterisation, ISO 8601."""
    calibration_temperature_c: float | None
    """Air temperature that the sensor assumes [deg C]; None for light and radio, whose ranges are not the air's."""
    sources: tuple[SourceFile, ...]
    """The data."""
    points: tuple[PointResult, ...]
    """All set-ups."""
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
    """Warnings about the use of these numbers."""


def as_json(findings: Findings) -> str:
    """The findings as JSON text, keys as the attributes here.

    Examples
    --------
    >>> nothing = Findings("MB1242", "2026-10-05", 22.5, (), (), absent={"mixture": "no true_range_cm"})
    >>> print(as_json(nothing)[:40].replace(chr(10), " "))
    {   "sensor": "MB1242",   "date": "2026-
    """
    return json.dumps(asdict(findings), indent=2, allow_nan=False)
