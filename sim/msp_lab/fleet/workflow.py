"""From a dataset to the findings: examine every sensor, search, and estimate what was found for every sensor.

A dataset and a model enter, `FleetFindings` leave. A sensor whose readings cannot be used is left out with the reason.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

import msp_range
from msp_lab.fleet.findings import FleetEffect, FleetFindings, LeftOut, SessionEstimate, UnitEstimate
from msp_lab.fleet.meta import shrunk
from msp_lab.fleet.search import FleetFinding, Search
from msp_lab.fleet.statistics import Change, Number, numbers_of
from msp_lab.fleet.terms import FleetTerm, effect_of
from msp_lab.fleet.unit import Unit, UnitNumbers, examine
from msp_lab.fleet.vehicles import MIN_VEHICLES, units_of
from msp_lab.fleet.words import plain_of, sentence_of
from msp_range.recording.error import RecordingError
from msp_sim.model.model import load_model
from msp_sim.workers import Workers

TWO_SIDED_95 = 1.959964
"""Standard errors on either side of a 95 % interval."""


def find_in_fleet(
    dataset: Path, model: Path, *, fdr: float, pattern: str | None, seed: int, date: str, where: Workers
) -> FleetFindings:
    """Find what a fleet shares, who is odd, and what changed.

    Parameters
    ----------
    dataset, model
        Folder that ``msp-lab import`` made, and the sensor model.
    fdr
        False-discovery rate.
    pattern
        What in the name of a run or log is the vehicle's name; None: the log's folder.
    seed, date
        Random seed; date to record.
    where
        Where sensors are computed.

    Raises
    ------
    RecordingError
        There is no dataset, or fewer than `MIN_VEHICLES` vehicles can be used.
    ConfigError
        The model cannot be used, or `pattern` fits no name.
    """
    run = partial(where.map, shared=load_model(model), what="sensors")
    every = units_of(dataset, pattern, seed)
    outcomes = list(zip(every, run(examine, [(unit, (), True) for unit in every]), strict=True))
    left_out = [LeftOut(unit.vehicle, unit.sensor, made.error) for unit, made in outcomes if made.error is not None]
    units = [unit for unit, made in outcomes if made.error is None]
    vehicles = len({unit.vehicle for unit in units})
    if vehicles < MIN_VEHICLES:
        reasons = "; ".join(f"{left.vehicle} {left.sensor}: {left.why}" for left in left_out[:3])
        raise RecordingError(
            f"{dataset}: readings of {vehicles} vehicles can be used, and a fleet is at least {MIN_VEHICLES}"
            + (f". Left out: {reasons}" if reasons else "")
        )
    search = Search(units, [made.value for _, made in outcomes if made.value is not None], fdr, run)
    search.search()
    order = {"odd": 0, "change": 1, "drift": 1, "shared": 2, "calibration": 3}
    effects = sorted((_effect(search, finding) for finding in search.found), key=lambda effect: order[effect.kind])
    findings = FleetFindings(
        sentence="",
        dataset=str(dataset),
        model=str(model),
        vehicles=vehicles,
        sensors=len(units),
        sessions=sum(len(numbers.sessions) for numbers in search.scores),
        readings=sum(int(numbers.readings.sum()) for numbers in search.scores),
        effects=tuple(effects) or (_effect(search, FleetFinding("calibration", FleetTerm("offset", "value"), ())),),
        found=len(effects),
        left_out=tuple(left_out),
        fdr=fdr,
        tests=search.tests,
        untestable=_untestable(search.scores),
        seed=seed,
        date=date,
        version=msp_range.__version__,
    )
    return replace(findings, sentence=sentence_of(findings))


def _untestable(scores: Sequence[UnitNumbers]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Effects that no sensor has the columns for."""
    common = set.intersection(*({name for name, _ in numbers.untestable} for numbers in scores))
    return tuple((name, absent) for name, absent in scores[0].untestable if name in common)


def _effect(search: Search, finding: FleetFinding) -> FleetEffect:
    term = finding.term
    unit_label = next(
        parameter.unit for parameter in effect_of(term.effect).parameters if parameter.name == term.number
    )
    alternatives = tuple((other.effect, lost) for other, lost in finding.alternatives)
    effect = FleetEffect(finding.kind, term.effect, term.number, unit_label, term.shape, "", alternatives)
    if finding.change is not None:
        return _changed(search, finding, finding.change, effect)
    number = _estimated(search, term)
    fleet = number.fleet
    is_odd = np.isin(number.units, finding.units) & (finding.kind == "odd")
    numbers = (
        number.value,
        number.error,
        *shrunk(number.value, number.error, fleet),
        is_odd,
        np.exp(fleet.deviation_log_p),
    )
    each_unit = zip(number.units.tolist(), *(column.tolist() for column in numbers), strict=True)
    of_odd = number.value[is_odd].mean() if is_odd.any() else fleet.mean
    shown = float(of_odd - fleet.mean * term.is_base)
    half = TWO_SIDED_95 * fleet.error
    return replace(
        effect,
        plain=plain_of(term, shown, with_size=bool(is_odd.any()) or finding.kind == "shared"),
        mean=fleet.mean,
        low=fleet.mean - half,
        high=fleet.mean + half,
        tau=fleet.tau,
        i2=fleet.i2,
        omega=number.omega,
        estimates=tuple(_estimate(search.units[unit], *own) for unit, *own in each_unit),
    )


def _estimate(
    unit: Unit, value: float, error: float, near: float, near_error: float, odd: bool, p_value: float
) -> UnitEstimate:
    """A unit's number, and the same drawn towards the fleet's with its standard error."""
    half = TWO_SIDED_95 * near_error
    return UnitEstimate(unit.vehicle, unit.sensor, value, error, near, near - half, near + half, odd, p_value)


def _estimated(search: Search, term: FleetTerm) -> Number:
    """The number in every sensor, next to what else each is known to have."""
    if term.is_base:
        scores = search.scores
    else:
        lacking = [k for k in range(len(search.units)) if not search.fits(k, term)]
        added = search.examined(lacking, [(*own, term) for own in search.terms], with_others=False)
        again = dict(zip(lacking, added, strict=True))
        scores = [again.get(k, numbers_of_unit) for k, numbers_of_unit in enumerate(search.scores)]
    # A number that hardly any unit has any more, next to what was found, is that of the first fit.
    return next(number for number in (*numbers_of(scores), *search.first) if number.term.identity == term.identity)


def _changed(search: Search, finding: FleetFinding, change: Change, effect: FleetEffect) -> FleetEffect:
    """The effect with what a unit's number changed by, and its estimates by session."""
    unit = finding.units[0]
    scores = search.before_change[unit]
    series = next(own for term, own in scores.over_sessions() if term.identity == finding.term.identity)
    sessions = zip(scores.sessions, series.value.tolist(), np.sqrt(series.variance).tolist(), strict=True)
    size = change.size, change.error
    return replace(
        effect,
        plain=plain_of(finding.term, change.size, with_size=True),
        estimates=(_estimate(search.units[unit], *size, *size, True, float(np.exp(change.log_p))),),
        since=scores.sessions[change.first] if change.kind == "change" else "",
        sessions=tuple(SessionEstimate(*session) for session in sessions),
    )
