"""Which rows of the measured readings a picture is made of, or `Absent` with the reason why there are none."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np

from msp_lab.characterise.experiments import EXPERIMENTS
from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.errors import Errors
from msp_lab.characterise.points import PointReadings, sort_into_points
from msp_range.arrays import Array, Column, Flags, Texts
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData
from msp_sim.page.page import Absent
from msp_sim.page.text import counted, plus, sentence

Part = TypeVar("Part")


@dataclass(frozen=True)
class ReferenceNumbers:
    """An earlier characterisation of the same sensor, which pictures and comparisons set next to the new one.

    The laboratory has one, the MB1242 characterization report (`msp_lab.comparison.report`). Findings never depend on
    it. An empty one, whose numbers are NaN and whose tables have no rows, marks nothing.
    """

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


@dataclass(frozen=True)
class PictureData:
    """What pictures are drawn from; columns of the data that its file lacks are NaN or ""."""

    findings: Findings
    data: MeasuredData
    """The readings that they were found in."""
    model: SensorModel
    """The sensor model with the fitted numbers."""
    reference: ReferenceNumbers = field(default_factory=ReferenceNumbers)
    """Earlier numbers to mark next to the new ones."""
    of_analysis: Sequence[PointReadings] | None = None
    """The readings as the analyses sorted them; None: they are sorted here."""

    @property
    def true_cm(self) -> Array:
        return self.data.column("true_range_cm")

    @property
    def reading_cm(self) -> Array:
        return self.data.column("reading_cm")

    @cached_property
    def missed(self) -> Flags:
        """Rows without an answer, and those that read a code for no echo, as the analyses take them."""
        return self._of_points(np.ones(len(self.data), dtype=bool), lambda point: ~point.is_echo)

    @cached_property
    def level(self) -> Texts:
        """What each row's experiment varies, as a word."""
        return self._of_points(np.full(len(self.data), "", dtype="<U64"), lambda point: point.level)

    @cached_property
    def condition(self) -> Texts:
        """Each row's experiment; "" without a true range."""
        return self._of_points(np.full(len(self.data), "", dtype="<U64"), lambda point: point.condition)

    @cached_property
    def points(self) -> list[PointReadings]:
        """The rows that have a true range, as the analyses sort them."""
        if self.of_analysis is None:
            return sort_into_points(self.data, self.model)
        return [replace(each, sensor_model=self.model) for each in self.of_analysis]

    def _of_points(self, column: Column, value: Callable[[PointReadings], Any]) -> Column:
        """A column with each point's value in its rows."""
        for point in self.points:
            column[point.rows] = value(point)
        return column

    def needed(self, part: Part | None, name: str) -> Part:
        """Return a part of the findings; `Absent` with their reason where these data do not give it."""
        if not part:
            why = self.findings.absent.get(name, f"the findings have no {name.replace('_', ' ')}")
            raise Absent(sentence(why))
        return part

    def of(self, condition: str) -> Flags:
        """Rows of an experiment that have a true range; `Absent` where there are none."""
        if not self.points:
            raise Absent("No row has a true range (column true_range_cm).")
        if not self.has(condition):
            hint = "" if "condition" in self.data else " (there is no column condition with the experiment)"
            raise Absent(f"No readings of {EXPERIMENTS[condition].called} are in the data{hint}.")
        return np.asarray(self.condition == condition)

    def has(self, condition: str) -> bool:
        """Whether there are rows of an experiment that have a true range."""
        return bool(np.any(self.condition == condition))

    def errors(self, rows: Flags, label: str = "", reading_cm: Array | None = None) -> Errors:
        """Errors of some rows, of the sensor's readings or of these [cm]; `Absent` where there are no such rows."""
        if not np.any(rows):
            raise Absent("No such readings are in the data.")
        reading_cm = self.reading_cm if reading_cm is None else reading_cm
        missed = self.missed[rows]
        error_cm = np.where(missed, np.nan, reading_cm[rows] - self.true_cm[rows])
        return Errors(label, self.true_cm[rows], error_cm, missed)


def summary(errors: Errors) -> str:
    """Count, median error of the bulk and missed readings of a picture, in a sentence."""
    echoes = errors.error_cm[~errors.missed]
    n, missed = errors.missed.size, int(np.count_nonzero(errors.missed))
    text = f"{n:,} readings at {counted(np.unique(errors.true_range_cm).size, 'range')}; "
    text += f"missed: {missed:,} ({100.0 * missed / n:.2g} %)" if missed else "none missed"
    if echoes.size:
        low, middle, high = map(plus, np.quantile(echoes, [0.025, 0.5, 0.975]))
        text += f"; {'of the rest ' if missed else ''}median error {middle} cm, 95 % from {low} to {high} cm"
    return text + "."
