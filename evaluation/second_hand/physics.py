"""Effects that are in the product's catalogue, from the physics of ultrasonic range finders alone."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from evaluation.second_hand.base import MINIMUM_CM
from evaluation.second_hand.density import Component, Law
from evaluation.second_hand.effect import Effect, Kind
from evaluation.second_hand.flights import Design
from evaluation.second_hand.rows import Floats, Rows

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


def _air_not_corrected(rng: np.random.Generator, rows: Rows) -> Effect:
    temperature = rows.contexts["air_temperature_c"]

    def apply(rows: Rows, law: Law, share: float) -> None:
        law.centre_cm = law.centre_cm + share * rows.true_cm * (
            sound_speed(CALIBRATED_AT_C) / sound_speed(temperature) - 1
        )

    return Effect("air_not_corrected", apply, 1.2, 0.2, frozenset({"air_temperature"}), between_runs=True)


def _thermometer_bias(rng: np.random.Generator, rows: Rows) -> Effect:
    shown, sign = rows.contexts["air_temperature_c"], rng.choice([-1, 1])

    def apply(rows: Rows, law: Law, bias: float) -> None:
        law.centre_cm = law.centre_cm + rows.true_cm * (sound_speed(shown) / sound_speed(shown - sign * bias) - 1)

    names = frozenset({"thermometer_offset", "range_scale"})
    return Effect("thermometer_bias", apply, 30.0, 3.0, names, same_as=("scale",))


def _scale(rng: np.random.Generator, rows: Rows) -> Effect:
    sign = rng.choice([-1, 1])

    def apply(rows: Rows, law: Law, pct: float) -> None:
        law.centre_cm = law.centre_cm + sign * pct / 100 * rows.true_cm

    return Effect("scale", apply, 8.0, 0.5, frozenset({"range_scale", "thermometer_offset"}), same_as=("scale",))


def _sensor_offset(rng: np.random.Generator, rows: Rows) -> Effect:
    which, sign = int(rng.integers(2)), rng.choice([-1, 1])

    def apply(rows: Rows, law: Law, offset_cm: float) -> None:
        law.centre_cm = law.centre_cm + sign * offset_cm * (rows.sensor == which)

    return Effect("sensor_offset", apply, 30.0, 0.5, frozenset({"mounting_offset"}))


def _run_offset(rng: np.random.Generator, rows: Rows) -> Effect:
    which, sign = int(rng.integers(rows.run.max() + 1)), rng.choice([-1, 1])

    def apply(rows: Rows, law: Law, offset_cm: float) -> None:
        law.centre_cm = law.centre_cm + sign * offset_cm * (rows.run == which)

    return Effect("run_offset", apply, 30.0, 1.0, frozenset({"session_offset"}), between_runs=True)


def _latency(rng: np.random.Generator, rows: Rows) -> Effect:
    def apply(rows: Rows, law: Law, delay_s: float) -> None:
        law.centre_cm = law.centre_cm + rows.range_before(delay_s) - rows.true_cm

    return Effect("latency", apply, 0.8, 0.03, frozenset({"latency"}))


def _stale(rng: np.random.Generator, rows: Rows) -> Effect:
    def apply(rows: Rows, law: Law, share: float) -> None:
        law.repeated = share

    return Effect("stale", apply, 0.7, 0.05, frozenset({"stale"}), channel="component", last=True)


def _slant(along_axis: bool) -> Callable[[np.random.Generator, Rows], Effect]:
    def draw(rng: np.random.Generator, rows: Rows) -> Effect:
        beam_deg = 0.0 if along_axis else rng.uniform(3, 9)
        angle = np.radians(np.maximum(np.abs(rows.contexts["incidence_deg"]) - beam_deg, 0.0))

        def apply(rows: Rows, law: Law, share: float) -> None:
            law.centre_cm = law.centre_cm + share * rows.true_cm * (1 / np.cos(angle) - 1)

        title = "slant_axis" if along_axis else "slant_beam_edge"
        names = {"slant_range"} if along_axis else {"nearest_point", "slant_range"}
        return Effect(title, apply, 1.2, 0.2, frozenset(names), details=(("beam_deg", beam_deg),))

    return draw


def _sensitivity_loss(rng: np.random.Generator, rows: Rows) -> Effect:
    start_m = rng.uniform(1.0, 2.0)

    def apply(rows: Rows, law: Law, per_m: float) -> None:
        law.odds[1] += per_m * np.maximum(rows.true_cm / 100 - start_m, 0)

    return Effect(
        "sensitivity_loss", apply, 4.0, 0.5, frozenset({"missed_with_range"}), channel="missed",
        details=(("start_m", start_m),),
    )  # fmt: skip


def _propeller_spread(rng: np.random.Generator, rows: Rows) -> Effect:
    power = rng.choice([1.0, 2.0])

    def apply(rows: Rows, law: Law, log_ratio: float) -> None:
        law.sigma_cm = law.sigma_cm * (1 + np.expm1(log_ratio) * rows.contexts["throttle"] ** power)

    return Effect(
        "propeller_spread", apply, 2.5, 0.7, frozenset({"rotor_noise"}), channel="spread", details=(("power", power),)
    )


def _propeller_short(rng: np.random.Generator, rows: Rows) -> Effect:
    def apply(rows: Rows, law: Law, odds: float) -> None:
        law.odds[0] += odds * rows.contexts["throttle"]

    return Effect("propeller_short", apply, 8.0, 2.0, frozenset({"prop_wash"}), channel="short")


def _crosstalk(rng: np.random.Generator, rows: Rows) -> Effect:
    scatter = rng.uniform(1.0, 3.0)
    lag_s = rows.contexts["neighbour_lag_ms"] / 1000
    # The neighbour's echo comes back after its own way; the sensor counts from its own ping.
    place = rows.contexts["neighbour_range_cm"] - 100 * sound_speed(CALIBRATED_AT_C) * lag_s / 2
    audible = (place > MINIMUM_CM + 5) & (place < rows.true_cm - 5)

    def apply(rows: Rows, law: Law, share: float) -> None:
        law.components.append(Component(share * audible.astype(float), place, scatter))

    return Effect("crosstalk", apply, 0.8, 0.05, frozenset({"crosstalk"}), channel="component", last=True)


def _multipath(rng: np.random.Generator, rows: Rows) -> Effect:
    scatter = rng.uniform(1.5, 4.0)

    def apply(rows: Rows, law: Law, share: float) -> None:
        place = 2 * law.centre_cm
        law.components.append(Component(share * (place < 740).astype(float), place, scatter))

    return Effect("multipath", apply, 0.5, 0.03, frozenset({"multipath"}), channel="component", last=True)


def _ring_down(rng: np.random.Generator, rows: Rows) -> Effect:
    depth_cm = rng.uniform(28, 50)
    inside = rows.true_cm < depth_cm

    def apply(rows: Rows, law: Law, share: float) -> None:
        law.components.append(Component(share * inside.astype(float), np.full(len(rows), float(MINIMUM_CM))))

    return Effect(
        "ring_down", apply, 0.98, 0.3, frozenset({"dead_zone_minimum"}), channel="component", last=True,
        details=(("depth_cm", depth_cm),),
    )  # fmt: skip


def _coarse(rng: np.random.Generator, rows: Rows) -> Effect:
    step_cm = float(rng.choice([2.54, 4.0, 5.0, 10.0]))

    def apply(rows: Rows, law: Law, share: float) -> None:
        law.coarse, law.coarse_step_cm = share, step_cm

    names = frozenset({"coarse_rounding"})
    return Effect(
        "coarse_rounding", apply, 0.98, 0.1, names, channel="code", last=True, details=(("step_cm", step_cm),)
    )


def _cycle_slip(rng: np.random.Generator, rows: Rows) -> Effect:
    periods = int(rng.integers(1, 13))

    def apply(rows: Rows, law: Law, share: float) -> None:
        law.components.append(Component(np.full(len(rows), share), rows.true_cm, slip_cm=periods * HALF_PERIOD_CM))

    return Effect(
        "cycle_slip", apply, 0.5, 0.05, frozenset({"cycle_slip"}), channel="component", last=True,
        details=(("periods", periods),),
    )  # fmt: skip


def _humidity(rng: np.random.Generator, rows: Rows) -> Effect:
    vapour = vapour_fraction(rows.contexts["air_temperature_c"], rows.contexts["humidity_pct"])

    def apply(rows: Rows, law: Law, share: float) -> None:
        law.centre_cm = law.centre_cm + share * rows.true_cm * (1 / (1 + 0.16 * vapour) - 1)

    return Effect("humidity", apply, 1.5, 0.5, frozenset({"humidity"}), between_runs=True)


def _spread_with_range(rng: np.random.Generator, rows: Rows) -> Effect:
    def apply(rows: Rows, law: Law, log_ratio: float) -> None:
        law.sigma_cm = law.sigma_cm * (1 + np.expm1(log_ratio) * rows.true_cm / SPREAD_RATIO_AT_CM)

    names = frozenset({"spread_with_range"})
    return Effect("spread_with_range", apply, 2.5, 0.3, names, channel="spread", same_as=("growth_per_m",))


def _misses_when_tilted(rng: np.random.Generator, rows: Rows) -> Effect:
    tilt = np.abs(rows.contexts["incidence_deg"])
    edge_deg = float(np.quantile(tilt, rng.uniform(0.6, 0.9)))

    def apply(rows: Rows, law: Law, odds: float) -> None:
        law.odds[1] += odds * (tilt > edge_deg)

    return Effect(
        "misses_when_tilted", apply, 6.0, 1.0, frozenset({"beyond_field_of_view"}), channel="missed",
        variable="incidence_deg", details=(("edge_deg", edge_deg),),
    )  # fmt: skip


def _vibration(rng: np.random.Generator, rows: Rows) -> Effect:
    def apply(rows: Rows, law: Law, log_ratio: float) -> None:
        law.sigma_cm = law.sigma_cm * np.where(rows.contexts["vibration_hz"] > 0, np.exp(log_ratio), 1.0)

    return Effect("vibration", apply, 2.5, 0.3, frozenset({"vibration"}), channel="spread")


def _columns(*names: str) -> Design:
    return Design(frozenset(names))


KNOWN = (
    Kind("air_not_corrected", replace(_columns("air_temperature_c"), many_runs=True), _air_not_corrected),
    Kind("thermometer_bias", _columns("air_temperature_c"), _thermometer_bias),
    Kind("scale", Design(), _scale),
    Kind("sensor_offset", Design(sensors=2), _sensor_offset),
    Kind("run_offset", Design(many_runs=True), _run_offset),
    Kind("latency", replace(_columns("range_rate_cm_s"), smooth=True), _latency),
    Kind("stale", Design(), _stale),
    Kind("slant_axis", _columns("incidence_deg"), _slant(True)),
    Kind("slant_beam_edge", _columns("incidence_deg"), _slant(False)),
    Kind("sensitivity_loss", Design(), _sensitivity_loss),
    Kind("propeller_spread", _columns("throttle"), _propeller_spread),
    Kind("propeller_short", _columns("throttle"), _propeller_short),
    Kind("crosstalk", _columns("neighbour"), _crosstalk),
    Kind("multipath", Design(), _multipath),
    Kind("ring_down", Design(low=True), _ring_down),
    Kind("coarse_rounding", Design(), _coarse),
    Kind("cycle_slip", Design(), _cycle_slip),
    Kind("humidity", replace(_columns("air_temperature_c", "humidity_pct"), many_runs=True), _humidity),
    Kind("spread_with_range", Design(), _spread_with_range),
    Kind("misses_when_tilted", _columns("incidence_deg"), _misses_when_tilted),
    Kind("vibration", _columns("vibration_hz"), _vibration),
)
