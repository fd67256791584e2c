"""One belief about which of the surfaces that the downward sensors see is the ground.

Each surface has a filter of its height. A reading belongs to the surface that explains it best, or begins a new one.
How probable each surface is as the ground follows from the evidence that it is there, from its prior where it was first
seen, from how the other sensors would have to be explained, and from how it responds to the vehicle's motion. All
priors, and the thresholds of modes, are in `msp_range.fusion.modes`.
"""

import copy
import math
from collections.abc import Mapping, Sequence

from msp_range.fusion.ground_filter import SLOPE_STD, GroundFilter
from msp_range.fusion.modes import (
    ANSWERED,
    AWAY_M,
    BLIND_M_S,
    BLIND_NEAR_M,
    COMMON,
    COMMON_AGAIN,
    COMMON_LOW,
    EVIDENCE_LEAST,
    EVIDENCE_MOST,
    HIT,
    HIT_MOST,
    LATE_BEGINS,
    LOW_M,
    MISS,
    MOST,
    MOVES,
    P_OUTLIER,
    PER_M,
    RETURNS_M,
    RISES_M,
    SAME_M,
    SAME_RAW,
    SAME_RAW_MOST,
    SHARED,
    START,
    STAYS,
    SURE,
    SURFACES,
    UNANSWERED,
    UNSEEN,
    SensorMode,
    all_noise,
    ground_prior,
    object_prior,
)
from msp_range.fusion.mounting import View
from msp_range.fusion.response import MotionResponse
from msp_range.fusion.vertical import Known, Mark, Rate, VerticalMotion
from msp_range.fusion.windows import Windows
from msp_range.pilot_texts import Condition, Text

STEP_STD_M, STEP_CLIMB_STD_M_S = 0.1, 0.3
"""What a new surface leaves uncertain of the height [m] and of its rate [m/s]: the first reading may be of a flank."""
SURE_STD_M_S, START_CLIMB_STD_M_S = 0.3, 3.0
"""The barometer's rate is used at the start below this deviation [m/s]; else a vehicle may climb by the second."""


class Surface:
    """Something that sensors see, perhaps the ground.

    Attributes
    ----------
    filter
        Its height below the reference point.
    prior, common
        Log prior that it is the ground, and that it is a fault of several sensors, relative to a reading of nothing.
    evidence
        Log likelihood ratio of its readings over readings of nothing.
    began_m
        Its height when it was first seen [m].
    mark, marked_m
        The barometer's height since which its rise is counted, and its own height then [m]; see `Belief._rises`.
    response
        Whether it answers to the vehicle's motion.
    least_s
        When a reading of it last stood for this range or less, as on the ground [s].
    again
        How much the sensors that saw it with their last answers once more say that they are a ping late [nats].
    """

    def __init__(self, ground: GroundFilter, prior: float, common: float, response: MotionResponse) -> None:
        self.filter = ground
        self.prior, self.common = prior, common
        self.response = response
        self.evidence = 0.0
        self.began_m = self.marked_m = ground.height_m
        self.mark: Mark | None = None
        self.seen_s = self.kept_s = self.least_s = float("-inf")
        self.raw: float | None = None
        self.same = 0.0
        self.again = 0.0


class Belief:
    """The surfaces, and which of them is the ground.

    Parameters
    ----------
    modes
        Of all sensors.
    motion, windows
        How the vehicle moves; for how long readings count.

    Attributes
    ----------
    surfaces
        All.
    ground
        The surface that is most probably the ground; None: none is known.
    sure
        The probability of that, and that not all readings are noise. At a tie: that the ground so far, or the likeliest
        other surface, is the ground below the vehicle.
    noise
        The probability that the readings of all sensors are noise.
    doubt
        Why what more than half of the sensors see, or half of them where nothing is sure, is perhaps no ground:
        `Text.CHANGE`, a ground was known, and this is more probably a fault; `Text.NO_RESPONSE`, it does not follow the
        vehicle's motion; or `Text.STEEP`, it would be ground, were it level. It lasts until some ground is sure, or
        nothing is seen any more and no sensor is fixed to the vehicle; None: no reason.
    proven
        The ground that more than half of the sensors have seen, until another one is more probable; None: none was.
    reference
        The ground that priors count from: the proven one, or the one before it, while that may be seen again.
    """

    def __init__(self, modes: Sequence[SensorMode], motion: VerticalMotion, windows: Windows) -> None:
        self._modes = modes
        self._motion = motion
        self._windows = windows
        self.surfaces: list[Surface] = []
        self.proven: Surface | None = None
        self.reference: Surface | None = None
        self._proven_s = float("-inf")  # Since when more sensors see the proven ground than the one before.
        self._known: Known | None = None
        self._response: MotionResponse | None = None  # Of the last ground.
        self._time_s = float("-inf")
        self._is_measured = self._was_no_ground = False
        self.ground: Surface | None = None
        self.sure = self.noise = 0.0
        self.doubt: Condition | None = None

    def predict(self, time_s: float) -> None:
        """Move all surfaces on, and forget those that nobody has seen for long."""
        if self.surfaces:
            up_m_s2 = self._motion.acceleration(self._time_s, time_s)
            self._is_measured = up_m_s2 is not None
            for surface in list(self.surfaces):
                if time_s - max(surface.seen_s, surface.kept_s) > self._windows.memory_s:
                    if surface.response.log_odds < UNANSWERED:
                        self._found_no_ground()
                    self._drop(surface)
                else:
                    answers = surface.response.log_odds > UNANSWERED
                    surface.filter.predict(time_s - self._time_s, up_m_s2 if answers else None)
        self._time_s = time_s

    def level(self) -> None:
        """Forget the slopes, which were estimated in another frame."""
        for surface in self.surfaces:
            surface.filter.level()

    def on_sent(self, known: Known) -> None:
        """The ground has been sent: remember where it was."""
        if self.proven is self.ground:
            self._known = known

    def sees(self, surface: Surface, since_s: float) -> list[SensorMode]:
        """The sensors whose newest range is of a surface, and not older."""
        return [mode for mode in self._modes if mode.sees is surface and mode.seen_s >= since_s]

    def best_of(
        self, mode: SensorMode, range_m: float | None, densities: Mapping[Surface, float]
    ) -> tuple[Surface | None, float]:
        """The surface that a reading is of, by its density under each [1/m], and how probable; None: nothing known.

        Updates how likely the sensor's readings are noise, but not without its range [m], as of a fault code.
        """
        best, most = None, mode.outlier * PER_M
        total = most
        for surface, density in densities.items():
            likely = density * (STAYS if surface is mode.sees else MOVES)
            total += likely
            if likely > most:
                best, most = surface, likely
        if self.surfaces and range_m is not None:
            mode.weigh_noise(range_m, total)
        return best, most / total

    @property
    def is_scattered(self) -> bool:
        """Whether the readings of all sensors are more probably noise than not."""
        return self.noise > 0.5

    def best_seen(self, mode: SensorMode) -> Surface | None:
        """The surface that most others see which do not repeat themselves.

        One sensor that sees something else may be the one that is wrong, unless there are only two.
        """
        since_s = self._time_s - self._windows.fresh_s
        best, most = None, 0
        for surface in self.surfaces:
            sees = sum([not each.repeated for each in self.sees(surface, since_s) if each is not mode])
            enough = sees > 1 or (sees == 1 and (surface is self.ground or len(self._modes) == 2))
            if enough and (sees > most or (sees == most and surface is self.ground)):
                best, most = surface, sees
        return best

    def hit(self, mode: SensorMode, surface: Surface, density: float, raw: float | None, least: bool) -> None:
        """A reading is of a surface; ``least``: it stands for this range or less, as on the ground."""
        mode.count_outlier(False)
        if least:
            surface.least_s = self._time_s
        if surface.evidence <= 0.0 and surface is not self.proven:
            self._appraise(surface, raw)  # Its first reading may have been of something else.
        self._update_same(surface, raw)
        gain = min(math.log(max(density, 1e-9) / PER_M) + HIT + math.log(P_OUTLIER / mode.outlier), HIT_MOST)
        surface.evidence = min(surface.evidence + gain, EVIDENCE_MOST)
        if mode.readings == 1:
            self._began_late(mode, surface, raw)
        has_left = surface.began_m < LOW_M and surface.filter.height_m > AWAY_M
        if surface is self.proven and (has_left or surface.response.log_odds > ANSWERED):
            surface.common = math.log(COMMON) if least else _common(surface)
            surface.response.is_in_doubt = self._was_no_ground = False
            surface.mark = None
        elif not least and surface.common > math.log(COMMON) and surface.response.log_odds < UNANSWERED:
            surface.response.is_in_doubt = True
        self.seen(surface)

    def seen(self, surface: Surface) -> None:
        """A reading has been of a surface, as new as it was."""
        surface.seen_s = self._time_s
        for other in list(self.surfaces):
            is_apart = abs(other.filter.height_m - surface.filter.height_m) >= SAME_M
            if other is not surface and other in self.surfaces and not is_apart:
                surface = self._merge(surface, other)

    def start(self, mode: SensorMode, height_m: float, variance_m2: float, view: View, raw: float | None) -> Surface:
        """A reading is of nothing known: perhaps of a new surface."""
        if self.surfaces:
            mode.count_outlier(True)
        for surface in self.surfaces:
            surface.evidence = max(surface.evidence - MISS, EVIDENCE_LEAST)
        parent = self.proven
        if parent is None:
            lever_m = (-view.by_north / view.by_height, -view.by_east / view.by_height)
            climb = self._motion.rate(self._time_s)
            if climb is None or climb.variance > SURE_STD_M_S**2:
                climb = Rate(0.0, START_CLIMB_STD_M_S**2)
            ground = GroundFilter(height_m, variance_m2, climb, lever_m)
        else:
            ground = copy.copy(parent.filter)
            off_m = height_m - ground.height_m
            may_climb = not self._is_measured and abs(off_m) < BLIND_NEAR_M
            ground.shift(off_m, STEP_STD_M**2, (BLIND_M_S if may_climb else STEP_CLIMB_STD_M_S) ** 2)
        new = Surface(ground, START, math.log(COMMON), MotionResponse(self._motion, self._windows.turn_s))
        if self._response is not None:
            new.response.inherit(self._response)
        self._appraise(new, raw)
        new.raw = None if self.expected() is None else raw
        new.seen_s = self._time_s
        self._began_late(mode, new, raw)
        if len(self.surfaces) >= SURFACES:
            self._drop(min([each for each in self.surfaces if each is not self.proven], key=lambda each: each.evidence))
        self.surfaces.append(new)
        return new

    def expected(self) -> tuple[float, float] | None:
        """Where the ground should be by now, and the standard deviation of that [m]; None: it was never known."""
        if self.reference is not None:
            known = self.reference.filter
            # An outlier of one sensor alone may have moved it, and no other one says that it has not.
            is_seen = len(self._modes) > 1 and self.reference.seen_s >= self._time_s - self._windows.held_s
            std_m = math.sqrt(known.variance(1.0, 0.0, 0.0))
            return known.height_m, std_m if is_seen else math.hypot(RETURNS_M, std_m)
        if self._known is None:
            return None
        climb = self._motion.climbed(self._known.mark, self._time_s)
        if climb is None:
            return self._known.height_m, RETURNS_M + BLIND_M_S * (self._time_s - self._known.time_s)
        return self._known.height_m + climb.height_m, math.hypot(RETURNS_M, climb.std_m)

    def weigh(self) -> None:
        """Find which surface is the ground, and how probable that is."""
        since_s = self._time_s - self._windows.held_s
        voters = [mode for mode in self._modes if mode.seen_s >= since_s]
        counts = {surface: sum([mode.share for mode in voters if mode.sees is surface]) for surface in self.surfaces}
        scores, nothing = self._scores(counts, len(voters))
        best = max(scores, key=scores.__getitem__, default=None)
        self.noise = self._noise_of(voters, best)
        if best is None:
            self.ground, self.sure = None, 0.0
            if not any(mode.is_fixed for mode in self._modes):
                self.doubt = None
            return
        most = scores[best]
        weights = {each: math.exp(score - most) for each, score in scores.items()}
        total = sum(weights.values()) + math.exp(min(nothing - most, 50.0))
        self.ground, self.sure = best, weights[best] / total * (1 - self.noise)
        self._response = best.response
        if self.sure < SURE and self.proven is not None and counts[self.proven]:
            # At an edge, perhaps: the ground so far is still below some sensors, whichever is below the middle.
            self.ground = self.proven
            others = [weights[each] for each in weights if counts[each] and each is not self.proven]
            self.sure = (weights[self.proven] + max(others, default=0.0)) / total * (1 - self.noise)
        most_seen = max(counts, key=counts.__getitem__)
        self._update_doubt(most_seen, counts[most_seen], weights[most_seen] / total, len(voters))
        if self.ground is not self.proven and self.sure > SURE:
            in_order = [mode for mode in self._modes if mode.works or mode.read_s == float("-inf")]
            if 2 * counts[best] > len({*in_order, *voters}):
                self._prove(best)

    def _scores(self, counts: Mapping[Surface, float], voters: int) -> tuple[dict[Surface, float], float]:
        """Log probability of each surface as the ground, and that none is; up to a constant.

        One that is not the ground is there as a fault or an object, or is not there. ``counts``: how many of the voters
        see each.
        """
        faults = {surface: self._as_fault(surface) for surface in counts}
        others = {
            surface: _log_sum(
                0.0, surface.evidence + _log_sum(self._as_object(surface, counts[surface], voters), fault)
            )
            for surface, fault in faults.items()
        }
        nothing = total = sum(others.values())
        if (proven := self.proven) is not None:
            # The ground so far has not become an object; and where it is says nothing of whether it is a fault, unless
            # all of its answers are alike.
            nothing += _log_sum(0.0, proven.evidence + faults[proven]) - others[proven]
            nothing += proven.prior if proven.raw is None else 0.0
        leader = self._leader(counts)
        scores = {}
        for surface, count in counts.items():
            prior = 0.0 if surface is leader else surface.prior
            unseen = 0.0 if count or surface is proven else UNSEEN
            scores[surface] = total - others[surface] + prior + surface.evidence + unseen
        return scores, nothing

    def _as_object(self, surface: Surface, count: float, voters: int) -> float:
        """Log prior that a surface is an object below ``count`` of the voters, or beyond an edge."""
        shared = max(count - 1, 0.0) * math.log(SHARED)
        shared += (max(count - voters / 2, 0.0) + (count > voters - 0.5)) * math.log(MOST)
        if surface is self.reference:
            return shared
        return shared + object_prior(
            surface.filter.height_m - self.reference.filter.height_m if self.reference is not None else 9.0
        )

    def _noise_of(self, voters: Sequence[SensorMode], best: Surface | None) -> float:
        """The probability that the readings of all sensors are noise.

        A sensor on another surface is no evidence about the ground.
        """
        no_others = None, best, self.proven
        witnesses = [mode for mode in voters if mode.sees in no_others or mode.readings < 2 or mode.noise > 0.0]
        return all_noise([mode.noise for mode in witnesses]) if witnesses else 0.0

    def _update_doubt(self, most_seen: Surface, count: float, share: float, voters: int) -> None:
        """Why what most sensors see, ``count`` of the voters, may be no ground; ``share`` is its probability."""
        seen, is_there = 2 * count, most_seen.evidence >= EVIDENCE_MOST
        is_open = self.sure < SURE
        is_most = seen > voters - 0.5 * is_open
        if is_there and is_most and share < SURE and most_seen.response.log_odds <= UNANSWERED:
            self.doubt = Text.NO_RESPONSE
        elif is_there and seen > voters and share < SURE < _were_it_level(share, most_seen):
            self.doubt = Text.STEEP
        elif is_there and seen > voters and share < 0.5 and self._known and not (is_open and self.doubt):
            self.doubt = Text.CHANGE
        elif not is_open:
            self.doubt = None

    def _as_fault(self, surface: Surface) -> float:
        """Log probability, over the ground's, that a surface is a fault of several sensors."""
        answers = surface.response.log_odds
        if surface.same >= SAME_RAW_MOST:
            answers = min(answers, 0.0)  # What does not change answers to no movement.
        return surface.common + surface.same - answers + self._rises(surface) + _steep(surface)

    def _rises(self, surface: Surface) -> float:
        """How much less likely a surface is the ground that was near at first, where the vehicle has risen over it.

        By the barometer: without accelerations nothing else shows a take-off.
        """
        has_answered = surface is self.proven and not surface.response.is_in_doubt
        if has_answered or surface.common <= math.log(COMMON):
            return 0.0
        climb = self._motion.climbed(surface.mark, self._time_s)
        if climb is None:
            # The barometer has just come, or begins anew.
            if (mark := self._motion.mark(self._time_s)) is not None:
                surface.mark, surface.marked_m = mark, surface.filter.height_m
            return 0.0
        rises_m = climb.height_m - (surface.filter.height_m - surface.marked_m)
        return 0.5 * max(rises_m, 0.0) ** 2 / (climb.std_m**2 + RISES_M**2)

    def _prove(self, ground: Surface) -> None:
        if self.proven is not None:
            ground.response.confirm_late(self.proven.response)
        self._suspect_late(ground.again)
        ground.again = 0.0
        self.proven, self.reference, self._proven_s = ground, self.reference or ground, self._time_s
        ground.common = max(ground.common, _common(ground))
        ground.response.is_in_doubt = ground.common > math.log(COMMON)

    def _leader(self, counts: Mapping[Surface, float]) -> Surface | None:
        """The proven ground, where more sensors see it than the ground before, and not with one constant.

        When it has led for so long that the ground before would have been seen again, as next to a box, priors count
        from it: every other surface is then a step away.
        """
        ground, before = self.proven, self.reference
        if ground is None or before is None:
            return None
        if ground.raw is not None or (ground is not before and counts[ground] <= counts[before] + 0.5):
            self._proven_s = self._time_s
            return None
        if ground.prior and (ground is before or self._time_s - self._proven_s > self._windows.memory_s):
            self.reference = ground
            for each in self.surfaces:
                self._place(each)
            ground.prior = 0.0
        return ground

    def _place(self, surface: Surface) -> None:
        """How probable a surface is as the ground, by where that should be."""
        expected, height_m = self.expected(), surface.filter.height_m
        if expected is not None:
            surface.prior = ground_prior(height_m - expected[0], expected[1], height_m)

    def forget(self, surface: Surface) -> None:
        """A surface is fixed to the vehicle; if it was the ground, where that is was not known since it appeared."""
        if surface is self.proven:
            self._known = None
        self._found_no_ground()
        self._drop(surface)

    def _found_no_ground(self) -> None:
        """What was seen was no ground: nor, probably, is what else is as near, but for the ground so far."""
        self._was_no_ground = True
        for surface in self.surfaces:
            if surface is not self.proven and surface.filter.height_m < LOW_M:
                surface.common = max(surface.common, math.log(COMMON_AGAIN))

    def _appraise(self, surface: Surface, raw: float | None) -> None:
        """How probable a new surface is as the ground and as a fault, by where the ground should be, and its answer."""
        surface.common = _common(surface)
        self._place(surface)
        is_again = self._was_no_ground or any(mode.is_fixed for mode in self._modes)
        is_same = raw is not None and raw in [mode.fixed_raw for mode in self._modes]
        if is_same or (surface.filter.height_m < LOW_M and is_again):
            surface.common = max(surface.common, math.log(COMMON_AGAIN))
        if self.proven is not None and self.proven.response.log_odds < UNANSWERED:
            # What did not answer to the motion may be here now.
            surface.common = max(surface.common, self.proven.common + UNANSWERED - self.proven.response.log_odds)

    def _began_late(self, mode: SensorMode, surface: Surface, raw: float | None) -> None:
        """A sensor sees a surface for the first time, perhaps with the answer of its ping before."""
        if self.proven is None or raw is None:
            return
        if surface is not self.proven:
            surface.again += LATE_BEGINS if raw == mode.last_raw else -LATE_BEGINS
        elif raw == mode.last_raw:
            self._suspect_late(LATE_BEGINS)

    def _suspect_late(self, nats: float) -> None:
        for each in self.surfaces:
            each.response.suspect_late(nats)

    def _update_same(self, surface: Surface, raw: float | None) -> None:
        if surface.raw is None or raw is None:
            return
        if raw != surface.raw:
            surface.same, surface.raw = 0.0, raw if surface.evidence <= 0.0 else None
        elif self._is_measured:  # On a bench sensors do repeat themselves.
            surface.same = min(surface.same + SAME_RAW, SAME_RAW_MOST)

    def _merge(self, surface: Surface, other: Surface) -> Surface:
        """Two surfaces are one by now: the first stays, unless the other one is the ground."""
        gone, stays = (surface, other) if other is self.proven else (other, surface)
        for mode in self._modes:
            if mode.sees is gone:
                mode.sees = stays if gone.evidence > 0.0 else None
        stays.seen_s = max(stays.seen_s, gone.seen_s)
        self._drop(gone)
        return stays

    def _drop(self, surface: Surface) -> None:
        self.surfaces.remove(surface)
        for mode in self._modes:
            if mode.sees is surface:
                mode.sees = None
        if surface is self.proven:
            self.proven = None
        if surface is self.reference:
            self.reference = self.proven
        if surface is self.ground:
            self.ground = None


def _common(surface: Surface) -> float:
    """Log prior that a surface is a fault of several sensors, by its height; see `COMMON`."""
    return math.log(COMMON * (COMMON_LOW if surface.filter.height_m < LOW_M else 1.0))


def _steep(surface: Surface) -> float:
    """How much less likely a surface is the ground by its slope: g^2 / (2 SLOPE_STD^2) [nats]."""
    return 0.5 * (surface.filter.rise_north**2 + surface.filter.rise_east**2) / SLOPE_STD**2


def _were_it_level(share: float, surface: Surface) -> float:
    """How probable a surface would be as the ground without its slope, which is so with a probability."""
    return share / (share + (1.0 - share) * math.exp(-_steep(surface)))


def _log_sum(a: float, b: float) -> float:
    """log(exp(a) + exp(b))."""
    least, most = (a, b) if a < b else (b, a)
    return most + math.log1p(math.exp(least - most))
