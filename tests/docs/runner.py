"""Runs what a document shows in a folder like a clone of this repository."""

import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile

from tests.docs import how
from tests.docs.shown import DOCUMENTS, ROOT, blocks, commands

LINKED = ("msp_range", "sim", "tests", "bin", "systemd")
COPIED = ("configs", "docs", "evaluation", "Makefile", "pyproject.toml", "README.md", "install.sh")
BEFORE = Path(__file__).parent / "before"
ENDED = "trap 'echo \"--- ended at: $BASH_COMMAND\"' ERR"
NEXT_BLOCK = "--- next block"
_BROKEN = re.compile(r"\\\n\s*")


def clone(folder: Path, smaller: how.Changes = how.SMALLER) -> Path:
    """A folder like a clone with its environment, in which commands may write; some of its files are smaller."""
    place = folder / "clone"
    place.mkdir(parents=True)
    for name in LINKED:
        (place / name).symlink_to(ROOT / name)
    for name in COPIED:
        source = ROOT / name
        (shutil.copytree if source.is_dir() else shutil.copy2)(source, place / name)
    for name, changes in smaller.items():
        text = (place / name).read_text(encoding="utf-8")
        for pattern, replacement in changes:
            text, count = re.subn(pattern, replacement, text)
            assert count, f"{name}: nothing like {pattern}"
        (place / name).write_text(text, encoding="utf-8")
    if (ROOT / ".venv-mavproxy").exists():
        (place / ".venv-mavproxy").symlink_to(ROOT / ".venv-mavproxy")
    environment = place / ".venv"
    environment.mkdir()
    for each in Path(sys.prefix).iterdir():
        (environment / each.name).symlink_to(each)
    for name in (".installed-demo", ".installed", ".installed-test"):
        (environment / name).unlink(missing_ok=True)
        (environment / name).touch()
    data = Path(os.environ.get("MSP_RANGE_DATA", ROOT / "../shared/data")).resolve()
    (folder / "shared").mkdir()
    (folder / "shared/data").symlink_to(data)
    return place


def environment(place: Path, flown: Path | None = None) -> dict[str, str]:
    """What commands of a document see, their programs first."""
    path = f"{place}/.venv/bin{os.pathsep}{os.environ['PATH']}"
    here = {"PATH": path, "HOME": str(place), "FLOWN": str(flown), "MPLBACKEND": "agg"}
    return {**os.environ, **here, **how.MAKE}


def before(document: Path) -> str:
    """What is there before a document's first command, as a script: what its text tells the reader to have."""
    name = str(document.relative_to(ROOT)).removeprefix("docs/").removesuffix(".md").replace("/", "-")
    path = BEFORE / f"{name}.sh"
    return path.read_text(encoding="utf-8") if path.exists() else ""


def script_of(document: Path) -> str:
    """What is run of a document, as one script, without what is run elsewhere; '' if nothing."""
    parts = []
    for block in blocks(document):
        if block.is_python:
            parts.append(f"python - <<'DOCUMENT'\n{block.text}\nDOCUMENT")
        elif block.script is not None:
            parts.append(_as_run(block.script, document))
    return f"\necho {NEXT_BLOCK}\n".join(filter(None, parts))


@cache
def _make_commands() -> dict[str, Path]:
    """The first document that shows a command of make: it is run there alone, as it needs nothing from before it."""
    shown = ((command, path) for path in DOCUMENTS for each in blocks(path) for command in commands(each.script or ""))
    return {command: path for command, path in reversed([*shown]) if command.startswith("make ")}


def _as_run(script: str, document: Path) -> str:
    kept = []
    for line in _BROKEN.sub("", script).splitlines():
        (command,) = commands(line) or [""]
        if how.found(how.ELSEWHERE, command) is not None or _make_commands().get(command, document) != document:
            continue
        around = how.found(how.AROUND, command)
        kept.append(around.replace("{}", command) if around else how.found(how.INSTEAD, command) or line)
    return "\n".join(kept)


def fly_four(folder: Path) -> Path:
    """Fly, and write recordings and tables."""
    place = clone(folder)
    script = """mkdir -p made/flights
        for i in 1 2 3 4; do
          msp-sim fly configs/scenarios/terrain.yaml --seed $i --out $i
          msp-range export $i/flight.mcap made/flights/$i.csv
          mv $i/flight.mcap made/$i.mcap
        done
        mv made .."""
    subprocess.run(["bash", "-ec", script], cwd=place, env=environment(place), check=True, capture_output=True)
    return folder / "made"


def run(script: str, place: Path, surroundings: dict[str, str], limit_s: float, wrapper: Sequence[str] = ()) -> str:
    """Run a script in a folder and return its output; AssertionError with it if it fails.

    What it has started ends with it.
    """
    with TemporaryFile("w+") as output:
        with subprocess.Popen(
            [*wrapper, "bash", "-ec", f"{ENDED}\n{script}"],
            cwd=place,
            env=surroundings,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        ) as program:
            try:
                code = program.wait(limit_s)
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(program.pid, signal.SIGKILL)
        output.seek(0)
        printed = output.read()
    assert code == 0, printed[-4000:]
    assert "Traceback (most recent call last)" not in printed, printed[-4000:]
    return printed
