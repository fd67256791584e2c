"""Separate gaps of many logs or sensors: a folder and a row for each, also where one cannot be used."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from msp_lab.cli import app
from msp_range.recording.csv_form import write_csv
from tests.support.measured import MODEL, readings


def run(*arguments: Any, code: int = 0) -> str:
    result = CliRunner().invoke(app, ["gap", *map(str, arguments), "--model", str(MODEL)])
    assert result.exit_code == code, result.output
    return result.output


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "gaps.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def logs(tmp_path: Path) -> list[Path]:
    """Three logs, of which the second is none."""
    paths = [tmp_path / f"{name}.csv" for name in ("one", "two", "three")]
    for seed, path in enumerate(paths):
        write_csv(path, readings(400, seed))
    paths[1].write_text("not,a,log\n1,2,3\n", encoding="utf-8")
    return paths


def test_a_log_that_cannot_be_used_is_named_and_the_others_are_compared(logs: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    shown = run(*logs, "--out", out, "--each", "log", "--until", "compare", code=4)
    assert "two could not be compared: " in shown
    assert "two.csv" in shown
    found = rows(out)
    assert [(row["name"], row["readings"]) for row in found] == [("one", "400"), ("two", "0"), ("three", "400")]
    assert "two.csv" in found[1]["error"]
    for row in (found[0], found[2]):
        alone = json.loads((out / row["name"] / "gap.json").read_text())
        assert float(row["before_nats"]) == pytest.approx(alone["gap"]["nats_per_reading"]["before"], rel=1e-6)


def test_a_gap_for_each_sensor(tmp_path: Path) -> None:
    columns = {**readings(800, 1), "sensor": np.array(["left", "right"] * 400)}
    columns["reading_cm"][1::2] += 20.0
    write_csv(tmp_path / "both.csv", columns)
    run(tmp_path / "both.csv", "--out", tmp_path / "out", "--each", "sensor", "--until", "compare")
    left, right = rows(tmp_path / "out")
    assert (left["name"], left["readings"], right["name"], right["readings"]) == ("left", "400", "right", "400")
    assert float(right["before_nats"]) > 10 * float(left["before_nats"])


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--jobs", "2"], "separate gaps are computed on several processors: give --each"),
        (["--each", "log", "--truth", "others"], "--truth others compares the sensors with each other"),
    ],
)
def test_options_that_do_not_go_together(logs: list[Path], tmp_path: Path, options: list[str], expected: str) -> None:
    assert expected in run(*logs, "--out", tmp_path / "out", *options, code=3)


@pytest.mark.slow
def test_the_same_findings_whatever_the_number_of_jobs(logs: list[Path], tmp_path: Path) -> None:
    for jobs in (1, 2):
        run(*logs, "--out", tmp_path / str(jobs), "--each", "log", "--jobs", jobs, "--until", "add", code=4)
    one, two = rows(tmp_path / "1"), rows(tmp_path / "2")
    assert one == two
    for name in ("one", "three"):
        first, second = (json.loads((tmp_path / jobs / name / "gap.json").read_text()) for jobs in "12")
        assert first | {"seconds": 0} == second | {"seconds": 0}
