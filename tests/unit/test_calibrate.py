"""Calibration of readings against the reference: recovered, kept only where it predicts, with honest intervals."""

from collections.abc import Callable

import numpy as np
import pytest

from msp_lab.characterise.calibration import calibrate
from msp_lab.characterise.findings import CalibrationFindings
from msp_lab.characterise.points import sort_into_points
from msp_range.correction.calibration import Calibration
from msp_range.recording.csv_form import MeasuredData
from tests.support.known import contains
from tests.support.plain_bench import point, table
from tests.support.shipped import SENSOR

RANGES_CM = np.arange(40.0, 301.0, 20.0)


def test_where_the_range_changes_missed_echoes_do_not_move_the_calibration() -> None:
    """The second half of each piece of 20 cm gives no echo: its hits are at other ranges than its rows."""
    true_cm = np.linspace(60.0, 299.9, 2400)
    part = point(np.random.default_rng(4), 100, n=2400)
    has_echo = true_cm % 20.0 < 10.0
    part |= {"true_range_cm": true_cm, "reading_cm": np.where(has_echo, np.rint(true_cm), 765.0)}
    found = calibrated(table(part))
    assert found.bias.value == pytest.approx(0.0, abs=0.1)
    assert found.form == "none"


def calibrated(data: MeasuredData, reference_std_cm: float | None = None) -> CalibrationFindings:
    found = calibrate(sort_into_points(data, SENSOR), reference_std_cm)
    assert found is not None
    return found


def bench(
    seed: int,
    error: Callable[[float], float],
    *,
    setup_cm: float = 0.1,
    sigma_cm: float = 0.7,
    n: int = 60,
    air_c: float = 22.5,
) -> MeasuredData:
    """A bench whose sensor errs by `error(range)` in air of its calibration, and whose tape errs by `setup_cm`."""
    rng = np.random.default_rng(seed)
    factor = np.sqrt(295.65 / (air_c + 273.15))
    return table(
        *(
            point(
                rng,
                z,
                error_cm=z * factor + error(z * factor) - z + rng.normal(0.0, setup_cm),
                sigma_cm=sigma_cm,
                n=n,
                missed=0.02,
                stray=0.01,
                air_temperature_c=air_c,
            )
            for z in RANGES_CM
        )
    )


@pytest.mark.parametrize(("stated_cm", "low", "high"), [(0.0, 0.3, 0.55), (0.3, 0.1, 0.45)])
def test_what_set_ups_differ_by_is_the_sensors_where_the_tape_is_better(
    stated_cm: float, low: float, high: float
) -> None:
    data = bench(3, lambda z: 0.0 * z, setup_cm=0.4)
    found = calibrate(sort_into_points(data, SENSOR), set_up_std_cm=stated_cm)
    assert found is not None
    assert found.set_up_offset is not None
    assert low < found.set_up_offset.value < high
    assert found.set_up_offset.low is not None
    assert found.set_up_offset.high is not None
    assert found.set_up_offset.low < np.sqrt(0.4**2 - stated_cm**2) < found.set_up_offset.high


def test_an_error_of_placements_that_is_stated_twice_counts_once() -> None:
    rng = np.random.default_rng(9)
    placed = [(z, rng.normal(0.0, 0.85)) for z in (*RANGES_CM, *RANGES_CM)]
    found = {}
    for column in (0.0, 0.5):
        parts = [
            point(np.random.default_rng(i), z, n=60, error_cm=off, run=str(i), true_range_std_cm=column)
            for i, (z, off) in enumerate(placed)
        ]
        for stated in (0.0, 0.5):
            calibration = calibrate(sort_into_points(table(*parts), SENSOR), set_up_std_cm=stated)
            assert calibration is not None
            assert calibration.set_up_offset is not None
            found[column, stated] = calibration.set_up_offset.value
    assert found[0.5, 0.0] == pytest.approx(found[0.0, 0.5], abs=0.02)
    assert found[0.5, 0.5] == pytest.approx(found[0.0, 0.5], abs=0.02)
    assert found[0.0, 0.0] > found[0.5, 0.5] + 0.1


def test_readings_that_depend_on_each_other_are_no_offsets_of_set_ups() -> None:
    rng = np.random.default_rng(6)
    parts = []
    for range_cm in np.arange(50.0, 350.0, 7.3):
        noise = rng.normal(0.0, 0.8, 400)
        for i in range(1, 400):
            noise[i] = 0.9 * noise[i - 1] + np.sqrt(1 - 0.81) * noise[i]
        made = point(rng, range_cm, n=400)
        made["reading_cm"] = np.rint(range_cm + noise)
        parts.append(made)
    found = calibrate(sort_into_points(table(*parts), SENSOR), set_up_std_cm=0.0)
    assert found is not None
    assert found.set_up_offset is not None
    assert found.set_up_offset.low == pytest.approx(0.0, abs=0.02)


def test_what_is_between_set_ups_is_the_tapes_where_nothing_is_stated() -> None:
    assert calibrated(bench(3, lambda z: 0.0 * z, setup_cm=0.4)).set_up_offset is None


def test_offset_and_scale_are_found_in_air_that_is_not_the_calibrations() -> None:
    found = calibrated(bench(1, lambda z: 2.0 + 0.01 * z, air_c=10.0))
    assert found.form == "offset and scale"
    assert found.offset is not None
    assert found.scale is not None
    assert contains(found.offset, 2.0)
    assert contains(found.scale, 1.01)
    curve = Calibration(tuple(k.true_cm for k in found.knots), tuple(k.reading_cm for k in found.knots))
    assert curve.forward(150.0) == pytest.approx(153.5, abs=0.15)
    assert found.spread.value == pytest.approx(0.7, abs=0.05)
    assert (found.resolution.value, found.held_out_unit) == (1.0, "range")


def test_a_bend_is_kept_and_predicts_ranges_that_were_left_out() -> None:
    found = calibrated(bench(2, lambda z: 1.0 + 0.05 * max(z - 170.0, 0.0)))
    assert found.form == "piecewise linear"
    by_form = {each.form: each for each in found.held_out}
    assert by_form["piecewise linear"].rms_cm < 0.5 * by_form["offset and scale"].rms_cm
    curve = Calibration(tuple(k.true_cm for k in found.knots), tuple(k.reading_cm for k in found.knots))
    assert curve.forward(100.0) == pytest.approx(101.0, abs=0.3)
    assert curve.forward(300.0) == pytest.approx(307.5, abs=0.4)
    assert found.linearity is not None
    assert found.linearity_noise_floor_cm is not None
    assert abs(found.linearity.value) > 3 * found.linearity_noise_floor_cm


def test_a_sensor_without_error_gets_no_calibration() -> None:
    forms = [calibrated(bench(seed, lambda z: 0.0, setup_cm=0.3)).form for seed in range(10)]
    assert forms.count("none") >= 9
    assert "piecewise linear" not in forms


@pytest.mark.slow
def test_the_intervals_hold_with_set_ups_that_err_and_readings_that_hide_it() -> None:
    held = {"bias": 0, "offset": 0, "scale": 0}
    trials = 40
    for seed in range(trials):
        found = calibrated(bench(100 + seed, lambda z: 0.4 + 0.002 * z, setup_cm=0.25, sigma_cm=0.2, n=40))
        # Of the bias at the bench's mean range.
        truth = {"bias": 0.4 + 0.002 * RANGES_CM.mean(), "offset": 0.4, "scale": 1.002}
        for name, value in truth.items():
            estimate = getattr(found, name)
            held[name] += estimate.low <= value <= estimate.high
    assert min(held.values()) >= 34


def test_runs_that_disagree_keep_a_calibration_out() -> None:
    rng = np.random.default_rng(5)
    # Each run has an offset of its own, so that none predicts another.
    data = table(
        *(
            point(rng, z, error_cm=offset_cm, run=f"run {i}", n=40)
            for i, offset_cm in enumerate((-3.0, 4.5, -2.0))
            for z in RANGES_CM
        )
    )
    found = calibrated(data)
    assert found.held_out_unit == "range and run"
    assert found.form == "none"


@pytest.mark.parametrize("name", ["bias", "offset"])
def test_what_the_reference_may_err_by_widens_bias_and_offset(name: str) -> None:
    data = bench(6, lambda z: 0.0)
    narrow, wide = (getattr(calibrated(data, std), name) for std in (None, 0.5))
    assert wide.value == narrow.value
    assert wide.high - wide.low == pytest.approx(np.hypot(narrow.high - narrow.low, 2 * 1.96 * 0.5), rel=1e-3)


def test_the_spread_is_that_of_all_readings_and_not_of_the_points() -> None:
    rng = np.random.default_rng(11)
    found = calibrated(table(point(rng, 100.0, n=2000, sigma_cm=2.0), point(rng, 200.0, n=50, sigma_cm=0.6)))
    assert found.spread.value == pytest.approx(np.sqrt((1999 * 2.0**2 + 49 * 0.6**2) / 2048), abs=0.08)


def test_few_ranges_are_reported_as_too_few() -> None:
    rng = np.random.default_rng(7)
    one = calibrated(table(point(rng, 100.0, error_cm=3.0)))
    assert (one.form, one.held_out, one.scale) == ("none", (), None)
    assert one.reason == "found 1 range, expected 4 to check it on one left out"
    assert one.bias.low is None
    three = calibrated(table(*(point(rng, z, error_cm=3.0) for z in (100.0, 150.0, 200.0))))
    assert (three.form, three.held_out) == ("none", ())
    assert three.scale is not None


def test_no_echo_at_all_is_no_calibration() -> None:
    rng = np.random.default_rng(8)
    assert calibrate(sort_into_points(table(point(rng, 100.0, missed=1.0)), SENSOR)) is None
