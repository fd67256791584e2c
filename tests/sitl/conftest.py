"""Prints what the flights measured, as the tables of docs/sitl.md."""

from typing import Any

from tests.sitl import figures


def pytest_terminal_summary(terminalreporter: Any) -> None:
    for title, headings, rows in (
        ("flights on real autopilots", figures.HEADINGS, figures.ROWS),
        ("the course on real autopilots", figures.COURSE_HEADINGS, figures.COURSE_ROWS),
    ):
        if rows:
            terminalreporter.section(title)
            terminalreporter.write_line(figures.table(headings, rows))
