"""The other sensors as the reference: for each sensor the range that the rest of the vehicle's sensors agree on.

It works on one run of several sensors' readings, with the vehicle's geometry and attitude where they were recorded. Its
rows get ``true_range_cm``, ``true_range_std_cm``, ``range_rate_cm_s`` and ``incidence_deg`` as the others see them.
What all sensors have in common is part of this reference and cannot be seen in a comparison with it. Nor can a
constant: three sensors know the plane of the ground below the fourth to a centimetre only, so each run's mean
difference is taken off the reference.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from msp_lab.readings.smoother import CLIMB, EAST, GATE, HEIGHT, NORTH, STATES, Smoothed, smooth
from msp_range.arrays import Array, Column, Flags, Indices, angle_deg
from msp_range.fusion.mounting import LEVEL, DownwardSensor, View
from msp_range.geometry import Matrix
from msp_range.recording.csv_form import MeasuredData
from msp_range.recording.error import RecordingError
from msp_sim.effects.base import OTHERS, REFERENCE, REFERENCE_STD, TRUE_RANGE
from msp_sim.model.model import Model

FROM_TRUTH = frozenset({"neighbour_range_cm", "target", "target_size_cm", REFERENCE})
"""Columns that only a simulator or a real reference knows; they are left out."""
MIN_OTHERS = 2
"""A sensor is compared with at least this many others: of two that differ nobody knows which one is off."""
MAX_STD_CM = 10.0
"""There is no reference where the others' estimate has a larger standard deviation than this [cm]: they got no echo, or
were not read. A larger limit adds rows without information."""
LEAST_STD_CM = 0.3
"""Readings scatter by at least this much [cm]: the rounding to whole centimetres."""
JERKS = tuple(float(10.0**power) for power in range(-4, 4))
"""Powers of the vehicle's white jerk that are tried [m^2/s^5]: from a hover, in which a second of readings is averaged,
to one that changes its acceleration by g within a tenth of a second."""
JERK_WINDOW_S = 1.5
"""The power of the jerk is estimated over this long before and after [s]: some thirty readings. Shorter windows follow
noise, longer ones smooth a manoeuvre as if it were a hover."""
SLOPES_PER_S = (1e-7, 1e-5, 1e-3)
"""Growths of the slope's variance that are tried [1/s]: one plane for the whole flight, gentle ground, and ground that
turns by 2 deg in a second."""
MEDIAN_SQUARE = 0.4549
"""Median of the square of a standard normal number."""
STANDING_CM, STANDING_S, LEGS_CM = 8.0, 5.0, 100.0
"""A vehicle stands on the ground where its readings stay within the first [cm] of the flight's lowest one for the
second [s]; only readings up to the height of legs, the third [cm], count, and the flight has to go as far above them.
No hover is as steady. A shorter time takes low passes for landings; higher legs a low hover. Slope and bumps below a
vehicle that stands are the same in hundreds of readings, and count as an error of a sensor."""
ROUNDS = 3
"""Rounds of smoothing. Each takes off the biases that the model has at the state of the round before, and leaves out
what does not fit it; a fourth changes nothing that is printed."""


@dataclass(frozen=True)
class Referenced:
    """Readings with the other sensors as reference."""

    data: MeasuredData
    """The readings in the order of time."""
    offsets_cm: Mapping[str, float]
    """How much more than the others each sensor with a reference read on average, which was taken off."""
    rows: Mapping[str, int]
    """How many readings of each have a reference; the average is over the echoes among them, without outliers."""


@dataclass(frozen=True)
class Mounting:
    """Where a vehicle's sensors are, and how it was turned."""

    sensors: Mapping[str, DownwardSensor]
    """The sensors that look down, by name."""
    rotations: Callable[[Array], Sequence[Matrix | None]]
    """Function from increasing times [s] to rotations from body to north, east, down; None where it is not known, which
    counts as level."""


def side_by_side(names: Collection[str]) -> Mounting:
    """All sensors at one place of a level vehicle, for a table that says nothing else."""
    sensors = {name: DownwardSensor((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), "nearest") for name in names}
    return Mounting(sensors, lambda time_s: [None] * time_s.size)


def with_others_as_reference(
    data: MeasuredData, model: Model, mounting: Mounting, without: Collection[str] = ()
) -> Referenced:
    """One run with the other sensors as the reference of each.

    Parameters
    ----------
    data
        Readings of at least three sensors; what a column says of the truth is not used.
    model
        How the sensors read: its biases are taken off the others' readings, its spread weighs them.
    mounting
        Geometry of the vehicle; other sensors' rows are left out.
    without
        Sensors that are no reference for the others.

    Raises
    ------
    RecordingError
        Too few sensors.
    """
    names = sorted(set(data["sensor"].tolist()) & set(mounting.sensors))
    for name in names or [""]:
        others = set(names) - {name, *without}
        if len(others) < MIN_OTHERS:
            raise RecordingError(
                f"found {len(others)} other downward sensors to compare {name or 'a sensor'} with, expected at least "
                f"{MIN_OTHERS}: of two that differ nobody knows which one is off"
            )
    rows = np.flatnonzero(np.isin(data["sensor"], names))
    order = rows[np.argsort(data["time_s"][rows], kind="stable")]
    # A flight is no experiment of a campaign: its angles are the vehicle's own.
    columns: dict[str, Column] = {key: column[order] for key, column in data.columns.items() if key not in FROM_TRUTH}
    columns.setdefault("condition", np.full(order.size, "baseline"))
    reference, offsets_cm = _reference(columns, names, model, mounting, [name not in without for name in names])
    known = columns["sensor"][~np.isnan(reference[TRUE_RANGE])].tolist()
    rows_of = {name: count for name in names if (count := known.count(name))}
    offsets = dict(zip(names, offsets_cm.tolist(), strict=True))
    return Referenced(MeasuredData(columns | reference), {name: offsets[name] for name in rows_of}, rows_of)


def _reference(
    columns: Mapping[str, Column], names: Sequence[str], model: Model, mounting: Mounting, trusted: Sequence[bool]
) -> tuple[dict[str, Column], Array]:
    """Columns of the reference of each row, in the order of time, and the offset of each sensor [cm]."""
    time_s, reading_cm = columns["time_s"], columns["reading_cm"]
    sensor = np.searchsorted(np.array(names), columns["sensor"])
    rotations = [LEVEL if rotation is None else rotation for rotation in mounting.rotations(time_s)]
    mounted = [mounting.sensors[names[each]] for each in sensor.tolist()]
    # Codes and limits say nothing of how far the ground is.
    is_range = (reading_cm > model.sensor.minimum_cm) & (reading_cm < model.sensor.maximum_cm)
    around_cm = _around(reading_cm, reading_cm < model.sensor.maximum_cm)
    flies = ~_grounded(time_s, around_cm, model.sensor.minimum_cm + GATE * model.sensor.reading_model.sigma_cm)
    usable = is_range & flies & np.asarray(trusted)[sensor]
    # A first height at each time, over level ground.
    state = np.zeros((time_s.size, STATES))
    state[:, HEIGHT] = _around(reading_cm, usable) / 100.0
    bias_cm, own_cm2 = np.zeros(time_s.size), np.full(time_s.size, model.sensor.reading_model.sigma_cm**2)
    excess_cm2 = np.zeros(len(names))
    fits = np.ones(time_s.size, dtype=bool)
    found: dict[str, Column] = {}
    for _ in range(ROUNDS):
        views = [_view(*each) for each in zip(mounted, rotations, state, strict=True)]
        geometry, offset_m = _linear(views, state)
        sees_ground = geometry[:, HEIGHT] != 0.0
        # One set of readings without each sensor, and one with all.
        variance_m2 = np.maximum(own_cm2 + excess_cm2[sensor], LEAST_STD_CM**2) / 1e4
        whole = np.where(usable & fits & sees_ground, variance_m2, np.inf)
        sets = np.stack([*(np.where(sensor == s, np.inf, whole) for s in range(len(names))), whole])
        seen = _smoothed(time_s, np.nan_to_num(reading_cm - bias_cm) / 100.0 - offset_m, geometry, sets)
        # About level ground: at a slope that is estimated, readings depend on it by height too. Two others, on one
        # line, do not show the slope across it, and by its own errors it would grow.
        state = seen.mean[-1] * (np.arange(STATES) < NORTH)
        expected_m, doubt_m2 = seen.predicted(geometry)
        here = sensor, np.arange(time_s.size)
        true_cm, std_cm2 = 100.0 * (expected_m[here] + offset_m), 1e4 * doubt_m2[here]
        off_cm = reading_cm - bias_cm - true_cm
        known = flies & sees_ground & (std_cm2 < MAX_STD_CM**2)
        with np.errstate(invalid="ignore"):
            fits = off_cm**2 < GATE**2 * (std_cm2 + 1e4 * variance_m2)
        # Readings are whole centimetres.
        excess_cm2 = _excess(off_cm, std_cm2 + own_cm2 + 1.0 / 12.0, sensor, usable & known, len(names))
        # Rough ground scatters all of them; what one has beyond that is its own, and no doubt of the reference.
        rough_cm2 = np.median(excess_cm2[np.asarray(trusted)])
        std_cm = np.sqrt(std_cm2 + max(float(rough_cm2), 0.0))
        of_own = seen.mean[here]
        rate = 100.0 * np.array([view.by_height for view in views]) * of_own[:, CLIMB]
        incidence = [_incidence_deg(*each) for each in zip(mounted, rotations, of_own, strict=True)]
        found = {
            TRUE_RANGE: np.where(known, true_cm, np.nan),
            REFERENCE_STD: np.where(known, std_cm, np.nan),
            "range_rate_cm_s": np.where(known, rate, np.nan),
            "incidence_deg": np.where(known, incidence, np.nan),
        }
        expected = model.rows({**columns, **found, TRUE_RANGE: true_cm, REFERENCE_STD: np.zeros(time_s.size)})
        bias_cm = np.where(np.isfinite(expected.centre_cm), expected.centre_cm - true_cm, 0.0)
        own_cm2 = np.broadcast_to(expected.sigma_cm**2, time_s.shape)
    found[REFERENCE] = np.full(time_s.size, OTHERS)
    offsets_cm = _offsets(off_cm, std_cm2 + 1e4 * variance_m2, sensor, is_range & known, len(names))
    found[TRUE_RANGE] = found[TRUE_RANGE] + offsets_cm[sensor]
    return found, offsets_cm


def _offsets(off_cm: Array, expected_cm2: Array, sensor: Indices, rows: Flags, sensors: int) -> Array:
    """By how much more than the others each sensor reads on average [cm], without outliers about its own median.

    About the others, a sensor that is off by more than the gate would have no offset, or one of its nearest readings.
    """
    offsets_cm = np.zeros(sensors)
    for s in range(sensors):
        here = rows & (sensor == s)
        if here.any():
            about_median = off_cm[here] - np.median(off_cm[here])
            offsets_cm[s] = off_cm[here][about_median**2 < GATE**2 * expected_cm2[here]].mean()
    return offsets_cm


def _around(reading_cm: Array, rows: Flags) -> Array:
    """The median of seven of these readings around each one [cm], (n,); 0 where there are none."""
    at = np.flatnonzero(rows)
    if not at.size:
        return np.zeros(reading_cm.size)
    first = np.clip(np.searchsorted(at, np.arange(reading_cm.size)) - 3, 0, max(at.size - 7, 0))
    seven = np.minimum(first[:, None] + np.arange(7), at.size - 1)
    return np.asarray(np.median(reading_cm[at[seven]], axis=1))


def _grounded(time_s: Array, around_cm: Array, least_cm: float) -> Flags:
    """Where a vehicle is nearer to the ground than `least_cm`, or stands there for `STANDING_S` or longer, (n,)."""
    near = around_cm <= least_cm
    lowest = (around_cm < around_cm.min(initial=np.inf) + STANDING_CM) & (around_cm < LEGS_CM)
    if not around_cm.max(initial=0.0) > around_cm.min(initial=np.inf) + LEGS_CM:
        return near
    stretch = np.cumsum(np.diff(lowest, prepend=False) != 0)
    first, last = (np.searchsorted(stretch, stretch, side) for side in ("left", "right"))
    stands: Flags = near | (lowest & (time_s[last - 1] - time_s[first] >= STANDING_S))
    return stands


def _view(mounted: DownwardSensor, rotation: Matrix, state: Array) -> View:
    """What a sensor should read; a sensor that looks past the ground does not depend on the height."""
    found = mounted.turned(rotation).view(float(state[HEIGHT]), float(state[NORTH]), float(state[EAST]))
    return View(0.0, 0.0, 0.0, 0.0, 0.0) if found is None else found


def _linear(views: Sequence[View], state: Array) -> tuple[Array, Array]:
    """Derivatives of the readings by the state (n, 5), and what readings have beyond their product with it [m]."""
    geometry = np.zeros((len(views), STATES))
    geometry[:, (HEIGHT, NORTH, EAST)] = [(view.by_height, view.by_north, view.by_east) for view in views]
    expected_m = np.array([view.expected_m for view in views])
    return geometry, expected_m - np.einsum("ni,ni->n", geometry, state)


def _smoothed(time_s: Array, reading_m: Array, geometry: Array, sets: Array) -> Smoothed:
    """Smoothing with the powers of jerk and slope that the readings themselves make most likely."""
    powers, slopes, slope = np.array(JERKS), np.array(SLOPES_PER_S), SLOPES_PER_S[1]
    tried = np.repeat(sets[-1:], powers.size, axis=0)
    likely = smooth(time_s, reading_m, geometry, tried, powers[:, None], slope, backward=False).log_likelihood
    summed = np.concatenate([np.zeros((powers.size, 1)), np.cumsum(likely, axis=1)], axis=1)
    first, last = (np.searchsorted(time_s, time_s + shift) for shift in (-JERK_WINDOW_S, JERK_WINDOW_S))
    jerk = powers[np.argmax(summed[:, last] - summed[:, first], axis=0)]
    if np.any(geometry[:, [NORTH, EAST]]):
        tried = np.repeat(sets[-1:], slopes.size, axis=0)
        likely = smooth(time_s, reading_m, geometry, tried, jerk, slopes, backward=False).log_likelihood
        slope = SLOPES_PER_S[int(np.argmax(likely.sum(axis=1)))]
    return smooth(time_s, reading_m, geometry, sets, jerk, slope)


def _excess(off_cm: Array, expected_cm2: Array, sensor: Indices, rows: Flags, sensors: int) -> Array:
    """By how much the others scatter more about each other than their model says [cm^2], for each sensor.

    The ground differs below the sensors. It is negative where the model's spread is too large. Medians, since outliers
    would widen the gate that is to keep them out, and since one of the others may be the one that errs.
    """
    own = np.full(sensors, np.nan)
    for s in range(sensors):
        here = rows & (sensor == s)
        if here.any():
            normal = (off_cm[here] - np.median(off_cm[here])) ** 2 / expected_cm2[here]
            hits = normal < GATE**2 * np.median(normal) / MEDIAN_SQUARE
            own[s] = (float(np.median(normal[hits])) / MEDIAN_SQUARE - 1.0) * float(np.median(expected_cm2[here]))
    others = [np.delete(own, s) for s in range(sensors)]
    return np.array([np.nanmedian(other) if np.isfinite(other).any() else 0.0 for other in others])


def _incidence_deg(mounted: DownwardSensor, rotation: Matrix, state: Array) -> float:
    """Angle between a sensor's axis and the ground's normal [deg]."""
    normal = np.array([state[NORTH], state[EAST], 1.0])
    cosine = normal @ np.array(rotation) @ np.array(mounted.boresight) / np.linalg.norm(normal)
    return float(angle_deg(cosine))
