"""Whether what the downward sensors see as ground follows the vehicle's motion, or is fixed to the vehicle.

A strap, a payload or ice in the beams gives the same range whatever the vehicle does; so do sensors that are stuck
together. A hill that the vehicle follows gives the same range, too, and the barometer tells the two apart only where no
hill rises so fast. What does is the response to single movements: over ground a range changes with the vehicle's
acceleration. There is one `MotionResponse` for each surface.

Three predictions of each reading are compared, by Kalman filters of the height h [m], its rate w [m/s] and a slow
acceleration b [m/s^2] that differ in one thing only:

    h' = w    w' = u - b + white noise    b' = -b / B_LASTS_S + white noise

Over ground u is the measured acceleration, over something fixed it is 0, and where each sensor answers with the range
of its ping before it is that of a turn earlier; a sensor that is asked out of turn answers for h + w times what its own
ping before is later than that. b is the bias of the accelerometer, which the ranges themselves show:
the barometer does not, where rotors change the pressure. A vehicle at rest or at a steady rate favours none of the
three. A fourth is that the range has stopped, as where a vehicle climbs away from the ground until what is fixed to it
is nearer: the mean of the readings since they were last seen to move.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

from msp_range.fusion.modes import (
    ANSWERED_MOST,
    DECIDED,
    DECIDED_APART,
    DOUBT_LASTS_S,
    FOLLOWS,
    LATE,
    LATE_OFF_M,
    LATE_S,
    MAY_BE_LATE,
    ODDS_LAST_S,
    SHOWS_M_S,
    UNANSWERED,
)
from msp_range.fusion.vertical import Covariance, VerticalMotion, corrected, moved
from msp_range.numbers import limited

NOISE_M2_S3 = 0.005
"""Spectral density of the white noise [m^2/s^3]: an accelerometer's noise of 0.3 m/s^2 at 25 Hz is 0.0036. Larger hides
small movements, smaller takes a bias of the accelerometer for a lack of response."""
B_START_M_S2, B_STD_M_S2, B_LASTS_S = 0.15, 0.1, 60.0
"""Standard deviation of b at the start, and later [m/s^2], and how long it lasts [s]: an accelerometer's bias, and how
the ground curves below the vehicle. Larger or shorter finds what is late only in hard manoeuvres (with 0.2 that lasts
5 s, late answers are wrong for a fifth longer, and unreported for half as long again), smaller finds it where ground
curves."""
NOISE_SHARE = 0.25
"""Share of a predicted height's variance by which the accelerometer's noise moves the two predictions apart: with it
the odds of a vehicle at rest stay the same (by simulated rest: 0.24 to 0.27). Larger finds what is fixed later, smaller
finds it where it is not."""
REST_SHARE = 0.08
"""The same for what a movement has shown: so little that a vehicle at rest gathers nothing. Larger believes after a
minute of hovering what is near."""
STRONGEST, SLOPING_PER_S = 4.0, 5.0
"""A reading speaks for one of the two by at most the first [nats]: more lets one outlier decide. Where the ground may
begin to slope, a vehicle that follows it accelerates and its range stays: then readings speak against a response by no
more than the second [nats/s], and more for a change of the rate that is too large for a slope."""
HILL_M_S, HILL_PER_S = 0.8, 3.0
"""Ground rises below a vehicle that follows it no faster than the first [m/s]: 40 % at 2 m/s. While the barometer says
that it rises faster, that speaks for something fixed by the second [nats/s], so that four seconds decide: longer than
the pressure below the rotors changes at a take-off. Smaller takes a steep hill for part of the vehicle."""
OWN_STD_M, OWN_SHARE = 0.1, 0.2
"""What a sensor sees higher or lower than the others, standard deviation [m], and the share of a reading in it: they
see different things, whether ground or parts of the vehicle. Larger takes more of a response for that, smaller takes
more of the differences for noise."""
OWN_TURNS = 3.0
"""Without a reading for so many turns, in which two others had some, a sensor has seen something else, and what it sees
higher or lower is learned anew. Longer takes the step between the two for answers that are late, shorter forgets it
with each missed echo."""
NEAR_M = 0.15
"""A reading that is not of the ground is taken where it is this near to one of the predictions [m]: in a hard climb
what is fixed leaves the ground within a turn. Larger takes readings of an edge."""
NOISE_STD_M, NOISE_READINGS = 0.02, 20.0
"""The readings' noise about the best prediction, standard deviation at the start [m]: a sensor's of its own; later a
mean over so many."""
WANDERS_M2_S = 4e-4
"""By how much something fixed to the vehicle moves, as a variance in a second [m^2/s]: a strap swings by centimetres.
Larger takes a slow climb for that, smaller finds later that a range has stopped."""
OUT_OF_TURN = 0.4
"""From this share of a turn on a ping is out of turn: one of two sensors that is asked twice is so by a half. Smaller
takes what a turn varies by for one."""
OUTLIER_SIGMAS = 5.0
"""A single reading that is farther than this from each prediction says nothing [standard deviations]: it is another
thing's, and would move all three predictions and the noise so far that a healthy vehicle's answers seem late. Fewer
leave out what a thermometer's step or a kick moves."""
LEAST_VARIANCE_M2 = 0.01
"""From this variance on a reading stands for any range below it, as on the ground, and the height is known no better
after many of them [m^2]. Larger finds what is late after take-offs later, smaller takes a landing that bounces for
something fixed."""
SLOPE_M_S, SPEED_LASTS_S = 0.3, 1.0
"""A change of the rate that a beginning slope often has [m/s]: 30 % at 1 m/s; and the time over which changes of the
rate are added up [s]. A larger speed finds what is fixed later in flight, a smaller one finds it where slopes begin."""
LEVEL_RISE = 0.03
"""Less rise per metre than this is level ground, whose rate does not change by itself: a part of the slopes that a
vehicle follows."""

State = tuple[float, float, float]
"""Height, rate and bias [m, m/s, m/s^2]."""
_ANYWHERE_M2 = 1e4
"""Variance of a height before its first reading [m^2]."""
_START = (0.01, 0.0, 0.0, 0.25, 0.0)
"""Covariance at the start: hh, hw, hb, ww, wb in SI units."""


class HeightReading(NamedTuple):
    """A sensor's reading as the height of the reference point."""

    sensor: str
    """Whose."""
    time_s: float
    """When it was [s]."""
    since_s: float
    """How long after the sensor's reading before [s]."""
    height_m: float
    """The height by this reading alone [m]."""
    variance_m2: float
    """Of its error [m^2]."""


class MotionResponse:
    """The response of the readings of one surface.

    Parameters
    ----------
    motion
        How the vehicle moves by its accelerometer and barometer.
    turn_s
        From a sensor's reading to its next one [s].

    Attributes
    ----------
    is_in_doubt
        Whether what is seen is more often part of the vehicle than ground: then its odds last longer.
    is_late
        Whether the sensors answer with the ranges of their pings before.
    """

    def __init__(self, motion: VerticalMotion, turn_s: float) -> None:
        self._motion = motion
        self._turn_s = turn_s
        self.is_in_doubt = self.is_late = False
        self._taken_s: dict[str, float] = {}
        # Log odds of the first over each of the other two; and over a range that has stopped.
        self._fixed = self._late = 0.0
        self._apart = 0.0  # Of the third over the second.
        self._answered = 0.0
        self._begin()

    def _begin(self) -> None:
        """Begin to predict; what has been shown stays."""
        self._time_s: float | None = None
        self._stopped = FOLLOWS
        self._level_m = self._level_m2 = 0.0
        self._change_m_s = 0.0
        self._noise_m2 = NOISE_STD_M**2
        self._covariance: Covariance = (*_START, B_START_M_S2**2)
        self._was_outlier = False
        self._own_m: dict[str, float] = {}
        # Over ground, over something fixed, and over ground at the time of the ping before.
        self._states: list[State] = [(0.0, 0.0, 0.0)] * 3

    @property
    def log_odds(self) -> float:
        """Log odds of ground over something fixed to the vehicle, or over answers of the ping before that mislead.

        After a movement they are more than `FOLLOWS`, as much as it has shown: a near ground needs that to be believed.
        """
        if self.is_late and not self.misleads:
            return max(self._fixed, min(self._apart, FOLLOWS))
        # No more than over something fixed: not where it is inherited.
        late = self._late if self._late > 0.0 else limited(-self._apart, self._late, 0.0)
        return min(self._fixed, self._stopped, late) + limited(self._answered - FOLLOWS, 0.0, ANSWERED_MOST)

    @property
    def is_fixed(self) -> bool:
        """Whether the surface is fixed to the vehicle."""
        return self._stopped <= DECIDED or (self._fixed <= DECIDED and self._apart <= DECIDED_APART)

    @property
    def may_be_late(self) -> bool:
        """Whether a sensor that is asked out of turn may show that the answers are those of the pings before."""
        return MAY_BE_LATE > self._late > LATE and abs(self._states[2][1]) > SHOWS_M_S

    @property
    def misleads(self) -> bool:
        """Whether the answers are late, and the ground moves so fast that it is elsewhere by now."""
        return self.is_late and self._turn_s * max([abs(w) for _, w, _ in self._states]) > LATE_OFF_M

    def inherit(self, other: "MotionResponse") -> None:
        """Begin as on the ground so far: the vehicle moves as before, and answers that came late still do.

        What is rather fixed there shows neither, nor does what was seen so long ago that the accelerations since are
        not known. Something fixed here does not move, whatever the ground did.
        """
        if other.is_late or other._apart >= 0.0:
            self._late, self.is_late = min(other._late, 0.0), other.is_late
        if other._time_s is not None and self._motion.covers(other._time_s) and other.log_odds > UNANSWERED:
            follows, _, late = other._states
            self._time_s, self._states = other._time_s, [follows, (0.0, 0.0, 0.0), late]
            self._covariance = (_ANYWHERE_M2, 0.0, 0.0, *other._covariance[3:])

    def confirm_late(self, other: "MotionResponse") -> None:
        """Answers that seem late on this surface are so if those on the ground before were found late meanwhile."""
        if other.is_late and self._late < UNANSWERED:
            self._late, self.is_late = min(self._late, other._late), True

    def suspect_late(self, nats: float) -> None:
        """Answers seem to begin to be those of the pings before; that they do not says nothing of earlier ones."""
        if self._turn_s >= LATE_S:
            self._late -= max(nats, 0.0)
            self.is_late |= self._late <= LATE

    def sees(self, since_s: float) -> set[str]:
        """The sensors of which a reading has been taken since a time [s]."""
        return {name for name, time_s in self._taken_s.items() if time_s >= since_s}

    def offs_m(self, reading: HeightReading) -> list[float]:
        """How far a reading is from each of the three predictions, by the rates at the last one [m]; see `update`."""
        if self._time_s is None:
            return [math.inf] * 3
        t = reading.time_s - self._time_s
        heights_m = self._heights_m([(h + w * t, w, b) for h, w, b in self._states], reading.since_s)
        return [abs(reading.height_m - expected_m) for expected_m in heights_m]

    def expects(self, reading: HeightReading) -> bool:
        """Whether a reading is near one of the three predictions."""
        return min(self.offs_m(reading)) < NEAR_M

    def _heights_m(self, states: Sequence[State], since_s: float) -> tuple[float, float, float]:
        """What a sensor should read by each of the three [m]; one that is asked in turn answers by their heights."""
        (follows_m, _, _), (fixed_m, _, _), (late_m, late_m_s, _) = states
        return follows_m, fixed_m, late_m + late_m_s * max(self._turn_s - since_s, -self._turn_s)

    def update(self, reading: HeightReading, climb_m_s: float, may_slope: bool, moves_all: bool = True) -> None:
        """Update with a reading that was of the ground, or is expected.

        Parameters
        ----------
        reading
            With the slope and attitude that are known.
        climb_m_s
            How fast the height grows by all readings before [m/s].
        may_slope
            Whether the ground may begin to slope here: it does slope, or the sensors cannot show whether.
        moves_all
            Whether the reading is of the ground, or the least that a sensor can say: another one moves only the second
            and third prediction, where it is near them.
        """
        sensor, time_s, since_s, height_m, variance_m2 = reading
        if self._time_s is None:
            self._states = [(height_m, climb_m_s, 0.0)] * 3
        before_s = time_s if self._time_s is None else self._time_s
        left_s = time_s - OWN_TURNS * self._turn_s
        if self._taken_s.get(sensor, time_s) < left_s and len(self.sees(left_s)) > 1:
            self._own_m.pop(sensor, None)
        self._time_s = self._taken_s[sensor] = time_s
        up_m_s2 = self._motion.measured(before_s, time_s)
        earlier_m_s2 = self._motion.measured(before_s - self._turn_s, time_s - self._turn_s)
        if up_m_s2 is None or earlier_m_s2 is None:
            self._begin()
            return
        t = time_s - before_s
        fades = math.exp(-t / B_LASTS_S)
        predicted = [
            (h + (w + 0.5 * (u - b) * t) * t, w + (u - b) * t, b * fades)
            for (h, w, b), u in zip(self._states, (up_m_s2, 0.0, earlier_m_s2), strict=True)
        ]
        own_m = self._own_m.get(sensor)
        is_least = variance_m2 >= LEAST_VARIANCE_M2
        variance_m2 = max(variance_m2, self._noise_m2) + (OWN_STD_M**2 if own_m is None else 0.0)
        covariance = self._predicted(t, fades)
        total_m2 = covariance[0] + variance_m2
        share = OWN_STD_M**2 / total_m2 if own_m is None else OWN_SHARE
        height_m -= own_m or 0.0
        others = len(self._own_m) - (own_m is not None)
        # One sensor alone is neither higher nor lower than others.
        self._own_m[sensor] = (own_m or 0.0) + share * (height_m - predicted[1][0]) if others else 0.0
        offs_m = [height_m - expected_m for expected_m in self._heights_m(predicted, since_s)]
        squares_m2 = [off_m * off_m for off_m in offs_m]
        if min(squares_m2) > OUTLIER_SIGMAS**2 * total_m2 and not self._was_outlier:
            self._states, self._covariance, self._was_outlier = predicted, covariance, True
            return
        self._was_outlier = False
        (k_h, k_w, k_b), (hh, hw, hb, ww, wb, bb) = corrected(covariance, variance_m2)
        self._covariance = max(hh, LEAST_VARIANCE_M2 if is_least else 0.0), hw, hb, ww, wb, bb
        if own_m is not None:
            off_level_m2 = self._off_level_m2(t, height_m, variance_m2)
            squares = [square_m2 / total_m2 for square_m2 in (*squares_m2, off_level_m2)]
            if self._turn_s < LATE_S and abs(self._turn_s - since_s) < OUT_OF_TURN * self._turn_s:
                squares[2] = squares[0]
            self._decide(t, squares, k_h, up_m_s2, may_slope)
            self._noise_m2 += (min(squares_m2) - self._noise_m2) / NOISE_READINGS
        nearest_m = [math.inf] * 3 if moves_all else [0.0, NEAR_M, NEAR_M]
        self._states = [
            (h + k_h * off_m, w + k_w * off_m, b + k_b * off_m) if abs(off_m) < near_m else (h, w, b)
            for (h, w, b), off_m, near_m in zip(predicted, offs_m, nearest_m, strict=True)
        ]

    def _off_level_m2(self, t: float, height_m: float, variance_m2: float) -> float:
        """Square of how far a reading is from the level at which the range has stopped; it then moves the level."""
        level_m2 = self._level_m2 + WANDERS_M2_S * t
        gain = level_m2 / (level_m2 + variance_m2) if self._stopped < FOLLOWS else 1.0
        off_m = height_m - self._level_m
        self._level_m += gain * off_m
        self._level_m2 = gain * variance_m2
        return off_m * off_m

    def _predicted(self, t: float, fades: float) -> Covariance:
        """P' = F P F^T + Q; b falls to ``fades`` of itself."""
        hh, hw, hb, ww, wb, bb = moved(self._covariance, t)
        noise = NOISE_M2_S3 * t
        return (
            hh + noise * t * t / 3,
            hw + noise * t / 2,
            fades * hb,
            ww + noise,
            fades * wb,
            fades * fades * bb + (1.0 - fades * fades) * B_STD_M_S2**2,
        )

    def _decide(self, t: float, squares: list[float], share: float, up_m_s2: float, may_slope: bool) -> None:
        """Update the log odds with the normalised squares of the three predictions' errors, and of the level's."""
        follows, fixed, late, stopped = squares
        self._change_m_s = self._change_m_s * math.exp(-t / SPEED_LASTS_S) + up_m_s2 * t
        least = -STRONGEST
        if may_slope:
            least = max(least, -SLOPING_PER_S * t * (1 + (self._change_m_s / SLOPE_M_S) ** 2))
        fades = math.exp(-t / (DOUBT_LASTS_S if self.is_in_doubt else ODDS_LAST_S))

        def updated(log_odds: float, fades: float, evidence: float, least: float) -> float:
            log_odds = log_odds * fades + limited(evidence, least, STRONGEST)
            return FOLLOWS if log_odds > FOLLOWS else log_odds

        self._fixed = updated(self._fixed, fades, 0.5 * (fixed - follows + NOISE_SHARE * share), least)
        self._stopped = updated(self._stopped, fades, 0.5 * (stopped - min(follows, late) + share), least)
        answers = limited(0.5 * (min(fixed, stopped) - follows + REST_SHARE * share), least, STRONGEST)
        self._answered = max(self._answered * fades + answers, 0.0)
        self._late = updated(self._late, math.exp(-t / DOUBT_LASTS_S), 0.5 * (late - follows), -STRONGEST)
        apart = self._apart * fades + limited(0.5 * (fixed - late), -STRONGEST, STRONGEST)
        self._apart = limited(apart, self._fixed - FOLLOWS, FOLLOWS - self._late)
        if self._late >= 0.0 or (self._late <= LATE and self._apart >= -DECIDED_APART):
            self.is_late = self._late < 0.0
        climb = self._motion.rate(self._time_s or 0.0)
        if climb is not None and abs(climb.m_s - self._states[1][1]) > HILL_M_S:
            self._fixed -= HILL_PER_S * t
            self._apart -= HILL_PER_S * t
