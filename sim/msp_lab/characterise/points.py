"""Readings sorted into points: one set-up of the bench each, which is the independent unit, not the reading.

`PointReadings` of measured data say which readings are codes, which are of the surface and which are not, and their
mean error and spread. All readings of a point share the error of its placement, so that analyses of anything but the
scatter of readings use points as their unit.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import groupby
from typing import Any, TypeVar

import numpy as np
from scipy import stats

from msp_lab.characterise.point_findings import PointResult, SetUp
from msp_lab.estimates import MeanAndSpread, common_spread, mean_and_spread
from msp_lab.readings.resolution import ON_STEP_SHARE, step_of
from msp_range.acoustics.air import ZERO_CELSIUS_K, sonic_temperature_c
from msp_range.arrays import Array, Flags, Indices, Texts, numbered
from msp_range.reading_model.sensor_model import SATURATED_CM, SensorModel
from msp_range.recording.csv_form import MeasuredData
from msp_sim.effects.air_temperature import AIR_TEMPERATURE
from msp_sim.model.model import Model

GATE_CM = 8.0
"""A reading this near to the middle of its point's hits is one [cm]: four times the noise that a Kalman filter of the
report assumes (R = 3.78 cm^2). A narrower gate makes outliers of noisy hits, a wider one hits of outliers."""
GATE_DEVIATIONS = 4.5
GATE_SHARE = 0.05
"""For hits that scatter more, the gate is this many of their robust standard deviations, but at most this share of the
range: one in 150,000 normal hits is outside."""
FARTHEST_CM, FARTHEST_SHARE = 25.0, 0.15
"""Readings with a median error above this, or this share of the range, are not of the surface [cm]: four times the
error of 46 deg C at 260 cm, and more than that of a neighbour's ping 1 ms early."""
MIN_HITS = 3
"""A point with fewer readings of the surface has no mean error: its spread would be unknown."""
LEVEL_GAP_C = 4.0
"""Air temperatures that differ by more are different levels of the temperature experiment [deg C]: a room varies by
less, a box by more."""
BIN_CM = 20.0
"""Width of the bins that serve as points if the range changes from row to row [cm]: a scale of 1 % changes the error
by 2 mm within one."""
MIN_READINGS = 5
"""If most ranges have fewer readings, they are not set-ups of a bench: the range changed while it was read."""

Record = TypeVar("Record")
BASELINE = "baseline"
VARIED = {"incidence_deg": "field_of_view", "vibration_hz": "vibration", "external_level_db": "external_interference"}
"""Experiment of a reading without a `condition`: that of a column which is known and not zero."""
USUAL_TARGETS = ("plywood", "wood")
"""Words of the target that others are compared with; without such a one it is that with the most readings."""
COMPARED_SHARE = 0.5
"""A target varies if this share of its readings is at ranges of the usual one. Those at ranges of their own are part of
the baseline: a wall that only the farthest points have is no material to compare. Any value from 0.2 to 0.8 decides
alike."""

SETTINGS = (
    "target_size_cm",
    "vibration_hz",
    "external_level_db",
    "external_duty",
    "external_distance_cm",
    "external_frequency_khz",
)
"""Columns of which every value makes a different point."""
SOURCE_DISTANCE_CM = 30.0
"""Distance at which the level of an external source is given [cm]."""
CLASS_DB = 20.0
"""Width of the classes of sound level at the sensor that external sources are sorted into [dB]."""
NEAR_KHZ = 1.0
"""A source within this of the ping's frequency counts as on it [kHz]: the receiver's bandwidth is about 2 kHz."""


@dataclass(frozen=True)
class PointReadings(SetUp):
    """The readings of one point."""

    reading_cm: Array
    true_range_cm: Array
    air_temperature_c: Array
    humidity_pct: Array
    """A row each; NaN where there was no answer, or where it is unknown."""
    reference_std_cm: Array
    """Standard deviation of the error of each row's true range [cm]; 0 where it is not stated."""
    incidence_deg: float
    target_temperature_c: float
    """NaN where unknown."""
    sensor_model: SensorModel
    """Limits, codes and calibration temperature."""
    step_cm: float
    """Step of the readings [cm]; 0 where they have none."""
    rows: Indices
    """Their row numbers in the data."""
    air_share: float = 0.0
    """As of `air_share`."""
    usual_spread_cm: float | None = None
    """Spread before rounding that the baseline's set-ups have in common [cm]; None where too few of them show any."""

    @cached_property
    def range_cm(self) -> float:
        """True range, the mean over the point [cm]."""
        # Their mean differs from it in the last digit, and equal ranges have to be equal.
        return float(self.true_range_cm[0] if self.is_fixed else self.true_range_cm.mean())

    @property
    def is_fixed(self) -> bool:
        """All readings have the same true range, and so the same error of it."""
        return bool((self.true_range_cm == self.true_range_cm[0]).all())

    @property
    def placement_cm2(self) -> float:
        """Variance of an error that the true ranges of all readings have in common [cm^2]."""
        return float(np.mean(self.reference_std_cm**2)) if self.is_fixed else 0.0

    @cached_property
    def is_code(self) -> Flags:
        """Readings of no echo: the maximum, and 255 where the others are not within the gate of it."""
        missed: Flags = self.reading_cm == self.sensor_model.maximum_cm
        if self.sensor_model.reading_model.saturated_fraction == 0.0:
            return missed
        saturated = self.reading_cm == SATURATED_CM
        others = self.reading_cm[~np.isnan(self.reading_cm) & ~missed & ~saturated]
        expected_cm = float(np.median(others)) if 2 * others.size >= self.reading_cm.size else self.range_cm
        return missed | saturated if abs(expected_cm - SATURATED_CM) > GATE_CM else missed

    @cached_property
    def is_echo(self) -> Flags:
        """Answers that are no code."""
        return ~np.isnan(self.reading_cm) & ~self.is_code

    @cached_property
    def error_cm(self) -> Array:
        """Reading minus truth of all rows [cm]."""
        return self.reading_cm - self.true_range_cm

    @cached_property
    def gate_cm(self) -> tuple[float, float]:
        """Errors between which a reading is of the surface [cm].

        About the middle of the fullest window of twice `GATE_CM`: a median would lie between two clusters. Both ends
        are the same where that window is too far off to be of the surface; NaN where nothing is echoes.
        """
        echoes = np.sort(self.error_cm[self.is_echo])
        if not echoes.size:
            return math.nan, math.nan
        counts = np.searchsorted(echoes, echoes + 2.0 * GATE_CM, side="right") - np.arange(echoes.size)
        fullest = np.flatnonzero(counts == counts.max())
        # Of equally full ones the nearest to the truth.
        first = int(fullest[np.abs(echoes[fullest] + GATE_CM).argmin()])
        window = echoes[first : first + int(counts[first])]
        middle = float(np.median(window))
        if abs(middle) > max(FARTHEST_CM, FARTHEST_SHARE * self.range_cm):
            return 0.0, 0.0
        deviation = float(stats.median_abs_deviation(window, scale="normal"))
        half = max(GATE_CM, min(GATE_DEVIATIONS * deviation, GATE_SHARE * self.range_cm))
        return middle - half, middle + half

    @cached_property
    def is_hit(self) -> Flags:
        """Readings of the surface."""
        low, high = self.gate_cm
        return self.is_echo & (self.error_cm >= low) & (self.error_cm <= high) & (low < high)

    @cached_property
    def compensation(self) -> Array:
        """Factor of a reading that takes off what the air does to it, for each row.

        Of a sensor that corrects nothing it is sqrt(T / T_calibration), absolute temperatures of dry air as fast. NaN
        where the air's temperature is unknown, and where it does not change the readings. Air of unknown humidity
        counts as dry.
        """
        if self.air_share == 0.0:
            return np.full(self.air_temperature_c.size, math.nan)
        calibration_k = self.sensor_model.calibration_temperature_c + ZERO_CELSIUS_K
        sonic_c = sonic_temperature_c(self.air_temperature_c, np.nan_to_num(self.humidity_pct))
        bare = np.sqrt((sonic_c + ZERO_CELSIUS_K) / calibration_k)
        return 1.0 / (1.0 + self.air_share * (1.0 / bare - 1.0))

    @cached_property
    def apparent_cm(self) -> Array:
        """Range that a perfect sensor reads, which takes the air to be as in its calibration [cm]; else the truth."""
        factor = np.where(np.isnan(self.compensation), 1.0, self.compensation)
        return self.true_range_cm / factor

    @cached_property
    def _statistics(self) -> MeanAndSpread | None:
        """Mean error and spread of the hits."""
        if self.hits < MIN_HITS:
            return None
        if self.is_fixed:
            # Readings are whole steps, and errors too where the truth is one number.
            mean, spread = mean_and_spread(self.reading_cm[self.is_hit], self.step_cm, self.usual_spread_cm)
            return MeanAndSpread(mean.mapped(lambda end: end - self.range_cm), spread)
        mean, spread = mean_and_spread(self.error_cm[self.is_hit], 0.0)
        # Where the truth changes, its error and the rounding are part of the scatter.
        other_cm2 = float(np.mean(self.reference_std_cm[self.is_hit] ** 2)) + self.step_cm**2 / 12
        return MeanAndSpread(mean, spread.mapped(lambda end: end**2).root(other_cm2))

    @property
    def hits(self) -> int:
        """How many readings are of the surface."""
        return int(self.is_hit.sum())

    @cached_property
    def found(self) -> PointResult:
        """What was found at this point."""
        echo_error = self.error_cm[self.is_echo]
        other_error = self.error_cm[self.is_echo & ~self.is_hit]
        is_short = other_error < sum(self.gate_cm) / 2.0
        is_no_echo = self.reading_cm == self.sensor_model.maximum_cm
        error, spread = self._statistics or (None, None)
        compensated = None
        if error is not None and not np.isnan(self.compensation[self.is_hit]).all():
            # Each row by its own air; the interval is that of the mean, moved.
            change = float(np.nanmean((self.compensation - 1.0)[self.is_hit] * self.reading_cm[self.is_hit]))
            compensated = error.mapped(lambda end: end + change)
        return PointResult(
            **{field.name: getattr(self, field.name) for field in fields(SetUp)},
            true_range_cm=self.range_cm,
            incidence_deg=_known(self.incidence_deg),
            air_temperature_c=_known(_mean(self.air_temperature_c)),
            target_temperature_c=_known(self.target_temperature_c),
            readings=self.reading_cm.size,
            hits=self.hits,
            short=int(is_short.sum()),
            long=int((~is_short).sum()),
            no_echo=int(is_no_echo.sum()),
            saturated=int((self.is_code & ~is_no_echo).sum()),
            no_answer=int(np.isnan(self.reading_cm).sum()),
            error=error,
            spread=spread,
            compensated_error=compensated,
            worst_error_cm=float(max(echo_error, key=abs)) if echo_error.size else None,
        )


def sort_into_points(data: MeasuredData, sensor_model: SensorModel) -> list[PointReadings]:
    """The points of measured data, in the order of their first readings.

    Rows without a true range are left out: their error is unknown.
    """
    rows = np.flatnonzero(~np.isnan(data["true_range_cm"]))
    known = data.select(rows)
    if not len(known):
        return []
    condition = conditions(known)
    words = {name: known.column(name) for name in ("sensor", "run")}
    words |= {"condition": condition, "level": _levels(known, condition, sensor_model.frequency_hz)}
    incidence_deg = np.nan_to_num(known.column("incidence_deg"))
    angle = np.where(condition == "field_of_view", np.round(incidence_deg, 1), 0.0)
    settings = [np.nan_to_num(known.column(name), nan=-1.0) for name in SETTINGS]
    different = (*words.values(), known.column("target"), _places(known["true_range_cm"]), angle, *settings)
    keys = np.column_stack([numbered(column) for column in different])
    point = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    step_cm, share = step_of(known["reading_cm"], ON_STEP_SHARE), air_share(sensor_model)
    points = []
    for here in np.split(np.argsort(point, kind="stable"), np.cumsum(np.bincount(point))[:-1]):
        part = known.select(here)
        names: dict[str, Any] = {name: str(column[here[0]]) for name, column in words.items()}
        points.append(
            PointReadings(
                **names,
                reading_cm=part["reading_cm"],
                true_range_cm=part["true_range_cm"],
                air_temperature_c=part.column("air_temperature_c"),
                humidity_pct=part.column("humidity_pct"),
                reference_std_cm=np.nan_to_num(part.column("true_range_std_cm")),
                incidence_deg=_mean(part.column("incidence_deg")),
                target_temperature_c=_mean(part.column("target_temperature_c")),
                sensor_model=sensor_model,
                step_cm=step_cm,
                rows=rows[here],
                air_share=share,
            )
        )
    points.sort(key=lambda each: int(each.rows[0]))
    alike = [set_up.reading_cm[set_up.is_hit] for set_up in points if set_up.condition == BASELINE and set_up.is_fixed]
    usual_cm = common_spread([each for each in alike if each.size >= MIN_HITS], step_cm)
    return [replace(set_up, usual_spread_cm=usual_cm) if set_up.condition == BASELINE else set_up for set_up in points]


def air_share(sensor: SensorModel) -> float:
    """Share of what the air's temperature does to echoes that a model's readings show: that of its `air_temperature`.

    It is 0 for a model without this effect: a sensor that compensates itself, or ranges with light or radio.
    """
    return sum(term.values["share"] for term in Model.of(sensor).effects if term.effect is AIR_TEMPERATURE)


def conditions(data: MeasuredData) -> Texts:
    """Return the experiment of each row: its column `condition`, or what is varied."""
    found = np.full(len(data), BASELINE, dtype="U32")
    for name, word in VARIED.items():
        column = data.column(name)
        found[~np.isnan(column) & (column != 0.0)] = word
    if (found == "field_of_view").any():
        # The rows straight ahead belong to the same experiment.
        found[(data.column("incidence_deg") == 0.0) & (found == BASELINE)] = "field_of_view"
    found[_other_targets(data, found == BASELINE)] = "material"
    named = data.column("condition")
    return np.where(named == "", found, named)


def _other_targets(data: MeasuredData, rows: Flags) -> Flags:
    """Which of these rows are of another target than the usual one, at its ranges."""
    target, place_cm = data.column("target"), np.round(data["true_range_cm"], 1)
    found, rows = np.zeros(len(data), dtype=bool), rows & (data.column("condition") == "") & (target != "")
    words = np.unique(target[rows])
    if words.size < 2:
        return found
    answers = [np.sum(rows & (target == word) & ~np.isnan(data["reading_cm"])) for word in words]
    usual = usual_target(words.tolist()) or words[np.argmax(answers)]
    is_common = np.isin(place_cm, place_cm[rows & (target == usual)])
    for word in words[words != usual]:
        own = rows & (target == word)
        found |= own & (is_common[own].mean() >= COMPARED_SHARE)
    return found


def usual_target(words: Sequence[str]) -> str | None:
    """The target that others are compared with by its word; None: no word says so."""
    return next((each for usual in USUAL_TARGETS for each in words if usual in each.lower()), None)


def _levels(data: MeasuredData, condition: Texts, frequency_hz: float) -> Texts:
    """What the experiment varies, as a word for each row."""
    level = np.full(len(data), "", dtype="U48")
    for name, words in (
        ("material", lambda rows: rows.column("target")),
        ("temperature", lambda rows: _temperature_words(rows.column("air_temperature_c"))),
        ("vibration", lambda rows: ["" if math.isnan(hz) else f"{hz:g} Hz" for hz in rows.column("vibration_hz")]),
        ("external_interference", lambda rows: _external_words(rows, frequency_hz)),
    ):
        level[condition == name] = words(data.select(condition == name))
    return level


def _temperature_words(air_c: Array) -> Texts:
    """Clusters of temperatures, each by its mean; "" where the temperature is not known."""
    found, known = np.full(air_c.size, "", dtype="U48"), np.flatnonzero(~np.isnan(air_c))
    order = known[np.argsort(air_c[known])]
    for cluster in np.split(order, np.flatnonzero(np.diff(air_c[order]) > LEVEL_GAP_C) + 1):
        found[cluster] = f"{np.round(_mean(air_c[cluster])):g} C"
    return found


def _external_words(data: MeasuredData, frequency_hz: float) -> list[str]:
    """Class of the sound level at the sensor: the source's, less 20 dB for each ten times its distance."""
    source_db, duty = data.column("external_level_db"), data.column("external_duty")
    distance_cm = np.nan_to_num(data.column("external_distance_cm"), nan=SOURCE_DISTANCE_CM)
    level_db = source_db - 20.0 * np.log10(np.maximum(distance_cm, 1.0) / SOURCE_DISTANCE_CM)
    lowest_db = CLASS_DB * np.floor((level_db + CLASS_DB / 2) / CLASS_DB) - CLASS_DB / 2
    off_khz = np.abs(np.nan_to_num(data.column("external_frequency_khz") - frequency_hz / 1e3))
    return [
        "quiet"
        if math.isnan(low) or share == 0.0
        else f"{low:.0f} to {low + CLASS_DB:.0f} dB at the sensor" + (", another frequency" if off > NEAR_KHZ else "")
        for low, share, off in zip(lowest_db.tolist(), duty.tolist(), off_khz.tolist(), strict=True)
    ]


def _places(truth_cm: Array) -> Array:
    """True range of each row's point: itself at a bench, the middle of a bin where it changes all the time."""
    _, which, counts = np.unique(truth_cm, return_inverse=True, return_counts=True)
    if np.median(counts[which.ravel()]) >= MIN_READINGS:
        return truth_cm
    return (np.floor(truth_cm / BIN_CM) + 0.5) * BIN_CM


def grouped(records: Iterable[Record], key: Callable[[Record], Any]) -> dict[Any, list[Record]]:
    """Points, or others, by what distinguishes them, in its order."""
    return {each: list(here) for each, here in groupby(sorted(records, key=key), key)}


def _mean(values: Array) -> float:
    known = values[~np.isnan(values)]
    return float(known.mean()) if known.size else math.nan


def _known(value: float) -> float | None:
    return None if math.isnan(value) else value
