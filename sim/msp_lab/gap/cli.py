"""The commands of the gap workflow, part of msp-lab.

The results are lines on the terminal and files. `gap` and `compare` start from readings and have the same options;
`name`, `add` and `show` continue in a folder.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from msp_lab.gap.findings import GapFindings, LastStep, Settings
from msp_range.extras import require
from msp_range.options import shipped
from msp_range.yaml_file import ConfigError, config_path
from msp_sim.cli import Jobs, OwnEffects, Scheduler, Seed

if TYPE_CHECKING:
    from msp_lab.gap.separate import Common, Each
    from msp_lab.gap.steps import Steps
    from msp_lab.gap.terminal import ProgressBar

app = typer.Typer()

Out = Annotated[Path, typer.Option(metavar="DIR", help="folder for gap.json, model.yaml, report.html and pictures")]
OutArgument = Annotated[Path, typer.Argument(metavar="DIR", help="folder that 'msp-lab compare' or 'gap' made")]
Measured = Annotated[
    list[Path],
    typer.Argument(
        metavar="MEASURED",
        help="readings with a true range (.csv), recordings (.mcap), datasets of 'msp-lab import', or flight logs "
        "(.BIN, .ulg, .tlog, .bag), which are imported into --out/readings first",
    ),
]
Reference = Annotated[
    Path,
    typer.Option(
        "--model",
        metavar="MODEL.yaml",
        help="sensor model to compare the readings with",
        autocompletion=shipped("sensors"),
    ),
]
Alpha = Annotated[float, typer.Option(min=0.0001, max=0.5, help="family-wise false-positive rate")]
MaxEffects = Annotated[int, typer.Option(min=0, max=100, help="largest number of effects to add")]
RunColumn = Annotated[str | None, typer.Option(help="column that names the runs (default: 'run', else each file)")]
ColumnMaps = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="MAP",
        help="column names and units: a YAML file, or NAME=COLUMN*FACTOR, repeatable",
    ),
]
Of = Annotated[
    list[str] | None,
    typer.Option(
        "--of", metavar="SENSOR", help="use only the readings of this sensor (column sensor); may be repeated"
    ),
]
TruthOption = Annotated[
    str,
    typer.Option(
        "--truth",
        metavar="SOURCE",
        help="recorded: the files' true_range_cm, or the best reference of a flight log; others: compare each sensor "
        "with the vehicle's other ones; of a flight log also what 'msp-lab import --help' names",
    ),
]
EachOption = Annotated[
    Literal["log", "sensor"] | None,
    typer.Option(help="a separate gap for each MEASURED, or for each sensor; with --jobs on several processors"),
]
Until = Annotated[LastStep, typer.Option(help="last step to do; 'show' draws the pictures")]

GAP = """Find where readings and a model disagree, name what is missing, add it, and show whether the gap closes.

In --out: report.html and its pictures, model.yaml (the model with what was added, for 'msp-sim fly' and 'sample'),
gap.json (all numbers), named.json, and model_training_fit.yaml. Each step is also a command: 'compare', then 'name',
'add', 'show'. With --each, in --out: a folder like that for each log or sensor, and gaps.csv, a row for each. A log
that cannot be used is named, the others are compared, and the exit code is 4.
"""
COMPARE = "Step 1 of gap: where readings and a model disagree, by slices of context."
NAME = "Step 2 of gap: name what is missing, and list the alternatives that fit as well."
ADD = "Step 3 of gap: add what was named to the model, and measure the gap that is left on held-out runs."
DEMO = """Hide five effects in eight simulated flights, find them, and fly the model with what was found.

In --out: flight-0.mcap to flight-7.mcap with their scenarios, vehicle.yaml (the model that was flown), given.yaml (the
model to which they are compared), gap/ as of 'msp-lab gap', and flight-8.mcap, flown with gap/model.yaml.
"""
SHOW = "Step 4 of gap: draw the gap before and after, and write the page."


def _from_readings(last: LastStep) -> Callable[..., None]:
    """A command that takes readings and a model, and works up to this step."""

    def command(
        measured: Measured,
        model: Reference,
        out: Out,
        alpha: Alpha = 0.01,
        max_effects: MaxEffects = 6,
        seed: Seed = 1,
        run_column: RunColumn = None,
        column_map: ColumnMaps = None,
        of: Of = None,
        truth: TruthOption = "recorded",
        until: Until = last,
        each: EachOption = None,
        jobs: Jobs = 1,
        scheduler: Scheduler = None,
        effects: OwnEffects = None,
    ) -> None:
        from msp_lab.logs.cli import with_logs_imported

        file = str(config_path(model, "sensors"))
        settings = Settings(file, alpha, max_effects, seed, run_column, tuple(column_map or ()), tuple(of or ()))
        if each is not None:
            require("lab", "The gap workflow")
            from msp_lab.gap.separate import Common

            common = Common(settings, truth, until, tuple(path.resolve() for path in effects or ()))
            _run_separately(measured, out, each, common, jobs, scheduler)
            return
        if jobs != 1 or scheduler is not None:
            raise ConfigError("--jobs and --scheduler: separate gaps are computed on several processors: give --each")
        measured, truth = with_logs_imported(measured, truth, column_map or [], out / "readings")
        if truth == "others":
            if until not in ("add", "show") or last != "show":
                raise ConfigError("--truth others: 'gap' does it, up to the step add or show")
            _run_sensors(measured, settings, out, until == "show")
        else:
            _run(out, lambda steps: steps.all(measured, settings, until))

    return command


def _in_folder(step: "Callable[[Steps], GapFindings]") -> Callable[..., None]:
    """A command that continues with what an earlier one left in a folder."""

    def command(out: OutArgument, effects: OwnEffects = None) -> None:
        _run(out, step)

    return command


@contextmanager
def _progress() -> Iterator["ProgressBar"]:
    """The progress of a command on the terminal."""
    require("lab", "The gap workflow")
    from msp_lab.gap.terminal import ProgressBar

    with ProgressBar() as progress:
        yield progress


def _run(out: Path, step: "Callable[[Steps], GapFindings]") -> None:
    """Do a step with its progress on the terminal, and print what it found."""
    with _progress() as progress:
        from msp_lab.gap.steps import Steps
        from msp_lab.gap.terminal import print_files

        findings = step(Steps(out, progress.clock, progress.report, progress.print_findings))
    print_files(findings, out)


def _run_separately(
    measured: list[Path], out: Path, each: "Each", common: "Common", jobs: int, scheduler: str | None
) -> None:
    """Compare each log or sensor on its own, and print a row for each; exit code 4 if some could not be compared."""
    from msp_lab.gap.separate import TABLE, SeparateGap, jobs_of, separate_gap
    from msp_lab.gap.terminal import separate_gaps_table
    from msp_sim.terminal import make_folder
    from msp_sim.workers import workers

    if common.truth == "others":
        raise ConfigError("--each: --truth others compares the sensors with each other; give one of them")
    make_folder(out)
    with workers(jobs, scheduler, "msp-lab gap") as where:
        separate = jobs_of(measured, each, common.settings, out)
        found = where.rows(separate_gap, separate, common, out / TABLE, SeparateGap, what="gaps")
    where.show_rows(
        found, separate_gaps_table(found), " could not be compared", f"in {out}: a folder for each, and {TABLE}"
    )


def _run_sensors(measured: list[Path], settings: Settings, out: Path, draw: bool) -> None:
    """Compare each sensor with the others, and print what was found at each."""
    with _progress() as progress:
        from msp_lab.gap.separate import compare_sensors
        from msp_lab.gap.steps import Steps
        from msp_lab.gap.terminal import print_sensors

        def steps(folder: Path) -> Steps:
            return Steps(folder, progress.clock, lambda what, share: progress.report(f"{folder.name}: {what}", share))

        gaps, messages = compare_sensors(measured, settings, out, steps, draw)
    print_sensors(gaps, messages, out)


def _demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="folder for flights, models and findings")] = Path(
        "flights/gap-demo"
    ),
    seed: Seed = 1,
    force: Annotated[bool, typer.Option("--force", help="replace an earlier demonstration in --out")] = False,
) -> None:
    with _progress() as progress:
        from msp_lab.gap import demo
        from msp_lab.gap.steps import Steps
        from msp_lab.gap.terminal import print_comparisons, print_files
        from msp_sim.terminal import make_folder

        make_folder(out)
        demo.clear(out, force)
        steps = Steps(out / "gap", progress.clock, progress.report, progress.print_findings)
        findings = demo.run(out, seed, steps)
    print_files(findings, out / "gap")
    print_comparisons(demo.comparisons(findings))


app.command("gap", help=GAP)(_from_readings("show"))
app.command("compare", help=COMPARE)(_from_readings("compare"))
app.command("name", help=NAME)(_in_folder(lambda steps: steps.name()))
app.command("add", help=ADD)(_in_folder(lambda steps: steps.add()))
app.command("show", help=SHOW)(_in_folder(lambda steps: steps.show()))
app.command("demo", help=DEMO)(_demo)
