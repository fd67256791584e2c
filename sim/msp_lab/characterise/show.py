"""The results of a characterisation as a short table on the terminal, with what the data did not allow.

It is the table of the page as lines; the page has the rest.
"""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.answers import conclusions_table, summarise
from msp_lab.characterise.page.tables import mixture_table
from msp_lab.characterise.sensors import TABLE, OfSensor
from msp_range.terminal import console, plain_table


def show_findings(findings: Findings, console: Console) -> None:
    """Print the results."""
    console.print(summarise(findings))
    rows = sum(point.readings for point in findings.points)
    console.print(f"{findings.sensor}: {rows} readings at {len(findings.points)} points")
    console.print(conclusions_table(findings))
    if findings.mixture is not None:
        console.print(mixture_table(findings))
        console.print(findings.mixture.conditional, soft_wrap=True)
    for why in dict.fromkeys(findings.absent.values()):
        names = ", ".join(name for name, each in findings.absent.items() if each == why)
        console.print(f"not in these data: {names}: {why}", style="dim")
    for warning in findings.warnings:
        console.print(f"warning: {warning}", style="yellow")


def show_sensors(found: Sequence[OfSensor], died: int, folder: Path) -> None:
    """Print the models of several sensors, and those that could not be made."""
    out = console()
    header = ("", "readings", "sigma [cm]", "short", "missed", "random")
    rows = []
    for each in found:
        numbers = (each.sigma_cm, each.short, each.missed, each.random)
        shown = ("-" if number is None else f"{number:.3g}" for number in numbers)
        rows.append((each.sensor, f"{each.readings:,}", *shown))
    out.print(plain_table(header, rows))
    for each in found:
        if each.error:
            out.print(f"{each.sensor}: no model: {each.error}", style="red")
    if died:
        out.print(f"{died} worker processes died; their sensors were computed again")
    out.print(f"in {folder}: a sensor model for each, and {TABLE}", soft_wrap=True)
