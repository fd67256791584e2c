"""The runner of campaigns: rows in order, kept, resumed, and the same in one process and in two."""

import json
from pathlib import Path

import pytest

from evaluation.runner import Row, publish, read_rows, run_cases

CASES = {f"1:{number}": (number,) for number in range(4)}


def square(number: int) -> Row:
    """The row of a case."""
    return {"square": number**2, "pair": (number, number)}


def refuse(number: int) -> Row:
    raise AssertionError(f"case {number} has its row")


@pytest.mark.parametrize("jobs", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_rows_come_in_the_order_of_the_cases_and_are_those_of_the_file(jobs: int, tmp_path: Path) -> None:
    file = tmp_path / "out" / "cases.jsonl"
    rows = run_cases(CASES, square, jobs, file)
    assert rows == [{"again": f"1:{number}", "square": number**2, "pair": [number, number]} for number in range(4)]
    assert [json.loads(line) for line in file.read_text().splitlines()] == rows


def test_what_has_a_row_is_not_run_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "cases.jsonl"
    first = run_cases(dict(list(CASES.items())[:2]), square, 1, file)
    assert run_cases(dict(list(CASES.items())[:2]), refuse, 1, file) == first
    rows = run_cases(CASES, square, 1, file, line=lambda row: f"new: {row['again']}")
    assert rows[:2] == first
    assert list(read_rows(file)) == list(CASES)
    assert capsys.readouterr().out == "new: 1:2\nnew: 1:3\n"


def test_a_line_that_was_cut_off_is_no_row_and_the_next_ones_are_whole(tmp_path: Path) -> None:
    file = tmp_path / "cases.jsonl"
    rows = run_cases(CASES, square, 1, file)
    file.write_text(file.read_text()[:-9])
    assert list(read_rows(file)) == list(CASES)[:3]
    assert run_cases(CASES, square, 1, file) == rows
    assert list(read_rows(file)) == list(CASES)


def test_a_campaign_that_does_not_resume_begins_its_file_anew(tmp_path: Path) -> None:
    file = tmp_path / "cases.jsonl"
    run_cases(CASES, square, 1, file)
    run_cases({"2:7": (7,)}, square, 1, file, resume=False)
    assert list(read_rows(file)) == ["2:7"]


def test_a_table_is_printed_and_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    publish("| a |", tmp_path)
    assert capsys.readouterr().out == (tmp_path / "table.md").read_text() == "| a |\n"
