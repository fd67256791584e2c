"""msp-lab: the commands of the laboratory."""

import json
import sys
from dataclasses import replace
from datetime import date as day
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from msp_lab.design.cli import app as design_app
from msp_lab.fleet.cli import app as fleet_app
from msp_lab.gap.cli import ColumnMaps, Of
from msp_lab.gap.cli import app as gap_app
from msp_lab.logs.cli import app as import_app
from msp_range.extras import require
from msp_range.options import shipped
from msp_range.user_errors import Commands
from msp_range.yaml_file import ConfigError
from msp_sim.cli import Jobs, OwnEffects, Scheduler, Seed, choose_figures

if TYPE_CHECKING:
    from msp_lab.characterise.analysis import Characterisation

EXIT_FOUND = 1
"""'check-effect' found something."""

app = typer.Typer(
    name="msp-lab",
    help="Laboratory of msp-range: measures a sensor, makes its model, and finds what a model is missing.",
    epilog="Start with: msp-lab collect configs/campaigns/table_4_1.yaml --simulate --out campaign",
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.callback()(choose_figures)

MOST_STD_CM = 1000.0
"""Largest error of a reference that an option may state [cm]: more than any range of these sensors."""


CollectBus = Annotated[
    str | None, typer.Option(help="I2C bus number of the bench, or the path of its device file; default 1")
]
Simulate = Annotated[
    bool, typer.Option("--simulate", help="read emulated sensors instead of a bus, unattended and in virtual time")
]
SimulatedModel = Annotated[
    Path | None,
    typer.Option(help="with --simulate: use this sensor model for all sensors, instead of the campaign's"),
]
SimulatedSeed = Annotated[
    int | None,
    typer.Option(min=0, help="with --simulate: random seed; the same gives the same readings; default 1"),
]
OnlyPoints = Annotated[list[str] | None, typer.Option(help="only points with a name that begins so; may be repeated")]
RepeatedPoints = Annotated[
    list[str] | None,
    typer.Option(help="read points with a name that begins so again; the old readings stay recorded"),
]


@app.command()
def collect(
    campaign_file: Annotated[
        Path,
        typer.Argument(metavar="CAMPAIGN.yaml", help="what is to be measured", autocompletion=shipped("campaigns")),
    ],
    out: Annotated[
        Path, typer.Option(help="folder for recordings and table; an interrupted campaign in it is resumed")
    ],
    bus: CollectBus = None,
    simulate: Simulate = False,
    model: SimulatedModel = None,
    seed: SimulatedSeed = None,
    only: OnlyPoints = None,
    repeat: RepeatedPoints = None,
    show_plan: Annotated[
        bool, typer.Option("--plan", help="show the points and the estimated time, and do nothing else")
    ] = False,
    own_effects: OwnEffects = None,
) -> None:
    """Lead a person through a campaign at the bench: what to set up, what is being read, what looks wrong.

    Stop with q or Ctrl-C at any time; the same command resumes. In --out: readings.csv (all valid readings, in the CSV
    form of the project) and session-001.mcap ... (everything that was read). For a campaign of flights it asks for the
    recording and the reference of each flight and keeps copies of them; --simulate flies its scenarios.
    """
    from msp_lab.campaigns.collect import load_collection
    from msp_lab.campaigns.flights import is_of_flights

    collection = None if is_of_flights(campaign_file) else load_collection(campaign_file, only or (), repeat or ())
    if not simulate:
        if model is not None or seed is not None or own_effects:
            raise ConfigError("--model, --seed and --effects: only emulated sensors use them; give --simulate too")
        from msp_lab.campaigns.commands import collect_at_bench, collect_recordings

        if collection is None:
            collect_recordings(campaign_file, out, show_plan)
        else:
            collect_at_bench(collection, out, bus or "1", show_plan)
        return
    if bus is not None:
        raise ConfigError("--bus and --simulate: give one of them")
    require("sim", "msp-lab collect --simulate")
    from msp_lab.campaigns.collecting import collect_campaign, fly_flights

    seed = 1 if seed is None else seed
    if collection is None:
        fly_flights(campaign_file, out, model, seed, show_plan)
    else:
        collect_campaign(collection, out, model, seed, show_plan)


MeasuredFiles = Annotated[
    list[Path],
    typer.Argument(
        metavar="DATA...", help="measured readings (.csv), recordings (.mcap), or datasets of 'msp-lab import'"
    ),
]
StartModel = Annotated[
    Path | None,
    typer.Option(
        metavar="SENSOR.yaml",
        help="starting model: limits, codes, and what the data do not determine; default: the first driver's",
    ),
]
TruthOption = Annotated[
    Literal["recorded", "others"],
    typer.Option(
        help="recorded: the files' true_range_cm; others: each sensor's true range is what the other ones say"
    ),
]
ReferenceStd = Annotated[
    float | None,
    typer.Option(
        min=0.0, max=MOST_STD_CM, help="standard deviation of an error that all true ranges have in common [cm]"
    ),
]
SetUpStd = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=MOST_STD_CM,
        help="standard deviation of the error of each placement's true range [cm]; differences beyond it are "
        "attributed to the sensor and enter the model",
    ),
]
CompareWithReport = Annotated[
    bool,
    typer.Option(
        "--compare-with-report",
        help="with --report: also compare with the MB1242 characterization report, as DIR/comparison.html",
    ),
]
EachOption = Annotated[
    Literal["sensor"] | None,
    typer.Option(help="a model for each sensor; --out is the folder for SENSOR.yaml, --report has a folder for each"),
]


@app.command()
def characterise(
    data: MeasuredFiles,
    out: Annotated[Path, typer.Option(metavar="MODEL.yaml", help="sensor model file to make")],
    report: Annotated[
        Path | None, typer.Option(metavar="DIR", help="folder for the page, its pictures, and all numbers")
    ] = None,
    sensor: StartModel = None,
    column_map: ColumnMaps = None,
    of: Of = None,
    truth: TruthOption = "recorded",
    reference_std_cm: ReferenceStd = None,
    set_up_std_cm: SetUpStd = None,
    compare_with_report: CompareWithReport = False,
    date: Annotated[str | None, typer.Option(help="date to record, YYYY-MM-DD (default: today)")] = None,
    seed: Seed = 1,
    each: EachOption = None,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
) -> None:
    """Make a sensor model from readings at known ranges: calibration, kinds of reading, field of view, influences.

    With --each sensor, in --out: a model for each, and sensors.csv. A sensor of which no model can be made is named,
    and the exit code is 4.
    """
    require("lab", "msp-lab characterise")
    from msp_lab.characterise.analysis import Characterisation
    from msp_lab.readings.from_files import sensor_file
    from msp_range.clock import SystemClock, date_of
    from msp_range.reading_model.sensor_model import load_sensor_model

    if date is not None and not _is_date(date):
        raise ConfigError(f"--date {date}: expected a day such as 2026-10-05")
    how = Characterisation(
        tuple(data),
        sensor_file(sensor),
        tuple(column_map or ()),
        truth,
        date or date_of(SystemClock().utc()),
        seed,
        reference_std_cm,
        set_up_std_cm,
    )
    if sensor is None and column_map:
        name = load_sensor_model(how.start).name
        print(f"note: no --sensor, so name, limits and codes are those of the {name}", file=sys.stderr)
    if each is not None:
        if compare_with_report:
            raise ConfigError("--each and --compare-with-report: give one of them")
        _characterise_each(how, out, report, of or [], jobs, scheduler)
    elif jobs != 1 or scheduler is not None:
        raise ConfigError("--jobs and --scheduler: models of several sensors are made at a time: give --each sensor")
    else:
        _characterise_one(how, out, report, of or [], compare_with_report)


def _characterise_one(
    how: "Characterisation", out: Path, report: Path | None, of: list[str], compare_with_report: bool
) -> None:
    """Make one model of all readings, and print what was found."""
    from msp_lab.characterise.sensors import characterised, check_free
    from msp_lab.characterise.show import show_findings
    from msp_range.reading_model.sensor_model import load_sensor_model
    from msp_range.terminal import PlainConsole

    check_free(out, report)
    if compare_with_report:
        if report is None:
            raise ConfigError("--compare-with-report: give --report too, the folder for its page")
        from msp_lab.comparison.report import check_sensor

        check_sensor(load_sensor_model(how.start))
    progress = PlainConsole(stderr=True)
    pages: list[Path] = []
    with progress.status("reading") as status:
        made = characterised(how, of, status.update)
        made.write(out)
    console = PlainConsole()
    show_findings(made.findings, console)
    if report is not None:
        with progress.status("drawing the report"):
            pages = [made.publish(report)]
            if compare_with_report:
                from msp_lab.comparison.write import write_comparison

                pages.append(write_comparison(made.findings, made.points, made.model, report))
    console.print(f"{out}: loads as a sensor model" + "".join(f"; {page}" for page in pages))


def _characterise_each(
    how: "Characterisation", out: Path, report: Path | None, of: list[str], jobs: int, scheduler: str | None
) -> None:
    """Make a model of each sensor, and print a row for each; exit code 4 if some could not be made."""
    from msp_lab.characterise.sensors import TABLE, OfSensor, characterise_sensor
    from msp_lab.characterise.show import sensors_table
    from msp_sim.terminal import make_folder
    from msp_sim.workers import workers

    make_folder(out)
    how = replace(how, data=tuple(path.resolve() for path in how.data), start=how.start.resolve())
    sensors = {name: name for name in how.sensors() if name in of or not of}
    common = how, out.resolve(), report.resolve() if report is not None else None
    with workers(jobs, scheduler, "msp-lab characterise") as where:
        found = where.rows(characterise_sensor, sensors, common, out / TABLE, OfSensor, what="sensors")
    where.show_rows(found, sensors_table(found), ": no model", f"in {out}: a sensor model for each, and {TABLE}")


def _is_date(text: str) -> bool:
    try:
        return day.fromisoformat(text).isoformat() == text
    except ValueError:
        return False


@app.command()
def beam(
    model_file: Annotated[
        Path, typer.Argument(metavar="SENSOR.yaml", help="sensor model file with measured breakaway angles")
    ],
) -> None:
    """Predict the beam of an ultrasonic sensor beyond its measured angles, and write it into its sensor model file.

    'characterise' does so for a file that it makes; this is for one that was written or changed by hand. Without it the
    bridge holds the last measured angle. Everything else in the file stays; SENSOR.yaml.1 is the file as it was.
    """
    require("lab", "msp-lab beam")
    from msp_lab.characterise.beam import predict_in_file
    from msp_range.yaml_file import config_path

    path = config_path(model_file, "sensors")
    predicted, backup = predict_in_file(path)
    for row in predicted.rows:
        print(f"{row.range_cm:g} cm: {row.half_angle_deg:.1f} deg")
    held = "the last of these angles" if predicted.rows else "no narrower beam is predicted: the last measured angle"
    print(f"{held} is held up to the longest range")
    print(f"{path}: has this prediction already" if backup is None else f"written: {path}; as it was: {backup}")


@app.command()
def effects(
    as_json: Annotated[bool, typer.Option("--json", help="print everything as JSON")] = False,
    own_effects: OwnEffects = None,
) -> None:
    """List the effects that a sensor model file may name: what each is, what it requires, and how it shows."""
    from msp_sim.effects import CATALOGUE
    from msp_sim.effects.listing import as_data, as_text

    print(json.dumps(as_data(CATALOGUE), indent=2) if as_json else as_text(CATALOGUE))


@app.command("check-effect")
def check_effect(
    file: Annotated[Path, typer.Argument(metavar="FILE.py", help="Python file with one effect or more")],
    sensor: Annotated[
        Path | None,
        typer.Option(metavar="SENSOR.yaml", help="sensor model to try them on; default: the first driver's"),
    ] = None,
) -> None:
    """Check effects of your own: what the simulator and the gap workflow rely on, and what to do where it is missing.

    It says, too, which effects of the catalogue do nearly the same: 'msp-lab gap' can hardly tell such effects apart.
    Exit code 1 where something was found. A file that passes is used with '--effects FILE.py'.
    """
    require("sim", "msp-lab check-effect")
    from msp_lab.readings.from_files import sensor_file
    from msp_range.reading_model.sensor_model import load_sensor_model
    from msp_sim.effects.own import effects_of_file
    from msp_sim.model.alike import alike
    from msp_sim.model.contract import run_checks
    from msp_sim.model.trial import own_columns

    on = load_sensor_model(sensor_file(sensor))
    failed = False
    for effect in effects_of_file(file):
        print(f"{effect.name}: {effect.sentence}")
        for column in own_columns(effect):
            print(f"  note: the column {column} is not one of the simulator's; it is tried with numbers from 0 to 1")
        is_right = True
        for result in run_checks(effect, on):
            print(f"  {'ok    ' if result.found is None else 'FAILED'} {result.check.title}")
            if result.found is not None:
                is_right, failed = False, True
                print(f"         found: {result.found}\n         to do: {result.check.advice}")
        for other in alike(effect, on) if is_right else ():
            share = f"{100 * min(other.share, 1.0):.0f} %"
            print(f"  note: it is nearly {other.name} of the catalogue, which explains {share} of what it does")
    if failed:
        raise typer.Exit(EXIT_FOUND)


@app.command()
def filters(
    table: Annotated[
        Path | None, typer.Option(help="CSV of error statistics to explain, instead of the report's tables 5.4-5.6")
    ] = None,
    seeds: Annotated[int, typer.Option(min=10, max=5000, help="number of runs of each scenario")] = 200,
    seed: Seed = 1,
    out: Annotated[Path | None, typer.Option(help="folder for figures 5.7-5.15 and the tables as CSV and JSON")] = None,
) -> None:
    """The report's filter study: its nine filters in its three scenarios, what explains its rows, and a better filter.

    Next to each value of the table is its band over many seeds. For a row outside, a search finds the difference of an
    implementation that explains it, or reports what was tried.
    """
    require("lab", "msp-lab filters")
    from msp_lab.filter_study.explain import explain_rows
    from msp_lab.filter_study.goals import check_goals
    from msp_lab.filter_study.show import print_explanations, print_goals, print_tables
    from msp_lab.filter_study.study import delays, run_study
    from msp_lab.filter_study.table import read_table, report_table
    from msp_range.terminal import console
    from msp_sim.terminal import make_folder

    rows = report_table() if table is None else read_table(table)
    if out is not None:
        make_folder(out)
    shown = console()
    with shown.status("comparing filters"):
        results = run_study(seeds, seed)
    with shown.status("explaining the table"):
        reverse, verdicts = explain_rows(rows)
    print_tables(shown, verdicts, delays(results))
    print_explanations(shown, reverse, verdicts)
    print_goals(shown, check_goals(results))
    if out is not None:
        from msp_lab.filter_study.publish import publish_study

        for path in publish_study(out, results, reverse, verdicts, seed):
            print(f"written: {path}")


app.add_typer(import_app)
app.add_typer(gap_app)
app.add_typer(design_app)
app.add_typer(fleet_app)


def main() -> None:
    """Entry point of the command."""
    app()
