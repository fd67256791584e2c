"""What the commands import: each package is a part of a second of outage on a small computer."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.kernel_bus import Sonar, kernel_bus
from tests.support.service import LinkEnd, running_service
from tests.support.shipped import CONFIGS

LABORATORY = {
    "IPython",
    "asyncio",
    "filterpy",
    "jinja2",
    "matplotlib",
    "mcap",
    "msp_lab",
    "msp_lab.mixture_fit.fit",
    "msp_range.reading_model.mixture",
    "msp_range.recording.reader",
    "msp_range.replay",
    "msp_range.tuning",
    "msp_sim",
    "pymavlink.mavutil",
    "rich",
    "scipy",
}
"""Nothing of this is needed to fly; each takes from 20 ms to a second to import."""


def imported(stderr: str) -> set[str]:
    """Modules that a Python with ``-X importtime`` has imported, and the packages that they are in."""
    names = re.findall(r"^import time:.*\| +([\w.]+)$", stderr, re.MULTILINE)
    return {".".join(name.split(".")[:depth]) for name in names for depth in range(1, name.count(".") + 2)}


@pytest.mark.parametrize(
    ("airframe", "records", "has_changepoint"),
    [("quad_pallet", True, False), ("loopback", False, False), ("proximity", False, True)],
)
def test_flying_imports_nothing_of_the_laboratory(
    airframe: str, records: bool, has_changepoint: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Up to the first distances; a sonar equation to fit is among what is done for them.

    numpy comes with a changepoint or Kalman filter of a single stream only, filterpy and scipy with the latter.
    """
    options = ["--record", str(tmp_path / "recordings")] if records else ["--no-record"]
    with kernel_bus([Sonar(0x70 + number) for number in range(4)]) as testbed, LinkEnd() as end:
        monkeypatch.setenv("PYTHONPROFILEIMPORTTIME", "1")
        path = CONFIGS / f"{airframe}.yaml"
        with running_service(testbed, end.url, tmp_path, *options, airframe=path) as service:
            end.run_until(lambda: len(end.distances) >= 4)
            assert service.stop() == 0
    modules = imported((tmp_path / "log.jsonl").read_text())
    assert "msp_range.bridge" in modules
    assert modules & LABORATORY == ({"mcap"} if records else set())  # It packs the records of a file's frame.
    assert ("zstandard" in modules) is records
    assert ("numpy" in modules) is has_changepoint


@pytest.mark.parametrize(
    ("arguments", "heavy"),
    [
        (["--help"], LABORATORY | {"numpy", "pymavlink"}),
        (["check", str(CONFIGS / "quad_pallet.yaml")], LABORATORY - {"rich"}),
    ],
    ids=["help", "check"],
)
def test_help_and_check_are_quick(arguments: list[str], heavy: set[str]) -> None:
    command = [sys.executable, "-X", "importtime", "-c", "from msp_range.cli import main; main()"]
    done = subprocess.run([*command, *arguments], capture_output=True, text=True, timeout=60.0)
    assert done.returncode == 0
    assert imported(done.stderr) & heavy == set()


def test_each_command_has_one_thread_of_blas_before_numpy_is_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    program = "import os, sys, msp_range.start; print(os.environ['OPENBLAS_NUM_THREADS'], 'numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "1 False\n"


def test_imports_are_not_searched_for_garbage_and_a_command_is() -> None:
    """Imports make some 100,000 objects that stay; to look for garbage among them takes a twentieth of their time."""
    program = """
import gc, msp_range.start, msp_range.cli
from msp_range.user_errors import report_user_errors
print(gc.isenabled())
report_user_errors(lambda: print(gc.isenabled(), gc.get_freeze_count() > 10_000))()
before = gc.get_freeze_count()
report_user_errors(lambda: print(gc.get_freeze_count() == before))()  # a second one keeps no garbage for ever
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "False\nTrue True\nTrue\n"


@pytest.mark.parametrize("command", ["msp-range", "msp-sim", "msp-lab"])
def test_each_command_imports_that_first(command: str) -> None:
    program = [str(Path(sys.executable).with_name(command)), "--help"]
    environment = os.environ | {"PYTHONPROFILEIMPORTTIME": "1"}
    done = subprocess.run(program, capture_output=True, text=True, check=True, env=environment)
    modules = [line.rpartition("|")[2].strip() for line in done.stderr.splitlines()]
    own = [each for each in modules if each.startswith(("msp_range.", "msp_sim.", "msp_lab."))]
    assert own[0] == "msp_range.start"
    assert f"{command.replace('-', '_')}.cli" in own


@pytest.mark.slow
def test_the_functions_for_programs_compute_with_one_thread_of_blas(tmp_path: Path) -> None:
    """Also where numpy is imported before: a notebook's first line."""
    (tmp_path / "a.csv").touch()
    for module, name, inside in (
        ("msp_lab.gap.steps", "find_gap(folder / 'a.csv')", "Steps.all"),
        ("msp_lab.characterise.from_files", "characterise(folder / 'a.csv')", "characterised"),
        ("msp_sim.flight.simulate", "simulate_flight('flat')", "Simulation.fly"),
    ):
        program = f"""
import numpy, pathlib, threadpoolctl, {module} as module
def threads(*args, **kwargs):
    print({{each["num_threads"] for each in threadpoolctl.threadpool_info()}})
    raise SystemExit
folder = pathlib.Path({str(tmp_path)!r})
module.load_readings = module.without_impossible = lambda *args: None
module.{inside} = threads
module.{name}
"""
        environment = os.environ | {"OPENBLAS_NUM_THREADS": "2", "OMP_NUM_THREADS": "2"}
        command = [sys.executable, "-c", program]
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=True)
        assert done.stdout == "{1}\n", module
