"""msp-sim: the commands of what imitates."""

import json
import shutil
import sys
from contextlib import ExitStack, closing, nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from msp_range.cli import tell_mistakes
from msp_range.yaml_file import ConfigError
from msp_sim.gap.cli import app as gap_app

SHOWN_EACH_S = 0.1
"""Wall time between two looks at a flight [s]."""
LOGGED_EACH_S = 5.0
"""The same where nobody looks: the output goes into a file [s]."""

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
    model: Annotated[
        Path | None, typer.Option(help="sensor model file that all sensors read by, instead of the airframe's")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="of all chance: the same seed gives the same flight")] = 1,
    out: Annotated[Path | None, typer.Option(help="folder for summary, recording, link log and picture")] = None,
    link: Annotated[
        str | None, typer.Option(help="share the link with a ground station, e.g. udpout:127.0.0.1:14550")
    ] = None,
    realtime: Annotated[bool, typer.Option("--realtime", help="fly in real time")] = False,
    speed: Annotated[
        float | None, typer.Option(min=0.1, help="at most so many times real time, to watch; left out: all it can")
    ] = None,
) -> None:
    """Fly a scenario with the real bridge, and show what came of it.

    In --out: summary.json (what the table shows), flight.mcap (every stage of every reading, for Foxglove or
    'msp-range replay'), link.tlog (what went out, for a ground station), flight.png, and the scenario.
    """
    from rich.console import Console
    from rich.live import Live

    from msp_range.clock import SystemClock, VirtualClock
    from msp_range.mavlink.transport import open_transport, parse_url
    from msp_range.reading_model.sensor_model import load_sensor_model
    from msp_range.recording.writer import Recorder
    from msp_range.service import stop_signals
    from msp_sim.autopilot import Tee
    from msp_sim.flight import Simulation
    from msp_sim.scenario import load_scenario
    from msp_sim.show import Live as Shown
    from msp_sim.show import draw, print_table
    from msp_sim.summary import summarise

    if realtime and speed is not None:
        raise ConfigError("--realtime and --speed: give one of them")
    scenario = load_scenario(scenario_file)
    sensor_model = load_sensor_model(model) if model is not None else None
    if link is not None:
        try:
            parse_url(link)
        except ValueError as error:
            raise ConfigError(f"--link: {error}") from None
    system = SystemClock()
    clock = system if realtime else VirtualClock()
    recorder = None
    if out is not None:
        make_folder(out)
        (out / "flight.mcap").unlink(missing_ok=True)
        recorder = Recorder(
            out / "flight.mcap",
            clock,
            files=scenario.airframe.files,
            metadata={"scenario": scenario.name, "seed": str(seed)},
        )
    simulation = Simulation(
        scenario,
        clock,
        seed,
        model=sensor_model,
        recorder=recorder,
        link=(lambda autopilot: Tee(open_transport(link, system), autopilot)) if link is not None else None,
        tlog=out / "link.tlog" if out is not None else None,
    )
    console = Console()
    if not console.is_terminal:
        console = Console(width=120)
    shown = Shown(simulation, scenario.duration_s)
    started_s = next_look_s = system.now()
    live: Any = Live(shown, console=console, auto_refresh=False) if console.is_terminal else nullcontext()
    with ExitStack() as opened:
        stopped = opened.enter_context(stop_signals())
        opened.enter_context(live)
        flying = opened.enter_context(closing(simulation.fly()))
        for steps in flying:
            if stopped:
                break
            shown.take(steps)
            if steps and speed is not None:
                system.sleep_until(started_s + simulation.now_s() / speed)
            if console.is_terminal:
                if system.now() >= next_look_s:
                    next_look_s = system.now() + SHOWN_EACH_S
                    live.refresh()
            elif steps and (line := shown.line()) is not None:
                print(line)
        if console.is_terminal:
            live.refresh()
    wall_s = system.now() - started_s
    if recorder is not None:
        recorder.close()
    summary = summarise(simulation.flight, scenario.name, seed)
    print_table(console, summary)
    times = summary["duration_s"] / wall_s
    held = "" if speed is None else f", held at {speed:g}"
    print(f"{summary['duration_s']:.1f} s of flight in {wall_s:.1f} s: {times:.0f} times real time{held}")
    if simulation.link_error is not None:
        print(f"link {link}: {simulation.link_error}")
    if out is not None:
        summary["wall"] = {"seconds": round(wall_s, 3), "times_real_time": round(times, 1)}
        (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
        shutil.copyfile(scenario_file, out / "scenario.yaml")
        draw(simulation.flight, out / "flight.png", f"{scenario.name}, seed {seed}")
        for name, what in (
            ("flight.png", "picture"),
            ("summary.json", "numbers"),
            ("flight.mcap", "recording"),
            ("link.tlog", "link"),
        ):
            print(f"{what:>9}: {out / name}")


@app.command()
@tell_mistakes
def sitl(
    airframe_file: Annotated[Path, typer.Argument(metavar="AIRFRAME.yaml", help="the vehicle: an airframe file")],
    link: Annotated[
        str | None, typer.Option(help="link to the autopilot, e.g. tcp:127.0.0.1:5762; left out: the airframe's")
    ] = None,
    model: Annotated[
        Path | None, typer.Option(help="sensor model file that all sensors read by, instead of the airframe's")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="of all chance")] = 1,
    ground: Annotated[
        Path | None,
        typer.Option(metavar="SCENARIO.yaml", help="scenario whose ground and air it flies in; left out: flat ground"),
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
) -> None:
    """Fly with an autopilot's own simulator (ArduPilot SITL, PX4 SIH), in real time, until SIGINT or SIGTERM.

    The vehicle's pose comes from the autopilot, over the link that DISTANCE_SENSOR goes out on. Start it while the
    vehicle stands on the ground: that is where the heights begin. docs/sitl.md has the commands and parameters.
    """

    from rich.console import Console

    from msp_range.cli import with_changes
    from msp_range.clock import SystemClock
    from msp_range.config import load_airframe
    from msp_range.mavlink.transport import open_transport
    from msp_range.reading_model.sensor_model import load_sensor_model
    from msp_range.service import open_recording, stop_signals
    from msp_sim.scenario import load_scenario
    from msp_sim.show import draw, print_table
    from msp_sim.sitl import Sitl, status_line
    from msp_sim.summary import summarise
    from msp_sim.surfaces import Ground
    from msp_sim.world import Air, World

    airframe = with_changes(load_airframe(airframe_file), link=link)
    sensor_model = load_sensor_model(model) if model is not None else None
    scenario = load_scenario(ground) if ground is not None else None
    if out is not None:
        make_folder(out)
    console = Console()
    if not console.is_terminal:
        console = Console(width=120)
    clock = SystemClock()
    with ExitStack() as opened:
        stopped = opened.enter_context(stop_signals())
        recorder = None
        if record is not None:
            recorder = open_recording(airframe, record, clock)
            if recorder is not None:
                opened.callback(recorder.close)
        transport = open_transport(airframe.link.url, clock)
        opened.callback(transport.close)
        simulation = Sitl(
            airframe,
            clock,
            transport,
            scenario.world() if scenario is not None else World(Ground(), Air()),
            seed,
            model=sensor_model,
            clearance_m=ground_clearance,
            start_m=scenario.flight.track.start_m if scenario is not None else (0.0, 0.0),
            recorder=recorder,
            report=lambda severity, text: console.print(f"{severity.name.lower()}: {text}", highlight=False),
        )
        status = opened.enter_context(console.status("")) if console.is_terminal else None
        next_look_s = 0.0
        source: str | None = None
        while not stopped and (duration is None or simulation.now_s() < duration):
            simulation.step()
            if simulation.vehicle.source != source:
                where = "where it was" if source else "standing on the ground"
                source = simulation.vehicle.source
                console.print(f"pose from {source}: the vehicle is {where}", highlight=False)
            if simulation.now_s() < next_look_s:
                continue
            if status is not None:
                next_look_s = simulation.now_s() + SHOWN_EACH_S
                status.update(status_line(simulation))
            else:
                next_look_s = simulation.now_s() + LOGGED_EACH_S
                console.print(status_line(simulation), highlight=False, soft_wrap=True)
    flight = simulation.finish()
    summary = summarise(flight, airframe.vehicle, seed)
    summary["poses"] = dict(simulation.vehicle.heard)
    print_table(console, summary)
    poses = ", ".join(f"{count} poses in {name}" for name, count in simulation.vehicle.heard.items())
    print(f"link: {airframe.link.url}; {poses or 'no pose was heard'}")
    if out is not None:
        (out / "summary.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
        draw(flight, out / "flight.png", f"{airframe.vehicle} on its autopilot's simulator, seed {seed}")
        print(f"  picture: {out / 'flight.png'}\n  numbers: {out / 'summary.json'}")
    if recorder is not None:
        print(f"recording: {recorder.path}")


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
    model: Annotated[
        Path | None, typer.Option(help="sensor model file that all sensors read by, instead of the campaign's")
    ] = None,
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
    from msp_range.characterise.campaign import load_campaign
    from msp_range.characterise.collect import chosen
    from msp_range.characterise.collect import collect as collect_readings
    from msp_range.characterise.flights import is_of_flights
    from msp_range.characterise.plan import plan
    from msp_range.characterise.store import Store
    from msp_range.clock import SystemClock
    from msp_range.service import stop_signals
    from msp_sim.bench import Nobody, SimulatedBench, readings_of
    from msp_sim.show import Collecting

    if is_of_flights(campaign_file):
        _collect_flights(campaign_file, out, model, seed)
        return
    campaign = load_campaign(campaign_file)
    points = plan(campaign)
    again = chosen(points, repeat or [], "--repeat")
    # What is to be read again is not a reason to read all the rest.
    wanted = chosen(points, only or ([] if repeat else [""]), "--only")
    models, described = readings_of(campaign, model)
    bench = SimulatedBench(campaign, points, models, seed, described)
    store = Store(out, points, bench.description, bench.clock, campaign.files)
    system = SystemClock()
    started_s = system.now()
    todo = [point for point in points if point.name in again or (point.name in wanted and not store.is_done(point))]
    with stop_signals() as stopped, Collecting(todo) as shown:
        nobody = Nobody(shown.take, lambda: bool(stopped))
        try:
            collect_readings(campaign, points, bench, store, nobody, wanted, again)
        finally:
            store.close()
    table, rows = store.write_table()
    for text in nobody.texts:
        print(text)
    left = sum(not store.is_done(point) for point in points)
    print(
        f"{table}: {rows} readings, {nobody.readings} of them now in {system.now() - started_s:.1f} s; "
        f"{nobody.outliers} outliers, {nobody.failed} pings without a usable answer; "
        f"{left} of {len(points)} points are left"
    )


def _collect_flights(campaign_file: Path, out: Path, model: Path | None, seed: int) -> None:
    from msp_range.characterise.flights import Hangar, load_flights
    from msp_range.clock import VirtualClock
    from msp_range.reading_model.sensor_model import load_sensor_model
    from msp_range.recording.writer import Recorder
    from msp_sim.flight import Simulation
    from msp_sim.scenario import load_scenario

    campaign = load_flights(campaign_file)
    hangar = Hangar(out, campaign)
    sensor_model = load_sensor_model(model) if model is not None else None
    scenarios = {
        flight.flight: load_scenario(campaign_file.parent / flight.scenario)
        for flight in campaign.flights
        if flight.scenario is not None
    }
    for number, flight in enumerate(campaign.flights, start=1):
        scenario = scenarios.get(flight.flight)
        if scenario is None or hangar.recordings(flight):
            continue
        print(f"{number} of {len(campaign.flights)}: {flight.flight}, {scenario.duration_s:g} s of {scenario.name}")
        clock = VirtualClock()
        with hangar.making(flight) as path:
            files = scenario.airframe.files
            recorder = Recorder(path, clock, files=files, metadata={"scenario": scenario.name, "seed": str(seed)})
            simulation = Simulation(scenario, clock, seed + number, model=sensor_model, recorder=recorder)
            for _ in simulation.fly():
                pass
            recorder.close()
    table, rows = hangar.write_table()
    print(f"{table}: {rows} readings of {len(scenarios)} flights")


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
    from rich.console import Console

    from msp_sim.filter_study.explain import explain
    from msp_sim.filter_study.goals import goals
    from msp_sim.filter_study.publish import publish
    from msp_sim.filter_study.show import print_explanations, print_goals, print_tables
    from msp_sim.filter_study.study import delays, study
    from msp_sim.filter_study.table import read_table, report_table

    rows = report_table() if table is None else read_table(table)
    if out is not None:
        make_folder(out)
    console = Console()
    if not console.is_terminal:
        console = Console(width=120)
    with console.status("comparing filters"):
        results = study(seeds, seed)
    with console.status("explaining the table"):
        reverse, verdicts = explain(rows)
    print_tables(console, verdicts, delays(results))
    print_explanations(console, reverse, verdicts)
    print_goals(console, goals(results))
    if out is not None:
        for path in publish(out, results, reverse, verdicts, seed):
            print(f"written: {path}")


def make_folder(folder: Path) -> None:
    """Make a folder for results where it is not there; ConfigError where that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: this folder cannot be made: {error.strerror}") from None


app.add_typer(gap_app)


def main() -> None:
    """Entry point of the command."""
    app()
