"""Hypotheses on what a flight's answers are, each with its weight and its own belief of the vehicle and the ground.

For `evaluation.faults.observer`, which says what they are. Accelerations, pressures and answers enter in order of time;
the log odds leave that a distance is wrong. In SI units; likelihoods of an answer are per centimetre.
"""

import math
from bisect import bisect_right
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

KEPT = 80
"""Hypotheses that go on after an answer."""
MODES = ["ground", "fixed", "constant", "saturated", "late", "longer", "shorter", "offset", "dust", "garbled"]
GROUND, FIXED, CONSTANT, SATURATED, LATE, LONGER, SHORTER, OFFSET, DUST, GARBLED = range(len(MODES))
BLIND = (FIXED, CONSTANT, DUST, GARBLED)
"""Modes whose answers say little or nothing about the ground: a distance is right by them only where it is known."""
HIT, OUTLIER, STEP = range(3)
"""What an answer of the ground is; the columns of the options are these three and the faults."""
A, W, B, G, U, D, E, C, LEVEL = range(9)
"""States; the levels below the sensors are the last ones."""
FAULTS_HZ, FAULTY_AT_START, ENDS_HZ, FOLLOWS = 1 / 60, 0.3, 1 / 30, 0.5
"""Faults of a vehicle in a second, and at the start; how soon one ends; probability that the next sensor follows."""
STEPS_HZ, STEP_FOLLOWS, STEP_S = 1 / 60, 0.2, 5.0
"""New levels of the ground in a second; probability that the next sensor meets one within `STEP_S`, at each answer."""
DRIFT_M_S, DRIFT_STD_M_S = 0.0225, 0.0043
"""How fast a sensor's error grows [m/s]: evenly from 1.5 to 3 cm/s."""
HIGHEST_EDGE_M, HIGHEST_BOX_M = 2.1, 1.2
"""Edges keep the vehicle 1 m over them; over the lower boxes, of up to 1.1 m, it flies 0.6 m high."""
NOISE_M, SHORTEST_CM, NO_ECHO_CM, SATURATED_CM = 0.0195, 20, 765, 255
OF_SENSORS = ["mode", "last", "count", "ref", "since_s"]
OF_VEHICLE = ["x", "p", "change", "change_ref", "change_s", "step_m", "step_s", "rise_m_s"]
"""Arrays with a row for each hypothesis, besides the weights."""
Array = NDArray[Any]


class Answer(NamedTuple):
    """An answer of a sensor: when, whose, as it came and in metres by the air's scale, how long after the last one,
    what that was (-1: none), and the probability that level ground gives no echo at this lean."""

    time_s: float
    sensor: int
    raw: int
    range_m: float
    scale: float
    turn_s: float
    last_raw: int
    lost: float


class Expectation(NamedTuple):
    """What each hypothesis expects of an answer: its derivatives by the state, its mean and variance."""

    h: Array
    mean: Array
    variance: Array


class Hypotheses:
    """What the answers may be, each with its log weight: rows of its arrays; see `evaluation.faults.observer`."""

    def __init__(self, sensors: int) -> None:
        size = LEVEL + sensors
        # It stands on the ground, or in the air where the flight begins there (only the family 'follow' does).
        self.log_w = np.log([0.9, 0.1])
        self.x, self.p = np.zeros((2, size)), np.zeros((2, size, size))
        self.x[:, G] = -0.18, -2.4
        self.rise_m_s = np.array([0.03, 0.15])
        for each, rate_m_s, ground_m, rise_m_s in zip(self.p, (0.02, 0.2), (0.04, 1.2), self.rise_m_s, strict=True):
            std = [0.0, rate_m_s, 0.1, ground_m, rise_m_s, 1.0, 0.3, 1.5, *[0.04] * sensors]
            np.fill_diagonal(each, np.square(std))
        # By sensor: mode, what the last answer was, reference and count of a fault's answers, when it began.
        self.mode, self.last, self.count = (np.zeros((2, sensors), dtype=np.int64) for _ in range(3))
        self.ref, self.since_s = np.zeros((2, sensors)), np.zeros((2, sensors))
        # The last change of a mode and the last step of the ground: which, to what, when.
        self.change, self.change_ref, self.change_s = np.zeros(2, dtype=np.int64), np.zeros(2), np.full(2, -99.0)
        self.step_m, self.step_s = np.zeros(2), np.full(2, -99.0)
        self._answered: dict[int, tuple[float, int]] = {}
        self._time_s = self._up_m_s2 = self._speed_m_s = self._way_m = 0.0
        self._up_s = -99.0
        self._past: list[tuple[float, float, float]] = [(-99.0, 0.0, 0.0)]

    def predict(self, time_s: float) -> None:
        """Move all to a time."""
        t = time_s - self._time_s
        if t <= 0.0:
            return
        self._time_s = time_s
        known = time_s - self._up_s < 0.2
        up_m_s2 = self._up_m_s2 if known else 0.0
        f = np.eye(self.x.shape[1])
        f[A, W], f[A, B], f[W, B], f[G, U] = t, -t * t / 2, -t, t
        f[U, U], f[E, E] = math.exp(-t / 10.0), math.exp(-t / 2.5)
        speed = (0.3 if known else 3.5) * math.sqrt(t * max(t, 0.04))
        q = np.zeros(len(f))
        q[D], q[E] = 0.05**2 * t, 0.09 * (1 - f[E, E] ** 2)
        q[W], q[A], q[LEVEL:] = speed**2, (speed * t) ** 2 / 4, 1e-4 * t
        self.x = self.x @ f.T
        self.x[:, A] += up_m_s2 * t * t / 2
        self.x[:, W] += up_m_s2 * t
        self.p = f @ self.p @ f.T + np.diag(q)
        self.p[:, U, U] += self.rise_m_s**2 * (1 - f[U, U] ** 2)
        self._way_m += self._speed_m_s * t + up_m_s2 * t * t / 2
        self._speed_m_s += up_m_s2 * t
        self._past.append((time_s, self._speed_m_s, self._way_m))

    def on_acceleration(self, time_s: float, up_m_s2: float) -> None:
        """The mean acceleration upwards since the last one."""
        self._up_m_s2, self._up_s = up_m_s2, time_s
        self.predict(time_s)

    def on_pressure(self, time_s: float, height_m: float, scale: float) -> None:
        """A pressure as a height over the start; ``scale``: of the standard air to this air."""
        self.predict(time_s)
        feet_m = self.x[:, A] - self.x[:, G] - 0.2
        h = np.zeros_like(self.x)
        h[:, A], h[:, D], h[:, E] = scale, 1.0, 1.0
        h[:, C] = np.clip(1.0 - feet_m / 0.8, 0.0, 1.0) * np.where(feet_m < 0.02, 0.2, 1.0)
        noise = np.where(feet_m < 1.2, 1.0, 0.15) ** 2 + (0.02 * self.x[:, A]) ** 2
        mean, variance = self._expected(h, 0.0)
        self.log_w += np.log(_normal(height_m, mean, variance + noise))
        self._correct(h, height_m - mean, noise, np.ones(len(h), dtype=bool))

    def on_answer(self, time_s: float, sensor: int, raw: int, scale: float, below_m: float, lost: float) -> None:
        """Branch, and keep the likeliest.

        Parameters
        ----------
        time_s, sensor, raw
            Time of the echo, which sensor, and its answer.
        scale
            Distance by the range that the sensor states, in this air.
        below_m
            How far the sensor is below the reference point, in this attitude.
        lost
            Probability that level ground gives no echo at this lean.
        """
        self.predict(time_s)
        last_s, last_raw = self._answered.get(sensor, (math.nan, -1))
        is_first = math.isnan(last_s)
        turn_s = 1.0 if is_first else max(time_s - last_s, 1e-3)
        self._answered[sensor] = time_s, raw
        now = self._expectation(sensor, below_m, math.nan)
        late = now if is_first else self._expectation(sensor, below_m, last_s)
        answer = Answer(time_s, sensor, raw, raw / 100 * scale, scale, turn_s, last_raw, lost)
        likelihoods = self._likelihoods(answer, now, late)
        transition = self._transition(sensor, time_s, turn_s, is_first)
        score = self.log_w[:, None] + np.log(likelihoods) + np.log(transition)
        parent, option = self._best(score, sensor)
        self.log_w = score[parent, option]
        mode = np.maximum(option - 2, GROUND)
        is_new = mode != self.mode[parent, sensor]
        self._keep(parent)
        self.last[:, sensor], self.mode[:, sensor] = np.where(option > STEP, 0, option), mode
        self._record_changes(answer, is_new, option, now.mean[parent] - answer.range_m)
        self._update(answer, option, *(Expectation(*(each[parent] for each in which)) for which in (now, late)))

    def _expectation(self, s: int, below_m: float, at_s: float) -> Expectation:
        """What a sensor's answer is if it is of now, or of an earlier time: z(t - T) = z - w T + what the vehicle has
        accelerated since then."""
        h = np.zeros_like(self.x)
        h[:, A], h[:, G], h[:, LEVEL + s] = 1.0, -1.0, -1.0
        since_m = unknown = 0.0
        if not math.isnan(at_s):
            late_s = self._time_s - at_s
            then_s, speed_m_s, way_m = self._past[bisect_right(self._past, (at_s, math.inf, math.inf)) - 1]
            way_m += speed_m_s * (at_s - then_s)
            since_m = self._speed_m_s * late_s - (self._way_m - way_m)
            h[:, W], h[:, B] = -late_s, -late_s * late_s / 2
            unknown = 0.0012 * late_s**3
        mean, variance = self._expected(h, since_m - below_m)
        return Expectation(h, mean, variance + NOISE_M**2 + unknown)

    def _likelihoods(self, answer: Answer, now: Expectation, late: Expectation) -> Array:
        """Likelihood of an answer [per cm]: of each hypothesis (row) with each option (column)."""
        time_s, s, raw, r_m, scale, turn_s, last_raw, lost = answer
        mode, count, ref = self.mode[:, s], self.count[:, s], self.ref[:, s]
        _, mean, seen = now
        beyond = 1 - (1 - lost) * ndtr((7.62 * scale - mean) / np.sqrt(seen))
        stray = 0.01 / 745 + (raw < 100 * mean) * 0.00005 * math.exp(-0.5 * r_m)
        coded = {NO_ECHO_CM: 0.015, SATURATED_CM: 0.005}.get(raw, 0.0) + (raw == NO_ECHO_CM) * 0.97 * beyond
        outlier = np.where(raw <= NO_ECHO_CM, stray + coded, 1e-9)

        def hit(at: Array, variance: Array) -> Array:
            if raw == SHORTEST_CM:
                found: Array = 0.96 * ndtr((0.205 * scale - at) / np.sqrt(variance)) + 1e-30
            else:
                found = 0.96 * _normal(r_m, at, variance) * (1 - beyond) * (raw < NO_ECHO_CM) / 100 + 1e-30
            return found

        like = np.empty((len(mean), 2 + len(MODES)))
        like[:, HIT], like[:, OUTLIER] = hit(mean, seen), outlier
        # Another level: anywhere where an edge or a box can be, or the one that another sensor has just met.
        rise_m = mean - r_m
        highest_m = HIGHEST_EDGE_M if r_m > 0.95 else HIGHEST_BOX_M
        allowed = (np.abs(rise_m) < highest_m) & (r_m > 0.55) & (raw < NO_ECHO_CM)
        same = STEP_FOLLOWS * _normal(self.x[:, LEVEL + s] + rise_m, self.step_m, 0.05**2) / 100
        like[:, STEP] = np.where(time_s - self.step_s < STEP_S, same, 0.0)
        like[:, STEP] += min(STEPS_HZ * turn_s, 0.2) * np.where(allowed, 1 / 400, 1e-12)
        # Something fixed, 20 to 60 cm away, and still, jittering or swinging; dust; neither is beyond the ground.
        nearer = ndtr((mean + 0.02 - r_m) / np.sqrt(seen))
        away = [_normal(raw, ref, std_cm**2 * (1 + 1 / np.maximum(count, 1))) for std_cm in (0.4, 1.0, 3.0)]
        again = 0.3 * away[0] + 0.35 * away[1] + 0.35 * away[2] + 1e-4
        like[:, 2 + FIXED] = np.where(mode != FIXED, (17 <= raw <= 63) * nearer / 46 + 1e-12, again)
        dust = max(math.log(230 / (max(raw, 50) - 20)), 0.0) / 200 * (raw >= SHORTEST_CM) * nearer
        like[:, 2 + DUST] = 0.55 * dust + 0.45 * (0.7 * hit(mean, seen) + 0.3 * hit(mean, seen + 0.06)) + outlier
        # One constant: that of other sensors, the last answer, or any.
        as_others = np.where((self.change == CONSTANT) & (self.change_ref == raw), 0.4, 0.0)
        first = as_others + 0.4 * (raw == last_raw) + 0.2 / 745
        like[:, 2 + CONSTANT] = np.where(mode != CONSTANT, first, np.where(ref == raw, 1.0, 1e-6))
        far = ndtr((mean - 2.55 * scale) / np.sqrt(seen))
        like[:, 2 + SATURATED] = far + 1e-9 if raw == SATURATED_CM else (raw < SATURATED_CM) * hit(mean, seen) + 1e-9
        like[:, 2 + LATE] = hit(late.mean, late.variance) + outlier
        for drift, sign in ((LONGER, 1), (SHORTER, -1)):
            faulty_s = np.where(mode == drift, time_s - self.since_s[:, s], 0.0)
            grown = hit(mean + sign * DRIFT_M_S * faulty_s, seen + (DRIFT_STD_M_S * faulty_s) ** 2)
            like[:, 2 + drift] = grown + outlier
        first = ((np.abs(rise_m) > 0.28) & (np.abs(rise_m) < 3.02)) / 540 + 1e-9
        like[:, 2 + OFFSET] = np.where(mode != OFFSET, first, hit(mean + ref, seen + NOISE_M**2) + outlier)
        like[:, 2 + GARBLED] = 0.5 / 745 if raw <= NO_ECHO_CM else 0.5 / 65536
        return like

    def _update(self, answer: Answer, option: Array, now: Expectation, late: Expectation) -> None:
        """Update each filter with the answer if the option takes it for one of the ground."""
        s, r_m, raw = answer.sensor, answer.range_m, answer.raw
        mode, stepped = self.mode[:, s], option == STEP
        self.p[stepped, LEVEL + s, :] = self.p[stepped, :, LEVEL + s] = 0.0
        self.p[stepped, LEVEL + s, LEVEL + s] = 4.0
        is_late, lasted_s = mode == LATE, answer.time_s - self.since_s[:, s]
        drifts = np.where(mode == LONGER, 1.0, np.where(mode == SHORTER, -1.0, 0.0))
        h = np.where(is_late[:, None], late.h, now.h)
        mean = np.where(is_late, late.mean, now.mean + drifts * DRIFT_M_S * lasted_s)
        off, noise = r_m - mean, NOISE_M**2 + (drifts * DRIFT_STD_M_S * lasted_s) ** 2
        used = (option == HIT) | stepped | ((mode == SATURATED) & (raw < SATURATED_CM))
        used |= np.isin(mode, (LATE, LONGER, SHORTER, DUST)) & (np.abs(off) < 0.1)
        if raw == SHORTEST_CM:
            # The ground is there or nearer: mean and variance of a normal distribution that is cut off above.
            variance = np.where(is_late, late.variance, now.variance)
            room = (0.205 * answer.scale - mean) / np.sqrt(variance)
            slope = np.exp(-0.5 * room * room) / math.sqrt(2 * math.pi) / (ndtr(room) + 1e-12)
            share = np.clip(slope * (slope + room), 1e-6, 1.0)
            off, noise = -slope * np.sqrt(variance) / share, variance / share - (variance - NOISE_M**2)
        self._correct(h, off, noise, used)

    def log_odds_wrong(self, distance_m: float, maximum_m: float, half_m: float, lean: float) -> float:
        """Log odds that a distance along the down axis is off by more than ``half_m``, or 'above the maximum' wrong."""
        right = np.full(len(self.x), 1e-12)
        for s in range(self.x.shape[1] - LEVEL):
            blind = np.isin(self.mode[:, s], BLIND)
            h = np.zeros_like(self.x)
            h[:, A], h[:, G], h[:, LEVEL + s] = 1.0, -1.0, np.where(blind, 0.0, -1.0)
            mean, variance = self._expected(h, 0.0)
            mean, std = mean / lean, np.sqrt(variance) / lean
            if distance_m > maximum_m:
                each = ndtr((mean - maximum_m + half_m) / std)
            else:
                each = ndtr((distance_m + half_m - mean) / std) - ndtr((distance_m - half_m - mean) / std)
                each = np.where(blind & (std > 2.0 * half_m), 0.0, each)
            right = np.maximum(right, each)
        w = np.exp(self.log_w - self.log_w.max())
        return math.log(max(float(w @ (1 - right)), 1e-300) / max(float(w @ right), 1e-300))

    def _expected(self, h: Array, offset_m: float) -> tuple[Array, Array]:
        return np.einsum("ki,ki->k", h, self.x) + offset_m, np.einsum("ki,kij,kj->k", h, self.p, h)

    def _correct(self, h: Array, off: Array, noise: Array, used: Array) -> None:
        ph = np.einsum("kij,kj->ki", self.p, h)
        gain = ph / (np.einsum("ki,ki->k", h, ph) + noise)[:, None] * used[:, None]
        self.x = self.x + gain * off[:, None]
        self.p = self.p - gain[:, :, None] * ph[:, None, :]

    def _transition(self, s: int, time_s: float, turn_s: float, at_start: bool) -> Array:
        """Probability of each option by the mode that a sensor has."""
        sensors, faults = self.mode.shape[1], len(MODES) - 1
        begins = (FAULTY_AT_START if at_start else min(FAULTS_HZ * turn_s, 0.3)) / sensors
        ends = min(ENDS_HZ * turn_s, 0.3)
        table = np.full((len(MODES), len(MODES)), 1e-6)
        table[GROUND, GROUND], table[GROUND, 1:] = 1 - begins, begins / faults
        table[1:, GROUND] = ends
        np.fill_diagonal(table[1:, 1:], 1 - ends)
        chance = table[self.mode[:, s]]
        follows = (time_s - self.change_s < 1.6 * turn_s) & (self.change != self.mode[:, s])
        follows &= (self.change == GROUND) | (self.mode[:, s] == GROUND)
        chance[follows] *= 1 - FOLLOWS
        chance[follows, self.change[follows]] += FOLLOWS
        # The priors of the ground's options are in their likelihoods.
        return np.concatenate([np.repeat(chance[:, :1], 3, axis=1), chance[:, 1:]], axis=1)

    def _best(self, score: Array, s: int) -> tuple[Array, Array]:
        """Parents and options of the likeliest, one for each set of modes; their weights are added up in ``score``."""
        order = np.argsort(score, axis=None)[::-1][: 6 * KEPT]
        parent, option = np.unravel_index(order, score.shape)
        modes, last = self.mode[parent], self.last[parent]
        modes[:, s], last[:, s] = np.maximum(option - 2, GROUND), np.where(option > STEP, 0, option)
        code = (modes * 3 + last) @ (30 ** np.arange(modes.shape[1], dtype=np.int64))
        _, first, group = np.unique(code, return_index=True, return_inverse=True)
        top = score[parent[0], option[0]]
        total = np.bincount(group.ravel(), np.exp(score[parent, option] - top))
        likeliest = np.argsort(total)[::-1][:KEPT]
        chosen = first[likeliest]
        score[parent[chosen], option[chosen]] = np.log(total[likeliest] + 1e-300)
        return parent[chosen], option[chosen]

    def _keep(self, parent: Array) -> None:
        """Keep what belongs to these hypotheses."""
        for name in (*OF_SENSORS, *OF_VEHICLE):
            setattr(self, name, getattr(self, name)[parent])

    def _record_changes(self, answer: Answer, is_new: Array, option: Array, rise_m: Array) -> None:
        """Record what began with an answer, and a fault's mean reading, constant or offset."""
        time_s, s, raw = answer.time_s, answer.sensor, answer.raw
        mode, stepped = self.mode[:, s], option == STEP
        self.count[is_new, s], self.since_s[is_new, s] = 0, time_s
        self.change = np.where(is_new, mode, self.change)
        self.change_ref, self.change_s = np.where(is_new, raw, self.change_ref), np.where(is_new, time_s, self.change_s)
        count, ref = self.count[:, s], self.ref[:, s]
        follows = np.where(mode == FIXED, ref + (raw - ref) / np.minimum(count + 1, 20), ref)
        self.ref[:, s] = np.where(count == 0, np.where(mode == OFFSET, -rise_m, raw), follows)
        self.count[:, s] = count + 1
        self.step_m = np.where(stepped, self.x[:, LEVEL + s] + rise_m, self.step_m)
        self.step_s = np.where(stepped, time_s, self.step_s)


def _normal(value: Any, mean: Any, variance: Any) -> Any:
    return np.exp(-0.5 * (value - mean) ** 2 / variance) / np.sqrt(2 * math.pi * variance) + 1e-300
