"""The sensor model file: the shipped one, and user errors in it."""

import copy
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.yaml_file import ConfigError
from tests.support.shipped import MB1242

CONTENT: dict[str, Any] = yaml.safe_load(MB1242.read_text(encoding="utf-8"))


def write(folder: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """Write the shipped file with a change made to its content."""
    content = copy.deepcopy(CONTENT)
    change(content)
    path = folder / "sensor.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_the_shipped_file_says_what_maker_and_report_say() -> None:
    sensor = load_sensor_model(MB1242)
    assert (sensor.name, sensor.driver) == ("MB1242", "mb1242")
    assert (sensor.minimum_cm, sensor.maximum_cm, sensor.resolution_cm) == (20, 765, 1)
    assert sensor.calibration_temperature_c == 22.5
    assert sensor.oblique_reading == "unknown"
    timing = sensor.timing
    assert (timing.ready_s, timing.s_per_cm, timing.cycle_s) == (0.020, 58e-6, 0.067)
    assert (timing.deadline_s, timing.ping_interval_s) == (0.080, 0.100)
    for range_m, half_angle_deg in [(0.5, 23.4), (1.0, 18.0), (1.5, 14.4), (2.0, 12.6)]:
        assert math.degrees(sensor.beam.half_angle_rad(range_m)) == pytest.approx(half_angle_deg)
    # Beyond the table the angle is the sonar equation's, for the whole range of the sensor.
    assert math.degrees(sensor.beam.half_angle_rad(7.65)) == pytest.approx(11.3, abs=0.05)
    assert sensor.reading_model.sigma_cm**2 == pytest.approx(3.7811, abs=2 * 1.9445 * 0.5e-4)


def test_effects_and_evidence_are_kept_unread(tmp_path: Path) -> None:
    effect = {"name": "range_scale", "parameters": {"scale": {"value": 0.01, "low": 0.008}}}
    sensor = load_sensor_model(
        write(tmp_path, lambda content: content.update(effects=[effect], evidence=[{"rows": 9}]))
    )
    assert sensor.effects == (effect,)
    assert sensor.evidence == ({"rows": 9},)


def test_drivers_answer_whole_centimetres_of_a_finer_model(tmp_path: Path) -> None:
    fine = load_sensor_model(write(tmp_path, lambda content: content.update(resolution_cm=0.1)))
    assert (fine.resolution_cm, fine.answered_cm) == (0.1, 1.0)


def test_effects_and_evidence_may_be_absent(tmp_path: Path) -> None:
    sensor = load_sensor_model(write(tmp_path, lambda content: (content.pop("effects"), content.pop("evidence"))))
    assert sensor.effects == sensor.evidence == ()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c.update(maximum=765), r"maximum: unknown key\. Did you mean 'maximum_cm'\?"),
        (lambda c: c["timing"].update(ready_ms=20), r"timing\.ready_ms: unknown key\. Did you mean 'ready_s'\?"),
        (lambda c: c.pop("calibration_temperature_c"), r"calibration_temperature_c: this key is missing"),
        (lambda c: c.update(driver="mb1232"), r"driver: found 'mb1232'; expected 'mb1242'"),
        (lambda c: c.update(oblique_reading="both"), r"oblique_reading: found 'both'; expected 'slant', 'nearest' or"),
        (lambda c: c.update(resolution_cm=0.3), r"expected resolution_cm a whole number, or a .*, found 0\.3"),
        (lambda c: c.update(resolution_cm=2), r"whole multiples of resolution_cm \(2\), found 20 and 765"),
        (lambda c: c.update(minimum_cm=20.5), r"whole multiples of resolution_cm \(1\), found 20\.5 and 765"),
        (
            lambda c: c.update(minimum_cm=20.5, resolution_cm=0.5),
            r"whole multiples of a centimetre, as drivers answer \(1\), found 20\.5 and 765",
        ),
        (lambda c: c.update(calibration_temperature_c=72.5), r"calibration_temperature_c: found 72\.5; .* 50"),
        (lambda c: c.update(minimum_cm=765), r"expected minimum_cm < maximum_cm, found 765 and 765"),
        (lambda c: c.update(maximum_cm=900), r"expected an echo from maximum_cm within timing\.cycle_s \(0\.067 s\)"),
        (lambda c: c.update(minimum_cm=300), r"expected reading_model\.saturated_fraction 0 .* leave out 255"),
        (
            lambda c: c["timing"].update(cycle_s=0.09),
            r"timing: .*expected ready_s < cycle_s <= deadline_s, found 0\.02",
        ),
        (lambda c: c["breakaway"].reverse(), r"breakaway: .*expected ranges that grow from row to row"),
        (
            lambda c: c["breakaway"].append({"range_cm": 300, "half_angle_deg": 13}),
            r"breakaway: .*found 13 deg at 300 cm after 12\.6 deg at 200 cm, expected angles that do not",
        ),
        (lambda c: c.update(heard_on_axis_cm=800), r"expected heard_on_axis_cm <= maximum_cm, found 800 and 765"),
        (lambda c: c.update(frequency_hz=42), r"frequency_hz: found 42; expected .*20000"),
        (lambda c: c["breakaway"].clear(), r"breakaway: found \[\]; expected .*at least 1"),
        (lambda c: c["breakaway"][0].update(half_angle_deg=95), r"breakaway\[0\]\.half_angle_deg: found 95; .*90"),
        (lambda c: c["reading_model"]["weights"].update(hit=0.9), r"weights: .*weights whose sum is 1, .*sum of 0\.94"),
        (lambda c: c["reading_model"].update(sigma_cm=0), r"reading_model\.sigma_cm: found 0; expected .*0\.01"),
        (lambda c: c["reading_model"].update(saturated_fraction=1.5), r"saturated_fraction: found 1\.5; expected .*1"),
        (lambda c: c.update(effects=["scale"]), r"effects\[0\]: found 'scale'; expected .*dict"),
    ],
)
def test_a_user_error_is_explained(tmp_path: Path, change: Callable[[dict[str, Any]], object], message: str) -> None:
    path = write(tmp_path, change)
    with pytest.raises(ConfigError, match=message) as error:
        load_sensor_model(path)
    assert str(path) in str(error.value)
