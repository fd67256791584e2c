"""The fuzzing of the link finds what is put in."""

from mmap import mmap
from random import Random

import pytest

from evaluation.fuzz import link
from msp_range.mavlink.frames import Frame, FrameReader

pytestmark = pytest.mark.slow


def test_the_same_seed_makes_the_same_bytes() -> None:
    def some(seed: int) -> list[bytes]:
        rng = Random(seed)
        return [link.made_up(rng) for _ in range(20)]

    assert some(3) == some(3) != some(4)


def test_an_exception_is_found_with_its_place_and_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    real = FrameReader.read

    def read(self: FrameReader, arrived: bytes) -> list[Frame]:
        if b"\xfe" in arrived:
            raise IndexError("made for this test")
        return real(self, arrived)

    monkeypatch.setattr(FrameReader, "read", read)
    result = link.fuzz(2.0, seed=1)
    assert any("IndexError('made for this test') in test_fuzz_link.py" in each for each in result.failures)
    assert result.cases > len(result.failures)


def test_a_buffer_that_keeps_everything_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """In maps of their own: of what the tests before have freed, the process would take 8 MB without growing."""
    kept = []
    real = FrameReader.read

    def read(self: FrameReader, arrived: bytes) -> list[Frame]:
        kept.append(mmap(-1, 20_000))
        kept[-1].write(b"\1" * 20_000)
        return real(self, arrived)

    monkeypatch.setattr(FrameReader, "read", read)
    monkeypatch.setattr(link, "WARM_UP_CASES", 10)
    monkeypatch.setattr(link, "GROWTH_MB", 5.0)
    result = link.fuzz(3.0, seed=1, fewest=400)
    assert any("memory grew by" in each for each in result.failures)
