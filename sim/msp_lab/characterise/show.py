"""The results of a characterisation on the terminal: the page's answer and first table, and what the data lacked."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.answers import conclusions_table, summarise
from msp_lab.characterise.page.tables import mixture_table
from msp_lab.characterise.sensors import OfSensor
from msp_range.terminal import plain_table


def show_findings(findings: Findings, console: Console) -> None:
    """Print the results."""
    console.print(summarise(findings))
    console.print(f"{findings.sensor}: {findings.readings} readings at {len(findings.points)} points")
    console.print(conclusions_table(findings))
    if findings.mixture is not None:
        console.print(mixture_table(findings))
        console.print(findings.mixture.conditional, soft_wrap=True)
    for why in dict.fromkeys(findings.absent.values()):
        names = ", ".join(name for name, each in findings.absent.items() if each == why)
        console.print(f"not in these data: {names}: {why}", style="dim")
    for warning in findings.warnings:
        console.print(f"warning: {warning}", style="yellow")


def sensors_table(found: Sequence[OfSensor]) -> Table:
    """The models of several sensors."""
    header = ("", "readings", "sigma [cm]", "short", "missed", "random")
    rows = []
    for finding in found:
        numbers = (finding.sigma_cm, finding.short, finding.missed, finding.random)
        shown = ("-" if number is None else f"{number:.3g}" for number in numbers)
        rows.append((finding.sensor, f"{finding.readings:,}", *shown))
    return plain_table(header, rows)
