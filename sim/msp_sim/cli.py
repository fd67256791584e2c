"""msp-sim: the commands of what imitates."""

import json
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from msp_lab.gap.cli import app as gap_app
from msp_range.mistakes import tell_mistakes
from msp_range.yaml_file import ConfigError

ReadBy = Annotated[
    Path | None,
    typer.Option(help="sensor model file that all sensors read by, instead of the airframe's or campaign's"),
]

app = typer.Typer(
    name="msp-sim",
    help="Simulator of msp-range: the real bridge on emulated sensors, with no hardware.",
    epilog="Start with: msp-sim fly configs/scenarios/demo.yaml --out flights/demo",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.command()
@tell_mistakes
def fly(
    scenario_file: Annotated[Path, typer.Argument(metavar="SCENARIO.yaml", help="the flight: a scenario file")],
    model: ReadBy = None,
    seed: Annotated[int, typer.Option(min=0, help="of all chance: the same seed gives the same flight")] = 1,
    out: Annotated[Path | None, typer.Option(help="folder for summary, recording, link log and picture")] = None,
    link: Annotated[
        str | None, typer.Option(help="share the link with a ground station, e.g. udpout:127.0.0.1:14550")
    ] = None,
    realtime: Annotated[bool, typer.Option("--realtime", help="fly in real time")] = False,
    speed: Annotated[
        float | None, typer.Option(min=0.1, help="at most so many times real time, to watch; left out: all it can")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="replace the flight that --out holds already")] = False,
) -> None:
    """Fly a scenario with the real bridge, and show what came of it.

    In --out: summary.json (what the table shows), flight.mcap (every stage of every reading, for Foxglove or
    'msp-range replay'), link.tlog (what went out, for a ground station), flight.png, and the scenario.
    """
    from msp_sim.flight.flying import fly_scenario

    if realtime and speed is not None:
        raise ConfigError("--realtime and --speed: give one of them")
    fly_scenario(scenario_file, model, seed, out, link, realtime, speed, force)


@app.command()
@tell_mistakes
def sitl(
    airframe_file: Annotated[Path, typer.Argument(metavar="AIRFRAME.yaml", help="the vehicle: an airframe file")],
    link: Annotated[
        str | None, typer.Option(help="link to the autopilot, e.g. tcp:127.0.0.1:5762; left out: the airframe's")
    ] = None,
    autopilot: Annotated[
        Literal["ardupilot", "px4"] | None, typer.Option(help="type of the autopilot; left out: the airframe's")
    ] = None,
    model: ReadBy = None,
    seed: Annotated[int, typer.Option(min=0, help="of all chance")] = 1,
    ground: Annotated[
        Path | None,
        typer.Option(
            metavar="SCENARIO.yaml",
            help="scenario whose ground, air and faults it flies with; left out: flat ground, no faults",
        ),
    ] = None,
    ground_clearance: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="height of the vehicle's reference point above the ground when landed [m]; left out: so high that the "
            "lowest sensor reads its minimum",
        ),
    ] = None,
    duration: Annotated[float | None, typer.Option(min=0.0, help="end after this time [s]")] = None,
    record: Annotated[Path | None, typer.Option(help="folder for a recording of every stage of every reading")] = None,
    out: Annotated[Path | None, typer.Option(help="folder for summary and picture")] = None,
    force: Annotated[bool, typer.Option("--force", help="replace the flight that --out holds already")] = False,
) -> None:
    """Fly with an autopilot's own simulator (ArduPilot SITL, PX4 SIH), in real time, until SIGINT or SIGTERM.

    The vehicle's pose comes from the autopilot, over the link that DISTANCE_SENSOR goes out on. Start it while the
    vehicle is disarmed and stands on the ground: that is where the heights begin. docs/sitl.md has the commands and
    parameters.
    """
    from msp_sim.flight.flying import fly_sitl

    fly_sitl(airframe_file, link, autopilot, model, seed, ground, ground_clearance, duration, record, out, force)


@app.command()
@tell_mistakes
def sample(
    model: Annotated[Path, typer.Argument(metavar="MODEL.yaml", help="sensor model file")],
    contexts: Annotated[Path, typer.Option(help="CSV whose rows say where a reading is to be drawn (true_range_cm)")],
    out: Annotated[Path, typer.Option(help="CSV to write: the contexts with reading_cm filled in")],
    seed: Annotated[int, typer.Option(min=0, help="of all chance")] = 1,
) -> None:
    """Draw one reading a row of a CSV from a sensor model."""
    from numpy.random import default_rng

    from msp_range.recording.csv_form import read_csv, write_csv
    from msp_sim.model.model import load_model

    readings = load_model(model)
    given = read_csv(contexts, required=("true_range_cm",))
    reading_cm = readings.sample(given.columns, default_rng(seed))
    write_csv(out, {**given.columns, "reading_cm": reading_cm})
    print(f"{out}: {len(given)} readings", file=sys.stderr)
    for effect in readings.effects:
        absent = [name for name in effect.effect.needs if name not in given]
        if absent:
            print(f"{effect.stream} does not act: there is no column {', '.join(absent)}", file=sys.stderr)


@app.command()
@tell_mistakes
def effects(
    as_json: Annotated[bool, typer.Option("--json", help="all of it, as JSON")] = False,
) -> None:
    """List the effects that a sensor model file may name: what each is, what it needs, and what would show it."""
    from msp_sim.effects import CATALOGUE
    from msp_sim.effects.listing import as_data, as_text

    print(json.dumps(as_data(CATALOGUE), indent=2) if as_json else as_text(CATALOGUE))


@app.command()
@tell_mistakes
def collect(
    campaign_file: Annotated[Path, typer.Argument(metavar="CAMPAIGN.yaml", help="what is to be measured")],
    out: Annotated[
        Path, typer.Option(help="folder for recordings and table; one that has some already is gone on with")
    ],
    model: ReadBy = None,
    seed: Annotated[int, typer.Option(min=0, help="of all chance: the same seed gives the same readings")] = 1,
    only: Annotated[list[str] | None, typer.Option(help="only points whose name begins so; may be repeated")] = None,
    repeat: Annotated[
        list[str] | None, typer.Option(help="read points again whose name begins so; the old readings stay recorded")
    ] = None,
) -> None:
    """Go through a campaign on emulated sensors, unattended: the code of 'msp-range collect', with nobody at the bench.

    In --out: readings.csv (all readings that count, in the one CSV form) and sitting-001.mcap ... Interrupted, the same
    command goes on and ends with the same readings. Of a campaign of flights it flies the scenarios.
    """
    from msp_lab.campaigns.collecting import collect_campaign, collect_flights
    from msp_lab.campaigns.flights import is_of_flights

    if is_of_flights(campaign_file):
        collect_flights(campaign_file, out, model, seed)
    else:
        collect_campaign(campaign_file, out, model, seed, only or [], repeat or [])


@app.command()
@tell_mistakes
def filters(
    table: Annotated[
        Path | None, typer.Option(help="CSV of error statistics to explain, instead of the report's tables 5.4-5.6")
    ] = None,
    seeds: Annotated[
        int, typer.Option(min=10, max=5000, help="runs of each scenario that filters are compared on")
    ] = 200,
    seed: Annotated[int, typer.Option(min=0, help="of all chance")] = 1,
    out: Annotated[Path | None, typer.Option(help="folder for figures 5.7-5.15 and the tables as CSV and JSON")] = None,
) -> None:
    """The report's filter study: its nine filters in its three scenarios, what explains its rows, and a better filter.

    Beside each value of the table stands the band that many seeds give it. Where a row is outside, a search finds what
    an implementation must have done otherwise to get it, or says what was tried.
    """
    from msp_lab.filter_study.explain import explain
    from msp_lab.filter_study.goals import goals
    from msp_lab.filter_study.publish import publish
    from msp_lab.filter_study.show import print_explanations, print_goals, print_tables
    from msp_lab.filter_study.study import delays, study
    from msp_lab.filter_study.table import read_table, report_table
    from msp_range.terminal import console
    from msp_sim.terminal import make_folder

    rows = report_table() if table is None else read_table(table)
    if out is not None:
        make_folder(out)
    shown = console()
    with shown.status("comparing filters"):
        results = study(seeds, seed)
    with shown.status("explaining the table"):
        reverse, verdicts = explain(rows)
    print_tables(shown, verdicts, delays(results))
    print_explanations(shown, reverse, verdicts)
    print_goals(shown, goals(results))
    if out is not None:
        for path in publish(out, results, reverse, verdicts, seed):
            print(f"written: {path}")


app.add_typer(gap_app)


def main() -> None:
    """Entry point of the command."""
    app()
