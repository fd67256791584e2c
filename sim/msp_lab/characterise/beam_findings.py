"""What was found of the beam: angles with a reliable range, and the sonar equation through them; values only."""

from dataclasses import dataclass
from typing import Literal

from msp_lab.characterise.point_findings import IntervalEstimate


@dataclass(frozen=True)
class AnglePoint:
    """Readings at one range and one signed angle."""

    range_cm: float
    incidence_deg: float
    readings: int
    reliable: IntervalEstimate
    """Share of the readings that are of the wall, with its interval."""
    is_reliable: bool
    """By the criterion of `FieldOfView`, at this angle alone."""
    reading: IntervalEstimate | None
    """Mean of those readings [cm]; None without any."""
    slant_cm: float
    nearest_cm: float
    """Its value by the two hypotheses, after the calibration."""


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
    """How many parameters for how many points."""
