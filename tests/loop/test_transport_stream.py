"""Frames on a byte stream that takes what it likes: whole, in order, not late."""

from hypothesis import given
from hypothesis import strategies as st

from msp_range.mavlink.transport.base import TransportStats
from msp_range.mavlink.transport.stream import FRAME_DEADLINE_S, MOST_WAITING_FRAMES, FrameStream
from tests.support.transports import FRAME_BYTES, StepClock, frame_numbers, numbered_frame


class Pipe:
    """Takes at most ``room`` bytes in all."""

    def __init__(self) -> None:
        self.room = 0
        self.taken = b""

    def write(self, unwritten: bytes) -> int:
        if not self.room:
            raise BlockingIOError
        count = min(self.room, len(unwritten))
        self.taken += unwritten[:count]
        self.room -= count
        return count


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 200), st.floats(0.0, 0.2)), max_size=60))
def test_whatever_the_stream_takes_is_whole_frames_in_order_and_none_is_started_late(
    steps: list[tuple[int, int, float]],
) -> None:
    clock, pipe, stats = StepClock(), Pipe(), TransportStats()
    stream = FrameStream(pipe.write, clock, stats)
    sent_at_s: list[float] = []
    refused: set[int] = set()
    for sends, room, step_s in steps:
        clock.now_s += step_s
        pipe.room += room
        begun = -(-len(pipe.taken) // FRAME_BYTES)
        stream.flush()
        for _ in range(sends):
            if not stream.send(numbered_frame(len(sent_at_s))):
                refused.add(len(sent_at_s))
            sent_at_s.append(clock.now_s)
        whole = len(pipe.taken) // FRAME_BYTES * FRAME_BYTES
        numbers = frame_numbers(pipe.taken[:whole])
        rest = pipe.taken[whole:]
        if rest:
            candidates = [n for n in range(len(sent_at_s)) if numbered_frame(n).startswith(rest)]
            assert candidates
            if len(rest) > 10 + 4:
                numbers.append(candidates[0])
        assert numbers == sorted(set(numbers))
        assert not refused & set(numbers)
        for number in numbers[begun:]:
            assert clock.now_s - sent_at_s[number] <= FRAME_DEADLINE_S
        assert stats.sent_frames == whole // FRAME_BYTES
    stream.abandon()
    assert stats.sent_frames + stats.dropped_frames == len(sent_at_s)


def test_a_frame_begun_is_finished_however_late() -> None:
    clock, pipe, stats = StepClock(), Pipe(), TransportStats()
    stream = FrameStream(pipe.write, clock, stats)
    pipe.room = 20
    assert stream.send(numbered_frame(0))
    assert stream.send(numbered_frame(1))
    clock.now_s += 60.0
    assert stream.send(numbered_frame(2))
    pipe.room = 1000
    stream.flush()
    assert frame_numbers(pipe.taken) == [0, 2]
    assert (stats.sent_frames, stats.dropped_frames) == (2, 1)


def test_a_frame_waits_until_its_deadline_and_no_longer() -> None:
    clock, pipe, stats = StepClock(), Pipe(), TransportStats()
    stream = FrameStream(pipe.write, clock, stats)
    assert stream.send(numbered_frame(0))
    clock.now_s += 0.125
    assert stream.send(numbered_frame(1))
    clock.now_s += 0.1875  # 0.3125 s after the first, 0.1875 s after the second
    pipe.room = 1000
    stream.flush()
    assert frame_numbers(pipe.taken) == [1]


def test_only_so_many_frames_wait() -> None:
    clock, pipe, stats = StepClock(), Pipe(), TransportStats()
    stream = FrameStream(pipe.write, clock, stats)
    taken = [stream.send(numbered_frame(number)) for number in range(MOST_WAITING_FRAMES + 10)]
    assert taken == [True] * MOST_WAITING_FRAMES + [False] * 10
    assert stats.dropped_frames == 10
    clock.now_s += 1.0
    assert stream.send(numbered_frame(100))  # those that waited are late by now


def test_an_empty_frame_does_no_harm() -> None:
    pipe = Pipe()
    pipe.room = 1000
    stream = FrameStream(pipe.write, StepClock(), TransportStats())
    assert stream.send(b"")
    assert stream.send(numbered_frame(1))
    assert frame_numbers(pipe.taken) == [1]
