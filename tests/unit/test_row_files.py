"""Through how many files a row of a CSV file goes until the first effect is named, counted while it does.

A file passes the row on when one of its functions gets the row's true range or its reading, each of which occurs once,
or an object that holds them, and hands it to a function of another file, or returns it to one. The steps of the second
walk in docs/one-ping.md are these files.
"""

import re
import sys
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

from msp_lab.gap.findings import Settings
from msp_lab.gap.steps import Steps
from msp_range.clock import VirtualClock
from msp_range.recording.csv_form import write_csv
from tests.support.measured import MODEL, ROOT, readings

MOST_FILES = 15
TRUE_CM, READING_CM = 217.0625, 801.0
"""Of the row. The model has a calibration, so that its centre is another number, and draws no reading beyond 765 cm."""
EFFECTS = "sim/msp_sim/effects/"
SCENE = EFFECTS + "base.py"
CHECKS = {
    "sim/msp_lab/gap/blank_cells.py": "finds which rows are complete, and keeps a mask",
    "sim/msp_lab/gap/profile.py": "limits the z of rare candidates by what they gain, and keeps sums",
}
"""Files that hand the row on to look at it, and of which no function's result has it."""


class Named(Exception):
    """The first name is found."""


class Trace:
    """Files that hand the row to another one, as an argument or as a result."""

    def __init__(self) -> None:
        self.files: dict[str, str] = {}
        self._known: dict[int, tuple[object, bool]] = {}

    def __call__(self, frame: FrameType, event: str, result: Any) -> None:
        if event not in ("call", "return"):
            return
        own = product_file(frame.f_code.co_filename)
        caller = frame.f_back
        while own and caller is not None and not product_file(caller.f_code.co_filename):
            caller = caller.f_back
        if not own or caller is None:
            return
        other = product_file(caller.f_code.co_filename)
        giver = own if event == "return" else other
        if own == other or giver in self.files or not counts(giver):
            return
        code = frame.f_code
        # An object that is asked for something gets nothing by it.
        names = [each for each in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount] if each != "self"]
        if self._holds(result) if event == "return" else any(self._holds(frame.f_locals.get(each)) for each in names):
            self.files[giver] = f"{event} of {code.co_qualname}"

    def _holds(self, value: Any) -> bool:
        """Whether the row is in an array, in a list of cells, or in what an object of the packages consists of."""
        if isinstance(value, np.ndarray):
            return value.dtype.kind == "f" and bool(((value == TRUE_CM) | (value == READING_CM)).any())
        if isinstance(value, list | tuple) and value and isinstance(value[0], str):
            return str(TRUE_CM) in value
        if isinstance(value, Mapping):
            return any(map(self._holds, value.values()))
        if isinstance(value, list | tuple):
            return any(map(self._holds, value))
        if isinstance(value, type) or not type(value).__module__.startswith("msp_"):
            return False
        if id(value) not in self._known:
            # What consists of itself does not hold the row for that.
            self._known[id(value)] = value, False
            self._known[id(value)] = value, self._holds(getattr(value, "__dict__", {}))
        return self._known[id(value)][1]


@cache
def product_file(path: str) -> str:
    """A file of the packages, as seen from the repository; any other is empty."""
    inside = Path(path).is_relative_to(ROOT) and Path(path).relative_to(ROOT)
    return inside.as_posix() if inside and inside.parts[0] in ("msp_range", "sim") else ""


def counts(file: str) -> bool:
    """Effects of the catalogue do not count, and neither do checks."""
    return file not in CHECKS and (file == SCENE or not file.startswith(EFFECTS))


@pytest.fixture(scope="module")
def passed_on(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("row")
    columns = readings(600, runs=6)
    columns["sensor"] = np.where(np.arange(600) % 2, "left", "right")
    columns["reading_cm"] = columns["reading_cm"] + np.where(columns["sensor"] == "left", 3.0, 0.0)
    row = 101
    columns["true_range_cm"][row], columns["reading_cm"][row] = TRUE_CM, READING_CM
    write_csv(folder / "flights.csv", columns)
    model = re.sub(
        r"(?m)^calibration: .*$",
        "calibration: [{true_cm: 0, reading_cm: 0.5}, {true_cm: 500, reading_cm: 500}]",
        MODEL.read_text(),
    )
    (folder / "model.yaml").write_text(model)
    trace = Trace()

    def report(what: str, share: float) -> None:
        if what.startswith("found "):
            raise Named

    sys.setprofile(trace)
    try:
        with pytest.raises(Named):
            Steps(folder / "gap", VirtualClock(), report).all(
                [folder / "flights.csv"], Settings(str(folder / "model.yaml"))
            )
    finally:
        sys.setprofile(None)
    return trace.files


def test_a_row_goes_through_at_most_fifteen_files(passed_on: dict[str, str]) -> None:
    assert len(passed_on) <= MOST_FILES, passed_on


def test_the_steps_of_the_walk_are_these_files(passed_on: dict[str, str]) -> None:
    walk = (ROOT / "docs" / "one-ping.md").read_text().partition("## Walk 2")[2]
    steps = re.findall(r"^\d+\. \[[^]]+\]\(\.\./([^)]+)\)", walk, re.M)
    assert sorted(steps) == sorted(passed_on)
