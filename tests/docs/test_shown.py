"""What documents show is run as they show it: commands and Python programs, in their order."""

from pathlib import Path

import pytest

from tests.docs import how
from tests.docs.runner import clone, environment, fly_four, run, scripts
from tests.docs.shown import DOCUMENTS, ROOT
from tests.support.data import measured_data

MEASURED = "../shared/data/"
LIMIT_S = 600.0


def key(path: Path) -> str:
    """A document's name in the tables."""
    return str(path.relative_to(ROOT))


RUN = [path for path in DOCUMENTS if key(path) not in how.ON_BUS and scripts(path)]


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four recorded flights and their tables."""
    return fly_four(tmp_path_factory.mktemp("flown"))


@pytest.mark.slow
@pytest.mark.parametrize("path", RUN, ids=key)
def test_what_a_document_shows_runs(path: Path, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    shown = scripts(path)
    if any(MEASURED in script for script in shown):
        measured_data("enmt482/training1.csv")
    before = how.PREPARE.get(key(path), "")
    flights = request.getfixturevalue("flown") if "$FLOWN" in before else None
    place = clone(tmp_path)
    for script in [before, *shown]:
        output, code = run(script, place, environment(place, flights), LIMIT_S)
        assert code == 0, f"{script}\n{output[-4000:]}"
