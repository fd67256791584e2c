"""What all tests need of the process that runs them, and which of them may run at the same time."""

import os
import re
import signal
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling

# Before numpy is imported. There are more processes of tests than processors, and matrices are small: more threads only
# wait for each other, in 15 % more processor time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

WALL_CLOCK = re.compile(
    r"\btime\.(monotonic|perf_counter|sleep|time)\(|^(import|from) socket\b"
    r"|\bkernel_bus\b|\brunning_service\b|\bLinkEnd\b|\breal_time\b",
    re.M,
)
"""A module of tests in which this is found depends on the wall clock: it reads it, or talks to another program. Such a
test has a module of its own, apart from those that compute."""


class OneModuleOneProcess(LoadScopeScheduling):
    """Each module's tests in one process, and all that depend on the wall clock one after the other in one.

    Two of those at a time would keep each other from the processor, and see delays that are not the product's.
    """

    def _split_scope(self, nodeid: str) -> str:
        return _group(nodeid.split("::")[0])


@cache
def _group(module: str) -> str:
    path = Path(__file__).parents[1] / module
    real_time = {"peers", "sitl"} & {*path.parts} or WALL_CLOCK.search(path.read_text(encoding="utf-8"))
    return "real time" if real_time else module


def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One process more than processors: the one with the tests that depend on the wall clock waits half of its time."""
    return len(os.sched_getaffinity(0)) + 1


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Processes that only compute leave the processor to the one with the wall clock, which begins with those tests."""
    if "PYTEST_XDIST_WORKER" in os.environ and _group(item.nodeid.split("::")[0]) != "real time":
        _give_way()


@cache
def _give_way() -> None:
    os.nice(5)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> OneModuleOneProcess:
    """Called by xdist where there are several processes."""
    return OneModuleOneProcess(config, log)


@pytest.fixture(autouse=True, scope="session")
def _own_runtime_folder() -> Iterator[None]:
    """Bridges of tests are watched at a place of their own, whose path is short enough for a socket."""
    with pytest.MonkeyPatch.context() as patch, TemporaryDirectory(prefix="msp-") as folder:
        patch.setenv("XDG_RUNTIME_DIR", folder)
        yield


@pytest.fixture(autouse=True, scope="session")
def _sigint_is_not_ignored() -> Iterator[None]:
    """A shell starts what is to run in the background with SIGINT ignored, and so would be all that tests start."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
