"""msp-sim: the commands of what imitates."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from msp_range.extras import DRAWING, require
from msp_range.mistakes import tell_mistakes
from msp_range.moved import EXIT_COMMAND_LINE, add_moved
from msp_range.yaml_file import ConfigError

ReadBy = Annotated[
    Path | None,
    typer.Option(help="use this sensor model for all sensors, instead of the airframe's"),
]
OwnEffects = Annotated[
    list[Path] | None,
    typer.Option("--effects", metavar="FILE.py", help="file with effects of your own; may be repeated"),
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
    effects: OwnEffects = None,
) -> None:
    """Fly a scenario with the real bridge, and show what came of it.

    In --out: summary.json (what the table shows), flight.mcap (every stage of every reading, for Foxglove or
    'msp-range replay'), link.tlog (what went out, for a ground station), flight.png, and the scenario.
    """
    require("sim", "msp-sim fly", but=DRAWING)
    from msp_sim.effects.own import add_own_effects
    from msp_sim.flight.flying import fly_scenario

    if realtime and speed is not None:
        raise ConfigError("--realtime and --speed: give one of them")
    add_own_effects(effects or ())
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
    effects: OwnEffects = None,
) -> None:
    """Fly with an autopilot's own simulator (ArduPilot SITL, PX4 SIH), in real time, until SIGINT or SIGTERM.

    The vehicle's pose comes from the autopilot, over the link that DISTANCE_SENSOR goes out on. Start it while the
    vehicle is disarmed and stands on the ground: that is where the heights begin. docs/sitl.md has the commands and
    parameters.
    """
    require("sim", "msp-sim sitl", but=DRAWING)
    from msp_sim.effects.own import add_own_effects
    from msp_sim.sitl.flying import fly_sitl

    add_own_effects(effects or ())
    fly_sitl(airframe_file, link, autopilot, model, seed, ground, ground_clearance, duration, record, out, force)


@app.command()
@tell_mistakes
def sample(
    model: Annotated[Path, typer.Argument(metavar="MODEL.yaml", help="sensor model file")],
    contexts: Annotated[Path, typer.Option(help="CSV whose rows say where a reading is to be drawn (true_range_cm)")],
    out: Annotated[Path, typer.Option(help="CSV to write: the contexts with reading_cm filled in")],
    seed: Annotated[int, typer.Option(min=0, help="of all chance")] = 1,
    effects: OwnEffects = None,
) -> None:
    """Draw one reading a row of a CSV from a sensor model."""
    require("sim", "msp-sim sample")
    from numpy.random import default_rng

    from msp_range.recording.csv_form import read_csv, write_csv
    from msp_sim.effects.own import add_own_effects
    from msp_sim.model.model import load_model

    add_own_effects(effects or ())
    readings = load_model(model)
    given = read_csv(contexts, required=("true_range_cm",))
    reading_cm = readings.sample(given.columns, default_rng(seed))
    write_csv(out, {**given.columns, "reading_cm": reading_cm})
    print(f"{out}: {len(given)} readings", file=sys.stderr)
    for effect in readings.effects:
        absent = [name for name in effect.effect.requires if name not in given]
        if absent:
            print(f"{effect.stream} does not act: there is no column {', '.join(absent)}", file=sys.stderr)


@app.command()
@tell_mistakes
def show(
    recording: Annotated[
        Path, typer.Argument(metavar="FLIGHT.mcap", help="a recording of 'msp-sim fly' or 'msp-range run'")
    ],
    out: Annotated[Path, typer.Option(metavar="PICTURE.png", help="picture to make")],
) -> None:
    """Draw a recorded flight, simulated or real: what each sensor read, what was held back, and the fused distance.

    Below it the errors, where the recording knows the truth.
    """
    if recording.is_dir():
        print(f"{recording}: expected a recording (.mcap); pages of the gap workflow: msp-lab show", file=sys.stderr)
        raise typer.Exit(EXIT_COMMAND_LINE)
    require("sim", "msp-sim show")
    from msp_sim.flight.flight_picture import draw
    from msp_sim.flight.recorded import recorded_flight
    from msp_sim.terminal import make_folder

    if out.exists():
        raise ConfigError(f"{out}: there is a file already, and none is overwritten")
    flight = recorded_flight(recording)
    make_folder(out.parent)
    draw(flight, out, recording.name)
    print(f"picture: {out}")


add_moved(app, {name: f"msp-lab {name}" for name in ("collect", "gap", "compare", "name", "add", "effects", "filters")})


def main() -> None:
    """Entry point of the command."""
    app()
