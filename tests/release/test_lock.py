"""requirements.lock, which `make lock` renews, pins all that an installation needs, for each Python and processor."""

import tomllib

import pytest
from packaging.requirements import Requirement

from release import ROOT
from release.wheels import MACHINES, PYTHONS, pins

LOCK = (ROOT / "requirements.lock").read_text(encoding="utf-8")
KALMAN = (ROOT / "requirements-kalman.lock").read_text(encoding="utf-8")
"""What the extra adds."""


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("python", PYTHONS)
def test_it_has_a_version_that_the_project_accepts_and_hashes_for_each_requirement(python: str, machine: str) -> None:
    written = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project = written["project"]
    required = [
        *project["dependencies"],
        *project["optional-dependencies"]["web"],
        *written["build-system"]["requires"],
    ]
    lines = {line.partition("==")[0]: line for line in pins(LOCK, python, machine)}
    for requirement in map(Requirement, required):
        pin = lines[requirement.name].split(" ")[0]
        assert requirement.specifier.contains(pin.partition("==")[2]), (pin, str(requirement))
    added = {line.partition("==")[0]: line for line in pins(KALMAN, python, machine)}
    assert not added.keys() & lines.keys()
    for requirement in map(Requirement, project["optional-dependencies"]["kalman"]):
        pin = added[requirement.name].split(" ")[0]
        assert requirement.specifier.contains(pin.partition("==")[2]), (pin, str(requirement))
    assert all(" --hash=sha256:" in line for line in (*lines.values(), *added.values()))


@pytest.mark.parametrize("lock", [LOCK, KALMAN], ids=["service", "kalman"])
def test_it_names_no_place_to_download_from(lock: str) -> None:
    assert "://" not in lock
    assert "--index" not in lock
