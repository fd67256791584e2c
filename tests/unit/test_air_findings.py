"""Where hot air must have been, and Table 5.1: one air temperature a row, and what is wrong with its first row."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.characterise.findings import Question
from msp_lab.characterise.points import sort_into_points
from msp_lab.characterise.questions import answer_questions
from msp_lab.characterise.temperature import compensation_table, hot_boxes
from msp_lab.comparison.report import implied_temperature_c
from msp_range.correction.calibration import IDENTITY, Calibration
from tests.support.known import contains
from tests.support.plain_bench import point, table
from tests.support.shipped import SENSOR

RANGES_CM = tuple(range(40, 261, 20))


Profile = Callable[[NDArray[np.float64], float], NDArray[np.float64]]
"""Temperature of the air [deg C] at a distance from the sensor, of a path of this range [cm]."""


def read_cm(range_cm: float, air_c: Profile, pieces: int = 2000) -> float:
    """What a sensor made for 22.5 deg C reads: its speed of sound times the time that each millimetre takes."""
    x = (np.arange(pieces) + 0.5) / pieces * range_cm
    return range_cm * float(np.mean(np.sqrt(295.65 / (air_c(x, range_cm) + 273.15))))


def asked(*parts: dict[str, NDArray[Any]]) -> tuple[Question, ...]:
    return answer_questions([each.found for each in sort_into_points(table(*parts), SENSOR)])


IDEAS: dict[str, Profile] = {
    "confined": lambda x, r: np.where(x < 30.0, 46.1, 21.1),
    "uniform": lambda x, r: np.full_like(x, 46.1),
    "gradient": lambda x, r: 46.1 + (21.1 - 46.1) * x / r,
}


@pytest.mark.parametrize("idea", IDEAS)
def test_where_the_hot_air_was_is_found(idea: str) -> None:
    rng = np.random.default_rng(1)
    parts = []
    for z in RANGES_CM:
        for air_c, profile in ((46.1, IDEAS[idea]), (21.1, lambda x, r: np.full_like(x, 21.1))):
            error_cm = read_cm(z, profile) - z + rng.normal(0.0, 0.1)
            context: dict[str, Any] = {"air_temperature_c": air_c, "target_temperature_c": 21.1}
            parts.append(point(rng, z, condition="temperature", error_cm=error_cm, **context))
    (found,) = hot_boxes(asked(*parts), 22.5)
    assert found.best == idea
    # Speeds at 22.5, 21.1 and 46.1 deg C: c_cal (1 / c_room - 1 / c_box).
    ratio = np.sqrt(295.65 / 294.25) - np.sqrt(295.65 / 319.25)
    assert found.uniform_per_cent == pytest.approx(100.0 * ratio, abs=1e-6)
    assert found.compared == ("as" if idea == "uniform" else "and not")
    if idea == "confined":
        assert contains(found.depth, 30.0)
        assert contains(found.per_cent, 0.0)
        assert "over the first" in found.answer
    if idea == "uniform":
        # The reading is short by 4.16 % of what it is in the room's air; the per cent are of range.
        assert found.per_cent.value == pytest.approx(100 * (1 - np.sqrt(294.25 / 319.25)) * 1.0024, abs=0.15)
        assert found.depth.high is None


def test_three_ranges_of_hot_air_are_a_shift() -> None:
    """The shift grows with range, so the scatter about its mean is no reason to doubt it."""
    rng = np.random.default_rng(4)
    parts = []
    for z in (50, 100, 150):
        for air_c in (46.1, 21.1):
            error_cm = z * np.sqrt(295.65 / (air_c + 273.15)) - z
            parts.append(point(rng, z, condition="temperature", error_cm=error_cm, air_temperature_c=air_c))
    (found,) = hot_boxes(asked(*parts), 22.5)
    assert found.best == "uniform"
    assert "no shift" not in found.answer


def test_rows_without_a_temperature_are_no_hot_ones() -> None:
    rng = np.random.default_rng(5)
    parts = [
        point(rng, z, condition="temperature", run=str(air_c), air_temperature_c=air_c)
        for z in (50, 100, 150)
        for air_c in (46.0, 21.0, np.nan)
    ]
    found = [each.found for each in sort_into_points(table(*parts), SENSOR)]
    assert sorted(each.level for each in found) == ["", "", "", *["21 C"] * 3, *["46 C"] * 3]


def test_a_box_that_changes_nothing_is_reported_so() -> None:
    rng = np.random.default_rng(2)
    parts = [
        point(rng, z, condition="temperature", error_cm=rng.normal(0.0, 0.2), air_temperature_c=air_c)
        for z in RANGES_CM
        for air_c in (46.1, 21.1)
    ]
    (found,) = hot_boxes(asked(*parts), 22.5)
    assert found.best == "none"


def test_table_5_1_gets_its_air_back_row_by_row() -> None:
    rng = np.random.default_rng(3)
    air_c = {305: 15.0, 335: 15.2, 366: 16.0, 396: 16.7, 427: 14.6}
    parts = [
        point(
            rng,
            z,
            n=400,
            condition="temperature_compensation",
            error_cm=z * np.sqrt(295.65 / (air + 273.15)) - z,
            **({"air_temperature_c": air} if z != 305 else {}),
        )
        for z, air in air_c.items()
    ]
    rows = [*compensation_table(sort_into_points(table(*parts), SENSOR), IDENTITY)]
    assert [row.range_cm for row in rows] == list(air_c)
    for row in rows:
        assert contains(row.implied_c, air_c[int(row.range_cm)])
    first, *others = rows
    assert first.compensated is None
    assert first.note == "no thermometer here, so nothing to compensate with"
    for row in others:
        assert row.uncompensated.value > 3.0
        assert row.compensated is not None
        assert contains(row.compensated, 0.0)


def test_the_temperatures_that_the_reports_two_columns_imply() -> None:
    """With its 20 deg C; the first row has the same number twice (erratum 12)."""
    assert implied_temperature_c(305.0) is None
    implied = [implied_temperature_c(range_cm) for range_cm in (335.0, 366.0, 396.0, 427.0)]
    assert [round(each, 1) for each in implied if each] == [15.2, 16.0, 16.7, 14.6]


def test_the_calibration_is_taken_back_before_the_air_is_judged() -> None:
    rng = np.random.default_rng(4)
    part = point(rng, 400, n=400, condition="temperature_compensation", error_cm=5.0, air_temperature_c=22.5)
    (row,) = compensation_table(sort_into_points(table(part), SENSOR), Calibration((0.0, 100.0), (5.0, 105.0)))
    assert row.uncompensated.value == pytest.approx(0.0, abs=0.1)
    assert row.implied_c.value == pytest.approx(22.5, abs=0.2)
    assert row.note == "after the calibration"
