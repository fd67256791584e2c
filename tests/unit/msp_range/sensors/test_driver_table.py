"""The table of drivers, and drivers and emulated devices that other packages bring by entry points."""

import sys
from pathlib import Path

import pytest
import yaml

from msp_range.config import load_airframe
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.sensors.table import DRIVERS, driver_names, find_driver
from msp_range.yaml_file import ConfigError
from msp_sim.device.table import EMULATED, emulated_kind
from tests.support.bench import Bench
from tests.support.shipped import CONFIGS

PACKAGE = """
from msp_range.sensors.mb1242 import MB1242
from msp_sim.device.mb1242 import EmulatedMB1242 as Emulated


class Doubled(MB1242):
    '''A sensor whose centimetres are half ones.'''

    part = "a doubled sensor"
    default_address = 0x20

    def answer(self):
        decoded = super().answer()
        return decoded._replace(range_m=None if decoded.range_m is None else decoded.range_m / 2)


class Device(Emulated):
    '''It answers as its driver expects.'''


NOT_A_DRIVER = 7
"""
ENTRY_POINTS = """
[msp_range.drivers]
doubled = somebodys_sensor:Doubled
broken = somebodys_sensor:Missing
number = somebodys_sensor:NOT_A_DRIVER
[msp_sim.devices]
doubled = somebodys_sensor:Device
"""


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package of somebody else's, as pip leaves it; returns a folder with an airframe that flies its sensor."""
    (tmp_path / "somebodys_sensor.py").write_text(PACKAGE)
    metadata = tmp_path / "somebodys_sensor-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: somebodys-sensor\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "somebodys_sensor", raising=False)
    vehicle = yaml.safe_load((CONFIGS / "quad_pallet.yaml").read_text())
    vehicle["sensors"] = [vehicle["sensors"][0] | {"model": "sensor.yaml"}]
    (tmp_path / "airframe.yaml").write_text(yaml.safe_dump(vehicle))
    return tmp_path


def model(folder: Path, driver: str) -> Path:
    content = yaml.safe_load((CONFIGS / "sensors" / "mb1242.yaml").read_text())
    path = folder / "sensor.yaml"
    path.write_text(yaml.safe_dump(content | {"driver": driver}))
    return path


def test_every_driver_has_an_emulated_device_and_a_sensor_model() -> None:
    assert DRIVERS.keys() == EMULATED.keys()
    models = {load_sensor_model(path).driver for path in (CONFIGS / "sensors").glob("*.yaml")}
    assert models >= DRIVERS.keys()


def test_default_addresses_are_ones_that_the_sensor_can_have() -> None:
    assert not [name for name, kind in DRIVERS.items() if kind.ignores_address(kind.default_address)]


def test_a_driver_of_another_package_flies_on_its_own_emulated_device(installed: Path) -> None:
    model(installed, "doubled")
    bench = Bench(load_airframe(installed / "airframe.yaml"), 500).fly(3.0)
    assert {step.ranging.reading.range_m for step in bench.steps} == {2.5}
    assert type(bench.sonars["front_left"]).__name__ == "Device"
    assert "doubled" in driver_names()


@pytest.mark.parametrize(
    ("driver", "message"),
    [
        ("broken", r"the driver 'broken' \(somebodys_sensor:Missing\) cannot be loaded"),
        ("number", r"the driver 'number' .* is not a Driver or a class derived from it"),
        ("absent", r"driver: found 'absent'; expected 'mb1242', .*'doubled', 'number' or 'none'"),
    ],
)
def test_a_driver_that_cannot_be_used_is_a_line(installed: Path, driver: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_sensor_model(model(installed, driver))


def test_names() -> None:
    assert find_driver("none") is None
    with pytest.raises(ValueError, match="no emulated range finder for the driver 'absent'"):
        emulated_kind("absent")
