"""The one command line of all evaluations: each is listed, has a help, and reports a wrong option."""

import argparse
from importlib import import_module

import pytest

from evaluation.__main__ import EVALUATIONS, listing, main


def test_without_a_name_all_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == main(["--help"]) == 0
    assert capsys.readouterr().out == 2 * f"{listing()}\n"
    assert all(f"\n  {name} " in listing() for name in EVALUATIONS)


def test_a_name_that_there_is_not(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["blin"]) == 2
    assert "no evaluation is called 'blin'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", EVALUATIONS)
def test_each_has_a_help_and_explains_all_its_options(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    assert f"usage: python -m evaluation {name} " in capsys.readouterr().out
    parser = argparse.ArgumentParser()
    import_module(f"evaluation.{EVALUATIONS[name][0]}").options(parser)
    assert [each.dest for each in parser._actions if not each.help] == []


def test_what_an_evaluation_refuses_is_reported_as_a_wrong_option(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["blind", "--out", "nowhere", "--plan", "nonsense=3"])
    assert ended.value.code == 2
    assert "python -m evaluation blind: error: plan 'nonsense=3': expected WHAT=COUNT" in capsys.readouterr().err
