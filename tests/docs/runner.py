"""Runs what a document shows in a folder like a clone of this repository."""

import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

from tests.docs import how
from tests.docs.shown import ROOT, blocks, commands

LINKED = ("configs", "msp_range", "sim", "tests", "bin", "systemd")
COPIED = ("docs", "benchmarks", "Makefile", "pyproject.toml", "README.md", "install.sh")
_BROKEN = re.compile(r"\\\n\s*")


def clone(folder: Path) -> Path:
    """A folder like a clone with its environment, in which commands may write."""
    place = folder / "clone"
    place.mkdir(parents=True)
    for name in LINKED:
        (place / name).symlink_to(ROOT / name)
    for name in COPIED:
        source = ROOT / name
        (shutil.copytree if source.is_dir() else shutil.copy2)(source, place / name)
    environment = place / ".venv"
    environment.mkdir()
    for each in Path(sys.prefix).iterdir():
        (environment / each.name).symlink_to(each)
    for name in (".installed", ".installed-test"):
        (environment / name).unlink(missing_ok=True)
        (environment / name).touch()
    data = Path(os.environ.get("MSP_RANGE_DATA", ROOT / "../shared/data")).resolve()
    (folder / "shared").mkdir()
    (folder / "shared/data").symlink_to(data)
    return place


def environment(place: Path, flown: Path | None = None) -> dict[str, str]:
    """What commands of a document see, their programs first."""
    path = f"{place}/.venv/bin{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, "HOME": str(place), "FLOWN": str(flown), "MPLBACKEND": "agg"}


def scripts(document: Path) -> list[str]:
    """What is run of a document, a script for each of its blocks: in its order, without what is run elsewhere."""
    found = []
    for block in blocks(document):
        if block.is_python:
            found.append(f"python - <<'DOCUMENT'\n{block.text}\nDOCUMENT")
        elif block.script is not None and (script := _as_run(block.script)):
            found.append(script)
    return found


def _as_run(script: str) -> str:
    lines = _BROKEN.sub("", script).splitlines()
    kept = []
    for line in lines:
        (command,) = commands(line) or [""]
        if how.found(how.ELSEWHERE | how.NOT_RUN, command) is None:
            kept.append(how.found(how.INSTEAD, command) or line)
    return "\n".join(kept)


def fly_four(folder: Path) -> Path:
    """Fly, and write recordings and tables."""
    place = clone(folder)
    script = """mkdir -p ../made/flights
        for i in 1 2 3 4; do
          msp-sim fly configs/scenarios/terrain.yaml --seed $i --out $i
          msp-range export $i/flight.mcap ../made/flights/$i.csv
          mv $i/flight.mcap ../made/$i.mcap
        done"""
    subprocess.run(["bash", "-ec", script], cwd=place, env=environment(place), check=True, capture_output=True)
    return folder / "made"


def run(script: str, place: Path, surroundings: dict[str, str], limit_s: float) -> tuple[str, int]:
    """Run a script in a folder; its output and exit code. What it has started ends with it."""
    with subprocess.Popen(
        ["bash", "-ec", script],
        cwd=place,
        env=surroundings,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as program:
        try:
            return program.communicate(timeout=limit_s)[0], program.wait()
        finally:
            with suppress(ProcessLookupError):
                os.killpg(program.pid, signal.SIGKILL)
