"""The fuzzing of the link finds what is put in."""

from pathlib import Path

import pytest

from evaluation.fuzz import link
from msp_range.bridge import Bridge, Step
from msp_range.mavlink.frames import Frame, FrameReader

pytestmark = pytest.mark.slow


def test_an_exception_and_a_bridge_that_stands_still_are_found_and_end_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = FrameReader.read

    def read(self: FrameReader, arrived: bytes) -> list[Frame]:
        if b"\xfe" in arrived:
            raise IndexError("made for this test")
        return real(self, arrived)

    monkeypatch.setattr(FrameReader, "read", read)
    check = link.prepare(tmp_path)
    # The first bytes make the far end known to the bridge, whatever the kind of link.
    for kind in range(5):
        check(bytes([kind]) + bytes(4) + b"\xfd" * 3000)
        with pytest.raises(IndexError, match="made for this test"):
            check(bytes([kind]) + bytes(4) + b"\xfe" * 3000)
        check(bytes([kind]) + bytes(4) + b"\xfd" * 3000)

    def idle(bridge: Bridge) -> list[Step]:
        bridge._clock.sleep_until(bridge._clock.now() + 0.1)
        return []

    monkeypatch.setattr(Bridge, "step", idle)
    for kind in range(5):
        with pytest.raises(AssertionError, match="no reading"):
            check(bytes([kind]) + bytes(4))
