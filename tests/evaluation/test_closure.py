"""The measures of closure on simple cases whose answer is known."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from evaluation import CONFIGS
from evaluation.closure.closure import Closure, case_closed, gap_closed
from evaluation.closure.measures import ks_by_slice, separability, slices
from evaluation.closure.table import Table, comparable, step_of, table_of
from evaluation.real.commands import run_command
from tests.support.known import known

pytestmark = pytest.mark.slow


def simulated(rng: np.random.Generator, shift_cm: float = 0.0, from_cm: float = 0.0) -> Table:
    """Twelve runs of 150 readings at ranges that are the same in every table; beyond a range all are shifted."""
    true_cm = np.random.default_rng(5).uniform(30.0, 500.0, 1800)
    residual = rng.normal(0.0, 2.0, true_cm.size) + shift_cm * (true_cm > from_cm)
    outlier = rng.random(true_cm.size) < 0.05
    reading = np.where(outlier, rng.uniform(20.0, 765.0, true_cm.size), true_cm + residual)
    contexts = {"true_range_cm": true_cm, "throttle": np.random.default_rng(6).random(true_cm.size)}
    return Table(reading, contexts, np.repeat(np.arange(12).astype(str), 150))


def test_a_classifier_does_not_separate_tables_that_are_alike() -> None:
    found = [
        separability(simulated(np.random.default_rng(k)), simulated(np.random.default_rng(k + 50)), 1) for k in range(4)
    ]
    assert abs(np.mean([each.auc for each in found]) - 0.5) < 0.02
    assert -0.001 < np.mean([each.nats for each in found]) < 0.002


def test_shift_of_one_sigma_is_seen() -> None:
    one, other = simulated(np.random.default_rng(1)), simulated(np.random.default_rng(2), shift_cm=2.0)
    # Normal distributions one sigma apart: AUC 0.76, Jensen-Shannon divergence 0.11 nats; a twentieth are outliers.
    found = separability(one, other, 1)
    assert 0.68 < found.auc < 0.77
    assert 0.06 < found.nats < 0.12
    # KS of that shift is 0.38.
    assert 0.1 < ks_by_slice(one, other) < 0.38**2 + 0.02
    assert ks_by_slice(one, simulated(np.random.default_rng(3))) < 0.006


def test_shift_in_a_corner_is_seen_in_its_slice() -> None:
    one = simulated(np.random.default_rng(1))
    corner = simulated(np.random.default_rng(2), shift_cm=3.0, from_cm=420.0)
    assert separability(one, corner, 1).nats > 0.008
    far = slices(one.contexts["true_range_cm"])[-1]
    assert abs(one.residual_cm[far].mean() - corner.residual_cm[far].mean()) > 1.0
    assert ks_by_slice(one, corner) > 3 * ks_by_slice(one, simulated(np.random.default_rng(3)))


def test_rows_of_a_run_are_left_out_together() -> None:
    # An offset of each run, the same in both tables, and a context that names the run: nothing to separate, unless
    # rows of a run stand on both sides.
    one, other = simulated(np.random.default_rng(1)), simulated(np.random.default_rng(2))
    offset = np.random.default_rng(3).normal(0.0, 6.0, 12)[one.run.astype(int)]
    number = {"throttle": one.run.astype(float)}
    moved = Table(one.reading_cm + offset, one.contexts | number, one.run)
    assert separability(moved, Table(other.reading_cm, other.contexts | number, other.run), 1).nats < 0.2


def test_rows_and_steps() -> None:
    cells = {"reading_cm": ["100", "", "102", "50"], "true_range_cm": ["99.5", "99", "", "49"], "sensor": list("aaab")}
    kept = comparable(cells, "flight")
    assert kept["previous_reading_cm"] == ["", ""]
    assert kept["run"] == ["flight", "flight"]
    assert table_of(kept).residual_cm.tolist() == [0.5, 1.0]
    assert [step_of(np.array(each)) for each in ([5.0, 15.0], [1.0, 3.0], [0.1, 0.3], [0.017, 0.05])] == [
        5.0,
        1.0,
        0.1,
        0.0,
    ]


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A blind case: readings 2 % too far, and a workflow that found 2 % (`model.yaml`)."""
    folder = tmp_path_factory.mktemp("case")
    given = (CONFIGS / "sensors" / "hcsr04.yaml").read_text(encoding="utf-8")
    assert "\neffects: []" in given
    for name, percent in (("model", 2.0), ("half", 1.4)):
        effect = f"\neffects: [{{name: range_scale, parameters: {{scale_pct: {{value: {percent}}}}}}}]"
        (folder / f"{name}.yaml").write_text(given.replace("\neffects: []", effect), encoding="utf-8")
    (folder / "given.yaml").write_text(given, encoding="utf-8")
    rng = np.random.default_rng(11)
    with (folder / "contexts.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("time_s", "sensor", "run", "true_range_cm"))
        for k in range(1600):
            writer.writerow((0.1 * k, "front", f"flight {k // 200}", f"{rng.uniform(60, 400):.2f}"))
    arguments = ("--contexts", folder / "contexts.csv", "--out", folder / "measured.csv", "--seed", 77)
    done = run_command("msp-sim", "sample", folder / "model.yaml", *arguments)
    assert done.returncode == 0, done.stderr
    (folder / "gap").mkdir()
    (folder / "model.yaml").rename(folder / "gap" / "model.yaml")
    held_out = [f"flight {k}" for k in (1, 2, 4, 7)]
    (folder / "gap" / "gap.json").write_text(json.dumps({"held_out_runs": held_out}), encoding="utf-8")
    return folder


@pytest.fixture(autouse=True)
def _two_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("evaluation.closure.closure.DRAWS", 2)


def test_right_model_closes_the_gap_on_held_out_runs(case: Path) -> None:
    found = case_closed(case, case / "given.yaml")
    assert found.rows == 800
    assert found.held_out
    assert found.step_cm == 1.0
    assert closed(found, "classifier") > 93.0
    assert closed(found, "ks") > 93.0
    assert found.auc_before > 0.75
    assert abs(found.auc_after - 0.5) < 0.04


def test_part_of_the_effect_closes_part_of_the_gap(case: Path) -> None:
    found = gap_closed([case / "measured.csv"], case / "given.yaml", case / "half.yaml")
    assert not found.held_out
    assert found.rows == 1600
    # Seven tenths of the effect leave nine hundredths of what grows with its square; at 4 to 8 cm it grows by less.
    assert 60.0 < known(found.closed_pct) < 95.0


def closed(found: Closure, which: str) -> float:
    """Per cent of one measure."""
    one = found.classifier if which == "classifier" else found.ks
    assert one.closed_pct is not None
    return one.closed_pct
