"""Run every benchmark, print one table, and write it: into docs/figures.md and evaluation/benchmarks/results.json.

With names, such as ``start page``, only these run, and nothing is written. Figures are {key, value, unit, goal, met}.
"""

import argparse
import json
import os
import platform
import sys
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from evaluation.benchmarks import (
    bench_bridge,
    bench_filters,
    bench_fit,
    bench_fit_coverage,
    bench_fusion,
    bench_gap,
    bench_laboratory,
    bench_logs,
    bench_monte_carlo,
    bench_page,
    bench_rates,
    bench_reading_model,
    bench_sensor_watch,
    bench_start,
    bench_virtual_flight,
)
from evaluation.document import FIGURES, replace_section

PARTS = (
    bench_reading_model,
    bench_fit,
    bench_fit_coverage,
    bench_laboratory,
    bench_gap,
    bench_logs,
    bench_monte_carlo,
    bench_bridge,
    bench_filters,
    bench_fusion,
    bench_sensor_watch,
    bench_virtual_flight,
    bench_rates,
    bench_start,
    bench_page,
)
BY_NAME = {part.__name__.removeprefix("evaluation.benchmarks.bench_"): part for part in PARTS}
RESULTS = Path(__file__).parent / "results.json"


def as_markdown(figures: list[dict[str, Any]]) -> str:
    """The figures as a table for docs/figures.md, with the machine that they were measured on."""
    lines = [
        f"Measured on {platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}.",
        "",
        "| figure | value | unit | goal | met |",
        "|---|---|---|---|---|",
    ]
    for figure in figures:
        met = {True: "yes", False: "**no**", None: ""}[figure["met"]]
        lines.append(f"| `{figure['key']}` | {figure['value']:g} | {figure['unit']} | {figure['goal'] or ''} | {met} |")
    return "\n".join(lines)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("name", nargs="*", help=f"one or more of {', '.join(BY_NAME)}; all if none is given")


def main(given: argparse.Namespace) -> None:
    """Run the benchmarks and print the table; if all ran, write both files."""
    names = given.name
    for name in names:
        if name not in BY_NAME:
            raise argparse.ArgumentTypeError(f"no benchmark is called {name!r}; there are {', '.join(BY_NAME)}")
    # In a file or a log a line may be as long as it needs.
    console = Console(width=None if sys.stdout.isatty() else 200)
    figures = []
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("measuring", total=len(names or BY_NAME))
        for name in names or BY_NAME:
            progress.update(task, description=name)
            figures += BY_NAME[name].run()
            progress.advance(task)
    table = Table(box=box.SIMPLE_HEAD)
    for heading in ("figure", "value", "unit", "goal", "met"):
        table.add_column(heading, justify="right" if heading == "value" else "left", no_wrap=heading == "figure")
    for figure in figures:
        met = {True: "yes", False: "NO", None: ""}[figure["met"]]
        table.add_row(figure["key"], f"{figure['value']:g}", figure["unit"], figure["goal"] or "", met)
    console.print(table)
    if names:
        return
    RESULTS.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    replace_section(FIGURES, "bench", as_markdown(figures))
    for path in (RESULTS, FIGURES):
        console.print(f"written: {path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path}")
