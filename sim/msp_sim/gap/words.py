"""Context columns and effects as people write them, for pictures and sentences."""

import re

_UNITS = {
    "_cm_s": "cm/s",
    "_cm": "cm",
    "_c": "°C",
    "_deg": "°",
    "_pct": "%",
    "_hz": "Hz",
    "_khz": "kHz",
    "_ms": "ms",
    "_s": "s",
    "_db": "dB",
}
_SPECIAL = {"range_rate_cm_s": "rate of the range", "uptime_s": "time since power-up", "incidence_deg": "incidence"}


def unit_of(column: str) -> str:
    """The unit that a column's name ends with; empty where there is none."""
    for ending in sorted(_UNITS, key=len, reverse=True):
        if column.endswith(ending):
            return _UNITS[ending]
    return ""


def name_of(column: str) -> str:
    """A column's name without its unit.

    Examples
    --------
    >>> name_of("air_temperature_c"), name_of("throttle"), name_of("true_range_cm")
    ('air temperature', 'throttle', 'true range')
    """
    if column in _SPECIAL:
        return _SPECIAL[column]
    for ending in sorted(_UNITS, key=len, reverse=True):
        if column.endswith(ending):
            return column.removesuffix(ending).replace("_", " ")
    return column.replace("_", " ")


def column_words(column: str) -> str:
    """For an axis.

    Examples
    --------
    >>> column_words("air_temperature_c"), column_words("throttle")
    ('air temperature [°C]', 'throttle')
    """
    unit = unit_of(column)
    return f"{name_of(column)} [{unit}]" if unit else name_of(column)


def plain(where: str) -> str:
    """A slice's name, its units behind its numbers.

    Examples
    --------
    >>> plain("throttle 0.7 to 1, air_temperature_c 20 to 25")
    'throttle 0.7 to 1, air temperature 20 to 25 °C'
    """
    return ", ".join(_plain_one(each) for each in where.split(", "))


def _plain_one(where: str) -> str:
    column, _, rest = where.partition(" ")
    unit = unit_of(column)
    if not re.match(r"-?\d", rest):
        return f"{name_of(column)} {rest}" if "_" in column or rest else where
    return f"{name_of(column)} {rest}" + ("" if not unit else unit if unit == "°" else f" {unit}")
