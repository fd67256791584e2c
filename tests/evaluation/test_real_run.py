"""Commands that an evaluation of measured data runs: they are named, and stopped only where that was asked for."""

import pytest

from evaluation.real.run import _run


def test_a_command_is_named_and_takes_as_long_as_it_does(capfd: pytest.CaptureFixture[str]) -> None:
    assert _run(("effects", "--json"), None) == ""
    assert capfd.readouterr().err == "msp-lab effects --json\n"


def test_a_command_that_takes_too_long_has_failed() -> None:
    assert _run(("effects", "--json"), 0.01) == "stopped after 0.01 s (--longest)"


def test_why_a_command_failed_is_its_last_line() -> None:
    assert "nowhere: no such" in _run(("show", "nowhere"), None).replace("/gap.json", "")
