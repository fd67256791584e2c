"""What ``msp-sim fly`` and ``msp-sim sitl`` do: fly, show it while it goes on, and write what came of it.

The commands' options enter; lines on the terminal and files in the folder for results leave.
"""

import json
from contextlib import ExitStack, closing, nullcontext
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from rich.live import Live

from msp_range.clock import SystemClock, VirtualClock
from msp_range.config import load_airframe
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.transport import open_transport, parse_url
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.writer import Recorder
from msp_range.service import flight_recorder, stop_signals
from msp_range.terminal import console
from msp_range.yaml_file import ConfigError
from msp_sim.flight import show
from msp_sim.flight.autopilot import Tee
from msp_sim.flight.flight import Simulation
from msp_sim.flight.flight_log import Flight
from msp_sim.flight.scenario import load_scenario
from msp_sim.flight.summary import summarise
from msp_sim.sitl.sitl import Sitl, start_line, status_line
from msp_sim.terminal import make_folder
from msp_sim.world.surfaces import Ground
from msp_sim.world.world import Air, World

SHOWN_EACH_S = 0.1
"""Wall time between two looks at a flight [s]."""
LOGGED_EACH_S = 5.0
"""The same where nobody looks: the output goes into a file [s]."""
RECORDING, TLOG, NUMBERS, PICTURE, SCENARIO = "flight.mcap", "link.tlog", "summary.json", "flight.png", "scenario.yaml"
"""Names of the files in the folder of a flight."""


def fly_scenario(
    scenario_file: Path,
    model: Path | None,
    seed: int,
    out: Path | None,
    link: str | None,
    realtime: bool,
    speed: float | None,
    force: bool,
) -> None:
    """Fly a scenario; the parameters are the options of the command."""
    scenario = load_scenario(scenario_file)
    scenario_text = scenario_file.read_bytes()
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
        _make_ready(out, force)
        recorder = Recorder(
            out / RECORDING,
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
        tlog=out / TLOG if out is not None else None,
    )
    out_to = console()
    shown = show.Live(simulation, scenario.duration_s)
    started_s = next_look_s = system.now()
    live: Any = Live(shown, console=out_to, auto_refresh=False) if out_to.is_terminal else nullcontext()
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
            if out_to.is_terminal:
                if system.now() >= next_look_s:
                    next_look_s = system.now() + SHOWN_EACH_S
                    live.refresh()
            elif steps and (line := shown.line()) is not None:
                print(line)
        if out_to.is_terminal:
            live.refresh()
    wall_s = system.now() - started_s
    summary = summarise(simulation.flight, scenario.name, seed)
    show.print_table(out_to, summary)
    times = summary["duration_s"] / wall_s
    held = "" if speed is None else f", held at {speed:g}"
    print(f"{summary['duration_s']:.1f} s of flight in {wall_s:.1f} s: {times:.0f} times real time{held}")
    if simulation.link_error is not None:
        print(f"link {link}: {simulation.link_error}")
    if out is not None:
        summary["wall"] = {"seconds": round(wall_s, 3), "times_real_time": round(times, 1)}
        (out / SCENARIO).write_bytes(scenario_text)
        _write(out, summary, simulation.flight, f"{scenario.name}, seed {seed}")
        print(f"     link: {out / TLOG}")
    if recorder is not None:
        recorder.close()
        print(f"recording: {recorder.path}")


def fly_sitl(
    airframe_file: Path,
    link: str | None,
    autopilot: Autopilot | None,
    model: Path | None,
    seed: int,
    ground: Path | None,
    ground_clearance: float | None,
    duration: float | None,
    record: Path | None,
    out: Path | None,
    force: bool,
) -> None:
    """Fly with an autopilot's own simulator; the parameters are the options of the command."""
    airframe = load_airframe(airframe_file).changed(link=link, autopilot=autopilot)
    sensor_model = load_sensor_model(model) if model is not None else None
    scenario = load_scenario(ground) if ground is not None else None
    faults = scenario.device_faults() if scenario is not None else {}
    for name in faults:
        if name not in (sensors := [sensor.name for sensor in airframe.sensors]):
            raise ConfigError(
                f"{ground}: faults: found sensor {name!r}; expected one of {airframe_file}: {', '.join(sensors)}"
            )
    if out is not None:
        _make_ready(out, force)
    out_to = console()
    clock = SystemClock()
    with ExitStack() as opened:
        stopped = opened.enter_context(stop_signals())
        recorder = None
        if record is not None:
            recorder = flight_recorder(airframe, record, clock, lambda path: print(f"recording: {path}"), print)
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
            faults=faults,
            recorder=recorder,
            report=lambda severity, text: out_to.print(f"{severity.name.lower()}: {text}", highlight=False),
        )
        status = opened.enter_context(out_to.status("")) if out_to.is_terminal else None
        next_look_s = 0.0
        source: str | None = None
        start: str | None = None
        while not stopped and (duration is None or simulation.now_s() < duration):
            simulation.step()
            if simulation.vehicle.source != source:
                source = simulation.vehicle.source
                out_to.print(f"pose from {source}", highlight=False)
            if start_line(simulation.vehicle) != start:
                start = start_line(simulation.vehicle)
                out_to.print(start, highlight=False, soft_wrap=True)
            if simulation.now_s() < next_look_s:
                continue
            if status is not None:
                next_look_s = simulation.now_s() + SHOWN_EACH_S
                status.update(status_line(simulation))
            else:
                next_look_s = simulation.now_s() + LOGGED_EACH_S
                out_to.print(status_line(simulation), highlight=False, soft_wrap=True)
    flight = simulation.finish()
    summary = summarise(flight, airframe.vehicle, seed)
    summary["poses"] = dict(simulation.vehicle.heard)
    show.print_table(out_to, summary)
    poses = ", ".join(f"{count} poses in {name}" for name, count in simulation.vehicle.heard.items())
    print(f"link: {airframe.link.url}; {poses or 'no pose was heard'}")
    if out is not None:
        _write(out, summary, flight, f"{airframe.vehicle} on its autopilot's simulator, seed {seed}")


def _make_ready(folder: Path, force: bool) -> None:
    """Make the folder of a flight, and say at once what will be missing from it.

    Raises
    ------
    ConfigError
        It holds a flight, and ``force`` is not given; or it cannot be made.
    """
    make_folder(folder)
    there = [folder / name for name in (RECORDING, TLOG, NUMBERS, PICTURE, SCENARIO) if (folder / name).exists()]
    if there and not force:
        raise ConfigError(f"{there[0]}: a flight is in this folder already; name another one, or replace it: --force")
    for path in there:
        path.unlink()
    if not _can_draw():
        print("matplotlib is missing, so no picture will be drawn; pip install 'msp-range[lab]' brings it")


def _can_draw() -> bool:
    return find_spec("matplotlib") is not None


def _write(folder: Path, summary: dict[str, Any], flight: Flight, title: str) -> None:
    """The flight as numbers and, where matplotlib is there, as a picture; and where they are."""
    (folder / NUMBERS).write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    print(f"  numbers: {folder / NUMBERS}")
    if _can_draw():
        # Imported late: matplotlib comes with the extra 'lab', which a flight does not need.
        from msp_sim.flight.flight_picture import draw

        draw(flight, folder / PICTURE, title)
        print(f"  picture: {folder / PICTURE}")
