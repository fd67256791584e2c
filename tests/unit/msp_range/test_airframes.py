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


def test_where_the_airframe_file_is_all_of_it_is(tmp_path: Path) -> None:
    written = run("msp-range airframes quad_pallet --into", tmp_path).output.splitlines()
    assert written == [f"written: {tmp_path}/{name}" for name in ("sensors/mb1242.yaml", "airframe.yaml")]


def test_what_exists_is_not_replaced(tmp_path: Path) -> None:
    model = tmp_path / "sensors/mb1242.yaml"
    model.parent.mkdir()
    model.write_text("# edited by its owner\n")
    assert run("msp-range airframes quad_pallet --into", tmp_path).output == f"written: {tmp_path}/airframe.yaml\n"
    assert model.read_text() == "# edited by its owner\n"
    assert "exists already" in run("msp-range airframes loopback --into", tmp_path, code=3).stderr
    assert (tmp_path / "airframe.yaml").read_bytes() == (CONFIGS / "quad_pallet.yaml").read_bytes()


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert "cannot be written" in run("msp-range airframes loopback --into", tmp_path / "file/etc", code=3).stderr


def test_a_name_that_none_has_is_refused() -> None:
    assert run("msp-range airframes quad_pallet").output.startswith("quad_pallet: 4 MB1242 on I2C, down")
    assert "expected one of canted_pallet" in run("msp-range airframes octo", code=3).stderr
