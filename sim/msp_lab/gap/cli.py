"""The commands of the gap workflow, which msp-lab takes in among its own.

Options enter, lines on the terminal and files leave. `gap` and `compare` begin with readings and have the same options;
`name`, `add` and `show` go on in a folder.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

import typer

from msp_range.extras import require
from msp_range.mistakes import tell_mistakes
from msp_sim.cli import OwnEffects

if TYPE_CHECKING:
    from msp_lab.gap.commands import Steps
    from msp_lab.gap.findings import GapFindings

app = typer.Typer()

Out = Annotated[Path, typer.Option(metavar="DIR", help="folder for gap.json, model.yaml, report.html and pictures")]
OutArgument = Annotated[Path, typer.Argument(metavar="DIR", help="folder that 'msp-lab compare' or 'gap' made")]
Measured = Annotated[
    list[Path], typer.Argument(metavar="MEASURED", help="readings with a true range (.csv) or recordings (.mcap)")
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
Last: TypeAlias = Literal["compare", "name", "add", "show"]
Until = Annotated[Last, typer.Option(help="the last step; pictures come with 'show'")]

GAP = """Find where readings and a model disagree, name what is missing, add it, and show whether the gap closes.

In --out: report.html and its pictures, model.yaml (the model with what was added, for 'msp-sim fly' and 'sample'),
gap.json (all numbers), and model_as_proved.yaml. The steps are there alone too: 'compare', then 'name', 'add', 'show'.
"""
COMPARE = "Step 1 of gap: where readings and a model disagree, by slices of context."
NAME = "Step 2 of gap: name what is missing, with what it could be confused with."
ADD = "Step 3 of gap: add what is missing to the model, and measure what it gains on runs that took no part."
SHOW = "Step 4 of gap: pictures of the gap before and after, and the page that holds them."


def _begins(last: Last) -> Callable[..., None]:
    """A command that takes readings and a model, and goes on to this step."""

    @tell_mistakes
    def command(
        measured: Measured,
        model: Reference,
        out: Out,
        alpha: Alpha = 0.05,
        max_effects: MaxEffects = 6,
        seed: Seed = 1,
        run_column: RunColumn = None,
        column_map: ColumnMaps = None,
        until: Until = last,
        effects: OwnEffects = None,
    ) -> None:
        from msp_lab.gap.findings import Settings

        settings = Settings(str(model), alpha, max_effects, seed, run_column, tuple(column_map or ()))
        _told(out, effects, lambda steps: steps.all(measured, settings, until))

    return command


def _goes_on(step: "Callable[[Steps], GapFindings]") -> Callable[..., None]:
    """A command that does this with what an earlier one left in a folder."""

    @tell_mistakes
    def command(out: OutArgument, effects: OwnEffects = None) -> None:
        _told(out, effects, step)

    return command


def _told(out: Path, effects: list[Path] | None, step: "Callable[[Steps], GapFindings]") -> None:
    """Do a step with its progress on the terminal, and say what it found."""
    require("lab", "The gap workflow")
    from msp_lab.gap.commands import Steps
    from msp_lab.gap.terminal import Progressing, print_findings
    from msp_sim.effects.own import add_own_effects

    add_own_effects(effects or ())
    with Progressing() as progress:
        findings = step(Steps(out, progress.clock, progress.say))
    print_findings(findings, out)


app.command("gap", help=GAP)(_begins("show"))
app.command("compare", help=COMPARE)(_begins("compare"))
app.command("name", help=NAME)(_goes_on(lambda steps: steps.name()))
app.command("add", help=ADD)(_goes_on(lambda steps: steps.add()))
app.command("show", help=SHOW)(_goes_on(lambda steps: steps.show()))
