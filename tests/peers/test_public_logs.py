"""Public logs of real vehicles, where somebody has fetched them: docs/logs.md says from where. Nothing is committed."""

import hashlib
import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from msp_lab.cli import app

FOLDER = os.environ.get("MSP_RANGE_FLIGHTS", "")
"""A folder with the logs."""
DOCUMENT = Path(__file__).parents[2] / "docs" / "logs.md"


def fetched(name: str) -> Path:
    """A log of the folder, the same as in the document; skips the test where it is absent."""
    path = Path(FOLDER) / name
    if not FOLDER or not path.exists():
        pytest.skip(f"no log {name}: docs/logs.md says where it is; MSP_RANGE_FLIGHTS names the folder")
    assert hashlib.sha256(path.read_bytes()).hexdigest() in DOCUMENT.read_text(encoding="utf-8")
    return path


def test_a_sonar_under_an_ardusub_that_was_not_moved(tmp_path: Path) -> None:
    path = fetched("2023-04-18 11-03-34.tlog")
    done = CliRunner().invoke(app, ["import", str(path), "--out", str(tmp_path / "set"), "--json"])
    assert done.exit_code == 0, done.output
    (found,) = json.loads(done.stdout)
    (sonar,) = found["rangers"]
    assert (sonar["readings"], sonar["silent"], sonar["low_cm"], sonar["high_cm"]) == (919, 0, 2865.0, 4102.0)
    # Its height is the barometer's, and says that it stood: no true range for readings that differ by 12 m.
    assert found["truth"] == "ekf"
    assert sonar["lag_s"] is None
    assert sonar["reference_span_cm"] < 2.0
