"""A recorded flight played through the bridge again, as `msp-range replay` does."""

from pathlib import Path

from msp_range import replay
from msp_range.clock import VirtualClock
from msp_range.config import Airframe
from msp_range.recording.pings import Recorded
from msp_range.replay import Nowhere

LONGEST_S = 600.0
MOST_PINGS = 400
"""Longer flights are not played: they take a time in proportion, 3 ms a second and 1 ms a ping."""


def play(
    airframe: Airframe,
    recorded: Recorded,
    source: Path,
) -> None:
    """Replay the pings, all of which have to come to their end."""
    pings, first_s = recorded.pings, recorded.first_ping_s
    last_s = max(each.ping_s for some in pings.values() for each in some)
    count = sum(map(len, pings.values()))
    if last_s - first_s > LONGEST_S or count > MOST_PINGS:
        return
    clock = VirtualClock(first_s)
    outcome = replay.replay(airframe, recorded, source, clock, Nowhere())
    assert sum(each.readings for each in outcome.counts.values()) >= count
