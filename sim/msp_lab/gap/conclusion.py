"""What the findings amount to: one decision, one number for how sure it is, and one next step.

They are filled in where the findings have their verdict. Each follows from the one before, so that they cannot
contradict each other: terminal, page, ``gap.json`` and `msp-lab design` show them and make none of their own.
"""

import math
from collections.abc import Iterator
from dataclasses import replace

from scipy.special import stdtr

from msp_lab.gap import rules
from msp_lab.gap.findings import FoundEffect, GapFindings, Measure, UnknownEffect
from msp_lab.gap.labels import (
    effect_label,
    finding_label,
    name_of,
    number_label,
    short,
    slice_label,
    unit_after,
    unit_of,
)
from msp_lab.gap.verdict import NO_GAP
from msp_lab.gap.what_is_left import likely_column, next_of_runs, own_number, what_is_left
from msp_sim.effects import CATALOGUE
from msp_sim.effects.latency import LATENCY
from msp_sim.effects.plain import MOST_TIMES, digits, plain_finding
from msp_sim.effects.run_offsets import RUN_OFFSETS
from msp_sim.page.text import and_list, capitalised

MOST_IN_SENTENCE = 3
"""Findings in the first sentence; with more nobody reads it to its end. The others are in the table below it."""
RAREST = 1e-4
"""A smaller share is written as fewer than this. Sums over runs follow Student's t only so far out. Lower: one of a
million tables by forty runs, which cannot show it."""
NOTHING_NAMED = ("nothing missing", "undecided", "absorbed")
"""Verdicts that rest on the test of all effects at once."""
STILL_OPEN = ("partly explained", "unexplained")
"""Verdicts that leave a gap."""
NOT_SMALLER = "but the disagreement does not become smaller by that"
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


def concluded(findings: GapFindings) -> GapFindings:
    """Fill in the decision, how sure it is, and what to do next."""
    findings = replace(findings, random_share=_random_share(findings))
    return replace(
        findings, sentence=f"{_decision(findings)}.", how_sure=_how_sure(findings), next_step=_next_step(findings)
    )


def found_parts(findings: GapFindings) -> list[FoundEffect | UnknownEffect]:
    """All that is a finding, that with the largest gain first; what is only suggested is none."""
    return sorted([*findings.confirmed, *findings.unknown], key=lambda finding: -(finding.gain_nats or 0.0))


def share_of(finding: FoundEffect | UnknownEffect, findings: GapFindings) -> float:
    """How often random variation alone gains as much where nothing was fitted: Student's t over runs, or blocks.

    It is that of one effect that was fixed before: it is not corrected for how many were asked, of which this one
    explained most.
    """
    units = len(findings.training_runs) + len(findings.held_out_runs) or findings.runs
    return float(stdtr(max(units - 1, 1), -(finding.z or 0.0)))


def how_sure_of(finding: FoundEffect | UnknownEffect, findings: GapFindings) -> str:
    """How sure a finding is, in words, by its `share_of`."""
    where = "runs" if findings.runs >= rules.MIN_RUNS else "parts of a run"
    tables = of_tables(share_of(finding, findings))
    return f"random variation alone would improve the prediction of {where} that were not fitted as much in {tables}"


def is_sure(finding: FoundEffect | UnknownEffect, findings: GapFindings) -> bool:
    """Whether random variation alone gains as much in no more tables than the rate that was asked for."""
    return share_of(finding, findings) <= findings.settings.alpha


def in_words(finding: FoundEffect | UnknownEffect, findings: GapFindings) -> str:
    """What was found, with 'perhaps' where it is not sure."""
    return finding.plain if is_sure(finding, findings) else f"perhaps {finding.plain}"


def of_tables(share: float) -> str:
    """A share as a number of tables.

    Examples
    --------
    >>> of_tables(0.41), of_tables(0.00123), of_tables(1e-9)
    ('41 of 100 tables', '1 of 810 tables', 'fewer than 1 of 10,000 tables')
    """
    if share > 0.1:
        return f"{100.0 * share:.0f} of 100 tables"
    fewer = "fewer than " if share < RAREST else ""
    return f"{fewer}1 of {float(f'{1.0 / max(share, RAREST):.2g}'):,.0f} tables"


def _random_share(findings: GapFindings) -> float | None:
    """How often random variation alone shows as much as the decision rests on; None where that is not known."""
    weakest = _weakest(findings)
    if weakest is not None:
        return share_of(weakest, findings)
    if findings.verdict in NOTHING_NAMED:
        return findings.p_value
    return min((piece.p_value for piece in findings.slices if piece.p_value is not None), default=None)


def _weakest(findings: GapFindings) -> FoundEffect | UnknownEffect | None:
    return max(found_parts(findings), key=lambda finding: share_of(finding, findings), default=None)


def _how_sure(findings: GapFindings) -> str:
    share, weakest = findings.random_share, _weakest(findings)
    if share is None:
        return ""
    if weakest is not None:
        of_which = f" ({finding_label(weakest)} is the weakest)" * (len(found_parts(findings)) > 1)
        return how_sure_of(weakest, findings) + of_which
    if findings.verdict in NOTHING_NAMED:
        unseen = f"; a gap below {short(findings.nats.noise_floor)} nats per reading would not be seen"
        model = "refitted model" if findings.verdict == "absorbed" else "model"
        return f"random variation alone would differ from the {model} as much in {of_tables(share)}{unseen}"
    return f"random variation alone would make some slice of context differ as much in {of_tables(share)}"


def _decision(findings: GapFindings) -> str:
    if parts := found_parts(findings):
        plain = [in_words(finding, findings) for finding in parts]
        more = len(parts) - MOST_IN_SENTENCE
        others = f", and there {'is 1 more finding' if more == 1 else f'are {more} more findings'}" * (more > 0)
        return capitalised(and_list(plain[:MOST_IN_SENTENCE])) + others + _share_of_gap(findings)
    suggested = f"; it may be that {and_list([effect.plain for effect in findings.effects])}" * bool(findings.effects)
    match findings.verdict:
        case None:
            return _compared(findings)
        case "nothing missing" if findings.random_share is not None and findings.random_share < rules.SLICE_P:
            own = [number_label(number.name) for number in findings.refitted if number.name.startswith("effects.")]
            what = f"{and_list(own)}, too little to matter" if own else "something, too small to have a name"
            text = f"The model is close enough: it may lack {what}"
        case "nothing missing":
            text = "Nothing is missing: readings and model agree as far as these data can tell"
        case "undecided":
            text = "These readings are too few to decide whether something is missing"
        case "absorbed":
            text = _absorbed(findings)
        case _ if left := what_is_left(findings):
            text = f"Readings and model disagree: {left}, and nothing that is recorded says why"
        case _:
            text = "Readings and model disagree, and no effect of the catalogue explains it"
    return text + suggested


def _share_of_gap(findings: GapFindings) -> str:
    if findings.verdict is None:
        return ""
    is_ = "is" if all(is_sure(finding, findings) for finding in found_parts(findings)) else "would be"
    if findings.verdict == "improved":
        return "; the model was close enough without it"
    if findings.verdict == "explained":
        # Random variation may hide what would not count as closed, or be what is left.
        hides = (findings.nats.noise_floor or 0.0) > rules.CLOSED_MAX_NATS or _is_left(findings)
        seen = " that these readings can show" * hides
        return f"; that {is_} all of the disagreement{seen}"
    before, after, left = findings.nats.before or 1.0, findings.nats.after or 0.0, what_is_left(findings)
    percent = 100.0 * (1.0 - after / before)
    if percent < 1.0:
        return f"; {f'most of the disagreement is that {left}' if left else NOT_SMALLER}"
    only = "only " * (findings.verdict == "unexplained")
    # The base's numbers were refitted with what was found, and a part of it is theirs.
    refitted = "with the refitted numbers " * bool(findings.refitted)
    share = f"{only}{min(percent, 99.0):.0f} % of the disagreement"
    return f"; {refitted}that {is_} {share}, and the rest is {f'that {left}' if left else 'not explained'}"


def _is_left(findings: GapFindings) -> bool:
    """Whether some measure is still beyond its noise floor."""
    return findings.gap is not None and any(getattr(findings.gap, key).is_beyond_floor for key in NO_GAP)


def _absorbed(findings: GapFindings) -> str:
    numbers = [number_label(number.name) for number in findings.refitted]
    text = f"The disagreement is absorbed in {and_list(numbers) if numbers else 'the numbers of the base model'}"
    if not findings.causes:
        return f"{text}; no recorded column says why"
    cause = findings.causes[0]
    why = "did not vary enough to say why" if cause.recorded else "was not recorded and might say why"
    return f"{text}; {name_of(cause.column)} {why}"


def _compared(findings: GapFindings) -> str:
    """Before anything was added: whether readings and model disagree, on the whole and where most."""
    if findings.random_share is None or findings.random_share > rules.SLICE_P:
        return "Readings and model agree as far as random variation lets them"
    worst = next((piece for piece in findings.slices if piece.variables), None)
    off = findings.gap is not None and any(getattr(findings.gap, key).was_beyond_floor for key in NO_GAP)
    if worst is None:
        where = "disagree"
    else:
        where = ("disagree, most where " if off else "agree on the whole, but not where ") + slice_label(worst.where)
    name = "what is missing is not named yet" if findings.p_value is None else "no effect of the catalogue explains it"
    return f"Readings and model {where}; {name}"


def _next_step(findings: GapFindings) -> str:
    """The one thing to do first: about what the decision leaves open, or else to fly."""
    verdict, weakest = findings.verdict, _weakest(findings)
    if verdict is None:
        if findings.effects or findings.unknown:
            return "msp-lab add DIR adds it and measures what is left"
        if findings.p_value is not None:
            return "msp-lab add DIR measures what is left once the model's own numbers are refitted"
        return "msp-lab name DIR looks for what is missing"
    if any(_is_ahead(effect) and is_sure(effect, findings) for effect in findings.confirmed):
        return "shift time_s of the reference, and compare again: no sensor is ahead of it"
    bias = Measure(None) if findings.gap is None else findings.gap.bias_cm
    if verdict in STILL_OPEN and bias.is_beyond_floor and bias.has_grown:
        return f"find out why the bias grew to {short(bias.after)} cm before you fly with this model"
    if weakest is not None and not is_sure(weakest, findings):
        return f"record more runs like these: {finding_label(weakest)} is not sure yet"
    for finding in found_parts(findings):
        if isinstance(finding, UnknownEffect):
            return _next_of_unknown(finding)
        if finding.name == RUN_OFFSETS.name and finding.alternatives:
            columns = " or ".join(name_of(other.name) for other in finding.alternatives)
            return f"record more runs that differ in {columns} alone"
        if finding.verdict == "indistinguishable":
            return f"msp-lab design DIR plans the session that decides: {finding_label(finding)}"
    match verdict:
        case "explained" | "improved" if findings.runs < rules.MIN_RUNS:
            return f"record {rules.MIN_RUNS} runs or more, so that runs that were not fitted can confirm it"
        case "explained" | "improved":
            return "fly model.yaml (msp-sim fly SCENARIO.yaml --model DIR/model.yaml)"
        case "nothing missing":
            return "fly the model as it is; report.html lists the smallest effects that these readings would have shown"
        case "undecided":
            times = math.ceil(rules.NOISE_FLOOR_FACTOR * (findings.nats.noise_floor or 0.0) / rules.CLOSED_MAX_NATS)
            return f"record about {max(times, 2)} times as many readings, in as many more runs"
        case "absorbed" if findings.causes:
            cause = findings.causes[0]
            return f"to see whether it is {effect_label(cause.effect, None)}: {cause.experiment}"
        case "absorbed":
            return "record more context (throttle, temperature, tilt)"
    for effect in findings.effects:
        if effect.verdict == "suggested":
            return f"to decide whether {effect.plain} ({effect.doubt}): {effect.experiment}"
    if what_is_left(findings):
        return next_of_runs(findings)
    return own_number(findings) or likely_column(findings) or "look at the slices that are still off in report.html"


def _is_ahead(effect: FoundEffect) -> bool:
    """Whether readings come before the reference: a fault of its clock, with which nobody should fly."""
    delay = effect.parameters.get("delay_ms") if effect.name == LATENCY.name else None
    return delay is not None and delay.value < 0.0


def _next_of_unknown(unknown: UnknownEffect) -> str:
    if unknown.likely_causes:
        name, column = unknown.likely_causes[0]
        over = and_list([name_of(one) for one in unknown.variables])
        return f"record {column}: {effect_label(name, None)} needs it and depends on the same {over}, a likely cause"
    return "look at its curve in report.html; if you know the physics, write it as an effect (docs/developing.md)"


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
    if unknown.channel == "bias":
        unit = f"{digits(size)} cm"
    else:
        times = math.exp(size)
        unit = "at least " * (times > MOST_TIMES) + f"a factor of {digits(min(times, MOST_TIMES))}"
    if unknown.period is not None:
        period = f"{unknown.period:.3g} {unit_of(unknown.variables[0])}"
        return f"{what} goes up and down by {unit} with every {period} of {over}, in an unknown way"
    return f"{what} changes by {unit} over the {over} in an unknown way"


def _from_to(measure: Measure, unit: str) -> str:
    """A measure before and after, where it changed, with its noise floor."""
    before, after, floor = (short(value, "?") for value in (measure.before, measure.after, measure.noise_floor))
    changed = f" to {after}" * (measure.after is not None and after != before)
    return f"{before}{changed} {unit}".rstrip() + f" (noise floor {floor})" * (measure.noise_floor is not None)
