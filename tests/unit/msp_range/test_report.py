"""`msp-range report`: what is in the archive, what is not, and that no secret is."""

import errno
import os
import shutil
from pathlib import Path
from zipfile import ZipFile

import pytest

from msp_range import report
from msp_range.recording.reader import Recording
from release.stored import STORED
from tests.support.programs import run
from tests.support.shipped import write_airframe

KEY = "0f" * 32
JOURNAL = f"""#!/bin/sh
echo '2026-10-05T14:30:00+0000 raspberry msp-range[7]: web page  url=http://0.0.0.0:8642/?token=Zq-31x_9&page=1'
echo asked for $1 $2
echo 'key of signing.key is {KEY}'
"""


@pytest.fixture(autouse=True)
def _alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No bridge of this user is asked, and what is written goes into a folder of its own, as the service's is."""
    monkeypatch.setattr(report, "SERVICE_FOLDER", tmp_path / "service")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.chdir(tmp_path)


def texts(path: Path) -> dict[str, str]:
    """The files of an archive."""
    with ZipFile(path) as archive:
        return {name: archive.read(name).decode() for name in archive.namelist()}


def add_journalctl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """A journalctl that does what a script says."""
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/journalctl").write_text(script)
    (tmp_path / "bin/journalctl").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"), prepend=os.pathsep)


def test_a_vehicles_report_has_no_secret(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "flights"
    folder.mkdir()
    for name, content in (("old.mcap", "old"), ("new.mcap", "0123456789")):
        (folder / name).write_text(content)
    os.utime(folder / "old.mcap", (1, 1))
    add_journalctl(tmp_path, monkeypatch, JOURNAL)
    monkeypatch.setattr(report, "RECORDING_BYTES", 4)
    monkeypatch.setattr(report, "BEGINNING_BYTES", 1)
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
    assert "asked for --unit=msp-range --unit=msp-range-web" in files["journal.txt"]
    assert files["new.mcap"] == "0789"
    assert result.output.startswith(files["contents.txt"])
    assert "new.mcap: the last recording; 0.0 MB of its middle are left out: msp-range recover" in files["contents.txt"]
    assert "status: not in it: no bridge runs" in files["contents.txt"]
    assert "r.zip: there is a file already" in run("msp-range report", path, "--out", "r.zip", code=3).output


def test_without_any_part_there_is_still_a_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    run("msp-range report", tmp_path / "none.yaml")
    (made,) = tmp_path.glob("msp-range-report-*.zip")
    files = texts(made)
    assert set(files) == {"versions.txt", "doctor.txt", "contents.txt"}
    for part in ("airframe", "sensors"):
        assert f"{part}: not in it: {tmp_path}/none.yaml: no such file" in files["contents.txt"]
    assert "recording: not in it: there is none" in files["contents.txt"]
    assert "journal: not in it: [Errno 2] No such file or directory: 'journalctl'" in files["contents.txt"]


@pytest.mark.parametrize(
    ("script", "listed"),
    [
        ("echo a line; exit 3", "the last 5000 lines, where journalctl ended with exit code 3"),
        ("echo not allowed >&2; exit 3", "journal: not in it: journalctl: exit code 3: not allowed"),
        ("exit 0", "journal.txt: journal of the service and its page, the last 5000 lines,"),
    ],
)
def test_a_journal_that_fails_is_reported(
    script: str, listed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_journalctl(tmp_path, monkeypatch, f"#!/bin/sh\n{script}\n")
    run("msp-range report", tmp_path / "none.yaml", "--out", tmp_path / "r.zip")
    assert listed in texts(tmp_path / "r.zip")["contents.txt"]


def names(tmp_path: Path, airframe: Path) -> set[str]:
    """Files of the report of a vehicle."""
    run("msp-range report", airframe, "--out", tmp_path / "r.zip")
    return set(texts(tmp_path / "r.zip"))


def test_a_broken_airframe_file_does_not_lose_the_recording(tmp_path: Path) -> None:
    (tmp_path / "service/flights").mkdir(parents=True)
    (tmp_path / "service/flights/last.mcap").write_text("flight")
    (tmp_path / "broken.yaml").write_text("colour: red\n")
    assert "last.mcap" in names(tmp_path, tmp_path / "broken.yaml")


def test_a_relative_folder_may_be_the_services(tmp_path: Path) -> None:
    (tmp_path / "service/mine").mkdir(parents=True)
    (tmp_path / "service/mine/last.mcap").write_text("flight")
    path = write_airframe(tmp_path, "quad_pallet", ("/var/lib/msp-range", "mine"), ("bus: 1", "bus: 99"))
    assert "last.mcap" in names(tmp_path, path)


def test_the_end_of_a_large_recording_can_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flight = next(STORED.glob("*/flight.mcap"))
    (tmp_path / "service").mkdir()
    shutil.copy(flight, tmp_path / "service/flight.mcap")
    monkeypatch.setattr(report, "RECORDING_BYTES", 50_000)
    monkeypatch.setattr(report, "BEGINNING_BYTES", 20_000)
    run("msp-range report", tmp_path / "none.yaml", "--out", "r.zip")
    with ZipFile("r.zip") as archive:
        archive.extract("flight.mcap")
    assert Path("flight.mcap").stat().st_size == 50_000
    run("msp-range recover", "flight.mcap", "rest.mcap")
    rest, whole = list(Recording("rest.mcap")), list(Recording(flight))
    assert 0.2 < len(rest) / len(whole) < 0.8
    assert rest[-1] == whole[-1]


def test_a_journal_that_cannot_be_read_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add_journalctl(tmp_path, monkeypatch, "#!/bin/sh\necho 'No journal files were opened' >&2\nexit 1\n")
    result = run("msp-range report", tmp_path / "none.yaml")
    assert "journal: not in it: journalctl: exit code 1: No journal files were opened" in result.output


def test_a_full_disk_is_an_error_and_no_missing_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def writestr(self: ZipFile, name: str, content: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(ZipFile, "writestr", writestr)
    result = run("msp-range report", tmp_path / "none.yaml", "--out", "r.zip", code=3)
    assert "r.zip: cannot be written: No space left on device" in result.output
    assert not (tmp_path / "r.zip").exists()
