"""Where real measured data lies, for tests that skip without it."""

import os
from pathlib import Path

import pytest


def measured_data(name: str) -> Path:
    """The file ``name`` in the folder of measured data; skips the test where it is absent."""
    folder = Path(os.environ.get("MSP_RANGE_DATA", "../shared/data"))
    path = folder / name
    if not path.exists():
        pytest.skip(f"no measured data {name} in {folder}; MSP_RANGE_DATA names its folder")
    return path
