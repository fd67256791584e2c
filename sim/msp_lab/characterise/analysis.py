"""All analyses in order: from loaded readings and a starting sensor model to findings and changes of the model.

What the data do not determine stays as in the starting model, and the findings give the reason.
"""

import difflib
import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.random import default_rng

from msp_lab.characterise.accuracy import baseline, longest_reliable_cm, maximum_range
from msp_lab.characterise.calibration import calibrate
from msp_lab.characterise.correlation import hit_correlation
from msp_lab.characterise.experiments import EXPERIMENTS, QUESTIONS
from msp_lab.characterise.field_of_view import breakaway_rows, find_field_of_view, sonar_through
from msp_lab.characterise.findings import BreakawayAngle, CalibrationFindings, Findings, Mixture, as_json
from msp_lab.characterise.mixture import fit_mixture
from msp_lab.characterise.model_file import changed, commented, write_new
from msp_lab.characterise.points import BASELINE, MIN_HITS, PointReadings, air_share, sort_into_points
from msp_lab.characterise.questions import answer_questions
from msp_lab.characterise.temperature import compensation_table, hot_boxes
from msp_lab.mixture_fit.fit_result import FitError
from msp_lab.readings.column_map import load_maps
from msp_lab.readings.intake import LoadedReadings, SourceFile, sensors_in
from msp_lab.readings.resolution import measured_step, step_with
from msp_range.correction.calibration import Calibration, curve_through
from msp_range.reading_model.sensor_model import MixtureParameters, SensorModel, load_sensor_model
from msp_range.recording.columns import KNOWN_COLUMNS
from msp_range.recording.error import RecordingError
from msp_sim.acoustics.sonar import STEP_DEG
from msp_sim.model.context_limits import span
from msp_sim.model.derived import DERIVED, PREVIOUS
from msp_sim.model.model import Model
from msp_sim.page.text import counted, listed

NUMBERS, PAGE = "findings.json", "report.html"
UNDISTURBED = (BASELINE, "maximum_range")
"""Experiments with nothing varied but range: calibration and mixture are fitted to them."""
COMPENSATION = "temperature_compensation"
SESSION_EFFECT = "run_offsets"
"""Name of the simulator's effect for an offset that differs between sessions."""
NOTHING_UNDISTURBED = "no readings of the surface with nothing varied"
NOT_MEASURED = "no readings of this condition, or none at ranges to compare with"
SHOWN = 3
"""Of runs or targets without readings, so many are named."""
FEW_READINGS = 20
"""Warn about points with fewer readings: the 95 % interval of their mean error is wider than half their spread."""


@dataclass(frozen=True)
class Characterisation:
    """The files from which a model is made, and the options."""

    data: tuple[Path, ...]
    start: Path
    """Files of readings, and of the starting model."""
    column_map: tuple[str, ...]
    truth: Literal["recorded", "others"]
    """Options ``--map`` and ``--truth``."""
    date: str
    seed: int
    """Date to record, and random seed of the goodness of fit."""
    reference_std_cm: float | None = None
    set_up_std_cm: float | None = None
    """Standard deviations of the reference's error and of setting a point up [cm], as for `calibration.calibrate`."""

    def sensors(self) -> list[str]:
        """Names of the sensors in the readings."""
        return sensors_in(self.data, load_sensor_model(self.start), load_maps(self.column_map), truth=self.truth)


@dataclass(frozen=True)
class Characterised:
    """A model, what was found, new values of the starting model's fields (others are kept), and the sorted readings."""

    model: SensorModel
    findings: Findings
    changes: Mapping[str, Any]
    points: Sequence[PointReadings]
    start: str
    """File name of the starting model."""

    def write(self, path: Path) -> None:
        """Write the model file; RecordingError if there is a file already, or it cannot be written."""
        write_new(path, commented(self.model, self.findings, self.changes, self.start))

    def publish(self, folder: Path) -> Path:
        """Write all numbers and the page, and return the page; UserError if they cannot be written."""
        write_new(folder / NUMBERS, as_json(self.findings))
        from msp_lab.characterise.page.picture_data import PictureData
        from msp_lab.characterise.page.write import write_report

        return write_report(PictureData(self.findings, self.points, self.model), folder)


def characterise(
    loaded: LoadedReadings,
    sensor: SensorModel,
    how: Characterisation,
    progress: Callable[[str], None] = lambda text: None,
) -> Characterised:
    """Characterise a sensor by readings with true ranges, from a model with its limits and codes to start with.

    `progress` is called with a description of the current analysis. RecordingError if nothing can be found in these
    readings, if they are of different sensors, or if most are far from their true ranges; ConfigError if what was found
    does not go with the rest of the model.
    """
    start, (sensor, about_step) = sensor, _with_step(sensor, loaded)
    progress("sorting readings into points")
    points = sort_into_points(loaded.data, sensor)
    by = {name: [p for p in points if p.condition == name] for name in EXPERIMENTS}
    undisturbed = [p for name in UNDISTURBED for p in by[name]]
    _check_one_kind(loaded, points)
    _check_together(loaded, undisturbed)
    progress("calibration")
    calibration = calibrate(undisturbed, how.reference_std_cm, how.set_up_std_cm)
    curve = curve_through(() if calibration is None else calibration.knots)
    progress("mixture")
    mixture, parameters, no_mixture = _mixture(undisturbed, loaded, curve, sensor, default_rng(how.seed))
    progress("maximum range, field of view and sonar equation")
    view, longest = find_field_of_view(by["field_of_view"], curve), by["maximum_range"]
    angles = view.angles if view else ()
    rows = breakaway_rows(angles)
    heard_cm = longest_reliable_cm(longest, sensor.maximum_cm)
    progress("questions")
    found = tuple(point.found for point in points)
    calibration_c = sensor.calibration_temperature_c if air_share(sensor) else None
    questions = answer_questions(found)
    findings = Findings(
        sensor=sensor.name,
        date=how.date,
        calibration_temperature_c=calibration_c,
        sources=loaded.sources,
        points=found,
        baseline=baseline(by[BASELINE], how.reference_std_cm),
        calibration=calibration,
        mixture=mixture,
        maximum_range=maximum_range(longest, sensor),
        field_of_view=view,
        sonar=sonar_through(rows, sensor, heard_cm or sensor.heard_on_axis_cm),
        questions=questions,
        hot_boxes=() if calibration_c is None else tuple(hot_boxes(questions, calibration_c)),
        temperature_compensation=() if calibration_c is None else tuple(compensation_table(by[COMPENSATION], curve)),
    )
    warnings = [*about_step, *_warnings(loaded, points, undisturbed, calibration)]
    warnings += [*_angle_warnings(angles, rows), *_spread_warnings(sensor, parameters)]
    findings = replace(findings, warnings=tuple(warnings), absent=_absent(findings, sensor, no_mixture))
    changes = _changes(findings, sensor, rows, heard_on_axis_cm=heard_cm, reading_model=parameters)
    if sensor.resolution_cm != start.resolution_cm:
        changes["resolution_cm"] = sensor.resolution_cm
    return Characterised(changed(start, findings, changes), findings, changes, points, how.start.name)


def _mixture(
    undisturbed: Sequence[PointReadings],
    loaded: LoadedReadings,
    curve: Calibration,
    sensor: SensorModel,
    rng: np.random.Generator,
) -> tuple[Mixture | None, MixtureParameters | None, str]:
    """The fitted mixture and its parameters for the model file, or the reason why there are none."""
    try:
        return *fit_mixture(undisturbed, curve, sensor, rng, hit_correlation(undisturbed, loaded.data)), ""
    except FitError as error:
        return None, None, str(error)


def _absent(findings: Findings, sensor: SensorModel, no_mixture: str) -> dict[str, str]:
    """The reason for each part that was not found."""
    no_sound = "" if sensor.medium == "sound" else f"about sound, and this sensor ranges with {sensor.medium}"
    no_air = no_sound or ("" if air_share(sensor) else "the starting model has no effect air_temperature")
    no_box = "no three ranges with hot or cold air at the sensor and the same ranges without"
    reasons = {
        "baseline": NOTHING_UNDISTURBED,
        "calibration": NOTHING_UNDISTURBED,
        "mixture": no_mixture,
        "maximum_range": NOT_MEASURED,
        "field_of_view": "no range was tried at more than one angle (incidence_deg)",
        "sonar": no_sound or "needs breakaway angles at three ranges at least",
        **dict.fromkeys(QUESTIONS, NOT_MEASURED),
        "hot_boxes": no_air or no_box,
        COMPENSATION: no_air or NOT_MEASURED,
    }
    found = {question.name for question in findings.questions}
    return {name: why for name, why in reasons.items() if name not in found and not getattr(findings, name, None)}


def _with_step(sensor: SensorModel, loaded: LoadedReadings) -> tuple[SensorModel, list[str]]:
    """The sensor with the step in which its readings come, or a warning where the model cannot have it."""
    model = Model.of(sensor)
    own_cm = measured_step(loaded.data, model)
    try:
        return model.with_step(own_cm).sensor, []
    except ValueError:
        step_cm = step_with(loaded.data, model)
    return model.with_step(step_cm).sensor, [
        f"the readings come in steps of {own_cm:g} cm, and this model cannot have them, as its limits of "
        f"{sensor.minimum_cm:g} and {sensor.maximum_cm:g} cm, or its 255, would be no multiples: its mixture takes "
        f"their step to be {step_cm:g} cm, so its sigma_cm is wrong"
    ]


def _check_one_kind(loaded: LoadedReadings, points: Sequence[PointReadings]) -> None:
    """Refuse readings of different sensors in different experiments, unless the user has selected them."""
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
                f"{', '.join(sorted(theirs))}, but a model describes one kind of sensor: select one with --of SENSOR, "
                "or all with --of for each if they are of the same kind"
            )


def _check_together(loaded: LoadedReadings, undisturbed: Sequence[PointReadings]) -> None:
    """Refuse readings of which most are far from their true ranges."""
    echoes = [p for p in undisturbed if 2 * int(p.is_echo.sum()) >= p.reading_cm.size]
    far_off = [p for p in echoes if p.hits < MIN_HITS <= int(p.is_echo.sum())]
    if 2 * len(far_off) > len(echoes):
        where = ", ".join(f"{p.range_cm:g}" for p in far_off[:5])
        raise RecordingError(
            f"{_names(loaded.sources)}: at {len(far_off)} of {len(echoes)} undisturbed points the readings are not "
            f"near the true range ({where} cm ...); do true_range_cm and reading_cm belong together, row by row?"
        )


def _names(sources: Sequence[SourceFile]) -> str:
    return ", ".join(source.name for source in sources)


def _changes(
    findings: Findings, sensor: SensorModel, rows: Sequence[tuple[float, float]], **fitted: Any
) -> dict[str, Any]:
    """New values of the sensor model, those that were `fitted` among them, as far as readings determine them.

    RecordingError for readings in which nothing at all can be found.
    """
    view, calibration = findings.field_of_view, findings.calibration
    if view is not None:
        fitted["breakaway"] = [{"range_cm": r, "half_angle_deg": angle} for r, angle in rows] or None
        fitted["oblique_reading"] = None if view.oblique.verdict == "unknown" else view.oblique.verdict
    changes = {name: value for name, value in fitted.items() if value is not None}
    # Without held-out ranges nothing was decided, and the starting model's stays.
    if calibration is not None and calibration.held_out:
        changes["calibration"] = [asdict(knot) for knot in calibration.knots]
        if calibration.scale is not None and calibration.scale.low is not None:
            # A line that is not sure enough to be kept says all the same how far off none may be.
            left_off = 0.0 if calibration.knots else calibration.scale.value - 1.0
            changes["calibration_scale_std_pct"] = 100.0 * math.hypot(calibration.scale.standard_error, left_off)
    # An offset between sessions enters if its interval excludes 0.
    if calibration is not None and calibration.set_up_offset and calibration.set_up_offset.low:
        offset = calibration.set_up_offset.mapped(lambda end: round(end, 3))
        own = {"value": offset.value, "low": offset.low, "high": offset.high or 0, "unit": "cm"}
        others = [effect for effect in sensor.effects if effect.get("name") != SESSION_EFFECT]
        changes["effects"] = (*others, {"name": SESSION_EFFECT, "parameters": {"deviation_cm": own}})
    if not findings.questions and not findings.temperature_compensation and not changes:
        reasons = {"calibration": calibration.reason} if calibration is not None else {}
        reasons |= {name: why for name, why in findings.absent.items() if name in ("calibration", "mixture")}
        why = [*(f"{name}: {each}" for name, each in reasons.items()), *findings.warnings]
        raise RecordingError(
            f"{_names(findings.sources)}: nothing can be found: {'; '.join(why)}. Expected a bench session; a flight, "
            "which varies everything at once, is for msp-lab gap"
        )
    return changes


def _warnings(
    loaded: LoadedReadings,
    points: Sequence[PointReadings],
    undisturbed: Sequence[PointReadings],
    calibration: CalibrationFindings | None,
) -> Iterator[str]:
    yield from loaded.messages
    for word in sorted({p.condition for p in points} - EXPERIMENTS.keys()):
        near = difflib.get_close_matches(word, EXPERIMENTS, n=1)
        yield f"no analysis uses the condition {word!r}" + (f"; is it {near[0]!r}?" if near else "")
    if own := [name for name in loaded.data.columns if name not in (*KNOWN_COLUMNS, *DERIVED, PREVIOUS)]:
        yield f"no analysis here uses the table's own columns {listed(own, SHOWN)}; msp-lab gap looks for their effects"
    unknown = len(loaded.data) - sum(p.reading_cm.size for p in points)
    if unknown:
        yield f"{unknown} rows without a true range are left out"
    sensors = sorted({p.sensor for p in undisturbed})
    if len(sensors) > 1:
        yield f"one model for {len(sensors)} sensors ({', '.join(sensors)}): their differences are in its noise"
    others = list(dict.fromkeys(p.level for p in points if p.condition == "material"))
    if others and (loaded.data.column("condition") == "").all():
        usual = loaded.data.column("target")[[p.rows[0] for p in undisturbed]].tolist()
        yield (
            f"the column target varies: {listed(list(dict.fromkeys(usual)), SHOWN)} is the baseline, of which the "
            f"model is made, and {listed(others, SHOWN)} are compared with it as material"
        )
    if len({round(p.range_cm, 1) for p in undisturbed}) == 1:
        yield "one range only: no scale, no linearity, and nothing that depends on range can be found"
    few = sum(p.reading_cm.size < FEW_READINGS for p in undisturbed)
    if few:
        yield f"{few} of {len(undisturbed)} undisturbed points have fewer than {FEW_READINGS} readings"
    yield from _silent([p for p in points if p.condition in (*UNDISTURBED, "material")])
    no_thermometer = all(np.isnan(p.air_temperature_c).all() for p in undisturbed)
    corrects = any(p.sensor_model.medium == "sound" and p.air_share == 0.0 for p in undisturbed)
    if calibration is not None and corrects and not no_thermometer:
        yield (
            "the starting model has no effect air_temperature, so the sensor is taken to compensate itself, and "
            "air_temperature_c is not used"
        )
    if calibration is not None and any(p.air_share for p in undisturbed) and no_thermometer:
        yield (
            "no air_temperature_c: a scale is the sensor's and the air's together, 0.17 % a degree; with "
            "a thermometer in the bridge the air would be corrected twice"
        )


def _silent(points: Sequence[PointReadings]) -> Iterator[str]:
    """Points without readings of the surface: of what and at which ranges, and the runs that never answered."""
    silent = [p for p in points if p.found.error is None]
    if not silent:
        return
    of, here = (Counter(p.level or p.run for p in some) for some in (points, silent))
    where = [f"{word} {count} of {of[word]}" if of[word] > 1 else word for word, count in here.most_common()]
    text = f"{len(silent)} of {len(points)} points have almost no reading of the surface, at "
    text += f"{span(np.array([p.range_cm for p in silent]))} cm: {listed(where, SHOWN)}"
    answered = {p.run for p in points if p.found.no_answer < p.found.readings}
    dead = list(dict.fromkeys(p.run for p in silent if p.run not in answered))
    yield text + (f"; no answer at all in {counted(len(dead), 'run')}: {listed(dead, SHOWN)}" if dead else "")


def _angle_warnings(angles: Sequence[BreakawayAngle], rows: Sequence[tuple[float, float]]) -> Iterator[str]:
    for angle in angles:
        if angle.half_angle.value == 0.0:
            yield f"at {angle.range_cm:g} cm no angle is reliable, so the range is not in the breakaway table"
        elif angle.half_angle.high is None:
            yield f"at {angle.range_cm:g} cm the largest angle tried is still reliable: the field is wider"
        if angle.negative and angle.positive and abs(angle.negative.value - angle.positive.value) > 2.0 * STEP_DEG:
            yield (
                f"at {angle.range_cm:g} cm the two sides differ ({angle.negative.value:g} and "
                f"{angle.positive.value:g} deg): is the sensor's axis where 0 deg is?"
            )
    measured = {angle.range_cm: angle.half_angle.value for angle in angles}
    wider = ", ".join(f"{r:g}" for r, half_deg in rows if half_deg < measured[r])
    if wider:
        yield f"an angle larger than at a shorter range was limited to that one: at {wider} cm"


def _spread_warnings(sensor: SensorModel, fitted: MixtureParameters | None) -> Iterator[str]:
    """Warn about a spread far below the starting model's: a vehicle shakes, and a filter must not be overconfident."""
    started_cm = sensor.reading_model.sigma_cm
    if fitted is not None and fitted.sigma_cm <= started_cm / 2.0:
        yield (
            f"the spread of {fitted.sigma_cm:.2g} cm was measured on a bench, and the starting model had "
            f"{started_cm:.2g} cm: on a vehicle, which shakes, a filter with it may be overconfident"
        )
