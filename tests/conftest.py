"""What all tests need of the process that runs them, and which of them may run at the same time."""

import gc
import os
import re
import signal
from collections import Counter
from collections.abc import Generator, Iterator
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadScopeScheduling

# Before numpy is imported. There are more processes of tests than processors, and matrices are small: more threads only
# wait for each other, in 15 % more processor time with OpenBLAS, and three times as much and more with OpenMP.
for _threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_threads, "1")

# Without a limit of time for an example: on a busy computer any of them may take long. Fixtures may be one for all.
UNCHECKED = [HealthCheck.too_slow, HealthCheck.function_scoped_fixture]
settings.register_profile("busy computer", deadline=None, suppress_health_check=UNCHECKED)
settings.load_profile("busy computer")

WALL_CLOCK = re.compile(
    r"\btime\.(monotonic|perf_counter|sleep|time)\(|^(import|from) socket\b"
    r"|\bkernel_bus\b|\brunning_service\b|\bLinkEnd\b|\breal_time\b|\btests\.support\.waiting\b",
    re.M,
)
"""A module of tests in which this is found depends on the wall clock: it reads it, waits, or talks to another program.
Such a test has a module of its own, apart from those that compute."""
ALONE = ("tests/docs/", "tests/real/")
"""Folders of tests of which each is long and stands alone. Documents in real time only wait for what they start."""


class OneModuleOneProcess(LoadScopeScheduling):
    """Each module's tests in one process, and all that depend on the wall clock one after the other in one.

    Two of those at a time would keep each other from the processor, and see delays that are not the product's. The
    order is that of `pytest_collection_modifyitems`.
    """

    def __init__(self, config: pytest.Config, log: Any) -> None:
        config.option.loadscopereorder = False
        super().__init__(config, log)

    def _split_scope(self, nodeid: str) -> str:
        module = nodeid.split("::")[0]
        # Documents in real time use the same ports, so they follow each other.
        return nodeid if module.startswith(ALONE) and not _has_clock(module) else _group(module)


@cache
def _has_clock(module: str) -> bool:
    path = Path(__file__).parents[1] / module
    return "sitl" in path.parts or WALL_CLOCK.search(path.read_text(encoding="utf-8")) is not None


def _group(module: str) -> str:
    return "real time" if _has_clock(module) and not module.startswith(ALONE) else module


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is collected lasts to the end: looking for garbage among it takes a fifth of the time of collecting."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What takes longest begins first, so that no process computes alone at the end."""
    modules = [item.nodeid.split("::")[0] for item in items]
    slow = Counter(module for module, item in zip(modules, items, strict=True) if item.get_closest_marker("slow"))
    number = Counter(modules)

    def rank(item: pytest.Item) -> tuple[bool, bool, bool, int, int]:
        module = item.nodeid.split("::")[0]
        if _group(module) == "real time":
            return False, False, False, 0, 0
        is_long = module.startswith((*ALONE, "tests/peers/"))
        return True, not _has_clock(module), not is_long, -slow[module], -number[module]

    items.sort(key=rank)


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
