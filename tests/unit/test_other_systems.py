"""Virtual flights and the laboratory import nothing that only Linux has, as far as that can be tried on Linux."""

import subprocess
import sys
from pathlib import Path

import pytest

LINUX_ONLY = ("fcntl", "termios", "pwd", "grp", "resource", "smbus2")
FIRST = f"import sys; sys.modules.update(dict.fromkeys({LINUX_ONLY}))\n"
"""A module that is None cannot be imported."""


def run(program: str, folder: Path) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-c", FIRST + program]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120.0)


def command(program: str, *arguments: str) -> str:
    package = program.replace("-", "_")
    return f"sys.argv = {[program, *arguments]}\nfrom {package}.cli import main\nmain()"


@pytest.mark.slow
@pytest.mark.parametrize(
    "program",
    [
        command("msp-sim", "fly", "flat", "--out", "flight"),
        command("msp-range", "check", "quad_pallet"),
        command("msp-range", "params", "quad_pallet", "--out", "range.parm"),
        command(
            "msp-lab", "collect", "configs/campaigns/table_4_1.yaml", "--simulate", "--out", "out", "--only", "base"
        ),
        command("msp-lab", "effects"),
        "from msp_sim import simulate_flight\n"
        "from msp_lab import find_gap\n"
        "simulate_flight('flat', recording='flight.mcap')\n"
        "find_gap('flight.mcap', until='compare')",
    ],
    ids=["fly", "check", "params", "collect", "effects", "python"],
)
def test_it_runs_without_what_only_linux_has(program: str, tmp_path: Path) -> None:
    (tmp_path / "configs").symlink_to(Path(__file__).parents[2] / "configs")
    done = run(program, tmp_path)
    assert done.returncode == 0, done.stderr


def test_the_block_blocks(tmp_path: Path) -> None:
    assert "import of fcntl halted" in run("import fcntl", tmp_path).stderr
