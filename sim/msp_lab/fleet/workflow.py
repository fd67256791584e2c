"""From a dataset to the findings: examine every sensor, search, and estimate what was found for every sensor.

A sensor whose readings cannot be used is left out with the reason.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

import msp_range
from msp_lab.fleet.findings import FleetEffect, FleetFindings, LeftOut, SessionEstimate, UnitEstimate
from msp_lab.fleet.search import FleetFinding, FleetSearch
from msp_lab.fleet.statistics import Change, shrunk
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
    outcomes = list(zip(every, run(examine, [(unit, ()) for unit in every]), strict=True))
    left_out = [LeftOut(unit.vehicle, unit.sensor, made.error) for unit, made in outcomes if made.error is not None]
    units = [unit for unit, made in outcomes if made.error is None]
    vehicles = _vehicles(dataset, units, left_out)
    numbers = [made.value for _, made in outcomes if made.value is not None]
    search = FleetSearch(units, numbers, fdr, run)
    order = {"group": 0, "odd": 0, "change": 1, "drift": 1, "shared": 2, "calibration": 3}
    found = sorted(search.all(), key=lambda finding: order[finding.kind])
    known = {finding.number.term for finding in found if finding.change is None}
    compared = search.compared(numbers)
    others = [FleetFinding("compared", number) for term, number in compared.items() if term not in known]
    findings = FleetFindings(
        sentence="",
        dataset=str(dataset),
        model=str(model),
        vehicles=vehicles,
        sensors=len(units),
        sessions=sum(len(unit.sessions) for unit in numbers),
        readings=sum(unit.readings for unit in numbers),
        effects=tuple(_effect(search, finding) for finding in [*found, *others]),
        found=len(found),
        left_out=tuple(left_out),
        fdr=fdr,
        tests=search.tests,
        untestable=_untestable(numbers),
        seed=seed,
        date=date,
        version=msp_range.__version__,
    )
    return replace(findings, sentence=sentence_of(findings))


def _vehicles(dataset: Path, units: Sequence[Unit], left_out: Sequence[LeftOut]) -> int:
    """Number of vehicles whose readings can be used; RecordingError if they are too few for a fleet."""
    vehicles = len({unit.vehicle for unit in units})
    if vehicles < MIN_VEHICLES:
        reasons = "; ".join(f"{left.vehicle} {left.sensor}: {left.why}" for left in left_out[:3])
        raise RecordingError(
            f"{dataset}: readings of {vehicles} vehicles can be used, and a fleet is at least {MIN_VEHICLES}"
            + (f". Left out: {reasons}" if reasons else "")
        )
    return vehicles


def _untestable(units: Sequence[UnitNumbers]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Effects that no sensor has the columns for."""
    common = set.intersection(*({name for name, _ in unit.untestable} for unit in units))
    return tuple((name, absent) for name, absent in units[0].untestable if name in common)


def _effect(search: FleetSearch, finding: FleetFinding) -> FleetEffect:
    number, term, fleet = finding.number, finding.number.term, finding.number.fleet
    alternatives = tuple((other.effect, lost) for other, lost in finding.alternatives)
    effect = FleetEffect(finding.kind, term.effect, term.number, term.parameter.unit, term.shape, "", alternatives)
    if finding.change is not None:
        return _changed(search, finding, finding.change, effect)
    is_odd = np.isin(number.units, list(finding.units))
    apart = number.apart if finding.kind == "group" else None
    near, near_error = shrunk(number.value - number.shift, number.error, fleet)
    log_p = fleet.deviation_log_p if apart is None else np.where(is_odd, apart.log_p, fleet.deviation_log_p)
    numbers = (number.value, number.error, near + number.shift, near_error, is_odd, np.exp(log_p))
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
        group="" if apart is None else apart.group.name,
        estimates=tuple(_estimate(search.units[unit], *own) for unit, *own in each_unit),
    )


def _estimate(
    unit: Unit, value: float, error: float, near: float, near_error: float, odd: bool, p_value: float
) -> UnitEstimate:
    """A unit's estimate, and the same shrunk towards the fleet's mean, each with its standard error."""
    half = TWO_SIDED_95 * near_error
    return UnitEstimate(unit.vehicle, unit.sensor, value, error, near, near - half, near + half, odd, p_value)


def _changed(search: FleetSearch, finding: FleetFinding, change: Change, effect: FleetEffect) -> FleetEffect:
    """The effect with what a unit's number changed by, and its estimates by session."""
    (unit,) = finding.units
    names, number = search.first[unit].sessions, finding.number
    value, variance, _ = number.series[number.units.tolist().index(unit)]
    size = change.size, change.error
    return replace(
        effect,
        plain=plain_of(number.term, change.size, with_size=True),
        estimates=(_estimate(search.units[unit], *size, *size, True, float(np.exp(change.log_p))),),
        since=names[change.first] if change.kind == "change" else "",
        sessions=tuple(map(SessionEstimate, names, value.tolist(), np.sqrt(variance).tolist())),
    )
