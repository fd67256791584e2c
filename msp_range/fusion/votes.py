"""What each downward sensor saw lately, against the ground that all of them make up: its vote.

A reading that fits the plane is ground. One that does not is off the ground by some distance, nearer or farther; a
reading without a range says nothing. A sensor's last three readings are its vote, so that one missed reading and one
outlier change nothing. Votes decide whether the ground may be sent, whether it has a step, and what is an object below
one sensor or a hole.
"""

from collections import deque
from collections.abc import Collection
from statistics import median
from typing import NamedTuple

from msp_range.fusion.windows import Windows

READINGS_OF_A_VOTE = 3
"""Readings of a sensor that make its vote: with two of three one may be missed or wrong. More are surer and later."""
AGREE_M = 0.12
"""Readings of different sensors that are this close, moved to one time and place, see the same ground [m]: three times
the noise of two sensors and the slope between them. Twice as much takes a kerb for no step."""
CLOSE_M = 0.06
"""Where only two sensors see a step and others do not, they must be this close [m]: half of what two outliers are by
chance within `AGREE_M`."""
LEAVING_M_S = 2.0
"""Readings of two sensors that move on may differ by as much as the vehicle climbs between them [m/s]."""
LEAVING_M = 0.5
"""What moves away from the ground that stuck sensors hold is first seen no farther from it than this [m]."""


class Seen(NamedTuple):
    """One reading: when [s]; how much farther than the ground it was [m], None where it had no range; and its kind."""

    time_s: float
    off_m: float | None
    is_ground: bool


class Sight:
    """One sensor's last readings against the ground.

    Attributes
    ----------
    repeated
        Whether it has given the same answer for long: where others move on, it has no vote.
    works
        Whether its last reading was none of a fault.
    read_s
        When it was last read [s].
    """

    __slots__ = ("_seen", "read_s", "repeated", "works")

    def __init__(self) -> None:
        self.repeated = False
        self.works = False
        self.read_s = float("-inf")
        self._seen: deque[Seen] = deque(maxlen=READINGS_OF_A_VOTE)

    def ground(self, time_s: float) -> None:
        """It saw the ground."""
        self._seen.append(Seen(time_s, 0.0, True))

    def off(self, time_s: float, off_m: float) -> None:
        """It saw something ``off_m`` farther than the ground."""
        self._seen.append(Seen(time_s, off_m, False))

    def nothing(self, time_s: float) -> None:
        """Its reading had no range, or none to be believed."""
        self._seen.append(Seen(time_s, None, False))

    def newest(self, since_s: float) -> Seen | None:
        """Its newest reading with a range, where that is not older than ``since_s``."""
        for seen in reversed(self._seen):
            if seen.off_m is not None:
                return seen if seen.time_s >= since_s else None
        return None

    def clear(self) -> None:
        """Forget its readings."""
        self._seen.clear()

    def before(self) -> Seen | None:
        """The reading before the newest one."""
        return self._seen[-2] if len(self._seen) > 1 else None

    def votes_ground(self, since_s: float) -> bool:
        """Whether two of its last three readings were ground, or the only one with a range."""
        grounds = others = 0
        for time_s, off_m, is_ground in self._seen:
            if off_m is not None and time_s >= since_s:
                if is_ground:
                    grounds += 1
                else:
                    others += 1
        return grounds > 1 or (grounds == 1 and not others)

    def votes_off_m(self, since_s: float) -> float | None:
        """Where two of its last three readings agree on another height: how much farther that is [m]."""
        offs = [
            seen.off_m
            for seen in self._seen
            if seen.off_m is not None and not seen.is_ground and seen.time_s >= since_s
        ]
        for i, one in enumerate(offs):
            for other in offs[i + 1 :]:
                if abs(one - other) < AGREE_M:
                    return (one + other) / 2
        return None

    def move(self, by_m: float) -> None:
        """The ground is now taken to be ``by_m`` lower than before."""
        moved = [seen if seen.off_m is None else _moved(seen, seen.off_m - by_m) for seen in self._seen]
        self._seen.clear()
        self._seen.extend(moved)


def _moved(seen: Seen, off_m: float) -> Seen:
    return Seen(seen.time_s, off_m, abs(off_m) < AGREE_M)


class Tally(NamedTuple):
    """The votes of all sensors.

    Attributes
    ----------
    ground, moving
        Sensors that vote for the ground; those of them that do not repeat themselves.
    against
        The most sensors that vote for one and the same other height.
    voters
        Sensors that work and have given a range lately.
    are_leaving
        Whether the newest ranges of more than half of them, and of two at least, are off to the same side.
    """

    ground: int
    moving: int
    against: int
    voters: int
    are_leaving: bool


def tally(sights: Collection[Sight], now_s: float, windows: Windows) -> Tally:
    """Count the votes."""
    since_s = now_s - windows.held_s
    ground = moving = voters = farther = nearer = 0
    fresh_s = now_s - windows.fresh_s
    offs: list[float] = []
    for sight in sights:
        if sight.votes_ground(since_s):
            ground += 1
            moving += not sight.repeated
        elif sight.works and not sight.repeated and (off_m := sight.votes_off_m(since_s)) is not None:
            offs.append(off_m)
        newest = sight.newest(since_s) if sight.works else None
        if newest is not None:
            voters += 1
            off_m = 0.0 if newest.is_ground or newest.time_s < fresh_s else newest.off_m or 0.0
            farther += off_m > 0.0
            nearer += off_m < 0.0
    against = 0
    for off_m in offs:
        against = max(against, sum([abs(off_m - other_m) < AGREE_M for other_m in offs]))
    are_leaving = 2 * max(farther, nearer) > max(voters, 2)
    return Tally(ground, moving, against, voters, are_leaving)


def working(sights: Collection[Sight], now_s: float, windows: Windows) -> int:
    """Sensors that are in order and do not repeat themselves, whether they give ranges or get no echo."""
    since_s = now_s - windows.held_s
    return sum([sight.works and not sight.repeated and sight.read_s >= since_s for sight in sights])


def step_m(newest: Sight, sights: Collection[Sight], now_s: float, windows: Windows) -> float | None:
    """How much lower the ground is by the sensors that agree with the newest reading; None where they are too few.

    More sensors must see it than still vote for the old ground, more than half of those that give ranges, and two at
    least; a sensor that is alone must see it twice in a row. Where sensors that repeat themselves hold the ground alone
    and the others leave it slowly, they do not count: they may be stuck, and the vehicle may be climbing.
    """
    fresh_s, held_s = now_s - windows.fresh_s, now_s - windows.held_s
    own = newest.newest(fresh_s)
    if own is None or own.off_m is None or own.is_ground:
        return None
    recent = {sight: seen for sight in sights if sight.works and (seen := sight.newest(fresh_s)) is not None}
    if tally(sights, now_s, windows).voters == 1:
        if any(sight is not newest and not sight.repeated and sight.votes_ground(held_s) for sight in sights):
            return None
        before = newest.before()
        agrees = before is not None and before.off_m is not None and abs(own.off_m - before.off_m) < AGREE_M
        return own.off_m if agrees else None
    holding = [sight for sight, seen in recent.items() if seen.is_ground]
    leaving = bool(holding) and all(sight.repeated for sight in holding) and abs(own.off_m) < LEAVING_M
    speed_m_s = LEAVING_M_S if leaving else 0.0
    agreeing = {
        sight: seen.off_m
        for sight, seen in recent.items()
        if seen.off_m is not None
        and not seen.is_ground
        and abs(seen.off_m - own.off_m) < AGREE_M + speed_m_s * (own.time_s - seen.time_s)
    }
    # Between pairs that have long disagreed one reading of the ground's decides only where it is close to the others.
    settled = [off_m for sight, off_m in agreeing.items() if not sight.votes_ground(held_s)]
    if len(settled) >= 2 and not leaving:
        agreeing = {sight: off_m for sight, off_m in agreeing.items() if abs(off_m - median(settled)) < CLOSE_M}
    others = [sight for sight in sights if sight not in agreeing and not (leaving and sight.repeated)]
    # Also one whose last answer was lost has seen it just now.
    old = [sight for sight in others if sight.votes_ground(held_s)]
    voters = [*agreeing, *(sight for sight in others if sight.works and sight.newest(held_s) is not None)]
    offs = list(agreeing.values())
    if len(offs) < 2 or len(offs) <= len(old) or 2 * len(offs) <= len(voters):
        return None
    if len(offs) == 2 and old and abs(offs[0] - offs[1]) > CLOSE_M:
        return None
    return own.off_m if leaving else median(offs)
