"""`make release` makes the same bytes of the same commit twice: with another umask, time zone, folder and time."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from release import ROOT


def make(out: Path, umask: int, **variables: str) -> dict[str, bytes]:
    command = [sys.executable, "-m", "release", "--out", str(out), "--machine", "aarch64", "--no-image"]
    environment = {**os.environ, **variables}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, umask=umask)
    assert done.returncode == 0, done.stdout + done.stderr
    return {path.name: path.read_bytes() for path in out.iterdir()}


@pytest.mark.slow
def test_a_commit_gives_the_same_bytes_twice(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    first = make(tmp_path / "one", 0o077, TZ="UTC", PYTHONHASHSEED="1")
    second = make(tmp_path / "two", 0o002, TZ="Asia/Kolkata", PYTHONHASHSEED="2", TMPDIR=str(tmp_path / "other"))
    assert sorted(name.rpartition(".")[2] for name in first) == ["SHA256SUMS", "deb", "gz", "json", "whl"]
    assert [name for name in first if first[name] != second.get(name)] == []
