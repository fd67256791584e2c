"""Numbers of an earlier characterisation of the same sensor, which pictures and comparisons set next to the new ones.

The laboratory has one, the MB1242 characterization report (`msp_lab.comparison.report`). Findings never depend on it.
An empty one, whose numbers are NaN and whose tables have no rows, marks nothing.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ReferenceNumbers:
    """An earlier characterisation."""

    name: str = ""
    """How sentences and legends call it: "the report"."""
    sensor: str = ""
    """Name of the sensor model that it is about."""
    largest_error_cm: float = math.nan
    """Largest error on the axis with nothing varied [cm]."""
    peak_range_cm: float = math.nan
    peak_cm: float = math.nan
    """True range of the readings at the longest range, and where their histogram has its peak [cm]."""
    half_angle_deg: Mapping[float, float] = field(default_factory=dict)
    """Range [cm] -> largest angle with a reliable range [deg]."""
    mean_error_cm: Mapping[float, tuple[float, float]] = field(default_factory=dict)
    """Range [cm] -> mean error without and with temperature compensation [cm]."""
    calibration_temperature_c: float = 20.0
    """Air temperature that its compensation takes the sensor to assume [deg C]."""
    answers: Mapping[str, str] = field(default_factory=dict)
    """Question (`findings.Question.name`) -> what it answers, in a sentence."""

    def mean_errors_at(self, range_cm: float) -> tuple[float, float] | None:
        """Mean error without and with compensation within a centimetre of a range [cm]; None where it has none."""
        return next((self.mean_error_cm[each] for each in self.mean_error_cm if abs(each - range_cm) < 1.0), None)
