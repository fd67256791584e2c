"""The command ``msp-sim fly``: fly a scenario, show it meanwhile, and write the results.

It prints lines on the terminal, and writes files into the folder for results.
"""

from contextlib import ExitStack, closing, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.live import Live

from msp_range.clock import SystemClock, VirtualClock
from msp_range.config import check_link
from msp_range.log import Log
from msp_range.mavlink.transport import open_transport
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.service import stop_signals
from msp_range.terminal import console
from msp_range.watch.place import Outputs, own_socket
from msp_range.watch.watch import Watch
from msp_range.yaml_file import config_path, read_yaml
from msp_sim.flight import show
from msp_sim.flight.autopilot import Tee
from msp_sim.flight.flight import Simulation
from msp_sim.flight.results import RECORDING, SCENARIO, TLOG, Results
from msp_sim.flight.sampled import Sampled
from msp_sim.flight.scenario import Scenario, load_scenario
from msp_sim.flight.simulate import recorder_of
from msp_sim.flight.summary import summarise


@dataclass(frozen=True)
class PlannedFlight:
    """A flight that the options of a command name."""

    scenario: Scenario
    text: bytes
    """The scenario as a file."""
    seed: int
    """Random seed of this flight."""
    title: str
    """Its name for people."""
    given_seed: int
    """The seed that the command was given; a sampled flight has it in common with all other samples."""
    drawn: dict[str, Any]
    """For the summary of a sampled flight: what was drawn."""
    model: SensorModel | None
    """Sensor model for all sensors; None: the airframe's."""


def planned_flight(scenario_file: Path, model: Path | None, seed: int, sample: int | None = None) -> PlannedFlight:
    """The flight of a scenario, or that number of its samples.

    Raises
    ------
    ConfigError
        A file cannot be used, or the sample cannot be drawn.
    """
    scenario_file = config_path(scenario_file, "scenarios")
    scenario = load_scenario(scenario_file)
    text, flight_seed, drawn, number = scenario_file.read_bytes(), seed, {}, ""
    if sample is not None:
        sampled = Sampled(scenario, str(scenario_file)).sample(seed, sample)
        scenario, flight_seed = sampled.scenario, sampled.seed
        text = sampled.text(read_yaml(scenario_file)["airframe"]).encode()
        drawn = {"sample": {"number": sample, "values": dict(sampled.values), "faults": list(sampled.faults)}}
        number = f", flight {sample}"
    sensor_model = load_sensor_model(model) if model is not None else None
    return PlannedFlight(
        scenario, text, flight_seed, f"{scenario.name}, seed {seed}{number}", seed, drawn, sensor_model
    )


def fly_scenario(
    planned: PlannedFlight,
    results: Results | None,
    link: str | None = None,
    realtime: bool = False,
    speed: float | None = None,
    web: str | None = None,
) -> None:
    """Fly a scenario; the parameters are the options of the command."""
    if link is not None:
        check_link(link)
    system, scenario = SystemClock(), planned.scenario
    clock = system if realtime else VirtualClock()
    recorder = None
    if results is not None:
        results.make_ready()
        recorder = recorder_of(results.folder / RECORDING, scenario, clock, planned.seed, waits=not realtime)
    simulation = Simulation(
        scenario,
        clock,
        planned.seed,
        model=planned.model,
        recorder=recorder,
        link=(lambda autopilot: Tee(open_transport(link, system), autopilot)) if link is not None else None,
    )
    if results is not None:
        simulation.transport.open_log(results.folder / TLOG)
    started_s = system.now()
    with ExitStack() as opened:
        watch = None
        if web is not None:
            place = simulation.bridge, simulation.transport, Outputs(None, own_socket(), web)
            watch = opened.enter_context(closing(Watch(*place, clock.now(), Log("text"))))
        _fly_shown(simulation, show.FlightDisplay(simulation, scenario.duration_s), watch, speed)
    wall_s = system.now() - started_s
    summary = summarise(simulation.flight, scenario.name, planned.given_seed) | planned.drawn
    show.print_table(console(), summary)
    times = summary["duration_s"] / wall_s
    held = "" if speed is None else f", limited to {speed:g}"
    print(f"{summary['duration_s']:.1f} s of flight in {wall_s:.1f} s: {times:.0f} times real time{held}")
    if simulation.transport.last_error is not None:
        print(f"link {link}: {simulation.transport.last_error}")
    if results is not None:
        summary["wall"] = {"seconds": round(wall_s, 3), "times_real_time": round(times, 1)}
        (results.folder / SCENARIO).write_bytes(planned.text)
        results.write(summary, simulation.flight, planned.title)
        print(f"     link: {results.folder / TLOG}")
    if recorder is not None:
        recorder.close()
        print(f"recording: {recorder.file.path}")


def _fly_shown(simulation: Simulation, shown: show.FlightDisplay, watch: Watch | None, speed: float | None) -> None:
    """Fly to the end or to a signal, with a display on a terminal, and elsewhere lines; no faster than ``speed``."""
    system, out_to = SystemClock(), console()
    started_s = next_refresh_s = system.now()
    live: Any = Live(shown, console=out_to, auto_refresh=False) if out_to.is_terminal else nullcontext()
    with stop_signals() as stopped, live, closing(simulation.fly()) as flying:
        for steps in flying:
            if stopped:
                break
            shown.update(steps)
            if watch is not None:
                watch.service(simulation.clock.now())
            if steps and speed is not None:
                system.sleep_until(started_s + simulation.now_s() / speed)
            if out_to.is_terminal:
                if system.now() >= next_refresh_s:
                    next_refresh_s = system.now() + show.REFRESH_S
                    live.refresh()
            elif steps and (line := shown.line()) is not None:
                print(line)
        if out_to.is_terminal:
            live.refresh()
