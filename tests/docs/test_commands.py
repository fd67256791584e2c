"""Commands of the documents exist with all their options, and each is run: here, or by the test that is named."""

import ast
import re
import shlex
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
import typer

from msp_lab.cli import app as msp_lab
from msp_lab.readings.vehicle import mounting_of
from msp_range.cli import app as msp_range
from msp_range.recording.reader import Recording
from msp_range.yaml_file import ConfigError
from msp_sim.cli import app as msp_sim
from tests.docs import how
from tests.docs.shown import DOCUMENTS, ROOT, blocks, commands, in_sentences, unseen

PROGRAMS: dict[str, Any] = {str(app.info.name): typer.main.get_command(app) for app in (msp_range, msp_sim, msp_lab)}
SHOWN = {command for path in DOCUMENTS for block in blocks(path) if block.script for command in commands(block.script)}


def problem(line: str) -> str | None:
    """What is wrong with a command of ours: no such command or option, or a value that is none; None: nothing."""
    line = re.sub(r" --format \w+", "", line, count=1)
    words = shlex.split(re.sub(r"\s*(\||>|&&|<<).*", "", line.replace("$seed", "1").replace("...", "")))
    program = PROGRAMS[Path(words[0]).name]
    if words[1] not in program.commands:
        return f"no command {words[1]}"
    command = program.commands[words[1]]
    options = {"--help", *(option for each in command.params for option in each.opts)}
    unknown = [word for word in words[2:] if word.startswith("--") and word.split("=")[0] not in options]
    return f"no option {unknown}" if unknown else None


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_commands_of_a_document_exist(path: Path) -> None:
    shown = [command for block in blocks(path) if block.script for command in commands(block.script)]
    ours = [re.sub(r"^(sudo |\.venv/bin/)", "", each) for each in [*shown, *in_sentences(path)]]
    for command in ours:
        if re.match(r"msp-(range|sim|lab) ", command):
            assert problem(re.sub(r"[][]", "", command)) is None, command
    assert [each for block in blocks(path) for each in unseen(block)] == [], "a command after what a command prints"


def test_a_command_that_does_not_exist_is_found() -> None:
    assert problem("msp-sim flie demo") == "no command flie"
    assert problem(".venv/bin/msp-sim fly demo --sped 2") == "no option ['--sped']"
    assert problem("msp-sim fly demo --speed 2") is None


def test_the_tables_name_what_is_shown_and_tests_that_exist() -> None:
    tables = [*how.AROUND, *how.INSTEAD, *how.ELSEWHERE]
    assert [key for key in tables if not any(how.found({key: "here"}, each) for each in SHOWN)] == []
    assert len({*tables}) == len(tables)
    for command, path in how.ELSEWHERE.items():
        assert command.removesuffix(" ...") in (ROOT / path).read_text(encoding="utf-8"), (
            f"{path} does not run {command}"
        )
    assert all(around.count("{}") == 1 for around in how.AROUND.values())
    assert {*how.ON_BUS, *how.PX4} <= {str(path.relative_to(ROOT)) for path in DOCUMENTS}


def test_make_has_every_target_that_is_shown() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    targets = [command.split()[1] for command in SHOWN if command.startswith("make ") and "px4_sitl" not in command]
    assert len(targets) > 5
    assert [each for each in targets if not re.search(rf"^{each}:", makefile, re.M)] == []


OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]+")


def options_in_texts(path: Path) -> set[str]:
    """Options that a module's texts name; its docstrings are for programmers."""
    source = path.read_text(encoding="utf-8")
    if OPTION.search(source) is None:
        return set()
    tree = ast.parse(source)
    docs = {ast.get_docstring(node, clean=False) for node in ast.walk(tree) if isinstance(node, DOCUMENTED)}
    texts = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str))
    return {found for text in texts if text not in docs for found in OPTION.findall(text)}


def options_of(*commands: Any) -> list[set[str]]:
    return [
        {option for each in command.params for option in (*each.opts, *each.secondary_opts)} for command in commands
    ]


DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
NO_OPTIONS = {"--help", "--before-", "--nthreads", "--nworkers", "--start", "--end", "--now", "--unit"}
NO_OPTIONS |= {"--no-pager", "--lines", "--output"}
NO_OPTIONS |= {"--quiet", "--disable-pip-version-check", "--no-cache-dir", "--no-deps", "--require-hashes"}
NO_OPTIONS |= {"--only-binary", "--find-links", "--requirement", "--priority"}
"""Options of every command, of programs of others (Dask, mcap, systemctl, journalctl, pip), and what only looks
like one; --unit is one of the page's process."""
INTAKE = ("import", "gap", "compare")
"""Commands that read measurements: a hint of what they share has to hold in each of them."""


def test_options_that_hints_name_exist() -> None:
    commands = [each for program in PROGRAMS.values() for each in (program, *program.commands.values())]
    known = set.union(*options_of(*commands)) | NO_OPTIONS
    unknown = {
        str(path.relative_to(ROOT)): found
        for folder in ("msp_range", "sim")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if (found := options_in_texts(path) - known)
    }
    assert unknown == {}


def test_options_that_hints_of_the_intake_name_exist_in_each_command_that_reads_measurements() -> None:
    """Of `--run-column` it is said by those only that have it."""
    shared = set.union(*(options_in_texts(path) for path in (ROOT / "sim/msp_lab/readings").glob("*.py")))
    for options in options_of(*(PROGRAMS["msp-lab"].commands[name] for name in INTAKE)):
        assert shared - {"--run-column"} <= options


def test_a_command_without_an_airframe_does_not_advise_to_name_one(tmp_path: Path) -> None:
    recording = SimpleNamespace(files={"other.yaml": ""}, path=tmp_path / "flight.mcap")
    with pytest.raises(ConfigError) as refused:
        mounting_of(cast(Recording, recording))
    assert str(refused.value) == f"{tmp_path}/flight.mcap: contains no airframe file"
