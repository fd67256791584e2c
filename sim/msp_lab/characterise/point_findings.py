"""What was found at one point of the bench: values only, as in `findings.py`."""

from dataclasses import dataclass

from msp_lab.estimates import IntervalEstimate


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
    """The mean error compensated for the air's temperature; None without one, and where the air does
    not change the readings."""
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
