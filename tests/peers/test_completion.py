"""Completion as a user's shell does it: Debian's bash runs the function that --install-completion installs."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.support.service import COMMAND

COMPLETE = """
name=_${1//-/_}
eval "$(env ${name^^}_COMPLETE=source_bash $1)"
COMP_WORDS=($2)
COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
${name}_completion $1
printf '%s\\n' "${COMPREPLY[@]}"
"""


def completed(line: str, folder: Path) -> list[str]:
    """What bash inserts or lists; nothing: it goes on with the names of files, as `complete -o default` says."""
    environment = {**os.environ, "PATH": os.pathsep.join([str(COMMAND.parent), os.environ["PATH"]])}
    command = ["bash", "-c", COMPLETE, "bash", line.split()[0], line]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, env=environment, timeout=60.0)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("msp-range comm", ["commission"]),
        ("msp-range run --no", ["--no-record"]),
        ("msp-range run --log j", ["json"]),
        ("msp-range check qu", ["quad_pallet"]),
        ("msp-range check my", []),
        ("msp-sim fly rough", ["rough_grass"]),
        ("msp-sim fly demo --model mb1242_i", ["mb1242_in_flight"]),
        ("msp-lab collect after", ["afternoon"]),
    ],
)
def test_bash_completes(line: str, expected: list[str], tmp_path: Path) -> None:
    (tmp_path / "my_airframe.yaml").touch()
    assert completed(line, tmp_path) == expected


def test_a_file_hides_the_names_that_begin_like_it(tmp_path: Path) -> None:
    (tmp_path / "quad_of_mine.yaml").touch()
    assert completed("msp-range check qu", tmp_path) == []
