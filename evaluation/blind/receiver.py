"""The receiver: echoes in noise enter, the time at which the envelope first crosses the threshold leaves, and a count.

The threshold falls with time, as a gain that rises would make it. Noise is narrow-band: two quadratures through the
same two-pole response as the transducer's. Where an echo is, envelope and noise are followed sample by sample; where
only noise is, its first crossing is drawn from Rice's rate of upward crossings.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from evaluation.blind.sound import Array, burst, pascal

NO_ECHO_CM = 765
SHORT_NO_ECHO_CM = 255
NEAREST_CM = 20

STEP_S = 12.5e-6
"""Between samples of the envelope."""

LEAD_S = 50e-6
"""Sampled before the first edge of an echo, where noise may cross first."""

CHUNK = 4096


@dataclass(frozen=True)
class Receiver:
    """One kind of sensor. The defaults are chosen so that what the report measured with an MB1242 comes out."""

    frequency_hz: float = 42_000.0
    piston_m: float = 0.016
    """Diameter of the piston with its beam."""

    level_db: float = 99.5
    """Of its ping on the axis at 1 m [dB re 20 uPa]."""

    rise_s: float = 35e-6
    """Time constant of the transducer, on the way out and on the way back."""

    burst_s: float = 16 / 42_000.0

    threshold_range_cm: tuple[float, ...] = (20.0, 50.0, 100.0, 150.0, 200.0, 300.0, 400.0, 500.0, 765.0)
    threshold_db: tuple[float, ...] = (81.8, 81.3, 81.0, 79.6, 76.6, 71.0, 66.1, 62.8, 61.8)
    """Level that the envelope has to cross for an echo from each range [dB re 20 uPa]; straight in dB between."""

    noise_db: float = 45.0
    """Of the quiet room and the amplifier in the receiver's band."""

    tick_s: float = 58e-6
    """Of the counter, one centimetre there and back."""

    late_s: float = 57e-6
    """What the maker subtracts for the time that an echo takes to rise."""

    def threshold_pa(self, time_s: ArrayLike) -> Array:
        """Rms pressure that is found, by time since the ping."""
        range_cm = np.asarray(time_s, dtype=float) / self.tick_s
        return pascal(np.interp(range_cm, self.threshold_range_cm, self.threshold_db))

    @cached_property
    def _samples(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Times of the samples from the first edge [s], and the factor that gives white noise the response's memory."""
        time_s = np.arange(-LEAD_S, self.burst_s + 1e-4, STEP_S)
        lag = np.abs(time_s[:, None] - time_s[None, :]) / self.rise_s
        factor = np.linalg.cholesky((1.0 + lag) * np.exp(-lag) + 1e-9 * np.eye(time_s.size))
        return time_s.astype(np.float32), factor.T.astype(np.float32)

    def crossing_s(
        self, amplitude_pa: NDArray[np.complexfloating], arrival_s: Array, noise_pa: Array, rng: Generator
    ) -> Array:
        """When the envelope of one echo, made of several arrivals close together, first crosses the threshold.

        Parameters
        ----------
        amplitude_pa : complex ndarray, shape (n, k)
            Rms pressure of each arrival with its phase.
        arrival_s : ndarray, shape (n, k)
            First edge of each arrival, by time since the ping.
        noise_pa : ndarray, shape (n,)
            Rms pressure of the noise.
        rng
            Source of randomness.

        Returns
        -------
        ndarray, shape (n,)
            Time since the ping; infinite where it is not found.
        """
        crossing = np.full(len(arrival_s), np.inf)
        # An arrival without sound may be anywhere, and must not open the window.
        heard = np.where(np.abs(amplitude_pa) > 0.0, arrival_s, np.inf)
        start = heard.min(axis=1, initial=np.inf)
        origin = np.where(np.isfinite(start), start, 0.0)
        threshold = self.threshold_pa(origin)
        # What cannot come within six sigma of the threshold is not sampled, where that is so for a whole chunk: the
        # draws for one ping must not depend on what happens to another.
        loudest = np.abs(amplitude_pa).sum(axis=1) + 6.0 * noise_pa
        audible = np.isfinite(start) & (loudest > threshold) & (start < (NO_ECHO_CM + 5) * self.tick_s)
        for chunk, stream in zip(_chunks(np.arange(len(start))), rng.spawn(-(-len(start) // CHUNK)), strict=True):
            if not audible[chunk].any():
                continue
            delay_s = np.where(np.isfinite(heard[chunk]), arrival_s[chunk] - origin[chunk, None], 0.0)
            found = self._first_sample_s(amplitude_pa[chunk], delay_s, threshold[chunk], noise_pa[chunk], stream)
            crossing[chunk] = np.where(audible[chunk], start[chunk] + found, np.inf)
        return crossing

    def _first_sample_s(
        self,
        amplitude: NDArray[np.complexfloating],
        delay_s: Array,
        threshold: Array,
        noise: Array,
        rng: Generator,
    ) -> Array:
        time_s, factor = self._samples
        # Quadratures have the rms of the whole, and the envelope is sqrt(2) times its rms: both over the threshold.
        scale = (noise / threshold / np.sqrt(2.0)).astype(np.float32)[:, None]
        shape = (len(threshold), time_s.size)
        real = rng.standard_normal(shape, dtype=np.float32) @ factor * scale
        imaginary = rng.standard_normal(shape, dtype=np.float32) @ factor * scale
        relative = (amplitude / threshold[:, None]).astype(np.complex64)
        delay = delay_s.astype(np.float32)
        for k in range(delay.shape[1]):
            (used,) = np.nonzero(relative[:, k] != 0)
            if used.size:
                pulse = burst(time_s[None, :] - delay[used, k, None], self.rise_s, self.burst_s)
                real[used] += relative.real[used, k, None] * pulse
                imaginary[used] += relative.imag[used, k, None] * pulse
        over = np.hypot(real, imaginary) - 1.0
        above = over >= 0.0
        first = above.argmax(axis=1)
        rows = np.arange(len(first))
        before = np.maximum(first - 1, 0)
        rise = over[rows, first] - over[rows, before]
        back = np.where(first > before, over[rows, first] / np.where(rise > 0.0, rise, 1.0), 0.0)
        found = time_s[first].astype(float) - back * STEP_S
        return np.where(above[rows, first], found, np.inf)

    def false_alarm_s(self, noise_pa: Array, rng: Generator) -> Array:
        """When noise alone first crosses the threshold, by Rice's rate sqrt(-R''(0) / 2 pi) rho exp(-rho^2 / 2).

        R is the noise's correlation, here (1 + t / rise) exp(-t / rise), so that -R''(0) is 1 / rise^2.
        """
        range_cm = np.linspace(NEAREST_CM, NO_ECHO_CM, 150)
        time_s = range_cm * self.tick_s
        threshold = self.threshold_pa(time_s)
        alarm = np.full(len(noise_pa), np.inf)
        # Below one ninth of the threshold noise crosses once in a million years.
        (rows,) = np.nonzero(noise_pa > threshold.min() * np.sqrt(2.0) / 9.0)
        for chunk in _chunks(rows):
            rho = np.sqrt(2.0) * threshold[None, :] / noise_pa[chunk, None]
            rate_hz = rho * np.exp(-0.5 * rho**2) / (np.sqrt(2.0 * np.pi) * self.rise_s)
            alarm[chunk] = first_event_s(rate_hz, time_s, rng)
        return alarm

    def count_cm(self, crossing_s: Array, tick_s: ArrayLike | None = None) -> Array:
        """The reading of each crossing: whole ticks to the nearest, no nearer than 20, 765 without a crossing."""
        tick = np.asarray(self.tick_s if tick_s is None else tick_s, dtype=float)
        count = (crossing_s - self.late_s) / tick
        whole = np.rint(np.minimum(count, NO_ECHO_CM))
        found: Array = np.maximum(whole, NEAREST_CM)
        return found


def first_event_s(rate_hz: Array, time_s: Array, rng: Generator) -> Array:
    """Draw the first event of Poisson processes with rates along a common grid of times; infinite where there is none.

    Parameters
    ----------
    rate_hz : ndarray, shape (n, m)
    time_s : ndarray, shape (m,)
    rng
        Source of randomness.
    """
    width = np.diff(time_s)
    hazard = np.cumsum(0.5 * (rate_hz[:, 1:] + rate_hz[:, :-1]) * width, axis=1)
    drawn = rng.exponential(size=len(rate_hz))
    after = hazard >= drawn[:, None]
    index = after.argmax(axis=1)
    rows = np.arange(len(index))
    start = np.where(index > 0, hazard[rows, np.maximum(index - 1, 0)], 0.0)
    share = (drawn - start) / np.maximum(hazard[rows, index] - start, 1e-300)
    event = time_s[index] + np.clip(share, 0.0, 1.0) * width[index]
    return np.where(after[rows, index], event, np.inf)


def _chunks(rows: NDArray[np.intp]) -> Iterator[NDArray[np.intp]]:
    for start in range(0, rows.size, CHUNK):
        yield rows[start : start + CHUNK]
