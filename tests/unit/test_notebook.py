"""The packages' functions for programs and notebooks: where they are found, and what finding them costs."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import msp_lab
import msp_range
import msp_sim
from msp_range.config import load_airframe
from msp_range.reading_model.mixture import ReadingModel
from msp_sim import simulate_flight
from tests.support.shipped import ROOT


def test_each_is_what_its_module_has() -> None:
    assert msp_range.load_airframe is load_airframe
    assert msp_range.ReadingModel is ReadingModel
    assert msp_sim.simulate_flight is simulate_flight
    assert {*msp_lab.__all__} == {"read_readings", "characterise", "find_gap"}
    for package in (msp_range, msp_sim, msp_lab):
        assert all(callable(getattr(package, name)) for name in package.__all__)
        assert not hasattr(package, "something_else")
        assert dir(package) == [*package.__all__] == sorted(package.__all__)


def test_the_document_for_programs_names_what_the_packages_have() -> None:
    """Also while none of it has been imported: `dir` and completion in a notebook show it."""
    text = (ROOT / "docs/notebooks.md").read_text(encoding="utf-8")
    named = re.findall(r"^\| `(msp_\w+)\.(\w+)", text, re.M)
    program = "import msp_range, msp_sim, msp_lab\nfor p in (msp_range, msp_sim, msp_lab): print(*dir(p))"
    shown = [line.split() for line in run(program).splitlines()]
    packages = ("msp_range", "msp_sim", "msp_lab")
    assert sorted(named) == sorted(
        (package, name) for package, names in zip(packages, shown, strict=True) for name in names
    )


def run(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60.0)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_the_packages_alone_import_nothing_and_characterise_is_called_before_and_after_its_package_is_there() -> None:
    shown = run(
        "import sys, msp_range, msp_sim, msp_lab\n"
        "print({'numpy', 'pydantic', 'yaml', 'scipy', 'importlib.metadata'} & {*sys.modules})\n"
        "from msp_lab import characterise as before\n"
        "import msp_lab.characterise.points\n"
        "from msp_lab import characterise as after\n"
        "for each in (before, after):\n"
        "    try: each('none.csv')\n"
        "    except Exception as error: print(type(error).__name__)\n"
    )
    assert shown.splitlines() == ["set()", "RecordingError", "RecordingError"]


def test_a_flight_is_recorded_and_read_again(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    flight = simulate_flight("flat", seed=3, recording=path)
    assert flight.summary["seed"] == 3
    sizes = {column.size for column in flight.readings.values()}
    assert sizes == {sum(each["readings"] for each in flight.summary["sensors"].values())}
    columns = msp_lab.read_readings(path)
    known = np.isfinite(columns["true_range_cm"])
    assert known.sum() > 500
    own = flight.readings["true_range_m"][flight.readings["sensor"] == "front_left"] * 100.0
    assert np.nanmax(np.abs(columns["true_range_cm"][columns["sensor"] == "front_left"] - own)) < 1.5
    assert np.all(np.diff(flight.readings["time_s"]) >= 0.0)
