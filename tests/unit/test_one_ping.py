"""docs/one-ping.md names files, functions and classes; they are there under these names."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

DOCUMENT = Path("docs/one-ping.md")
TEXT = DOCUMENT.read_text(encoding="utf-8")
STEPS = [" ".join(each.split()) for each in re.findall(r"^\d+\. (.*?)(?=^\d+\. |^\S)", TEXT, re.M | re.S)]
ROWS = [line for line in TEXT.splitlines() if line.startswith("| where")]
NAME = re.compile(r"`((?:[A-Za-z_]\w*\.)*[A-Za-z_]\w*)`")


@cache
def names_of(path: Path) -> frozenset[str]:
    """Functions, classes, methods as Class.method, and constants of a file."""
    found = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            found |= {f"{node.name}.{each.name}" for each in node.body if isinstance(each, ast.FunctionDef)}
            found |= {each.name for each in node.body if isinstance(each, ast.FunctionDef)}
        if isinstance(node, ast.AnnAssign | ast.Assign):
            targets = [node.target] if isinstance(node, ast.AnnAssign) else node.targets
            found |= {each.id for each in targets if isinstance(each, ast.Name)}
    return frozenset(found)


def linked(text: str) -> list[Path]:
    return [DOCUMENT.parent / each for each in re.findall(r"\]\(([^)#]+)\)", text)]


@pytest.mark.parametrize("step", STEPS, ids=lambda step: step.split("]")[0].lstrip("["))
def test_what_a_step_names_is_in_its_file(step: str) -> None:
    path, *others = linked(step)
    head = step.split(". In: ")[0]
    for name in NAME.findall(head):
        assert any(name in names_of(each) for each in (path, *others)), f"{name} is not in {path}"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.split("|")[1].strip())
def test_what_a_row_names_is_in_one_of_its_files(row: str) -> None:
    files = linked(row)
    for name in NAME.findall(row.split("|")[2]):
        assert any(name in names_of(each) for each in files if each.suffix == ".py"), name


def test_other_names_are_those_of_the_code() -> None:
    """Methods that the text mentions in passing are those of a class in a file that the page links to."""
    known = {name for path in linked(TEXT) if path.suffix == ".py" for name in names_of(path)}
    prose = re.sub(r"(?m)^ {4}\S.*$", "", TEXT)
    for name in NAME.findall(prose):
        if "." in name and name.split(".")[0][:1].isupper():
            assert name in known, name
