"""The gap workflow as commands run it: readings in, an extended model out that loads and flies."""

import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msp_lab.gap.findings_file import read_findings
from msp_range.recording.csv_form import write_csv
from msp_sim.model.model import load_model
from tests.support import programs
from tests.support.known import known
from tests.support.measured import MODEL, ROOT, readings

PICTURES = ("lead.png", "path.png", "pit.png", "autocorrelation.png")


def run(command: str, *arguments: Any, code: int = 0) -> str:
    return programs.run(f"msp-lab {command}", *arguments, code=code).output


def hidden(columns: dict[str, Any]) -> np.ndarray:
    """A clock that is 1 % off, by a generator that does not know the catalogue."""
    return np.asarray(0.01 * columns["true_range_cm"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("gap")
    write_csv(made / "flights.csv", readings(2400, 4, bias=hidden))
    printed = run("gap", made / "flights.csv", "--model", MODEL, "--out", made / "out")
    (made / "printed.txt").write_text(printed, encoding="utf-8")
    return made


def test_the_verdict_comes_first_and_the_effect_is_named(folder: Path) -> None:
    printed = (folder / "printed.txt").read_text(encoding="utf-8")
    lines = [line for line in printed.splitlines() if not re.match(r" *\d+ %", line)]
    assert lines[0].startswith("Ranges read 1")
    assert "too long" in lines[0]
    assert "of the disagreement" in " ".join(lines[:3])
    found = read_findings(folder / "out")
    assert found.verdict == "explained"
    names = {each.name for each in found.effects} | {
        other.name for each in found.effects for other in each.alternatives
    }
    assert "range_scale" in names
    assert found.rows == 2400
    assert found.runs == 10
    assert found.gap is not None
    assert found.gap.bias_cm.before == pytest.approx(3.0, abs=0.3)
    assert known(found.gap.bias_cm.after) < 0.3
    # 1 % of ranges of 40 to 500 cm against a sigma of 1.94 cm: about 1.2 nats a hit.
    assert found.gap.nats_per_reading.before == pytest.approx(1.2, abs=0.3)
    assert known(found.gap.nats_per_reading.after) < 0.02


def test_terminal_page_and_file_say_the_same_place(folder: Path) -> None:
    """1 % of the range: from 0.4 cm near the sensor to 5 cm."""
    found = read_findings(folder / "out")
    (where,) = [each.where for each in found.effects]
    assert where.startswith("everywhere, most at true range from 2")
    differing = [each for each in found.slices if each.differs and each.variables == ("true_range_cm",)]
    assert len(differing) == 12
    assert {each.by for each in differing} == {(found.effects[0].name,)}
    page = html.unescape((folder / "out" / "report.html").read_text(encoding="utf-8"))
    assert f"<li>Where: {where}.</li>" in page
    printed = (folder / "printed.txt").read_text(encoding="utf-8")
    assert "Where: everywhere, most" in printed


def test_the_extended_model_carries_its_evidence_and_flies(folder: Path) -> None:
    model = load_model(folder / "out" / "model.yaml")
    added = [entry for entry in model.sensor.effects if "evidence" in entry]
    assert added
    evidence = added[0]["evidence"]
    assert evidence["data"][0]["name"] == "flights.csv"
    assert evidence["data"][0]["rows"] == 2400
    assert evidence["gap_before"]["bias_cm"] > 2.0 > evidence["gap_after"]["bias_cm"]
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", evidence["date"])
    flown = programs.run("msp-sim fly hover", "--model", folder / "out" / "model.yaml")
    assert "times real time" in flown.output


def test_the_page_needs_nothing_but_itself(folder: Path) -> None:
    page = (folder / "out" / "report.html").read_text(encoding="utf-8")
    assert read_findings(folder / "out").sentence in html.unescape(page)
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", page)
    for name in PICTURES:
        assert (folder / "out" / name).read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_the_steps_alone_end_with_the_same(folder: Path) -> None:
    out = folder / "steps"
    run("compare", folder / "flights.csv", "--model", MODEL, "--out", out)
    assert read_findings(out).verdict is None
    assert not (out / "model.yaml").exists()
    assert "msp-lab add DIR" in run("name", out)
    assert "of the disagreement" in run("add", out)
    run("show", out)
    one, other = (json.loads((each / "gap.json").read_text(encoding="utf-8")) for each in (folder / "out", out))
    for each in (one, other):
        del each["seconds"]
    assert one == other
    for name in ("model.yaml", "lead.png"):
        assert (out / name).read_bytes() == (folder / "out" / name).read_bytes()


def test_data_that_changed_between_steps_are_reported(folder: Path, tmp_path: Path) -> None:
    write_csv(tmp_path / "flights.csv", readings(600, 4))
    run("compare", tmp_path / "flights.csv", "--model", MODEL, "--out", tmp_path / "out")
    (tmp_path / "flights.csv").unlink()
    write_csv(tmp_path / "flights.csv", readings(600, 5))
    assert "has changed since 'msp-lab compare'" in run("name", tmp_path / "out", code=3)


def test_a_folder_without_a_comparison_is_reported(tmp_path: Path) -> None:
    assert "'msp-lab compare' or 'msp-lab gap' makes it" in run("name", tmp_path, code=3)


@pytest.mark.slow
def test_adding_takes_what_was_named_and_asks_for_it_where_it_is_missing(folder: Path, tmp_path: Path) -> None:
    write_csv(tmp_path / "flights.csv", readings(600, 4, bias=hidden))
    out = tmp_path / "out"
    run("compare", tmp_path / "flights.csv", "--model", MODEL, "--out", out)
    assert f"run 'msp-lab name {out}' first" in run("add", out, code=3).replace("\n", "")
    run("name", out)
    named = json.loads((out / "named.json").read_text(encoding="utf-8"))
    assert [each["name"] for each in named["terms"]] == ["range_scale"]
    # What is added is what the file holds, and not what naming would find again.
    text = (out / "named.json").read_text(encoding="utf-8")
    term = next(each for each in named["final_fit"]["effects"] if each["name"] == "range_scale")
    (out / "named.json").write_text(text.replace(str(term["parameters"]["scale_pct"]), "0.875"), encoding="utf-8")
    run("add", out)
    added = load_model(out / "model.yaml").effects[-1]
    assert added.values["scale_pct"] == 0.875
    (tmp_path / "flights.csv").unlink()
    write_csv(tmp_path / "flights.csv", readings(600, 5))
    assert "has changed since 'msp-lab name'" in run("add", out, code=3)
    (out / "named.json").write_text("{}", encoding="utf-8")
    assert f"run 'msp-lab name {out}' again" in run("add", out, code=3).replace("\n", "")


def test_nothing_missing_reports_what_would_have_been_seen(tmp_path: Path) -> None:
    write_csv(tmp_path / "flights.csv", readings(1500, 6))
    printed = run("gap", tmp_path / "flights.csv", "--model", MODEL, "--out", tmp_path / "out", "--until", "add")
    assert "Nothing is missing" in printed
    assert "would have shown" in printed
    found = read_findings(tmp_path / "out")
    assert (found.verdict, found.effects, found.unknown) == ("nothing missing", (), ())
    assert any(each.name == "humidity" and "humidity_pct" in each.columns for each in found.not_testable)


@pytest.mark.slow
def test_a_campaign_whose_sensor_is_off_shows_it(tmp_path: Path) -> None:
    bench = ROOT / "configs" / "sensors" / "mb1242_bench.yaml"
    off = bench.read_text(encoding="utf-8").replace(
        "\neffects:\n", "\neffects:\n  - {name: range_scale, parameters: {scale_pct: 1.0}}\n"
    )
    (tmp_path / "off.yaml").write_text(off, encoding="utf-8")
    campaign = ROOT / "configs" / "campaigns" / "afternoon.yaml"
    run("collect", campaign, "--simulate", "--model", tmp_path / "off.yaml", "--out", tmp_path / "made")
    run("compare", tmp_path / "made" / "readings.csv", "--model", bench, "--out", tmp_path / "out")
    run("name", tmp_path / "out")
    run("add", tmp_path / "out")
    found = read_findings(tmp_path / "out")
    # Its runs are points, each at one range: a scale is seen as what it does over range, by its name or as a curve.
    names = {each.name for each in found.effects} | {
        other.name for each in found.effects for other in each.alternatives
    }
    curves = {(each.channel, each.variables) for each in found.unknown}
    assert "range_scale" in names or ("bias", ("true_range_cm",)) in curves
    assert found.gap is not None
    assert known(found.gap.nats_per_reading.after) < 0.1 * known(found.gap.nats_per_reading.before)
