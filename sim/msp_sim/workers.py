"""Do the same for each item of a list, on one processor, on several, or on a Dask cluster.

A function is called for each of a list of independent items, and gives an `ItemOutcome` for each, in the list's order.
The results do not depend on where they were computed: each item is computed alone, with one BLAS thread, and whatever
is summed over items is summed by the caller, in order.

There is one mechanism for several processes, Dask: `--jobs` starts a cluster on this machine, `--scheduler` uses one
that runs. It replaces a worker that died and does its items again. With one job nothing is started, and the extra
`fleet` is not needed.
"""

import csv
import gc
import hashlib
import logging
import pickle
import platform
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, astuple, dataclass, fields
from functools import lru_cache
from itertools import count
from math import inf
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy
import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TimeRemainingColumn
from rich.table import Table
from threadpoolctl import threadpool_limits

from msp_range import __version__
from msp_range.errors import UserError
from msp_range.extras import require
from msp_range.terminal import Bar, PlainConsole, console
from msp_range.yaml_file import ConfigError

EXIT_SOME_FAILED = 4
"""Exit code: some items could not be computed; the others were."""
MOST_TASKS = 250
"""Longer lists are handed to the cluster in this many parts. Each part costs its scheduler 2 ms; fewer, longer parts
leave processors idle at the end, and more is lost with a worker."""
SILENT = logging.CRITICAL + 1
"""Log level of Dask: what its processes log about a worker that died is reported by the command."""
CONNECT_S = 5.0
"""Time in which a scheduler must answer [s]; more only delays the message about a wrong address."""
WAIT_S = 5.0
"""Time without a result after which it is checked whether the cluster has workers [s]."""
RESTART_S = 120.0
"""Time in which a process of this machine that died must be replaced [s]. It takes 2 s, and 10 s on a computer that
does ten other things; who waits longer waits for nothing. Nobody knows when the workers of a cluster come back."""
NEVER = "365 days"
"""Dask's time after which it closes for ever a worker that died and is not there (15 s by default). It looks once, that
long after a death: where the worker that was replaced has died again, nothing would start another one."""
MEMORY_KEPT = {"MALLOC_TRIM_THRESHOLD_": 1 << 29, "MALLOC_MMAP_THRESHOLD_": 1 << 25, "MALLOC_ARENA_MAX": 1}
"""The environment of worker processes: they keep freed memory. Dask has them return all beyond 64 kB at once, and of a
gap of 100,000 readings on each of two processors a third of the time went into getting it back."""

Item = TypeVar("Item")
Result = TypeVar("Result")
Row = TypeVar("Row", bound=Any)


@dataclass(frozen=True)
class ItemOutcome(Generic[Result]):
    """Result of one item, or why it has none."""

    index: int
    """Place of the item in the list."""
    value: Result | None
    """What the function returned; None if it failed."""
    error: str | None
    """Why it failed, in a line; None if it did not."""


class OtherVersion(UserError):
    """A worker has another version of the program, so that its results could differ."""


class Workers:
    """Where items are computed: this process, or the workers of a Dask cluster.

    Parameters
    ----------
    client
        The cluster's client; None: this process.
    progress
        Console for the progress bar; None: no bar.
    patience_s
        Time for which a cluster without workers is waited for [s].

    Attributes
    ----------
    died
        Number of worker processes that ended unexpectedly; their items were computed again by others.
    """

    def __init__(self, client: Any = None, progress: Console | None = None, patience_s: float = inf) -> None:
        self.died = 0
        self._maps = 0
        self._client = client
        self._progress = progress
        self._patience_s = patience_s

    def map(
        self, function: Callable[[Any, Item], Result], items: Sequence[Item], shared: Any = None, *, what: str
    ) -> Iterator[ItemOutcome[Result]]:
        """Call ``function(shared, item)`` for each item.

        Parameters
        ----------
        function
            At the top level of a module that the workers can import.
        items, shared
            Arguments of the function; ``shared`` is sent to each worker once per part and kept there.
        what
            Noun for the items, in the plural, for progress bar and dashboard.

        Yields
        ------
        ItemOutcome
            One per item, in order. An exception of an item is an outcome; it does not end the others.

        Raises
        ------
        ConfigError
            The cluster was lost.
        OtherVersion
            A worker has another version of the program.
        """
        columns = (BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
        outcomes = (
            (_attempt(function, shared, *each) for each in enumerate(items))
            if self._client is None
            else self._on_cluster(function, items, shared, what)
        )
        with ExitStack() as opened:
            bar = None
            if self._progress is not None:
                bar = opened.enter_context(Bar(*columns, total=len(items), on=self._progress))
                bar.show(what, 0)
            for outcome in outcomes:
                if bar is not None:
                    bar.show(what, outcome.index + 1)
                yield outcome

    def rows(
        self,
        function: Callable[[Any, Item], Row],
        items: Mapping[str, Item],
        shared: Any,
        table: Path,
        kind: type[Row],
        *,
        what: str,
    ) -> list[Row]:
        """Make a row for each item, in order; the rows also go into a CSV table, which is replaced, as they are
        computed.

        Parameters
        ----------
        function, shared, what
            As for `map`.
        items
            Items by name.
        table
            The file.
        kind
            Dataclass of a row; for an item that failed it is made of the item's name and ``error``.
        """
        names, rows = list(items), []
        with table.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, [field.name for field in fields(kind)])
            writer.writeheader()
            for outcome in self.map(function, list(items.values()), shared, what=what):
                rows.append(outcome.value or kind(names[outcome.index], error=outcome.error or ""))
                writer.writerow(asdict(rows[-1]))
                file.flush()
        return rows

    def show_rows(self, rows: Sequence[Any], table: Table, failed: str, files: str) -> None:
        """Print the end of a command: the table, the items that ``failed``, and where the files are; some failed: exit
        code `EXIT_SOME_FAILED`."""
        out = console()
        out.print(table)
        errors = [f"{astuple(row)[0]}{failed}: {row.error}" for row in rows if row.error]
        for error in errors:
            out.print(error, style="red")
        if self.died:
            out.print(f"{self.died} worker processes died; what they computed was computed again")
        out.print(files, soft_wrap=True)
        if errors:
            raise typer.Exit(EXIT_SOME_FAILED)

    def _on_cluster(
        self, function: Callable[[Any, Item], Result], items: Sequence[Item], shared: Any, what: str
    ) -> Iterator[ItemOutcome[Result]]:
        from distributed import KilledWorker

        pickled = pickle.dumps((function, shared))
        length = -(-len(items) // MOST_TASKS)
        indexed_items = list(enumerate(items))
        parts = [indexed_items[start : start + length] for start in range(0, len(items), length or 1)]
        # The dashboard groups tasks by the first part of their keys. A key must be new: the result of an earlier task
        # with the same one, also of somebody else's, would be taken for this one's.
        self._maps += 1
        group = f"{what.replace(' ', '_')}-{self._client.id.removeprefix('Client-').replace('-', '')}{self._maps}"
        numbers = count()

        def submitted(part: Sequence[tuple[int, Item]]) -> Any:
            return self._client.submit(_attempt_all, pickled, part, fingerprint(), key=(group, next(numbers)))

        waiting = [submitted(part) for part in parts][::-1]
        for part in parts:
            try:
                yield from self._result(waiting.pop())
            except KilledWorker:
                # Dask gives a task up when its worker died four times. One of its items may be the reason, or that it
                # waited at the same worker as the reason: each is tried alone.
                for indexed in part:
                    try:
                        yield from self._result(submitted([indexed]))
                    except KilledWorker:
                        yield ItemOutcome(
                            indexed[0], None, "each worker process that computed it died (out of memory?)"
                        )

    def _result(self, future: Any) -> Any:
        """The result of a task, which is then forgotten by the cluster."""
        from distributed import CancelledError
        from distributed.comm import CommClosedError

        without_workers_s = 0.0
        while True:
            try:
                return future.result(timeout=WAIT_S)
            except TimeoutError:
                if self._client.scheduler_info()["workers"]:
                    without_workers_s = 0.0
                    continue
                if without_workers_s == 0.0:
                    print("the cluster has no worker at present: waiting for one", file=sys.stderr)
                without_workers_s += WAIT_S
                if without_workers_s >= self._patience_s:
                    raise ConfigError(
                        f"all worker processes died, and none has started again for {without_workers_s:g} s (out of "
                        "memory?): try fewer --jobs; what was computed is kept"
                    ) from None
            except (CommClosedError, CancelledError):
                raise ConfigError("the connection to the Dask scheduler was lost; what was computed is kept") from None

    def on_event(self, event: tuple[float, Any]) -> None:
        """Count a worker process that ended unexpectedly, from the time and the content of a cluster's event."""
        message = event[1]
        if isinstance(message, dict) and message.get("action") == "remove-worker" and not message.get("expected"):
            self.died += 1


@contextmanager
def workers(jobs: int, scheduler: str | None, command: str) -> Iterator[Workers]:
    """Workers by the options of a command.

    Parameters
    ----------
    jobs
        Number of processes on this machine; 1: this one.
    scheduler
        Address of a Dask scheduler, such as ``tcp://192.168.1.5:8786``; None: this machine.
    command
        Name of the command, for messages.

    Raises
    ------
    ConfigError
        Both are given, the extra is not installed, or the scheduler does not answer or has no suitable workers.
    """
    progress = PlainConsole(stderr=True)
    if scheduler is not None and jobs != 1:
        raise ConfigError("--jobs and --scheduler: give one of them; a cluster has as many jobs as workers")
    if scheduler is None and jobs == 1:
        yield Workers(progress=progress)
        return
    require("fleet", f"{command} --{'jobs' if scheduler is None else 'scheduler'}")
    from distributed import Client

    with ExitStack() as opened:
        if scheduler is None:
            client = opened.enter_context(Client(opened.enter_context(_local_cluster(jobs))))
        else:
            client = opened.enter_context(_connected(scheduler))
        if progress.is_terminal:
            print(f"progress also at {client.dashboard_link}", file=sys.stderr)
        found = Workers(client, progress, RESTART_S if scheduler is None else inf)
        client.subscribe_topic("all", found.on_event)
        yield found
        client.unsubscribe_topic("all")


@contextmanager
def _local_cluster(jobs: int) -> Iterator[Any]:
    """A Dask cluster of processes of this machine, which listens to this machine only."""
    import dask
    from distributed import LocalCluster

    # Ctrl-C goes to all processes of a terminal. The workers must leave it to this one: they inherit what is blocked.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    environment = {f"distributed.nanny.pre-spawn-environ.{name}": value for name, value in MEMORY_KEPT.items()}
    try:
        with dask.config.set(environment):
            cluster = LocalCluster(
                n_workers=jobs,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",
                # Nothing is swapped to disk and no worker is paused, as without --jobs.
                memory_limit=0,
                silence_logs=SILENT,
            )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    with cluster, dask.config.set({"distributed.deploy.lost-worker-timeout": NEVER}):
        yield cluster


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    """A client of a running cluster."""
    from distributed import Client

    logging.getLogger("distributed").setLevel(SILENT)
    client, reason = None, ""
    try:
        client = Client(address, timeout=CONNECT_S)
    except (OSError, ValueError, TypeError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    if client is None:
        # What there is of it ends now. While another cluster starts, it would wait for a lock that its own thread has.
        gc.collect()
        raise ConfigError(
            f"--scheduler {address}: no Dask scheduler answered within {CONNECT_S:g} s ({reason}). Start one with "
            "'dask scheduler', and 'dask worker tcp://HOST:8786 --nthreads 1' on each machine (docs/fleets.md)"
        )
    with client:
        found = client.scheduler_info(n_workers=-1)["workers"]
        if not found:
            raise ConfigError(
                f"--scheduler {address}: it has no workers. Start some on each machine: dask worker {address} "
                "--nthreads 1 --nworkers 2"
            )
        for name, worker in found.items():
            if worker["nthreads"] != 1:
                raise ConfigError(
                    f"--scheduler {address}: the worker {name} computes {worker['nthreads']} items at a time in one "
                    f"process; expected one: start it with --nthreads 1 --nworkers {worker['nthreads']}"
                )
        # By built-in words, which a worker knows without the program. Dask would fail to read each task, and try again.
        for name, why in client.run(exec, f"import {__name__}", {}, on_error="return").items():
            if why is not None:
                raise ConfigError(
                    f"--scheduler {address}: the worker {name} cannot import the program ({why}); expected "
                    f"msp-range {__version__} with the extra fleet in the Python that the worker runs in"
                )
        yield client


@lru_cache(maxsize=1)
def fingerprint() -> str:
    """Everything that results depend on besides their arguments: versions, and the hash of the program's own files."""
    sha = hashlib.sha256()
    root = Path(__file__).parent
    for package in (Path(sys.modules["msp_range"].__file__ or "").parent, root, root.parent / "msp_lab"):
        for path in sorted(package.rglob("*.py")):
            sha.update(path.relative_to(package).as_posix().encode() + path.read_bytes())
    python = platform.python_version()
    return f"msp-range {__version__} ({sha.hexdigest()[:12]}), Python {python}, numpy {numpy.__version__}"


@lru_cache(maxsize=1)
def _unpickled(pickled: bytes) -> Any:
    return pickle.loads(pickled)


def _attempt_all(pickled: bytes, part: Sequence[tuple[int, Any]], expected: str) -> list[ItemOutcome[Any]]:
    """Compute some items on a worker."""
    if fingerprint() != expected:
        raise OtherVersion(f"a worker on {platform.node()} has {fingerprint()}; expected {expected}, as here")
    # Kept from part to part, with what was derived from it.
    function, shared = _unpickled(pickled)
    return [_attempt(function, shared, index, item) for index, item in part]


def _attempt(function: Callable[[Any, Any], Result], shared: Any, index: int, item: Any) -> ItemOutcome[Result]:
    # Products of large matrices differ in the last digits with the number of threads.
    with threadpool_limits(limits=1):
        try:
            return ItemOutcome(index, function(shared, item), None)
        except UserError as error:
            return ItemOutcome(index, None, str(error))
        except Exception as error:  # Whatever is wrong with one item must not end the others.
            return ItemOutcome(index, None, f"{type(error).__name__}: {error}")
