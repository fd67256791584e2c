"""The page of a gap states how it was found, and its pictures keep apart what lies close together."""

import html
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from msp_lab.cli import app
from msp_lab.gap.cells import Partition, partitions
from msp_lab.gap.conclusion import with_words
from msp_lab.gap.findings import (
    Alternative,
    FittedValue,
    FoundEffect,
    GapFindings,
    PathStep,
    ReadingsFile,
    Settings,
    UnknownEffect,
)
from msp_lab.gap.measures import HeldOutReadings
from msp_lab.gap.pictures import _apart, subjects
from msp_lab.gap.report import write_report
from msp_range import __version__
from msp_range.recording.csv_form import write_csv
from msp_sim.model.model import load_model
from tests.support.measured import MODEL, readings
from tests.unit.test_gap_findings import FULL

FOUND = replace(
    FULL,
    effects=(
        FoundEffect(
            "range_scale",
            "indistinguishable",
            {"scale_pct": FittedValue(0.8, 0.7, 0.9, "%")},
            0.4,
            12.0,
            (Alternative("bend", -0.3, 0.97), Alternative("thermometer_offset", 1.2, 0.99)),
            "to tell range_scale from bend: ranges in steps of 20 cm",
        ),
    ),
    unknown=(
        UnknownEffect("bias", ("throttle",), "1.2 throttle^2", 0.1, ((0.0, 0.0, -0.1, 0.1), (1.0, 1.2, 1.0, 1.4))),
    ),
    selection_path=(PathStep("", 0.5, -2.8), PathStep("calibration", 0.4, -2.7), PathStep("range_scale", 0.002, -2.3)),
    training_runs=("monday", "tuesday"),
    held_out_runs=("wednesday", "thursday"),
    p_value=0.0005,
    sources=(ReadingsFile("flight.csv", "ab" * 32, 400),),
    settings=Settings("given.yaml", alpha=0.02, seed=7),
    model_sha256="cd" * 32,
    version="9.8.7",
    detectable="mounting_offset above 0.5 cm; bend above 0.3 %",
)


def page_of(findings: GapFindings, folder: Path) -> str:
    given, findings = load_model(MODEL), with_words(findings)
    columns = readings(400, 3)
    contexts = {name: column for name, column in columns.items() if name != "reading_cm"}
    table = HeldOutReadings(columns["reading_cm"], contexts, np.unique(columns["run"], return_inverse=True)[1])
    page = write_report(findings, given, given, given, table, folder).read_text(encoding="utf-8")
    words = html.unescape(re.sub(r"<style.*?</style>|<[^>]+>", " ", page, flags=re.DOTALL))
    return re.sub(r"\s+", " ", words)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of the page of `FOUND`, and its words."""
    folder = tmp_path_factory.mktemp("page")
    return folder, page_of(FOUND, folder)


def test_a_page_says_what_another_laboratory_needs_to_do_it_again(drawn: tuple[Path, str]) -> None:
    _, text = drawn
    assert "held-out runs: wednesday, thursday" in text
    assert "training runs: monday, tuesday" in text
    assert "Family-wise false-positive rate: 0.02" in text
    assert "msp-range 9.8.7, seed 7" in text
    for digest in ("ab" * 32, "cd" * 32):
        assert digest in text


def test_a_page_says_what_a_number_means_and_what_it_could_be_instead(drawn: tuple[Path, str]) -> None:
    folder, text = drawn
    assert "relative error of the readings 0.8 % 0.7 to 0.9" in text
    assert "bend (0.3 nats better in total, correlation 0.97)" in text
    assert "thermometer offset (1.2 nats worse in total, correlation 0.99)" in text
    assert "What tells them apart: to tell range_scale from bend: ranges in steps of 20 cm." in text
    assert "its numbers refitted 0.4 −2.7000 +0.1000" in text
    assert "bend above 0.3 %" in text
    assert "sigma_cm Standard deviation of a hit" in text
    names = {each.name for each in folder.glob("*.png")}
    assert names == {"lead.png", "residuals.png", "path.png", "pit.png", "autocorrelation.png", "unknown-1.png"}


def test_a_page_begins_with_the_sentence_and_one_picture(drawn: tuple[Path, str]) -> None:
    page = (drawn[0] / "report.html").read_text(encoding="utf-8")
    body = page[page.index("<body>") :]
    first = html.unescape(with_words(FOUND).sentence)
    assert first.startswith("Ranges read 0.8 % too long (or it is bend or thermometer offset)")
    assert 0 < html.unescape(body).index(first) < body.index("<img") < body.index("noise floor")
    assert body.index('id="lead"') < body.index("<h2")


def test_a_picture_over_single_readings_comes_first() -> None:
    """A pilot reads a cloud of readings against its line; a share of outliers has to be explained first."""
    columns = readings(400, 3)
    contexts = {name: column for name, column in columns.items() if name != "reading_cm"}
    contexts["previous_reading_cm"] = np.roll(columns["reading_cm"], 1)
    table = HeldOutReadings(columns["reading_cm"], contexts, np.zeros(400, dtype=np.intp))
    wash = FoundEffect("prop_wash", "named", {"log_odds": FittedValue(3.0, 2.0, 4.0, "1")}, 0.5, 9.0)
    repeats = FoundEffect("stale", "named", {"share": FittedValue(0.5, 0.4, 0.6, "1")}, 0.5, 9.0)
    scale = replace(FOUND.effects[0], gain_nats=0.1)
    found = subjects(replace(FOUND, effects=(wash, repeats, scale), unknown=()), table)
    assert [each.column for each in found] == ["true_range_cm", "throttle", "true_range_cm"]
    assert [each.of_outliers for each in found] == [False, True, True]


def test_points_that_would_cover_each_other_are_one() -> None:
    cell = np.array([0, 0, 0, 1, 2, 2, 3])
    part = Partition(("x",), ("x 0", "x 100", "x 101", "x unknown"), cell, np.array([0.0, 100.0, 101.0, np.nan]))
    apart = _apart(part)
    assert apart.counts.tolist() == [3, 3, 1]
    assert apart.centres is not None
    assert apart.centres[:2] == pytest.approx([0.0, 302.0 / 3.0])
    assert np.isnan(apart.centres[2])


def test_ends_of_a_slice_have_the_digits_in_which_they_differ() -> None:
    values = np.concatenate([np.linspace(267.50, 267.54, 200), np.linspace(100.0, 120.0, 200)])
    labels = partitions({"true_range_cm": values}, pairs=False)[1].labels
    assert all(re.fullmatch(r"true_range_cm [\d.]+ to [\d.]+", each) for each in labels)
    assert all(len(set(re.findall(r"[\d.]+", each))) == 2 for each in labels)


def test_a_model_that_changed_between_steps_is_reported(tmp_path: Path) -> None:
    write_csv(tmp_path / "flights.csv", readings(400, 4))
    model = tmp_path / "given.yaml"
    model.write_text(MODEL.read_text(encoding="utf-8"), encoding="utf-8")
    compared = CliRunner().invoke(
        app, ["compare", str(tmp_path / "flights.csv"), "--model", str(model), "--out", str(tmp_path / "out")]
    )
    assert compared.exit_code == 0, compared.output
    assert f'"version": "{__version__}"' in (tmp_path / "out" / "gap.json").read_text(encoding="utf-8")
    model.write_text("# Another line.\n" + model.read_text(encoding="utf-8"), encoding="utf-8")
    named = CliRunner().invoke(app, ["name", str(tmp_path / "out")])
    assert named.exit_code == 3
    assert "given.yaml: has changed since 'msp-lab compare'" in named.output


@pytest.mark.parametrize("command", ["show", "add", "name", "design"])
def test_readings_in_place_of_a_folder_of_findings_are_reported(command: str, tmp_path: Path) -> None:
    write_csv(tmp_path / "flights.csv", readings(400, 4))
    result = CliRunner().invoke(app, [command, str(tmp_path / "flights.csv")])
    assert result.exit_code == 3
    assert "is a file; expected the folder" in " ".join(result.output.split())


def test_a_folder_that_is_a_file_is_reported(tmp_path: Path) -> None:
    write_csv(tmp_path / "flights.csv", readings(400, 4))
    taken = tmp_path / "taken"
    taken.write_text("", encoding="utf-8")
    result = CliRunner().invoke(
        app, ["gap", str(tmp_path / "flights.csv"), "--model", str(MODEL), "--out", str(taken), "--until", "compare"]
    )
    assert result.exit_code == 3
    assert "is a file; expected a folder" in " ".join(result.output.split())


def test_what_an_earlier_comparison_left_does_not_stay(tmp_path: Path) -> None:
    write_csv(tmp_path / "flights.csv", readings(400, 4))
    out = tmp_path / "out"
    out.mkdir()
    for name in ("report.html", "model.yaml", "unknown-2.png", "notes.txt"):
        (out / name).write_text("old", encoding="utf-8")
    result = CliRunner().invoke(
        app, ["compare", str(tmp_path / "flights.csv"), "--model", str(MODEL), "--out", str(out)]
    )
    assert result.exit_code == 0, result.output
    assert {each.name for each in out.iterdir()} == {"gap.json", "notes.txt"}
