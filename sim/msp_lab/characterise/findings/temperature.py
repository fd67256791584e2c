"""Air temperature: hot or cold air at the sensor, and compensation of the air's temperature."""

from dataclasses import dataclass
from typing import Literal

from msp_lab.characterise.findings.estimate import IntervalEstimate

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
