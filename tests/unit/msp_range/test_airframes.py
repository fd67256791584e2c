"""The airframes that come with the program: the questions that choose one, and what is written of it."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from msp_range.airframes import QUESTIONS, choose, shipped_airframes
from msp_range.config import load_airframe
from tests.support.programs import run
from tests.support.shipped import CONFIGS

SHIPPED = shipped_airframes()


@pytest.mark.parametrize("name", SHIPPED)
def test_the_answers_of_each_file_lead_to_it(name: str) -> None:
    asked = []

    def answer(question: str, answers: Sequence[str]) -> str:
        asked.append(question)
        assert len(answers) > 1
        (given,) = (answer(SHIPPED[name]) for text, answer in QUESTIONS if text == question)
        assert given in answers
        return given

    assert choose(SHIPPED, answer) == name
    assert 2 <= len(asked) <= 4


def test_the_answers_are_those_of_the_files() -> None:
    changed = {"one": SHIPPED["quad_pallet"], "other": SHIPPED["quad_pallet"].changed(link="udpin:0.0.0.0:14550")}
    asked: dict[str, Sequence[str]] = {}

    def last(question: str, answers: Sequence[str]) -> str:
        asked[question] = answers
        return answers[-1]

    assert choose(changed, last) == "other"
    assert list(asked.values()) == [["serial:/dev/serial0:921600", "udpin:0.0.0.0:14550"]]
    assert choose({"one": SHIPPED["quad_pallet"]}, last) == "one"


def test_the_list_has_what_each_file_says() -> None:
    lines = run("msp-range airframes").output.splitlines()
    assert "proximity: 4 MB1242 on I2C, around, canted by 10 deg; ardupilot, serial:/dev/serial0:921600" in lines
    assert "serial_down: 1 MB1240 on a serial port, down, not canted; ardupilot, serial:/dev/serial0:921600" in lines
    assert [line.partition(":")[0] for line in lines] == sorted(path.stem for path in CONFIGS.glob("*.yaml"))


def test_one_is_chosen_at_a_terminal(tmp_path: Path) -> None:
    program = "from msp_range.cli import main; main()"
    command = f"{sys.executable} -c '{program}' airframes --into {tmp_path / 'new'}"
    # How many: 4; where: around. The first line is no number of an answer.
    done = subprocess.run(
        ["script", "--quiet", "--return", "--command", command, "/dev/null"],
        input="four\n2\n1\n",
        capture_output=True,
        text=True,
        timeout=60.0,
    )
    assert done.returncode == 0, done.stdout
    assert (tmp_path / "new/airframe.yaml").read_bytes() == (CONFIGS / "proximity.yaml").read_bytes()
    assert load_airframe(tmp_path / "new/airframe.yaml").vehicle == "proximity"


def test_without_a_terminal_the_names_are_reported(tmp_path: Path) -> None:
    assert "canted_pallet, forward_and_down" in run("msp-range airframes --into", tmp_path, code=3).stderr
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_ones_own_is_written_with_its_models_and_replaces_nothing(tmp_path: Path) -> None:
    source, folder = tmp_path / "source", tmp_path / "etc"
    (source / "models").mkdir(parents=True)
    (folder / "models").mkdir(parents=True)
    (source / "models/own.yaml").write_bytes((CONFIGS / "sensors/mb1242.yaml").read_bytes())
    (source / "models/edited.yaml").write_bytes((CONFIGS / "sensors/mb1242.yaml").read_bytes())
    (folder / "models/edited.yaml").write_text("# edited by its owner\n")
    text = (CONFIGS / "quad_pallet.yaml").read_text()
    text = text.replace("sensors/mb1242.yaml", "models/own.yaml", 1).replace(
        "sensors/mb1242.yaml", "models/edited.yaml", 1
    )
    text = text.replace("sensors/mb1242.yaml", "mb1242")
    (source / "mine.yaml").write_text(text)
    output = run("msp-range airframes", source / "mine.yaml", "--into", folder).output
    assert output == f"written: {folder}/models/own.yaml\nwritten: {folder}/airframe.yaml\n"
    assert (folder / "airframe.yaml").read_text() == text
    assert (folder / "models/edited.yaml").read_text() == "# edited by its owner\n"
    assert "exists already" in run("msp-range airframes loopback --into", folder, code=3).stderr
    assert (folder / "airframe.yaml").read_text() == text
    (source / "mine.yaml").write_text(text.replace("models/own.yaml", "../source/models/own.yaml"))
    refused = run("msp-range airframes", source / "mine.yaml", "--into", tmp_path / "other", code=3)
    assert "names ../source/models/own.yaml, outside of its folder" in refused.stderr
    assert not (tmp_path / "other").exists()


def test_a_name_without_a_folder_is_refused() -> None:
    assert "--into names the folder" in run("msp-range airframes quad_pallet", code=3).stderr
