"""The benchmark for everybody: known findings have known scores, and nothing but the scorer reads the answers."""

import ast
import gzip
import hashlib
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from evaluation import ROOT
from evaluation.benchmark.score import FindingsError, Score, main, scored, show

HERE = ROOT / "evaluation" / "benchmark"
FROZEN = "0b1ea9443e0c46ff1cfd8de365725b69e02a20835224ed2d67356b3f7b620a71"
"""Of all tables, models and answers."""
SCALE = {"title": "scale", "names": {"range_scale": 2.0}, "channel": "bias", "columns": [], "standard_errors": 5.0}
LATE = {"title": "late", "names": {"latency": 50.0}, "channel": "bias", "columns": [], "standard_errors": 10.0}
SUPPLY = {"title": "own", "names": {}, "channel": "spread", "columns": ["supply_v"], "standard_errors": 10.0}
FOUND_SCALE = {"name": "range_scale", "value": 2.2, "low": 1.8, "high": 2.6}

Scorer = Callable[[dict[str, Any]], Score]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A benchmark of three tables: nothing, two effects, and a form without a name over ``supply_v``."""
    (tmp_path / "tables").mkdir()
    (tmp_path / "answers").mkdir()
    slices: list[dict[str, Any]] = [
        {"column": "supply_v", "low": 0.0, "high": 4.0, "differs": True},
        {"column": "supply_v", "low": 5.0, "high": 9.0, "differs": False},
        {"column": "anchor", "word": "a1", "differs": True},
        {"column": "anchor", "word": "a2", "differs": None},
    ]
    answers = {}
    for name, hidden in (("t1", []), ("t2", [SCALE, LATE]), ("t3", [SUPPLY]), ("t4", [SCALE])):
        rows = "".join(f"{k},{k},a{1 + k % 2}\n" for k in range(10))
        text = f"time_s,supply_v,anchor\n{rows}".encode()
        (tmp_path / "tables" / f"{name}.csv.gz").write_bytes(gzip.compress(text))
        own = [each | {"differs": False} for each in slices] if not hidden else slices
        answers[name] = {"hidden": hidden, "noise": ["humidity"], "slices": own}
    (tmp_path / "answers" / "answers.json").write_text(json.dumps(answers))
    (tmp_path / "names.csv").write_text("name\nrange_scale\nlatency\nbend\nhumidity\n")
    return tmp_path


@pytest.fixture
def of(folder: Path) -> Scorer:
    """Score of findings by table; the others have none."""

    def score(found: dict[str, Any]) -> Score:
        tables = {f"t{k}": found.get(f"t{k}", {}) for k in range(1, 5)}
        path = folder / "findings.json"
        path.write_text(json.dumps({"method": "mine", "tables": tables}))
        return scored([path], folder)["mine"]

    return score


def test_nothing_found_is_right_only_where_nothing_is_hidden(of: Scorer) -> None:
    score = of({})
    assert (score.quiet, score.exact, score.near, score.unknown) == ([True], [False, False], [False], [False])
    assert score.wrong == [False] * 4
    assert np.isnan(score.where[0])


def test_all_found_is_right_everywhere(of: Scorer) -> None:
    late = {"name": "latency", "alternatives": ["bend"], "value": 45.0, "low": 30.0, "high": 49.0}
    where = [{"column": "supply_v", "low": 1.0, "high": 3.9}, {"column": "anchor", "word": "a1"}]
    two = {"effects": [late, FOUND_SCALE], "where": where, "seconds": 3.0}
    own = {"unknown": [{"channel": "spread", "column": "supply_v"}], "where": where}
    score = of({"t2": two, "t3": own, "t4": {"effects": [FOUND_SCALE], "where": where}})
    assert all([*score.quiet, *score.exact, *score.near, *score.unknown])
    assert not any(score.wrong)
    assert score.where == (1.0, 1.0, 1.0)
    assert sorted(score.ratios) == pytest.approx([0.9, 1.1, 1.1])
    assert score.near_ratios == pytest.approx([1.1, 1.1])
    assert sorted(score.covered) == [False, True, True]
    expected = "| mine | 1 of 1 | 2 of 2 | 1 of 1 | 1 of 1 | 0 of 4 | 1.00 (1.00, 1.00) | 1.03 of 3 (1.10 of 2) |"
    assert f"{expected} 2 of 3 | 3 |" in show({"mine": score})


@pytest.mark.parametrize(
    ("effects", "unknown", "is_wrong"),
    [
        ([FOUND_SCALE, {"name": "bend"}], [], True),
        ([{"name": "bend"}], [], True),
        ([{"name": "range_scale", "alternatives": ["bend", "humidity", "latency"]}], [], True),
        ([FOUND_SCALE], [{"channel": "bias", "column": "supply_v"}], False),
        ([], [{"channel": "bias", "column": "supply_v"}], False),
    ],
)
def test_one_effect_is_not_exact_with(effects: list[Any], unknown: list[Any], is_wrong: bool, of: Scorer) -> None:
    score = of({"t4": {"effects": effects, "unknown": unknown}})
    assert score.near == [False]
    assert score.wrong[-1] == is_wrong
    assert "hidden scale 5; found " in score.mistakes["t4"]


def test_what_is_true_of_the_noise_is_neither_right_nor_wrong(of: Scorer) -> None:
    noise = {"name": "humidity"}
    score = of({"t1": {"effects": [noise]}, "t4": {"effects": [noise, FOUND_SCALE]}})
    assert (score.quiet, score.near, any(score.wrong)) == ([True], [True], False)


def test_one_finding_stands_for_one_effect(of: Scorer) -> None:
    both = {"name": "range_scale", "alternatives": ["latency"]}
    assert of({"t2": {"effects": [both]}}).exact == [False, False]
    assert of({"t2": {"effects": [both, {"name": "range_scale"}]}}).exact == [True, False]


def test_unknown_form_needs_its_channel_and_column_and_no_name(of: Scorer) -> None:
    right = {"channel": "spread", "column": "supply_v"}
    assert of({"t3": {"unknown": [{"channel": "bias", "column": "anchor"}, right]}}).unknown == [True]
    assert of({"t3": {"unknown": [right | {"channel": "bias"}]}}).unknown == [False]
    assert of({"t3": {"unknown": [right], "effects": [{"name": "bend"}]}}).unknown == [False]


def test_slices_that_do_not_differ_count_against_precision(of: Scorer) -> None:
    everything = [{"column": "supply_v", "low": 0.0, "high": 9.0}, {"column": "anchor", "word": "a1"}]
    score = of({f"t{k}": {"where": everything} for k in range(1, 5)})
    # 6 slices differ in three tables; reported are these, one more in each, and three where nothing is hidden.
    assert score.where == pytest.approx((2 * 6 / (6 + 12), 6 / 12, 1.0))
    few = [{"column": "supply_v", "low": 0.0, "high": 0.9}]
    assert np.isnan(of({"t2": {"where": few}}).where[0]), "a fifth of a slice does not report it"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[1", "Expecting"),
        ("[]", 'expected {"method": "words", "tables": {...}}'),
        ('{"method": "m", "tables": {"t1": {}}}', "tables: t2, t3, t4: missing"),
        ('{"method": "m", "tables": {"t1": {}, "t2": {}, "t3": {}, "t4": {}, "t5": {}}}', "tables: t5: unknown"),
        ({"effect": []}, "expected an object with effects, unknown, where and seconds"),
        ({"effects": {}}, "tables.t1.effects: expected a list of objects"),
        ({"effects": [{"name": "scale"}]}, "tables.t1.effects[0]: found the name 'scale'; names.csv has those"),
        ({"effects": [{"name": "bend", "alternatives": "latency and more"}]}, "found the name 'latency and more'"),
        ({"effects": [{"name": "bend", "value": 3, "low": 4, "high": 5}]}, "low, value, high [4, 3, 5]"),
        ({"effects": [{"name": "bend", "value": "3"}]}, "expected numbers in this order"),
        ({"unknown": [{"channel": "noise", "column": "anchor"}]}, "expected one of bias, spread"),
        ({"unknown": [{"channel": "bias"}]}, "unknown[0].column: found None"),
        ({"where": [{"column": "height", "low": 0, "high": 1}]}, "the table has time_s, supply_v, anchor"),
        ({"where": [{"column": "anchor", "low": 0, "high": 1}]}, "anchor holds words; expected a word"),
        ({"where": [{"column": "supply_v", "word": "a1"}]}, "supply_v holds numbers; expected low and high"),
        ({"seconds": float("nan")}, "tables.t1.seconds: found nan; expected a number"),
    ],
)
def test_broken_file_is_explained(text: str | dict[str, Any], says: str, folder: Path) -> None:
    path = folder / "broken.json"
    tables = {"t1": text, "t2": {}, "t3": {}, "t4": {}}
    path.write_text(text if isinstance(text, str) else json.dumps({"method": "m", "tables": tables}))
    with pytest.raises(FindingsError) as error:
        scored([path], folder)
    assert says in str(error.value)
    assert str(path) in str(error.value)


def test_two_methods_have_two_names(folder: Path, of: Scorer) -> None:
    of({})
    with pytest.raises(FindingsError, match="'mine', as in another file"):
        scored([folder / "findings.json"] * 2, folder)


def test_command_line_scores_the_frozen_tables_without_the_project(tmp_path: Path) -> None:
    names = [path.name.partition(".")[0] for path in (HERE / "tables").iterdir()]
    path = tmp_path / "nothing.json"
    path.write_text(json.dumps({"method": "finds nothing", "tables": {name: {} for name in names}}))
    words = [sys.executable, str(HERE / "score.py"), str(path), "--mistakes"]
    done = subprocess.run(words, cwd=tmp_path, env={}, capture_output=True, text=True, check=True)
    assert "| finds nothing | 9 of 9 | 0 of 24 | 0 of 9 | 0 of 8 | 0 of 41 | none | none | 0 of 0 |  |" in done.stdout
    assert "t01: hidden slant_axis 10, thermometer_bias 10; found nothing" in done.stdout
    assert main([str(tmp_path / "absent.json")]) == 2
    assert main([]) == 2


def test_scorer_imports_numpy_and_the_standard_library() -> None:
    nodes = list(ast.walk(ast.parse((HERE / "score.py").read_text(encoding="utf-8"))))
    names = {each.name for node in nodes if isinstance(node, ast.Import) for each in node.names}
    names |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    assert {name.partition(".")[0] for name in names} <= {"numpy", *sys.stdlib_module_names}


def test_nothing_but_the_scorer_and_what_draws_names_the_answers() -> None:
    here = {path.name for path in HERE.glob("*.py") if "answers" in path.read_text(encoding="utf-8")}
    assert here == {"score.py", "draw.py"}
    folders = (ROOT / each for each in ("msp_range", "sim", "evaluation", "docs"))
    paths = [path for folder in folders for path in folder.rglob("*.py") if path.parent != HERE]
    assert not [path for path in paths if "benchmark.draw" in path.read_text(encoding="utf-8")]
    assert not [path for path in paths if "benchmark/answers" in path.read_text(encoding="utf-8")]


def test_methods_open_no_answers() -> None:
    code = """
import sys
opened = []
sys.addaudithook(lambda event, given: event == "open" and opened.append(str(given[0])))
from evaluation.benchmark.methods import find
find("KS of PIT by slice", "t01")
assert any("t01.csv.gz" in each for each in opened) and not any("answers" in each for each in opened), opened
"""
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


def test_tables_are_frozen() -> None:
    found = hashlib.sha256()
    for part in ("tables", "models", "answers"):
        for path in sorted((HERE / part).iterdir()):
            found.update(path.name.encode() + path.read_bytes())
    assert found.hexdigest() == FROZEN, "scores of other tables cannot be compared: name them as a new version"
