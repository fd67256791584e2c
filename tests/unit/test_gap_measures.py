"""The four measures of a gap against what was put in, by a generator that shares no code with the model."""

from typing import Any

import numpy as np
import pytest

from msp_lab.gap.cell_fits import CellFits
from msp_lab.gap.cells import partitions
from msp_lab.gap.measures import HeldOutReadings, Measures, measure, replicates, usable
from msp_lab.gap.slices import ranked
from msp_sim.model.model import load_model
from tests.support.measured import MODEL, readings

MODEL_GIVEN = load_model(MODEL)


def table_of(columns: dict[str, Any], units: int = 50) -> HeldOutReadings:
    contexts = {name: columns[name] for name in ("true_range_cm", "throttle")}
    n = columns["reading_cm"].size
    return HeldOutReadings(columns["reading_cm"], contexts, (np.arange(n) * units // n).astype(np.intp))


def measured(columns: dict[str, Any]) -> tuple[Measures, dict[str, float]]:
    table = table_of(columns)
    parts = partitions(table.contexts)
    drawn = replicates(MODEL_GIVEN, table, parts, 5, np.random.default_rng(7))
    return measure(MODEL_GIVEN, table, parts, drawn), dict(drawn.noise_floor)


def test_nothing_missing_is_within_the_floor() -> None:
    found, floor = measured(readings(4000))
    for name, number in found.numbers.items():
        assert number.value <= 1.5 * floor[name] + 0.002, name
    assert found.numbers["nats_per_reading"].low == 0.0


@pytest.mark.parametrize("bias_cm", [-1.0, 12.0])
def test_an_offset_is_measured_in_centimetres_also_where_it_is_many_sigma(bias_cm: float) -> None:
    found, _ = measured(readings(4000, bias=lambda _: bias_cm))
    assert found.numbers["bias_cm"].value == pytest.approx(abs(bias_cm), abs=0.12)
    assert found.numbers["bias_cm"].low < abs(bias_cm) < found.numbers["bias_cm"].high
    assert found.numbers["spread_ratio"].value < 1.1


def test_a_bias_that_cancels_over_all_is_seen_in_its_slices() -> None:
    found, _ = measured(readings(6000, bias=lambda c: np.where(c["throttle"] > 0.5, 1.5, -1.5)))
    assert found.numbers["bias_cm"].value == pytest.approx(1.5, abs=0.15)


@pytest.mark.parametrize("factor", [0.7, 1.5])
def test_the_spread_is_a_ratio_either_way(factor: float) -> None:
    found, _ = measured(readings(4000, sigma_cm=1.9445 * factor))
    assert found.numbers["spread_ratio"].value == pytest.approx(max(factor, 1.0 / factor), rel=0.06)


@pytest.mark.parametrize("name", ["short", "missed", "random"])
def test_odds_of_each_class(name: str) -> None:
    usual: dict[str, Any] = {"short": 0.01, "missed": 0.02, "random": 0.01}
    shares = usual | {name: 0.06}
    hit = 1.0 - sum(shares.values())
    found, _ = measured(readings(6000, hit=hit, **shares))
    truth = (shares[name] / hit) / (usual[name] / 0.96)
    assert found.numbers[f"odds_{name}"].value == pytest.approx(truth, rel=0.25)


def test_nats_are_the_gain_of_the_right_model() -> None:
    """For a bias of the hits: half its square over the variance, times the share of hits."""
    found, _ = measured(readings(8000, bias=lambda _: 1.0))
    assert found.numbers["nats_per_reading"].value == pytest.approx(0.96 * 0.5 * (1.0 / 1.9445) ** 2, rel=0.15)


def test_what_the_model_cannot_give_is_separated() -> None:
    columns = readings(500)
    columns["reading_cm"][:20] = 40000.0
    assert (~usable(MODEL_GIVEN, table_of(columns))).sum() == 20


def test_slices_say_where_and_are_corrected_for_their_number() -> None:
    rng = np.random.default_rng(3)
    table = table_of(readings(4000, bias=lambda c: np.where(c["throttle"] > 0.9, 2.0, 0.0)))
    parts = partitions(table.contexts)
    drawn = replicates(MODEL_GIVEN, table, parts, 5, rng)
    slices = ranked(measure(MODEL_GIVEN, table, parts, drawn), rng)
    assert slices[0].variables == ()
    first = slices[1]
    assert "throttle" in first.variables
    assert first.channel == "bias"
    assert first.p_value is not None
    assert first.p_value < 0.01
    whole_throttle = [each for each in slices if each.variables == ("throttle",)]
    assert whole_throttle[0].bias_cm == pytest.approx(2.0, abs=0.6)
    # A false slice in one of twenty tables at most; here none in six.
    for seed in range(6):
        null = table_of(readings(1500, seed=10 + seed))
        null_parts = partitions(null.contexts, pairs=False)
        few = replicates(MODEL_GIVEN, null, null_parts, 3, rng)
        assert min(each.p_value or 1.0 for each in ranked(measure(MODEL_GIVEN, null, null_parts, few), rng)[:3]) > 0.01


def test_errors_are_those_of_units_that_share_an_offset() -> None:
    columns = readings(4000, runs=40)
    shift = np.random.default_rng(5).normal(0.0, 1.0, 40)
    run = np.arange(4000) * 40 // 4000
    columns["reading_cm"] = np.clip(columns["reading_cm"] + np.rint(shift[run] * 3.0), 20, 765)
    contexts = {name: columns[name] for name in ("true_range_cm", "throttle")}
    parts = partitions(contexts, pairs=False)
    whole = {}
    for name, unit in (("run", run), ("reading", np.arange(4000))):
        table = HeldOutReadings(columns["reading_cm"], contexts, unit.astype(np.intp))
        drawn = replicates(MODEL_GIVEN, table, parts, 3, np.random.default_rng(1))
        whole[name] = measure(MODEL_GIVEN, table, parts, drawn).fits[()].errors[0, 0]
    # 40 offsets of 3 cm: 0.47 cm, where independent readings would make it 0.05.
    assert whole["run"] == pytest.approx(0.47, rel=0.4)
    assert whole["reading"] < 0.15


@pytest.mark.slow
def test_the_floor_of_readings_that_depend_on_each_other_is_that_of_their_runs() -> None:
    for seed in range(4):
        columns = readings(4000, seed=20 + seed, runs=20)
        rng = np.random.default_rng(seed)
        drift = np.zeros((20, 200))
        drift[:, 0] = rng.standard_normal(20)
        for k in range(1, 200):
            drift[:, k] = 0.9 * drift[:, k - 1] + np.sqrt(1.0 - 0.81) * rng.standard_normal(20)
        heard = np.abs(columns["reading_cm"] - columns["true_range_cm"]) < 12.0
        # Whole centimetres of the drift, with the whole spread as the model has it.
        shifted = np.rint(columns["true_range_cm"] + 1.9445 * drift.ravel())
        columns["reading_cm"] = np.where(heard, np.clip(shifted, 20, 764), columns["reading_cm"])
        unit = np.arange(4000) * 20 // 4000
        contexts = {name: columns[name] for name in ("true_range_cm", "throttle")}
        contexts["run"] = unit.astype(str)
        table = HeldOutReadings(columns["reading_cm"], contexts, unit.astype(np.intp))
        parts = partitions(contexts)
        drawn = replicates(MODEL_GIVEN, table, parts, 10, np.random.default_rng(7))
        found = measure(MODEL_GIVEN, table, parts, drawn)
        assert found.numbers["bias_cm"].value < 1.3 * drawn.noise_floor["bias_cm"]
        assert found.numbers["nats_per_reading"].value < 1.3 * drawn.noise_floor["nats_per_reading"] + 0.002


def test_what_noise_adds_to_a_mean_square_is_subtracted() -> None:
    rng = np.random.default_rng(6)
    cells, error = 4000, 0.3

    def square(bias_cm: float) -> float:
        values = np.tile([bias_cm, 0.0, 0.0, 0.0, 0.0], (cells, 1)) + error * rng.standard_normal((cells, 5))
        errors = np.full((cells, 5), error)
        fit = CellFits(np.full(cells, 50, dtype=np.intp), values, errors, np.zeros(cells), np.zeros(cells))
        found, of_it = fit.mean_square("bias")
        assert abs(found - bias_cm**2) < 4.0 * of_it
        return found

    assert abs(square(0.0)) < 0.02
    assert square(0.5) == pytest.approx(0.25, abs=0.03)


def test_of_three_runs_no_slice_is_sure() -> None:
    rng = np.random.default_rng(7)
    table = table_of(readings(900, seed=7, bias=lambda c: np.where(c["throttle"] > 0.5, 1.0, 0.0)), units=3)
    parts = partitions(table.contexts, pairs=False)
    slices = ranked(measure(MODEL_GIVEN, table, parts, replicates(MODEL_GIVEN, table, parts, 3, rng)), rng)
    assert min(each.p_value or 1.0 for each in slices) > 0.05


def test_what_few_runs_say_of_a_cell_is_not_noise_without_bounds() -> None:
    """A cell of one run that has outliers where the model has none: its noise is that of its own readings."""
    rng = np.random.default_rng(3)
    n = 600
    columns = {
        "true_range_cm": rng.uniform(100.0, 300.0, n),
        "throttle": np.where(np.arange(n) < 60, 1.0, 0.0),
    }
    reading_cm = np.rint(columns["true_range_cm"] + 1.9 * rng.standard_normal(n))
    reading_cm[:60] = np.rint(rng.uniform(400.0, 700.0, 60))
    unit = np.repeat(np.arange(10), 60).astype(np.intp)
    table = HeldOutReadings(reading_cm, columns, unit)
    parts = partitions(table.contexts)
    drawn = replicates(MODEL_GIVEN, table, parts, 5, np.random.default_rng(1))
    slices = ranked(measure(MODEL_GIVEN, table, parts, drawn), np.random.default_rng(1))
    (full,) = [each for each in slices if each.where == "throttle 1"]
    assert full.nats is not None
    assert 1.0 < full.nats < 10.0
    assert full.p_value is not None
    assert full.p_value < 0.01
