"""What was found of an effect, in words for a pilot: its own sentence with its numbers and their units.

It is made of the values of an effect's parameters and the sensor, run or target that it is of. The sentence is data of
the effect (`Effect.finding`), so an own effect brings its own along. In it `{of}` is the sensor, run or target, and a
parameter in braces is its number with its unit, in one of these formats:

    {delay_ms}                      325 ms as 0.33 s: a number with its unit
    {share:of} readings             three of four readings, 3.3 % of readings
    {share:%}                       101 %
    {wider:number}                  the number alone
    {growth:factor}                 a growth of 2.9 as 3.9 times as much
    {log_odds:times}                log odds: 20 times as often, 20 times less often
    {log_sd:times much}             the logarithm of a size: 1.3 times as much, 1.3 times less
    {offset_cm:too far|too near}    the size and words for its sign: 1.5 cm too near, 0.33 s behind
    {share:% too far|% too near}    the same of a share: 98 % too near
"""

import math
import string
from collections.abc import Mapping
from dataclasses import dataclass

from msp_sim.effects.base import Effect

FRACTIONS = {
    "a quarter of": 1 / 4,
    "a third of": 1 / 3,
    "half of": 1 / 2,
    "two of three": 2 / 3,
    "three of four": 3 / 4,
}
"""Shares that people say in words."""
NEAR = 0.03
"""A share within this of a fraction is written as it; the exact number is in the table next to the sentence."""
MOST = 0.97
"""From this share on it is nearly all readings."""
MOST_TIMES = 1000.0
"""Odds that change by more are as good as certain, and their exact ratio is not known."""


@dataclass(frozen=True)
class Quantity:
    """A number with its unit, in the formats of this module."""

    value: float
    unit: str

    def __format__(self, form: str) -> str:
        """The number in one of the formats.

        Raises
        ------
        ValueError
            There is no such format.
        """
        if form == "":
            return self._with_unit(self.value)
        if form == "number":
            return digits(self.value)
        if form == "%":
            return f"{digits(100.0 * self.value)} %"
        if form == "factor":
            return f"{digits(1.0 + self.value)} times as much"
        if form == "of":
            return self._share()
        if form in ("times", "times much"):
            ratio = math.exp(min(abs(self.value), math.log(MOST_TIMES)))
            many = f"more than {digits(ratio)}" if ratio >= MOST_TIMES else digits(ratio)
            more, less = ("as often", "less often") if form == "times" else ("as much", "less")
            return f"{many} times {more if self.value >= 0.0 else less}"
        more, bar, less = form.partition("|")
        if not bar:
            raise ValueError(f"no such format: {form!r}")
        words = more if self.value >= 0.0 else less
        if words.startswith("%"):
            return f"{digits(100.0 * abs(self.value))} {words}"
        return f"{self._with_unit(abs(self.value))} {words}"

    def _with_unit(self, value: float) -> str:
        if self.unit == "ms" and abs(value) >= 100.0:
            return f"{value / 1000.0:.2f} s"
        return digits(value) if self.unit in ("1", "") else f"{digits(value)} {self.unit}"

    def _share(self) -> str:
        if self.value >= MOST:
            return "nearly all"
        words = [text for text, share in FRACTIONS.items() if abs(self.value - share) <= NEAR]
        return words[0] if words else f"{digits(100.0 * self.value)} % of"


def plain_finding(effect: Effect, values: Mapping[str, float], of: str | None = None) -> str:
    """What was found of an effect, without a full stop and with a small first letter.

    Parameters
    ----------
    effect
        Of the catalogue or one's own.
    values
        Of its parameters, by name.
    of
        The sensor, run or target that it is of.

    Raises
    ------
    ValueError, KeyError
        Its sentence has a format or a parameter that there is not.

    Examples
    --------
    >>> from msp_sim.effects import CATALOGUE
    >>> plain_finding(CATALOGUE["latency"], {"delay_ms": 325.0})
    'readings are 0.33 s behind the reference'
    >>> plain_finding(CATALOGUE["stale"], {"share": 0.74})
    'three of four readings are repeats of the one before'
    >>> plain_finding(CATALOGUE["mounting_offset"], {"offset_cm": -1.5}, "front_left")
    'front_left reads 1.5 cm too near'
    """
    quantities = {parameter.name: Quantity(values[parameter.name], parameter.unit) for parameter in effect.parameters}
    if effect.finding:
        return string.Formatter().vformat(effect.finding, (), {**quantities, "of": of or f"one {effect.per}"})
    numbers = ", ".join(f"{name.replace('_', ' ')} {each}" for name, each in quantities.items())
    sentence = effect.sentence.rstrip(".")
    return f"{sentence[:1].lower()}{sentence[1:]} ({numbers})"


def digits(value: float) -> str:
    """A number with as many digits as people read: two, or three from 100 on.

    Examples
    --------
    >>> digits(1.513), digits(104.7), digits(0.0), digits(22026.5)
    ('1.5', '105', '0', '22,000')
    """
    if value == 0.0 or not math.isfinite(value):
        return "0" if value == 0.0 else "?"
    size = abs(value)
    if size >= 1000.0:
        return f"{round(value, -3 if size >= 10_000 else -2):,.0f}"
    return f"{value:.0f}" if size >= 10.0 else f"{value:.2g}"
