"""One ping after another: what is between a sensor and its target goes in, what the sensor reports comes out.

A `Ping` holds n pings as arrays. Whoever stages an experiment changes its arrays (a longer path, a weaker echo, another
source of sound), and `listen` finds what is heard first.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from evaluation.blind import air, sound
from evaluation.blind.receiver import NO_ECHO_CM, SHORT_NO_ECHO_CM, Receiver
from evaluation.blind.sound import Array, Complex

REFLECTION_DB = {
    "wall": -0.1,
    "plywood": -0.1,
    "concrete": -0.05,
    "asphalt": -0.4,
    "dirt": -2.0,
    "grass": -7.0,
}
"""Loss on reflection of the coherent echo. Hard boards differ by less than a decibel from a perfect mirror; asphalt
loses some to its grain (1 mm rms against a wavelength of 8 mm), loose ground to its pores."""


@dataclass
class Ping:
    """n pings: their surroundings, each an array of length n.

    Parameters
    ----------
    receiver
        The sensor.
    range_m
        From the sensor to its target, at the time of the reflection.
    """

    receiver: Receiver
    range_m: Array
    temperature_c: Array = field(init=False)
    humidity_pct: Array = field(init=False)
    slowness_s_m: Array = field(init=False)
    """Mean of 1 / c along the path; follows the temperature unless set."""
    off_axis_rad: Array = field(init=False)
    """Between the axis and the point that mirrors."""
    tilt_rad: Array = field(init=False)
    """Of the target against the line of sight; an endless mirror has none."""
    width_m: Array = field(init=False)
    height_m: Array = field(init=False)
    reflection_db: Array = field(init=False)
    fade: Array = field(init=False)
    """Spread of the logarithm of the echo's pressure from ping to ping, from eddies of warm air."""
    eddies_k: Array = field(init=False)
    """Spread of the air's temperature over eddies of half a metre, which make an echo early or late."""
    late_s: Array = field(init=False)
    """Anything else that makes the echo late."""
    noise_pa: Array = field(init=False)
    click_hz: Array = field(init=False)
    """Rate of short loud clicks in the room: keys, valves, insects."""
    misfire: Array = field(init=False)
    """Probability that the transducer is not driven: the receiver then listens to the room alone."""
    passers_per_m: Array = field(init=False)
    """Objects in the beam for each metre of it."""
    locked_s: Array = field(init=False)
    """When an amplifier that has locked up on a spike lets go, which counts as the echo; NaN: it has not."""
    tick_s: Array = field(init=False)
    saturated: float = 0.2
    """Share of no-echo readings that arrive as one byte, 255."""
    others: list[tuple[Complex, Array]] = field(default_factory=list)
    """Further echoes and sounds with their shape: pressures and first edges, each of shape (n, k)."""
    crossings_s: list[Array] = field(default_factory=list)
    """Times at which something else crosses the threshold; infinite where it does not."""

    def __post_init__(self) -> None:
        n = len(self.range_m)
        neutral = {
            "temperature_c": 21.1,
            "humidity_pct": 50.0,
            "slowness_s_m": np.nan,
            "off_axis_rad": 0.0,
            "tilt_rad": 0.0,
            "width_m": np.inf,
            "height_m": np.inf,
            "reflection_db": REFLECTION_DB["wall"],
            "eddies_k": 0.3,
            "late_s": 0.0,
            "noise_pa": float(sound.pascal(self.receiver.noise_db)),
            "click_hz": 0.0,
            "misfire": 0.0,
            "passers_per_m": 0.0,
            "locked_s": np.nan,
            "tick_s": self.receiver.tick_s,
        }
        for name, value in neutral.items():
            setattr(self, name, np.full(n, value))
        # Weak turbulence: the spread grows with the power 3/2 of the way.
        self.fade = 0.2 * (self.range_m / 5.0) ** 1.5

    def slowness(self) -> Array:
        """Mean of 1 / c along the path [s/m]."""
        return np.where(
            np.isnan(self.slowness_s_m), 1.0 / air.speed_m_s(self.temperature_c, self.humidity_pct), self.slowness_s_m
        )

    def wavelength_m(self) -> Array:
        """Wavelength of the ping."""
        return 1.0 / (self.slowness() * self.receiver.frequency_hz)

    def level_at_pa(self, way_m: ArrayLike) -> Array:
        """Rms pressure of the own ping after a way on the axis."""
        way = np.asarray(way_m, dtype=float)
        loss = air.absorption_db_m(self.temperature_c, self.humidity_pct, self.receiver.frequency_hz) * way
        found: Array = sound.pascal(self.receiver.level_db - loss) / way
        return found

    def beam(self, off_axis_rad: ArrayLike) -> Array:
        """Pressure off the axis, relative to on it, for one way."""
        return sound.piston(off_axis_rad, self.receiver.piston_m, self.wavelength_m())

    def add_sound(self, pressure_pa: Array, arrival_s: Array) -> None:
        """One more sound for each ping, with its first edge."""
        self.others.append((pressure_pa[:, None].astype(complex), arrival_s[:, None]))

    def echo(self, rng: Generator) -> tuple[Complex, Array]:
        """Pressures and first edges of the target's echo."""
        pressure = self.level_at_pa(2.0 * self.range_m) * self.beam(self.off_axis_rad) ** 2
        pressure *= 10.0 ** (self.reflection_db / 20.0) * np.exp(self.fade * rng.standard_normal(len(self.range_m)))
        # Eddies met on the way average out: the mean temperature over n of them spreads by 1 / sqrt(n).
        mean_k = self.eddies_k * np.sqrt(0.5 / np.maximum(self.range_m, 0.5)) * rng.standard_normal(len(self.range_m))
        slowness = self.slowness() * (1.0 - 0.5 * mean_k / (self.temperature_c + 273.15))
        first_s = (2.0 * self.range_m * slowness + self.late_s)[:, None]
        if np.isinf(self.width_m).all():
            return pressure[:, None].astype(complex), first_s
        shares, ways_m = sound.plate(
            self.range_m, self.width_m / 2, self.height_m / 2, self.tilt_rad, self.wavelength_m()
        )
        return pressure[:, None] * shares, first_s + 2.0 * ways_m * slowness[:, None]

    def heard_s(self, rng: Generator) -> Array:
        """When the threshold is first crossed [s]; infinite where it is not."""
        n, receiver = len(self.range_m), self.receiver
        # A stream for each source of randomness, so that one more echo leaves the rest as it was.
        fading, noise, other_noise, passing, firing, clicking, alarm = rng.spawn(7)
        amplitude, arrival_s = self.echo(fading)
        first = receiver.crossing_s(amplitude, arrival_s, self.noise_pa, noise)
        for pressures, edges in self.others:
            np.minimum(first, receiver.crossing_s(pressures, edges, self.noise_pa, other_noise), out=first)
        if self.passers_per_m.any():
            depth_m = passing.exponential(1.0 / np.maximum(self.passers_per_m, 1e-12))
            np.minimum(first, np.where(depth_m < self.range_m, 2.0 * depth_m * self.slowness(), np.inf), out=first)
        first[firing.random(n) < self.misfire] = np.inf
        opens_s = 20.0 * receiver.tick_s
        clicks = np.where(self.click_hz > 0.0, 1.0 / np.maximum(self.click_hz, 1e-12), np.inf)
        np.minimum(first, opens_s + clicking.standard_exponential(n) * clicks, out=first)
        np.minimum(first, receiver.false_alarm_s(self.noise_pa, alarm), out=first)
        for crossing_s in self.crossings_s:
            np.minimum(first, crossing_s, out=first)
        return np.where(np.isnan(self.locked_s), first, self.locked_s)

    def listen(self, rng: Generator) -> Array:
        """Readings [cm], shape (n,)."""
        hearing, reporting = rng.spawn(2)
        reading_cm = self.receiver.count_cm(self.heard_s(hearing), self.tick_s)
        none = reading_cm >= NO_ECHO_CM
        reading_cm[none & (reporting.random(len(none)) < self.saturated)] = SHORT_NO_ECHO_CM
        return reading_cm


def tone_crossing_s(
    receiver: Receiver,
    level_db: Array,
    frequency_hz: Array,
    duty: Array,
    period_s: float,
    rng: Generator,
) -> Array:
    """When a foreign tone, on for a share of each period and in no step with the pings, first crosses the threshold.

    Parameters
    ----------
    receiver
        Who hears it; its transducer answers less off its own frequency, by two poles.
    level_db
        At the sensor [dB re 20 uPa].
    frequency_hz, duty
        Of the source.
    period_s
        Of its bursts.
    rng
        Source of randomness: where in its period a ping falls.
    """
    detuned = 1.0 + (2.0 * np.pi * (frequency_hz - receiver.frequency_hz) * receiver.rise_s) ** 2
    heard_db = level_db - 20.0 * np.log10(detuned)
    # The threshold falls with time: from some time on the tone is over it.
    falling_db = np.minimum.accumulate(receiver.threshold_db)
    range_cm = np.interp(-heard_db, -falling_db, receiver.threshold_range_cm)
    over_s = np.where(heard_db < falling_db[-1], np.inf, np.maximum(range_cm, 20.0) * receiver.tick_s)
    start_s = -rng.random(len(duty)) * period_s
    crossing_s = np.full(len(duty), np.inf)
    while (start_s < NO_ECHO_CM * receiver.tick_s).any():
        on_s = np.maximum(start_s, over_s)
        hit = (on_s < start_s + duty * period_s) & (on_s < crossing_s)
        crossing_s[hit] = on_s[hit]
        start_s = start_s + period_s
    return crossing_s
