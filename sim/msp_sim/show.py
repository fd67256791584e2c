"""A flight for the eye: progress while it flies, the table after it, and the picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console, Group, RenderableType
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from msp_range.bridge import Step
from msp_range.characterise.plan import Point
from msp_sim.flight import Flight, Simulation

BAR_CELLS = 44


LINE_EACH_S = 10.0
"""Flown time between two lines where there is no terminal to draw on [s]."""


class Live:
    """What happens now: height, the last answer of every sensor, the newest texts."""

    def __init__(self, simulation: Simulation, duration_s: float) -> None:
        self._simulation = simulation
        self._duration_s = duration_s
        self._last: dict[str, str] = {}
        self._fused_m: float | None = None
        self._highest_m = 1.0
        self._next_line_s = 0.0

    def take(self, steps: list[Step]) -> None:
        """Note what the bridge did."""
        for step in steps:
            reading = step.ranging.reading
            estimate = step.filtered.estimate
            shown = step.filtered.rejected or (f"{estimate.range_m:.2f} m" if estimate else "-")
            self._last[reading.sensor] = shown
            if step.fused is not None:
                self._fused_m = step.fused.range_m

    def line(self) -> str | None:
        """What happens now in a line, now and then; None in between."""
        now_s = self._simulation.now_s()
        if now_s < self._next_line_s:
            return None
        self._next_line_s = now_s + LINE_EACH_S
        fused = "no estimate" if self._fused_m is None else f"{self._fused_m:.2f} m"
        sensors = ", ".join(f"{name} {shown}" for name, shown in self._last.items())
        return f"{now_s:6.1f} s: true height {self._simulation.height_m():.2f} m, fused {fused}; {sensors}"

    def __rich__(self) -> RenderableType:
        now_s = self._simulation.now_s()
        height_m = self._simulation.height_m()
        self._highest_m = max(self._highest_m, height_m, self._fused_m or 0.0)
        done = min(now_s / self._duration_s, 1.0)
        table = Table.grid(padding=(0, 1))
        table.add_row("flown", _bar(done, "cyan"), f"{now_s:5.1f} of {self._duration_s:.0f} s")
        table.add_row("true height", _bar(height_m / self._highest_m, "green"), f"{height_m:5.2f} m")
        fused = "no estimate" if self._fused_m is None else f"{self._fused_m:5.2f} m"
        table.add_row("fused", _bar((self._fused_m or 0.0) / self._highest_m, "yellow"), fused)
        for name in self._simulation.flight.tracks:
            table.add_row(name, Text(self._last.get(name, "")), "")
        texts = self._simulation.flight.texts[-3:]
        return Group(table, *(Text(f"{time_s:7.1f} s  {severity}: {text}") for time_s, severity, text in texts))


def _bar(share: float, colour: str) -> Text:
    cells = round(min(max(share, 0.0), 1.0) * BAR_CELLS)
    return Text("█" * cells, style=colour) + Text("·" * (BAR_CELLS - cells), style="dim")


class Collecting:
    """A campaign's progress: a bar on a terminal, and elsewhere a line for each question."""

    def __init__(self, todo: Sequence[Point]) -> None:
        self._total = sum(point.readings * len(point.setup.sensors) for point in todo)
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:.0f} of {task.total:.0f} readings"),
            TimeRemainingColumn(),
            transient=True,
        )
        self._task = self._progress.add_task("", total=self._total)
        self._shown = self._progress.console.is_terminal
        self._question = ""

    def __enter__(self) -> "Collecting":
        if self._shown:
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown:
            self._progress.stop()

    def take(self, point: Point, readings: int) -> None:
        """Show where the collection is."""
        if self._shown:
            self._progress.update(self._task, completed=readings, description=point.condition)
        elif point.question != self._question:
            self._question = point.question
            print(f"{readings} of {self._total} readings; now {point.condition}: {point.question}")


def print_table(console: Console, summary: dict[str, Any]) -> None:
    """Per sensor: readings, rejected and why, error before and after; the link's messages by type and rate."""
    table = Table(
        title=f"{summary['scenario']}, {summary['duration_s']:.0f} s flown, seed {summary['seed']}", box=box.SIMPLE_HEAD
    )
    table.add_column("sensor", no_wrap=True)
    table.add_column("readings", justify="right")
    table.add_column("rejected, why")
    for heading in ("rms raw", "95 % raw", "rms filtered", "95 % filtered"):
        table.add_column(f"{heading} [cm]".replace("[", r"\["), justify="right", max_width=8)
    for name, sensor in summary["sensors"].items():
        rejected = sensor["rejected"]
        total = sum(rejected.values())
        why = f"{total}: " + ", ".join(f"{reason} {count}" for reason, count in rejected.items()) if total else "0"
        table.add_row(
            name, str(sensor["readings"]), why, *_error(sensor["error_before"]), *_error(sensor["error_after"])
        )
    fused = summary["fused"]
    if fused["estimates"]:
        rate = f"{fused['rate_hz']:.2f} Hz; {fused['over_edges']} over edges, not compared"
        table.add_row("fused", str(fused["estimates"]), rate, "", "", *_error(fused["error"]))
    console.print(table)
    link = Table(box=box.SIMPLE_HEAD)
    link.add_column("message sent")
    for heading in ("messages", "rate Hz", "dropped"):
        link.add_column(heading, justify="right")
    dropped = summary["link"]["dropped"]
    sent = summary["link"]["sent"]
    for name in sorted(sent | dropped):
        each = sent.get(name, {"messages": 0, "rate_hz": 0.0})
        link.add_row(name, str(each["messages"]), f"{each['rate_hz']:.2f}", str(dropped.get(name, 0)))
    console.print(link)
    for text in summary["texts"]:
        console.print(f"{text['time_s']:7.1f} s  {text['severity']}: {text['text']}", highlight=False)


def _error(error: dict[str, float]) -> tuple[str, str]:
    return (f"{error['rms_cm']:.1f}", f"{error['p95_cm']:.1f}") if error["count"] else ("-", "-")


def draw(flight: Flight, path: Path, title: str) -> None:
    """The flight as a picture: ranges over time with what was rejected, and the errors below."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (top, bottom) = plt.subplots(2, 1, figsize=(11, 7.5), sharex=True, height_ratios=(3, 2))
    for number, (name, track) in enumerate(flight.tracks.items()):
        colour = f"C{number}"
        pairs = zip(track.time_s, track.raw_m, track.why, strict=True)
        points = [(time_s, raw_m, why) for time_s, raw_m, why in pairs if raw_m is not None]
        used = [(time_s, raw_m) for time_s, raw_m, why in points if why in (None, "at_minimum")]
        held = [(time_s, raw_m) for time_s, raw_m, why in points if why not in (None, "at_minimum")]
        top.plot(*_columns(used), ".", color=colour, markersize=3, label=name)
        top.plot(*_columns(held), "x", color=colour, markersize=5)
        errors = zip(track.time_s, track.raw_m, track.truth_m, track.why, strict=True)
        raw = [(t, 100 * (r - e)) for t, r, e, why in errors if r is not None and e is not None and why != "at_minimum"]
        bottom.plot(*_columns(raw), ".", color=colour, markersize=2, alpha=0.6)
    if flight.fused.time_s:
        fused = flight.fused
        truth = [(t, e) for t, e in zip(fused.time_s, fused.truth_m, strict=True) if e is not None]
        top.plot(*_columns(truth), "-", color="0.6", linewidth=4, label="truth, down axis", zorder=0)
        top.plot(fused.time_s, fused.filtered_m, "k-", linewidth=1, label="fused")
        pairs_m = zip(fused.time_s, fused.filtered_m, fused.truth_m, strict=True)
        errors_cm = [(t, 100 * (f - e)) for t, f, e in pairs_m if f is not None and e is not None]
        bottom.plot(*_columns(errors_cm), "k-", linewidth=1, label="fused")
    top.plot([], [], "x", color="0.3", label="held back")
    top.set_ylabel("range [m]")
    top.set_title(title)
    top.legend(ncols=3, fontsize=8)
    bottom.set_ylabel("error [cm]")
    bottom.set_ylim(-40, 40)
    bottom.set_xlabel("time [s]")
    bottom.set_title(
        "reading minus truth (dots: as the sensor gave it; line: fused; beyond 40 cm not shown)", fontsize=9
    )
    for axes in (top, bottom):
        axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _columns(rows: list[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return [row[0] for row in rows], [row[1] for row in rows]
