"""A campaign of blind tables: what is made, what is kept, and the commands that stay loaded."""

import json
from pathlib import Path

import pytest

from evaluation.blind import run as running
from evaluation.blind.run import Campaign
from evaluation.blind.tables import Case, draw_cases
from evaluation.product import command

pytestmark = pytest.mark.slow


class FakeTools:
    """Commands that write what the real ones would, or say what is wrong."""

    def __init__(self, wrong: str = "") -> None:
        self.wrong = wrong
        self.calls: list[list[str]] = []

    def call(self, *command: object) -> str:
        words = [str(each) for each in command]
        self.calls.append(words)
        out = Path(words[words.index("--out") + 1])
        if words[1] == "gap":
            out.mkdir(parents=True, exist_ok=True)
            (out / "gap.json").write_text("{}", encoding="utf-8")
        elif not self.wrong:
            out.write_text("", encoding="utf-8")
        return self.wrong


def do(campaign: Campaign, case: Case, tools: FakeTools, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setattr(running, "command", tools.call)
    return str(running._do_base(campaign, case.regime)["wrong"] or running._do_table(campaign, case)["wrong"])


def test_a_table_is_drawn_and_looked_at_and_its_answer_is_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign = Campaign(tmp_path, 3)
    (null,) = draw_cases(3, 1, "null", "ar1")
    tools = FakeTools()
    assert do(campaign, null, tools, monkeypatch) == ""
    assert [call[:2] for call in tools.calls] == [["msp-lab", "characterise"], ["msp-lab", "gap"]]
    assert tools.calls[1][-2:] == ["--until", "name"]
    assert not any("answers" in word for call in tools.calls for word in call)
    assert campaign.findings(null).exists()
    answer = json.loads(campaign.answer(null).read_text(encoding="utf-8"))
    assert answer == {"kind": "null", "regime": "ar1", "twist": "", "pair": [], "hidden": []}
    first = (campaign.table(null) / "measured.csv").read_bytes()
    again = Campaign(tmp_path / "again", 3)
    assert do(again, null, FakeTools(), monkeypatch) == ""
    assert (again.table(null) / "measured.csv").read_bytes() == first


def test_what_fails_is_reported_and_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign = Campaign(tmp_path, 3, until="show")
    (one,) = draw_cases(3, 1, "one", standard_errors=6.0)
    assert do(campaign, one, FakeTools(), monkeypatch) == ""
    campaign.findings(one).unlink()
    campaign.findings(one).parent.rmdir()
    drawn = (campaign.table(one) / "measured.csv").stat().st_mtime_ns
    tools = FakeTools("exit code 3")
    assert "table 0: exit code 3" in do(campaign, one, tools, monkeypatch)
    assert not campaign.findings(one).exists()
    tools = FakeTools()
    assert do(campaign, one, tools, monkeypatch) == ""
    assert tools.calls[0][-2:] == ["--until", "show"]
    assert (campaign.table(one) / "measured.csv").stat().st_mtime_ns == drawn


def test_a_command_in_this_process_fails_as_commands_do() -> None:
    assert command("msp-lab", "effects", "--json") == ""
    assert "no-such-folder/gap.json: no such file" in command("msp-lab", "show", "no-such-folder")
    assert "nonsense" in command("msp-range", "nonsense")
