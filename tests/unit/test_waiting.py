"""The helper by which tests wait: it goes on as soon as it may, and its message shows what was seen last."""

import itertools

import pytest

from tests.support.waiting import until, until_passes


def test_it_is_asked_once_more_at_the_end() -> None:
    """A process that had no processor for the whole limit has missed nothing."""
    answers = iter([False, True])
    until(lambda: next(answers), limit_s=0.0)


def test_the_message_has_the_condition_and_what_was_seen_last() -> None:
    states = itertools.count()
    with pytest.raises(AssertionError, match=r"not within 0 s: .*next\(states\) < 0.*; seen last: 2"):
        until(lambda: next(states) < 0, limit_s=0.0, seen=lambda: next(states))


def test_all_that_is_asserted_is_waited_for_and_the_last_failure_is_shown() -> None:
    states = itertools.count()

    def is_three() -> None:
        state = next(states)
        assert state == 3, f"found {state}"

    with pytest.raises(AssertionError, match=r"is_three.*; seen last: found 1"):
        until_passes(is_three, limit_s=0.0, work=lambda: None)
    until_passes(is_three)
    assert next(states) == 4
