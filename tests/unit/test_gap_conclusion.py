"""Decision, number and next step of a gap agree in every outcome, and terminal, page and file have no others."""

import html
import itertools
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest
from scipy.stats import t

from msp_lab.gap.before_after import later_steps
from msp_lab.gap.conclusion import of_tables, with_words
from msp_lab.gap.findings import (
    Alternative,
    CalibrationFinding,
    FittedValue,
    FoundEffect,
    Gap,
    GapFindings,
    Measure,
    NotTestable,
    OddsMeasures,
    PathStep,
    ReadingAge,
    RunScatter,
    Slice,
    UnknownEffect,
    Verdict,
)
from msp_lab.gap.findings_file import as_json, from_json
from msp_lab.gap.terminal import print_findings
from msp_lab.gap.verdict import verdict
from msp_sim.model.model import load_model
from tests.support.known import known
from tests.support.measured import MODEL
from tests.unit.test_gap_page import page_of

ONE = Measure(1.0, 1.0, 1.1)
GIVEN = load_model(MODEL)
SURE, WEAK = 9.0, 0.8
"""Standard errors of a gain: of one that is there, and of one that random variation makes in a fifth of tables."""


def gap(before: float, after: float, floor: float) -> Gap:
    return Gap(Measure(before, after, floor), Measure(0.05, 0.05, 0.06), ONE, OddsMeasures(ONE, ONE, ONE, ONE))


def scale(z: float = SURE) -> FoundEffect:
    return FoundEffect("air_temperature", "named", {}, 0.2, z, experiment="a cold day", plain="")


def curve(z: float = SURE) -> UnknownEffect:
    return UnknownEffect("bias", ("throttle",), "1.2 throttle", 0.1, ((0.0, 0.0, 0.0, 0.0), (1.0, 1.2, 1.0, 1.4)), z=z)


OTHERS = replace(scale(), verdict="indistinguishable", alternatives=(Alternative("bend", 1.0),))
DOUBTED = replace(scale(), verdict="suggested", doubt="share may be 0")
PATH = (PathStep("", 0.5, -3.0),)
SLICE = Slice("throttle 0.5 to 1", ("throttle",), 99, *(0.1,) * 11, "bias", 4.0, 0.002)
FOUND: dict[str, tuple[tuple[FoundEffect, ...], tuple[UnknownEffect, ...]]] = {
    "nothing": ((), ()),
    "one": ((scale(),), ()),
    "a weak one": ((scale(WEAK),), ()),
    "one and a weak one": ((scale(), replace(scale(WEAK), name="latency")), ()),
    "alternatives": ((OTHERS,), ()),
    "a suggestion": ((DOUBTED,), ()),
    "a curve": ((), (curve(),)),
    "a weak curve": ((), (curve(WEAK),)),
    "one and a curve": ((scale(),), (curve(),)),
}
GAPS = {
    "closed before": gap(0.002, 0.001, 0.004),
    "closed after": gap(0.5, 0.004, 0.004),
    "hidden": gap(0.21, 0.16, 0.36),
    "left": gap(0.5, 0.2, 0.01),
    "the same": gap(0.5, 0.5, 0.01),
    "larger": replace(gap(0.5, 0.5, 0.01), bias_cm=Measure(0.05, 3.0, 0.06)),
}


def outcomes() -> Iterator[GapFindings]:
    for (effects, unknown), (what, measured), runs, p in itertools.product(
        FOUND.values(), GAPS.items(), (1, 12), (0.41, 0.02, 1e-6)
    ):
        # Blocks stand in for few runs.
        units = tuple(f"unit {k}" for k in range(60 if runs == 1 else runs))
        content = GapFindings(None, 2000, runs, measured, effects, unknown, slices=(SLICE,), p_value=p)
        content = replace(content, training_runs=units, selection_path=PATH)
        yield with_words(replace(content, verdict=verdict(content, GIVEN)))
        if what == "left":
            yield with_words(content)


OUTCOMES = [*outcomes()]


def z_of(each: FoundEffect | UnknownEffect) -> float:
    return known(each.z)


def test_the_outcomes_have_every_verdict() -> None:
    assert {each.verdict for each in OUTCOMES} == {None, *get_args(Verdict)}


@pytest.mark.parametrize("found", OUTCOMES, ids=lambda each: each.sentence[:50])
def test_decision_number_and_next_step_agree(found: GapFindings) -> None:
    named: list[FoundEffect | UnknownEffect] = [*found.confirmed, *found.unknown]
    alpha, sentence, step = found.settings.alpha, found.sentence, found.next_step
    assert found.random_share is not None
    assert of_tables(found.random_share) in found.how_sure
    weak = bool(named) and found.random_share > alpha
    assert ("erhaps" in sentence) == weak
    flies = step.startswith("fly ")
    if named:
        # The number is that of the weakest finding, by Student's t, and never that of another test.
        weakest = max(float(t.sf(z_of(each), len(found.training_runs) - 1)) for each in named)
        assert found.random_share == pytest.approx(weakest)
        assert not sentence.startswith(("Nothing", "The model is", "Readings and model"))
        assert not (weak and flies)
        assert not (flies and (found.unknown or any(each.alternatives for each in found.confirmed)))
        assert not (flies and found.runs < 4)
    elif found.verdict == "nothing missing":
        assert sentence.startswith("Nothing is missing") == (found.random_share >= 0.05)
        assert flies
    else:
        assert not flies
    if named and found.verdict in ("explained", "improved"):
        assert "%" not in sentence
        assert "not explained" not in sentence
        assert (found.verdict == "explained") == ("all of the disagreement" in sentence)
    if found.verdict in ("partly explained", "unexplained"):
        assert not flies
        assert "all of" not in sentence
    if found.verdict == "undecided":
        assert "too few" in sentence
        assert re.match(r"record about \d+ times as many readings", step)
    # One of each: the lines repeat them, and the file holds them.
    assert found.summary[:2] == (f"How sure: {found.how_sure}", f"Next: {step}")
    assert from_json(as_json(found)).next_step == step
    assert with_words(found) == found


@pytest.mark.parametrize("found", OUTCOMES[::7], ids=lambda each: each.sentence[:50])
def test_the_terminal_has_one_decision_one_number_and_one_next_step(
    found: GapFindings, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    print_findings(found)
    text = " ".join(capsys.readouterr().out.split())
    assert text.startswith(f"{found.sentence} How sure: {found.how_sure} Next: {found.next_step} ")
    assert len(re.findall(r"\d tables|of the splits|p-value", text)) == 1
    assert len(re.findall(r"[Nn]ext\b", text)) == 1


@pytest.mark.parametrize("measured", [[SURE, WEAK], []], ids=["one and a weak one", "nothing"])
def test_the_page_has_the_same_three(measured: list[float], tmp_path: Path) -> None:
    found = next(
        each
        for each in OUTCOMES
        if [one.z for one in each.effects] == measured and not each.unknown and each.verdict is not None
    )
    text = page_of(found, tmp_path)
    title = re.search(r"<title>(.*?)</title>", (tmp_path / "report.html").read_text(encoding="utf-8"))
    assert title is not None
    assert html.unescape(title[1]) == found.sentence
    assert f"{found.sentence} " in text
    assert text.count(f"How sure: {found.how_sure}.") == text.count(f"Next: {found.next_step}.") == 1
    assert "What to do next" not in text
    assert "of the splits of the runs" not in text
    # Each finding has its own number; the first line has that of the weakest.
    assert text.count(of_tables(found.random_share or 0.0)) == (2 if found.effects else 1)


def test_a_named_effect_is_as_sure_as_its_own_gain_says() -> None:
    """Not as the first test of all effects at once, which a table of dependent runs may pass."""
    found = replace(GapFindings(None, 900, 12, gap(0.21, 0.16, 0.36), (scale(),), p_value=0.41), seconds=1.0)
    said = with_words(replace(found, verdict=verdict(found, GIVEN)))
    assert said.sentence.endswith("; that is all of the disagreement that these readings can show.")
    assert said.how_sure.endswith("in fewer than 1 of 10,000 tables")


def test_one_run_is_no_other_run() -> None:
    blocks = tuple(f"all#{k:02d}" for k in range(60))
    said = with_words(GapFindings("explained", 900, 1, GAPS["closed after"], (scale(),), training_runs=blocks))
    assert "of parts of a run that were not fitted" in said.how_sure
    assert said.next_step.startswith("record 4 runs or more")


def test_what_is_likely_is_to_be_recorded_and_not_what_is_absent() -> None:
    """The scatter is off, in one run more: vibration changes it, and neither a hot target nor the warm-up does."""
    absent = (
        NotTestable("hot_box", ("target_temperature_c",)),
        NotTestable("warm_up", ("uptime_s",)),
        NotTestable("vibration", ("vibration_hz",)),
    )
    scattered = replace(gap(0.5, 0.5, 0.01), spread_ratio=Measure(1.6, 1.6, 1.1))
    shaken = replace(SLICE, where="run 7", variables=("run",), after={"log_spread": 0.9})
    for slices, columns, step in (
        ((shaken,), absent, "record vibration_hz: vibration would need it, and may be what is left"),
        ((shaken,), absent[:2], "look at the slices that are still off in report.html"),
        ((replace(shaken, after={"log_spread": 0.2}),), absent, "look at the slices that are still off in report.html"),
    ):
        said = with_words(GapFindings("unexplained", 2000, 12, scattered, slices=slices, not_testable=columns))
        assert said.next_step == step


def test_a_number_that_is_off_alike_everywhere_is_the_model_s_own() -> None:
    """A refit of few readings has not come so far; a column that nobody recorded makes no scatter smaller."""
    less = replace(gap(0.7, 0.2, 0.01), spread_ratio=Measure(7.1, 3.1, 1.1))
    whole = replace(SLICE, where="all readings", variables=(), after={"log_spread": -0.95})
    parts = [replace(SLICE, where=f"run {k}", variables=("run",), after={"log_spread": -0.9}) for k in range(3)]
    tilted = NotTestable("spread_with_incidence", ("incidence_deg",))
    said = with_words(GapFindings("unexplained", 200, 12, less, slices=(whole, *parts), not_testable=(tilted,)))
    assert said.next_step == (
        "make the model's own numbers of more such readings (msp-lab characterise): scatter (sigma) is off everywhere"
    )


APART = replace(gap(0.05, 0.05, 0.01), bias_cm=Measure(0.3, 0.3, 0.1))


@pytest.mark.parametrize(
    ("scatter", "effects", "sentence", "step"),
    [
        (
            RunScatter(0.2, False),
            (),
            "disagree: runs differ from each other by 0.2 cm, and nothing that is recorded says why.",
            "look at what was different in may (+0.6 cm) and june (-0.5 cm)",
        ),
        (
            RunScatter(0.2, True),
            (),
            "disagree: readings wander by 0.2 cm in the course of a run, and nothing that is recorded says why.",
            "log a fixed target for as long as a run: it shows whether readings wander by themselves",
        ),
        (
            RunScatter(0.2, False),
            (scale(),),
            "; most of the disagreement is that runs differ from each other by 0.2 cm.",
            "look at what was different in",
        ),
        (
            RunScatter(0.2, False),
            (scale(), replace(scale(), name="run_offsets")),
            "; most of the disagreement is that the runs on which it is measured differ by more, 0.3 cm.",
            "look at what was different in",
        ),
        (
            RunScatter(0.1, False),
            (),
            "Readings and model disagree, and no effect of the catalogue explains it.",
            "record air_temperature_c",
        ),
    ],
    ids=["runs", "a wander", "next to an effect", "offsets named", "too little"],
)
def test_that_runs_differ_is_said_where_it_is_what_is_left(
    scatter: RunScatter, effects: tuple[FoundEffect, ...], sentence: str, step: str
) -> None:
    off = {"run may": 0.6, "run june": -0.5, "run july": 0.2, "true_range_cm 40 to 50": 0.4}
    slices = tuple(
        replace(SLICE, where=where, variables=(where.split()[0],), after={"bias_cm": cm}) for where, cm in off.items()
    )
    warm = NotTestable("air_temperature", ("air_temperature_c",))
    said = with_words(
        GapFindings("unexplained", 2000, 12, APART, effects, slices=slices, not_testable=(warm,), run_scatter=scatter)
    )
    assert said.sentence.endswith(sentence)
    assert said.next_step.startswith(step)


def test_a_column_is_likely_only_if_readings_differ_over_what_else_its_effects_need() -> None:
    hot = NotTestable("hot_box", ("target_temperature_c",))
    biased = replace(gap(0.5, 0.5, 0.01), bias_cm=Measure(1.0, 1.0, 0.1))
    far = replace(SLICE, variables=("true_range_cm",), after={"bias_cm": 1.0})
    warm = replace(far, variables=("air_temperature_c",))
    for piece, step in (
        (SLICE, "look at"),
        (warm, "record target"),
        (replace(warm, after={"bias_cm": 0.2}), "look at"),
    ):
        said = with_words(GapFindings("unexplained", 2000, 12, biased, slices=(far, piece), not_testable=(hot,)))
        assert said.next_step.startswith(step)


def test_where_a_column_may_be_what_runs_differ_by_more_runs_decide() -> None:
    offsets = replace(
        OTHERS, name="run_offsets", alternatives=(Alternative("battery", -1.0), Alternative("fin_c", 2.0))
    )
    said = with_words(GapFindings("explained", 2000, 12, GAPS["closed after"], (offsets,)))
    assert said.next_step == "record more runs that differ in battery or fin alone"
    assert "or it is battery or fin)" in said.effects[0].plain


WITHIN = replace(gap(0.05, 0.05, 0.4), nats_per_reading=Measure(0.05, None, 0.4), bias_cm=Measure(0.01, None, 0.06))


@pytest.mark.parametrize(
    ("measured", "p_value", "sentence", "step"),
    [
        (
            GAPS["left"],
            None,
            "disagree, most where throttle 0.5 to 1; what is missing is not named yet.",
            "name DIR looks",
        ),
        (GAPS["left"], 0.4, "disagree, most where throttle 0.5 to 1; no effect of the catalogue", "add DIR measures"),
        (WITHIN, 0.4, "agree on the whole, but not where throttle 0.5 to 1; no effect", "add DIR measures"),
    ],
)
def test_no_command_is_next_that_has_found_nothing(
    measured: Gap, p_value: float | None, sentence: str, step: str
) -> None:
    said = with_words(GapFindings(None, 2000, 12, measured, slices=(SLICE,), p_value=p_value))
    assert said.sentence.startswith(f"Readings and model {sentence}")
    assert said.next_step.startswith(f"msp-lab {step}")


@pytest.mark.parametrize(("low", "has_grown"), [(0.4, True), (0.3, False), (None, True)])
def test_a_bias_has_grown_if_its_interval_says_so(low: float | None, has_grown: bool) -> None:
    measured = replace(gap(0.3, 0.11, 0.045), bias_cm=Measure(0.34, 0.45, 0.17, low, 0.5))
    said = with_words(GapFindings("unexplained", 2000, 12, measured, slices=(SLICE,)))
    assert ("bias grew" in said.next_step) == has_grown


@pytest.mark.parametrize(
    ("delay_ms", "z", "step"), [(-140.0, SURE, "shift"), (-5.0, WEAK, "record"), (90.0, SURE, "fly")]
)
def test_nobody_flies_with_readings_that_are_ahead_of_the_reference(delay_ms: float, z: float, step: str) -> None:
    delay = FittedValue(delay_ms, delay_ms - 3.0, delay_ms + 3.0, "ms")
    late = replace(scale(z), name="latency", parameters={"delay_ms": delay})
    said = with_words(GapFindings("explained", 2000, 12, GAPS["closed after"], (late,), age=ReadingAge(-0.14, 0.01)))
    assert said.next_step.startswith(step)
    assert not any("old" in each for each in said.summary)


def test_what_was_refitted_has_its_part_and_its_name() -> None:
    tails = CalibrationFinding("effects.heavy_tails", "", 0.0, 0.2, 0.1, 0.3)
    said = with_words(GapFindings("partly explained", 2000, 12, GAPS["left"], (scale(),), calibration=(tails,)))
    assert said.sentence.endswith(
        "; with the refitted numbers that is 60 % of the disagreement, and the rest is not explained."
    )
    said = with_words(
        GapFindings("nothing missing", 2000, 12, GAPS["closed before"], calibration=(tails,), p_value=5e-4)
    )
    assert said.sentence == "The model is close enough: it may lack heavy tails, too little to matter."
    step = CalibrationFinding("resolution", "steps of 0.1 cm", 1.0, 0.1)
    said = with_words(GapFindings("partly explained", 2000, 12, GAPS["left"], (scale(),), calibration=(step,)))
    assert "refitted" not in said.sentence.lower() + " ".join(said.summary).lower()


def test_one_effect_is_not_effects(capsys: pytest.CaptureFixture[str]) -> None:
    print_findings(with_words(GapFindings("explained", 9, 5, not_testable=(NotTestable("warm_up", ("uptime_s",)),))))
    assert "one effect cannot be tested without uptime_s" in capsys.readouterr().out


def test_step_and_codes_are_said_on_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    of_readings = (
        CalibrationFinding("resolution", "the readings are compared in steps of 0.5 cm", before=0.1, after=0.5),
        CalibrationFinding("code", "0 cm comes in 3 % of the readings"),
    )
    weight = CalibrationFinding("weights.hit", "weights.hit is another one")
    print_findings(GapFindings("explained", 9, 5, calibration=(*of_readings, weight), messages=("A message.",)))
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("note: ")] == [
        "note: A message.",
        "note: The readings are compared in steps of 0.5 cm.",
        "note: 0 cm comes in 3 % of the readings.",
    ]


def test_what_is_not_sure_is_perhaps_everywhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    weak = with_words(
        GapFindings("explained", 2000, 12, GAPS["closed after"], (scale(WEAK),), (curve(WEAK),), selection_path=PATH)
    )
    print_findings(weak)
    table = " ".join(capsys.readouterr().out.partition("experiment")[2].split())
    text = page_of(weak, tmp_path).partition("What is missing")[2]
    assert table.count("perhaps") == text.count("Perhaps") == 2
    assert 'class="mark no"' not in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_no_step_has_a_larger_gap_than_the_given_model() -> None:
    """Slices may show less than a score: repeated readings have the right error in each of them."""
    steps = [*later_steps(0.058, 0.01, [("calibration", -3.0), ("stale", -2.9), ("latency", -2.8)])]
    assert [each.nats_per_reading for each in steps] == pytest.approx([0.058, 0.058, 0.01])
    steps = [*later_steps(0.5, 0.01, [("calibration", -3.0), ("stale", -2.9), ("latency", -2.8)])]
    assert [each.nats_per_reading for each in steps] == pytest.approx([0.21, 0.11, 0.01])


def test_what_the_base_absorbs_is_as_sure_as_the_test_for_more() -> None:
    number = CalibrationFinding("sigma_cm", "", 1.9, 2.4, 2.3, 2.5, "cm")
    said = with_words(GapFindings("absorbed", 2000, 12, gap(0.5, 0.004, 0.004), calibration=(number,), p_value=0.3))
    assert "differ from the refitted model as much in 30 of 100 tables" in said.how_sure
