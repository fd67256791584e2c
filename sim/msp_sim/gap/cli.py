"""The commands of the gap workflow, which msp-sim takes in among its own."""

from pathlib import Path
from typing import Annotated

import typer

from msp_range.cli import tell_mistakes

app = typer.Typer()

Out = Annotated[Path, typer.Option(metavar="DIR", help="folder for gap.json, model.yaml, report.html and pictures")]
OutArgument = Annotated[Path, typer.Argument(metavar="DIR", help="folder that 'msp-sim compare' or 'gap' made")]
Measured = Annotated[
    list[Path], typer.Argument(metavar="MEASURED...", help="readings with a true range (.csv) or recordings (.mcap)")
]
Reference = Annotated[Path, typer.Option("--model", metavar="MODEL.yaml", help="what the readings are held against")]
Alpha = Annotated[float, typer.Option(min=0.0001, max=0.5, help="chance of any false name, in all")]
MaxEffects = Annotated[int, typer.Option(min=0, max=20, help="at most so many effects are added")]
Seed = Annotated[int, typer.Option(min=0, help="of all chance: the same seed gives the same answer")]
RunColumn = Annotated[str | None, typer.Option(help="column that tells runs apart; left out: 'run', else the files")]
ColumnMaps = Annotated[
    list[str] | None,
    typer.Option(
        "--map", metavar="MAP", help="other column names and units: a YAML file, or NAME=COLUMN*FACTOR, repeatedly"
    ),
]


@app.command()
@tell_mistakes
def gap(
    measured: Measured,
    model: Reference,
    out: Out,
    alpha: Alpha = 0.05,
    max_effects: MaxEffects = 6,
    seed: Seed = 1,
    run_column: RunColumn = None,
    column_map: ColumnMaps = None,
) -> None:
    """Find where readings and a model disagree, name what is missing, add it, and show whether the gap closes."""
    from msp_sim.gap.commands import Steps
    from msp_sim.gap.findings import Settings
    from msp_sim.gap.terminal import Progressing, print_findings

    settings = Settings(str(model), alpha, max_effects, seed, run_column, tuple(column_map or ()))
    with Progressing() as progress:
        findings = Steps(out, progress.clock, progress.say).all(measured, settings)
    print_findings(findings, out)


@app.command()
@tell_mistakes
def compare(
    measured: Measured,
    model: Reference,
    out: Out,
    alpha: Alpha = 0.05,
    max_effects: MaxEffects = 6,
    seed: Seed = 1,
    run_column: RunColumn = None,
    column_map: ColumnMaps = None,
) -> None:
    """The first step of 'msp-sim gap': where readings and a model disagree, by slices of context."""
    from msp_sim.gap.commands import Steps
    from msp_sim.gap.findings import Settings
    from msp_sim.gap.terminal import Progressing, print_findings

    settings = Settings(str(model), alpha, max_effects, seed, run_column, tuple(column_map or ()))
    with Progressing() as progress:
        compared = Steps(out, progress.clock, progress.say).compare(measured, settings)
    print_findings(compared.findings, out)


@app.command()
@tell_mistakes
def name(out: OutArgument) -> None:
    """The second step: name what is missing, with what it could be confused with."""
    from msp_sim.gap.commands import Steps
    from msp_sim.gap.terminal import Progressing, print_findings

    with Progressing() as progress:
        findings = Steps(out, progress.clock, progress.say).name()
    print_findings(findings, out)


@app.command()
@tell_mistakes
def add(out: OutArgument) -> None:
    """The third step: add what was named to the model, and measure on runs that took no part what it gains."""
    from msp_sim.gap.commands import Steps
    from msp_sim.gap.terminal import Progressing, print_findings

    with Progressing() as progress:
        findings = Steps(out, progress.clock, progress.say).add()
    print_findings(findings, out)


@app.command()
@tell_mistakes
def show(out: OutArgument) -> None:
    """The last step: pictures of the gap before and after, and the page that holds them."""
    from msp_sim.gap.commands import Steps
    from msp_sim.gap.findings import read_findings
    from msp_sim.gap.terminal import Progressing

    findings = read_findings(out)
    with Progressing() as progress:
        page = Steps(out, progress.clock, progress.say).show(findings)
    print(f"{findings.sentence}\n{page}")
