"""The findings of a characterisation: values only, for the model file, the terminal, the page and other programs.

The analyses make these; nothing here computes or draws. Every interval is a 95 % one unless its field says otherwise,
errors are reading minus truth (a positive one reads too far), and None is 'not known from these data'. `as_json` turns
all of it into plain JSON.
"""

import json
from dataclasses import asdict, dataclass, field

from msp_lab.characterise.findings.accuracy import (
    Baseline,
    CalibrationFindings,
    Form,
    HeldOut,
    Knot,
    MaximumRange,
    Peak,
)
from msp_lab.characterise.findings.beam import AnglePoint, BreakawayAngle, FieldOfView, Oblique, SonarFit, SonarRow
from msp_lab.characterise.findings.estimate import IntervalEstimate
from msp_lab.characterise.findings.mixture import Mixture, MixtureParameter, PlacementError
from msp_lab.characterise.findings.points import PointResult
from msp_lab.characterise.findings.questions import FactorEffect, Metric, Question, Verdict
from msp_lab.characterise.findings.temperature import AirBefore, CompensationRow, HotBox, HotBoxRow
from msp_lab.readings.intake import SourceFile


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
