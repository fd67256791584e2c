"""The files of a design: campaign and scenario files, the picture, and all numbers.

It writes a folder for each session and ``design.json``.
"""

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from msp_lab.design.designing import Plan
from msp_lab.design.proof import Proof
from msp_lab.gap.findings import GapFindings
from msp_range.yaml_file import ConfigError
from msp_sim.terminal import make_folder

DESIGN = "design.json"
CAMPAIGN = "campaign.yaml"
PICTURE = "session.png"


def prepare_folder(out: Path, force: bool) -> None:
    """Make the folder; one with an earlier design is refused.

    Raises
    ------
    ConfigError
        There is one, and `force` is not given; or nothing can be written into the folder.
    """
    if (out / DESIGN).exists() and not force:
        raise ConfigError(f"{out}: found an earlier design; give --force to replace it, or another --out")
    make_folder(out)


def folder_of(plan: Plan, number: int, out: Path) -> Path:
    """The folder of a question's session."""
    return out / f"{number}-{plan.design.question.folder}"


def write_plans(plans: Sequence[Plan], findings: GapFindings, out: Path) -> None:
    """Write everything.

    Raises
    ------
    ConfigError
        The folder cannot be written.
    """
    from msp_lab.design.picture import draw_session
    from msp_sim.page.style import save

    for number, plan in enumerate(plans, start=1):
        session = plan.design.session
        if session is None:
            continue
        folder = folder_of(plan, number, out)
        make_folder(folder)
        heading = f"# To decide: {plan.design.question.label}. Made by msp-lab design.\n"
        scenarios = {f"{name}.yaml": scenario for name, scenario in session.scenarios.items()}
        for name, content in {CAMPAIGN: session.campaign, **scenarios}.items():
            text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=118)
            (folder / name).write_text(heading + text, encoding="utf-8")
        save(draw_session(plan.design), folder / PICTURE)
    content = {"questions": [_entry(plan, number, findings, out) for number, plan in enumerate(plans, start=1)]}
    (out / DESIGN).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


def commands(plan: Plan, number: int, findings: GapFindings, out: Path) -> tuple[str, str]:
    """The command that holds a session, and the one that puts its readings in with the old ones."""
    folder = folder_of(plan, number, out)
    settings = findings.settings
    new = folder / "readings"
    old = [source.path for source in findings.sources] if plan.joined else []
    words = ["msp-lab", "gap", *old, str(new / "readings.csv"), "--model", settings.model]
    if settings.run_column is not None and plan.joined:
        words += ["--run-column", settings.run_column]
    if plan.joined:
        words += [word for mapping in settings.map for word in ("--map", mapping)]
    words += ["--out", str(folder / "gap")]
    return shlex.join(["msp-lab", "collect", str(folder / CAMPAIGN), "--out", str(new)]), shlex.join(words)


def _entry(plan: Plan, number: int, findings: GapFindings, out: Path) -> dict[str, Any]:
    design = plan.design
    labels = [answer.answer.label for answer in design.answers]
    entry: dict[str, Any] = {
        "kind": design.question.kind,
        "answers": [{"name": answer.answer.name, "of": answer.answer.of} for answer in design.answers],
        "why": design.question.why,
        "same": [[labels[place] for place in sorted(alike)] for alike in design.classes if len(alike) > 1],
        "no_session": design.why,
    }
    session = design.session
    if session is None:
        return entry
    entry["session"] = {
        "kind": session.kind,
        "folder": str(folder_of(plan, number, out)),
        "varied": dict(session.varied),
        "minutes": round(session.minutes, 1),
        "runs": session.runs,
        "readings": session.readings,
        "expected_power": round(design.power, 4),
        "separations": [
            {
                "true": labels[separation.truth],
                "alternative": labels[separation.alternative],
                "nats": round(separation.nats(session.readings, session.runs), 2),
            }
            for separation in design.separations
        ],
        "strengths": {
            answer.answer.label: {name: float(np.round(value, 6)) for name, value in answer.terms[-1].values.items()}
            for answer in design.answers
            if answer.answer.name is not None
        },
        "commands": list(commands(plan, number, findings, out)),
    }
    if plan.proof is not None:
        entry["simulated"] = _proof_entry(plan.proof)
    return entry


def _proof_entry(proof: Proof) -> dict[str, Any]:
    low, high = proof.interval
    return {
        "right": proof.right,
        "sessions": proof.held,
        "power_low": round(low, 3),
        "power_high": round(high, 3),
        "wrong": list(proof.wrong),
    }
