"""The table of names, its copy in the documents, and the catalogue."""

import json

import pytest

from evaluation import ROOT
from evaluation.real.commands import run_command
from evaluation.real.names import expected_names, markdown_table
from evaluation.real.sets import SETS


def test_document_has_the_table() -> None:
    assert markdown_table() in (ROOT / "docs" / "real_data.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_every_set_has_names_and_every_name_is_in_the_catalogue() -> None:
    catalogue = {each["name"] for each in json.loads(run_command("msp-lab", "effects", "--json").stdout)}
    expected = expected_names()
    assert list(expected) == [each.name for each in SETS]
    for name, lines in expected.items():
        for line in lines:
            assert line.status in ("required", "allowed", "forbidden")
            for what in line.what:
                assert what in catalogue or what.startswith(("unknown ", "calibration ")), (name, what)
        forbidden = {what for line in lines if line.status == "forbidden" for what in line.what}
        assert not forbidden & {what for line in lines if line.status != "forbidden" for what in line.what}, name
