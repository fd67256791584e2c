"""Awkward tables by the command: each ends in a right answer, or in a line that reports what is wrong."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msp_lab.gap.findings import GapFindings
from msp_lab.gap.findings_file import read_findings
from msp_range.recording.csv_form import write_csv
from msp_sim.model.model import load_model
from tests.support.measured import MODEL, readings
from tests.support.programs import run

Columns = dict[str, Any]
SIGMA_CM = 1.9445


def gap(folder: Path, columns: Columns, *options: str, code: int = 0) -> str:
    write_csv(folder / "flights.csv", columns)
    given = [folder / "flights.csv", "--model", MODEL, "--out", folder / "out", *options]
    return " ".join(run("msp-lab gap", *given, code=code).output.split())


def found(folder: Path, columns: Columns, *options: str, until: str = "add") -> GapFindings:
    gap(folder, columns, *options, "--until", until)
    return read_findings(folder / "out")


def reports(findings: GapFindings, text: str) -> bool:
    return any(text in each for each in findings.messages)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c | {"true_range_cm": c["true_range_cm"] * 10.0}, "true_range_cm in millimetres?"),
        (lambda c: {name: each for name, each in c.items() if name != "true_range_cm"}, "true_range_cm"),
        (lambda c: c | {"reading_cm": np.full(400, 100.0)}, "nearly all readings are 100 cm"),
        (lambda c: c | {"throttle": np.linspace(0.0, 100.0, 400)}, "expected a share, 0 to 1"),
        (lambda c: c | {"humidity_pct": np.linspace(0.3, 0.8, 400)}, "A share? --map humidity_pct=COLUMN*100"),
        (lambda c: c | {"incidence_deg": np.linspace(0.0, 200.0, 400)}, "degrees between beam and normal"),
    ],
    ids=["truth in mm", "no truth", "stuck", "throttle in %", "humidity as a share", "incidence of a circle"],
)
def test_what_cannot_be_compared_is_reported_in_a_line(
    tmp_path: Path, change: Callable[[Columns], Columns], message: str
) -> None:
    printed = gap(tmp_path, change(readings(400)), code=3)
    assert message in printed
    assert "Traceback" not in printed
    assert not (tmp_path / "out" / "gap.json").exists()


def test_readings_of_one_run_are_parted_in_time(tmp_path: Path) -> None:
    columns = readings(1200, seed=4, runs=1)
    findings = found(tmp_path, columns)
    assert findings.runs == 1
    assert reports(findings, "Found 1 run")
    assert reports(findings, "blocks of consecutive readings")
    assert findings.verdict == "nothing missing"


@pytest.mark.slow
def test_offsets_between_runs_are_named_with_their_size(tmp_path: Path) -> None:
    n, runs = 3000, 30
    offset_cm = np.random.default_rng(6).permutation(np.linspace(-2.6, 2.6, runs))
    findings = found(tmp_path, readings(n, seed=6, runs=runs, bias=lambda _: np.repeat(offset_cm, n // runs)))
    assert [each.name for each in findings.effects] == ["run_offsets"]
    deviation = findings.effects[0].parameters["deviation_cm"]
    assert deviation.low is not None
    assert deviation.high is not None
    assert deviation.low < offset_cm.std() < deviation.high


def test_another_spread_offset_and_share_are_calibration_and_absorb_the_gap(tmp_path: Path) -> None:
    columns = readings(3000, seed=7, bias=lambda _: 0.8, sigma_cm=1.2 * SIGMA_CM, hit=0.91, missed=0.07)
    findings = found(tmp_path, columns)
    assert (findings.effects, findings.unknown) == ((), ())
    assert findings.verdict == "absorbed"
    numbers = {each.name: each for each in findings.calibration}
    assert set(numbers) == {"offset_cm", "sigma_cm", "weights.missed"}
    for name, truth in (("offset_cm", 0.8), ("sigma_cm", 1.2 * SIGMA_CM), ("weights.missed", 0.07)):
        each = numbers[name]
        assert each.low is not None
        assert each.high is not None
        # Odds of missed are reported as a share of the model's: 0.07 / 0.91 against 0.02 / 0.96.
        assert each.low < (truth if name != "weights.missed" else truth / 0.91 * 0.96) < each.high
    # What flies is calibrated.
    mixture = load_model(tmp_path / "out" / "model.yaml").sensor.reading_model
    assert mixture.sigma_cm == pytest.approx(1.2 * SIGMA_CM, rel=0.06)
    assert mixture.weights.missed == pytest.approx(0.07, abs=0.02)


@pytest.mark.slow
def test_one_true_range_and_nothing_else_is_compared(tmp_path: Path) -> None:
    """Nothing varies: there is nothing to slice by, and a scale is an offset."""
    columns = readings(600, seed=9)
    columns["reading_cm"] = columns["reading_cm"] - np.rint(columns["true_range_cm"]) + 200.0
    columns["reading_cm"] = np.where(np.abs(columns["reading_cm"] - 200.0) > 15.0, 765.0, columns["reading_cm"])
    columns["true_range_cm"] = np.full(600, 200.0)
    columns["throttle"] = np.full(600, 0.5)
    findings = found(tmp_path, columns, until="show")
    assert reports(findings, "All readings are at one true range (200 cm)")
    assert findings.effects == ()


@pytest.mark.slow
def test_a_limit_on_the_number_of_effects_that_is_reached_is_reported(tmp_path: Path) -> None:
    columns = readings(1500, 3, bias=lambda c: 4.0 * np.sin(c["true_range_cm"] / 40.0))
    named = found(tmp_path, columns, "--max-effects", "1")
    assert reports(named, "as many effects, curves and numbers of the base as may be added, 1")
    assert reports(named, "more may be missing (--max-effects 2)")
    (tmp_path / "flights.csv").unlink()
    named = found(tmp_path, columns, "--max-effects", "0")
    assert (named.effects, named.unknown) == ((), ())


@pytest.mark.slow
def test_as_many_effects_are_named_as_there_are(tmp_path: Path) -> None:
    """Eight of nine sensors are mounted off, and there is room for more: then the evidence is the limit."""
    columns = readings(2700, 3)
    sensor = np.arange(2700) % 9
    columns["sensor"] = np.char.add("s", sensor.astype(str))
    columns["reading_cm"] = np.where(columns["reading_cm"] < 700.0, columns["reading_cm"] + 3.0 * sensor, 765.0)
    named = found(tmp_path, columns, "--max-effects", "20")
    assert {each.of for each in named.effects if each.name == "mounting_offset"} == {f"s{k}" for k in range(1, 9)}
    assert not reports(named, "--max-effects")
