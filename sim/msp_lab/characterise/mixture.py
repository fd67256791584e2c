"""The reading model's mixture fitted to the undisturbed readings, and how well it fits.

The fit itself is `msp_lab.mixture_fit.fit`. Each set-up is fitted about the mean of its own hits, since the error of
its placement is not noise of the sensor; the calibration deals with the differences between set-ups.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from operator import attrgetter

import numpy as np

from msp_lab.characterise.correlation import HitCorrelation
from msp_lab.characterise.findings import Mixture, MixtureParameter, PlacementError
from msp_lab.characterise.points import PointReadings
from msp_lab.estimates import IntervalEstimate
from msp_lab.mixture_fit.fit import fit_readings
from msp_lab.mixture_fit.fit_result import FitError, FitResult
from msp_lab.mixture_fit.grid import ReadingGrid
from msp_lab.mixture_fit.parameters import KINDS, MIN_WEIGHT, PARAMETERS, with_floors
from msp_lab.mixture_fit.pit import goodness_of_fit
from msp_lab.readings.resolution import TOLERANCE, constants_cm
from msp_range.arrays import Array
from msp_range.correction.calibration import Calibration
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import WEIGHTS_RANGE_CM, MixtureParameters, SensorModel

ENOUGH_HITS = 50
"""Set-ups with fewer hits are fitted about the reference: their own mean would lower the variance by 2 % or more."""


def fit_mixture(
    points: Sequence[PointReadings],
    calibration: Calibration,
    sensor: SensorModel,
    rng: np.random.Generator,
    correlation: HitCorrelation | None = None,
) -> tuple[Mixture, MixtureParameters]:
    """Fit the mixture to undisturbed readings on the axis: what was found, and what goes into the file.

    `sensor` has the limits and codes, and the parameters to compare with; `rng` is for the randomised goodness of fit;
    `correlation` is that of neighbouring hits. FitError with the reason if it cannot be fitted.
    """
    try:
        grid = ReadingGrid.of(sensor)
    except ValueError as error:
        raise FitError(str(error)) from None
    set_ups = [_placement_error(point, calibration) for point in points]
    reading_cm, expected_cm, reference_std_cm, set_up = _readings(points, set_ups, calibration)
    limits_cm = grid.minimum_cm, grid.maximum_cm
    constant_cm = constants_cm(reading_cm, set_up.astype(np.intp), grid.resolution_cm, limits_cm)
    reading_cm, expected_cm = reading_cm - constant_cm, expected_cm - constant_cm
    whole = grid.nearest(reading_cm)
    has_ranges = np.unique([round(point.range_cm, 1) for point in points]).size > 1
    result = fit_readings(whole, expected_cm, grid, growth=has_ranges, reference_std_cm=reference_std_cm)
    notes = []
    if (np.abs(whole - reading_cm) > TOLERANCE * grid.resolution_cm).any():
        notes.append(f"readings were rounded to the {grid.resolution_cm:g} cm: their own step is none, or a finer one")
    shares = _shares(result, expected_cm)
    good = goodness_of_fit(result, whole, expected_cm, rng, reference_std_cm=reference_std_cm)
    moved = tuple(set_up for set_up in set_ups if set_up is not None)
    fitted, raised = with_floors(result.parameters, saturates=grid.saturates)
    # All weights are one number together, so none of them alone can be the starting model's.
    kept = set(result.not_identified) & MixtureParameters.model_fields.keys()
    changed = {name: getattr(sensor.reading_model, name) for name in kept}
    notes += [good.note, *_notes(result, moved, len(points), raised, kept)]
    if correlation is not None:
        changed |= {"correlation": correlation.correlation, "correlation_spacing_s": correlation.spacing_s}
        notes.append(correlation.note)
    found = Mixture(
        parameters=tuple(
            _parameter(name, result, sensor.reading_model, name in (*result.at_bound, *raised))
            for name in result.estimates
            if name not in result.not_identified
        ),
        readings=result.readings,
        log_likelihood=result.log_likelihood,
        pit_counts=good.pit_histogram,
        pit_p_value=good.chi_square_p_value,
        shares=shares,
        conditional=_conditional(result, shares) if has_ranges else "not tried: all readings are of one range",
        notes=tuple(notes),
        set_ups=moved,
    )
    return found, fitted.model_copy(update=changed)


def _notes(
    result: FitResult, moved: Sequence[PlacementError], set_ups: int, raised: Collection[str], kept: Collection[str]
) -> Iterator[str]:
    """What to know of set-ups that were moved, and of parameters at a bound or not identified."""
    if moved:
        farthest_cm = max(abs(set_up.error_cm) for set_up in moved)
        yield (
            f"{len(moved)} of {set_ups} set-ups are fitted about the mean of their own hits, up to "
            f"{farthest_cm:.2f} cm from the calibration: sigma_cm is the scatter within a set-up, without what the "
            "reference was off by"
        )
    for name in result.estimates:
        if name in raised:
            yield (
                f"{name}: hardly seen in these readings; the model has its floor of {MIN_WEIGHT:g}, since it may still "
                "come in flight"
            )
        elif name in result.at_bound:
            yield f"{name}: at its bound; the value may lie beyond it"
    for name in result.not_identified:
        starting = "; the starting model's value is kept" if name in kept else ""
        yield f"{name}: not identifiable from these readings{starting}"


def _readings(
    points: Sequence[PointReadings], set_ups: Sequence[PlacementError | None], calibration: Calibration
) -> tuple[Array, Array, Array, Array]:
    """Answers [cm], the readings that are expected, the reference's own standard deviation, and numbers of set-ups."""
    columns = [np.empty((4, 0))]
    for number, (point, set_up) in enumerate(zip(points, set_ups, strict=True)):
        expected_cm, std_cm = calibration.forward(point.apparent_cm), point.reference_std_cm
        if set_up is not None:
            # The mean of a placement's own hits has the error of its one reference in it.
            expected_cm, std_cm = expected_cm + set_up.error_cm, np.zeros(std_cm.size)
        columns.append(np.array([point.reading_cm, expected_cm, std_cm, np.full(std_cm.size, float(number))]))
    reading_cm, expected_cm, std_cm, of = np.concatenate(columns, axis=1)
    answered = ~np.isnan(reading_cm)
    return reading_cm[answered], expected_cm[answered], std_cm[answered], of[answered]


def _placement_error(point: PointReadings, calibration: Calibration) -> PlacementError | None:
    """Error of a placement; None: too few hits, or a moving range."""
    mean = point.found.error
    if mean is None or point.hits < ENOUGH_HITS or not point.is_fixed:
        return None
    expected_cm = float(np.mean(calibration.forward(point.apparent_cm[point.is_hit])))
    error_cm = point.range_cm + mean.value - expected_cm
    return PlacementError(point.condition, point.run, point.range_cm, error_cm)


def _parameter(name: str, result: FitResult, before: MixtureParameters, at_bound: bool) -> MixtureParameter:
    try:
        low, high = (end if math.isfinite(end) else None for end in result.interval(name))
    except ValueError:
        # The profile of the likelihood has no end here.
        low, high = None, None
    estimate = IntervalEstimate(result.estimates[name], low, high, PARAMETERS[name].unit, result.readings)
    full_name = f"weights.{name}" if name in KINDS else name
    return MixtureParameter(full_name, estimate, attrgetter(full_name)(before), at_bound)


def _shares(result: FitResult, expected_cm: Array) -> dict[str, float]:
    """Mean shares of the kinds of readings at these ranges."""
    grid = result.grid
    model = ReadingModel(result.parameters, grid.minimum_cm, grid.maximum_cm, resolution_cm=grid.resolution_cm)
    return {name: float(np.mean(share)) for name, share in zip(KINDS, model.shares(expected_cm), strict=True)}


def _conditional(result: FitResult, shares: Mapping[str, float]) -> str:
    grown = [PARAMETERS[name].grows for name, value in result.estimates.items() if PARAMETERS[name].grows and value]
    if not grown:
        return "nothing depends on range (by BIC)"
    growing = f"{' and '.join(grown)} depend{'s' if len(grown) == 1 else ''} on range (by BIC)"
    if "missed_growth_per_m" not in result.estimates:
        return growing
    shown = ", ".join(f"{name} {share:.4f}" for name, share in shares.items())
    at_cm = min(WEIGHTS_RANGE_CM, result.grid.maximum_cm)
    return f"{growing}: weights are those at {at_cm:g} cm; over these readings: {shown}"
