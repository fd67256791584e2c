"""The one runner of all campaigns: many cases by name, several at a time, and a line of a file for each.

It shares nothing with the product, as generators that must not share anything with it use it.
"""

import argparse
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from threadpoolctl import threadpool_limits

Kind = TypeVar("Kind")
Row = dict[str, Any]
"""What became of a case, for JSON. Its key ``again`` is the name of the case."""
Cases = Mapping[str, tuple[Any, ...]]
"""Name of a case -> arguments of the work. The name holds all that the row depends on, seed and options included."""

LINE_EACH_S = 30.0
"""Time between two lines on the progress where there is no terminal [s]. More often fills a log."""
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
"""Environment in which numpy computes on one processor: processes, not threads, use the others, and the last digits of
a result do not depend on the machine."""


def campaign_options(parser: argparse.ArgumentParser, out: str | None = None) -> None:
    """Add the options that all campaigns have; ``out`` is the default folder, None: it has to be named."""
    parser.add_argument(
        "--out",
        type=Path,
        default=out and Path(out),
        required=out is None,
        help="folder for the results" + (" (default: %(default)s)" if out else ""),
    )
    seed = "random seed; where each case has one of its own, that of the first (default: %(default)s)"
    parser.add_argument("--seed", type=int, default=1, help=seed)
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")


def run_cases(
    cases: Cases,
    work: Callable[..., Row],
    jobs: int,
    file: Path | None = None,
    resume: bool = True,
    line: Callable[[Row], str] | None = None,
) -> list[Row]:
    """Run each case that has no row yet, and return the rows of all in their order.

    Ctrl-C lets the cases that have begun finish, keeps their rows, and leaves the others.

    Parameters
    ----------
    cases
        What to run.
    work
        Makes the row of a case from its arguments; with several processes a function of a module.
    jobs
        Processes; with one the work is done in this one.
    file
        A line of JSON for each row, in the order of the cases; None: rows are not kept.
    resume
        Whether rows that the file already has count; else it begins anew.
    line
        What is printed of a new row.
    """
    rows = read_rows(file) if file is not None and resume else {}
    todo = {name: arguments for name, arguments in cases.items() if name not in rows}
    with _kept(file, rows) as keep, _progress(len(cases), len(cases) - len(todo)) as advance, threadpool_limits(1):
        for name, made in _results(todo, work, jobs):
            text = json.dumps({"again": name} | made)
            keep(text + "\n")
            rows[name] = json.loads(text)
            advance(name)
            if line is not None:
                print(line(rows[name]), flush=True)
    return [rows[name] for name in cases]


def read_rows(file: Path) -> dict[str, Row]:
    """Rows of a file by the names of their cases; a line that was cut off by the end of the power is none."""
    rows = {}
    for line in file.read_text(encoding="utf-8").splitlines(keepends=True) if file.exists() else ():
        if line.endswith("\n"):
            row = json.loads(line)
            rows[row["again"]] = row
    return rows


def as_objects(kind: Callable[..., Kind], rows: Sequence[Row]) -> list[Kind]:
    """Rows as the dataclass that they were made of."""
    return [kind(**{name: each for name, each in row.items() if name != "again"}) for row in rows]


def publish(table: str, out: Path) -> None:
    """Print a table, and write it to ``table.md`` in the folder."""
    (out / "table.md").write_text(table + "\n", encoding="utf-8")
    print(table)


@contextmanager
def _kept(file: Path | None, rows: Mapping[str, Row]) -> Iterator[Callable[[str], object]]:
    """What keeps a line in the file, in which the rows of before stand first."""
    if file is None:
        yield lambda text: None
        return
    file.parent.mkdir(parents=True, exist_ok=True)
    begun = file.with_suffix(".part")
    begun.write_text("".join(json.dumps(row) + "\n" for row in rows.values()), encoding="utf-8")
    begun.replace(file)
    with file.open("a", encoding="utf-8", buffering=1) as stream:
        yield stream.write


@contextmanager
def _progress(total: int, done: int) -> Iterator[Callable[[str], None]]:
    """What counts a case: in a bar on a terminal, elsewhere with a line on standard error now and then."""
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    is_shown = Console().is_terminal
    with Progress(*columns, transient=True, disable=not is_shown) as bar:
        task = bar.add_task("", total=total, completed=done)
        started_s = next_line_s = time.monotonic()

        def advance(name: str) -> None:
            nonlocal next_line_s
            bar.update(task, advance=1, description=name)
            if not is_shown and time.monotonic() >= next_line_s:
                next_line_s = time.monotonic() + LINE_EACH_S
                count = bar.tasks[task].completed
                print(f"{count:.0f} of {total}, {time.monotonic() - started_s:.0f} s", file=sys.stderr, flush=True)

        yield advance


def _results(todo: Cases, work: Callable[..., Row], jobs: int) -> Iterator[tuple[str, Row]]:
    """What the work makes of each case, in order."""
    if jobs == 1 or not todo:
        for name, arguments in todo.items():
            yield name, work(*arguments)
        return
    os.environ |= ONE_THREAD  # the processes inherit it, and read it when numpy starts
    pool = ProcessPoolExecutor(jobs, get_context("spawn"), partial(signal.signal, signal.SIGINT, signal.SIG_IGN))
    running: dict[str, Future[Row]] = {}
    try:
        running = {name: pool.submit(work, *arguments) for name, arguments in todo.items()}
        for name in list(running):
            made = running[name].result()
            del running[name]
            yield name, made
    except KeyboardInterrupt:
        print("\nends when what has begun is done", file=sys.stderr, flush=True)
        pool.shutdown(cancel_futures=True)
        yield from ((name, each.result()) for name, each in running.items() if not each.cancelled())
        raise
    finally:
        pool.shutdown(cancel_futures=True)
