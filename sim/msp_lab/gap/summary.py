"""The findings in words for a pilot: a decision in a sentence, at most five lines, and for each finding its own words.

The findings are returned with their words filled in. The terminal, the page and ``gap.json`` show these and make none
of their own.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

from msp_lab.gap.conclusion import concluded
from msp_lab.gap.findings import FoundEffect, GapFindings, Measure, UnknownEffect
from msp_lab.gap.labels import effect_label, name_of, number_label, short, unit_after, unit_of
from msp_sim.effects import CATALOGUE
from msp_sim.effects.plain import digits, plain_finding
from msp_sim.page.text import and_list

MOST_REFITTED = 3
"""Refitted numbers in the lines; all of them are on the page."""
CHANNELS = {
    "bias": "the error",
    "spread": "the scatter",
    "short": "the share of short readings",
    "missed": "the share of missed echoes",
    "random": "the share of random readings",
}
"""What an unknown effect changes, as a pilot calls it."""


def with_words(findings: GapFindings) -> GapFindings:
    """Fill in the words of each finding, what they amount to, and the lines."""
    findings = concluded(
        replace(
            findings,
            effects=tuple(replace(effect, plain=_plain(effect)) for effect in findings.effects),
            unknown=tuple(replace(unknown, plain=_plain_unknown(unknown)) for unknown in findings.unknown),
        )
    )
    return replace(findings, summary=tuple(_lines(findings)))


def _lines(findings: GapFindings) -> Iterator[str]:
    if findings.how_sure:
        yield f"How sure: {findings.how_sure}"
    yield f"Next: {findings.next_step}"
    gap = findings.gap
    if gap is not None:
        yield f"Gap {_from_to(gap.nats_per_reading, 'nats per reading')}"
        yield f"Bias {_from_to(gap.bias_cm, 'cm')}; spread off by a factor {_from_to(gap.spread_ratio, '')}"
    further = [*_age(findings), *_refitted(findings)]
    if further:
        yield ". ".join(further)


def _age(findings: GapFindings) -> Iterator[str]:
    age = findings.age
    if age is not None and age.latency_s > 0.0:
        late, hold = f"{age.latency_s:.2f} s behind the reference", f"held for {age.mean_hold_s:.2f} s on average"
        yield f"A reading is {age.total_s:.2f} s old: {late}, {hold}"


def _refitted(findings: GapFindings) -> Iterator[str]:
    """Numbers of the base that are others now."""
    numbers = []
    for number in findings.refitted:
        if number.before is not None and number.after is not None:
            ends = f"{short(number.before)} to {short(number.after)}{unit_after(number.unit)}"
            numbers.append(f"{number_label(number.name)} {ends}")
    if numbers:
        more = f" and {len(numbers) - MOST_REFITTED} more" if len(numbers) > MOST_REFITTED else ""
        yield f"Refitted: {', '.join(numbers[:MOST_REFITTED])}{more}"


def _plain(found: FoundEffect) -> str:
    effect = CATALOGUE.get(found.name)
    text = effect_label(found.name, found.of)
    if effect is not None and found.parameters:
        text = plain_finding(effect, {name: value.value for name, value in found.parameters.items()}, found.of)
    if found.in_model:
        text += ", on top of what the model says"
    if found.verdict == "indistinguishable" and found.alternatives:
        others = " or ".join(effect_label(other.name, other.of) for other in found.alternatives)
        text += f" (or it is {others})"
    return text


def _plain_unknown(unknown: UnknownEffect) -> str:
    what = CHANNELS.get(unknown.channel, unknown.channel)
    over = and_list([name_of(one) for one in unknown.variables])
    if not unknown.curve:
        return f"{what} depends on {over} in an unknown way"
    values = [value for _, value, _, _ in unknown.curve]
    size = max(values) - min(values)
    unit = f"{digits(size)} cm" if unknown.channel == "bias" else f"a factor of {digits(math.exp(min(size, 7.0)))}"
    if unknown.period is not None:
        period = f"{unknown.period:.3g} {unit_of(unknown.variables[0])}"
        return f"{what} goes up and down by {unit} with every {period} of {over}, in an unknown way"
    return f"{what} changes by {unit} over the {over} in an unknown way"


def _from_to(measure: Measure, unit: str) -> str:
    """A measure before and after, where it changed, with its noise floor."""
    before, after, floor = (short(value, "?") for value in (measure.before, measure.after, measure.noise_floor))
    changed = f" to {after}" * (measure.after is not None and after != before)
    return f"{before}{changed} {unit}".rstrip() + f" (noise floor {floor})" * (measure.noise_floor is not None)
