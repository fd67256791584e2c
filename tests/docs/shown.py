"""What documents show: scripts of commands, Python blocks, and commands in the middle of a sentence.

A block is indented by four spaces or more, or fenced. One that begins with a program's name is a script for a shell, up
to its first empty line outside of a here-document: what follows is what it prints.
"""

import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PROGRAMS = (
    r"(?:msp-(?:range|sim|lab)|make|sudo|git|pip3?|pipx|uv|python3?|\.venv/bin/[-\w]+|ssh|journalctl|head|cat|mkdir|cp|cd|"
    r"export|for|sed|dask|sim_vehicle\.py|arducopter|systemctl|sphinx-build)"
)
_SCRIPT = re.compile(rf"(?:[A-Z_]+=\S+ )?{PROGRAMS}(?= |$)")
_HERE = re.compile(r"<<'(\w+)'")
_OURS = re.compile(r"^(?:\.venv/bin/)?msp-(?:range|sim|lab) [a-z]", re.M)


class Block(NamedTuple):
    """A block of a document: where it begins, its language if it is fenced, and its text."""

    line: int
    language: str
    text: str

    @property
    def is_python(self) -> bool:
        """Whether it is a Python program."""
        return self.language == "python"

    @property
    def script(self) -> str | None:
        """Its commands; None if it is no script."""
        if self.language not in ("", "sh", "bash", "console") or _SCRIPT.match(self.text) is None:
            return None
        kept: list[str] = []
        end = None
        for line in self.text.splitlines():
            if end is None and not line.strip():
                break
            kept.append(line)
            if end is None and (here := _HERE.search(line)):
                end = here[1]
            elif line == end:
                end = None
        return "\n".join(kept)


def blocks(path: Path) -> Iterator[Block]:
    """All blocks of a document."""
    lines = path.read_text(encoding="utf-8").splitlines()
    i = 0
    while i < len(lines):
        start = i
        if lines[i].startswith("```"):
            i = lines.index("```", i + 1)
            yield Block(start + 1, lines[start][3:].strip(), "\n".join(lines[start + 1 : i]))
        elif lines[i].startswith("    ") and (i == 0 or not lines[i - 1].strip()):
            while i + 1 < len(lines) and (lines[i + 1].startswith("    ") or not lines[i + 1].strip()):
                i += 1
            text = textwrap.dedent("\n".join(lines[start : i + 1])).rstrip()
            yield Block(start + 1, "", text)
        i += 1


def commands(script: str) -> list[str]:
    """The commands of a script, one each: without comments, here-documents and broken lines."""
    found: list[str] = []
    end = None
    for line in re.sub(r"\\\n\s*", "", script).splitlines():
        if end is not None:
            end = None if line == end else end
            continue
        command = re.sub(r"\s+# .*$", "", line).strip()
        if command and not command.startswith("#"):
            found.append(command)
        if here := _HERE.search(line):
            end = here[1]
    return found


def programs_in(script: str) -> int:
    """How many Python programs a script holds as here-documents."""
    return len(re.findall(r"python -? ?<<'", script))


def unseen(block: Block) -> list[str]:
    """Lines with a command of ours in a block that is no script, or in what a script is said to print."""
    rest = block.text.removeprefix(block.script or "")
    return [] if block.is_python else _OURS.findall(rest)


def in_sentences(path: Path) -> list[str]:
    """Commands of ours that stand in the middle of a sentence or table, in backquotes."""
    text = path.read_text(encoding="utf-8")
    prose = re.sub(r"(?m)^    .*$", "", text)
    spans = re.findall(r"`([^`]+)`", prose)
    ours = [" ".join(span.split()).removeprefix("sudo ").removeprefix(".venv/bin/") for span in spans]
    return [span for span in ours if re.match(r"msp-(range|sim|lab) [a-z]", span)]


def shown(command: str) -> str:
    """A command for a test that runs exactly what a document shows; AssertionError if none does."""
    scripts = [block.script for path in DOCUMENTS for block in blocks(path) if block.script]
    assert any(command in commands(script) for script in scripts), f"no document shows {command}"
    return command
