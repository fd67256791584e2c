"""``msp-lab design``: from the folder of a gap run to sessions that decide what it left open.

It writes a folder for each session, with its campaign and scenario files and a picture, and ``design.json``.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from msp_lab.design.answers import OldReadings, fit_answers
from msp_lab.design.bench import BenchSessions
from msp_lab.design.choose import Decision, Design, SessionPlace, cheapest
from msp_lab.design.flight import Pilot
from msp_lab.design.proof import Proof, prove, with_old
from msp_lab.design.questions import OpenQuestion, open_questions
from msp_lab.gap.findings import GapFindings
from msp_lab.gap.findings_file import read_findings
from msp_lab.gap.problem import Progress
from msp_lab.gap.steps import Steps
from msp_range.clock import Clock
from msp_range.config import load_airframe
from msp_range.yaml_file import ConfigError, config_path

NAME = "[a-z][a-z0-9_]{0,31}"
"""Names that a sensor of a campaign can have."""
LENGTHENED = 1.5
"""Where the simulated sessions keep the promise less often, the session gets so many times the readings, once."""


@dataclass(frozen=True)
class Options:
    """What a user asks of a design."""

    bench: bool | None
    """Only at the bench, or only in flight; None: whichever is cheaper."""
    max_minutes: float
    """No session may take longer."""
    power: float
    """Probability that the right answer is named."""
    sessions: int
    """Simulated sessions; 0: none."""
    seed: int
    """Seed of all draws."""
    airframe: str
    """Airframe of the vehicle that flies."""


@dataclass(frozen=True)
class Plan:
    """A design with its proof."""

    design: Design
    """Design for one question."""
    proof: Proof | None = None
    """None where there is no session, or none was simulated."""
    joined: bool = True
    """The session's readings go in with the old ones; otherwise they are compared alone."""


def plan_sessions(folder: Path, options: Options, clock: Clock, report: Progress) -> tuple[GapFindings, list[Plan]]:
    """A plan for each question that a gap run left open, and the findings of the run.

    Raises
    ------
    ConfigError
        There is nothing to decide, or the run's files are gone or have changed.
    """
    findings = read_findings(folder)
    questions = open_questions(findings, folder)
    old = OldReadings.load(Steps(folder, clock, report))
    plans = []
    for number, question in enumerate(questions):

        def part(what: str, share: float, done: int = number) -> None:
            report(what, (done + share) / len(questions))

        plans.append(_plan(old, question, _places(old, question, options), options, part))
    return findings, plans


def _places(old: OldReadings, question: OpenQuestion, options: Options) -> list[SessionPlace]:
    places: list[SessionPlace] = []
    if options.bench is not False and old.model.sensor.driver != "none":
        file = config_path(old.comparison.settings.model, "sensors").resolve()
        places.append(BenchSessions(file, old.model.sensor, _sensors(old, question)))
    if not options.bench:
        file = config_path(options.airframe, "").resolve()
        places.append(Pilot(file, load_airframe(file)))
    if not places:
        raise ConfigError("--bench: the model says driver: none, so that no bench can read the sensor; give --flight")
    return places


def _sensors(old: OldReadings, question: OpenQuestion) -> tuple[str, ...]:
    """The sensors of the old readings where an answer is about one of them, two for neighbours, else the first."""
    names = np.unique(old.columns["sensor"]).tolist() if "sensor" in old.columns else []
    names = [name for name in names if re.fullmatch(NAME, name)] or ["sensor_1"]
    if "neighbour_lag_ms" in question.columns and len(names) < 2:
        names.append("neighbour")
    return tuple(names if "sensor" in question.columns else names[: 2 if "neighbour_lag_ms" in question.columns else 1])


def _plan(
    old: OldReadings, question: OpenQuestion, places: Sequence[SessionPlace], options: Options, report: Progress
) -> Plan:
    rng = np.random.default_rng([options.seed, 0])
    answers = fit_answers(old, question)
    old_runs = old.runs if with_old(old, answers, 0) else 0
    decision = Decision(question, tuple(answers), old.model, options.power, old.run_offset_cm, old_runs, rng)
    design = cheapest(decision, places, options.max_minutes, lambda what, share: report(what, 0.4 * share))
    if design.session is None:
        return Plan(design)
    joined = with_old(old, answers, design.session.readings)
    if not options.sessions:
        return Plan(design, joined=joined)

    def proof_of(design: Design) -> Proof:
        return prove(
            old, design, joined, options.sessions, options.seed, lambda what, share: report(what, 0.4 + 0.6 * share)
        )

    proof = proof_of(design)
    if proof.right < options.power * proof.held:
        longer = design.longer(LENGTHENED)
        if longer.session is not None and longer.session.minutes <= options.max_minutes:
            design, proof = longer, proof_of(longer)
    return Plan(design, proof, joined)
