"""`msp-range params`: the values, the file, and what it sets on an autopilot that pymavlink plays."""

import re
import socket
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
from pymavlink import mavparm
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from msp_range.config import load_airframe
from msp_range.params.settings import Firmware, Vehicle, remarks, settings
from tests.sitl import documented
from tests.support.parameter_autopilot import ParameterAutopilot
from tests.support.shipped import CONFIGS, write_airframe
from tests.support.transports import free_port

COMMAND = Path(sys.executable).with_name("msp-range")
FRESH = {
    "RNGFND1_TYPE": 0.0,
    "RNGFND1_ORIENT": 25.0,
    "RNGFND1_ADDR": 112.0,
    "RNGFND1_MIN": 0.2,
    "RNGFND1_MAX": 7.0,
    "RNGFND1_GNDCLR": 0.1,
    "RNGFND1_POS_Z": 0.0,
}
"""ArduCopter 4.7 with its defaults, apart from the address of an MB1242 on its own I2C."""
FRESH_BEFORE = {"RNGFND1_MIN_CM": 20.0, "RNGFND1_MAX_CM": 700.0, "RNGFND1_GNDCLEAR": 10.0} | {
    name: FRESH[name] for name in ("RNGFND1_TYPE", "RNGFND1_ORIENT", "RNGFND1_ADDR", "RNGFND1_POS_Z")
}
FRESH_PX4 = {"EKF2_RNG_CTRL": 1.0, "EKF2_HGT_REF": 1.0, "EKF2_MIN_RNG": 0.1, "EKF2_RNG_POS_Z": 0.0}


def of(name: str, firmware: Firmware, port: int = 2) -> dict[str, float]:
    """Names and values for one of the shipped airframes, in order."""
    return {each.name: each.value for each in settings(load_airframe(CONFIGS / f"{name}.yaml"), firmware, port)}


def params(folder: Path, *arguments: str, answers: str = "") -> "subprocess.CompletedProcess[str]":
    """Run the command in a folder."""
    return subprocess.run(
        [COMMAND, "params", *arguments], cwd=folder, input=answers, capture_output=True, text=True, timeout=60.0
    )


def test_the_values_are_those_that_are_flown() -> None:
    flown = {name: float(value) for name, value in documented.parameters("ArduPilot").items()}
    now = of("loopback", Firmware("ardupilot"))
    before = of("loopback", Firmware("ardupilot", centimetres=True))
    assert now | before == {name: flown[name] for name in now | before}
    assert {"RNGFND1_MIN", "RNGFND1_MAX", "RNGFND1_GNDCLR"} <= now.keys() - before.keys()
    assert {"RNGFND1_MIN_CM", "RNGFND1_MAX_CM", "RNGFND1_GNDCLEAR"} <= before.keys() - now.keys()
    px4 = {name: float(value) for name, value in documented.parameters("PX4 (SIH)").items()}
    assert of("loopback", Firmware("px4")).items() <= px4.items()
    assert of("proximity", Firmware("ardupilot"))["PRX1_TYPE"] == 2


@pytest.mark.parametrize("path", ["docs/flying.md", "configs/lidar_down.yaml", "configs/forward_and_down.yaml"])
def test_the_values_are_those_of_other_documents(path: str) -> None:
    name = Path(path).stem if path.startswith("configs") else "quad_pallet"
    values = of(name, Firmware("ardupilot"))
    text = (documented.ROOT / path).read_text(encoding="utf-8")
    stated = re.findall(r"\b([A-Z0-9]+_[A-Z0-9_]+)`? (-?[0-9.]*[0-9])", text)
    compared = {each: float(value) for each, value in stated if each in values}
    assert len(compared) >= 3
    assert compared == {each: values[each] for each in compared}


def test_a_serial_port_is_set_up_first() -> None:
    first = list(of("quad_pallet", Firmware("ardupilot"), port=4).items())[:3]
    assert first == [("SERIAL4_PROTOCOL", 2), ("SERIAL4_BAUD", 921), ("RNGFND1_TYPE", 10)]
    px4 = of("canted_pallet", Firmware("px4"))
    assert list(px4.items())[:3] == [("MAV_1_CONFIG", 102), ("MAV_1_MODE", 2), ("SER_TEL2_BAUD", 921600)]


@pytest.mark.parametrize(
    ("name", "is_named"), [("proximity", True), ("forward_and_down", True), ("quad_pallet", False)]
)
def test_what_the_pilot_has_to_choose_is_named(name: str, is_named: bool) -> None:
    """Of PX4's collision prevention: no value follows from the airframe, and without one it is off."""
    airframe = load_airframe(CONFIGS / f"{name}.yaml")
    assert ("CP_DIST" in "".join(remarks(airframe, Firmware("px4")))) is is_named
    assert "CP_DIST" not in "".join(remarks(airframe, Firmware("ardupilot")))


@pytest.mark.parametrize(
    ("firmware", "names"),
    [
        (Firmware("ardupilot"), ["EK3_RNG_M_NSE", " WP_RFND_USE", "SURFTRAK_MODE"]),
        (Firmware("ardupilot", centimetres=True), ["EK3_RNG_M_NSE", "WPNAV_RFND_USE", "SURFTRAK_MODE"]),
        (Firmware("ardupilot", "rover"), ["EK3_RNG_M_NSE"]),
        (Firmware("px4"), ["EKF2_RNG_NOISE", "MPC_ALT_MODE"]),
    ],
)
def test_what_becomes_of_the_stream_is_named(firmware: Firmware, names: list[str]) -> None:
    text = " ".join(remarks(load_airframe(CONFIGS / "quad_pallet.yaml"), firmware))
    assert "No autopilot reads the covariance" in text
    every = ["EK3_RNG_M_NSE", " WP_RFND_USE", "WPNAV_RFND_USE", "SURFTRAK_MODE", "EKF2_RNG_NOISE", "MPC_ALT_MODE"]
    assert [name for name in every if name in text] == names
    outward = remarks(load_airframe(CONFIGS / "proximity.yaml"), firmware)
    assert not any(name in " ".join(outward) for name in every)


def test_the_distance_on_the_ground_is_that_of_the_airframe_file(tmp_path: Path) -> None:
    path = write_airframe(tmp_path, "loopback", ("send:\n", "send:\n  standing_m: 0.34\n"))
    for firmware, name, value in (
        (Firmware("ardupilot"), "RNGFND1_GNDCLR", 0.34),
        (Firmware("ardupilot", centimetres=True), "RNGFND1_GNDCLEAR", 34),
        (Firmware("px4"), "EKF2_MIN_RNG", 0.34),
    ):
        (found,) = [each for each in settings(load_airframe(path), firmware, 2) if each.name == name]
        assert (found.value, found.source) == (value, "send.standing_m")
        (default,) = [
            each for each in settings(load_airframe(CONFIGS / "loopback.yaml"), firmware, 2) if each.name == name
        ]
        assert default.value in (0.2, 20)
        assert "commission measures it" in default.source


def test_for_a_bridge_that_sends_nothing_the_autopilot_waits_for_nothing(tmp_path: Path) -> None:
    airframe = load_airframe(write_airframe(tmp_path, "quad_pallet", ("send:\n", "send:\n  nothing: true\n")))
    for firmware, names in (
        (Firmware("ardupilot"), ["SERIAL2_PROTOCOL", "SERIAL2_BAUD"]),
        (Firmware("px4"), ["MAV_1_CONFIG", "MAV_1_MODE", "SER_TEL2_BAUD"]),
    ):
        assert [each.name for each in settings(airframe, firmware, 2)] == names
        said = remarks(airframe, firmware)
        assert any("sends nothing" in line for line in said)
        assert ("RNGFND1_TYPE is 10" in said[-1]) is (firmware.autopilot == "ardupilot")


@pytest.mark.parametrize("vehicle", get_args(Vehicle))
@pytest.mark.parametrize("name", ["quad_pallet", "proximity", "forward_and_down", "lidar_down"])
def test_other_vehicles(vehicle: Vehicle, name: str) -> None:
    values = of(name, Firmware("ardupilot", vehicle))
    assert ("RNGFND_LANDING" in values) is (vehicle == "plane" and name != "proximity")
    assert ("PRX1_TYPE" in values) is (vehicle != "plane" and name in ("proximity", "forward_and_down"))
    copter = of(name, Firmware("ardupilot"))
    assert {each: values[each] for each in values if each.startswith("RNGFND1")} == {
        each: copter[each] for each in copter if each.startswith("RNGFND1")
    }


def test_the_file_is_read_by_pymavlink(tmp_path: Path) -> None:
    done = params(tmp_path, str(CONFIGS / "quad_pallet.yaml"), "--out", "range.parm", "--before-4.7")
    assert done.returncode == 0, done.stderr
    read = mavparm.MAVParmDict()
    assert done.stdout == "written: range.parm\n"
    assert read.load(str(tmp_path / "range.parm"))
    assert dict(read) == of("quad_pallet", Firmware("ardupilot", centimetres=True))
    text = (tmp_path / "range.parm").read_text()
    assert text.count("\n# ") >= len(read)


@pytest.mark.parametrize(
    ("fresh", "px4", "firmware"),
    [
        (FRESH, False, Firmware("ardupilot")),
        pytest.param(FRESH_BEFORE, False, Firmware("ardupilot", centimetres=True), marks=pytest.mark.slow),
        pytest.param(FRESH_PX4, True, Firmware("px4"), marks=pytest.mark.slow),
    ],
    ids=["4.7", "before 4.7", "PX4"],
)
def test_write_read_back_and_undo(fresh: dict[str, float], px4: bool, firmware: Firmware, tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    airframe = write_airframe(tmp_path, "loopback", ("autopilot: ardupilot", f"autopilot: {firmware.autopilot}"))

    def done(option: str, *arguments: str, answers: str = "", code: int = 0) -> "subprocess.CompletedProcess[str]":
        link = ("--link", f"udpout:127.0.0.1:{port}")
        ended = params(tmp_path, str(airframe), option, *arguments, *link, answers=answers * len(changed))
        assert ended.returncode == code, ended.stderr
        return ended

    wanted = of("loopback", firmware)
    changed = [name for name in wanted if wanted[name] != fresh[name]]
    with ParameterAutopilot(f"udpin:127.0.0.1:{port}", fresh, px4=px4) as autopilot:
        autopilot.lossy = 1
        compared = done("--compare", code=1).stdout
        assert [line.split(":")[0] for line in compared.splitlines()[1:]] == changed
        done("--write", answers="n\n")
        assert autopilot.set_names == []
        done("--write", answers="y\n")
        assert autopilot.set_names == changed
        assert autopilot.values == pytest.approx(wanted)
        done("--compare")
        (undo,) = tmp_path.glob("undo-*.parm")
        done("--restore", undo.name, answers="y\n")
        assert autopilot.values == pytest.approx(fresh)


def test_never_while_armed(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    arguments = (str(CONFIGS / "loopback.yaml"), "--write", "--link", f"udpout:127.0.0.1:{port}")
    with ParameterAutopilot(f"udpin:127.0.0.1:{port}", FRESH, armed=True) as autopilot:
        done = params(tmp_path, *arguments, answers="y\n" * 9)
        assert done.returncode == 3
        assert "armed" in done.stderr.splitlines()[-1]
        assert autopilot.set_names == []
        assert not [each for each in autopilot.received if each.get_type() == "PARAM_SET"]


def test_a_value_that_does_not_stay(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    arguments = (str(CONFIGS / "loopback.yaml"), "--write", "--link", f"udpout:127.0.0.1:{port}")
    with ParameterAutopilot(f"udpin:127.0.0.1:{port}", FRESH) as autopilot:
        autopilot.stubborn = {"RNGFND1_MIN"}
        done = params(tmp_path, *arguments, answers="y\n" * 9)
    assert done.returncode == 3
    assert "RNGFND1_MIN was set to 0.19, and reads back as 0.2" in done.stderr
    assert "Set so far: RNGFND1_TYPE" in done.stderr
    assert autopilot.set_names == ["RNGFND1_TYPE", "RNGFND1_ADDR"]


@pytest.mark.slow
def test_other_autopilots_and_none(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    arguments = (str(CONFIGS / "loopback.yaml"), "--compare", "--link", f"udpout:127.0.0.1:{port}")
    with ParameterAutopilot(f"udpin:127.0.0.1:{port}", FRESH_PX4, px4=True):
        done = params(tmp_path, *arguments)
    assert done.returncode == 3
    assert "the autopilot is PX4, and link.autopilot is ardupilot" in done.stderr
    with ParameterAutopilot(f"udpin:127.0.0.1:{port}", FRESH, kind=mavlink.MAV_TYPE_FIXED_WING):
        done = params(tmp_path, *arguments)
    assert "ArduPlane" in done.stdout
    assert "RNGFND_LANDING: not known by this autopilot; expected 1" in done.stdout
