"""What was found at one point of the bench, and a number with its interval: values only, as in `findings.py`."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from msp_sim.intervals import Z


@dataclass(frozen=True)
class IntervalEstimate:
    """A number with its 95 % interval."""

    value: float
    low: float | None = None
    high: float | None = None
    """Ends of the interval; None where the data give none on that side."""
    unit: str = ""
    """Unit of all three; "" for a share or a ratio."""
    n: int = 0
    """Number of independent things it rests on, which `of` names."""
    of: str = "readings"
    """What was counted: "readings" or "points" (a point is one set-up: a range, an angle, a target)."""

    @classmethod
    def about(cls, value: float, half: float, n: int, of: str = "readings", unit: str = "cm") -> "IntervalEstimate":
        """A number with an interval that reaches as far to both sides."""
        return cls(value, value - half, value + half, unit, n, of)

    @property
    def ends(self) -> tuple[float, float]:
        """Ends of the interval; infinite where the data give none."""
        return -math.inf if self.low is None else self.low, math.inf if self.high is None else self.high

    @property
    def standard_error(self) -> float:
        """Standard error, where the interval is roughly symmetric; infinite without one."""
        low, high = self.ends
        return (high - low) / (2 * Z)

    def holds(self, value: float) -> bool:
        """Whether a value is within the interval; an end that is not known is no limit."""
        low, high = self.ends
        return low <= value <= high

    def mapped(self, change: Callable[[float], float]) -> "IntervalEstimate":
        """The estimate and both ends of its interval changed by a rising function."""
        low, high = (None if end is None else change(end) for end in (self.low, self.high))
        return replace(self, value=change(self.value), low=low, high=high)

    def words(self, form: str, unit: str = "") -> str:
        """The numbers in this format, and ``?`` for an end that is not known.

        Examples
        --------
        >>> IntervalEstimate(1.512, 1.06).words(".1f", " cm")
        '1.5 cm (1.1 to ?)'
        """
        low, high = ("?" if end is None else f"{end:{form}}" for end in (self.low, self.high))
        return f"{self.value:{form}}{unit} ({low} to {high})"

    def root(self, known: float = 0.0) -> "IntervalEstimate":
        """The standard deviation of this variance, without a part that is known."""
        return self.mapped(lambda end: math.sqrt(max(end - known, 0.0)))


@dataclass(frozen=True)
class SetUp:
    """What was set up on the bench, in the data's words."""

    condition: str
    """Experiment of the campaign, as the CSV form's column `condition` names it."""
    sensor: str
    run: str
    """Names of the sensor and the run in the data."""
    level: str
    """What the experiment varies, as a word: "concrete", "46 C", "60 Hz"; "" where nothing is varied."""


@dataclass(frozen=True)
class PointResult(SetUp):
    """One set-up of the bench and its readings."""

    true_range_cm: float
    incidence_deg: float | None
    air_temperature_c: float | None
    target_temperature_c: float | None
    """Means over the point; None where unknown."""
    readings: int
    """All rows; the next six add up to it."""
    hits: int
    """Readings of the surface: within a gate about the middle of the point's fullest 16 cm (`points.GATE_CM`)."""
    short: int
    long: int
    """Readings before and after the gate: of something else."""
    no_echo: int
    saturated: int
    no_answer: int
    """Readings of the maximum (765), of 255 where that cannot be the range, and rows without a reading."""
    error: IntervalEstimate | None
    spread: IntervalEstimate | None
    """Mean error of the hits [cm] and their standard deviation with the rounding taken out [cm]; their intervals
    contain the scatter of readings, not the error of the placement. None without hits."""
    compensated_error: IntervalEstimate | None
    """The mean error compensated for the air's temperature; None without one, and for light and radio."""
    worst_error_cm: float | None
    """Largest error of a reading that is no code, signed."""

    @property
    def place_cm(self) -> float:
        """The true range to a millimetre: points of the same one are compared."""
        return round(self.true_range_cm, 1)

    @property
    def missed(self) -> int:
        """Readings without an echo: codes, and rows without an answer."""
        return self.no_echo + self.saturated + self.no_answer

    @property
    def outliers(self) -> int:
        """Readings of something else than the surface."""
        return self.short + self.long
