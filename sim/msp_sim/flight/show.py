"""A flight on the terminal: its progress, and afterwards its table."""

from typing import Any

from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from msp_range.bridge import Step
from msp_range.terminal import plain_table
from msp_sim.flight.flight import Simulation

BAR_CELLS = 44
REFRESH_S = 0.1
"""Wall time between two updates of a display on a terminal [s]; smaller costs processor time."""
LINE_PERIOD_S = 10.0
"""Flown time between two lines if the output is not a terminal [s]."""


class FlightDisplay:
    """The present state of a flight: height, last answer of every sensor, newest texts."""

    def __init__(self, simulation: Simulation, duration_s: float) -> None:
        self._simulation = simulation
        self._duration_s = duration_s
        self._last: dict[str, str] = {}
        self._fused_m: float | None = None
        self._highest_m = 1.0
        self._next_line_s = 0.0

    def update(self, steps: list[Step]) -> None:
        """Update with the bridge's newest steps."""
        for step in steps:
            estimate = step.filtered.estimate or step.corrected
            self._last[step.ranging.reading.sensor] = step.filtered.rejected or f"{estimate.range_m:.2f} m"
            if step.fused is not None:
                self._fused_m = step.fused.range_m

    def line(self) -> str | None:
        """The present state in a line every `LINE_PERIOD_S`; None in between."""
        now_s = self._simulation.now_s()
        if now_s < self._next_line_s:
            return None
        self._next_line_s = now_s + LINE_PERIOD_S
        sensors = ", ".join(f"{name} {shown}" for name, shown in self._last.items())
        return f"{now_s:6.1f} s: true height {self._simulation.height_m():.2f} m, fused {self._fused()}; {sensors}"

    def _fused(self) -> str:
        if self._fused_m is None:
            return "no estimate"
        is_edge = self._simulation.flight.fused.why[-1] == "edge"
        return f"{self._fused_m:.2f} m" + (" (over an edge of the ground)" if is_edge else "")

    def __rich__(self) -> RenderableType:
        now_s = self._simulation.now_s()
        height_m = self._simulation.height_m()
        self._highest_m = max(self._highest_m, height_m, self._fused_m or 0.0)
        done = min(now_s / self._duration_s, 1.0)
        table = Table.grid(padding=(0, 1))
        table.add_row("flown", _bar(done, "cyan"), f"{now_s:5.1f} of {self._duration_s:.0f} s")
        table.add_row("true height", _bar(height_m / self._highest_m, "green"), f"{height_m:5.2f} m")
        table.add_row("fused", _bar((self._fused_m or 0.0) / self._highest_m, "yellow"), self._fused())
        for name in self._simulation.flight.tracks:
            table.add_row(name, Text(self._last.get(name, "")), "")
        texts = self._simulation.flight.texts[-3:]
        return Group(table, *(Text(f"{time_s:7.1f} s  {severity}: {text}") for time_s, severity, text in texts))


def _bar(share: float, colour: str) -> Text:
    cells = round(min(max(share, 0.0), 1.0) * BAR_CELLS)
    return Text("█" * cells, style=colour) + Text("·" * (BAR_CELLS - cells), style="dim")


def print_table(console: Console, summary: dict[str, Any]) -> None:
    """Print readings and rejections of each sensor, errors where the truth is known, and the messages sent."""
    seed = "" if summary["seed"] is None else f", seed {summary['seed']}"
    title = f"{summary['scenario']}, {summary['duration_s']:.0f} s flown{seed}"
    fused = summary["fused"]
    readings, errors = [], []
    for name, sensor in summary["sensors"].items():
        rejected = sensor["rejected"]
        why = ", ".join(f"{reason} {count}" for reason, count in rejected.items())
        readings.append((name, str(sensor["readings"]), f"{sum(rejected.values())}{': ' if why else ''}{why}"))
        if sensor["error_before"]["count"]:
            errors.append((name, *_error(sensor["error_before"]), *_error(sensor["error_after"])))
    if fused["estimates"]:
        readings.append(("fused", str(fused["estimates"]), f"{fused['rate_hz']:.2f} Hz"))
        if fused["error"]["count"]:
            errors.append(("fused", "", "", *_error(fused["error"])))
    console.print(plain_table(("sensor", "readings", "rejected, reason"), readings, "lrl", title))
    if errors:
        header = ("error [cm]", "rms raw", "95 % raw", "rms filtered", "95 % filtered")
        console.print(plain_table(header, errors))
    if fused["over_edges"]:
        console.print(f"  {fused['over_edges']} fused distances over edges of the ground are not in the errors\n")
    sent, dropped = summary["link"]["sent"], summary["link"]["dropped"]
    frames = []
    for name in sorted(sent | dropped):
        each = sent.get(name, {"messages": 0, "rate_hz": 0.0})
        frames.append((name, str(each["messages"]), f"{each['rate_hz']:.2f}", str(dropped.get(name, 0))))
    console.print(plain_table(("message sent", "messages", "rate Hz", "dropped"), frames))
    for text in summary["texts"]:
        console.print(f"{text['time_s']:7.1f} s  {text['severity']}: {text['text']}")


def _error(error: dict[str, float]) -> tuple[str, str]:
    return (f"{error['rms_cm']:.1f}", f"{error['p95_cm']:.1f}") if error["count"] else ("-", "-")
