"""Ctrl-C while the runner of campaigns has several processes."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from evaluation import ROOT
from evaluation.runner import read_rows

INTERRUPTED = """
import time
from pathlib import Path
from evaluation.runner import run_cases

def work(number):
    Path(f"begun-{number}").touch()
    time.sleep(2.0)
    return {"number": number}

if __name__ == "__main__":
    try:
        run_cases({str(number): (number,) for number in range(40)}, work, 2, Path("cases.jsonl"))
    except KeyboardInterrupt:
        raise SystemExit(130)
"""


@pytest.mark.slow
def test_ctrl_c_keeps_the_rows_of_what_has_begun_and_leaves_the_rest(tmp_path: Path) -> None:
    (tmp_path / "campaign.py").write_text(INTERRUPTED)
    process = subprocess.Popen(
        [sys.executable, "campaign.py"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while not list(tmp_path.glob("begun-*")):
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert "ends when what has begun is done" in errors
    begun = {path.name.removeprefix("begun-") for path in tmp_path.glob("begun-*")}
    assert begun == {row["again"] for row in read_rows(tmp_path / "cases.jsonl").values()}
    assert len(begun) < 10
