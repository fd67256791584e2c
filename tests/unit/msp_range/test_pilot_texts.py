"""The texts to the pilot, and what docs/flying.md says of them."""

import re
from pathlib import Path

import pytest

from msp_range.pilot_texts import DISK_FAULTS, FINDINGS, LONGEST_TEXT, SENSOR_FAULTS, Condition, Severity, Text

REPOSITORY = Path(__file__).parents[3]
CONDITIONS = {name: each for name, each in vars(Text).items() if isinstance(each, Condition)}
DOCUMENT = (REPOSITORY / "docs" / "flying.md").read_text()
SHOWN = re.findall(r"`([^`\n]+)`", DOCUMENT)
LIST = DOCUMENT[DOCUMENT.index("| the pilot reads |") :].split("\n\n")[0]
WORDS = [words for words, _ in SENSOR_FAULTS.values()] + [*DISK_FAULTS.values(), Text.DISK_HANGS]


class Values(dict[str, object]):
    """Something to fill in: words by their names, else a number."""

    def __missing__(self, name: str) -> object:
        return 88


VALUES = Values(sensor="front_left", fault=Text.DISK_HANGS, what="object", found="ardupilot", expected="ardupilot")


def pattern(text: str) -> str:
    """Fits a text whatever is filled in."""
    return "".join(".+" if part.startswith("{") else re.escape(part) for part in re.split(r"(\{.*?\})", text))


def is_shown(text: str) -> bool:
    """Whether the document shows a text, or its end as one of several; without the number of an error."""
    parts = text.removesuffix(" (errno {errno})").split(" ")
    ends = [pattern(" ".join(parts[begin:])) + r"( \(errno \d+\))?" for begin in range(len(parts) - 1)]
    return any(re.fullmatch(end, shown) for end in ends for shown in SHOWN)


@pytest.mark.parametrize("name", CONDITIONS)
def test_the_document_shows_each_text(name: str) -> None:
    text = CONDITIONS[name].text
    assert text is not None
    assert is_shown(text) or name in {"ALL_GOOD", "SOURCE_DISAGREES", "RANGES_DISAGREE"}
    assert len(text.format_map(VALUES)) <= LONGEST_TEXT
    assert len(CONDITIONS[name].over.format_map(VALUES)) <= LONGEST_TEXT


@pytest.mark.parametrize("words", [*WORDS, *[full.format(off="cm too long") for full, _, _ in FINDINGS.values()]])
def test_the_document_shows_what_a_text_may_say(words: str) -> None:
    assert any(words in shown for shown in SHOWN)


def test_the_list_has_no_text_that_is_not_sent() -> None:
    patterns = {pattern(each.text or "") for each in CONDITIONS.values()}
    shown = re.findall(r"^\| `(Range[^`]+)`", LIST, re.M)
    assert [text for text in shown if not any(re.fullmatch(each, text) for each in patterns)] == []


def test_what_is_absent_has_no_text_and_its_end_is_filled_in() -> None:
    silent = Text.SILENT.of(sensor="a")
    assert silent.when(False, sensor="a") == ("silence a", None, "Range a: distance is back", *Text.SILENT[3:])
    assert silent.when(True, sensor="a").text == "Range a: no distance"
    assert Text.GROUND.said(sensor="a") == (Severity.INFO, "Range a: ground below")
