"""Words of the MB1242 as the data sheet and the faults seen in the field have them."""

import pytest

from msp_range.reading import Reading, Status
from msp_range.sensors.mb1242 import decode


@pytest.mark.parametrize("word", [b"\x01\x2c", b"\x02\xfd", b"\x81\x2c"])
def test_before_the_first_ping_nothing_is_a_distance(word: bytes) -> None:
    decoded = decode(word, pinged=False)
    assert (decoded.status, decoded.range_m) == (Status.PART_INFO, None)


@pytest.mark.parametrize("answer", [b"", b"\x01", b"\x01\x02\x03"])
def test_anything_but_two_bytes_is_refused(answer: bytes) -> None:
    with pytest.raises(ValueError, match=f"2 bytes; found {len(answer)}"):
        decode(answer)


@pytest.mark.parametrize("status", Status)
def test_a_reading_has_a_range_exactly_where_its_status_says_so(status: Status) -> None:
    wrong = None if status.has_range else 1.0
    with pytest.raises(ValueError, match=repr(status.value)):
        Reading(0.0, "front", status, wrong)
    assert status.is_fault is (status not in (Status.OK, Status.AT_MINIMUM, Status.NO_ECHO))
