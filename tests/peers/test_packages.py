"""Wheel and sdist as users install them: by uv, and by pipx, which calls pip. They fly where nothing is."""

import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from tests.support.shipped import ROOT

BIN = Path(sys.executable).parent


def run(*command: str | Path, cwd: Path, **variables: str) -> str:
    done = subprocess.run(
        [str(each) for each in command],
        cwd=cwd,
        env={**os.environ, **variables},
        capture_output=True,
        text=True,
        timeout=300.0,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with both, made by `python -m build` from what git has: the wheel from the sdist."""
    folder = tmp_path_factory.mktemp("built")
    tree = run("git", "ls-files", cwd=ROOT).splitlines()
    for name in tree:
        target = folder / "source" / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if (ROOT / name).is_symlink():
            target.symlink_to(os.readlink(ROOT / name))
        else:
            target.write_bytes((ROOT / name).read_bytes())
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder / "dist", cwd=folder / "source")
    return folder / "dist"


def wheel_of(built: Path) -> Path:
    (wheel,) = built.glob("*.whl")
    return wheel


def flies(commands: Path, folder: Path) -> None:
    """The command flies by the name of a scenario, in an empty folder."""
    empty = folder / "empty"
    empty.mkdir()
    run(commands / "msp-sim", "fly", "demo", "--out", "flight", cwd=empty, PYTHONPATH="")
    assert {"summary.json", "flight.png", "flight.mcap"} <= {each.name for each in (empty / "flight").iterdir()}


@pytest.mark.slow
def test_the_sdist_has_what_the_service_is_installed_from(built: Path) -> None:
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as file:
        held = {name.partition("/")[2] for name in file.getnames()}
    assert {
        "install.sh",
        "requirements-kalman.lock",
        "systemd/msp-range.service",
        "docs/installing.md",
        "configs/quad_pallet.yaml",
    } <= held
    assert "msp_range/configs/quad_pallet.yaml" in held


@pytest.mark.slow
def test_uv_tool_install(built: Path, tmp_path: Path) -> None:
    folders = {"UV_TOOL_DIR": str(tmp_path / "tools"), "UV_TOOL_BIN_DIR": str(tmp_path / "bin")}
    requirement = f"msp-range[sim] @ {wheel_of(built).as_uri()}"
    run(BIN / "uv", "tool", "install", "--quiet", "--python", sys.executable, requirement, cwd=tmp_path, **folders)
    flies(tmp_path / "bin", tmp_path)


@pytest.mark.slow
def test_pipx(built: Path, tmp_path: Path) -> None:
    folders = {"PIPX_HOME": str(tmp_path / "pipx"), "PIPX_BIN_DIR": str(tmp_path / "bin")}
    run(BIN / "pipx", "install", "--quiet", f"{wheel_of(built)}[sim]", cwd=tmp_path, **folders)
    assert run(tmp_path / "bin/msp-range", "--version", cwd=tmp_path).startswith("msp-range ")
    flies(tmp_path / "bin", tmp_path)
