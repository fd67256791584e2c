"""The distribution of n readings with effects: the base mixture, additional components, and faults of the code.

Made from the centres, spreads and weights that the effects have changed; draws readings and gives their probabilities,
with the derivatives by the parameters of the mixture for fits and scores. All steps after the mixture (saturation,
faults of the code) are linear in the probability, so derivatives pass through them as the probability itself does.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np

from msp_range.arrays import Array, Column, Flags, Indices
from msp_range.reading_model.kernel import Hit
from msp_range.reading_model.rows import MIN_PROBABILITY, Base, MixtureRows, Part, among, shares_of
from msp_range.reading_model.sensor_model import SATURATED_CM
from msp_sim.effects.codes import CodeFault
from msp_sim.effects.component import Code, Component, Hits
from msp_sim.model.history import HIT_SIGMAS, MAX_CORRELATION, History
from msp_sim.model.streams import RandomStreams


class AddedComponent(NamedTuple):
    """An additional component: its odds relative to the base mixture, and the name of its random stream."""

    odds: Any
    component: Component
    stream: str


class AppliedFault(NamedTuple):
    """A fault of the code: the share of readings affected, and the name of its random stream."""

    share: Any
    fault: CodeFault
    stream: str


class RunOffset(NamedTuple):
    """An offset common to the readings of a run: its standard deviation [cm], and the run of each row ("": none)."""

    deviation_cm: float
    runs: Column
    stream: str


@dataclass(frozen=True)
class Carry:
    """What readings carry over from the last hit before them, each (n,); all zero where there is none."""

    before: Indices
    """Place of the last hit."""
    factor: Array
    """By how much a centre moves if that hit's centre moves back by one."""
    shift_cm: Array
    """By how much the hit's error moves the centre [cm]."""
    correlation_shift_cm: Array
    log_sigma_slope: Array
    """Derivatives by the correlation, of the centre [cm] and of the logarithm of the spread."""


@dataclass(frozen=True)
class ModelRows(MixtureRows):
    """Distribution of n readings.

    With q the base mixture of `ReadingModel`, o_j the odds and c_j the densities of the components added, and faults
    f = 1 ... F, each of which affects a share s_f of what the previous ones give::

        q(k)    weights w_i exp(eta_i), divided by their sum
        g(k)  = (q(k) + sum_j o_j c_j(k)) / (1 + sum_j o_j), of whose readings of M a share is received as 255
        p_f(k) = (1 - s_f) p_(f-1)(k) + s_f (sum of p_(f-1)(i) over the codes i that f turns into k)

    Attributes
    ----------
    sigma_cm
        Standard deviation of the hits of all runs together, shape (n,).
    """

    added: tuple[AddedComponent, ...] = ()
    faults: tuple[AppliedFault, ...] = ()
    run_offsets: tuple[RunOffset, ...] = ()
    """Contributions of the effects; faults in the order in which they are applied."""
    history: History | None = None
    """Which reading came before which, if the noise is correlated. Then a reading's probability is that after the
    readings before it: with e_j the error of the last hit j and c their correlation, its hit is normal about centre_i +
    c (sigma_i / sigma_j) e_j with the deviation sigma_i sqrt(1 - c^2)."""
    reference_cm2: Any = 0.0
    """Variance of the error of each reading's true range [cm^2], (n,) or a number; part of ``sigma_cm``. A normal error
    of the reference widens the hits, and what is counted from them, exactly; the end of short readings, which lies
    below the hits, is not blurred."""

    @property
    def between_cm2(self) -> Any:
        """Variance of the hits between runs [cm^2]."""
        return sum(np.where(runs != "", deviation_cm**2, 0.0) for deviation_cm, runs, _ in self.run_offsets)

    @property
    def within_share(self) -> Any:
        """Share of the hits' variance that is the sensor's own scatter within a run: not the offsets of runs, and not
        the reference's error."""
        if not self.run_offsets and np.ndim(self.reference_cm2) == 0 and self.reference_cm2 == 0.0:
            return 1.0
        return np.maximum(1.0 - (self.between_cm2 + self.reference_cm2) / self.sigma_cm**2, 0.0)

    @property
    def hits(self) -> Hits:
        """What additional components know of the hits and the sensor."""
        return Hits(self.centre_cm, self.sigma_cm, self.minimum_cm, self.maximum_cm, self.step_cm)

    def wider(self, factor: Any) -> Self:
        """A copy with the sensor's spread within runs multiplied by a factor; the rest of the spread is unchanged."""
        within = self.within_share
        if np.ndim(within) == 0 and within == 1.0:
            return replace(self, sigma_cm=self.sigma_cm * factor)
        return replace(self, sigma_cm=self.sigma_cm * np.sqrt(1.0 - within + within * factor**2))

    def changed(self, change: Base) -> Self:
        """A copy with its numbers changed, that of the correlation too where the noise is correlated."""
        rows, history = super().changed(change), self.history
        if history is not None:
            correlation = float(np.clip(history.correlation + change.correlation, 0.0, MAX_CORRELATION))
            history = replace(history, correlation=correlation)
        return replace(rows, history=history)

    def scores(self, reading_cm: Array) -> tuple[Array, Array]:
        """As the base class; of the spread only that within runs moves."""
        log_p, by = super().scores(reading_cm)
        by[:, 1] *= self.within_share
        return log_p, by

    @property
    def marginal(self) -> Self:
        """Each reading's distribution without what the readings before it say."""
        return replace(self, history=None)

    def given(self, reading_cm: Array) -> tuple[Self, "Carry | None"]:
        """The distribution of each reading after the readings before it, and what it carries over from them."""
        history = self.history
        if history is None:
            return self, None
        sigma_cm = np.broadcast_to(self.sigma_cm, self.centre_cm.shape)
        error_cm = reading_cm - self.centre_cm
        before, age_s = history.before(self.are_hits(reading_cm))
        has = before >= 0
        over = np.where(has, history.correlation_over(age_s), 0.0)
        ratio = np.where(has, sigma_cm / sigma_cm[before], 0.0)
        there_cm = np.where(has, ratio * np.where(has, error_cm[before], 0.0), 0.0)
        slope = np.where(has, history.slope_over(np.where(has, age_s, 0.0)), 0.0)
        carry = Carry(np.where(has, before, 0), over * ratio, over * there_cm, slope * there_cm, over * slope)
        left = 1.0 - over**2
        rows = replace(
            self,
            centre_cm=self.centre_cm + carry.shift_cm,
            sigma_cm=sigma_cm * np.sqrt(left),
            history=None,
            # What is known of the error takes the same share from each of its parts.
            run_offsets=(),
            reference_cm2=(self.between_cm2 + self.reference_cm2) * left,
        )
        return rows, replace(carry, log_sigma_slope=-carry.log_sigma_slope / left)

    def are_hits(self, reading_cm: Array) -> Flags:
        """Readings whose error is that of a hit, (n,)."""
        sigma_cm = np.broadcast_to(self.sigma_cm, self.centre_cm.shape)
        error_cm = reading_cm - self.centre_cm
        with np.errstate(invalid="ignore"):
            found = (np.abs(error_cm) < HIT_SIGMAS * sigma_cm) & (reading_cm < self.maximum_cm)
        found &= (reading_cm > self.minimum_cm) & ~self._is_code(reading_cm, error_cm / sigma_cm, sigma_cm)
        return found

    def _is_code(self, reading_cm: Array, off_sigmas: Array, sigma_cm: Array) -> Flags:
        """Readings that are rather the code of a component than hits, (n,): a repeated one has no error of its own."""
        found = np.zeros(reading_cm.size, dtype=bool)
        hits = shares_of(self.log_weights)[0]
        for odds, component, _ in self.added:
            if isinstance(component, Code):
                share = hits * Hit.density(off_sigmas**2, 1.0) * self.step_cm / sigma_cm
                with np.errstate(invalid="ignore"):
                    found |= (component.code_cm == reading_cm) & (odds > share)
        return found

    def log_prob(self, reading_cm: Array) -> Array:
        """log of the probability of each reading, after those before it; -inf for what cannot be read."""
        return super(ModelRows, self.given(reading_cm)[0]).log_prob(reading_cm)

    def of_readings(self, reading_cm: Array, part: Part) -> Array:
        """What ``part`` is of each reading, after those before it, (m, n); 0 for what is no multiple of the step."""
        return super(ModelRows, self.given(reading_cm)[0]).of_readings(reading_cm, part)

    def take(self, rows: Any) -> Self:
        """Some of the rows; their history is that of all and is left out."""
        return replace(super().take(rows), history=None)

    def sample(self, streams: RandomStreams) -> Array:
        """Draw one reading per row [cm]; each part uses its own random stream."""
        n = len(self)
        centre_cm, sigma_cm = self._with_run_offsets(streams)
        hits = replace(self.hits, centre_cm=centre_cm, sigma_cm=sigma_cm)
        normal, kind, place = streams["hit"].standard_normal(n), streams["kind"].random(n), streams["place"].random(n)
        if self.history is not None:
            normal = self.history.correlated(normal, streams)
        reading_cm = replace(self, centre_cm=centre_cm, sigma_cm=sigma_cm).draw(normal, kind, place)
        # Independent exponential waiting times with the parts' odds as rates: the first one selects the part.
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

    def _with_run_offsets(self, streams: RandomStreams) -> tuple[Array, Array]:
        """Centres including each run's own offset, and the spread within runs."""
        if not self.run_offsets:
            return self.centre_cm, self.sigma_cm
        centre_cm = self.centre_cm
        for deviation_cm, runs, stream in self.run_offsets:
            names, index = np.unique(runs, return_inverse=True)
            offset_cm = np.array([streams.normal_of(stream, str(run)) if run else 0.0 for run in names])
            centre_cm = centre_cm + deviation_cm * offset_cm[index]
        return centre_cm, np.sqrt(np.maximum(self.sigma_cm**2 - self.between_cm2, 0.0))

    def arrives(self, first: Array, last: Array, part: Part) -> Array:
        """Distribution of the readings that arrive, as in the base class, after all faults of the code."""
        return self._after(len(self.faults), first, last, part)

    def _after(self, count: int, first: Array, last: Array, part: Part) -> Array:
        """Distribution after the first ``count`` faults of the code."""
        if not count:
            return super().arrives(first, last, part)
        inside = np.flatnonzero(first <= last)
        if inside.size < first.size:
            # Most faults give few codes, so that their own origins are those of few readings.
            some = self.take(inside)._after(count, first[inside], last[inside], part)
            return among(some, inside, first.size)
        share, fault, _ = self.faults[count - 1]
        faulty = sum(self._after(count - 1, *origin, part) for origin in fault.origins(first, last))
        if np.ndim(share) == 0 and share == 1.0:
            return np.asarray(faulty)
        return np.asarray((1.0 - share) * self._after(count - 1, first, last, part) + share * faulty)

    def probability(self, first: Array, last: Array) -> Array:
        """Probability g of the codes from first to last, within the limits, before saturation and faults, (1, n)."""
        return self._mixed_in(super().probability(first, last), first, last)

    def slopes(self, first: Array, last: Array) -> Array:
        """g and its derivatives in the order of `FREE`, (8, n); that by the saturated fraction is 0."""
        return self._mixed_in(super().slopes(first, last), first, last)

    def _mixed_in(self, parts: Array, first: Array, last: Array) -> Array:
        """Add the components to the mixture's probability, or to the probability and its slopes."""
        if not self.added:
            return parts
        hits, odds = self.hits, 1.0
        for each, component, _ in self.added:
            odds = odds + each
            with np.errstate(invalid="ignore"):
                own = component.prob(first, last, hits, slopes=len(parts) > 1)
            # A component without a share may have unknown parameters.
            parts[: len(own)] += np.where(each > 0.0, each * own, 0.0)
        return parts / odds

    def last_added(self, first: Array, last: Array) -> Array:
        """Probability under the last component alone, (1, n)."""
        with np.errstate(invalid="ignore"):
            found = self.added[-1].component.prob(first, last, self.hits)
        # A component without a share may have unknown parameters.
        return np.nan_to_num(found)


def log_prob(rows: ModelRows, reading_cm: Array) -> Array:
    """Log probabilities alone, (n,): as `ModelRows.log_prob`, but at least log `MIN_PROBABILITY`."""
    return np.asarray(np.log(np.maximum(rows.of_readings(reading_cm, ModelRows.probability)[0], MIN_PROBABILITY)))


def score_of_component(rows: ModelRows, reading_cm: Array, component: Component, log_p: Array) -> Array:
    """Derivative of the log probabilities by the odds of one more component, at odds of 0, (n,)."""
    others = 1.0 + sum(np.asarray(each.odds) for each in rows.added)
    own = replace(rows, added=(AddedComponent(1.0, component, ""),)).of_readings(reading_cm, ModelRows.last_added)[0]
    return _ratio(own, log_p) / others


def score_of_fault(rows: ModelRows, reading_cm: Array, fault: CodeFault, log_p: Array) -> Array:
    """Derivative of the log probabilities by the share of one more fault, at a share of 0, (n,)."""
    faults = sorted((*rows.faults, AppliedFault(1.0, fault, "")), key=lambda each: each.fault.order)
    own = replace(rows, faults=tuple(faults)).of_readings(reading_cm, ModelRows.probability)[0]
    return _ratio(own, log_p)


def _ratio(own: Array, log_p: Array) -> Array:
    """The added probability divided by the present one, minus 1; an impossible reading cannot become less probable."""
    p = np.exp(log_p)
    return np.maximum(own / p - 1.0, np.where(p > MIN_PROBABILITY * (1.0 + 1e-9), -1.0, 0.0))
