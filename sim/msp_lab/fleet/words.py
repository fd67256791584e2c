"""What was found in a fleet, in sentences that an operator understands."""

from collections.abc import Sequence

from msp_lab.fleet.findings import FleetEffect, FleetFindings, UnitEstimate
from msp_lab.fleet.terms import FleetTerm
from msp_sim.effects.plain import plain_finding
from msp_sim.page.text import and_list, capitalised, listed

MAX_NAMES = 8
"""Vehicles that a sentence names; the table has all."""
ENOUGH_VEHICLES = 6
"""With fewer vehicles the spread between the others has so few degrees of freedom that 40 standard errors are no
finding among all that is asked. Smaller: fleets in which
nothing can be found read as fleets in which nothing is wrong."""
MAX_SENTENCES = 3
"""Findings in the first sentence; the list below it has all."""


def plain_of(term: FleetTerm, value: float, with_size: bool) -> str:
    """A number in words; without its size where nothing was found of it."""
    effect = term.catalogued
    if not with_size:
        return effect.sentence.rstrip(".")
    return plain_finding(effect, {**effect.neutral_values(), **dict(term.shape), term.number: value}, term.of)


def names_of(units: Sequence[UnitEstimate], several_sensors: bool) -> str:
    """Vehicles, with their sensors where they have several."""
    sensors: dict[str, list[str]] = {}
    for unit in units:
        sensors.setdefault(unit.vehicle, []).append(unit.sensor)
    names = [f"{name} ({', '.join(own)})" if several_sensors else name for name, own in sensors.items()]
    return listed(names, MAX_NAMES)


def line_of(effect: FleetEffect, findings: FleetFindings) -> str:
    """One finding, without a full stop."""
    several = findings.sensors > findings.vehicles
    names = names_of(effect.odd, several)
    count = len({estimate.vehicle for estimate in effect.odd})
    others = " or ".join(name.replace("_", " ") for name, _ in effect.alternatives)
    other = f" (or {others})" if others else ""
    if effect.kind == "change":
        return f"{names} changed with {effect.since}: since then {effect.plain}{other}"
    if effect.kind == "drift":
        return f"{names} drifted: from its first session to its last, {effect.plain}{other}"
    if effect.kind == "odd":
        return f"{count} of {findings.vehicles} vehicles differ{'s' * (count == 1)}: {effect.plain}{other}: {names}"
    if effect.kind == "group":
        return f"the vehicles of {effect.group} differ from the others: {effect.plain}{other}: {names}"
    if effect.kind == "shared":
        return f"the whole fleet differs from the model: {effect.plain}{other}"
    return f"in the whole fleet {effect.name.replace('_', ' ')} is another number than the model's: {effect.plain}"


def sentence_of(findings: FleetFindings) -> str:
    """The answer, for an operator."""
    found = [effect for effect in findings.effects[: findings.found] if effect.kind != "calibration"]
    if not found:
        text = f"No vehicle of {findings.vehicles} differs from the others, as far as these readings can tell."
        if findings.vehicles < ENOUGH_VEHICLES:
            text += f" Of fewer than {ENOUGH_VEHICLES} even one that is far off is within what they scatter."
        return text
    lines = [line_of(effect, findings) for effect in found[:MAX_SENTENCES]]
    more = len(found) - MAX_SENTENCES
    text = "; ".join(lines) + (f"; and {more} more finding{'s' * (more > 1)}" if more > 0 else "")
    return f"{capitalised(text)}. {100.0 * findings.fdr:.3g} % of such findings are expected to be false."


def left_out_line(findings: FleetFindings) -> str:
    """Who is not in the comparison, and why."""
    parts = [f"{left.vehicle} {left.sensor} ({left.why})" for left in findings.left_out]
    return f"Left out: {and_list(parts)}." if parts else ""


def one_session_line(findings: FleetFindings) -> str:
    """A hint where vehicles have many sensors, of which each has one session: those of tables without a name of it."""
    if not findings.vehicles < findings.sensors == findings.sessions:
        return ""
    return (
        f"Each of the {findings.sensors} sensors has one session. If they are one sensor of each vehicle, give the "
        "tables a column 'sensor' with its name: without one each file is a sensor of its own."
    )
