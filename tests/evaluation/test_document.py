"""Documents: tables that `make bench` and `make blind` write, the list of all pages, and the length of lines."""

import re
from pathlib import Path

import pytest

from evaluation.benchmarks.command import as_markdown
from evaluation.document import FIGURES, replace_section


def test_a_section_is_replaced_and_the_rest_stays(tmp_path: Path) -> None:
    path = tmp_path / "figures.md"
    path.write_text("before\n<!-- begin bench -->\nold\n<!-- end bench -->\nafter\n", encoding="utf-8")
    for text in ("| new \\1 |", "| newer |"):
        replace_section(path, "bench", f"\n{text}\n")
        assert path.read_text(encoding="utf-8") == (
            f"before\n<!-- begin bench -->\n\n{text}\n\n<!-- end bench -->\nafter\n"
        )


def test_a_missing_section_is_an_error_and_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "figures.md"
    path.write_text("no section\n", encoding="utf-8")
    with pytest.raises(ValueError, match="found section 'bench' 0 times"):
        replace_section(path, "bench", "text")
    assert path.read_text(encoding="utf-8") == "no section\n"


def test_the_document_has_all_sections() -> None:
    text = FIGURES.read_text(encoding="utf-8")
    names = re.findall(r"<!-- begin (.*) -->", text)
    assert names == ["bench", "arm64", "blind"]
    assert re.findall(r"<!-- end (.*) -->", text) == names


def test_figures_become_rows() -> None:
    figures = [
        {"key": "latency_p99", "value": 2.7, "unit": "ms", "goal": "at most 5", "met": True},
        {"key": "start", "value": 0.52, "unit": "s", "goal": "at most 0.5", "met": False},
    ]
    assert as_markdown(figures).splitlines()[-2:] == [
        "| `latency_p99` | 2.7 | ms | at most 5 | yes |",
        "| `start` | 0.52 | s | at most 0.5 | **no** |",
    ]


@pytest.mark.parametrize("path", [*Path("docs").rglob("*.md"), Path("CHANGELOG.md")], ids=str)
def test_lines_of_documents_are_at_most_120_long(path: Path) -> None:
    """But for tables, and for what a program prints."""
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        assert len(line) <= 120 or line.startswith(("|", "      ")), f"{path}:{number}"


def test_every_document_is_in_a_list_of_the_first_page() -> None:
    """What `make docs` refuses, found without building the site."""
    index = Path("docs/index.md").read_text(encoding="utf-8")
    pages = [each.relative_to("docs").as_posix() for each in Path("docs").rglob("*.md") if each.name != "index.md"]
    assert [page for page in pages if f"]({page})" not in index] == []
