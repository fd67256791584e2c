"""The findings in words for a pilot: one sentence, at most five lines with numbers, and for each finding its own words.

Findings enter and leave with their words filled in. The terminal, the page and ``gap.json`` show these and make none
of their own.
"""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from msp_lab.gap import rules
from msp_lab.gap.findings import FoundEffect, GapFindings, Measure, UnknownEffect
from msp_lab.gap.labels import effect_label, name_of, number_label, short, slice_label, unit_after, unit_of
from msp_sim.effects import CATALOGUE
from msp_sim.effects.plain import digits, plain_finding
from msp_sim.page.text import and_list, capitalised

MOST_IN_SENTENCE = 3
"""Findings in the first sentence; with more nobody reads it to its end. The others are in the table below it."""
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
    """Fill in the sentence, the lines and the words of each finding."""
    findings = replace(
        findings,
        effects=tuple(replace(each, plain=_plain(each), next_step=_next_of_effect(each)) for each in findings.effects),
        unknown=tuple(
            replace(each, plain=_plain_unknown(each), next_step=_next_of_unknown(each)) for each in findings.unknown
        ),
    )
    return replace(findings, sentence=_sentence(findings), summary=tuple(_lines(findings)))


def found_parts(findings: GapFindings) -> list[FoundEffect | UnknownEffect]:
    """All that is a finding, that with the largest gain first; what is only suggested is none."""
    return sorted([*findings.confirmed, *findings.unknown], key=lambda each: -(each.gain_nats or 0.0))


def gain_percent(findings: GapFindings) -> float | None:
    """By how many per cent of itself the gap became smaller; None where it was not measured twice."""
    gap = findings.gap
    if gap is None or gap.nats_per_reading.after is None or not gap.nats_per_reading.before:
        return None
    return 100.0 * (1.0 - gap.nats_per_reading.after / gap.nats_per_reading.before)


def _sentence(findings: GapFindings) -> str:
    parts = found_parts(findings)
    if parts:
        text = and_list([each.plain for each in parts[:MOST_IN_SENTENCE]])
        more = len(parts) - MOST_IN_SENTENCE
        if more > 0:
            text += f", and there {'is 1 more finding' if more == 1 else f'are {more} more findings'}"
        text = capitalised(text) + _share_of_gap(findings)
    elif findings.verdict == "nothing missing":
        text = "Nothing is missing: readings and model agree as far as these data can tell"
        text += f"; suggested, and no finding: {and_list([each.plain for each in findings.effects])}" * bool(
            findings.effects
        )
    elif findings.verdict == "absorbed":
        text = _absorbed(findings)
    elif findings.verdict is None:
        text = _compared(findings)
    else:
        text = "Readings and model disagree, and no effect of the catalogue explains it"
        suggested = [each.plain for each in findings.effects]
        text += f"; it may be that {and_list(suggested)}" if suggested else ""
    return text + "."


def _share_of_gap(findings: GapFindings) -> str:
    percent = gain_percent(findings)
    if findings.verdict == "improved":
        return "; the model was close enough without it"
    if percent is None or findings.verdict is None:
        return ""
    if percent < 1.0:
        return "; but the disagreement does not become smaller by that"
    only = "only " if findings.verdict == "unexplained" else ""
    rest = ", and the rest has no name yet" if findings.verdict != "explained" else ""
    return f"; that is {only}{_percent(percent)} of the disagreement{rest}"


def _absorbed(findings: GapFindings) -> str:
    numbers = [number_label(each.name) for each in findings.calibration if each.name not in ("resolution", "code")]
    text = f"The disagreement is absorbed in {and_list(numbers) if numbers else 'the numbers of the base model'}"
    return f"{text}; {_why_open(findings) or 'no recorded column says why'}"


def _why_open(findings: GapFindings) -> str:
    """Which column would say why a number of the base is another one; empty where none would."""
    if not findings.causes:
        return ""
    cause = findings.causes[0]
    why = "did not vary enough to say why" if cause.recorded else "was not recorded and might say why"
    return f"{name_of(cause.column)} {why}"


def _compared(findings: GapFindings) -> str:
    gap = findings.gap
    if gap is None:
        return "Readings and model were compared"
    floor = gap.nats_per_reading.noise_floor
    if floor is not None and (gap.nats_per_reading.before or 0.0) <= floor:
        return "Readings and model agree as far as random variation lets them"
    worst = next((each for each in findings.slices if each.variables), None)
    where = f", most where {slice_label(worst.where)}" if worst is not None else ""
    return f"Readings and model disagree{where}; what is missing is not named yet"


def _lines(findings: GapFindings) -> Iterator[str]:
    gap = findings.gap
    if gap is not None:
        nats, bias, spread = gap.nats_per_reading, gap.bias_cm, gap.spread_ratio
        percent = gain_percent(findings)
        changed = percent is not None and nats.after != nats.before
        less = "" if percent is None or not changed else f", {_percent(percent)} less" if percent > 0.0 else ", no less"
        yield f"Gap {_from_to(nats, 'nats per reading')}{less}{_floor(nats, '')}"
        visible_cm = rules.NOISE_FLOOR_FACTOR * (bias.noise_floor or 0.0)
        grew = bias.after is not None and bias.after > max(bias.before or 0.0, visible_cm)
        warning = "; it grew, so find out why before you fly with this model" if grew else ""
        yield f"Bias {_from_to(bias, 'cm')}{_floor(bias, ' cm')}{warning}"
        yield f"Spread off by a factor {_from_to(spread, '')}{_floor(spread, '')}"
    further = [*_age(findings), *_refitted(findings)]
    if further:
        yield ". ".join(further)
    yield f"Next: {_next(findings)}"


def _age(findings: GapFindings) -> Iterator[str]:
    age = findings.age
    if age is not None:
        late, hold = f"{age.latency_s:.2f} s behind the reference", f"held for {age.mean_hold_s:.2f} s on average"
        yield f"A reading is {age.total_s:.2f} s old: {late}, {hold}"


def _refitted(findings: GapFindings) -> Iterator[str]:
    """Numbers of the base that are others now, and why that stays open."""
    numbers = []
    for each in findings.calibration:
        if each.before is not None and each.after is not None and each.name not in ("resolution", "code"):
            ends = f"{_short(each.before)} to {_short(each.after)}{unit_after(each.unit)}"
            numbers.append(f"{number_label(each.name)} {ends}")
    if numbers:
        why = "" if findings.verdict == "absorbed" else _why_open(findings)
        more = f" and {len(numbers) - MOST_REFITTED} more" if len(numbers) > MOST_REFITTED else ""
        yield f"Refitted: {', '.join(numbers[:MOST_REFITTED])}{more}" + (f"; {why}" if why else "")


def _next(findings: GapFindings) -> str:
    """The one thing to do first."""
    if findings.verdict is None:
        named = findings.effects or findings.unknown
        return "msp-lab add DIR adds it and measures what is left" if named else "msp-lab name DIR names it"
    parts: Sequence[FoundEffect | UnknownEffect] = found_parts(findings)
    for each in parts:
        if isinstance(each, UnknownEffect) or each.verdict == "indistinguishable":
            return each.next_step
    if findings.verdict == "absorbed":
        cause = findings.causes[0] if findings.causes else None
        return "record more context (throttle, temperature, tilt)" if cause is None else cause.experiment
    if findings.verdict in ("explained", "improved"):
        return "fly model.yaml (msp-sim fly SCENARIO.yaml --model DIR/model.yaml)"
    if findings.verdict == "nothing missing":
        return "fly the model as it is; report.html lists the smallest effects that these readings would have shown"
    suggested = [each for each in findings.effects if each.verdict == "suggested"]
    if suggested:
        return suggested[0].next_step
    # A column first that shows many effects by itself.
    alone = Counter(each.columns[0] for each in findings.not_testable if len(each.columns) == 1)
    columns = [name for name, _ in alone.most_common(3)]
    record = f", and record {and_list(columns)}" if columns else ""
    return f"look at the slices that are still off in report.html{record}"


def _plain(each: FoundEffect) -> str:
    effect = CATALOGUE.get(each.name)
    text = effect_label(each.name, each.of)
    if effect is not None and each.parameters:
        text = plain_finding(effect, {name: value.value for name, value in each.parameters.items()}, each.of)
    if each.in_model:
        text += ", on top of what the model says"
    if each.verdict == "indistinguishable" and each.alternatives:
        others = " or ".join(effect_label(other.name, other.of) for other in each.alternatives)
        text += f" (or it is {others})"
    return text


def _next_of_effect(each: FoundEffect) -> str:
    if each.verdict == "suggested":
        return f"no finding yet ({each.doubt}); to decide it: {each.experiment}"
    return each.experiment if each.verdict == "indistinguishable" else f"to see it alone: {each.experiment}"


def _plain_unknown(each: UnknownEffect) -> str:
    what = CHANNELS.get(each.channel, each.channel)
    over = and_list([name_of(one) for one in each.variables])
    if not each.curve:
        return f"{what} depends on {over} in an unknown way"
    values = [value for _, value, _, _ in each.curve]
    size = max(values) - min(values)
    unit = f"{digits(size)} cm" if each.channel == "bias" else f"a factor of {digits(math.exp(min(size, 7.0)))}"
    if each.period is not None:
        period = f"{each.period:.3g} {unit_of(each.variables[0])}"
        return f"{what} goes up and down by {unit} with every {period} of {over}, in an unknown way"
    return f"{what} changes by {unit} over the {over} in an unknown way"


def _next_of_unknown(each: UnknownEffect) -> str:
    if each.likely_causes:
        name, column = each.likely_causes[0]
        over = and_list([name_of(one) for one in each.variables])
        return f"record {column}: {effect_label(name, None)} needs it and depends on the same {over}, a likely cause"
    return "look at its curve in report.html; if you know the physics, write it as an effect (docs/developing.md)"


def _percent(value: float) -> str:
    return "more than 99 %" if value > 99.0 else f"{value:.0f} %"


def _from_to(measure: Measure, unit: str) -> str:
    after = "" if measure.after in (None, measure.before) else f" to {_short(measure.after)}"
    return f"{_short(measure.before)}{after} {unit}".rstrip()


def _floor(measure: Measure, unit: str) -> str:
    return "" if measure.noise_floor is None else f" (noise floor {_short(measure.noise_floor)}{unit})"


def _short(value: float | None) -> str:
    return short(value, "?")
