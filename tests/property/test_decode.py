"""Every one of the 65536 words that an MB1242's bus can give."""

from msp_range.reading import Status
from msp_range.sensors.mb1242 import decode, encode


def test_what_is_encoded_is_decoded() -> None:
    for reading_cm in range(20, 765):
        decoded = decode(encode(reading_cm))
        assert decoded.status.has_range
        assert decoded.raw == reading_cm
        assert decoded.range_m == reading_cm / 100
    assert decode(encode(765)).status is Status.NO_ECHO


def test_no_other_word_is_a_distance() -> None:
    for word in range(0x10000):
        decoded = decode(word.to_bytes(2, "big"))
        legal = 20 <= word <= 764
        assert (decoded.range_m is not None) is legal
        assert decoded.status.has_range is legal
        assert (decoded.status is Status.CLOCK_FAULT) is (word >= 0x8000)
        assert (decoded.status is Status.AT_MINIMUM) is (word == 20)
        assert (decoded.status is Status.IMPOSSIBLE) is not (legal or word == 765 or word >= 0x8000)
        assert (decoded.raw, decoded.suspect) == (word, word in (253, 255))
