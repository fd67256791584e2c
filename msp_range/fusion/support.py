"""Whether the ground that is known may be sent.

What each reading was, the ground's or not, enters, and the sensors' votes; a yes or no leaves. The ground may be sent
while sensors enough see it and no more of them agree on another one, and not in the turns in which the vehicle or the
ground seems to do what the filter has not seen yet.
"""

from collections import deque
from collections.abc import Sequence

from msp_range.fusion.votes import AGREE_M, LEAVING_M_S, Sight, tally
from msp_range.fusion.windows import Windows

OFF_IN_A_ROW = 3
"""After readings of so many sensors in a row, or of all, that are not of the ground, or of two that agree with each
other or as two of a vehicle that moves on, nothing is sent until one is: the ground may have a step, or the vehicle a
motion that the filter has not seen. Fewer make gaps of outliers, more send an old ground for longer."""
ON_TRIAL, DOUBT_READINGS = 3, 8
"""A first ground with which other readings do not agree, or after most of the last readings were of no ground, is sent
after so many further readings of it in a row: four outliers may lie on a line once in some seconds of nothing else,
seven do not."""
STALE_S = 0.25
"""A ranging that is over this long after its time says nothing of now [s]: the program or the bus stood still."""


class GroundSupport:
    """Which of the last readings support the known ground.

    Parameters
    ----------
    sights
        What each sensor saw lately, kept up to date by the fusion.
    windows
        How long what a sensor saw counts.
    widest_m
        Readings that are farther apart than this are never taken for the same [m].

    Attributes
    ----------
    seen_s
        Time of the last reading that was of the ground [s].
    """

    def __init__(self, sights: Sequence[Sight], windows: Windows, widest_m: float) -> None:
        self._sights = sights
        self._windows = windows
        self._same_m = min(AGREE_M + LEAVING_M_S * windows.gap_s, widest_m)
        self.seen_s = float("-inf")
        self._was_ground: deque[bool] = deque(maxlen=DOUBT_READINGS)
        # Of the ground that is known: two sensors have agreed on it, more than half of them have seen it, and how many
        # further readings it takes before it is sent.
        self._established = self._proven = False
        self._on_trial = 0
        # Since the last reading of the ground: how far off each sensor was, and whether two of them agreed.
        self._off_m: dict[str, float] = {}
        self._two_agree = False

    def on_new_ground(self, in_doubt: bool) -> None:
        """Another ground is known from now on; in doubt where not all readings agreed on it."""
        self._established = self._proven = False
        doubtful = in_doubt or self._was_ground.count(False) > len(self._was_ground) // 2 > 0
        self._on_trial = ON_TRIAL + 1 if doubtful else 0

    def on_ground(self, time_s: float) -> None:
        """A reading was of the ground."""
        self.seen_s = time_s
        self._was_ground.append(True)
        self._on_trial = max(self._on_trial - 1, 0)
        self._off_m.clear()
        self._two_agree = False

    def on_other(self, sensor: str, off_m: float, is_object: bool) -> None:
        """A reading was not of the ground but ``off_m`` farther; a known object is no reason to doubt the ground."""
        self._was_ground.append(False)
        if self._on_trial:
            self._on_trial = ON_TRIAL
        if not is_object:
            others = [other_m for name, other_m in self._off_m.items() if name != sensor]
            self._two_agree |= any(abs(other_m - off_m) < self._same_m for other_m in others)
            self._off_m[sensor] = off_m

    def is_seen(self, time_s: float) -> bool:
        """Whether two sensors vote for the ground, or the only one that gives ranges, and one has seen it just now."""
        if time_s - self.seen_s > self._windows.newest_s:
            return False
        votes = tally(self._sights, time_s, self._windows)
        return votes.ground >= min(2, votes.voters) > 0

    def is_enough(self, time_s: float, now_s: float, was_ground: bool) -> bool:
        """Whether the ground may be sent: sensors enough see it, and no more of them agree on another one.

        Of as many against as many the ground is that which more than half have seen before; until then more than half
        of the sensors that give ranges must see it. All of those that see it may be stuck where they repeat themselves.
        Where most newest readings lie to one side of it, the vehicle may be leaving it too fast for them to agree.

        Parameters
        ----------
        time_s, was_ground
            Time of the newest reading [s], and whether it was of the ground.
        now_s
            When it is passed on [s].
        """
        windows = self._windows
        if time_s - self.seen_s > windows.fresh_s:
            self._established = False
        if time_s - self.seen_s > windows.newest_s:
            return False
        votes = tally(self._sights, time_s, windows)
        self._established |= votes.ground >= min(2, votes.voters) and votes.ground > votes.against
        has_most = self._proven or self._has_most(votes.ground, time_s)
        if not self._established or self._on_trial or votes.ground < 1 or now_s - time_s > STALE_S:
            return False
        if votes.ground < votes.against or not has_most:
            return False
        if votes.ground == votes.against and not votes.moving:
            return False
        if votes.are_leaving:
            return False
        all_off = len(self._off_m) >= min(OFF_IN_A_ROW, votes.voters)
        return was_ground or (votes.ground >= 2 and not self._two_agree and not all_off)

    def _has_most(self, ground: int, time_s: float) -> bool:
        """Whether so many are most of the sensors that give ranges; of all in order, the ground is proven from now."""
        # An answer that was lost just now is no sensor that is out of order.
        ranging = [sight for sight in self._sights if sight.newest(time_s - self._windows.held_s) is not None]
        in_order = [sight for sight in self._sights if sight.works or sight.read_s == float("-inf")]
        self._proven = 2 * ground > len({*ranging, *in_order})
        return 2 * ground > len(ranging)
