"""What `msp-range check` shows, and messages for what a person forgot: I2C, the serial port, metres, the right file."""

import errno
from pathlib import Path

import pytest

from msp_lab.campaigns.campaign import load_campaign
from msp_lab.readings.column_map import load_map
from msp_range.bus.base import BusError
from msp_range.bus.smbus import KernelBus
from msp_range.check import _table, drawing, lines
from msp_range.clock import VirtualClock
from msp_range.config import Airframe, load_airframe
from msp_range.health.bus import BusHealth
from msp_range.mavlink.transport import open_transport
from msp_range.plausible import doubts
from msp_range.reading import Reading, Status
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.sensors.polling import Ranging
from msp_range.yaml_file import ConfigError
from msp_sim.flight.scenario import load_scenario
from tests.support.shipped import CONFIGS


def airframe(name: str, folder: Path, *changes: tuple[str, str]) -> Airframe:
    """A shipped airframe with changes."""
    text = (CONFIGS / f"{name}.yaml").read_text().replace("sensors/mb1242.yaml", "mb1242")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "airframe.yaml"
    path.write_text(text)
    return load_airframe(path)


def test_the_drawing_shows_who_is_where(tmp_path: Path) -> None:
    rows = drawing(airframe("forward_and_down", tmp_path))
    assert "0.6 m from edge to edge" in rows[0]
    picture = [row[3:-1] for row in rows[1:-1]]
    places = {
        letter: (row, column) for row, line in enumerate(picture) for column, letter in enumerate(line) if letter != " "
    }
    assert places.keys() == set("1234+")
    middle = places["+"]
    assert places["1"] == (0, middle[1])
    assert places["4"][0] > middle[0] > places["2"][0] == places["3"][0]
    assert places["2"][1] < middle[1] < places["3"][1]
    assert middle[1] - places["2"][1] == places["3"][1] - middle[1]
    assert max(map(len, rows)) <= 110


def test_what_is_shown(tmp_path: Path) -> None:
    vehicle = airframe("forward_and_down", tmp_path, ("/var/lib/msp-range", "/data"))
    text = "\n".join(lines(vehicle))
    for words in (
        f"msp-range params {tmp_path}/",
        "/dev/serial0 at 921600 baud, as component 191",
        "forward with down_left, then down_right, then down_rear; 0.1 s apart",
        "filters of the single streams: changepoint",
        "height above ground (RNGFND1)",
        "forward: id 1: obstacles (PRX1_TYPE 2)",
        "SCALED_PRESSURE.temperature",
        "recording: /data",
    ):
        assert words in text
    text = "\n".join(lines(airframe("loopback", tmp_path, ("autopilot: ardupilot", "autopilot: px4"))))
    assert "udpout:127.0.0.1:14550, no serial port" in text
    assert "height above ground (EKF2_RNG_CTRL)" in text
    assert "0.05 s below 2 m" in text
    assert "recording: none" in text
    assert "warning" not in text


def test_that_nothing_is_sent_stands_before_the_streams(tmp_path: Path) -> None:
    vehicle = airframe("forward_and_down", tmp_path, ("send:\n", "send:\n  nothing: true\n"))
    shown = list(lines(vehicle))
    place = next(i for i, line in enumerate(shown) if line.startswith("send: nothing;"))
    assert shown[place + 1].startswith("fused: id 10")
    assert [list(_table(vehicle).columns[4].cells)] == [["no"] * 4]
    assert list(_table(airframe("forward_and_down", tmp_path)).columns[4].cells) == ["yes", "no", "no", "no"]


def test_centimetres_are_suspected(tmp_path: Path) -> None:
    """A whole file in centimetres, one number of it, and a large vehicle in metres."""
    assert list(doubts(airframe("quad_pallet", tmp_path))) == []
    everything = ("[0.25, -0.20, 0.05]", "[25, -20, 5]"), ("reference_down_m: 0.05", "reference_down_m: 5")
    found = list(doubts(airframe("quad_pallet", tmp_path, *everything)))
    assert len(found) == 2
    assert "sensors.front_left.position_m: 25 m" in found[0]
    assert "0.25?" in found[0]
    assert "reference_down_m: 5 m" in found[1]
    assert list(doubts(airframe("quad_pallet", tmp_path, ("0.25, -0.20", "2.5, -2.0")))) == []
    (twice,) = doubts(airframe("quad_pallet", tmp_path, ("[0.25, 0.20, 0.05]", "[0.25, -0.20, 0.05]")))
    assert "front_right: at the same place and angle as front_left" in twice


READERS = {
    ".": ("an airframe file", load_airframe),
    "sensors": ("a sensor model", load_sensor_model),
    "scenarios": ("a scenario", load_scenario),
    "campaigns": ("a campaign", load_campaign),
    "maps": ("a column map", lambda path: load_map([str(path)])),
}


@pytest.mark.parametrize("other", READERS)
@pytest.mark.parametrize("folder", READERS)
def test_a_file_of_another_kind_is_one_line(folder: str, other: str) -> None:
    expected, read = READERS[folder]
    for path in sorted((CONFIGS / other).glob("*.yaml")):
        if folder != other:
            with pytest.raises(ConfigError) as caught:
                read(path)
            found = "a campaign of flights" if path.stem == "flight" else READERS[other][0]
            assert str(caught.value) == f"{path}: found {found}; expected {expected}"


def test_the_eight_bit_form_is_explained(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="0xE2 is the 8-bit form of 0x71; expected the 7-bit form"):
        airframe("quad_pallet", tmp_path, ("0x71", "0xE2"))
    with pytest.raises(ConfigError, match="0xEF is the 8-bit form of 0x77; expected the 7-bit form"):
        airframe("quad_pallet", tmp_path, ("0x71", "0xEF"))
    with pytest.raises(ConfigError, match="expected a number without quotes: address: 0x71"):
        airframe("quad_pallet", tmp_path, ("0x71", "'0x71'"))
    with pytest.raises(ConfigError, match="less than or equal to 119"):
        airframe("quad_pallet", tmp_path, ("0x71", "0x1F0"))


def bus_text(error: BusError) -> str:
    """What the pilot reads of a bus's fault."""
    health = BusHealth()
    health.on_ranging(1.0, Ranging(Reading(1.0, "down", Status.NO_ANSWER), 1.0, 1.0, error))
    condition = health.condition()
    assert condition.text is not None
    assert len(condition.text) <= 50
    return condition.text


def test_a_bus_that_never_was_is_not_reopened(tmp_path: Path) -> None:
    with pytest.raises(BusError) as caught:
        KernelBus(str(tmp_path / "i2c-1")).read(0x70, 2)
    assert "no such I2C bus; enable I2C" in str(caught.value)
    assert bus_text(caught.value) == "Range: no I2C bus: enable I2C (errno 2)"
    assert bus_text(BusError(errno.ENOENT, "read", 0x70)) == "Range: I2C bus gone, reopening (errno 2)"
    assert bus_text(BusError(errno.ETIMEDOUT, "read", 0x70)) == "Range: I2C bus locked up, reopening (errno 110)"


def test_a_missing_serial_port_of_the_computer(tmp_path: Path) -> None:
    missing = open_transport("serial:/dev/serial0:57600", VirtualClock())
    assert (
        missing.last_error
        == "serial:/dev/serial0:57600: there is no such port; on a Raspberry Pi: enable_uart=1 in config.txt"
    )
    usb = open_transport(f"serial:{tmp_path}/ttyUSB0:57600", VirtualClock())
    assert usb.last_error == f"serial:{tmp_path}/ttyUSB0:57600: there is no such port"
