"""install.sh and the unit file as far as they can be checked without a systemd of one's own (`make test-install`)."""

import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.service import missing
from tests.support.shipped import ROOT

MAX_EXPOSURE = 2.0
"""0 is a service that can do nothing, 10 one that can do all."""


def install(*arguments: str) -> "subprocess.CompletedProcess[str]":
    """Run install.sh without a terminal to ask on."""
    return subprocess.run(
        [ROOT / "install.sh", *arguments], stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=60.0
    )


@pytest.mark.parametrize("name", ["msp-range", "msp-range-web"])
def test_the_unit_is_hardened(name: str) -> None:
    if shutil.which("systemd-analyze") is None:
        missing("no systemd-analyze: apt-get install systemd")
    unit = ROOT / "systemd" / f"{name}.service"
    threshold = f"--threshold={round(10 * MAX_EXPOSURE)}"
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=yes", "--no-pager", threshold, unit], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout.splitlines()[-1]
    assert f"{name}.service" in done.stdout.splitlines()[-1]


@pytest.mark.slow
def test_a_dry_run_names_what_it_would_do(tmp_path: Path) -> None:
    done = install("--dry-run", "--airframe", "quad_pallet")
    assert done.returncode == 0, done.stderr
    for what in (
        "useradd",
        "/etc/systemd/system/msp-range.service",
        "msp-range-web.service",
        "70-msp-range.rules",
        "sensors/mb1242.yaml",
    ):
        assert what in done.stdout
    assert not Path("/opt/msp-range").exists()
    own = tmp_path / "own.yaml"
    own.touch()
    assert str(own) not in install("--dry-run", "--airframe", "loopback").stdout
    assert install("--dry-run", "--airframe", str(own)).returncode == 0
    assert (
        "/systemd/msp-range-web.service /etc/systemd"
        not in install("--dry-run", "--airframe", "loopback", "--no-web").stdout
    )


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (("--whatever",), 2, "unknown option --whatever"),
        (("--purge", "--dry-run"), 2, "--purge goes with --uninstall"),
        (("--uninstall", "--upgrade", "--dry-run"), 2, "--uninstall goes with"),
        (("--no-web", "--web-on-network", "--dry-run"), 2, "give one of them"),
        (("--uninstall", "--web-on-network", "--dry-run"), 2, "--uninstall goes with"),
        (("--dry-run",), 2, "quad_pallet"),
        (("--dry-run", "--airframe"), 2, "expected a name or a file"),
        (("--dry-run", "--airframe", "octo"), 2, "neither a file nor an example"),
        (("--dry-run", "--upgrade"), 3, "nothing is installed"),
    ],
)
def test_a_wrong_command_line(arguments: tuple[str, ...], code: int, text: str) -> None:
    done = install(*arguments)
    assert (done.returncode, text in done.stderr.splitlines()[-1]) == (code, True), done.stderr
