"""Each area of the fuzzing for some seconds, of which `make fuzz` gives ten minutes, and the loop that they share."""

from collections.abc import Iterator
from pathlib import Path
from random import Random

import pytest

from evaluation.fuzz import base
from evaluation.fuzz.command import AREAS
from tests.support import crashing


@pytest.mark.parametrize("area", AREAS)
def test_changed_input_is_read_or_has_a_line(area: str) -> None:
    result = AREAS[area].fuzz(0.6, 1)
    assert result.area == area
    assert result.cases > 3
    assert result.failures == [], "\n".join(result.failures)


def run(inputs: list[bytes], seconds: float) -> base.FuzzResult:
    """The result of these inputs, and then of none until the time is over."""
    rest: Iterator[bytes] = iter(inputs)
    return base.run(
        "crash", seconds, 1, lambda rng: next(rest, b""), crashing.prepare, len(inputs) + base.WARM_UP_CASES
    )


@pytest.mark.slow
def test_a_crash_is_a_finding_and_not_the_end_of_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(base, "FOLDER", tmp_path / "fuzz")
    result = run([b"", b"raise", b"", b"die", b"take much", b"raise", b""], seconds=5.0)
    assert result.cases > 7
    assert [each.split("\n")[0] for each in result.failures] == [
        f"{tmp_path}/fuzz/crash-1-2: ValueError in crashing.py:20 check",
        f"{tmp_path}/fuzz/crash-1-4: the process died: SIGSEGV",
        f"{tmp_path}/fuzz/crash-1-5: MemoryError in crashing.py:24 check",
    ]
    assert "no such thing" in result.failures[0]
    assert [path.read_bytes() for path in sorted((tmp_path / "fuzz").iterdir())] == [b"raise", b"die", b"take much"]


@pytest.mark.slow
def test_memory_that_is_kept_is_a_finding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(base, "FOLDER", tmp_path / "fuzz")
    result = run([b"grow"] * 250, seconds=2.0)
    assert result.cases > 250
    assert 70 < result.growth_mb < 80
    assert result.failures == [f"crash: memory grew by {result.growth_mb:.1f} MB, expected at most 20"]


@pytest.mark.slow
def test_the_same_seed_draws_the_same_inputs() -> None:
    def drawn(seed: int) -> list[bytes]:
        inputs: list[bytes] = []

        def make(rng: Random) -> bytes:
            inputs.append(rng.randbytes(4))
            return inputs[-1]

        base.run("crash", 0.0, seed, make, crashing.prepare)
        return inputs[:1]

    assert drawn(3) == drawn(3) != drawn(4)
