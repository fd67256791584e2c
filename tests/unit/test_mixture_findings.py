"""The mixture of a bench whose set-ups are each off by more than the sensor scatters."""

from pathlib import Path

import numpy as np
import pytest

from msp_lab.characterise.analysis import Characterisation, characterise
from msp_lab.characterise.findings import Mixture
from msp_lab.characterise.mixture import fit_mixture
from msp_lab.characterise.points import sort_into_points
from msp_lab.mixture_fit.fit_result import FitError
from msp_lab.readings.intake import LoadedReadings
from msp_range.correction.calibration import IDENTITY
from tests.support.characterised import measured
from tests.support.known import known
from tests.support.plain_bench import point, table
from tests.support.shipped import SENSOR


def fitted(seed: int, *, n: int, off_cm: float) -> Mixture:
    rng = np.random.default_rng(seed)
    parts = [
        point(rng, z, n=n, error_cm=off_cm * rng.standard_normal(), sigma_cm=0.7, missed=0.03, stray=0.01)
        for z in range(40, 500, 20)
    ]
    points = sort_into_points(table(*parts), SENSOR)
    return fit_mixture(points, IDENTITY, SENSOR, np.random.default_rng(seed))[0]


def test_how_far_set_ups_are_off_is_not_the_sensor_s_noise() -> None:
    found = fitted(1, n=600, off_cm=0.6)
    sigma = next(each.fitted for each in found.parameters if each.name == "sigma_cm")
    assert sigma.value == pytest.approx(0.7, abs=0.02)
    assert known(found.pit_p_value) > 0.01
    assert "nothing depends on range" in found.conditional
    assert any(note.startswith("23 of 23 set-ups are fitted about the mean of their own hits") for note in found.notes)


def test_set_ups_of_few_readings_stay_where_the_reference_puts_them() -> None:
    found = fitted(2, n=40, off_cm=0.0)
    sigma = next(each.fitted for each in found.parameters if each.name == "sigma_cm")
    # Their own means would take 1/40 off the variance, and hide what the set-ups differ by.
    assert sigma.value == pytest.approx(0.7, abs=0.05)
    assert not any("set-ups" in note for note in found.notes)


def test_255_is_a_reading_like_others_of_a_sensor_that_has_no_such_code() -> None:
    rng = np.random.default_rng(3)
    parts = [point(rng, z, n=300, saturated=0.05) for z in range(100, 501, 100)]
    points = sort_into_points(table(*parts), SENSOR)
    weights = {}
    for share in (0.25, 0.0):
        parameters = SENSOR.reading_model.model_copy(update={"saturated_fraction": share})
        sensor = SENSOR.model_copy(update={"reading_model": parameters})
        weights[share] = fit_mixture(points, IDENTITY, sensor, np.random.default_rng(3))[1].weights
    assert weights[0.25].missed == pytest.approx(0.05, abs=0.015)
    assert weights[0.0].missed < 0.005


def test_a_sensor_without_255_among_its_readings_is_fitted_unless_its_file_has_the_code() -> None:
    """A step that does not meet 255 from the shortest reading ended the command with a traceback."""
    rng = np.random.default_rng(4)
    points = sort_into_points(table(*[point(rng, z, n=300) for z in range(100, 501, 100)]), SENSOR)
    limits = {"minimum_cm": 20, "maximum_cm": 764, "resolution_cm": 2.0}
    with_code = SENSOR.model_copy(update=limits)
    no_code = SENSOR.reading_model.model_copy(update={"saturated_fraction": 0.0})
    without = with_code.model_copy(update={"reading_model": no_code})
    fit_mixture(points, IDENTITY, without, np.random.default_rng(4))
    with pytest.raises(FitError, match="expected a second code outside of the limits or on the grid, found 255 cm"):
        fit_mixture(points, IDENTITY, with_code, np.random.default_rng(4))


def test_a_weight_that_the_readings_leave_open_is_the_fit_s() -> None:
    """It is no number of its own in the starting model, whose value was asked for."""
    points = sort_into_points(measured(3, most=2000), SENSOR)
    undisturbed = [each for each in points if each.found.condition in ("baseline", "maximum_range")]
    found, fitted = fit_mixture(undisturbed, IDENTITY, SENSOR, np.random.default_rng(1))
    assert "short: not identifiable from these readings" in found.notes
    assert fitted.weights.short < 0.01


def test_an_error_of_the_program_is_not_shown_as_readings_without_a_mixture(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*given: object, **more: object) -> None:
        raise ValueError("operands could not be broadcast together")

    monkeypatch.setattr("msp_lab.characterise.mixture.fit_readings", broken)
    loaded = LoadedReadings(measured(most=300), ())
    with pytest.raises(ValueError, match="broadcast"):
        characterise(loaded, SENSOR, Characterisation((), Path(), (), "recorded", "2026-10-05", 1))
