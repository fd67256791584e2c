"""Blind cases of `msp-lab design`, by the commands and files that a user has.

A folder and a case's number enter; what was promised, and what the session's readings then said, leave.
"""

import json
import shlex
import shutil
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import yaml

from evaluation.design.oracle import PLACED_CM, decidable_nats
from evaluation.design.pairs import Columns, Hidden, draw_case, with_readings
from evaluation.product import command
from evaluation.runner import Row
from msp_range.recording.csv_form import read_csv, write_csv
from tests.support.measured import MODEL


@dataclass(frozen=True)
class Outcome:
    """What became of one question of a case."""

    number: int
    pair: str
    hidden: str
    size: float
    """The case."""
    outcome: str
    """right, wrong: of a session that promised the power; not promised: a session that did not; same: no session; no
    question: the gap run left nothing open; not asked: the truth is none of the answers; crash."""
    promised: float = 0.0
    """Expected power of the session."""
    detail: str = ""
    """What was found, or why there is no session."""
    minutes: float = 0.0
    """Of the session."""
    decidable_nats: float = 0.0
    """By which the other effect of the pair fails in an experiment that a person would do; of a question about the pair
    that has no session."""
    about_pair: bool = True
    """Whether an effect of the pair is among the question's answers. Other questions ask for what was not recorded."""


def run_case(folder: Path, seed: int, number: int, power: float = 0.95, sessions: int = 0) -> Row:
    """Draw a case, run `gap` and `design`, hold each session, and run `gap` with its readings."""
    work = folder / f"case-{seed}-{number:03d}"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    found = _run(work, seed, number, power, sessions)
    shutil.rmtree(work)
    return {"outcomes": [asdict(each) for each in found]}


def _run(work: Path, seed: int, number: int, power: float, sessions: int) -> list[Outcome]:
    pair, hidden, size, columns = draw_case(seed, number)

    def outcome(
        what: str, detail: str = "", promised: float = 0.0, minutes: float = 0.0, about: bool = True
    ) -> Outcome:
        nats = decidable_nats(pair, hidden, size) if what == "same" and about else 0.0
        return Outcome(number, pair.title, hidden.name, size, what, promised, detail, minutes, nats, about)

    model, old = work / "given.yaml", work / "old.csv"
    model.write_text(yaml.safe_dump(yaml.safe_load(MODEL.read_text()) | {"effects": []}))
    write_csv(old, columns)
    crash = command("msp-lab", "gap", old, "--model", model, "--out", work / "gap", "--until", "add")
    if crash:
        return [outcome("crash", crash)]
    crash = command("msp-lab", "design", work / "gap", "--power", power, "--sessions", sessions, "--seed", seed)
    if "nothing to decide" in crash:
        effects = json.loads((work / "gap/gap.json").read_text())["effects"]
        return [outcome("no question", ", ".join(each["name"] for each in effects))]
    if crash:
        return [outcome("crash", crash)]
    questions = json.loads((work / "gap/design/design.json").read_text())["questions"]
    named = {each.name for each in pair.effects if each.name}
    about = [any(answer["name"] in named for answer in each["answers"]) for each in questions]
    return [
        outcome(*_held(each, hidden, size, power, seed + number), about=own)
        for each, own in zip(questions, about, strict=True)
    ]


def _held(
    question: dict[str, Any], hidden: Hidden, size: float, power: float, seed: int
) -> tuple[str, str, float, float]:
    """Hold a question's session with the hidden effect, and see what the workflow says of all readings."""
    answers = [each["name"] for each in question["answers"]]
    session = question.get("session")
    same: list[str] = next((names for names in question["same"] if hidden.name.replace("_", " ") in names), [])
    alike = {name for name in answers if name and name.replace("_", " ") in same} | {hidden.name}
    if session is None:
        return "same", f"{' or '.join(map(str, answers))}: {question['no_session']}", 0.0, 0.0
    if hidden.name not in answers and None not in answers:
        return "not asked", " or ".join(answers), 0.0, 0.0
    promised, minutes = session["expected_power"], session["minutes"]
    simulated = question.get("simulated")
    keeps = simulated is None or simulated["right"] >= power * simulated["sessions"]
    collect, gap = (shlex.split(each)[1:] for each in session["commands"])
    table = Path(collect[collect.index("--out") + 1]) / "readings.csv"
    crash = command("msp-lab", *collect, "--simulate")
    if not crash:
        new: Columns = dict(read_csv(table).columns)
        drawn = with_readings(new, hidden, size, seed, PLACED_CM[session["kind"]])
        write_csv(table, drawn, replacing=True)
        crash = command("msp-lab", *gap, "--until", "name")
    if crash:
        return "crash", crash, promised, minutes
    out = Path(gap[gap.index("--out") + 1])
    effects = json.loads((out / "gap.json").read_text())["effects"]
    named = [each for each in effects if each["verdict"] != "suggested"]
    classes = [{each["name"], *(other["name"] for other in each["alternatives"])} for each in named]
    detail = ", ".join(" or ".join(sorted(each)) for each in classes) or "nothing"
    detail = f"{session['kind']}, {', '.join(session['varied'])}, {session['readings']} readings: {detail}"
    others = {name for name in answers if name} - alike
    clean = not any(each & others for each in classes)
    there = hidden.name not in answers or any(each & alike for each in classes)
    if not keeps or promised < power:
        return "not promised", detail, promised, minutes
    return "right" if clean and there else "wrong", detail, promised, minutes
