"""The sensor model file: what is known about one kind of range finder.

A `SensorModel` is made of YAML and validated. The bridge takes limits, timing, calibration temperature, beam and noise
from it; the simulator draws its readings from the same file; characterisation and the gap workflow write it back with
fitted numbers, effects and the evidence for them.
"""

import zlib
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import Field, GetJsonSchemaHandler, field_validator, model_validator
from pydantic_core import CoreSchema

from msp_range.acoustics.beam import BreakawayTable
from msp_range.correction.calibration import Calibration, curve_through
from msp_range.sensors.table import NONE, driver_names, find_driver
from msp_range.yaml_file import Section, config_path, load

SATURATED_CM = 255
"""What a no-echo code reads where its two bytes are OR-ed (0x02 | 0xFD for 765) or it saturates to eight bits [cm]."""

WEIGHTS_RANGE_CM = 300.0
"""Range at which the share of missed echoes is the one in `weights`, where it changes with range [cm]; of a sensor that
reaches less far, its `maximum_cm`: what it misses beyond that is no number of its readings."""

Medium: TypeAlias = Literal["sound", "light", "radio"]
"""What a sensor ranges with."""
UNUSED_TEMPERATURE_C = 20.0
"""`calibration_temperature_c` of a sensor of light or radio, where the file has none [deg C]. Any value will do: its
ranges are compensated from this temperature to the same one, which changes nothing."""

Probability = Annotated[float, Field(ge=0.0, le=1.0)]


class Timing(Section):
    """When a sensor answers after a ping, and when it may be pinged again."""

    ready_s: float = Field(ge=0.0, le=1.0)
    """Time from the ping to the answer without the echo's own time of flight [s]."""

    s_per_cm: float = Field(gt=0.0, le=0.001)
    """Time that each centimetre of range adds to it [s/cm]: sound there and back."""

    cycle_s: float = Field(gt=0.0, le=1.0)
    """Length of a full cycle, the one without an echo [s]."""

    deadline_s: float = Field(gt=0.0, le=2.0)
    """Time after the ping at which a sensor that has not answered is given up [s]."""

    ping_interval_s: float = Field(gt=0.0, le=10.0)
    """Shortest time between two pings that can disturb each other, for the sound to decay [s]."""

    @model_validator(mode="after")
    def _in_order(self) -> "Timing":
        if not self.ready_s < self.cycle_s <= self.deadline_s:
            raise ValueError(
                "expected ready_s < cycle_s <= deadline_s, "
                f"found {self.ready_s:g}, {self.cycle_s:g}, {self.deadline_s:g}"
            )
        return self

    def answer_s(self, range_cm: float) -> float:
        """Time from the ping to the answer where the echo is from a range [s]."""
        return self.ready_s + self.s_per_cm * range_cm


class BreakawayPoint(Section):
    """One row of the breakaway table (report 4.3.3)."""

    range_cm: float = Field(gt=0.0, le=10_000.0)
    """Perpendicular distance to the surface [cm]."""

    half_angle_deg: float = Field(gt=0.0, lt=90.0)
    """Largest angle to either side of the axis with a reliable range [deg]."""


class PredictedBreakaway(Section):
    """Half angles beyond the measured ones, which ``msp-lab beam`` computes before flight."""

    inputs: str = Field(pattern="^crc32-[0-9a-f]{8}$")
    """Hash of the file's own numbers that they were computed from: breakaway, heard_on_axis_cm, maximum_cm and
    frequency_hz. The rows are used only while the file still has these numbers."""

    rows: tuple[BreakawayPoint, ...]
    """From behind the last measured range on; beyond the last row its angle is held."""


class CalibrationKnot(Section):
    """A knot of the piecewise linear calibration."""

    true_cm: float = Field(ge=0.0, le=10_000.0)
    """True range [cm]."""

    reading_cm: float = Field(ge=-10_000.0, le=10_000.0)
    """Mean reading there, in air of the calibration temperature, before the sensor's limits [cm]: an offset may take it
    below 0, where the sensor reads its minimum."""


class Weights(Section):
    """Shares of the four kinds of reading; their sum is 1."""

    hit: Probability
    """Share of readings of the surface itself: Thrun's z_hit."""

    short: Probability
    """Share of readings of something nearer than the surface: Thrun's z_short."""

    missed: Probability
    """Share of echoes missed, which read the maximum: Thrun's z_max."""

    random: Probability
    """Share of readings that nothing explains: Thrun's z_rand."""

    @model_validator(mode="after")
    def _sum_to_one(self) -> "Weights":
        total = self.hit + self.short + self.missed + self.random
        # Six digits are what a person or a fit writes.
        if abs(total - 1.0) > 1e-6:
            raise ValueError(f"expected weights whose sum is 1, found a sum of {total:.7g}")
        return self


class MixtureParameters(Section):
    """Parameters of the base mixture (report eq 9-12); `msp_range.reading_model.mixture` has the equations."""

    weights: Weights
    """Shares of hit, short, missed and random readings."""

    sigma_cm: float = Field(ge=0.01, le=100.0)
    """Standard deviation of a hit before it is rounded to `resolution_cm`: Thrun's sigma_hit [cm]."""

    short_rate_per_m: float = Field(gt=0.0, le=1000.0)
    """Rate at which short readings get rarer with range: Thrun's lambda_short [1/m]."""

    saturated_fraction: Probability
    """Share of no-echo readings that arrive as 255."""

    sigma_growth_cm_per_m: float = Field(0.0, ge=0.0, le=100.0)
    """Growth of the standard deviation with range z: sigma^2 = sigma_cm^2 + (growth z)^2 [cm/m]."""

    missed_growth_per_m: float = Field(0.0, ge=-100.0, le=100.0)
    """Growth of the log odds of a missed echo against the other kinds with range; `weights` are those at 3 m, or at
    `maximum_cm` if that is less [1/m]."""

    correlation: float = Field(0.0, ge=0.0, le=0.98)
    """Correlation of the errors of two hits that are `correlation_spacing_s` apart; over t it is this to the power of
    t / `correlation_spacing_s`. The simulator and the gap workflow use it, the bridge does not."""

    correlation_spacing_s: float = Field(0.1, gt=0.0, le=1000.0)
    """The time to which `correlation` refers [s]."""


MEAN_EFFECTS = frozenset(
    {"mounting_offset", "session_offset", "range_scale", "bend", "warm_up", "flooring", "threshold_walk", "hot_box"}
    | {"air_temperature", "thermometer_offset", "temperature_gradient", "humidity", "latency", "motion_during_ping"}
    | {"slant_range", "nearest_point", "day_cycle"}
)
"""Effects of the catalogue that change the mean reading only, which the sensor watch does not ask for: it follows each
sensor's offset from the others. A model with other effects needs `InFlight`; a name too many lets good sensors be
reported."""
WIDEST_IN_FLIGHT_CM = 100.0
"""Hits of a flight scatter by at most this much [cm]: no sensor that scatters by a metre is worth watching. Larger: the
bridge watches what says nothing; smaller: models of poor sensors are not watched."""


class InFlight(Section):
    """Means over a flight of what all effects together make of the readings; the bridge watches the sensor by them."""

    short: Probability
    """share of readings that are more than four standard deviations nearer than the surface, whatever their cause"""

    missed: Probability
    """share of readings of the maximum or of its damaged form while the surface is in range"""

    sigma_cm: float = Field(ge=0.01, le=WIDEST_IN_FLIGHT_CM)
    """standard deviation of a hit before it is rounded [cm]"""


class SensorModel(Section):
    """A sensor model file."""

    name: str = Field(min_length=1)
    """Name of the part, as its maker writes it."""

    maker: str = Field(min_length=1)
    """Who makes it."""

    driver: str = Field(json_schema_extra=lambda schema: schema.update(enum=[*driver_names()]))
    """The driver that speaks its protocol; none: its readings are characterised, and it does not fly."""

    medium: Medium = "sound"
    """What it ranges with. Light and radio do not change with the air: no correction for temperature, a ray instead of
    a beam that detects a surface from the side, and `breakaway` is half the beam's divergence."""

    compensates_air: bool = False
    """Whether the sensor itself corrects its ranges for the temperature of the air; the bridge then does not."""

    minimum_cm: float = Field(ge=0.0)
    """Shortest reading; a nearer surface reads this too [cm]. Whole centimetres, where a driver answers."""

    maximum_cm: float = Field(le=32767.0)
    """Longest reading; it is also the code for 'no echo' [cm]. Whole centimetres, where a driver answers."""

    resolution_cm: float = Field(ge=0.01, le=100.0)
    """Step of the readings [cm], which are whole multiples of it: whole centimetres, or a whole number of steps in one.
    A finer step than that of the driver's answers is that of measured readings."""

    calibration_temperature_c: float = Field(ge=-20.0, le=50.0)
    """Air temperature that the sensor's own conversion to range assumes [deg C]; left out for light and radio."""

    oblique_reading: Literal["slant", "nearest", "unknown"]
    """What a canted sensor reads over flat ground: the range along its axis, or to the nearest point of the ground."""

    timing: Timing
    """When the sensor answers, and when it may be pinged again."""

    frequency_hz: float = Field(42_000.0, ge=20_000.0, le=500_000.0)
    """Frequency of the ping [Hz]."""

    breakaway: tuple[BreakawayPoint, ...] = Field(min_length=1)
    """Largest angle with a reliable range, over range."""

    predicted_breakaway: PredictedBreakaway | None = None
    """The same beyond the measured ranges, made by `msp-lab beam`; left out: the last measured angle is held."""

    heard_on_axis_cm: float | None = Field(None, gt=0.0, le=10_000.0)
    """Range at which a wall straight ahead gives an echo for sure [cm]; left out: that of the last breakaway angle."""

    calibration: tuple[CalibrationKnot, ...] = ()
    """Mean reading over true range: linear between the knots, and beyond them. None: the reading is the range."""

    calibration_scale_std_pct: float | None = Field(None, ge=0.0, le=100.0)
    """Standard error of the calibration's scale [%], by the bench that it is from. A scale within it is none that the
    gap workflow names; left out: it counts as exact. The bridge does not use it."""

    reading_model: MixtureParameters
    """Parameters of the base mixture that the readings follow."""

    effects: tuple[dict[str, Any], ...] = ()
    """Effects on top of the base mixture, for the simulator; the bridge reads only their names."""

    in_flight: InFlight | None = None
    """What the effects make of the readings, as plain numbers; left out: the watch of the sensor is off if there are
    effects that change more than the mean reading."""

    evidence: tuple[dict[str, Any], ...] = ()
    """Where parameters and effects come from; kept unread."""

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """The JSON Schema, in which no key is required of sound only."""
        described = super().__get_pydantic_json_schema__(schema, handler)
        handler.resolve_ref_schema(described)["required"].remove("calibration_temperature_c")
        return described

    @model_validator(mode="before")
    @classmethod
    def _only_sound_needs_a_temperature(cls, content: Any) -> Any:
        if isinstance(content, dict) and content.get("medium") in ("light", "radio"):
            return {"calibration_temperature_c": UNUSED_TEMPERATURE_C} | content
        return content

    @field_validator("minimum_cm", "maximum_cm")
    @classmethod
    def _is_shown_whole(cls, limit_cm: float) -> float:
        return int(limit_cm) if limit_cm.is_integer() else limit_cm

    @field_validator("driver")
    @classmethod
    def _is_known(cls, driver: str) -> str:
        find_driver(driver)
        return driver

    @field_validator("breakaway")
    @classmethod
    def _is_a_beam(cls, points: tuple[BreakawayPoint, ...]) -> tuple[BreakawayPoint, ...]:
        _beam(points)
        return points

    @field_validator("calibration")
    @classmethod
    def _is_a_calibration(cls, knots: tuple[CalibrationKnot, ...]) -> tuple[CalibrationKnot, ...]:
        curve_through(knots)
        return knots

    @model_validator(mode="after")
    def _can_be_met(self) -> "SensorModel":
        if not self.minimum_cm < self.maximum_cm:
            raise ValueError(f"expected minimum_cm < maximum_cm, found {self.minimum_cm} and {self.maximum_cm}")
        if self.heard_on_axis_cm is not None and self.heard_on_axis_cm > self.maximum_cm:
            raise ValueError(
                f"expected heard_on_axis_cm <= maximum_cm, found {self.heard_on_axis_cm:g} and {self.maximum_cm}"
            )
        step = self.resolution_cm
        if (step if step >= 1.0 else round(1.0 / step, 9)) % 1.0:
            raise ValueError(f"expected resolution_cm a whole number, or a whole number of them in 1, found {step:g}")
        what = "resolution_cm"
        if self.driver != NONE and step < 1.0:
            step, what = 1.0, "a centimetre, as drivers answer"
        if any(round(limit_cm / step, 6) % 1.0 for limit_cm in (self.minimum_cm, self.maximum_cm)):
            raise ValueError(
                f"expected minimum_cm and maximum_cm whole multiples of {what} ({step:g}), "
                f"found {self.minimum_cm} and {self.maximum_cm}"
            )
        saturates = self.reading_model.saturated_fraction > 0.0
        if saturates and not self.minimum_cm <= SATURATED_CM < self.maximum_cm:
            raise ValueError(
                f"expected reading_model.saturated_fraction 0 with readings of {self.minimum_cm} to "
                f"{self.maximum_cm} cm, which leave out 255"
            )
        timing = self.timing
        farthest_s = timing.answer_s(self.maximum_cm)
        if farthest_s > timing.cycle_s:
            raise ValueError(
                f"expected an echo from maximum_cm within timing.cycle_s ({timing.cycle_s:g} s), "
                f"found that it ends after {farthest_s:.4g} s (ready_s + maximum_cm * s_per_cm)"
            )
        return self

    @model_validator(mode="after")
    def _is_a_whole_beam(self) -> "SensorModel":
        _beam(self._points)
        return self

    @property
    def depends_on_air(self) -> bool:
        """Whether its ranges have to be corrected for the air."""
        return self.medium == "sound" and not self.compensates_air

    @property
    def answered_cm(self) -> float:
        """Step of what a driver answers [cm], however fine the readings that were characterised."""
        driver = find_driver(self.driver)
        return max(self.resolution_cm, 1.0 if driver is None else 1.0 / driver.per_cm)

    @cached_property
    def calibration_curve(self) -> Calibration:
        """The calibration, ready to be applied."""
        return curve_through(self.calibration)

    @cached_property
    def beam(self) -> BreakawayTable:
        """The breakaway table, for sound with the predicted angles beyond the measured ones."""
        beam = _beam(self._points)
        return beam if self.medium == "sound" else replace(beam, narrowest_deg=0.0)

    @property
    def _points(self) -> tuple[BreakawayPoint, ...]:
        predicted = self.predicted_breakaway
        return self.breakaway if predicted is None or not self._is_predicted else (*self.breakaway, *predicted.rows)

    @property
    def _is_predicted(self) -> bool:
        return self.predicted_breakaway is not None and self.predicted_breakaway.inputs == self.beam_inputs

    @property
    def beam_doubt(self) -> str:
        """Why the last measured angle is held to `maximum_cm`, though it can be predicted; empty: it need not be."""
        if self._is_predicted or self.medium != "sound" or self.breakaway[-1].range_cm >= self.maximum_cm:
            return ""
        if self.predicted_breakaway is None:
            return "no predicted_breakaway"
        return "predicted_breakaway is of other numbers than those in the file"

    @property
    def beam_inputs(self) -> str:
        """Hash of the numbers that `predicted_breakaway` is computed from, each to six digits, as files are written."""
        rows = [number for point in self.breakaway for number in (point.range_cm, point.half_angle_deg)]
        numbers = [self.heard_on_axis_cm or 0.0, self.maximum_cm, self.frequency_hz, *rows]
        return f"crc32-{zlib.crc32(' '.join(f'{number:.6g}' for number in numbers).encode()):08x}"


def load_sensor_model(path: Path | str) -> SensorModel:
    """Read a sensor model file.

    Raises
    ------
    ConfigError
        The file cannot be read or says something impossible; one line a mistake.
    """
    return load(config_path(path, "sensors"), SensorModel)


def _beam(points: Sequence[BreakawayPoint]) -> BreakawayTable:
    return BreakawayTable(
        ranges_m=tuple(point.range_cm / 100.0 for point in points),
        half_angles_deg=tuple(point.half_angle_deg for point in points),
    )
