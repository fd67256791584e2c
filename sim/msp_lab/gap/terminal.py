"""The gap workflow on the terminal: its progress, and the verdict in a few lines."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.padding import Padding
from rich.progress import BarColumn, TaskProgressColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from msp_lab.estimates import IntervalEstimate
from msp_lab.gap.conclusion import in_words
from msp_lab.gap.findings import FoundEffect, GapFindings, UnknownEffect
from msp_lab.gap.findings_file import MODEL
from msp_lab.gap.labels import (
    channel_label,
    effect_label,
    finding_label,
    interval,
    short,
    slice_label,
    unit_after,
)
from msp_lab.gap.separate import SensorGap, SeparateGap
from msp_lab.gap.tables import measures_table
from msp_range.clock import Clock, SystemClock
from msp_range.terminal import Bar, PlainConsole, console, plain_table
from msp_sim.page.text import counted

if TYPE_CHECKING:
    from msp_lab.gap.demo import HiddenNumber

COLOURS = {
    "nothing missing": "green",
    "undecided": "yellow",
    "absorbed": "yellow",
    "explained": "green",
    "improved": "green",
    "partly explained": "yellow",
    "unexplained": "red",
}
SLICES = 5


class ProgressBar(Bar):
    """A bar on a terminal, and elsewhere a line for each part of the work."""

    def __init__(self) -> None:
        self.clock: Clock = SystemClock()
        self._console = PlainConsole(stderr=True)
        self._last = ""
        super().__init__(BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), total=1.0, on=self._console)

    def report(self, what: str, share: float) -> None:
        """Show what is being done, and which share of the whole is done."""
        if self.is_shown:
            self.show(what, share)
        elif what != self._last:
            self._console.print(f"{100.0 * share:3.0f} %  {what}")
        self._last = what

    def print_findings(self, findings: GapFindings) -> None:
        """Print the findings above the bar."""
        with self.paused():
            print_findings(findings)


def print_comparisons(found: Iterable["HiddenNumber"]) -> None:
    """What was hidden, and what was found of it."""
    header = ("hidden effect", "number", "hidden", "found", "95 % interval", "holds it")
    rows = []
    for hidden in found:
        value, ends = "not named", ""
        if hidden.found is not None:
            value, ends = f"{hidden.found.value:.3g}", interval(hidden.found.low, hidden.found.high)
            ends += unit_after(hidden.found.unit) * bool(ends)
        rows.append(
            (hidden.effect, hidden.parameter, f"{hidden.hidden:g}", value, ends, "yes" if hidden.holds else "no")
        )
    console().print(plain_table(header, rows, "llrrl"))


def separate_gaps_table(gaps: Sequence[SeparateGap]) -> Table:
    """What was found at each of many logs or sensors."""
    header = ("", "verdict", "named", "readings", "nats before", "after")
    rows = [
        (one.name, one.verdict, one.named, f"{one.readings:,}", short(one.before_nats, "-"), short(one.after_nats, "-"))
        for one in gaps
    ]
    return plain_table(header, rows, "lllr")


def print_sensors(gaps: Sequence[SensorGap], messages: Sequence[str], folder: Path) -> None:
    """What was found at each sensor of a vehicle, compared with the others."""
    out = console()
    for gap in gaps:
        style = f"bold {COLOURS.get(gap.findings.verdict or '', 'cyan')}" if gap.named else ""
        out.print(Text(f"{gap.sensor}: {gap.findings.sentence}", style=style))
        if gap.without:
            out.print(f"  compared without {', '.join(gap.without)}, which differs from the rest")
        if gap.doubted:
            out.print(f"  perhaps the fault of {gap.doubted}, which differs most from the rest")
    for message in messages:
        out.print(f"note: {message}", style="dim")
    out.print(f"in {folder}: a folder for each sensor, and sensors.json", soft_wrap=True)


def print_findings(findings: GapFindings) -> None:
    """The sentence for a pilot, the lines with numbers, and the table of what was found."""
    out = console()
    out.print(Text(findings.sentence, style=f"bold {COLOURS.get(findings.verdict or '', 'cyan')}"))
    for line in findings.summary:
        out.print(Padding(Text(line), (0, 0, 0, 2)))
    if findings.effects or findings.unknown:
        out.print(_found_table(findings))
    elif findings.gap is not None:
        out.print(measures_table(findings))
    if findings.verdict is None and not findings.effects:
        for piece in [piece for piece in findings.slices if piece.variables][:SLICES]:
            p = "" if piece.p_value is None else f", p {piece.p_value:.3f}"
            out.print(f"  {slice_label(piece.where)}: {piece.channel}{p}")
    for message in findings.notes:
        out.print(f"note: {message}", style="dim")
    columns = sorted({name for untested in findings.not_testable for name in untested.columns})
    if columns:
        effects = counted(len(findings.not_testable), "effect")
        out.print(f"{effects} cannot be tested without {', '.join(columns)}", style="dim")


def print_files(findings: GapFindings, folder: Path) -> None:
    """How much was compared, and where the rest is."""
    runs = counted(findings.runs, "run")
    files = [name for name in ("report.html", MODEL, "gap.json") if (folder / name).exists()]
    console().print(
        f"{findings.rows:,} readings, {runs}, {findings.seconds:.1f} s; in {folder}: {', '.join(files)}",
        soft_wrap=True,
    )


def _found_table(findings: GapFindings) -> Table:
    """Each finding with its numbers, and what would show it alone or tell it from its alternatives."""
    table = plain_table(("finding", "effect, with 95 % intervals", "experiment"), align="l")
    table.show_lines = True
    for effect in findings.effects:
        label = effect_label(effect.name, effect.of)
        what = label if effect.verdict == "named" else f"{label} ({effect.verdict})"
        values = [
            f"{name} {IntervalEstimate(number.value, number.low, number.high, unit_after(number.unit).strip())}"
            for name, number in effect.parameters.items()
        ]
        table.add_row(
            _with_place(effect, findings), "\n".join([what, *values, *filter(None, [effect.doubt])]), effect.experiment
        )
    for unknown in findings.unknown:
        table.add_row(
            _with_place(unknown, findings),
            f"{finding_label(unknown)}\n{channel_label(unknown.channel)} = {unknown.formula}",
            "",
        )
    return table


def _with_place(finding: FoundEffect | UnknownEffect, findings: GapFindings) -> str:
    return in_words(finding, findings) + (f"\nWhere: {finding.where}" if finding.where else "")
