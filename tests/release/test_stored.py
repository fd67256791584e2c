"""Files that any version wrote or shipped, kept by `make stored`, are read by this one."""

import re
from pathlib import Path

import pytest

from msp_lab.campaigns.campaign import load_campaign
from msp_lab.campaigns.flights import load_flights
from msp_lab.gap.intake import read_readings
from msp_range import __version__
from msp_range.config import load_airframe
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.reader import Recording
from msp_sim.flight.scenario import load_scenario
from msp_sim.model.model import load_model
from release.stored import STORED
from tests.support.programs import run

VERSIONS = sorted(path.name for path in STORED.iterdir() if path.is_dir())
every_version = pytest.mark.parametrize("version", VERSIONS)


def stored(version: str, pattern: str) -> list[Path]:
    found = sorted((STORED / version).glob(pattern))
    assert found, (version, pattern)
    return found


def test_this_version_has_stored_files() -> None:
    assert __version__ in VERSIONS, "make stored"


@every_version
def test_airframes(version: str) -> None:
    for path in stored(version, "configs/*.yaml"):
        assert load_airframe(path).sensors
    run("msp-range check", STORED / version / "configs/quad_pallet.yaml")


@every_version
def test_sensor_models(version: str) -> None:
    for path in (*stored(version, "configs/sensors/*.yaml"), *stored(version, "model.yaml")):
        assert load_sensor_model(path).maximum_cm > 0.0
        load_model(path)


@every_version
def test_scenarios_and_campaigns(version: str) -> None:
    for path in stored(version, "configs/scenarios/*.yaml"):
        load_scenario(path)
    for path in stored(version, "configs/campaigns/*.yaml"):
        is_flights = re.search("^flights:", path.read_text(encoding="utf-8"), re.M)
        load_flights(path) if is_flights else load_campaign(path)


def distances(path: Path) -> list[float]:
    return [message["range_m"] for topic, _, message in Recording(path) if topic == "/fused"]


@every_version
def test_a_recording_is_replayed(version: str, tmp_path: Path) -> None:
    (recording,) = stored(version, "flight.mcap")
    run("msp-range replay", recording, "--record", tmp_path / "again.mcap")
    flown, again = distances(recording), distances(tmp_path / "again.mcap")
    assert len(flown) > 100
    assert len(again) == pytest.approx(len(flown), rel=0.1)


@every_version
def test_readings_are_a_dataset(version: str, tmp_path: Path) -> None:
    (readings,) = stored(version, "readings.csv")
    assert read_readings([readings], load_model(STORED / version / "model.yaml")).data["reading_cm"].size == 240
    run("msp-lab characterise", readings, "--out", tmp_path / "model.yaml")
