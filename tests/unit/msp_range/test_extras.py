"""Optional packages on a vehicle: what is installed of which lock file, and what refuses."""

import os
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from msp_range.config import load_airframe
from msp_range.extras import missing
from msp_range.yaml_file import ConfigError
from tests.support.programs import run
from tests.support.shipped import CONFIGS


@pytest.fixture
def vehicle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The environment of a vehicle without filterpy, whose Python writes its arguments into a file."""
    prefix = tmp_path / "msp-range/venv"
    prefix.mkdir(parents=True)
    (prefix / "requirements-kalman.lock").touch()
    (prefix / "python").write_text(f'#!/bin/sh\necho "$@" >{prefix}/pip\numask >>{prefix}/pip\n')
    (prefix / "python").chmod(0o755)
    monkeypatch.setattr(sys, "prefix", str(prefix))
    monkeypatch.setattr(sys, "executable", str(prefix / "python"))
    monkeypatch.setitem(sys.modules, "filterpy", None)
    return prefix


@pytest.fixture
def airframe(tmp_path: Path) -> Path:
    """An airframe file that needs the extra kalman."""
    content: dict[str, Any] = yaml.safe_load((CONFIGS / "forward_and_down.yaml").read_text())
    for sensor in content["sensors"]:
        sensor["model"] = "mb1242"
    path = tmp_path / "airframe.yaml"
    path.write_text(yaml.safe_dump(content | {"filters": [{"filter": "kalman"}]}))
    return path


def test_what_an_airframe_needs_is_installed_by_the_command_that_check_names(vehicle: Path, airframe: Path) -> None:
    with pytest.raises(ConfigError, match="filters: kalman requires filterpy: sudo msp-range extras kalman; or use "):
        load_airframe(airframe)
    assert run("msp-range extras --airframe", airframe).output == "kalman: installed\n"
    command, umask = (vehicle / "pip").read_text().splitlines()
    assert command.startswith("-m pip ")
    for option in ("--require-hashes", "--only-binary=:all:", "--no-deps"):
        assert option in command
    assert command.endswith(f"--find-links={vehicle.parent}/wheels --requirement={vehicle}/requirements-kalman.lock")
    assert umask == "0022"  # the service's user reads it
    (vehicle / "pip").unlink()
    run("msp-range extras kalman")
    assert (vehicle / "pip").exists()


def test_nothing_is_installed_that_nobody_needs(vehicle: Path) -> None:
    shipped = CONFIGS / "quad_pallet.yaml"
    assert run("msp-range extras --airframe", shipped).output == f"{shipped} needs no packages that are not there\n"
    assert not (vehicle / "pip").exists()


@pytest.mark.parametrize(
    ("name", "expected"), [("lab", "found lab; those of this installation are kalman"), ("no", "found no; those of")]
)
def test_what_has_no_lock_file_is_refused(vehicle: Path, name: str, expected: str) -> None:
    assert expected in run("msp-range extras", name, code=3).stderr


def test_pip_that_fails_and_a_user_who_may_not(vehicle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (vehicle / "python").write_text("#!/bin/sh\nexit 1\n")
    assert "it needs a network" in run("msp-range extras kalman", code=3).stderr
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert f"{vehicle}: cannot be written; with sudo" in run("msp-range extras kalman", code=3).stderr


def test_a_clone_has_pips_words(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "filterpy", None)
    assert missing("kalman") == f"filterpy: {sys.executable} -m pip install 'msp-range[kalman]'"
    assert "only install.sh and the Debian package have any" in run("msp-range extras kalman", code=3).stderr
