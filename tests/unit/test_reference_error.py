"""A true range with a known error: the column `true_range_std_cm`, from the likelihood to files and fits."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import norm

from msp_lab.characterise.mixture import fit_mixture
from msp_lab.characterise.points import sort_into_points
from msp_lab.gap.curve_test import asked_of
from msp_lab.gap.prepared import Prepared, channel_slopes
from msp_lab.gap.refit import fit_base
from msp_lab.readings.intake import load_readings
from msp_range.correction.calibration import IDENTITY
from msp_range.reading_model.rows import Base
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.recording.csv_form import MeasuredData, write_csv
from msp_range.recording.error import RecordingError
from msp_sim.model.model import Model
from msp_sim.model.rows import log_prob
from tests.support.known import known

OWN_CM, NOISE_CM = 1.2, 2.0


def sensor_of(sigma_cm: float) -> SensorModel:
    sensor = load_sensor_model("configs/sensors/mb1242.yaml")
    parameters = sensor.reading_model.model_copy(update={"sigma_cm": sigma_cm})
    return sensor.model_copy(update={"effects": (), "reading_model": parameters})


def flown(n: int, seed: int) -> dict[str, NDArray[np.float64]]:
    """Readings of a sensor whose reference is off by 2 cm at random, drawn without the column."""
    rng = np.random.default_rng(seed)
    true_cm = 250.0 + 150.0 * np.sin(np.arange(n) / 90.0)
    reading_cm = Model(sensor_of(OWN_CM)).sample({"true_range_cm": true_cm}, rng)
    noise_cm = np.where(np.arange(n) % 2, NOISE_CM, 0.5 * NOISE_CM)
    return {
        "true_range_cm": true_cm + noise_cm * rng.standard_normal(n),
        "true_range_std_cm": noise_cm,
        "reading_cm": reading_cm,
        "time_s": 0.1 * np.arange(n),
    }


def test_characterise_gets_the_sensors_own_sigma_back() -> None:
    columns = flown(6000, 1)
    words = {"sensor": np.full(6000, "a"), "run": np.full(6000, "1"), "condition": np.full(6000, "baseline")}
    sigma_cm, p_value, spread_cm = {}, {}, {}
    for given in (True, False):
        kept = {name: column for name, column in columns.items() if given or name != "true_range_std_cm"}
        points = sort_into_points(MeasuredData({**kept, **words}), sensor_of(1.0))
        found, parameters = fit_mixture(points, IDENTITY, sensor_of(1.0), np.random.default_rng(1))
        sigma_cm[given], p_value[given] = parameters.sigma_cm, known(found.pit_p_value)
        spreads = [point.found.spread.value for point in points if point.found.spread is not None]
        spread_cm[given] = float(np.median(spreads))
    assert sigma_cm[True] == pytest.approx(OWN_CM, abs=0.06)
    assert spread_cm[True] == pytest.approx(OWN_CM, abs=0.15)
    # The mean of both variances is in it where nothing is known of the reference.
    assert sigma_cm[False] == pytest.approx(np.sqrt(OWN_CM**2 + 0.625 * NOISE_CM**2), abs=0.1)
    assert p_value[True] > 0.02 > p_value[False]


def test_gap_gets_the_sensors_own_sigma_back() -> None:
    columns = flown(6000, 2)
    reading_cm = columns.pop("reading_cm")
    fit = fit_base(Prepared.of(Model(sensor_of(1.0)), columns, reading_cm))
    assert np.exp(fit.base[1]) == pytest.approx(OWN_CM, abs=0.06)
    del columns["true_range_std_cm"]
    fit = fit_base(Prepared.of(Model(sensor_of(1.0)), columns, reading_cm))
    assert np.exp(fit.base[1]) > 1.7


def test_a_placement_s_one_error_is_not_taken_out_of_its_scatter() -> None:
    """At a bench all readings of a placement share the reference's error, so their own scatter is the sensor's."""
    rng = np.random.default_rng(3)
    true_cm = np.repeat(np.arange(100.0, 500.0, 40.0), 200)
    off_cm = np.repeat(NOISE_CM * rng.standard_normal(10), 200)
    reading_cm = Model(sensor_of(OWN_CM)).sample({"true_range_cm": true_cm + off_cm}, rng)
    n = true_cm.size
    words = {"sensor": np.full(n, "a"), "run": np.full(n, "1"), "condition": np.full(n, "baseline")}
    numbers = {"time_s": np.arange(float(n)), "reading_cm": reading_cm, "true_range_cm": true_cm}
    data = MeasuredData({**numbers, **words, "true_range_std_cm": np.full(n, NOISE_CM)})
    points = sort_into_points(data, sensor_of(1.0))
    _, parameters = fit_mixture(points, IDENTITY, sensor_of(1.0), np.random.default_rng(1))
    assert parameters.sigma_cm == pytest.approx(OWN_CM, abs=0.06)
    assert {point.placement_cm2 for point in points} == {NOISE_CM**2}


def test_draws_and_probabilities_are_those_of_the_wider_hit() -> None:
    model, n = Model(sensor_of(OWN_CM)), 20_000
    contexts = {"true_range_cm": np.full(n, 300.0), "true_range_std_cm": np.full(n, NOISE_CM)}
    drawn_cm = model.sample(contexts, np.random.default_rng(4))
    hits_cm = drawn_cm[np.abs(drawn_cm - 300.0) < 15.0]
    assert hits_cm.std() == pytest.approx(np.hypot(np.hypot(OWN_CM, NOISE_CM), 0.29), rel=0.03)
    whole = np.hypot(OWN_CM, NOISE_CM)
    one = {name: column[:1] for name, column in contexts.items()}
    p = np.exp(model.log_prob([303.0], one))[0] / model.sensor.reading_model.weights.hit
    assert p == pytest.approx(norm.cdf(3.5 / whole) - norm.cdf(2.5 / whole), rel=0.02)
    blank = {"true_range_cm": one["true_range_cm"], "true_range_std_cm": np.array([np.nan])}
    exact = {"true_range_cm": one["true_range_cm"]}
    assert model.log_prob([303.0], blank) == model.log_prob([303.0], exact)


def test_effects_change_the_sensors_own_spread_only() -> None:
    contexts = {"true_range_cm": np.full(1, 300.0), "true_range_std_cm": np.full(1, NOISE_CM)}
    rows = Model(sensor_of(OWN_CM)).rows(contexts)
    assert rows.wider(2.0).sigma_cm == pytest.approx(np.hypot(2.0 * OWN_CM, NOISE_CM))
    reading_cm, h = np.array([304.0]), 1e-5
    numeric = (log_prob(rows.wider(np.exp(h)), reading_cm) - log_prob(rows.wider(np.exp(-h)), reading_cm)) / (2 * h)
    assert rows.scores(reading_cm)[1][0, 1] == pytest.approx(numeric[0], rel=1e-4)


def test_the_score_of_correlated_readings_follows_their_likelihood() -> None:
    n = 400
    sensor = sensor_of(OWN_CM)
    correlated = sensor.reading_model.model_copy(update={"correlation": 0.6})
    model = Model(sensor.model_copy(update={"reading_model": correlated}))
    rng = np.random.default_rng(5)
    noise_cm = rng.uniform(0.0, 3.0, n)
    contexts = {"true_range_cm": np.full(n, 300.0), "true_range_std_cm": noise_cm, "time_s": 0.1 * np.arange(n)}
    reading_cm = model.sample(contexts, rng)
    prepared = Prepared.of(model, contexts, reading_cm)
    nothing, template, h = Base(), rng.random(n), 1e-5
    score = channel_slopes(prepared.at(nothing, []), reading_cm).score(1, template)
    moved = [replace(prepared.rows.wider(np.exp(s * h * template))) for s in (1.0, -1.0)]
    numeric = (log_prob(moved[0], reading_cm) - log_prob(moved[1], reading_cm)) / (2 * h)
    hits = np.abs(reading_cm - 300.0) < 8.0
    hits[1:] &= hits[:-1]
    np.testing.assert_allclose(score[hits], numeric[hits], rtol=1e-3, atol=1e-4)


def test_it_is_no_context_and_has_to_be_a_deviation(tmp_path: Path) -> None:
    columns = flown(200, 6)
    assert {names for names, _ in asked_of(columns)[0]} == {("true_range_cm",)}
    columns["true_range_std_cm"][7] = -1.0
    write_csv(tmp_path / "a.csv", {**columns, "sensor": np.full(200, "a")})
    with pytest.raises(RecordingError, match="true_range_std_cm of -1 to 2, expected the standard deviation"):
        load_readings([tmp_path / "a.csv"], sensor_of(1.0))
