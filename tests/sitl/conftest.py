"""Prints what the flights measured, as the table of docs/sitl.md."""

from typing import Any

from tests.sitl import figures


def pytest_terminal_summary(terminalreporter: Any) -> None:
    if figures.ROWS:
        terminalreporter.section("flights on real autopilots")
        terminalreporter.write_line(figures.table())
