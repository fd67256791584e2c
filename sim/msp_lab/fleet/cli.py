"""`msp-lab fleet`: which vehicles share which effect, which are odd ones out, and what changed over time."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from msp_range.extras import require
from msp_range.terminal import PlainConsole
from msp_range.user_errors import report_user_errors
from msp_sim.cli import Jobs, OwnEffects, Scheduler, Seed

if TYPE_CHECKING:
    from msp_lab.fleet.findings import FleetFindings

app = typer.Typer()

WIDTH = 80
"""Columns of the summary."""


@app.command("fleet")
@report_user_errors
def fleet(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="folder that 'msp-lab import' made")],
    model: Annotated[Path, typer.Option(metavar="MODEL.yaml", help="sensor model that all vehicles are compared with")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="folder for report.html, fleet.csv and fleet.json")],
    fdr: Annotated[
        float,
        typer.Option(min=0.0001, max=0.5, help="false-discovery rate: the share of the findings that may be false"),
    ] = 0.05,
    vehicle: Annotated[
        str | None,
        typer.Option(
            metavar="REGEX",
            help="what in the name of a run, or in the path of its log, is the vehicle's name, such as 'V[0-9]+'; "
            "default: the folder of the log",
        ),
    ] = None,
    seed: Seed = 1,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    effects: OwnEffects = None,
) -> None:
    """Find what the vehicles of a fleet share, which are odd ones out, and which have changed.

    DATASET is what 'msp-lab import' made of logs with a true range, one folder of logs for each vehicle:

        msp-lab import logs/*/*.BIN --truth rtk --out readings

        msp-lab fleet readings --model configs/sensors/mb1242.yaml --out fleet

    In --out: report.html with one picture, fleet.csv (every number of every sensor), fleet.json. A fleet is four
    vehicles or more. A vehicle whose readings cannot be used is left out with the reason.
    """
    require("lab", "msp-lab fleet")
    require("logs", "msp-lab fleet")
    from msp_lab.fleet.report import write_files
    from msp_lab.fleet.workflow import find_in_fleet
    from msp_range.clock import SystemClock, date_of
    from msp_sim.terminal import make_folder
    from msp_sim.workers import workers

    make_folder(out)
    if scheduler is not None:
        # Other machines have other working folders.
        dataset = dataset.resolve()
    with workers(jobs, scheduler, "msp-lab fleet") as where:
        findings = find_in_fleet(
            dataset, model, fdr=fdr, pattern=vehicle, seed=seed, date=date_of(SystemClock().utc()), where=where
        )
    console = PlainConsole(width=WIDTH)
    _print(findings, where.died, console)
    files = ", ".join(path.name for path in write_files(findings, out))
    console.print(
        f"{findings.readings:,} readings, {findings.vehicles} vehicles, {findings.sensors} sensors, "
        f"{findings.sessions} sessions; in {out}: {files}",
    )


def _print(findings: "FleetFindings", died: int, console: PlainConsole) -> None:
    from msp_lab.fleet.words import left_out_line, line_of, one_session_line
    from msp_lab.gap.labels import unit_after

    console.print(findings.sentence, style="bold")
    found = findings.effects[: findings.found]
    for effect in found:
        console.print(f"  {effect.kind}: {line_of(effect, findings)}")
        if effect.mean is not None:
            console.print(
                f"    fleet {effect.mean:.3g} ({effect.low:.3g} to {effect.high:.3g}){unit_after(effect.unit)}, "
                f"between vehicles {effect.tau:.2g}, {effect.parameter}",
                style="dim",
            )
    if findings.left_out:
        console.print(left_out_line(findings))
    if hint := one_session_line(findings):
        console.print(hint)
    if died:
        console.print(f"{died} worker processes died; their sensors were examined again.")
