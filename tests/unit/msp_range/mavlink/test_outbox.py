"""What waits behind a fused message: the newest of each stream, in turn, 20 ms apart."""

from msp_range.mavlink.streams import SPACING_S, Outbox


def test_the_newest_message_of_a_stream_takes_the_place_of_one_that_waits() -> None:
    sent: list[str] = []
    outbox = Outbox(sent.append)
    outbox.send_now(1.0, "fused")
    outbox.put(1.0, 1, "one, old")
    outbox.put(1.0, 2, "two")
    outbox.put(1.0, 1, "one, new")
    outbox.send_due(1.0 + SPACING_S / 2)
    assert sent == ["fused"]
    outbox.send_due(1.0 + SPACING_S)
    outbox.send_due(1.0 + SPACING_S)
    assert sent == ["fused", "one, new"]
    outbox.send_due(1.0 + 2 * SPACING_S)
    assert sent == ["fused", "one, new", "two"]
    assert outbox.next_event_s == float("inf")
