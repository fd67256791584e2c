"""What `make` installs into .venv for which target, and with what: seen by a uv and a Python that only write down."""

import re
import shutil
import subprocess
import tomllib
from collections.abc import Sequence
from pathlib import Path

import pytest

from msp_range.extras import EXTRAS
from tests.support.shipped import CONFIGS

ROOT = CONFIGS.parent
WRITES_DOWN = '#!/bin/sh\necho "${{0##*/}} $*" >> calls\nexit {}\n'


class Clone:
    """A folder with the Makefile, in whose .venv nothing is installed, and a PATH with or without uv."""

    def __init__(self, folder: Path, uv_exit: int | None) -> None:
        self.folder, self.path = folder, folder / "bin"
        for name in ("Makefile", "pyproject.toml"):
            shutil.copy2(ROOT / name, folder)
        self.path.mkdir()
        for name in ("sh", "make", "touch"):
            (self.path / name).symlink_to(shutil.which(name) or name)
        self.write(folder / ".venv/bin/python", 0)
        if uv_exit is not None:
            self.write(self.path / "uv", uv_exit)

    @staticmethod
    def write(program: Path, code: int) -> None:
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text(WRITES_DOWN.format(code), encoding="utf-8")
        program.chmod(0o755)

    def make(self, stamp: str) -> str:
        command = ["make", f".venv/.installed{stamp}"]
        environment = {"PATH": str(self.path)}
        done = subprocess.run(command, cwd=self.folder, env=environment, check=True, capture_output=True, text=True)
        return done.stdout

    def calls(self) -> list[tuple[str, str]]:
        """Installations: the program, and the extras."""
        calls = self.folder / "calls"
        lines = calls.read_text(encoding="utf-8").splitlines() if calls.exists() else []
        found = (re.fullmatch(r"(uv|python -m) pip install .*'?\.\[(.*)\]'?", line) for line in lines)
        return [(each[1].split()[0], each[2]) for each in found if each is not None]


@pytest.mark.parametrize(
    ("uv_exit", "programs"), [(0, ["uv"]), (1, ["uv", "python"]), (None, ["python"])], ids=["uv", "uv fails", "pip"]
)
def test_uv_installs_where_it_is_and_pip_otherwise(
    uv_exit: int | None, programs: Sequence[str], tmp_path: Path
) -> None:
    clone = Clone(tmp_path, uv_exit)
    assert re.fullmatch(r"Installing .* into \.venv, in silence: .* minute.*\.\n", clone.make("-demo"))
    assert clone.calls() == [(program, "sim,kalman") for program in programs]


def test_the_demo_is_installed_once_and_a_larger_installation_holds_it(tmp_path: Path) -> None:
    clone = Clone(tmp_path, 0)
    for stamp in ("-demo", "-demo", "-test", "", "-demo"):
        clone.make(stamp)
    demo, tests = (set(extras.split(",")) for _, extras in clone.calls())
    packaging = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert demo < set(EXTRAS) < tests == set(packaging["optional-dependencies"])


def test_users_have_every_extra_that_a_command_asks_for(tmp_path: Path) -> None:
    clone = Clone(tmp_path, 0)
    clone.make("")
    ((_, extras),) = clone.calls()
    assert set(extras.split(",")) == set(EXTRAS)
