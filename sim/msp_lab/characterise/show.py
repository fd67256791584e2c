"""The results of a characterisation as a short table on the terminal, with what the data did not allow.

Findings enter, the table of the page leaves as lines; the page has the rest.
"""

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from msp_lab.characterise.answer import summarise
from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.answers import Kind, conclusions

STYLES: dict[Kind, str] = {"yes": "yellow", "no": "green", "open": "dim"}


def show_findings(findings: Findings, console: Console) -> None:
    """Print the results."""
    console.print(summarise(findings), highlight=False)
    rows = sum(each.readings for each in findings.points)
    columns = [Column(heading, overflow="fold") for heading in ("what", "found (95 % interval)", "verdict")]
    title = f"{findings.sensor}: {rows} readings at {len(findings.points)} points"
    table = Table(*columns, title=title, title_justify="left")
    for each in conclusions(findings):
        table.add_row(each.subject, each.answer, Text(each.mark, style=STYLES[each.kind]))
    console.print(table)
    for why in dict.fromkeys(findings.absent.values()):
        names = ", ".join(name for name, each in findings.absent.items() if each == why)
        console.print(f"not in these data: {names}: {why}", style="dim", highlight=False)
    for warning in findings.warnings:
        console.print(f"warning: {warning}", style="yellow", highlight=False)
