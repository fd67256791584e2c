"""Peers of the gap workflow (`evaluation.blind_peers`) do what their names say; some skip without the extra `bench`."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from evaluation.blind_peers import power
from evaluation.blind_peers.command import score, show
from evaluation.blind_peers.detectors import classifier, compare, ks_by_slice, pted_as_it_comes
from evaluation.blind_peers.detectors import with_pairs_swapped as swapped
from evaluation.blind_peers.library import LEAST, Library, fitted, library, previous
from evaluation.blind_peers.namers import (
    aic_stepwise,
    bic_stepwise,
    every_two_sigma,
    pastis_stepwise,
    pysindy_stlsq,
)
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.model.model import Model

pytestmark = pytest.mark.slow

N = 1500


@pytest.fixture(scope="module")
def model() -> Model:
    """The sensor of the project, without effects."""
    sensor = load_sensor_model("configs/sensors/mb1242.yaml")
    return Model.of(sensor.model_copy(update={"effects": ()}))


def table(
    seed: int, scale: float = 1.0, at_33: float = 0.0, n: int = N
) -> tuple[dict[str, NDArray[Any]], NDArray[Any]]:
    """Readings drawn by hand: normal about the range, a few missed, short or anywhere."""
    rng = np.random.default_rng(seed)
    true_cm = rng.uniform(60.0, 350.0, n)
    reading = np.rint(scale * true_cm + 2.0 * rng.standard_normal(n))
    kind = rng.random(n)
    reading = np.where(kind < 0.02, 765.0, reading)
    reading = np.where((kind > 0.02) & (kind < 0.04), np.rint(rng.uniform(20.0, true_cm)), reading)
    reading = np.where((kind > 0.04) & (kind < 0.06), rng.integers(20, 766, n), reading)
    reading = np.where(rng.random(n) < at_33, 33.0, reading)
    contexts = {
        "time_s": 0.1 * np.arange(n),
        "sensor": np.full(n, "front"),
        "run": np.repeat(np.char.add("r", np.arange(20).astype(str)), n // 20),
        "true_range_cm": true_cm,
        "throttle": rng.uniform(0.2, 0.8, n),
    }
    return contexts, reading


def toy(errors: list[float], n: int = 4000) -> Library:
    """A library of unrelated scores, each so many standard errors from nothing; 0 to k are their names."""
    rng = np.random.default_rng(3)
    scores = rng.standard_normal((n, 1 + len(errors)))
    scores = np.linalg.qr(scores - scores.mean(axis=0))[0]
    # A score's sum over its root sum of squares is z, so ones are added along it.
    scores[:, 1:] += np.asarray(errors) / n
    names, none = tuple(map(str, range(len(errors)))), np.zeros(len(errors), dtype=bool)
    return Library(scores[:, :1], scores[:, 1:], names, none, none, np.full(n, np.log(0.1)))


def test_stepwise_adds_what_its_penalty_allows() -> None:
    found = toy([1.0, 1.7, 3.2, 5.0] + [0.0] * 16)
    # Penalties: 1 nat is 1.41 standard errors, half log 4000 is 2.88, log(20 / 0.05) is 3.46.
    assert aic_stepwise(found) == {"1", "2", "3"}
    assert every_two_sigma(found) == {"2", "3"}
    assert bic_stepwise(found) == {"2", "3"}
    assert pastis_stepwise(found) == {"3"}


def test_stepwise_does_not_name_both_of_two_that_are_alike() -> None:
    one = toy([6.0])
    no = np.zeros(2, dtype=bool)
    twice = Library(one.base, np.repeat(one.scores, 2, axis=1), ("0", "1"), no, no, one.log_p)
    assert len(bic_stepwise(twice)) == 1
    assert every_two_sigma(twice) == {"0", "1"}


def test_what_cannot_be_negative_is_not_named_for_being_so() -> None:
    one = toy([-6.0])
    assert bic_stepwise(one) == {"0"}
    assert bic_stepwise(replace(one, one_sided=np.array([True]))) == set()


def test_what_acts_on_two_readings_gains_no_more_than_they_can() -> None:
    n = 1000
    scores = np.zeros((n, 1))
    scores[:2] = np.sqrt(0.5)
    base = np.linalg.qr(np.random.default_rng(1).standard_normal((n, 1)))[0]
    no = np.array([False])
    few = Library(base, scores, ("few",), no, ~no, np.full(n, np.log(0.5)))
    # A shift of two readings: half a nat each; a mixture: log 2 each. Half log 1000 is 3.5.
    assert bic_stepwise(few) == set()
    assert bic_stepwise(replace(few, moves=no)) == set()
    assert bic_stepwise(replace(few, moves=no, log_p=np.full(n, np.log(0.01)))) == {"few"}


def test_one_number_gives_what_any_share_of_added_readings_gains(model: Model) -> None:
    contexts, reading = table(1, at_33=0.02)
    scores = library(model, contexts, reading)
    # p with a share e of c is p (1 + e (c / p - 1)), so log(1 + S theta) is the likelihood itself.
    base = fitted(model, contexts, reading)
    shape: dict[str, Any] = {"location_cm": 33.0, "sigma_cm": 2.0}
    assert "clutter" in scores.names
    fifth = np.expm1(
        base.adding("clutter", share=0.2, **shape).log_prob(reading, contexts) - base.log_prob(reading, contexts)
    )
    tenth = np.expm1(
        base.adding("clutter", share=0.1, **shape).log_prob(reading, contexts) - base.log_prob(reading, contexts)
    )
    np.testing.assert_allclose(fifth, 2.0 * tenth, rtol=1e-8, atol=1e-10)
    assert "clutter" in bic_stepwise(scores) & pastis_stepwise(scores)


def test_base_is_fitted_before_anything_is_added(model: Model) -> None:
    contexts, reading = table(2)
    base = library(model, contexts, np.where(reading < 700.0, reading + 3.0, reading)).base
    # The rate of the short ones has nothing to be fitted to: by hand they are anywhere.
    assert np.abs(base.sum(axis=0) / np.sqrt((base**2).sum(axis=0)))[:5].max() < 0.2


def test_a_scale_is_found_and_nothing_where_there_is_nothing(model: Model) -> None:
    contexts, reading = table(3)
    assert pastis_stepwise(library(model, contexts, reading)) == set()
    contexts, reading = table(3, scale=1.004)
    assert pastis_stepwise(library(model, contexts, reading)) & {"range_scale", "bend", "threshold_walk"}


def test_reading_that_cannot_be_counts_as_improbable(model: Model) -> None:
    contexts, reading = table(4)
    reading[7] += 32768.0
    assert np.isfinite(library(model, contexts, reading).scores).all()
    assert LEAST > 0.0


def test_reading_before_is_of_the_same_sensor_and_run() -> None:
    contexts = {"time_s": np.array([0.2, 0.0, 0.1, 0.3]), "sensor": np.array(["a", "a", "b", "a"])}
    before = previous({**contexts, "run": np.array(["1", "1", "1", "2"])}, np.array([20.0, 30.0, 40.0, 50.0]))
    np.testing.assert_array_equal(before, [30.0, np.nan, np.nan, np.nan])


def test_swapped_pairs_keep_their_promise_where_contexts_are_shared() -> None:
    rng = np.random.default_rng(5)
    p_values = []
    for _ in range(150):
        context = rng.standard_normal((60, 2))
        one, other = (np.column_stack([rng.standard_normal(60), context]) for _ in range(2))
        p_values.append(swapped(one, other, rng)[1])
    # 0.05 of 150 is 7.5, of which 15 or more have a probability of 1 %.
    assert np.mean(np.array(p_values) <= 0.05) < 0.1
    assert 0.4 < np.mean(p_values) < 0.6


def test_energy_distance_of_two_points_by_hand() -> None:
    one, other = np.array([[0.0], [2.0]]), np.array([[1.0], [5.0]])
    # 2 E|x - y| - E|x - x'| - E|y - y'| = 2 (1 + 5 + 1 + 3) / 4 - 1 - 2.
    assert swapped(one, other, np.random.default_rng(1))[0] == pytest.approx(2.0)


def test_slices_find_a_shift_that_all_readings_have(model: Model) -> None:
    rng = np.random.default_rng(6)
    contexts, reading = table(6)
    data = compare(model, contexts, reading + 2.0, rng)
    assert len(data.slices) == 1 + 2 * 4
    assert ks_by_slice(data, rng) < 0.001


def test_table_of_counts(tmp_path: Path) -> None:
    answers = tmp_path / "answers"
    answers.mkdir()
    hidden = [("slow_clock", 6.0), ("read_late", 10.0), None]
    for number, each in enumerate(hidden):
        reported = {
            "BIC stepwise": {"names": ["range_scale"], "seconds": 1.0},
            "KS by slice": {"p_value": 0.5, "seconds": 1.0},
        }
        (tmp_path / "tables" / f"{number:04d}").mkdir(parents=True)
        (tmp_path / "tables" / f"{number:04d}" / "peers.json").write_text(json.dumps(reported))
        answer: dict[str, Any] = {"kind": "one" if each else "null", "regime": "iid", "hidden": []}
        if each:
            answer["hidden"] = [{"mechanism": each[0], "wanted": each[1]}]
        (answers / f"{number:04d}.json").write_text(json.dumps(answer))
    counts, seconds = score(tmp_path)
    assert counts["BIC stepwise", "iid"] == [True]
    assert counts["BIC stepwise", "one, 6 s.e.: exact set"] == [True]
    assert counts["BIC stepwise", "one, 10 s.e.: found"] == [True]
    assert counts["BIC stepwise", "one, 10 s.e.: exact set"] == [False]
    assert counts["KS by slice", "one, 6 s.e.: found"] == [False]
    assert ("KS by slice", "one, 6 s.e.: exact set") not in counts
    assert "| BIC stepwise | 1.00 (0.21 to 1.00) | 1 |" in show(counts, seconds)


def test_pysindy_takes_what_stands_out() -> None:
    pytest.importorskip("pysindy", reason="the extra 'bench' is not installed")
    assert pysindy_stlsq(toy([0.3, -0.5, 8.0, 0.0, -7.0])) == {"2", "4"}
    assert pysindy_stlsq(toy([0.3, -0.5, 1.0])) == set()


def test_pted_as_it_comes_rejects_tables_that_share_their_contexts(model: Model) -> None:
    pytest.importorskip("pted", reason="the extra 'bench' is not installed")
    rng = np.random.default_rng(8)
    contexts, _ = table(8, n=300)
    contexts |= {f"more_{k}": rng.standard_normal(300) for k in range(12)}
    # Both of the model itself: nothing is missing.
    same = model.sample(contexts, rng)
    assert pted_as_it_comes(compare(model, contexts, same, rng), rng) < 0.05


def test_classifier_finds_a_shift_that_comes_with_throttle(model: Model) -> None:
    pytest.importorskip("sklearn", reason="the extra 'bench' is not installed")
    rng = np.random.default_rng(10)
    contexts, _ = table(10)
    shifted = model.sample(contexts, rng) + 2.0 * (contexts["throttle"] > 0.5)
    assert classifier(compare(model, contexts, shifted, rng), rng) < 0.01


def test_classifier_finds_nothing_where_nothing_is_missing(model: Model) -> None:
    pytest.importorskip("sklearn", reason="the extra 'bench' is not installed")
    p_values = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        contexts, _ = table(seed, n=400)
        p_values.append(classifier(compare(model, contexts, model.sample(contexts, rng), rng), rng))
    assert sum(p < 0.05 for p in p_values) <= 1
    assert 0.25 < np.mean(p_values) < 0.75


def test_power_is_the_size_that_is_found_in_80_of_100(tmp_path: Path) -> None:
    unit = (0.95 * 2000) ** 0.5
    number = 0
    for size, of, found_by_ks in ((0.0, 40, 2), (0.05, 10, 2), (0.1, 10, 6), (0.14, 10, 10)):
        for k in range(of):
            table = tmp_path / "tables" / f"{number:04d}"
            (table / "gap").mkdir(parents=True)
            (tmp_path / "answers").mkdir(exist_ok=True)
            hidden = [{"standard_errors": 1.04 * size * unit}] if size else []
            (tmp_path / "answers" / f"{number:04d}.json").write_text(json.dumps({"hidden": hidden}))
            gap = {"effects": [{}] if size >= 0.1 else [], "unknown": [], "p_value": 0.01 if size else 0.5}
            gap["messages"] = [f"{'latency' if size else 'heavy_tails'} was tried and dropped: as one does."]
            (table / "gap" / "gap.json").write_text(json.dumps(gap))
            peers = {"KS by slice": {"p_value": 0.01 if k < found_by_ks else 0.5, "seconds": 1.0}}
            (table / "peers.json").write_text(json.dumps(peers))
            number += 1
    reported = power.found(tmp_path)
    assert [sum(each) for each in reported["KS by slice"].values()] == [2, 2, 6, 10]
    text = power.show(reported)
    assert "40 with nothing hidden, 10 of 0.05, 10 of 0.1, 10 of 0.14" in text
    assert "| KS by slice | 0.050 (0.014 to 0.165) | 0.20 | 0.60 | 1.00 | 0.120 (" in text
    assert "| gap workflow: its first screen, p < 0.05 | 0.000 (0.000 to 0.088) | 1.00 | 1.00 | 1.00 | 0.050 (" in text
    assert "| gap workflow: chooses something, before the held-out runs decide | 0.000 (0.000 to 0.088) | 1.00" in text
    assert "| gap workflow: names something or calls it unknown | 0.000 (0.000 to 0.088) | 0.00 | 1.00" in text


def test_power_draws_each_size_of_each_mechanism() -> None:
    drawn = power.cases(10, 1)
    assert len({case.number for case in drawn}) == len(drawn) == 10 * (3 + len(power.SIZES))
    assert len({case.hidden for case in drawn if case.hidden}) == 10 * len(power.SIZES)
