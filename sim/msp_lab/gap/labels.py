"""Labels for people: context columns, effects, slices and runs as pictures and sentences name them."""

import re

import numpy as np

from msp_lab.gap.findings import FoundEffect, GapFindings, UnknownEffect
from msp_lab.mixture_fit.parameters import PARAMETERS
from msp_sim.effects.plain import digits

_UNITS = {
    "_cm_s": "cm/s",
    "_cm": "cm",
    "_m": "m",
    "_v": "V",
    "_c": "°C",
    "_deg": "°",
    "_pct": "%",
    "_hz": "Hz",
    "_khz": "kHz",
    "_ms": "ms",
    "_h": "h",
    "_s": "s",
    "_db": "dB",
}
_NUMBERS = {
    "offset_cm": "constant offset",
    "correlation": "correlation of neighbouring errors",
    **{name: parameter.label for name, parameter in PARAMETERS.items()},
}
_SPECIAL = {
    "range_rate_cm_s": "rate of the range",
    "uptime_s": "time since power-up",
    "time_in_run_s": "time in the run",
    "incidence_deg": "incidence",
}


def unit_of(column: str) -> str:
    """The unit that a column's name ends with; empty where there is none."""
    return _UNITS.get(_ending(column), "")


def with_unit(number: str, column: str) -> str:
    """A number, or a range of them, with the unit of its column."""
    unit = unit_of(column)
    return f"{number}{unit}" if unit in ("", "°") else f"{number} {unit}"


def name_of(column: str) -> str:
    """A column's name without its unit.

    Examples
    --------
    >>> name_of("air_temperature_c"), name_of("throttle"), name_of("true_range_cm")
    ('air temperature', 'throttle', 'true range')
    """
    if column in _SPECIAL:
        return _SPECIAL[column]
    return column.removesuffix(_ending(column)).replace("_", " ")


def axis_label(column: str) -> str:
    """A column's name and unit, for an axis.

    Examples
    --------
    >>> axis_label("air_temperature_c"), axis_label("throttle")
    ('air temperature [°C]', 'throttle')
    """
    unit = unit_of(column)
    return f"{name_of(column)} [{unit}]" if unit else name_of(column)


def slice_label(where: str) -> str:
    """A slice's name with its units after its numbers.

    Examples
    --------
    >>> slice_label("throttle 0.7 to 1, air_temperature_c 20 to 25")
    'throttle 0.7 to 1, air temperature 20 to 25 °C'
    """
    return ", ".join(_label_of_one(place) for place in where.split(", "))


def effect_label(name: str, of: str | None) -> str:
    """An effect, and the sensor, run or target that it is of; or a column in its place."""
    return name_of(name) + (f" of {of}" if of else "")


def finding_label(finding: FoundEffect | UnknownEffect) -> str:
    """A finding in a few words, with the alternatives that these data cannot tell from it.

    Examples
    --------
    >>> finding_label(UnknownEffect("bias", ("throttle", "uptime_s"), "", 0.1))
    'an unknown effect on bias over throttle and time since power-up'
    """
    if isinstance(finding, UnknownEffect):
        return f"an unknown effect on {finding.channel} over {' and '.join(map(name_of, finding.variables))}"
    others = (effect_label(one.name, one.of) for one in finding.alternatives)
    return " or ".join([effect_label(finding.name, finding.of), *others])


def unit_after(unit: str) -> str:
    """A unit as it follows a number; nothing for a number without one."""
    return "" if unit in ("1", "") else f" {unit}"


def size_label(name: str, size: float, unit: str) -> str:
    """A parameter's size with what it is of.

    Examples
    --------
    >>> size_label("delay_ms", 12.3, "ms"), size_label("log_odds", 5.0, "1"), size_label("share", 0.02, "1")
    ('12 ms', '148 times the odds', '0.02 (share)')
    """
    if name == "log_odds":
        return f"{digits(float(np.exp(size)))} times the odds"
    return f"{digits(size)}{unit_after(unit) or f' ({name})'}"


def extension_label(findings: GapFindings) -> str:
    """What the extended model has that the given one has not."""
    if findings.effects or findings.unknown:
        return "with what was added"
    return "nothing added yet" if findings.verdict is None else "its numbers refitted"


def channel_label(channel: str) -> str:
    """What a curve changes, with its unit.

    Examples
    --------
    >>> channel_label("bias"), channel_label("missed")
    ('bias [cm]', 'log odds of missed')
    """
    return {"bias": "bias [cm]", "spread": "log of the spread"}.get(channel, f"log odds of {channel}")


def step_name(added: str) -> str:
    """A step of the selection path, by what was added in it.

    Examples
    --------
    >>> step_name(""), step_name("mounting_offset"), step_name("bias over air_temperature_c")
    ('given model', '+ mounting offset', '+ bias over air temperature')
    """
    if not added:
        return "given model"
    if added == "calibration":
        return "its numbers refitted"
    channel, over, columns = added.partition(" over ")
    if not over:
        return f"+ {added.replace('_', ' ')}"
    return f"+ {channel} over {' and '.join(name_of(column) for column in columns.split(' and '))}"


def number_label(name: str) -> str:
    """A number of the base model, as a pilot calls it.

    Examples
    --------
    >>> number_label("sigma_cm"), number_label("reading_model.weights.short"), number_label("tail")
    ('scatter (sigma)', 'short readings', 'tail')
    """
    last = name.rpartition(".")[2]
    return _NUMBERS.get(last, last.replace("_", " "))


def short(value: float | None, unknown: str = "") -> str:
    """A number with few digits, or a word where it is not known."""
    if value is None:
        return unknown
    return "0" if abs(value) < 5e-5 else f"{value:.2g}" if abs(value) < 1.0 else f"{value:.3g}"


def interval(low: float | None, high: float | None, digits: int = 3) -> str:
    """From one number to another; nothing where they are not known."""
    return "" if low is None or high is None else f"{low:.{digits}g} to {high:.{digits}g}"


def _ending(column: str) -> str:
    """The longest unit that a column's name ends with."""
    return max((unit for unit in _UNITS if column.endswith(unit)), key=len, default="")


def _label_of_one(where: str) -> str:
    column, _, rest = where.partition(" ")
    if not re.match(r"-?\d", rest):
        return f"{name_of(column)} {rest}" if "_" in column or rest else where
    return f"{name_of(column)} {with_unit(rest, column)}"
