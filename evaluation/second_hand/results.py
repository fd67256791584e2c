"""One JSON file a case: what was hidden, what the workflow found, and the outcome."""

import json
import tempfile
from pathlib import Path
from typing import Any

from evaluation.second_hand.generator import case
from evaluation.second_hand.score import outcome
from evaluation.second_hand.workflow import run_case


def result_file(out: Path, kind: str, seed: int) -> Path:
    """Where the result of a case is."""
    return out / f"{kind.replace(':', '_')}-{seed}.json"


def make_result(out: Path, kind: str, seed: int, final: bool = False) -> None:
    """Make a case, run the workflow on it, and write the result; an interrupted one leaves no file of that name."""
    made = case(kind, seed, final)
    with tempfile.TemporaryDirectory() as folder:
        found = run_case(made, Path(folder))
    result: dict[str, Any] = {"outcome": outcome(made.truth, found), "truth": made.truth, "found": found}
    path = result_file(out, kind, seed)
    unfinished = path.with_suffix(".part")
    unfinished.write_text(json.dumps(result, indent=1))
    unfinished.rename(path)
