"""Which readings a picture is made of, or `Absent` with the reason why there are none."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import attrgetter
from typing import TypeVar

import numpy as np

from msp_lab.characterise.experiments import EXPERIMENTS
from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.errors import Errors
from msp_lab.characterise.points import PointReadings
from msp_range.arrays import Array, Column
from msp_range.reading_model.sensor_model import SensorModel
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
    largest_error_cm: float = math.nan
    """Largest error on the axis with nothing varied [cm]."""
    peak_range_cm: float = math.nan
    peak_cm: float = math.nan
    """True range of the readings at the longest range, and where their histogram has its peak [cm]."""
    half_angle_deg: Mapping[float, float] = field(default_factory=dict)
    """Range [cm] -> largest angle with a reliable range [deg]."""
    mean_error_cm: Mapping[float, tuple[float, float]] = field(default_factory=dict)
    """Range [cm] -> mean error without and with temperature compensation [cm]."""

    def mean_errors_at(self, range_cm: float) -> tuple[float, float] | None:
        """Mean error without and with compensation within a centimetre of a range [cm]; None where it has none."""
        return next((self.mean_error_cm[at_cm] for at_cm in self.mean_error_cm if abs(at_cm - range_cm) < 1.0), None)


@dataclass(frozen=True)
class PictureData:
    """What pictures are drawn from."""

    findings: Findings
    points: Sequence[PointReadings]
    """The readings that they were found in, as the analyses sorted them."""
    model: SensorModel
    """The sensor model with the fitted numbers."""
    reference: ReferenceNumbers = field(default_factory=ReferenceNumbers)
    """Earlier numbers to mark next to the new ones."""

    def needed(self, part: Part | None, name: str) -> Part:
        """Return a part of the findings; `Absent` with their reason where these data do not give it."""
        if not part:
            why = self.findings.absent.get(name, f"the findings have no {name.replace('_', ' ')}")
            raise Absent(sentence(why))
        return part

    def of(self, condition: str) -> list[PointReadings]:
        """The points of an experiment; `Absent` where there are none."""
        if not self.points:
            raise Absent("No row has a true range (column true_range_cm).")
        found = [point for point in self.points if point.condition == condition]
        if not found:
            raise Absent(f"No readings of {EXPERIMENTS[condition].called} are in the data (column condition).")
        return found


def in_order(points: Sequence[PointReadings], column: Callable[[PointReadings], Column]) -> Column:
    """A column of the readings of some points, at least one, in the order in which they came."""
    order = np.argsort(np.concatenate([point.rows for point in points]))
    return np.concatenate([column(point) for point in points])[order]


def errors_of(
    points: Sequence[PointReadings],
    label: str = "",
    error_cm: Callable[[PointReadings], Array] = attrgetter("error_cm"),
) -> Errors:
    """Errors of the readings of some points, at least one: those as read, or others [cm]."""
    missed = ~in_order(points, lambda point: point.is_echo)
    errors_cm = np.where(missed, np.nan, in_order(points, error_cm))
    return Errors(label, in_order(points, lambda point: point.true_range_cm), errors_cm, missed)


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
