"""Readings against the reference: bias, scale, spread, resolution, linearity, and the calibration worth keeping.

`findings.CalibrationFindings` is made from points with nothing varied. Every point counts once with its own uncertainty
and the scatter between points, which is how well ranges were set up and whatever else changes from one to the next. A
more complex calibration is kept only where it predicts ranges that it was not fitted to better than the simpler one
does.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from msp_lab.characterise.findings import CalibrationFindings, Form, HeldOut, MeasuredKnot
from msp_lab.characterise.points import PointReadings
from msp_lab.estimates import (
    CONFIDENCE,
    IntervalEstimate,
    PointsFit,
    Z,
    between_points,
    dependence_factor,
    fit_line,
    mean_of_points,
)
from msp_range.arrays import Array, Flags, numbered
from msp_range.correction.calibration import curve_through, piecewise_linear

MIN_RANGES = 4
"""Ranges that a straight line needs: it predicts each from the others, and three determine it with an error."""
MIN_RUNS = 3
"""Runs with several ranges each that are needed to leave out whole runs."""
MIN_SET_UPS = 8
"""Set-ups that are needed for a variance between them: with 8 it is known within a factor of 4."""
RANGES_PER_PIECE = 3
"""Ranges per segment of a piecewise linear calibration, so that each segment has a residual."""
MAX_PIECES = 4
"""Segments of a calibration at most; more follow the placements and not the sensor."""
NAMES: dict[Form, str] = {
    "none": "no calibration",
    "offset and scale": "a straight line",
    "piecewise linear": "straight pieces",
}


class _Points(NamedTuple):
    """Columns of the points: apparent true range, mean reading, its variance, true range, number of the run."""

    true_cm: Array
    reading_cm: Array
    variance_cm2: Array
    range_cm: Array
    run: Array

    @classmethod
    def of(cls, points: Sequence[PointReadings]) -> "_Points":
        run = numbered(np.array([point.run for point in points]))
        rows = [
            (
                point.apparent_cm[point.is_hit].mean(),
                # An error is about the true range of the hits: where that changes, missed echoes are at other ranges.
                point.true_range_cm[point.is_hit].mean() + error.value,
                error.standard_error**2 + point.placement_cm2,
                round(point.range_cm, 6),
                run[i],
            )
            for i, point in enumerate(points)
            if (error := point.found.error) is not None
        ]
        return cls(*np.array(rows).T)

    def select(self, rows: Flags) -> "_Points":
        return _Points(*(column[rows] for column in self))


def calibrate(
    points: Sequence[PointReadings], reference_std_cm: float | None = None, set_up_std_cm: float | None = None
) -> CalibrationFindings | None:
    """Calibration by points on the axis with nothing varied; None where none has readings of the surface.

    `reference_std_cm` is the standard deviation of an error that the reference may have at all ranges alike [cm], as
    its owner states it; it widens the bias's interval, for readings cannot tell it from the sensor's own.
    `set_up_std_cm` is that of the error of each placement's true range [cm]; None: not stated, and all differences
    between placements are attributed to it.
    """
    used = [point for point in points if point.found.error is not None]
    if not used:
        return None
    data, extra_cm = _Points.of(used), reference_std_cm or 0.0
    offset, scale, linearity, noise_floor, between_cm2 = None, None, None, None, 0.0
    if np.unique(data.range_cm).size >= 3:
        line = fit_line(data.true_cm, data.reading_cm, data.variance_cm2)
        offset, scale, between_cm2 = line.estimate(0, "cm", extra_cm), line.estimate(1, ""), line.between
        linearity, noise_floor = _linearity(data, line)
    # Set-ups differ by more than the scatter of readings explains; their residual variance is added to every point.
    chosen = _choose(data._replace(variance_cm2=data.variance_cm2 + between_cm2))
    step_cm = used[0].step_cm
    return CalibrationFindings(
        **chosen._asdict(),
        bias=mean_of_points(data.reading_cm - data.true_cm, data.variance_cm2, extra_cm),
        offset=offset,
        scale=scale,
        spread=pooled_spread(used),
        resolution=IntervalEstimate(step_cm, unit="cm", n=sum(point.hits for point in used)),
        resolution_note=(
            f"readings are whole multiples of {step_cm:g} cm" if step_cm else "readings are not multiples of a step"
        ),
        linearity=linearity,
        linearity_noise_floor_cm=noise_floor,
        reference_std_cm=reference_std_cm,
        set_up_offset=_set_up_offset(used, data, chosen.knots, set_up_std_cm),
        held_out_unit="range and run" if _has_runs(data) else "range",
        true_cm=tuple(data.true_cm.tolist()),
        reading_cm=tuple(data.reading_cm.tolist()),
        reading_std_cm=tuple(np.sqrt(data.variance_cm2).tolist()),
    )


def _set_up_offset(
    used: Sequence[PointReadings], data: _Points, knots: Sequence[MeasuredKnot], set_up_std_cm: float | None
) -> IntervalEstimate | None:
    if set_up_std_cm is None or len(used) < MIN_SET_UPS:
        return None
    curve = curve_through(knots)
    factor = dependence_factor([point.error_cm[point.is_hit] for point in used])
    # The error of a placement is stated once for all of them, or in a column for each.
    placements_cm2 = np.array([point.placement_cm2 for point in used])
    own_cm2 = factor * (data.variance_cm2 - placements_cm2) + np.maximum(placements_cm2 - set_up_std_cm**2, 0.0)
    residual_cm = data.reading_cm - curve.forward(data.true_cm)
    return between_points(residual_cm, own_cm2, set_up_std_cm**2, max(len(knots), 1))


def pooled_spread(points: Sequence[PointReadings]) -> IntervalEstimate:
    """Standard deviation of hits about their own point's mean, before rounding: root mean square over the points."""
    variances = [point.found.spread.mapped(lambda end: end**2) for point in points if point.found.spread is not None]
    weight = np.array([variance.n - 1.0 for variance in variances])
    if not weight.any():
        return IntervalEstimate(0.0, unit="cm", n=len(variances))
    weight /= weight.sum()
    mean = float(weight @ [variance.value for variance in variances])
    # Each point's own interval of the variance; they are independent.
    half = Z * float(np.linalg.norm(weight * [variance.standard_error for variance in variances]))
    readings = sum(variance.n for variance in variances)
    return IntervalEstimate.about(mean, half, readings).root()


def _linearity(data: _Points, line: PointsFit) -> tuple[IntervalEstimate, float]:
    """Largest distance from the line, and its noise floor: what the scatter of readings reaches in 95 % of cases."""
    offset, scale = line.coefficients
    residual = data.reading_cm - (offset + scale * data.true_cm)
    i = int(np.abs(residual).argmax())
    half = Z * math.sqrt(data.variance_cm2[i])
    # The largest of n distances is below its limit where each is.
    z = float(ndtri((1.0 + CONFIDENCE ** (1.0 / residual.size)) / 2))
    noise_floor = z * math.sqrt(data.variance_cm2.mean())
    return IntervalEstimate.about(float(residual[i]), half, residual.size, "points"), noise_floor


class _Choice(NamedTuple):
    """The calibration that is kept, why, and how each form did on ranges left out."""

    form: Form
    knots: tuple[MeasuredKnot, ...]
    reason: str
    held_out: tuple[HeldOut, ...] = ()


def _choose(data: _Points) -> _Choice:
    """The form that predicts left-out ranges significantly better than the simpler ones."""
    ranges = np.unique(data.range_cm)
    if ranges.size < MIN_RANGES:
        reason = f"found {ranges.size} range{'s'[: ranges.size - 1]}, expected {MIN_RANGES} to check it on one left out"
        return _Choice("none", (), reason)
    by_run = _has_runs(data)
    most = min(MAX_PIECES, ranges.size // RANGES_PER_PIECE)
    errors = {pieces: _left_out_errors(data, pieces, data.range_cm) for pieces in range(max(most, 1) + 1)}
    tried: list[tuple[Form, int]] = [("offset and scale", 1)]
    if most >= 2:
        # The best piecewise linear form represents its kind.
        tried.append(("piecewise linear", min(range(2, most + 1), key=lambda pieces: _rms(errors[pieces]))))
    kept: Form = "none"
    kept_pieces, refused, held_out = 0, "", [HeldOut("none", _rms(errors[0]), None)]
    for form, pieces in tried:
        # Mean square error taken off, ranges as the unit.
        saved = errors[kept_pieces] ** 2 - errors[pieces] ** 2
        gain = mean_of_points(np.array([saved[data.range_cm == at_cm].mean() for at_cm in ranges]), unit="cm^2")
        held_out.append(HeldOut(form, _rms(errors[pieces]), gain))
        is_better = gain.ends[0] > 0.0
        if is_better and by_run:
            simpler, complex_ = (_rms(_left_out_errors(data, each, data.run)) for each in (kept_pieces, pieces))
            is_better = complex_ < simpler
        if is_better:
            try:
                curve_through(_knots(data, pieces))
                kept, kept_pieces = form, pieces
            except ValueError as error:
                refused += f"; {NAMES[form]} would predict better and is no calibration: {error}"
    others = [
        f"{candidate.rms_cm:.2f} cm by {NAMES[candidate.form]}" for candidate in held_out if candidate.form != kept
    ]
    reason = (
        f"left-out ranges are predicted to {_rms(errors[kept_pieces]):.2f} cm rms, against {' and '.join(others)}; a "
        f"more complex form is kept if its gain is significant{' and left-out runs agree' if by_run else ''}{refused}"
    )
    return _Choice(kept, _knots(data, kept_pieces), reason, tuple(held_out))


def _has_runs(data: _Points) -> bool:
    """True where runs hold several ranges each: a whole one can then be left out."""
    ranges = [np.unique(data.range_cm[data.run == run]).size for run in np.unique(data.run)]
    return len(ranges) >= MIN_RUNS and min(ranges) >= 2


def _left_out_errors(data: _Points, pieces: int, group: Array) -> Array:
    """Error of each reading, predicted by a calibration fitted to the points of other groups: ranges, or runs."""
    errors = np.empty_like(data.true_cm)
    for unit in np.unique(group):
        out = group == unit
        places, readings = _fitted(data.select(~out), pieces)
        errors[out] = data.reading_cm[out] - piecewise_linear(places, readings, data.true_cm[out])
    return errors


def _fitted(data: _Points, pieces: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Knots of a curve of straight pieces by least squares, ranges and readings; without pieces they are equal."""
    places = tuple(np.quantile(np.unique(data.true_cm), np.linspace(0.0, 1.0, max(pieces, 1) + 1)).tolist())
    if pieces == 0:
        return places, places
    # Hat functions; the outer ones go on beyond the ends as straight lines.
    hats = np.array([piecewise_linear(places, tuple(hat), data.true_cm) for hat in np.eye(len(places)).tolist()])
    root_weight = 1.0 / np.sqrt(data.variance_cm2 + 1e-12)
    readings, *_ = np.linalg.lstsq((hats * root_weight).T, data.reading_cm * root_weight, rcond=None)
    return places, tuple(readings.tolist())


def _knots(data: _Points, pieces: int) -> tuple[MeasuredKnot, ...]:
    knots = zip(*_fitted(data, pieces), strict=True) if pieces else ()
    return tuple(MeasuredKnot(round(true_cm, 2), round(reading_cm, 3)) for true_cm, reading_cm in knots)


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))
