"""msp-sim: the commands of the simulator."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from msp_range.extras import DRAWING, require
from msp_range.options import AirframeFile, shipped
from msp_range.user_errors import EXIT_COMMAND_LINE, Commands, VersionOption
from msp_range.watch.place import parse_listen
from msp_range.yaml_file import ConfigError

ScenarioFile = Annotated[
    Path,
    typer.Argument(metavar="SCENARIO.yaml", help="the flight: a scenario file", autocompletion=shipped("scenarios")),
]
ForceOption = Annotated[bool, typer.Option("--force", help="replace the flight in --out")]
SensorModelOption = Annotated[
    Path | None,
    typer.Option(
        help="use this sensor model for all sensors, instead of the airframe's", autocompletion=shipped("sensors")
    ),
]


def _add_effects(context: typer.Context, files: list[Path] | None) -> list[Path] | None:
    if context.params.get("simulate", True):  # 'collect' at a real bench draws no readings.
        require("sim", context.command_path, but=DRAWING)
        from msp_sim.effects.own import add_own_effects

        add_own_effects(files or ())
    return files


Seed = Annotated[int, typer.Option(min=0, help="random seed: the same gives the same result")]
OwnEffects = Annotated[
    list[Path] | None,
    typer.Option(
        "--effects", metavar="FILE.py", callback=_add_effects, help="file with effects of your own; may be repeated"
    ),
]
"""Effects of the files that are named, and of installed packages, are added to the catalogue before the command
starts."""

Jobs = Annotated[int, typer.Option(min=1, help="number of processes on this machine; more than 1 need the extra fleet")]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="compute on a Dask cluster: address of its scheduler, e.g. tcp://192.168.1.5:8786"
    ),
]

app = typer.Typer(
    name="msp-sim",
    help="Simulator of msp-range: the real bridge on emulated sensors, with no hardware.",
    epilog="Start with: msp-sim fly configs/scenarios/demo.yaml --out flights/demo",
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


FigureFormat = Annotated[
    Literal["png", "svg", "pdf"],
    typer.Option("--format", help="format in which each figure is written, next to its PNG; before the command's name"),
]


def choose_figures(figures: FigureFormat = "png", version: VersionOption = False) -> None:
    """Options of all commands."""
    if figures != "png":
        require("sim", f"--format {figures}")
        from msp_sim.page.style import choose_format

        choose_format(figures)


app.callback()(choose_figures)


@app.command()
def fly(
    scenario_file: ScenarioFile,
    model: SensorModelOption = None,
    seed: Seed = 1,
    out: Annotated[Path | None, typer.Option(help="folder for summary, recording, link log and picture")] = None,
    link: Annotated[
        str | None, typer.Option(help="share the link with a ground station, e.g. udpout:127.0.0.1:14550")
    ] = None,
    realtime: Annotated[bool, typer.Option("--realtime", help="fly in real time")] = False,
    speed: Annotated[
        float | None,
        typer.Option(
            min=0.1, help="limit of the speed in multiples of real time, to watch; default: as fast as possible"
        ),
    ] = None,
    force: ForceOption = False,
    web: Annotated[
        str | None,
        typer.Option(
            metavar="[HOST:]PORT", help="serve the page of the bridge meanwhile; real time, or as --speed says"
        ),
    ] = None,
    sample: Annotated[
        int | None,
        typer.Option(min=0, help="fly this flight of 'msp-sim monte-carlo' with the same --seed again"),
    ] = None,
    effects: OwnEffects = None,
) -> None:
    """Fly a scenario with the real bridge, and show the result.

    In --out: summary.json (the numbers of the table), flight.mcap (every stage of every reading, for Foxglove or
    'msp-range replay'), link.tlog (all messages sent, for a ground station), flight.png, and the scenario.
    """
    from msp_sim.flight.flying import fly_scenario, planned_flight
    from msp_sim.flight.results import Results

    if realtime and speed is not None:
        raise ConfigError("--realtime and --speed: give one of them")
    if web is not None:
        parse_listen(web)
        require("web", "msp-sim fly --web")
        speed = speed if speed is not None or realtime else 1.0
    planned = planned_flight(scenario_file, model, seed, sample)
    fly_scenario(planned, None if out is None else Results(out, force), link, realtime, speed, web)


@app.command("monte-carlo")
def monte_carlo(
    scenario_file: ScenarioFile,
    flights: Annotated[int, typer.Option(min=1, help="number of flights, counted from 0")],
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="folder for table, summary and picture; flights in it are kept")
    ],
    seed: Seed = 1,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
    model: SensorModelOption = None,
    model_only: Annotated[
        bool,
        typer.Option(
            "--model-only", help="only draw readings from the sensor models, without bridge and faults: faster"
        ),
    ] = False,
    effects: OwnEffects = None,
) -> None:
    """Fly a scenario many times with random parameters, and show how often something goes wrong.

    What varies, and how, is in the scenario's section 'vary' (docs/simulating.md); without one, terrain, motion,
    temperatures and faults vary within ranges that are printed. Each flight is the real bridge in virtual time.

    In --out: flights.csv (a row per flight), summary.json (shares and quantiles with 95 % intervals, the worst flights
    with the command that flies each again), flights.png. Ctrl-C keeps the flights that are done, the same command flies
    the others, and a larger --flights adds some. The results do not depend on --jobs.

    Exit code 4: some flights could not be flown; they are named, and flown again by the same command.
    """
    from msp_sim.monte_carlo.command import FlightOptions, fly_monte_carlo
    from msp_sim.workers import workers

    options = FlightOptions(scenario_file, seed, model, effects or ())
    fly_monte_carlo(options, flights, out, model_only, workers(jobs, scheduler, "msp-sim monte-carlo"))


@app.command()
def sitl(
    airframe_file: AirframeFile,
    link: Annotated[
        str | None, typer.Option(help="link to the autopilot, e.g. tcp:127.0.0.1:5762; default: the airframe's")
    ] = None,
    autopilot: Annotated[
        Literal["ardupilot", "px4"] | None, typer.Option(help="type of the autopilot; default: the airframe's")
    ] = None,
    model: SensorModelOption = None,
    seed: Seed = 1,
    ground: Annotated[
        Path | None,
        typer.Option(
            metavar="SCENARIO.yaml",
            help="scenario with the ground, air and faults to use; default: flat ground, no faults",
        ),
    ] = None,
    ground_clearance: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            help="height of the vehicle's reference point above the ground when landed [m]; default: such that the "
            "lowest sensor reads its minimum",
        ),
    ] = None,
    duration: Annotated[float | None, typer.Option(min=0.0, help="end after this time [s]")] = None,
    record: Annotated[Path | None, typer.Option(help="folder for a recording of every stage of every reading")] = None,
    out: Annotated[Path | None, typer.Option(help="folder for the summary and the picture")] = None,
    force: ForceOption = False,
    effects: OwnEffects = None,
) -> None:
    """Fly with an autopilot's own simulator (ArduPilot SITL, PX4 SIH), in real time, until SIGINT or SIGTERM.

    The autopilot sends the vehicle's pose over the same link on which it receives DISTANCE_SENSOR. Start it while the
    vehicle is disarmed and stands on the ground, because heights are counted from there. docs/sitl.md has the commands
    and parameters.
    """
    from msp_range.config import load_airframe
    from msp_sim.flight.results import Results
    from msp_sim.sitl.flying import fly_sitl, load_scene

    airframe = load_airframe(airframe_file).changed(link=link, autopilot=autopilot)
    scene = load_scene(ground, ground_clearance, airframe, airframe_file)
    fly_sitl(airframe, scene, model, seed, duration, record, None if out is None else Results(out, force))


@app.command()
def sample(
    model: Annotated[
        Path, typer.Argument(metavar="MODEL.yaml", help="sensor model file", autocompletion=shipped("sensors"))
    ],
    contexts: Annotated[
        Path, typer.Option(help="CSV with the contexts of the readings, one per row (true_range_cm and more)")
    ],
    out: Annotated[Path, typer.Option(help="CSV to write: the contexts with reading_cm filled in")],
    seed: Seed = 1,
    effects: OwnEffects = None,
) -> None:
    """Draw one reading from a sensor model for each row of a CSV.

    Columns that the model uses and the CSV lacks are computed from others where that is possible: the rate of the
    range, the time in the run, the incidence from roll_deg and pitch_deg. The previous reading is the one drawn before.
    """
    from msp_range.recording.csv_form import read_csv, write_csv
    from msp_sim.model.context_limits import check_contexts
    from msp_sim.model.derived import PREVIOUS, derived_columns, sample_in_order
    from msp_sim.model.model import load_model

    readings = load_model(model)
    given = read_csv(contexts, required=("true_range_cm",))
    check_contexts(str(contexts), given)
    added, sources = derived_columns(readings.columns, given.columns)
    columns = {**given.columns, **added}
    reading_cm = sample_in_order(readings, columns, seed)
    write_csv(out, {**columns, "reading_cm": reading_cm})
    print(f"{out}: {len(given)} readings", file=sys.stderr)
    for name, words in sources.items():
        print(f"{name} was computed from {words}", file=sys.stderr)
    for effect in readings.effects:
        absent = [name for name in effect.effect.requires if name not in columns and name != PREVIOUS]
        if absent:
            print(f"{effect.stream} has no effect: there is no column {', '.join(absent)}", file=sys.stderr)


@app.command()
def show(
    recording: Annotated[
        Path, typer.Argument(metavar="FLIGHT.mcap", help="a recording of 'msp-sim fly' or 'msp-range run'")
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="PICTURE.png", help="picture to draw; default: only the table")
    ] = None,
) -> None:
    """Summarise a recorded flight, simulated or real, and draw it: what each sensor read, which readings were rejected
    and why, what was reported to the pilot, and the fused distance.

    If the recording contains the truth, the table has the errors, and the picture shows them below.
    """
    if recording.is_dir():
        print(f"{recording}: expected a recording (.mcap); pages of the gap workflow: msp-lab show", file=sys.stderr)
        raise typer.Exit(EXIT_COMMAND_LINE)
    require("sim", "msp-sim show", but="" if out is not None else DRAWING)
    from msp_range.terminal import console
    from msp_sim.flight.recorded import recorded_flight
    from msp_sim.flight.show import print_table
    from msp_sim.flight.summary import summarise

    if out is not None:
        from msp_sim.page.style import FORMATS
        from msp_sim.terminal import make_folder

        if out.suffix.removeprefix(".").lower() not in FORMATS:
            raise ConfigError(f"{out}: found the ending {out.suffix!r}; expected .{', .'.join(FORMATS)}")
        if out.exists():
            raise ConfigError(f"{out}: there is a file already, and none is overwritten")
        make_folder(out.parent)
    flight = recorded_flight(recording)
    print_table(console(), summarise(flight, recording.name, None))
    if out is not None:
        from msp_sim.flight.flight_picture import draw

        draw(flight, out, recording.name)
        print(f"picture: {out}")


def main() -> None:
    """Entry point of the command."""
    app()
