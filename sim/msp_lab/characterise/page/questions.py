"""The questions (does it matter?) as one picture, and every effect as a table."""

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.draw.questions import draw_questions
from msp_lab.characterise.page.picture_data import Absent, Drawn, PictureData
from msp_lab.characterise.page.text import interval, sentence
from msp_lab.characterise.question_findings import FactorEffect, Question
from msp_lab.characterise.questions import SHARE_BOUND
from msp_sim.page.page import PageTable
from msp_sim.page.style import p_text

QUESTION_NAMES = {
    "material": "material",
    "temperature": "temperature",
    "vibration": "vibration",
    "crosstalk_simultaneous": "pings at once",
    "crosstalk_sequential": "pings in turn",
    "external_interference": "external ultrasound",
}
"""Names of the questions as a picture has room for."""

METRICS = {
    "bias": "mean error, difference",
    "spread": "spread, ratio",
    "missed": "missed, odds ratio",
    "outliers": "outliers, odds ratio",
}


def forest(findings: Findings, rows: PictureData) -> Drawn:
    """The questions as a forest plot."""
    shown = [
        (_label(each), [(effect, effect.estimate) for effect in each.effects if effect.estimate is not None])
        for each in findings.questions
    ]
    if not any(effects for _, effects in shown):
        raise Absent(sentence(findings.absent.get("questions", "the data compare no two settings of the bench")))
    caption = (
        "Each line is an effect with its 95 % interval; grey ground is what would be too small to matter, the black "
        "bars the smallest effect that these data would have shown in 80 % of cases. Verdicts are corrected for the "
        f"number of questions (Holm). Missed readings and outliers that change by less than {SHARE_BOUND:.0%} of all "
        "readings also count as too small, whatever their odds. No bars: unknown. An arrow: the interval is longer."
    )
    return Drawn(draw_questions(shown), caption, "Effect sizes of every question with their intervals.")


def _label(question: Question) -> str:
    name = QUESTION_NAMES.get(question.name, question.name)
    level = f"\n{question.level} against {question.reference}" if question.level else ""
    sensor = f", {question.sensor}" if question.sensor else ""
    return f"{name}{sensor}{level}"


def effects_table(findings: Findings) -> PageTable | None:
    """Every effect of every question; None where none was asked."""
    rows = []
    for question in findings.questions:
        subject = f"{question.name.replace('_', ' ')}: {question.level} against {question.reference}"
        if question.sensor:
            subject += f" ({question.sensor})"
        for effect in question.effects:
            rows.append((subject, METRICS[effect.metric], effect.verdict, *_numbers(effect)))
            subject = ""
    if not rows:
        return None
    return PageTable(
        name="effects",
        title="Every effect",
        header=(
            "question",
            "property",
            "verdict",
            "effect, 95 % interval",
            "small enough",
            "smallest detectable",
            "p, adjusted",
        ),
        rows=tuple(rows),
        caption=(
            "No effect is a difference of 0 or a ratio of 1. p is adjusted by Holm over all effects. 'Matters': there "
            "is an effect by it, and it may be larger than what is small enough. 'Does not matter': the 90 % interval "
            "lies within that (two one-sided tests), or missed readings and outliers change by less than "
            f"{SHARE_BOUND:.0%} of all readings. Smallest detectable: in 80 % of cases, at the adjusted level."
        ),
        words=3,
    )


def _numbers(effect: FactorEffect) -> tuple[str, ...]:
    is_ratio = effect.metric != "bias"
    bound = f"{1.0 / effect.bound:.2g} to {effect.bound:.3g}" if is_ratio else f"±{effect.bound:.2g} cm"
    smallest = effect.smallest_detectable
    return (
        "–" if effect.estimate is None else interval(effect.estimate),
        bound,
        "–" if smallest is None else f"{smallest:.2g}" if is_ratio else f"±{smallest:.2g} cm",
        "–" if effect.p_adjusted is None else p_text(effect.p_adjusted),
    )
