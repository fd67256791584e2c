"""The report's campaign, staged in sound and characterised: each of the report's conclusions is reached."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from evaluation.blind.campaign import campaign
from msp_lab.characterise.analysis import Characterisation, characterise
from msp_lab.characterise.findings import FactorEffect, Findings, Question
from msp_lab.readings.intake import load_readings
from msp_range.recording.csv_form import write_csv
from tests.support.known import known
from tests.support.shipped import SENSOR
from tests.support.slow import slow

STEP_DEG = 1.8
REPORT_DEG = {50.0: 23.4, 100.0: 18.0, 150.0: 14.4, 200.0: 12.6}

pytestmark = pytest.mark.parametrize("seed", [1, *slow(3)])


@cache
def found(seed: int) -> Findings:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "campaign.csv"
        write_csv(path, campaign(seed))
        loaded = load_readings([path], SENSOR)
    return characterise(loaded, SENSOR, Characterisation((), Path(), (), "recorded", "2026-10-05", seed)).findings


def asked(seed: int, name: str, level: str = "", sensor: str = "") -> Question:
    (question,) = (
        each
        for each in found(seed).questions
        if each.name == name and each.level.startswith(level) and each.sensor in ("", sensor or each.sensor)
    )
    return question


def bias(question: Question) -> FactorEffect:
    return next(effect for effect in question.effects if effect.metric == "bias")


def test_baseline_errs_by_a_centimetre(seed: int) -> None:
    """4.3.1: the largest error of a reading that is not missed is 1 cm."""
    baseline = found(seed).baseline
    assert baseline is not None
    assert abs(baseline.largest_error_cm) <= 1.0


def test_codes_masked_leave_one_peak(seed: int) -> None:
    """4.3.2: several peaks, and a single one near 503 cm once 765 and 255 are masked."""
    maximum = found(seed).maximum_range
    assert maximum is not None
    assert maximum.readings == 20_000
    assert len(maximum.peaks_before) > 1
    assert len(maximum.peaks_after) == 1
    assert maximum.peak.value == pytest.approx(503.0, abs=1.0)
    assert maximum.no_echo > maximum.saturated > 0


def test_breakaway_angles_within_a_step(seed: int) -> None:
    """4.3.3: 23.4 deg at 50 cm, where no larger angle was tried, 18.0 at 100, 14.4 at 150, 12.6 at 200."""
    view = found(seed).field_of_view
    assert view is not None
    assert {angle.range_cm for angle in view.angles} == set(REPORT_DEG)
    for angle in view.angles:
        assert angle.half_angle.value == pytest.approx(REPORT_DEG[angle.range_cm], abs=STEP_DEG + 1e-6)
    assert view.oblique.verdict == "nearest"  # a wall is a mirror


def test_sonar_equation_within_a_step(seed: int) -> None:
    sonar = found(seed).sonar
    assert sonar is not None
    for row in sonar.rows:
        assert row.fitted_deg == pytest.approx(row.measured_deg, abs=STEP_DEG)


@pytest.mark.parametrize("material", ["asphalt", "concrete"])
def test_materials_are_indistinguishable(seed: int, material: str) -> None:
    """4.3.4, and what the data could have shown is small."""
    question = asked(seed, "material", material)
    assert question.verdict == "does not matter"
    smallest = bias(question).smallest_detectable
    assert smallest is not None
    assert smallest < 1.0


def test_hot_box_errs_by_1_to_2_cm(seed: int) -> None:
    """4.3.5 and errata 4 and 11: 1 to 2 cm at all ranges and not 4.4 %, from air confined to about 30 cm."""
    (hot,) = (box for box in found(seed).hot_boxes if box.box_c > box.room_c)
    shifts = [row.shift.value for row in hot.rows]
    assert min(shifts) > -2.2
    assert max(shifts) < 0.0
    assert -2.0 < np.mean(shifts) < -1.0
    assert hot.best == "confined"
    assert hot.depth.low is not None
    assert hot.depth.high is not None
    assert hot.depth.low < 32.0  # what is in the box is 30 cm deep and 2 cm blurred
    assert hot.depth.high > 28.0
    assert abs(hot.uniform_per_cent) == pytest.approx(4.2, abs=0.3)
    assert abs(hot.per_cent.value) < 1.0


def test_cold_air_reads_farther(seed: int) -> None:
    assert known(bias(asked(seed, "temperature", "8")).estimate).value > 0.3


def test_vibration_does_nothing(seed: int) -> None:
    """4.3.6."""
    assert asked(seed, "vibration").verdict == "does not matter"


def test_crosstalk_is_short_and_goes_when_pinged_in_turn(seed: int) -> None:
    """4.3.7: the sensor that pings second reads short; the first does not; neither does in turn."""
    assert asked(seed, "crosstalk_simultaneous", sensor="sensor_1").verdict == "does not matter"
    second = asked(seed, "crosstalk_simultaneous", sensor="sensor_2")
    assert second.verdict == "matters"
    estimate = bias(second).estimate
    assert estimate is not None
    # The other's ping is 0.35 to 0.65 ms early, at 58 us a centimetre.
    assert estimate.value == pytest.approx(-0.5 / 0.058, abs=1.0)
    for sensor in ("sensor_1", "sensor_2"):
        assert asked(seed, "crosstalk_sequential", sensor=sensor).verdict == "does not matter"


def test_external_ultrasound_matters_when_loud(seed: int) -> None:
    """4.3.8, where the report could not tell."""
    loud = [each for each in found(seed).questions if each.name == "external_interference" and "110" in each.level]
    assert [each.verdict for each in loud] == ["matters"]


def test_table_5_1(seed: int) -> None:
    """One air temperature a row, compensation to within a centimetre, and a first row that nothing compensates."""
    rows = {row.range_cm: row for row in found(seed).temperature_compensation}
    uncompensated = {305.0: 1.0, 335.0: 2.821, 366.0: 2.739, 396.0: 2.724, 427.0: 4.931}
    assert set(rows) == set(uncompensated)
    for range_cm, row in rows.items():
        assert row.uncompensated.value == pytest.approx(uncompensated[range_cm], abs=0.5)
        if range_cm == 305.0:
            assert row.thermometer_c is None
            assert row.compensated is None
        else:
            assert row.compensated is not None
            assert abs(row.compensated.value) < 1.0
            assert row.thermometer_c is not None
            # The random error in setting up the range is 1 mm: 0.2 C at 3 m.
            assert row.implied_c.value == pytest.approx(row.thermometer_c, abs=1.0)
