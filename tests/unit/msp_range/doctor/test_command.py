"""What `msp-range doctor` prints of findings, for people and as JSON, and its exit code."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from msp_range.doctor import command
from msp_range.doctor.computer import Computer, this_computer
from msp_range.doctor.finding import Finding, right, unknown, wrong

DATE, BUS, PORT = right("date", "it is set"), wrong("bus", "none", "connect it"), unknown("port", "busy", "again")


def shown(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    as_json: bool,
    *findings: Finding,
    show: Callable[[Path, Computer, bool], int] = command.show,
) -> tuple[int, str]:
    """Exit code and output."""
    monkeypatch.setattr(command, "examine", lambda *_, **__: iter(findings))
    return show(Path("a.yaml"), this_computer(), as_json), capsys.readouterr().out


@pytest.mark.parametrize(("findings", "code"), [([DATE, PORT], 0), ([DATE, BUS, PORT], 1)])
def test_only_what_is_wrong_makes_the_exit_code_1(
    findings: list[Finding], code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found, text = shown(monkeypatch, capsys, False, *findings)
    assert found == code
    assert text.splitlines()[-1] == f"1 right, {code} wrong, 1 unknown"
    assert "unknown  port: busy" in text
    assert "         -> again" in text
    assert text.count("->") == len(findings) - 1


def test_json_is_all_of_the_output(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    found, text = shown(monkeypatch, capsys, True, DATE, BUS)
    answer = json.loads(text)
    assert (found, [each["verdict"] for each in answer["findings"]]) == (1, ["right", "wrong"])
    assert answer["counts"] == {"right": 1, "wrong": 1}


@pytest.mark.parametrize(("findings", "code"), [([DATE, PORT], 0), ([DATE, PORT, BUS], 1)])
def test_a_preflight_begins_with_its_answer_and_what_is_against_it(
    findings: list[Finding], code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found, text = shown(monkeypatch, capsys, False, *findings, show=command.show_preflight)
    lines = [line.split()[:2] for line in text.splitlines() if "->" not in line]
    assert (found, lines[0]) == (code, ["NO-GO", "bus"] if code else ["GO"])
    assert lines[1:] == [["wrong", "bus:"]] * code + [["unknown", "port:"], ["right", "date:"]]
    found, text = shown(monkeypatch, capsys, True, *findings, show=command.show_preflight)
    assert (found, json.loads(text)["go"]) == (code, not code)
