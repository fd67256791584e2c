"""What `msp-range doctor` prints of findings, for people and as JSON, and its exit code."""

import json
from pathlib import Path

import pytest

from msp_range.doctor import command
from msp_range.doctor.computer import this_computer
from msp_range.doctor.finding import Finding, right, unknown, wrong

DATE, BUS, PORT = right("date", "it is set"), wrong("bus", "none", "connect it"), unknown("port", "busy", "again")


def shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], as_json: bool, *findings: Finding
) -> tuple[int, str]:
    """Exit code and output."""
    monkeypatch.setattr(command, "examine", lambda *_, **__: iter(findings))
    code = command.show(Path("a.yaml"), this_computer(), as_json)
    return code, capsys.readouterr().out


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
