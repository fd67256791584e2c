"""MAVLink signing with a real ArduPilot that keeps the key: signed distances are used, unsigned ones are dropped."""

import subprocess
from pathlib import Path

import pytest

from tests.sitl.arducopter import ArduCopter
from tests.sitl.autopilot import running
from tests.sitl.kinds import needs_arducopter
from tests.sitl.test_params import airframe_of, doctor
from tests.support.service import COMMAND

pytestmark = pytest.mark.real_time
RECEIVED = ("right", "1.00 m was sent, and the autopilot has 1.00 m")


def sign(airframe: Path, *options: str) -> "subprocess.CompletedProcess[str]":
    """Run msp-range in the folder of the airframe file."""
    return subprocess.run(
        [COMMAND, "sign", airframe, *options], cwd=airframe.parent, capture_output=True, text=True, timeout=60.0
    )


@needs_arducopter
def test_arducopter_uses_signed_distances_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "state"))
    copter = ArduCopter(tmp_path)
    unsigned = airframe_of(copter, tmp_path)
    signed = tmp_path / "signed.yaml"
    signed.write_text(unsigned.read_text().replace("link:\n", "link:\n  signing_key: signing.key\n"))
    monkeypatch.chdir(tmp_path)
    with running(copter):
        assert doctor(unsigned)["distances"] == RECEIVED
        given = sign(signed)
        assert given.returncode == 0, given.stderr
        key = (tmp_path / "signing.key").read_text().strip()
        assert key not in given.stdout + given.stderr
        assert doctor(signed)["distances"] == RECEIVED

        # The key is in the autopilot's storage, so it counts after a restart, where unsigned messages are dropped.
        copter.end()
        copter.start()
        found = doctor(unsigned)
        assert found["signing"][0] == "wrong"
        assert found.get("distances", ("wrong", ""))[0] == "wrong"
        assert doctor(signed)["distances"] == RECEIVED

        removed = sign(signed, "--remove")
        assert removed.returncode == 0, removed.stderr
        assert doctor(unsigned)["distances"] == RECEIVED
