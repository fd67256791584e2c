"""What a downward sensor can be looking at, and how probable that is before it is read: all that decides modes is here.

A sensor sees one of a few surfaces, or nothing that is known. A surface is the ground, an object or a hole below some
sensors, or a fault with a common cause: something fixed to the vehicle, one constant, answers of the ping before. The
modes of one sensor are a chain: it stays with what it has seen before unless a reading is far likelier otherwise.

    what it is           begins                                           ends
    ground               `SURE`, seen by more than half of the sensors    another surface is so
    object or hole       `OBJECT_READINGS` of `OF_THE_LAST`               `GROUND_READINGS` in a row
    outlier              `P_OUTLIER` is likelier than each surface        a reading of a surface
    garbled              `P_GARBLED` is likelier than an outlier          any other reading
    stuck                `STUCK_READINGS` alike, others by `STUCK_M`      `ANEW_READINGS`, one within `ANEW_M`, no echo
    fixed to the vehicle log odds of `DECIDED`                            `ANEW_READINGS` off by `FIXED_M`
    a ping late          log odds of `LATE`, or `UNANSWERED` once more    even odds
    noise, of all        `P_NOISE_ALL`, by `noise_density`                readings of surfaces
    odd                  likelier by `ODD`, the others fit (`ODD_FITS`)   likelier by less
    above the maximum    `ABOVE_TURNS` without an echo, or a climb to it  `ABOVE_RANGES` or `ABOVE_CODES` in a row
"""

import math
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING

from msp_range.fusion.ground_filter import SQRT_TWO_PI
from msp_range.fusion.mounting import DownwardSensor
from msp_range.fusion.vertical import Mark, VerticalMotion
from msp_range.numbers import limited

if TYPE_CHECKING:
    from msp_range.fusion.belief import Surface

# What one reading is of.
PER_M = 0.13
"""Density of a range that nothing is known of: even over the range of the sensors [1/m]. All priors and likelihoods
are relative to it."""
STAYS, MOVES = 0.9, 0.05
"""Of a sensor that is read: it sees what it saw before, or a certain other surface that is known; what is left are
missed echoes and outliers. Not varied: they count by their logarithm, against densities of 0.1 to 20 per metre."""
P_OUTLIER = 0.015
"""Of a reading that it is of nothing known: the share of the MB1242's model (short and random). Twice as many lost the
ground in a climb at 4.5 m/s^2 without an accelerometer."""
OUTLIERS, OUTLIER_READINGS = 0.5, 6.0
"""A sensor that gives outliers goes on with that, as in dust: the probability is this share of theirs, over so many
readings."""
P_NOISE, P_NOISE_ALL = 0.003, 1e-4
"""That one sensor begins to give readings of nothing, as one that fails does; and that all do, as in dust."""
SCATTERED = 0.95
"""Of the readings of a sensor that sees nothing for certain: the others are of the ground. With 0.8 nothing is sent in
dust that leaves half of the readings to the ground; with all, one reading of it ends the dust."""
DUST_WIDEST_M, DUST_NARROWEST_M, DUST_FROM_M = 2.5, 0.5, 0.2
"""Dust answers from anywhere between the last and a distance between the other two [m]."""
FAR_PER_M = 0.065
"""Density of noise that is farther: half of that of a range that nothing is known of [1/m]. Not varied."""
NOISE_LEAST, NOISE_MOST, NOISE_STRONGEST = -4.0, 10.0, 4.0
"""Log likelihood, over surfaces, that a sensor's readings are noise: at least, so that it is found; at most, so that it
ends; and by one reading at most [nats]. With 6 for the last, two outliers in a row silence a single sensor."""
GATE_M, GATE_M_S2, GATE_WIDEST_M = 0.25, 1.0, 1.0
"""A reading farther off than this is not of the ground, however little is known of the vehicle's motion: with readings
0.1 s apart [m], for an acceleration of twice the second where they are farther apart [m/s^2], and at most [m]. Wider
takes an outlier for the ground after a manoeuvre, narrower loses the ground in one."""
GATE_SIGMAS = 3.0
"""So many standard deviations of a reading are not outside of the gate: a lidar's at 30 m is off by a decimetre. Fewer
split the ground of such a sensor into several surfaces."""
DOUBTFUL_PER_M, DOUBTFUL_M = 0.3, 0.10
"""The least density and the gate of a reading that is also a fault code [1/m, m]: it may not pass for ground that is
merely near it."""
STILL_M_S, STILL_SIGMAS = 0.2, 2.0
"""A fault code counts as ground while the vehicle climbs or sinks no faster than this by its barometer [m/s], to so
many standard deviations: one that climbs past it while all sensors have the code must get away from it."""
P_GARBLED, P_AGAIN = 0.02, 0.5
"""That the bus garbles an answer, once it is one that garbling would explain; and that it does so again."""
AGAIN_S, AGAIN_M = 10.0, 0.25
"""On a bus that has garbled an answer within this time [s] others are likely garbled; and no answer that is farther
from the ground than this is [m]."""
GARBLED_STD_M = 0.05
"""How far a garbled answer is trusted to be that of the ground, standard deviation [m]: it may be a code by itself."""

# How probable a surface is as the ground, and as something else.
STEP = 0.002
"""That the ground has a step between two readings: one in 50 s of flight over uneven ground. More believe faults of all
sensors, fewer are silent after steps of more than 2 m. Not varied."""
STEP_M, CLIFFS = 0.6, 0.1
"""Mean size of a step [m]: kerbs, walls and roofs of 0.3 to 2 m; and the share of those that may have any size, such as
the edge of a tall building. With a smaller share nothing is sent beyond that until the vehicle climbs or sinks."""
LOW_M, LOW = 0.65, 0.05
"""A vehicle is seldom nearer to the ground than the first after a step [m], a twentieth as often as elsewhere: it is
where payload, straps and gear are; nor where its height is not known to as much. With a fifth three sensors that saw a
strap were believed. Nor does a vehicle follow ground that begins to slope so near to it."""
OBJECT, EDGE = 0.03, 0.1
"""That an object or a hole comes below a sensor, relative to a reading of nothing known; and that the ground has a step
there: every step of the ground begins as one below a sensor or two."""
SHARED, MOST = 0.5, 0.003
"""That another sensor sees the same object; and that it does where more than half of all do. With 0.01 for the second a
step is followed a reading later."""
COMMON, COMMON_LOW = 1e-5, 160.0
"""That all sensors, or some, have one fault between two readings: one in 10,000 s, which is more than a vehicle has,
but silence costs less than a wrong distance; nearer than `LOW_M` so many times more, as payload and gear. The same
decides how long what does not answer to the motion is sent: with the first it takes 10 nats."""
COMMON_AGAIN = 0.3
"""That what is nearer than `LOW_M` is part of the vehicle where another sensor sees such a part, or where one has been
found, or been in doubt until it was gone, since a ground last answered; and, at any height, that it is what another
sensor sees that is fixed, where the answers are the same. Not varied: it is sent once it has answered to a movement."""
SAME_RAW, SAME_RAW_MOST = 3.0, 6.0
"""What each answer that is the same as all before on a new surface adds to its prior as a fault, and at most [nats]:
sensors with a centimetre's noise answer the same in one of four readings, and one constant is the commonest fault of
all. Another answer takes it back, also where the surface is the ground by then, and without an accelerometer it does
not count: on a bench sensors repeat themselves. A larger limit keeps good sensors over calm ground silent after a
step."""
UNSEEN = -4.0
"""Log prior that a surface which no sensor sees any more is the ground. Not varied."""
RETURNS_M = 0.15
"""How far from where it should be the ground is found again [m]: by a slope between two places. Not varied."""
START = -3.4
"""Log prior of the first surface that is seen: a second reading that agrees makes it sure, three if others do not."""
BLIND_M_S, BLIND_NEAR_M = 2.0, 0.5
"""How fast the ground's height is lost where no barometer says how the vehicle climbs [m/s]; and where no accelerometer
does, a surface that begins as near to the ground as the second may be the ground of a vehicle that climbs so [m]."""

# What is known of the ground, and sent.
EVIDENCE_MOST, EVIDENCE_LEAST, HIT, HIT_MOST, MISS = 15.0, -6.0, 3.5, 7.5, 3.0
"""Log likelihood that a surface is there, over readings of nothing: at most, so that some outliers in a row begin to
count; at least; by a reading that is of it, beyond its density (of the 4.2 that an outlier costs), and at most; and
less by each that is of nothing known [nats]."""
SURE = 0.8
"""A distance goes out where its surface is the ground with this probability."""
OTHERS_IN_A_ROW = 2
"""After so many ranges in a row that are of nothing that a reading before has seen nothing is sent until one is of the
ground: it may have a step, or the vehicle a motion that the filter has not seen. A range of what another sensor sees,
too, is below an edge, perhaps, which no distance ends: four sensors over one would be silent for 0.4 s, in which an
autopilot stops using the range. With 3 distances go out in noise of 30 cm whose deviation does not hold."""
SURFACES = 4
"""So many are followed at most: the ground, one beyond an edge, one object, and an outlier."""
SAME_M = 0.10
"""Surfaces as near as this are one [m]: an autopilot does the same with either."""

# What does not answer to the vehicle's motion, see `msp_range.fusion.response`.
ODDS_LAST_S, DOUBT_LASTS_S = 6.0, 60.0
"""Time constant with which the odds fall back to even [s]: shorter forgets before slow movements have decided, longer
adds up noise. The second of late answers, a fault that lasts, and where the surface is in doubt and has never answered
to a movement."""
FOLLOWS, DECIDED = 4.0, -12.0
"""Log odds are kept below the first, so that something which gets into the beams is found soon. At the second, what the
sensors see is not what they should: five standard deviations of what noise adds up to. A take-off gives -30."""
LATE, LATE_S = -11.0, 0.2
"""At the first log odds the answers are those of the ping before: in healthy flights of the hostile families they stay
above -10, the lowest where sensors read their minimum until after the take-off. With -13 late answers are wrong for 3 %
longer (30 flights of seed 816). With turns shorter than the second [s] it is not decided: an accelerometer's delay
looks the same. From then on they are late until the odds are even."""
MAY_BE_LATE, SHOWS_M_S = 2.0, 0.25
"""From the first log odds on, where the vehicle climbs or sinks faster than the second [m/s], sensors are asked out of
turn: the answer of a ping before is then of a younger one, by some 0.2 s, which moves it by two standard deviations of
a reading. At a steady rate nothing else shows that answers are late. Later asks less in flights in which nothing is
wrong."""
LATE_OFF_M = 0.1
"""Answers of the ping before are sent while the ground is off by no more than this, by how fast it moves [m]: half of
what is a wrong distance. With less a hover is silent, in which nothing shows that they are in time again; with more the
beginning of a climb is wrong for longer."""
RISES_M = 0.8
"""By how much the barometer may say that the vehicle has risen over something near which has not answered to any
movement yet, where that is the ground after all: the standard deviation, as well as that of the climb [m]. Rotors
change the pressure so before a take-off. A vehicle may have taken off before its accelerations were known. With 0.4
half a second of some take-offs is silent, larger believes a strap for longer."""
LATE_BEGINS = 5.0
"""Answers that come late begin with each sensor's last one once more: a new surface, where the vehicle climbs or sinks.
Each sensor that sees one first with its last answer speaks for that by so much, and against it with another answer
[nats]. Four sensors decide: a step of just that height has the same answer in one of four. Less waits for the next
acceleration."""
DECIDED_APART = -4.0
"""So much less likely than either verdict must be the other one: in the first turn of a climb what is fixed and what is
late look alike. More decides later."""
UNANSWERED, ANSWERED, ANSWERED_MOST, AWAY_M = -3.0, 5.0, 6.0, 0.8
"""Below the first log odds a surface is not thought to move with the measured acceleration any more, and answers that
were late on the ground before are late on a new one, too. Above the second, more than one reading can show, one that
was low when it was first seen, as before a take-off, is no payload; nor is one that is farther away by now than the
last [m]. The third is how much an answer counts at most: it says that a surface is not fixed to the vehicle, not that
two sensors see no drift. Larger believes slopes of 80 %."""

# What repeats itself.
STUCK_READINGS, REPEATED_READINGS = 3, 5
"""The same answer so many times in a row may be stuck while the others move; so many are evidence for nothing new."""
STUCK_M = 0.15
"""While the height over a surface that most others see has changed by this much [m]: three times what noise hides."""
STUCK_ALONE_M, STUCK_SIGMAS = 0.5, 3.0
"""Or while the vehicle has climbed by this much by its barometer [m], and so many standard deviations."""
ANEW_READINGS, ANEW_M, FIXED_M = 3, 0.05, 0.08
"""A stuck sensor answers anew after so many other answers, one as near as the second [m], or no echo; what is fixed to
the vehicle moves by less than the third [m]."""

# Which sensor does not fit into the plane of the others, see `msp_range.fusion.odd`.
ODD_GAP_S = 0.3
"""With readings farther apart no sensor is odd: the vehicle moves them by more than the noise [s]. 0.1 m^2/s^3 make
3 cm."""
ODD, ODD_APART = 9.0, 5.0
"""How much likelier the plane without one sensor must be than that of all, and than without any other one [nats]: a
sensor of four on a rectangle of half a metre is then odd at some 22 cm. Less isolates one over a kerb."""
ODD_FITS = 4.5
"""The plane of the others must cost no more [nats]: three standard deviations of the slope. More takes a box below two
sensors for one that is odd on a steep slope."""

# Objects and holes.
OBJECT_M = 0.12
"""Less than this above or below the ground is not reported as an object [m]."""
NEAR_M = 0.08
"""Readings of one object lie within this of each other [m]: four times a reading's noise."""
OBJECT_READINGS, OF_THE_LAST, GROUND_READINGS = 3, 4, 2
"""So many of a sensor's last readings of one object begin the report of it, and so many of the ground in a row end it.
Two of three would find it a reading sooner, and ten times a day where there is none."""

# Above the maximum, see `msp_range.fusion.above`.
ABOVE_TURNS = 3
"""Above the maximum, where no ground is known: so many readings in a row of every working sensor are without an echo.
Fewer take a soft landing place for the sky, more are late after a restart in cruise."""
ABOVE_RANGES = 2
"""So many readings in a row with a range end it, however many sensors had no echo before: of eight that ping half a
second apart most still had none when a descent has gone on for four seconds. One is often an outlier; more are late."""
ABOVE_CODES = 5
"""After so many readings in a row of 253 or 255, which may as well be 'no echo', they no longer stand for it. Of
readings without an echo a quarter are such codes, so that one message in a thousand is left out by chance; fewer leave
out more, more keep 'above the maximum' for longer in a descent in which all sensors have that fault."""
ABOVE_MARGIN_M = 0.3
"""A climb that ends this far below the maximum counts as one to it [m]: sensors lose the ground a little sooner."""
ABOVE_SIGMAS = 3.0
"""A climb by the barometer may be longer than it says by so many standard deviations."""


def normal_per_m(off_m: float, std_m: float) -> float:
    """Density of a normal distribution [1/m]."""
    return math.exp(-0.5 * (off_m / std_m) ** 2) / std_m / SQRT_TWO_PI


def ground_prior(off_m: float, std_m: float, height_m: float) -> float:
    """Log prior density, over `PER_M`, that the ground is ``off_m`` from where it should be, to ``std_m`` [m]."""
    returns = normal_per_m(off_m, std_m)
    steps = STEP * (math.exp(-abs(off_m) / STEP_M) / (2 * STEP_M) + CLIFFS * PER_M)
    if height_m < LOW_M:
        steps *= LOW
        if std_m > LOW_M:  # Where it should be is not known.
            returns *= LOW
    return math.log(max((returns + steps) / PER_M, 1e-9))


def noise_density(range_m: float) -> float:
    """Density of a range in dust, or of one that is of nothing [1/m]."""
    width_m, least_m = DUST_WIDEST_M - DUST_FROM_M, max(range_m, DUST_NARROWEST_M) - DUST_FROM_M
    return max(math.log(width_m / least_m) / (DUST_WIDEST_M - DUST_NARROWEST_M), FAR_PER_M)


def all_noise(log_odds: Sequence[float]) -> float:
    """How probable it is that the readings of all sensors are noise, by the log likelihood of each over surfaces."""
    odds = [math.exp(each) for each in log_odds]
    every = math.prod(odds) * P_NOISE_ALL
    some = math.prod([1 + P_NOISE * each for each in odds]) - math.prod([P_NOISE * each for each in odds])
    return every / (every + some)


def object_prior(off_m: float) -> float:
    """Log prior density, over `PER_M`, of an object, a hole or an edge, ``off_m`` from the ground [m]."""
    return math.log(OBJECT + EDGE * math.exp(-abs(off_m) / STEP_M) / (2 * STEP_M) / PER_M)


class SensorMode:
    """One downward sensor: where it sits, and what it sees.

    Attributes
    ----------
    sees, readings
        The surface that its last reading was of, and how many in a row; None: of nothing known.
    share
        How probable that is.
    seen_s, read_s, since_s, ranged_s
        When it had a range that counts, when it was read, how long after the reading before, and when it had any range
        [s].
    works
        Whether its last reading was none of a fault.
    stray
        What its last reading was the first of, if that was not the ground: it counts as an outlier unless another
        reading is of the same by the sensor's next one.
    object_m
        Height over the ground of what is below it [m]; None: the ground, or nothing.
    """

    def __init__(self, mounted: DownwardSensor) -> None:
        self.mounted = mounted
        self.sees: Surface | None = None
        self.readings = 0
        self.share = 1.0
        self._outliers = 0.0
        self.noise = NOISE_LEAST
        self.seen_s = self.read_s = self.ranged_s = float("-inf")
        self.since_s = float("inf")
        self.works = False
        self.foot_m = mounted.foot_m(0.0)
        self.stray: Surface | None = None
        self.object_m: float | None = None
        self._offs_m: deque[float | None] = deque(maxlen=OF_THE_LAST)
        self.is_ground_in_doubt = False
        self._on_ground = 0
        self.last_raw: float | None = None
        self._raw: float | None = None
        self._range_m: float | None = None
        self._times = self._others = 0
        self._level: Surface | None = None
        self._level_m = self._climbed_m = 0.0
        self._mark: Mark | None = None
        self._stuck = False
        self._fixed_m: float | None = None

    @property
    def outlier(self) -> float:
        """How probable it is that a reading is of nothing known."""
        return max(P_OUTLIER, OUTLIERS * self._outliers)

    def count_outlier(self, is_outlier: bool) -> None:
        """A reading was of something known, or not."""
        self._outliers += (is_outlier - self._outliers) / OUTLIER_READINGS

    def weigh_noise(self, range_m: float, density: float) -> None:
        """Update how likely its readings are noise with one, by its density over all surfaces [1/m]."""
        gain = math.log(1 - SCATTERED + SCATTERED * noise_density(range_m) / density)
        self.noise = limited(self.noise + min(gain, NOISE_STRONGEST), NOISE_LEAST, NOISE_MOST)

    @property
    def repeated(self) -> bool:
        """Whether the newest answer is one of many alike."""
        return self._times >= REPEATED_READINGS and not self._others

    @property
    def is_fixed(self) -> bool:
        """Whether it sees something that is fixed to the vehicle."""
        return self._fixed_m is not None

    @property
    def fixed_raw(self) -> float | None:
        """Its answer by what is fixed to the vehicle, while it sees that."""
        return None if self._fixed_m is None or self._others else self.last_raw

    def hold(self) -> None:
        """What the sensor sees now is fixed to the vehicle."""
        self._fixed_m, self._others = self._range_m, 0

    def see(self, surface: "Surface | None", time_s: float, share: float = 1.0) -> None:
        """Its newest range is of a surface, with a probability, or of nothing known."""
        self.readings = self.readings + 1 if surface is self.sees else 1
        self.share = share
        self.sees, self.seen_s = surface, time_s

    def below(self, off_m: float | None, ground_is_seen: bool) -> None:
        """Update the object below with how much farther than the ground the newest reading is; None: it is ground."""
        self._offs_m.append(off_m)
        if off_m is None:
            self._on_ground += 1
            if self._on_ground >= GROUND_READINGS:
                self.object_m = None
            return
        near = [each for each in self._offs_m if each is not None and abs(each - off_m) < NEAR_M]
        is_object = len(near) >= OBJECT_READINGS
        if ground_is_seen and abs(off_m) >= OBJECT_M and (self.object_m is not None or is_object):
            self._on_ground = 0
            if self.object_m is not None and abs(self.object_m + off_m) < NEAR_M:
                self.object_m -= (self.object_m + off_m) / 2
            elif is_object:
                self.object_m = -off_m

    def has_edge_at(self, off_m: float) -> bool:
        """Whether a beam that meets an edge of what is below it would read this much farther than the ground [m]."""
        object_m = self.object_m
        return object_m is not None and min(-object_m, 0.0) - NEAR_M < off_m < max(-object_m, 0.0) + NEAR_M

    def is_stuck(
        self,
        raw: float,
        range_m: float | None,
        others_see: "Surface | None",
        motion: VerticalMotion,
        time_s: float,
        least: bool,
    ) -> bool:
        """Whether its answers do not follow the vehicle, by the newest one.

        ``others_see``: the surface that most others see, whose height shows how the vehicle climbs; ``least``: the
        answer stands for this range or less.
        """
        if self._fixed_m is not None and range_m is not None:
            self._others = 0 if abs(range_m - self._fixed_m) < FIXED_M else self._others + 1
            if self._others < ANEW_READINGS:
                return True
            self._fixed_m = None
        if raw != self._raw:
            self._others += 1
            near = range_m is None or (self._range_m is not None and abs(range_m - self._range_m) < ANEW_M)
            if self._stuck and self._others < ANEW_READINGS and not near:
                return False
            self._raw, self._times, self._stuck = raw, 0, False
            self._level, self._climbed_m = None, 0.0
            self._mark = motion.mark(time_s)
        self._range_m, self._others = self._range_m if range_m is None else range_m, 0
        self._times += 1
        if others_see is not None:
            height_m = others_see.filter.height_m
            if self._level is others_see:
                self._climbed_m += height_m - self._level_m
            self._level, self._level_m = others_see, height_m
            if self._times >= STUCK_READINGS:
                self._stuck |= abs(self._climbed_m) >= STUCK_M
            if least and others_see.least_s == others_see.seen_s:
                # All are on the ground, where they repeat themselves.
                self._stuck, self._climbed_m = False, 0.0
        if self.repeated and not self._stuck and not least:
            climb = motion.climbed(self._mark, time_s)
            self._stuck = climb is not None and abs(climb.height_m) >= max(STUCK_ALONE_M, STUCK_SIGMAS * climb.std_m)
        return self._stuck
