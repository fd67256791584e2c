"""What several documents have in common."""

import fcntl
import os
from pathlib import Path

import pytest

from tests.docs.runner import fly_four


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four recorded flights and their tables, flown by the first process that needs them."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "flown"
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "made").exists():
            fly_four(folder)
    return folder / "made"
