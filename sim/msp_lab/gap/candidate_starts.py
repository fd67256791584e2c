"""Where refits with one more candidate start: a likelihood has many local maxima along a shape, and none near what the
base has taken.

Each start is the candidate with its values, with the base that goes with it.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.candidates import CandidateEffect
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.refit import JointFit
from msp_range.arrays import Indices
from msp_range.reading_model.rows import Base
from msp_sim.model.model import Term, apply_terms, shifted
from msp_sim.model.rows import log_prob


def starts_of(prepared: Prepared, fit: JointFit, candidate: CandidateEffect, value: float) -> list[tuple[Term, Base]]:
    """The candidate at the best of some values and shapes, with the base of each start.

    Parameters
    ----------
    prepared
        The readings that are refitted.
    fit
        To which the candidate is added.
    candidate, value
        Its shape and its strength, where the screen has them.
    """
    bases = (fit.base, *_less_correlated(prepared, candidate, fit))
    starts = [(_best_start(prepared, fit, candidate, value, base), base) for base in bases]
    if candidate.effect.moves:
        starts.append(max(_moved_hits(prepared, candidate, fit), key=lambda start: _height(prepared, fit, *start)))
    return starts


def shapes_of(candidate: CandidateEffect) -> list[dict[str, float]]:
    """Shapes that are tried: values of the first number that is searched, next to all grids of the others."""
    lines = _lines(candidate)
    numbers = [parameter for parameter in candidate.effect.parameters if parameter.name in lines]
    values = [lines[number.name] if i == 0 else number.grid for i, number in enumerate(numbers)]
    return [dict(zip(lines, shape, strict=True)) for shape in product(*values)] if numbers else []


def gathered_cm(prepared: Prepared, fit: JointFit) -> tuple[float, ...]:
    """Ranges [cm] at which readings before the surface gather, those with the most beyond their neighbourhood first.

    Of n readings within `rules.GATHERED_CM` of a place and m expected by those within ten times as much, the gain is
    n log(n / m) - (n - m).
    """
    rows, sensor = fit.here.rows, prepared.scene.sensor
    far = prepared.reading_cm < rows.centre_cm - rules.FAR_SIGMAS * rows.sigma_cm
    near = np.sort(prepared.reading_cm[far & (prepared.reading_cm > sensor.minimum_cm)])
    places = np.unique(near)

    def within(cm: float) -> Indices:
        first, after = np.searchsorted(near, places - cm, "left"), np.searchsorted(near, places + cm, "right")
        return after - first

    own, expected = within(rules.GATHERED_CM), np.maximum(within(10.0 * rules.GATHERED_CM) / 10.0, 0.5)
    gains = np.where(own > expected, own * np.log(own / expected) - (own - expected), 0.0)
    found: list[float] = []
    for i in np.argsort(-gains, kind="stable"):
        if len(found) == rules.GATHERED_PLACES or gains[i] < rules.GATHERED_LEAST_NATS:
            break
        if all(abs(places[i] - place) > 2.0 * rules.GATHERED_CM for place in found):
            found.append(float(places[i]))
    return tuple(found)


def _height(prepared: Prepared, fit: JointFit, term: Term, base: Base) -> float:
    """Log likelihood of a fit with one more effect and another base, before any refit."""
    return prepared.log_likelihood(base, [*fit.effects, term])


def _best_start(prepared: Prepared, fit: JointFit, candidate: CandidateEffect, value: float, base: Base) -> Term:
    """The effect at the best of some values: its shape's first number next to all grids of the others, then each."""
    parameter, lines = candidate.parameter, _lines(candidate)
    here = candidate.at(value)
    rows, scene = prepared.at(base, fit.effects), shifted(prepared.scene, fit.effects)

    def height(term: Term) -> float:
        if term.effect.is_shift:
            # The others act on the scene that it shifts.
            return _height(prepared, fit, term, base)
        return float(log_prob(apply_terms(rows, scene, [term]), prepared.reading_cm).sum())

    def best(*changes: Mapping[str, float]) -> Term:
        return max([here, *map(here.having, changes)], key=height)

    here = best(*shapes_of(candidate))
    stronger = [np.clip(here.values[parameter.name] * times, parameter.low, parameter.high) for times in (0.25, 4.0)]
    here = best(*({parameter.name: float(strength)} for strength in (*stronger, *parameter.grid)))
    for name in list(lines)[1:]:
        here = best(*({name: place} for place in lines[name]))
    return here


def _moved_hits(prepared: Prepared, candidate: CandidateEffect, fit: JointFit) -> Iterator[tuple[Term, Base]]:
    """Starts at which a part of the hits is moved, and mean and variance of all of them are those of the fit.

    Offset and spread have taken both, and from there no small share of moved hits is any better.
    """
    rows = fit.here.rows
    sigma_cm = float(np.median(rows.sigma_cm))
    for share in rules.MOVED_SHARES:
        for sigmas in rules.MOVED_SIGMAS:
            moved_cm, left = sigmas * sigma_cm, 1.0 - share * (1.0 - share) * sigmas**2
            log_sigma = fit.base.log_sigma + 0.5 * float(np.log(left))
            base = fit.base._replace(offset_cm=fit.base.offset_cm - share * moved_cm, log_sigma=log_sigma)
            yield candidate.moved_by(moved_cm, prepared.scene.sensor).at(share), base


def _less_correlated(prepared: Prepared, candidate: CandidateEffect, fit: JointFit) -> Iterator[Base]:
    """A second start where noise follows the errors so closely that it stands in for an effect on the bias.

    A late reading errs as the one before it: correlated noise explains that as well, one reading at a time, and from
    there no small step leads to the effect. With half the correlation and the same scatter from one reading to the
    next, what is slow is the effect's to explain.
    """
    history = prepared.rows.history
    if history is None or "bias" not in candidate.effect.channels:
        return
    now = history.correlation + fit.base.correlation
    if now > rules.RESTART_CORRELATION:
        log_sigma = fit.base.log_sigma + 0.5 * float(np.log((1.0 - now**2) / (1.0 - (now / 2.0) ** 2)))
        yield fit.base._replace(correlation=fit.base.correlation - now / 2.0, log_sigma=log_sigma)


def _lines(candidate: CandidateEffect) -> dict[str, Sequence[float]]:
    """Values of each searched number of its shape, between and beyond those on its grid."""
    lines: dict[str, Sequence[float]] = {}
    for parameter in candidate.effect.parameters:
        if parameter.neutral is not None or len(parameter.grid) < 2:
            continue
        low, high = min(parameter.grid), max(parameter.grid)
        beyond = (high - low) / 2.0
        places = np.linspace(max(low - beyond, parameter.low), min(high + beyond, parameter.high), rules.SHAPE_STARTS)
        lines[parameter.name] = parameter.grid if parameter.jumps else [float(f"{place:.4g}") for place in places]
    return lines
