"""`msp-lab design` as a command: questions, sessions, and their readings put in with the old ones."""

import json
import shlex
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from msp_range.recording.csv_form import write_csv
from msp_sim.model.model import load_model
from tests.docs.shown import shown
from tests.support.measured import ROOT
from tests.support.programs import run

MODEL = ROOT / "configs/sensors/mb1242.yaml"
RUNS, ROWS = 8, 150


def options(words: list[str]) -> set[str]:
    return {each for each in words if each.startswith("--")}


def one_cold_day() -> dict[str, Any]:
    """Readings 2 % too short, all at 5 C: the air that the sensor does not know, its clock, or its thermometer."""
    number = np.arange(RUNS * ROWS)
    columns = {
        "time_s": 0.4 * (number % ROWS),
        "run": np.array([f"r{each}" for each in number // ROWS]),
        "sensor": np.full(number.size, "left"),
        "true_range_cm": 200.0 + 120.0 * np.sin(number / 13.0),
        "air_temperature_c": np.full(number.size, 5.0),
    }
    given = load_model(MODEL)
    return columns | {
        "reading_cm": given.adding("range_scale", scale_pct=-3.0).sample(columns, np.random.default_rng(3))
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that docs/experiment.md names."""
    made = tmp_path_factory.mktemp("design")
    write_csv(made / "OLD.csv", one_cold_day())
    shutil.copy(MODEL, made / "MODEL.yaml")
    run("msp-lab gap", made / "OLD.csv", "--model", made / "MODEL.yaml", "--out", made / "gaps/june", "--until", "add")
    return made


@pytest.mark.slow
def test_the_readings_of_the_session_decide_between_air_and_clock(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As docs/experiment.md shows it; the campaign is collected from emulated sensors whose clock is slow."""
    monkeypatch.chdir(folder)
    design = shlex.split(shown("msp-lab design gaps/june --bench --max-minutes 90"))
    collect = shlex.split(shown("msp-lab collect gaps/june/design/1-*/campaign.yaml --out new"))
    gap = shlex.split(shown("msp-lab gap OLD.csv new/readings.csv --model MODEL.yaml --out gaps/july"))
    assert "right in 2 of 2 sessions" in run(*design, "--sessions", "2").output
    questions = json.loads(Path("gaps/june/design/design.json").read_text())["questions"]
    (question,) = [each for each in questions if each["kind"] == "indistinguishable"]
    named = {each["name"] for each in question["answers"]}
    assert {"range_scale", "air_temperature"} <= named
    # A bend that begins before the nearest reading is a scale, and no answer of its own.
    assert "bend" not in named
    session = question["session"]
    assert session["expected_power"] >= 0.95
    assert Path(session["folder"], "session.png").stat().st_size > 5_000

    slow = yaml.safe_load(MODEL.read_text())
    slow["effects"] = [*slow["effects"], {"name": "range_scale", "parameters": {"scale_pct": -3.0}}]
    Path("slow.yaml").write_text(yaml.safe_dump(slow))
    (campaign,) = Path().glob(collect[2])
    run("msp-lab collect", campaign, *collect[3:], "--simulate", "--model", "slow.yaml")
    run(*gap, "--until", "add")
    (found,) = json.loads(Path("gaps/july/gap.json").read_text())["effects"]
    for printed, of_document in zip(session["commands"], (collect, gap), strict=True):
        assert options(shlex.split(printed)) == options(of_document)
    names = {found["name"], *(each["name"] for each in found["alternatives"])}
    assert "range_scale" in names
    assert "air_temperature" not in names

    assert "give --force" in run(*design, code=3).output
    Path("taken").write_text("")
    assert "taken: is a file" in run(*design, "--out", "taken", code=3).output


@pytest.mark.slow
def test_no_session_is_promised_in_less_time_than_it_takes(folder: Path) -> None:
    out = folder / "short"
    options = ["--bench", "--sessions", "0", "--max-minutes", "5", "--out", out]
    assert "with --max-minutes" in run("msp-lab design", folder / "gaps/june", *options).output
    assert not list(out.glob("*/campaign.yaml"))


def test_a_folder_without_a_gap_run_says_how_to_make_one(tmp_path: Path) -> None:
    assert "'msp-lab compare' or 'msp-lab gap' makes it" in run("msp-lab design", tmp_path, code=3).output
