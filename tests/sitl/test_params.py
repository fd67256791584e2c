"""`msp-range params` and `doctor` with real autopilots: what is set stays, counts after a restart, and is undone."""

import json
import subprocess
from pathlib import Path

import pytest

from msp_range.config import load_airframe
from msp_range.params.settings import Firmware, settings
from tests.sitl.arducopter import ArduCopter
from tests.sitl.autopilot import Autopilot, running
from tests.sitl.documented import ROOT
from tests.sitl.kinds import needs_arducopter, needs_px4
from tests.sitl.px4 import Px4
from tests.support.kernel_bus import Sonar, kernel_bus
from tests.support.service import COMMAND

pytestmark = pytest.mark.real_time
SAVED_S = 5.0
"""PX4 writes changed parameters to its disk some seconds later (parameters.cpp, param_autosave)."""


def airframe_of(autopilot: Autopilot, folder: Path) -> Path:
    """The loopback airframe for an autopilot's link."""
    text = (ROOT / "configs/loopback.yaml").read_text().replace("sensors/mb1242.yaml", "mb1242")
    text = text.replace("udpout:127.0.0.1:14550", autopilot.link)
    path = folder / "airframe.yaml"
    path.write_text(text.replace("autopilot: ardupilot", f"autopilot: {autopilot.kind}"))
    return path


def params(airframe: Path, *arguments: str, answers: str = "") -> "subprocess.CompletedProcess[str]":
    """Run the command next to the airframe file."""
    return subprocess.run(
        [COMMAND, "params", airframe, *arguments],
        cwd=airframe.parent,
        input=answers,
        capture_output=True,
        text=True,
        timeout=120.0,
    )


def doctor(airframe: Path) -> dict[str, tuple[str, str]]:
    """Verdict and text of each step, with sensors that see something 1 m away."""
    with kernel_bus([Sonar(0x70 + number, [100]) for number in range(4)]) as testbed:
        done = testbed.run([COMMAND, "doctor", airframe, "--json"], timeout_s=120.0)
    assert done.returncode in (0, 1), done.stderr
    return {each["step"]: (each["verdict"], each["text"]) for each in json.loads(done.stdout)["findings"]}


def set_compare_undo(autopilot: Autopilot, airframe: Path) -> None:
    """Write all, see them after a restart, and set the old values again."""
    loaded = load_airframe(airframe)
    names = {each.name for each in settings(loaded, Firmware(loaded.link.autopilot), 2)}
    compared = params(airframe, "--compare")
    assert compared.returncode == 1, compared.stderr
    changed = [line.split(":")[0] for line in compared.stdout.splitlines()[1:]]
    assert set(changed) <= names
    written = params(airframe, "--write", answers="y\n" * len(changed))
    assert written.returncode == 0, written.stderr
    assert f"{len(changed)} set" in written.stdout
    autopilot.wait(SAVED_S)
    autopilot.end()
    autopilot.start()
    again = params(airframe, "--compare")
    assert again.returncode == 0, again.stdout
    assert doctor(airframe)["parameters"][0] == "right"


def undo(airframe: Path) -> None:
    """Set the old values again."""
    file = min(airframe.parent.glob("undo-*.parm"))
    done = params(airframe, "--restore", file.name, answers="y\n" * 20)
    assert done.returncode == 0, done.stderr
    assert params(airframe, "--compare").returncode == 1


@needs_arducopter
def test_arducopter(tmp_path: Path) -> None:
    copter = ArduCopter(tmp_path)
    fresh = copter.COMMON | {"SERIAL1_PROTOCOL": 2}
    (tmp_path / "defaults.parm").write_text("".join(f"{name} {value}\n" for name, value in fresh.items()))
    airframe = airframe_of(copter, tmp_path)
    with running(copter):
        before = doctor(airframe)
        assert before["heartbeat"] == ("right", "system 1 is ArduPilot")
        assert before["parameters"][0] == "wrong"
        assert before["distances"][0] == "wrong"
        set_compare_undo(copter, airframe)
        assert doctor(airframe)["distances"] == ("right", "1.00 m was sent, and the autopilot has 1.00 m")
        # The address of a sensor on its own I2C: nothing before 4.8, from then on it rejects all distances.
        (tmp_path / "left.parm").write_text("RNGFND1_ADDR,112\n")
        assert params(airframe, "--restore", "left.parm", answers="y\n").returncode == 0
        found = doctor(airframe)
        assert found["parameters"][0] == found["distances"][0], found
        assert params(airframe, "--write", answers="y\n").returncode == 0
        copter.station.command_until_accepted("arming", 400, 1, 21196)
        refused = params(airframe, "--restore", max(tmp_path.glob("undo-*")).name, answers="y\n" * 20)
        assert refused.returncode == 3
        assert "the vehicle is armed" in refused.stderr
        copter.station.command_until_accepted("disarming", 400, 0, 21196)
        undo(airframe)


@needs_px4
def test_px4(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    px4 = Px4(tmp_path)
    command, environment = px4._command()
    fresh = {name: value for name, value in environment.items() if not name.startswith("PX4_PARAM_EKF2")}
    monkeypatch.setattr(px4, "_command", lambda: (command, fresh))
    airframe = airframe_of(px4, tmp_path)
    with running(px4):
        set_compare_undo(px4, airframe)
        found = doctor(airframe)
        assert found["heartbeat"] == ("right", "system 1 is PX4")
        assert found["distances"][0] == "right"
        undo(airframe)
