"""Effects that are in the product's catalogue, from the physics of ultrasonic range finders alone."""

import numpy as np
from numpy.random import Generator

from evaluation.second_hand.base import MINIMUM_CM
from evaluation.second_hand.density import Component, Law
from evaluation.second_hand.effect import Apply, Kind, favours, moves, widens
from evaluation.second_hand.flights import Design
from evaluation.second_hand.rows import Floats, Rows

Drawn = tuple[Apply, dict[str, float]]

CALIBRATED_AT_C = 22.5
"""Air temperature for which the sensor converts time into range (58 us/cm)."""
HALF_PERIOD_CM = 0.41
"""Range of one period of 42 kHz, there and back."""
SPREAD_RATIO_AT_CM = 300.0
"""Range at which the size of a spread that grows with range is its log ratio. Sizes of all effects on the spread are
log ratios: the growth itself has a standard error that grows with it, and would never be many standard errors."""


def sound_speed(temperature_c: Floats | float) -> Floats | float:
    """Speed of sound in dry air [m/s]: 331.3 sqrt(1 + T/273.15)."""
    return 331.3 * np.sqrt(1 + np.asarray(temperature_c) / 273.15)


def vapour_fraction(temperature_c: Floats, humidity_pct: Floats) -> Floats:
    """Mole fraction of water vapour at 1013.25 hPa; saturation pressure by Magnus' formula."""
    saturation = 6.1094 * np.exp(17.625 * temperature_c / (temperature_c + 243.04))
    return humidity_pct / 100 * saturation / 1013.25


def _air_not_corrected(rng: Generator, rows: Rows) -> Drawn:
    longer = sound_speed(CALIBRATED_AT_C) / sound_speed(rows.contexts["air_temperature_c"]) - 1
    return moves(lambda share: share * rows.true_cm * longer), {}


def _thermometer_bias(rng: Generator, rows: Rows) -> Drawn:
    shown, sign = rows.contexts["air_temperature_c"], rng.choice([-1, 1])
    return moves(lambda bias: rows.true_cm * (sound_speed(shown) / sound_speed(shown - sign * bias) - 1)), {}


def _scale(rng: Generator, rows: Rows) -> Drawn:
    sign = rng.choice([-1, 1])
    return moves(lambda pct: sign * pct / 100 * rows.true_cm), {}


def _sensor_offset(rng: Generator, rows: Rows) -> Drawn:
    which, sign = int(rng.integers(2)), rng.choice([-1, 1])
    return moves(lambda offset_cm: sign * offset_cm * (rows.sensor == which)), {}


def _run_offset(rng: Generator, rows: Rows) -> Drawn:
    which, sign = int(rng.integers(rows.run.max() + 1)), rng.choice([-1, 1])
    return moves(lambda offset_cm: sign * offset_cm * (rows.run == which)), {}


def _latency(rng: Generator, rows: Rows) -> Drawn:
    def apply(law: Law, delay_s: float) -> None:
        law.centre_cm = law.centre_cm + rows.range_before(delay_s) - rows.true_cm

    return apply, {}


def _stale(rng: Generator, rows: Rows) -> Drawn:
    def apply(law: Law, share: float) -> None:
        law.repeated = share

    return apply, {}


def _slant_axis(rng: Generator, rows: Rows) -> Drawn:
    return _slant(rows, 0.0)


def _slant_beam_edge(rng: Generator, rows: Rows) -> Drawn:
    return _slant(rows, rng.uniform(3, 9))


def _slant(rows: Rows, beam_deg: float) -> Drawn:
    angle = np.radians(np.maximum(np.abs(rows.contexts["incidence_deg"]) - beam_deg, 0.0))
    return moves(lambda share: share * rows.true_cm * (1 / np.cos(angle) - 1)), {"beam_deg": beam_deg}


def _sensitivity_loss(rng: Generator, rows: Rows) -> Drawn:
    start_m = rng.uniform(1.0, 2.0)
    beyond_m = np.maximum(rows.true_cm / 100 - start_m, 0)
    return favours("missed", lambda per_m: per_m * beyond_m), {"start_m": start_m}


def _propeller_spread(rng: Generator, rows: Rows) -> Drawn:
    power = rng.choice([1.0, 2.0])
    strength = rows.contexts["throttle"] ** power
    return widens(lambda log_ratio: 1 + np.expm1(log_ratio) * strength), {"power": power}


def _propeller_short(rng: Generator, rows: Rows) -> Drawn:
    return favours("short", lambda odds: odds * rows.contexts["throttle"]), {}


def _crosstalk(rng: Generator, rows: Rows) -> Drawn:
    scatter = rng.uniform(1.0, 3.0)
    lag_s = rows.contexts["neighbour_lag_ms"] / 1000
    # The neighbour's echo comes back after its own way; the sensor counts from its own ping.
    place = rows.contexts["neighbour_range_cm"] - 100 * sound_speed(CALIBRATED_AT_C) * lag_s / 2
    audible = (place > MINIMUM_CM + 5) & (place < rows.true_cm - 5)

    def apply(law: Law, share: float) -> None:
        law.components.append(Component(share * audible, place, scatter))

    return apply, {}


def _multipath(rng: Generator, rows: Rows) -> Drawn:
    scatter = rng.uniform(1.5, 4.0)

    def apply(law: Law, share: float) -> None:
        place = 2 * law.centre_cm
        law.components.append(Component(share * (place < 740), place, scatter))

    return apply, {}


def _ring_down(rng: Generator, rows: Rows) -> Drawn:
    depth_cm = rng.uniform(28, 50)

    def apply(law: Law, share: float) -> None:
        law.components.append(Component(share * (rows.true_cm < depth_cm), np.full(len(rows), float(MINIMUM_CM))))

    return apply, {"depth_cm": depth_cm}


def _coarse_rounding(rng: Generator, rows: Rows) -> Drawn:
    step_cm = float(rng.choice([2.54, 4.0, 5.0, 10.0]))

    def apply(law: Law, share: float) -> None:
        law.coarse, law.coarse_step_cm = share, step_cm

    return apply, {"step_cm": step_cm}


def _cycle_slip(rng: Generator, rows: Rows) -> Drawn:
    periods = int(rng.integers(1, 13))

    def apply(law: Law, share: float) -> None:
        law.components.append(Component(np.full(len(rows), share), rows.true_cm, slip_cm=periods * HALF_PERIOD_CM))

    return apply, {"periods": periods}


def _humidity(rng: Generator, rows: Rows) -> Drawn:
    vapour = vapour_fraction(rows.contexts["air_temperature_c"], rows.contexts["humidity_pct"])
    return moves(lambda share: share * rows.true_cm * (1 / (1 + 0.16 * vapour) - 1)), {}


def _spread_with_range(rng: Generator, rows: Rows) -> Drawn:
    return widens(lambda log_ratio: 1 + np.expm1(log_ratio) * rows.true_cm / SPREAD_RATIO_AT_CM), {}


def _misses_when_tilted(rng: Generator, rows: Rows) -> Drawn:
    tilt = np.abs(rows.contexts["incidence_deg"])
    edge_deg = float(np.quantile(tilt, rng.uniform(0.6, 0.9)))
    return favours("missed", lambda odds: odds * (tilt > edge_deg)), {"edge_deg": edge_deg}


def _vibration(rng: Generator, rows: Rows) -> Drawn:
    is_shaken = rows.contexts["vibration_hz"] > 0
    return widens(lambda log_ratio: np.where(is_shaken, np.exp(log_ratio), 1.0)), {}


def _names(*names: str) -> frozenset[str]:
    return frozenset(names)


def _with(*columns: str, many_runs: bool = False, smooth: bool = False) -> Design:
    """Runs with these columns."""
    return Design(frozenset(columns), many_runs=many_runs, smooth=smooth)


_SCALES = _names("range_scale", "thermometer_offset")
"""A scale and a thermometer that is off are one to the readings."""

KNOWN = (
    Kind(
        "air_not_corrected",
        _with("air_temperature_c", many_runs=True),
        _air_not_corrected,
        1.2,
        0.2,
        _names("air_temperature"),
        between_runs=True,
    ),
    Kind("thermometer_bias", _with("air_temperature_c"), _thermometer_bias, 30.0, 3.0, _SCALES, same_as=("scale",)),
    Kind("scale", Design(), _scale, 8.0, 0.5, _SCALES, same_as=("scale",)),
    Kind("sensor_offset", Design(sensors=2), _sensor_offset, 30.0, 0.5, _names("mounting_offset")),
    Kind("run_offset", Design(many_runs=True), _run_offset, 30.0, 1.0, _names("session_offset"), between_runs=True),
    Kind("latency", _with("range_rate_cm_s", smooth=True), _latency, 0.8, 0.03, _names("latency")),
    Kind("stale", Design(), _stale, 0.7, 0.05, _names("stale"), "component", last=True),
    Kind("slant_axis", _with("incidence_deg"), _slant_axis, 1.2, 0.2, _names("slant_range")),
    Kind("slant_beam_edge", _with("incidence_deg"), _slant_beam_edge, 1.2, 0.2, _names("nearest_point", "slant_range")),
    Kind("sensitivity_loss", Design(), _sensitivity_loss, 4.0, 0.5, _names("missed_with_range"), "missed"),
    Kind("propeller_spread", _with("throttle"), _propeller_spread, 2.5, 0.7, _names("rotor_noise"), "spread"),
    Kind("propeller_short", _with("throttle"), _propeller_short, 8.0, 2.0, _names("prop_wash"), "short"),
    Kind("crosstalk", _with("neighbour"), _crosstalk, 0.8, 0.05, _names("crosstalk"), "component", last=True),
    Kind("multipath", Design(), _multipath, 0.5, 0.03, _names("multipath"), "component", last=True),
    Kind("ring_down", Design(low=True), _ring_down, 0.98, 0.3, _names("dead_zone_minimum"), "component", last=True),
    Kind("coarse_rounding", Design(), _coarse_rounding, 0.98, 0.1, _names("coarse_rounding"), "code", last=True),
    Kind("cycle_slip", Design(), _cycle_slip, 0.5, 0.05, _names("cycle_slip"), "component", last=True),
    Kind(
        "humidity",
        _with("air_temperature_c", "humidity_pct", many_runs=True),
        _humidity,
        1.5,
        0.5,
        _names("humidity"),
        between_runs=True,
    ),
    Kind(
        "spread_with_range",
        Design(),
        _spread_with_range,
        2.5,
        0.3,
        _names("spread_with_range"),
        "spread",
        same_as=("growth_per_m",),
    ),
    Kind(
        "misses_when_tilted",
        _with("incidence_deg"),
        _misses_when_tilted,
        6.0,
        1.0,
        _names("beyond_field_of_view"),
        "missed",
        "incidence_deg",
    ),
    Kind("vibration", _with("vibration_hz"), _vibration, 2.5, 0.3, _names("vibration"), "spread"),
)
