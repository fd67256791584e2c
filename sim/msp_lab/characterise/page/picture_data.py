"""Which rows of the measured readings a picture is made of, and why there are none.

Measured data and the sensor model enter; arrays for the drawing functions leave, or `Absent` with the reason.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from matplotlib.figure import Figure

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.draw.errors import Errors
from msp_lab.characterise.page.text import plus, sentence
from msp_lab.characterise.points import PointReadings, conditions, sort_into_points
from msp_lab.characterise.reference import ReferenceNumbers
from msp_range.arrays import Array, Flags, Texts
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData

Part = TypeVar("Part")

CONDITIONS = {
    "baseline": "the baseline (nothing varied)",
    "maximum_range": "the maximum range",
    "field_of_view": "the field of view",
    "material": "the target's material",
    "temperature": "the temperature",
    "vibration": "vibration",
    "crosstalk_simultaneous": "two sensors that ping at once",
    "crosstalk_sequential": "two sensors that ping in turn",
    "external_interference": "external ultrasound",
    "temperature_compensation": "temperature compensation",
}
"""Experiments of a campaign by their word in the column `condition`, and how a sentence calls them."""


class Absent(Exception):
    """The data do not allow this picture; the message gives the reason and what is needed."""


def needed(part: Part | None, findings: Findings, name: str) -> Part:
    """Return a part of the findings.

    Raises
    ------
    Absent
        These data do not give it, with the reason that the findings have.
    """
    if not part:
        raise Absent(sentence(findings.absent.get(name, f"the findings have no {name.replace('_', ' ')}")))
    return part


@dataclass(frozen=True)
class Drawn:
    """A picture before it is turned into bytes: figure, caption, and what it shows in a sentence."""

    figure: Figure
    caption: str
    alternative: str


@dataclass(frozen=True)
class PictureData:
    """What pictures are drawn from: measured data in which a column that the file lacks is NaN or ""."""

    data: MeasuredData
    """The readings."""
    model: SensorModel
    """The sensor model with the fitted numbers."""
    reference: ReferenceNumbers | None = None
    """Earlier numbers to mark next to the new ones; None: nothing is marked."""

    @cached_property
    def true_cm(self) -> Array:
        """True ranges [cm]."""
        return self.data.column("true_range_cm")

    @cached_property
    def reading_cm(self) -> Array:
        """Readings [cm]."""
        return self.data.column("reading_cm")

    @cached_property
    def sensor(self) -> Texts:
        """Names of the sensors."""
        return self.data.column("sensor")

    @cached_property
    def _points(self) -> list[PointReadings]:
        return sort_into_points(self.data, self.model)

    @cached_property
    def missed(self) -> Flags:
        """Rows without an answer, and those that read a code for no echo, as the analyses take them."""
        missed = np.ones(len(self.data), dtype=bool)
        for point in self._points:
            missed[point.rows] = ~point.is_echo
        return missed

    @cached_property
    def level(self) -> Texts:
        """What each row's experiment varies, as a word."""
        level = np.full(len(self.data), "", dtype="<U48")
        for point in self._points:
            level[point.rows] = point.level
        return level

    @cached_property
    def apparent_cm(self) -> Array:
        """True ranges in the centimetres of a sensor that assumes its calibration temperature [cm].

        Where the air's temperature is unknown, the true range as it is. A calibration in the sensor model comes on top.
        """
        apparent_cm = self.true_cm.copy()
        for point in self._points:
            apparent_cm[point.rows] = point.apparent_cm
        return apparent_cm

    @cached_property
    def _condition(self) -> Texts:
        return conditions(self.data)

    def of(self, condition: str) -> Flags:
        """Rows of an experiment that have a true range.

        Raises
        ------
        Absent
            There are none.
        """
        known = np.isfinite(self.true_cm)
        if not np.any(known):
            raise Absent("No row has a true range (column true_range_cm).")
        rows = known & (self._condition == condition)
        if not np.any(rows):
            what = CONDITIONS.get(condition, condition)
            hint = "" if "condition" in self.data else " (there is no column condition with the experiment)"
            raise Absent(f"No readings of {what} are in the data{hint}.")
        return np.asarray(rows)

    def errors(self, rows: Flags, label: str = "", reading_cm: Array | None = None) -> Errors:
        """Errors of some rows, for drawing.

        Parameters
        ----------
        rows
            Mask, with at least one row.
        label
            Whose they are.
        reading_cm
            In place of the readings as the sensor gave them [cm].
        """
        if not np.any(rows):
            raise Absent("No such readings are in the data.")
        reading_cm = self.reading_cm if reading_cm is None else reading_cm
        missed = self.missed[rows]
        error_cm = np.where(missed, np.nan, reading_cm[rows] - self.true_cm[rows])
        return Errors(label, self.true_cm[rows], error_cm, missed)


Maker = Callable[[Findings, PictureData], Drawn]
"""Draws a picture; raises `Absent` where the data do not allow it."""

Entry = tuple[str, str, Maker]
"""Name of the file, title, and what makes the picture."""


def summary(errors: Errors) -> str:
    """Count, mean error of the bulk and missed readings of a picture, in a sentence."""
    echoes = errors.error_cm[~errors.missed]
    n = errors.error_cm.size
    missed = int(np.count_nonzero(errors.missed))
    ranges = np.unique(errors.true_range_cm).size
    text = f"{n:,} readings at {ranges} range{'s' if ranges != 1 else ''}; "
    text += f"missed: {missed:,} ({100.0 * missed / n:.2g} %)" if missed else "none missed"
    if echoes.size:
        text += (
            f"; {'of the rest ' if missed else ''}median error {plus(float(np.median(echoes)))} cm, 95 % from "
            f"{plus(float(np.quantile(echoes, 0.025)))} to {plus(float(np.quantile(echoes, 0.975)))} cm"
        )
    return text + "."


def placement_error_cm(findings: Findings, condition: str, true_range_cm: float) -> float:
    """Return the mean placement error of a condition at a range [cm]; 0 where unknown."""
    set_ups = () if findings.mixture is None else findings.mixture.set_ups
    found = [
        each.error_cm
        for each in set_ups
        if each.condition == condition and math.isclose(each.true_range_cm, true_range_cm)
    ]
    return sum(found) / len(found) if found else 0.0
