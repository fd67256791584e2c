"""What documents show is run as they show it: commands and Python programs, in their order."""

from pathlib import Path

import pytest

from tests.docs import how
from tests.docs.runner import NEXT_BLOCK, before, clone, environment, run, script_of
from tests.docs.shown import DOCUMENTS, ROOT
from tests.support.data import measured_data

MEASURED = "../shared/data/"
LIMIT_S = 600.0


def key(path: Path) -> str:
    """A document's name in the tables."""
    return str(path.relative_to(ROOT))


RUN = [path for path in DOCUMENTS if key(path) not in how.ON_BUS and script_of(path)]


@pytest.mark.slow
@pytest.mark.parametrize("path", RUN, ids=key)
def test_what_a_document_shows_runs(path: Path, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    shown = script_of(path)
    if MEASURED in shown:
        measured_data("enmt482/training1.csv")
    script = f"{before(path)}\n{shown}"
    flights = request.getfixturevalue("flown") if "$FLOWN" in script else None
    checked = key(path) in how.NUMBERS_CHECKED
    place = clone(tmp_path, {} if checked else how.SMALLER)
    output = run(script, place, environment(place, flights), LIMIT_S)
    if checked:
        text = " ".join(path.read_text(encoding="utf-8").split())
        printed = output.rpartition(f"{NEXT_BLOCK}\n")[2].splitlines()
        assert printed
        assert [line for line in printed if line.strip() not in text] == []
