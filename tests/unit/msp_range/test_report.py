"""`msp-range report`: what is in the archive, what is not, and that no secret is."""

import os
from pathlib import Path
from zipfile import ZipFile

import pytest

from msp_range import report
from tests.support.programs import run
from tests.support.shipped import write_airframe

KEY = "0f" * 32
JOURNAL = f"""#!/bin/sh
echo '2026-10-05T14:30:00+0000 raspberry msp-range[7]: web page  url=http://0.0.0.0:8642/?token=Zq-31x_9&page=1'
echo 'key of signing.key is {KEY}'
"""


@pytest.fixture(autouse=True)
def _alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No bridge of this user is asked, and what is written goes into a folder of its own."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.chdir(tmp_path)


def texts(path: Path) -> dict[str, str]:
    """The files of an archive."""
    with ZipFile(path) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}


def test_a_vehicles_report_has_no_secret(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "flights"
    folder.mkdir()
    for name, content in (("old.mcap", "old"), ("new.mcap", "0123456789")):
        (folder / name).write_text(content)
    os.utime(folder / "old.mcap", (1, 1))
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/journalctl").write_text(JOURNAL)
    (tmp_path / "bin/journalctl").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"), prepend=os.pathsep)
    monkeypatch.setattr(report, "RECORDING_BYTES", 4)
    path = write_airframe(
        tmp_path,
        "quad_pallet",
        ("link:", "link:\n  signing_key: '/etc/my own.key'"),
        ("/var/lib/msp-range", str(folder)),
        ("bus: 1", "bus: 99"),
    )
    result = run("msp-range report", path, "--out", "r.zip")
    files = texts(tmp_path / "r.zip")
    assert set(files) == {
        "airframe.yaml",
        "sensors/mb1242",
        "versions.txt",
        "journal.txt",
        "doctor.txt",
        "new.mcap",
        "contents.txt",
    }
    everything = "\n".join(files.values())
    for secret in (KEY, "Zq-31x_9", "own.key", "/etc/my"):
        assert secret not in everything
    assert "signing_key: (removed)" in files["airframe.yaml"]
    assert "?token=(removed)&page=1" in files["journal.txt"]
    assert "wrong    I2C interface: there is no /dev/i2c-99" in files["doctor.txt"]
    assert "pymavlink 2." in files["versions.txt"]
    assert files["new.mcap"] == "0123"
    assert result.output.startswith(files["contents.txt"])
    assert "new.mcap: the last recording; its last 0.0 MB are left out" in files["contents.txt"]
    assert "status: not in it: no bridge runs" in files["contents.txt"]
    assert "r.zip: there is a file already" in run("msp-range report", path, "--out", "r.zip", code=3).output


def test_without_any_part_there_is_still_a_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    run("msp-range report", tmp_path / "none.yaml")
    (made,) = tmp_path.glob("msp-range-report-*.zip")
    files = texts(made)
    assert set(files) == {"versions.txt", "doctor.txt", "contents.txt"}
    for part in ("airframe", "sensors", "recording"):
        assert f"{part}: not in it: {tmp_path}/none.yaml: no such file" in files["contents.txt"]
    assert "journal: not in it: [Errno 2] No such file or directory: 'journalctl'" in files["contents.txt"]
