"""The resolution of readings: the step in which a file's readings come, and the one in which they are compared."""

from collections.abc import Sequence

import numpy as np

from msp_range.arrays import Array, Flags, Indices, numbered
from msp_range.reading_model.kernel import on_grid
from msp_range.recording.csv_form import MeasuredData
from msp_sim.model.model import Model

STEPS_CM = (10.0, 5.0, 2.54, 2.0, 1.0, 0.5, 0.254, 0.2, 0.1, 0.05, 0.01)
"""Steps that are looked for, the largest first: usual resolutions of range finders and of files. The step decides how
much rounding is taken out of a spread; a step that is not listed counts as no rounding."""

TOLERANCE = 0.005
"""Share of a step by which a multiple may be off. Readings that went through 32-bit numbers are off by up to 2e-4 of a
millimetre; of readings without a step 1 % are within this, so that 30 of them never are."""


def step_of(reading_cm: Array, share: float = 1.0, steps: Sequence[float] = STEPS_CM) -> float:
    """Return the first of these steps of which this share of the readings are whole multiples [cm]; 0: there is none.

    The largest one, where they are the usual ones.

    Examples
    --------
    >>> print(step_of(np.array([120.0, 121.0, np.nan])), step_of(np.array([120.0, 120.37])))
    1.0 0.01
    """
    known = reading_cm[~np.isnan(reading_cm)]
    return next((step_cm for step_cm in steps if _share_on(known, step_cm) >= share), 0.0)


COMPARED_CM = (0.1, 0.2, 0.5, 1.0)
"""Steps in which readings are compared, next to the model's own. Finer ones show nothing: the finest effects of the
catalogue are waves of 0.4 cm. Coarser ones are rounding, which is an effect (`coarse_rounding`)."""
ON_STEP_SHARE = 0.95
"""A step is that of a file or a run if this share of its readings are multiples of it; a few others may be means, or of
another source. Of readings in a step half as large one in two is, by chance. Higher: one odd logger makes a file of
whole centimetres one of millimetres, in which its values repeat for no reason; lower: steps that are none."""
BETWEEN_STEPS = 0.2
"""A true range is between the multiples of a step if it is off by this share of it. Smaller: the set-ups' own errors
count; larger: few ranges are left to show a step."""
LEAST_VALUES = 8
"""A run with fewer different readings does not show its step: if the true step is half as large, all of this many are
whole larger ones apart with a probability of 0.8 %. Fewer: steps by chance; more: short runs in whole centimetres
are overlooked."""
WINDOW = 100
"""Values are compared among this many readings in a row. A step that is corrected for a temperature is one step in
these only, as that drifts; over a whole run drift fills the gaps, and whole centimetres that repeat are named `stale`.
Fewer: values are farther apart, and fine readings are compared in larger steps; more: quick drift is overlooked."""
GAP_QUANTILE = 0.1
"""Quantile of the distances between neighbouring values, counted as often as both were read, that is their step.
Readings that do not reach every multiple have larger ones, too; a few odd readings make smaller ones. Lower: odd
readings count; higher: few readings over long ranges are compared in larger steps than they could be."""
HALF = 1e-6
"""A half is one in spite of the rounding of a division, as a share of a step."""
NEIGHBOURS_SHARE = 0.5
"""Readings come in a step if as many values are one step apart as this share of those that are any other number of
steps apart. In independent readings one is the most frequent; of whole centimetres that were corrected for the
temperature and written to 0.1 cm it is ten. Higher: few readings over long ranges, where all are as many, are compared
in larger steps; lower: steps that are left out count."""
MAX_GAP = 50
"""Values that are farther apart, in steps, are not compared: 5 cm of 0.1. More: nothing; fewer: steps of that size pass
for their parts."""
GAPS_PER_STEP = 2.0
"""Readings in a step that is not compared (0.017 cm: a timer's microsecond) are rounded to a step that is this many
times as large. With fewer, some steps hold twice as many readings as others, and readings repeat more often than the
model says, which makes the name `stale`; more hides small effects."""


def to_step(reading_cm: Array, step_cm: float) -> Array:
    """Return readings as whole multiples of a step, same shape; halves go up.

    Halves to the next even number, as `numpy.rint` has them, put a tenth of readings in millimetres on a grid of 2 cm.

    Examples
    --------
    >>> print(to_step(np.array([120.5, 121.5, np.nan]), 1.0), to_step(np.array([12.25, 12.34]), 0.1))
    [121. 122.  nan] [12.3 12.3]
    """
    nearest = np.floor(np.asarray(reading_cm, dtype=np.float64) / step_cm + (0.5 + HALF))
    return np.asarray(on_grid(nearest * step_cm, step_cm), dtype=np.float64)


def step_with(data: MeasuredData, model: Model) -> float:
    """Return the step in which readings are compared with a model [cm].

    It is the model's own where that has faults of the bytes of readings, which are those of whole centimetres.
    """
    if any("code" in effect.effect.channels and not effect.effect.any_step for effect in model.effects):
        return model.sensor.resolution_cm
    usual, run = _usual(data, model), runs_and_sensors(data)
    limits_cm = model.sensor.minimum_cm, model.sensor.maximum_cm
    return compared_step(data["reading_cm"][usual], run[usual], model.sensor.resolution_cm, limits_cm)


def constants_cm(reading_cm: Array, run: Indices, step_cm: float, limits_cm: tuple[float, float]) -> Array:
    """Return what was added to readings that are a constant off the multiples of a step, run by run [cm], (n,).

    Rounded away, it would be an offset of up to half a step that no sensor has. It is 0 where nothing was added, for
    readings of such a run that are no multiples even without it, as its codes are, and in runs without a step.

    Parameters
    ----------
    reading_cm
        Readings, (n,); NaN: none.
    run
        Number of the run and sensor of each, (n,).
    step_cm
        The step.
    limits_cm
        The sensor's: readings between them show whether a run has the step.

    Examples
    --------
    >>> calibrated_cm = np.array([12.34, 13.34, 15.34, 12.34, 400.0])
    >>> print(constants_cm(calibrated_cm, np.zeros(5, dtype=int), 1.0, (2.0, 400.0)).round(3))
    [0.34 0.34 0.34 0.34 0.  ]
    """
    constant_cm = np.zeros(reading_cm.size)
    usual = (reading_cm > limits_cm[0]) & (reading_cm < limits_cm[1])
    for number in np.unique(run[usual]):
        own = np.flatnonzero(run == number)
        shown_cm = reading_cm[own[usual[own]]]
        middle_cm = _most_frequent(shown_cm)
        off_cm = middle_cm - float(to_step(np.array([middle_cm]), step_cm)[0])
        # Of a single reading any step is one but for a constant.
        is_off = shown_cm.size > 1 and abs(off_cm) > TOLERANCE * step_cm
        if is_off and _share_on(shown_cm - middle_cm, step_cm) >= ON_STEP_SHARE:
            constant_cm[own[_is_on(reading_cm[own] - middle_cm, step_cm)]] = off_cm
    return constant_cm


def runs_and_sensors(data: MeasuredData) -> Indices:
    """Return the number of the run and sensor of each reading, (n,): what was added is the same in one of these."""
    return numbered(np.char.add(np.char.add(data["run"], "\0"), data["sensor"]))


def _usual(data: MeasuredData, model: Model) -> Flags:
    """Readings between the sensor's limits, which are its codes."""
    reading_cm = data["reading_cm"]
    usual: Flags = (reading_cm > model.sensor.minimum_cm) & (reading_cm < model.sensor.maximum_cm)
    return usual


def measured_step(data: MeasuredData, model: Model) -> float:
    """Return the step in which a bench's readings come [cm]: that of `step_with`, or a coarser one that they show.

    Where the true ranges are multiples of a coarse step, quiet readings are too, and show nothing.
    """
    step_cm, reading_cm, true_cm = step_with(data, model), data["reading_cm"], data["true_range_cm"]
    usual = _usual(data, model)
    coarse_cm = step_of(reading_cm[usual], ON_STEP_SHARE)
    if coarse_cm <= step_cm:
        return step_cm
    with np.errstate(invalid="ignore"):
        between = np.abs(true_cm / coarse_cm - np.rint(true_cm / coarse_cm)) > BETWEEN_STEPS
    return coarse_cm if np.unique(reading_cm[usual & between]).size >= LEAST_VALUES else step_cm


def compared_step(reading_cm: Array, run: Indices, model_step_cm: float, limits_cm: tuple[float, ...] = ()) -> float:
    """Return the step in which a file's readings are compared with a model [cm].

    The smallest one that leaves out nothing in which they come: in no run are values farther apart. A step is the
    distance of readings of a run, to all of which the same may have been added. Readings that are coarser than whole
    centimetres and the model are compared in the larger step of these two.

    Parameters
    ----------
    reading_cm
        Readings between the sensor's limits, no codes, those of a run in their order, (n,).
    run
        Number of the run and sensor of each, (n,).
    model_step_cm
        Step of the model's readings.
    limits_cm
        Limits of the model's readings, which are multiples of the step.

    Examples
    --------
    >>> truth = np.linspace(100.0, 110.0, 500)
    >>> steps = [compared_step(np.round(truth, digits), np.zeros(500, dtype=int), 1.0) for digits in (0, 1)]
    >>> print(*steps)
    1.0 0.1
    """
    usual = {*COMPARED_CM, model_step_cm}
    steps = sorted(
        step_cm for step_cm in usual if not any(round(limit_cm / step_cm, 6) % 1.0 for limit_cm in limits_cm)
    )
    least_cm, gaps, weights, apart_cm = 0.0, [np.zeros(0)], [np.zeros(0)], np.array(reading_cm)
    for name in np.unique(run):
        own = np.round(reading_cm[run == name], 6)
        for start in range(0, own.size, WINDOW):
            values, counts = np.unique(own[start : start + WINDOW], return_counts=True)
            gaps.append(np.diff(values))
            weights.append(np.minimum(counts[1:], counts[:-1]).astype(np.float64))
        apart_cm[run == name] -= _most_frequent(own)
        if np.unique(own).size >= LEAST_VALUES:
            least_cm = max(least_cm, step_of(apart_cm[run == name], ON_STEP_SHARE, steps[::-1]))
    gap, weight = np.concatenate(gaps), np.concatenate(weights)
    if not gap.size:
        return model_step_cm
    order = np.argsort(gap)
    up_to = np.cumsum(weight[order])
    gap_cm = float(gap[order][np.searchsorted(up_to, GAP_QUANTILE * up_to[-1])])
    for step_cm in steps:
        full = _share_on(apart_cm, step_cm) >= ON_STEP_SHARE and _has_neighbours(gap, weight, step_cm)
        if step_cm >= least_cm and (full or step_cm >= GAPS_PER_STEP * gap_cm):
            return step_cm
    return steps[-1]


def _has_neighbours(gap: Array, weight: Array, step_cm: float) -> bool:
    """Whether values are one step apart about as often as any other number of steps."""
    steps = np.rint(gap / step_cm).astype(np.intp)
    times = np.bincount(np.minimum(steps, MAX_GAP), weight, MAX_GAP + 1)
    return bool(times[1] > 0.0 and times[1] >= NEIGHBOURS_SHARE * times[2:MAX_GAP].max())


def _most_frequent(reading_cm: Array) -> float:
    values, counts = np.unique(np.round(reading_cm, 6), return_counts=True)
    return float(values[counts.argmax()])


def _is_on(reading_cm: Array, step_cm: float) -> Flags:
    steps = reading_cm / step_cm
    found: Flags = np.abs(steps - np.rint(steps)) < TOLERANCE
    return found


def _share_on(reading_cm: Array, step_cm: float) -> float:
    return float(_is_on(reading_cm, step_cm).mean()) if reading_cm.size else 1.0
