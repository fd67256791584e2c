"""The distribution of n readings, each with its own parameters: log-probabilities and draws.

The model's parameters, with the effects applied, enter; what leaves are log-probabilities of readings and readings.
The mixture is that of `msp_range.reading_model.mixture.ReadingModel`, with parameters that differ from row to row, more
components and faults of the code.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msp_range.reading_model.mixture import log_hit, log_unexpected
from msp_range.reading_model.sensor_model import SATURATED_CM
from msp_sim.effects.codes import CodeFault
from msp_sim.effects.component import Component, Hits, take
from msp_sim.model.streams import Streams

_Array = NDArray[np.float64]


class Added(NamedTuple):
    """One more component: its odds against the base mixture, and the name of its stream."""

    odds: Any
    component: Component
    stream: str


class Faulty(NamedTuple):
    """A fault of the code: the share of readings that it befalls, and the name of its stream."""

    share: Any
    fault: CodeFault
    stream: str


class RunOffset(NamedTuple):
    """An offset that the readings of a run share: its standard deviation [cm], the run of each row ("": none)."""

    deviation_cm: float
    runs: NDArray[Any]
    stream: str


@dataclass(frozen=True)
class Rows:
    """Distribution of n readings.

    With q the base mixture of `ReadingModel`, o_j the odds and c_j the densities of the components added, and faults
    f = 1 ... F, each of which befalls a share s_f of what the ones before leave::

        q(k)    weights w_i exp(eta_i), divided by their sum
        g(k)  = (q(k) + sum_j o_j c_j(k)) / (1 + sum_j o_j), of whose readings of M a share arrives as 255
        p_f(k) = (1 - s_f) p_(f-1)(k) + s_f (sum of p_(f-1)(i) over the codes i that f turns into k)

    Attributes
    ----------
    centre_cm, sigma_cm
        Of the hits of all runs together, shape (n,); a centre of NaN is not heard.
    log_weights
        log (w_i exp(eta_i)) of hit, unexpected, max, random: numbers or arrays.
    rate_per_m, saturated_fraction, minimum_cm, maximum_cm
        As in the sensor model.
    added, faults, run_offsets
        What effects add; faults in their order.
    """

    centre_cm: _Array
    sigma_cm: _Array
    log_weights: tuple[Any, Any, Any, Any]
    rate_per_m: float
    saturated_fraction: float
    minimum_cm: int
    maximum_cm: int
    added: tuple[Added, ...] = ()
    faults: tuple[Faulty, ...] = ()
    run_offsets: tuple[RunOffset, ...] = ()

    def __len__(self) -> int:
        return self.centre_cm.size

    def log_prob(self, reading_cm: _Array) -> _Array:
        """log of the probability of each reading; -inf for what cannot be read, such as fractions and NaN."""
        whole = np.rint(reading_cm) == reading_cm
        code = np.where(whole, reading_cm, -1.0)
        log_p: _Array = np.where(whole, self._log_after(self.faults, code, code), -np.inf)
        return log_p

    def log_below(self, reading_cm: _Array) -> _Array:
        """log of the probability of all smaller readings, for the probability integral transform."""
        last = np.ceil(reading_cm) - 1.0
        return self._log_after(self.faults, np.full_like(last, -np.inf), last)

    @property
    def between_cm2(self) -> Any:
        """The part of the hits' variance that lies between runs [cm^2]."""
        return sum(np.where(runs != "", deviation_cm**2, 0.0) for deviation_cm, runs, _ in self.run_offsets)

    def wider(self, factor: Any) -> "Rows":
        """With another spread within runs; what lies between runs stays as it is."""
        if not self.run_offsets:
            return replace(self, sigma_cm=self.sigma_cm * factor)
        between_cm2 = self.between_cm2
        within_cm2 = np.maximum(self.sigma_cm**2 - between_cm2, 0.0)
        return replace(self, sigma_cm=np.sqrt(within_cm2 * factor**2 + between_cm2))

    def take(self, rows: Any) -> "Rows":
        """Some of the rows."""
        hit, unexpected, max_, random = (take(each, rows) for each in self.log_weights)
        return replace(
            self,
            centre_cm=self.centre_cm[rows],
            sigma_cm=self.sigma_cm[rows],
            log_weights=(hit, unexpected, max_, random),
            added=tuple(Added(take(odds, rows), each.take(rows), stream) for odds, each, stream in self.added),
            faults=tuple(Faulty(take(share, rows), fault, stream) for share, fault, stream in self.faults),
            run_offsets=tuple(RunOffset(each, runs[rows], stream) for each, runs, stream in self.run_offsets),
        )

    def sample(self, streams: Streams) -> _Array:
        """One reading a row [cm]; each part draws from its own stream."""
        n = len(self)
        centre_cm, sigma_cm = self._with_run_offsets(streams)
        hits = Hits(centre_cm, sigma_cm, self.minimum_cm, self.maximum_cm)
        reading_cm = self._sample_base(hits, streams)
        # Of independent exponential waiting times, each with its part's rate, the first is each part's by its odds.
        first = streams["race"].standard_exponential(n)
        for odds, component, stream in self.added:
            with np.errstate(divide="ignore"):
                arrival = streams[stream].standard_exponential(n) / odds
            drawn_cm = component.sample(streams[stream], hits)
            wins = arrival < first
            reading_cm[wins], first[wins] = drawn_cm[wins], arrival[wins]
        saturated = streams["saturated"].random(n) < self.saturated_fraction
        reading_cm[(reading_cm == self.maximum_cm) & saturated] = SATURATED_CM
        for share, fault, stream in self.faults:
            reading_cm = np.where(streams[stream].random(n) < share, fault.arrives(reading_cm), reading_cm)
        return reading_cm

    def _with_run_offsets(self, streams: Streams) -> tuple[_Array, _Array]:
        """Centres that have each run's own offset, and the spread without the offsets' share."""
        if not self.run_offsets:
            return self.centre_cm, self.sigma_cm
        centre_cm = self.centre_cm
        for deviation_cm, runs, stream in self.run_offsets:
            names, index = np.unique(runs, return_inverse=True)
            offset_cm = np.array([streams.normal_of(stream, str(run)) if run else 0.0 for run in names])
            centre_cm = centre_cm + deviation_cm * offset_cm[index]
        return centre_cm, np.sqrt(np.maximum(self.sigma_cm**2 - self.between_cm2, 0.0))

    def _sample_base(self, hits: Hits, streams: Streams) -> _Array:
        n = len(self)
        reading_cm = np.rint(hits.centre_cm + hits.sigma_cm * streams["hit"].standard_normal(n))
        reading_cm = np.maximum(np.fmin(reading_cm, self.maximum_cm), self.minimum_cm)
        kind, place = streams["kind"].random(n), streams["place"].random(n)
        shares = self._shares()
        below_hit, below_unexpected = shares[0], shares[0] + shares[1]
        # The last share takes what rounding leaves, so it must be none where it has no weight.
        below_max = np.where(shares[3] > 0.0, below_unexpected + shares[2], 1.0)
        unexpected = np.flatnonzero((kind >= below_hit) & (kind < below_unexpected))
        rate_per_cm = self.rate_per_m / 100.0
        length_cm = np.maximum(np.fmin(hits.centre_cm[unexpected], self.maximum_cm) - self.minimum_cm, 0.0)
        nearer_cm = -np.log1p(place[unexpected] * np.expm1(-rate_per_cm * length_cm)) / rate_per_cm
        reading_cm[unexpected] = np.minimum(np.rint(self.minimum_cm + nearer_cm), self.maximum_cm)
        reading_cm[(kind >= below_unexpected) & (kind < below_max)] = self.maximum_cm
        random = np.flatnonzero(kind >= below_max)
        reading_cm[random] = self.minimum_cm + np.floor(place[random] * (self.maximum_cm - self.minimum_cm + 1))
        return reading_cm

    def _shares(self) -> _Array:
        """Shares of the four kinds of the base, shape (4, n) or (4, 1)."""
        logs = np.array(np.broadcast_arrays(*(np.atleast_1d(each) for each in self.log_weights)))
        weights = np.exp(logs - logs.max(axis=0))
        return np.asarray(np.broadcast_to(weights / weights.sum(axis=0), (4, len(self))))

    def _log_after(self, faults: Sequence[Faulty], first: _Array, last: _Array) -> _Array:
        """log of the probability of the codes from first to last behind these faults."""
        if not faults:
            return self._log_saturated(first, last)
        share, fault, _ = faults[-1]
        with np.errstate(divide="ignore"):
            log_p: _Array = np.log1p(-share) + self._log_after(faults[:-1], first, last)
            log_share = np.log(share)
        for origin_first, origin_last in fault.origins(first, last):
            log_p = np.logaddexp(log_p, log_share + self._log_after(faults[:-1], origin_first, origin_last))
        return log_p

    def _log_saturated(self, first: _Array, last: _Array) -> _Array:
        """The mixture, of whose no-echo readings some arrive as 255."""
        first, last = np.maximum(first, self.minimum_cm), np.minimum(last, self.maximum_cm)
        inside = np.flatnonzero(first <= last)
        if inside.size < first.size:
            log_p = np.full(first.shape, -np.inf)
            if inside.size:
                log_p[inside] = self.take(inside)._log_saturated(first[inside], last[inside])
            return log_p
        log_p = self._log_mixture(first, last)
        if self.saturated_fraction > 0.0:
            has_max = last == self.maximum_cm
            has_255 = (first <= SATURATED_CM) & (last >= SATURATED_CM)
            some = np.flatnonzero(has_max != has_255)
            if some.size:
                log_p[some] = self.take(some)._log_one_of(first[some], last[some], has_max[some])
        return log_p

    def _log_one_of(self, first: _Array, last: _Array, has_max: NDArray[np.bool_]) -> _Array:
        """Codes among which is the maximum or 255, and not both."""
        top = np.full_like(first, self.maximum_cm)
        # What is left of the maximum, or what 255 gets of it; and the other codes.
        share = np.where(has_max, 1.0 - self.saturated_fraction, self.saturated_fraction)
        with np.errstate(divide="ignore"):
            log_moved = np.log(share) + self._log_mixture(top, top)
        below = np.where(has_max, self.maximum_cm - 1.0, last)
        log_rest = np.where(first <= below, self._log_mixture(np.minimum(first, below), below), -np.inf)
        log_p: _Array = np.logaddexp(log_moved, log_rest)
        return log_p

    def _log_mixture(self, first: _Array, last: _Array) -> _Array:
        """log g of the codes from first to last, all within the limits."""
        minimum_cm, maximum_cm = self.minimum_cm, self.maximum_cm
        log_hits, log_nearer, log_max, log_random = self.log_weights
        others = np.exp(log_random) * (last - first + 1.0) / (maximum_cm - minimum_cm + 1.0)
        others += np.where(last == maximum_cm, np.exp(log_max), 0.0)
        if np.any(log_nearer > -np.inf):
            nearer = log_unexpected(first, self.centre_cm, self.rate_per_m, minimum_cm, maximum_cm, last)
            others += np.exp(log_nearer + nearer)
        total = sum(np.exp(each) for each in self.log_weights)
        if self.added:
            hits = Hits(self.centre_cm, self.sigma_cm, minimum_cm, maximum_cm)
            odds = np.zeros(len(self))
            for each, component, _ in self.added:
                odds += each
                with np.errstate(invalid="ignore"):
                    density = np.exp(component.log_prob(first, last, hits))
                # Where it has no share, its parameters may be unknown.
                others += np.where(each > 0.0, total * each * density, 0.0)
            total = total * (1.0 + odds)
        log_hits = log_hits + log_hit(first, self.centre_cm, self.sigma_cm, minimum_cm, maximum_cm, last)
        with np.errstate(divide="ignore"):
            log_p: _Array = np.logaddexp(log_hits, np.log(others)) - np.log(total)
        return log_p
