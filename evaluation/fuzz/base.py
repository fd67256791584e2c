"""The loop that all areas of the fuzzing share.

An area makes inputs from a seeded generator and has a check that reads one input with the project's own code. The
check runs in a child process whose address space is limited, so that a crash, an endless loop or a growing heap is a
finding and not the end of the run. Inputs that fail are saved under ``build/fuzz`` and named in the result.
"""

import ctypes
import gc
import itertools
import multiprocessing
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import NamedTuple

from evaluation.memory import ALL_ADDRESSES, memory_mb
from msp_range.input_file import CONTROL

Check = Callable[[bytes], None]
"""Reads one input. The project's own errors are caught inside; whatever it raises is a failure."""
Prepare = Callable[[Path], Check]
"""Makes the check in the child process; the folder is the child's own, for files. A function of a module (pickled)."""

FOLDER = Path("build/fuzz")
SLOW_S = 2.0
"""Longest time that one input may take [s of processor time, so that a busy machine is no finding]: what a
person waits before he takes a program for dead."""
STUCK_S = 60.0
"""A child that has not answered for so long [s] waits for something and is ended."""
MEMORY_MB = 200.0
"""Memory that reading one input may take beyond what the program has after its start: a small computer
has that much to spare."""
GROWTH_MB = 20.0
"""Growth of the child's memory over the whole run that is a failure: more than caches, and
less than a leak of a byte for each byte read."""
WARM_UP_CASES = 100
"""Cases before the memory is measured for the first time, and between two measurements: caches fill first. More hides
slow leaks in short runs."""


def check_message(text: str, folder: Path, longest: int) -> None:
    """A message that a person can read: it names a file in the folder, is not endless, and prints as it is."""
    assert text.strip(), "an empty message"
    assert str(folder) in text, f"no file is named: {text[:500]}"
    assert len(text) <= longest, f"a message of {len(text)} characters"
    assert CONTROL.search(text) is None, f"a control character is printed: {text[:500]!r}"


class FuzzResult(NamedTuple):
    """What a run of one area found."""

    area: str
    cases: int
    seconds: float
    growth_mb: float
    slowest_s: float
    failures: list[str]


class _Answer(NamedTuple):
    """What the child reports of one input: None or what went wrong, processor time [s], memory where measured [MB]."""

    failure: str | None
    seconds: float
    held_mb: float | None = None


def run(
    area: str, seconds: float, seed: int, make: Callable[[Random], bytes], prepare: Prepare, fewest: int = 5
) -> FuzzResult:
    """Check inputs of ``make`` until the time is over.

    Parameters
    ----------
    area
        Name in the result and in the names of saved inputs.
    seconds
        How long, from when the child is ready.
    seed
        Of the generator that ``make`` gets: the same seed gives the same inputs.
    make
        Draws one input.
    prepare
        Makes the check in the child process; it should exercise the check once, so that what is imported late is
        there before the memory is limited.
    fewest
        So many inputs are checked at least, also where a busy computer takes longer for them.
    """
    rng = Random(seed)
    failures: dict[str, str] = {}
    growth_mb = slowest_s = 0.0
    child: _Child | None = _Child(prepare)
    start_s = time.monotonic()
    case = 0
    for case in itertools.count(1):
        if case > fewest and time.monotonic() - start_s > seconds:
            case -= 1
            break
        data = make(rng)
        child = child or _Child(prepare)
        answer = child.check(data)
        slowest_s = max(slowest_s, answer.seconds)
        growth_mb = max(growth_mb, child.growth_mb)
        failure = answer.failure
        if failure is None and answer.seconds > SLOW_S:
            failure = f"slow: {answer.seconds:.1f} s"
        # One finding each: the same cause at the same place is saved once.
        if failure is not None and failure.splitlines()[0] not in failures:
            FOLDER.mkdir(parents=True, exist_ok=True)
            saved = FOLDER / f"{area}-{seed}-{case}"
            saved.write_bytes(data)
            failures[failure.splitlines()[0]] = f"{saved}: {failure}"
        if not child.is_alive:
            child = None
    if child is not None:
        child.end()
    found = list(failures.values())
    if growth_mb > GROWTH_MB:
        found.append(f"{area}: memory grew by {growth_mb:.1f} MB, expected at most {GROWTH_MB:.0f}")
    return FuzzResult(area, case, time.monotonic() - start_s, growth_mb, slowest_s, found)


class _Child:
    """The process that checks inputs."""

    def __init__(self, prepare: Prepare) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, prepare), daemon=True)
        self._process.start()
        theirs.close()
        self._warm_mb: float | None = None
        self.growth_mb = 0.0
        self.is_alive = True
        started = self._receive(timeout_s=120.0)
        if started.failure is not None:
            raise RuntimeError(f"the check could not be prepared: {started.failure}")

    def check(self, data: bytes) -> _Answer:
        """What the check made of an input."""
        self._connection.send(data)
        answer = self._receive(STUCK_S)
        if answer.held_mb is not None:
            self._warm_mb = self._warm_mb or answer.held_mb
            self.growth_mb = answer.held_mb - self._warm_mb
        return answer

    def end(self) -> None:
        """End the process."""
        self._connection.send(None)
        self._process.join()

    def _receive(self, timeout_s: float) -> _Answer:
        try:
            if self._connection.poll(timeout_s):
                answer: _Answer = self._connection.recv()
                return answer
            self._process.kill()
            failure = f"stuck: no answer within {timeout_s:.0f} s"
        except (EOFError, ConnectionResetError):
            failure = ""
        self._process.join()
        self.is_alive = False
        code = self._process.exitcode or 0
        name = signal.Signals(-code).name if code < 0 else f"exit code {code}"
        return _Answer(failure or f"the process died: {name}", 0.0)


def _serve(connection: Connection, prepare: Prepare) -> None:
    """The child: check what comes in, until nothing comes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # Of an overflow or an invalid value in numpy, a person would see lines that say nothing to him.
    warnings.simplefilter("error", RuntimeWarning)
    with tempfile.TemporaryDirectory() as folder:
        try:
            check = prepare(Path(folder))
        except BaseException:
            connection.send(_Answer(traceback.format_exc(), 0.0))
            return
        connection.send(_Answer(None, 0.0))
        for case in itertools.count(1):
            data = connection.recv()
            if data is None:
                return
            limit = int(1e6 * (memory_mb(ALL_ADDRESSES) + MEMORY_MB))
            resource.setrlimit(resource.RLIMIT_AS, (limit, resource.RLIM_INFINITY))
            start_s = time.process_time()
            failure = _failure(check, data)
            seconds = time.process_time() - start_s
            resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            connection.send(_Answer(failure, seconds, None if case % WARM_UP_CASES else _held_mb()))


def _failure(check: Check, data: bytes) -> str | None:
    """None, or what the check raised: its type and place in the first line, then the traceback."""
    try:
        check(data)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)[-1]
        first = f"{type(error).__name__} in {Path(place.filename).name}:{place.lineno} {place.name}"
        return f"{first}\n{traceback.format_exc(limit=-12)}"
    return None


def _held_mb() -> float:
    """Resident memory that is in use: without garbage, and without what the allocator keeps for later [MB]."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    return memory_mb()


def show(result: FuzzResult) -> None:
    """Print a result, with every failure."""
    rate = result.cases / max(result.seconds, 1e-9)
    print(
        f"{result.area}: {result.cases} cases in {result.seconds:.0f} s ({rate:.0f} per s), "
        f"slowest {result.slowest_s:.2f} s, "
        f"memory grew by {result.growth_mb:.1f} MB, {len(result.failures)} failures"
    )
    for failure in result.failures:
        print(f"  {failure}", file=sys.stderr)
