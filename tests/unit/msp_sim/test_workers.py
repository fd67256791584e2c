"""The same for each item of a list: results in order, and a bad item or a dead worker ends nothing."""

import gc
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from msp_range.yaml_file import ConfigError
from msp_sim import workers as module
from msp_sim.workers import ItemOutcome, Workers, workers
from tests.support.shipped import ROOT
from tests.support.waiting import LIMIT_S, until


def square(add: int, item: int) -> int:
    """Fails for 3."""
    if item == 3:
        raise ConfigError("three.yaml: expected another number")
    if item == 4:
        raise ZeroDivisionError("four")
    return item * item + add


def deadly(mark: Path, item: str) -> str:
    """Kills its process for 'die', and for 'die once' the first time."""
    if item == "die" or (item == "die once" and not mark.exists()):
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def matrix_product(seed: int, size: int) -> bytes:
    """Differs in the last digits with the number of BLAS threads."""
    import numpy as np

    values = np.random.default_rng(seed).random((size, size))
    return bytes((values @ values).tobytes())


def test_results_come_in_order_and_a_bad_item_is_named() -> None:
    found = list(Workers().map(square, [1, 3, 4, 2], 10, what="numbers"))
    assert found == [
        ItemOutcome(0, 11, None),
        ItemOutcome(1, None, "three.yaml: expected another number"),
        ItemOutcome(2, None, "ZeroDivisionError: four"),
        ItemOutcome(3, 14, None),
    ]


def test_one_job_starts_nothing() -> None:
    with workers(1, None, "a command") as found:
        assert list(found.map(square, [], 0, what="numbers")) == []
        assert [each.value for each in found.map(square, [2], 0, what="numbers")] == [4]


def test_jobs_and_a_scheduler_exclude_each_other() -> None:
    with pytest.raises(ConfigError, match="give one of them"), workers(2, "tcp://localhost:1", "a command"):
        pass


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_named_with_how_to_start_one(monkeypatch: Any) -> None:
    from distributed import Client

    monkeypatch.setattr(module, "CONNECT_S", 0.2)
    for address in ("tcp://127.0.0.1:9", "no address"):
        with pytest.raises(ConfigError) as found, workers(1, address, "a command"):
            pass
        assert f"--scheduler {address}: no Dask scheduler answered" in str(found.value)
        assert "dask worker tcp://HOST:8786 --nthreads 1" in str(found.value)
        # One that is collected while another cluster starts waits for itself without end.
        assert "connecting" not in [each.status for each in gc.get_objects() if isinstance(each, Client)]


@pytest.mark.slow
def test_four_workers_of_which_some_are_killed_do_all_that_can_be_done(tmp_path: Path) -> None:
    items = [str(number) for number in range(40)]
    items[7], items[20] = "die once", "die"
    with workers(4, None, "a command") as found:
        outcomes = list(found.map(deadly, items, tmp_path / "mark", what="items"))
        assert found.died >= 2
    assert [each.index for each in outcomes] == list(range(40))
    assert [each.value for each in outcomes if each.index != 20] == [each for each in items if each != "die"]
    assert outcomes[20].value is None
    assert outcomes[20].error is not None
    assert "each worker process that computed it died" in outcomes[20].error


@pytest.mark.slow
def test_a_worker_is_replaced_however_often_and_quickly_it_dies(tmp_path: Path, monkeypatch: Any) -> None:
    """Dask looks once whether a worker that died is back, here while it is being replaced."""
    import dask

    monkeypatch.setattr(module, "RESTART_S", 20.0)
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "100 ms"}), workers(2, None, "a command") as found:
        outcomes = list(found.map(deadly, ["die", "1"], tmp_path / "mark", what="items"))
        assert [each.value for each in outcomes] == [None, "1"]
        assert found.died >= 8


@pytest.mark.slow
def test_a_cluster_whose_processes_cannot_be_started_again_is_not_waited_for(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(module, "RESTART_S", 10.0)
    monkeypatch.setattr(module, "NEVER", "100 ms")
    with pytest.raises(ConfigError, match="none has started again for 10 s"), workers(2, None, "a command") as found:
        list(found.map(deadly, ["die"], tmp_path / "mark", what="items"))


@pytest.mark.slow
def test_a_cluster_gives_the_same_bytes_and_the_same_errors() -> None:
    products = [each.value for each in Workers().map(matrix_product, [300, 400], 1, what="products")]
    numbers = list(Workers().map(square, [1, 3, 4, 2], 10, what="numbers"))
    with workers(2, None, "a command") as found:
        assert [each.value for each in found.map(matrix_product, [300, 400], 1, what="products")] == products
        assert list(found.map(square, [1, 3, 4, 2], 10, what="numbers")) == numbers


def page_faults(_: None, size: int) -> int:
    """While arrays are made and freed."""
    import resource

    import numpy as np

    np.ones(size)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _each in range(100):
        np.ones(size)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


@pytest.mark.slow
def test_workers_keep_the_memory_that_they_free() -> None:
    """An array of 100,000 numbers is 196 pages: asked for again each time, that was a third of a gap."""
    with workers(2, None, "a command") as found:
        assert all((each.value or 0) < 1000 for each in found.map(page_faults, [100_000] * 4, None, what="arrays"))


@pytest.mark.slow
def test_a_cluster_of_another_version_or_with_threads_or_without_workers_is_refused(monkeypatch: Any) -> None:
    from distributed import LocalCluster

    options = {
        "processes": False,
        "dashboard_address": "127.0.0.1:0",
        "silence_logs": 60,
        "protocol": "tcp",
        "host": "127.0.0.1",
    }
    with LocalCluster(n_workers=1, threads_per_worker=1, **options) as cluster:
        address = cluster.scheduler_address
        with workers(1, address, "a command") as found:
            assert [each.value for each in found.map(square, [2], 0, what="numbers")] == [4]
            monkeypatch.setattr(module, "_attempt_all", other_version)
            with pytest.raises(module.OtherVersion, match="has msp-range 0"):
                list(found.map(square, [2], 0, what="numbers"))
    for size, reason in (((1, 2), "computes 2 items at a time"), ((0, 1), "it has no workers")):
        with LocalCluster(n_workers=size[0], threads_per_worker=size[1], **options) as cluster:
            address = cluster.scheduler_address
            with pytest.raises(ConfigError, match=reason), workers(1, address, "a command"):
                pass


@pytest.mark.slow
def test_a_cluster_as_the_document_starts_it(tmp_path: Path) -> None:
    """Scheduler and workers are the programs of docs/fleets.md, in a folder of their own; one worker is killed."""
    programs = Path(sys.executable).parent
    environ = {**os.environ, "PYTHONPATH": str(ROOT)}
    quiet: dict[str, Any] = {
        "cwd": tmp_path,
        "env": environ,
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
    }
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    own = ["--host", "127.0.0.1", "--port", str(port), "--dashboard-address", "127.0.0.1:0"]
    joins = ["--nworkers", "2", "--nthreads", "1", "--no-dashboard"]
    started = [subprocess.Popen([programs / "dask", "scheduler", *own], **quiet)]
    try:
        started.append(subprocess.Popen([programs / "dask", "worker", address, *joins], **quiet))
        items = ["die once" if number == 5 else str(number) for number in range(12)]
        with connected(address) as found:
            outcomes = list(found.map(deadly, items, tmp_path / "mark", what="items"))
            assert found.died == 1
        assert [each.value for each in outcomes] == items
    finally:
        # The workers first: they tell the scheduler that they end.
        for program in reversed(started):
            program.terminate()
            program.wait(LIMIT_S)


@contextmanager
def connected(address: str) -> Iterator[Workers]:
    """Workers of a cluster that is being started."""
    with ExitStack() as opened:
        found: list[Workers] = []

        def is_connected() -> bool:
            with suppress(ConfigError):
                found.append(opened.enter_context(workers(1, address, "a command")))
            return bool(found)

        until(is_connected)
        yield found[0]


def other_version(pickled: bytes, part: Any, expected: str) -> Any:
    """As a worker with other files answers."""
    raise module.OtherVersion("a worker on another has msp-range 0")


@pytest.mark.slow
def test_a_worker_without_the_program_is_named_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from distributed import LocalCluster

    without = "import sys\nsys.modules['msp_sim'] = None\n"
    (tmp_path / "sitecustomize.py").write_text(without, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    with LocalCluster(n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0") as cluster:
        address = cluster.scheduler_address
        with pytest.raises(ConfigError, match="cannot import the program") as found, workers(1, address, "a command"):
            pass
    assert "\n" not in str(found.value)
    assert "expected msp-range" in str(found.value)
