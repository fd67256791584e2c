"""All analyses in order: loaded readings and a starting sensor model enter, findings and a new sensor model leave.

What the data do not allow is left as the starting model has it, and the findings say why.
"""

import difflib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from msp_lab.characterise.accuracy import baseline, heard_to_cm, maximum_range
from msp_lab.characterise.calibration import calibrate
from msp_lab.characterise.field_of_view import RELIABLE_SHARE, breakaway_rows, find_field_of_view, sonar_through
from msp_lab.characterise.findings import BreakawayAngle, CalibrationFindings, Findings
from msp_lab.characterise.mixture import FittedMixture, fit_mixture
from msp_lab.characterise.points import BASELINE, LEAST_HITS, PointReadings, sort_into_points
from msp_lab.characterise.questions import TOPICS, answer_questions
from msp_lab.characterise.temperature import compensation_table, hot_boxes
from msp_lab.readings.intake import LoadedReadings, SourceFile
from msp_range.correction.calibration import IDENTITY, Calibration
from msp_range.reading_model.sensor_model import BreakawayPoint, CalibrationKnot, MixtureParameters, SensorModel
from msp_range.recording.error import RecordingError

UNDISTURBED = (BASELINE, "maximum_range")
"""Experiments whose readings are of the sensor alone: what calibration and mixture are fitted to."""
COMPENSATION = "temperature_compensation"
SESSION_EFFECT = "run_offsets"
"""Of the simulator: the name of an offset that differs from session to session."""
NOT_ASKED = "no readings of this condition, or none at ranges to compare with"
KNOWN_CONDITIONS = {*UNDISTURBED, COMPENSATION, "field_of_view", *TOPICS}
FEW_READINGS = 20
"""Points with fewer readings than this are told of."""


@dataclass(frozen=True)
class Changes:
    """What a characterisation changes in a sensor model; None: the data did not say."""

    calibration: tuple[CalibrationKnot, ...] | None = None
    breakaway: tuple[BreakawayPoint, ...] | None = None
    oblique_reading: str | None = None
    heard_on_axis_cm: float | None = None
    reading_model: MixtureParameters | None = None
    effects: tuple[dict[str, Any], ...] | None = None


class Characterised(NamedTuple):
    """Findings, and what they change."""

    findings: Findings
    changes: Changes


def characterise(
    loaded: LoadedReadings,
    sensor: SensorModel,
    *,
    date: str,
    rng: np.random.Generator,
    reference_std_cm: float | None = None,
    set_up_std_cm: float | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Characterised:
    """Characterise a sensor.

    Parameters
    ----------
    loaded
        Readings with true ranges.
    sensor
        The starting model: limits, codes, calibration temperature, and numbers to compare with.
    date
        Of today, ISO 8601, for the record.
    rng
        For the randomised goodness of fit.
    reference_std_cm
        Standard deviation of an error that the reference may have at all ranges alike [cm]; None: not stated.
    set_up_std_cm
        Standard deviation of what each set-up's true range is off by on its own [cm]; None: not stated.
    say
        Called with what is being done.

    Raises
    ------
    RecordingError
        Nothing can be found in these readings.
    """
    say("sorting readings into points")
    points = sort_into_points(loaded.data, sensor)
    by = {name: [p for p in points if p.condition == name] for name in {p.condition for p in points}}
    undisturbed = [p for name in UNDISTURBED for p in by.get(name, [])]
    absent: dict[str, str] = {}

    _check_one_kind(loaded, points)
    _check_together(loaded, undisturbed)

    say("calibration")
    found_base = baseline(by.get(BASELINE, []), reference_std_cm)
    calibration = calibrate(undisturbed, reference_std_cm, set_up_std_cm)
    curve = _curve(calibration)
    if found_base is None:
        absent["baseline"] = "no readings of the surface with nothing varied"
    if calibration is None:
        absent["calibration"] = "no readings of the surface with nothing varied"

    say("mixture")
    fitted = fit_mixture(undisturbed, curve, sensor, rng)
    if isinstance(fitted, str):
        absent["mixture"] = fitted

    say("maximum range")
    longest = maximum_range(by.get("maximum_range", []), sensor)
    if longest is None:
        absent["maximum_range"] = NOT_ASKED

    say("field of view and sonar equation")
    view = find_field_of_view(by.get("field_of_view", []), curve)
    heard_cm = _heard_on_axis_cm(undisturbed, sensor)
    rows = breakaway_rows(view.angles) if view is not None else []
    sonar = sonar_through(rows, sensor, heard_cm or sensor.heard_on_axis_cm)
    if view is None:
        absent["field_of_view"] = "no range was tried at more than one angle (incidence_deg)"
    if sonar is None:
        absent["sonar"] = "needs breakaway angles at three ranges at least"

    say("questions")
    found_points = tuple(point.found for point in points)
    asked = answer_questions(found_points)
    for name in TOPICS:
        if not any(each.name == name for each in asked):
            absent[name] = NOT_ASKED
    boxes = hot_boxes(found_points, sensor.calibration_temperature_c)
    table = compensation_table(by.get(COMPENSATION, []), curve)
    if not boxes:
        absent["hot_boxes"] = "no three ranges with hot or cold air at the sensor and the same ranges without"
    if not table:
        absent[COMPENSATION] = NOT_ASKED

    findings = Findings(
        sensor=sensor.name,
        date=date,
        calibration_temperature_c=sensor.calibration_temperature_c,
        sources=loaded.sources,
        points=found_points,
        baseline=found_base,
        calibration=calibration,
        mixture=fitted.found if isinstance(fitted, FittedMixture) else None,
        maximum_range=longest,
        field_of_view=view,
        sonar=sonar,
        questions=asked,
        hot_boxes=boxes,
        temperature_compensation=table,
        absent=absent,
        warnings=(
            *_warnings(loaded, points, undisturbed, calibration, view.angles if view else (), rows),
            *_quieter(sensor, fitted.parameters if isinstance(fitted, FittedMixture) else None),
        ),
    )
    changes = Changes(
        calibration=_knots(calibration),
        breakaway=tuple(BreakawayPoint(range_cm=r, half_angle_deg=a) for r, a in rows) or None,
        oblique_reading=None if view is None or view.oblique.verdict == "unknown" else view.oblique.verdict,
        heard_on_axis_cm=heard_cm,
        reading_model=fitted.parameters if isinstance(fitted, FittedMixture) else None,
        effects=_with_set_up_offset(sensor, calibration),
    )
    if not asked and not table and all(value is None for value in vars(changes).values()):
        why = [*findings.warnings, absent.get("calibration", "no calibration")]
        raise RecordingError(f"{_names(loaded.sources)}: nothing can be found: {'; '.join(why)}")
    return Characterised(findings, changes)


def _check_one_kind(loaded: LoadedReadings, points: Sequence[PointReadings]) -> None:
    """Refuse what one sensor makes beside what another one makes, unless the person has named both."""
    if loaded.sensors:
        return
    of = {
        name: sensors
        for name in (*UNDISTURBED, "field_of_view")
        if (sensors := {p.sensor for p in points if p.condition == name})
    }
    for (one, its), (other, theirs) in combinations(of.items(), 2):
        if not its & theirs:
            raise RecordingError(
                f"{_names(loaded.sources)}: {one} is of {', '.join(sorted(its))} and {other} of "
                f"{', '.join(sorted(theirs))}, and one model is of one kind of sensor: name the one with --of SENSOR, "
                "or all with --of for each where they are of one kind"
            )


def _check_together(loaded: LoadedReadings, undisturbed: Sequence[PointReadings]) -> None:
    """Refuse readings of which most are nowhere near their true ranges, though they are readings of something."""
    heard = [p for p in undisturbed if 2 * int(p.is_heard.sum()) >= p.reading_cm.size]
    astray = [p for p in heard if p.hits < LEAST_HITS <= int(p.is_heard.sum())]
    if 2 * len(astray) > len(heard):
        where = ", ".join(f"{p.range_cm:g}" for p in astray[:5])
        raise RecordingError(
            f"{_names(loaded.sources)}: at {len(astray)} of {len(heard)} undisturbed points the readings are not "
            f"near the true range ({where} cm ...); do true_range_cm and reading_cm belong together, row by row?"
        )


def _names(sources: Sequence[SourceFile]) -> str:
    return ", ".join(source.name for source in sources)


def _curve(calibration: CalibrationFindings | None) -> Calibration:
    if calibration is None or not calibration.knots:
        return IDENTITY
    return Calibration(
        tuple(knot.true_cm for knot in calibration.knots), tuple(knot.reading_cm for knot in calibration.knots)
    )


def _knots(calibration: CalibrationFindings | None) -> tuple[CalibrationKnot, ...] | None:
    # Without held-out ranges nothing was decided, and the starting model's stays.
    if calibration is None or not calibration.held_out:
        return None
    return tuple(CalibrationKnot(true_cm=knot.true_cm, reading_cm=knot.reading_cm) for knot in calibration.knots)


def _with_set_up_offset(
    sensor: SensorModel, calibration: CalibrationFindings | None
) -> tuple[dict[str, Any], ...] | None:
    """Effects with the offset of each session, where one is sure."""
    found = None if calibration is None else calibration.set_up_offset
    if found is None or not found.low:
        return None
    others = [each for each in sensor.effects if each.get("name") != SESSION_EFFECT]
    own = {
        key: round(value, 3) for key, value in (("value", found.value), ("low", found.low), ("high", found.high or 0))
    }
    return (*others, {"name": SESSION_EFFECT, "parameters": {"deviation_cm": {**own, "unit": "cm"}}})


def _heard_on_axis_cm(points: Sequence[PointReadings], sensor: SensorModel) -> float | None:
    """Longest range at which a large target was heard; None unless that was asked."""
    heard = heard_to_cm([p for p in points if p.condition == "maximum_range"], RELIABLE_SHARE)
    return None if heard is None else min(round(heard, 1), float(sensor.maximum_cm))


def _warnings(
    loaded: LoadedReadings,
    points: Sequence[PointReadings],
    undisturbed: Sequence[PointReadings],
    calibration: CalibrationFindings | None,
    angles: Sequence[BreakawayAngle],
    rows: Sequence[tuple[float, float]],
) -> list[str]:
    told = list(loaded.messages)
    for word in sorted({p.condition for p in points} - KNOWN_CONDITIONS):
        near = difflib.get_close_matches(word, KNOWN_CONDITIONS, n=1)
        told.append(f"no analysis knows the condition {word!r}" + (f"; is it {near[0]!r}?" if near else ""))
    unknown = len(loaded.data) - sum(p.reading_cm.size for p in points)
    if unknown:
        told.append(f"{unknown} rows have no true range and were left out")
    sensors = sorted({p.sensor for p in undisturbed})
    if len(sensors) > 1:
        told.append(f"one model for {len(sensors)} sensors ({', '.join(sensors)}): their differences are in its noise")
    ranges = {round(p.range_cm, 1) for p in undisturbed}
    if len(ranges) == 1:
        told.append("one range only: no scale, no linearity, and nothing that depends on range can be found")
    if calibration is not None and undisturbed and all(np.isnan(p.air_temperature_c).all() for p in undisturbed):
        told.append(
            "no air_temperature_c: a scale is the sensor's and the air's together, 0.17 % a degree; with "
            "a thermometer in the bridge the air would be corrected twice"
        )
    few = [p for p in undisturbed if p.reading_cm.size < FEW_READINGS]
    if few:
        told.append(f"{len(few)} of {len(undisturbed)} undisturbed points have fewer than {FEW_READINGS} readings")
    silent = [p for p in undisturbed if p.found.error is None]
    if silent:
        shown = ", ".join(f"{p.range_cm:g}" for p in silent[:5])
        told.append(f"{len(silent)} points have hardly a reading of the surface: at {shown} cm")
    for angle in angles:
        if angle.half_angle.value == 0.0:
            told.append(f"at {angle.range_cm:g} cm no angle is reliable, so the range is not in the breakaway table")
        elif angle.half_angle.high is None:
            told.append(f"at {angle.range_cm:g} cm the largest angle tried is still reliable: the field is wider")
        if angle.negative and angle.positive and abs(angle.negative.value - angle.positive.value) > 3.6:
            told.append(
                f"at {angle.range_cm:g} cm the two sides differ ({angle.negative.value:g} and "
                f"{angle.positive.value:g} deg): is the sensor's axis where 0 deg is?"
            )
    measured = {angle.range_cm: angle.half_angle.value for angle in angles}
    wider = [r for r, half_deg in rows if half_deg < measured[r]]
    if wider:
        told.append(
            "an angle that is larger than at a shorter range was taken as that one: at "
            + ", ".join(f"{r:g}" for r in wider)
            + " cm"
        )
    return told


def _quieter(sensor: SensorModel, fitted: MixtureParameters | None) -> list[str]:
    """A bench's noise is not a vehicle's, and a filter that is too sure is the worse mistake."""
    if fitted is None or fitted.sigma_cm > sensor.reading_model.sigma_cm / 2.0:
        return []
    return [
        f"the spread of {fitted.sigma_cm:.2g} cm is a bench's, and {sensor.reading_model.sigma_cm:.2g} cm was taken "
        "before: filters that trust it on a vehicle, which shakes, may be too sure"
    ]


def provenance(findings: Findings) -> dict[str, object]:
    """The entry for the sensor model file's `evidence`."""
    return {
        "what": "characterisation",
        "date": findings.date,
        "data": [_source(each) for each in findings.sources],
    }


def _source(source: SourceFile) -> dict[str, object]:
    return {"name": source.name, "sha256": source.sha256, "rows": source.rows}
