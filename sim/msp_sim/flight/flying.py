"""The command ``msp-sim fly``: fly a scenario, show it meanwhile, and write the results.

Input are the command's options, output are lines on the terminal and files in the folder for results.
"""

from contextlib import ExitStack, closing, nullcontext
from pathlib import Path
from typing import Any

from rich.live import Live

from msp_range.clock import Clock, SystemClock, VirtualClock
from msp_range.log import Log
from msp_range.mavlink.transport import open_transport, parse_url
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.writer import Recorder
from msp_range.service import stop_signals
from msp_range.terminal import console
from msp_range.watch.feed import FeedError
from msp_range.watch.place import Outputs, own_socket
from msp_range.watch.watch import Watch
from msp_range.yaml_file import ConfigError, config_path, read_yaml
from msp_sim.flight import show
from msp_sim.flight.autopilot import Tee
from msp_sim.flight.flight import Simulation
from msp_sim.flight.results import RECORDING, SCENARIO, TLOG, make_ready, write_results
from msp_sim.flight.sampled import Sampled
from msp_sim.flight.scenario import load_scenario
from msp_sim.flight.summary import summarise

REFRESH_S = 0.1
"""Wall time between two updates of the display [s]; smaller costs processor time."""


def fly_scenario(
    scenario_file: Path,
    model: Path | None,
    seed: int,
    out: Path | None,
    link: str | None,
    realtime: bool,
    speed: float | None,
    force: bool,
    web: str | None,
    sample: int | None = None,
) -> None:
    """Fly a scenario; the parameters are the options of the command."""
    scenario_file = config_path(scenario_file, "scenarios")
    scenario = load_scenario(scenario_file)
    scenario_text = scenario_file.read_bytes()
    flight_seed, drawn, number = seed, {}, ""
    if sample is not None:
        sampled = Sampled(scenario, str(scenario_file)).sample(seed, sample)
        scenario, flight_seed = sampled.scenario, sampled.seed
        scenario_text = sampled.text(read_yaml(scenario_file)["airframe"]).encode()
        drawn = {"sample": {"number": sample, "values": dict(sampled.values), "faults": list(sampled.faults)}}
        number = f", flight {sample}"
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
        make_ready(out, force)
        recorder = Recorder(
            out / RECORDING,
            clock,
            files=scenario.airframe.files,
            metadata={"scenario": scenario.name, "seed": str(flight_seed)},
            waits=not realtime,
        )
    simulation = Simulation(
        scenario,
        clock,
        flight_seed,
        model=sensor_model,
        recorder=recorder,
        link=(lambda autopilot: Tee(open_transport(link, system), autopilot)) if link is not None else None,
        tlog=out / TLOG if out is not None else None,
    )
    out_to = console()
    shown = show.FlightDisplay(simulation, scenario.duration_s)
    started_s = next_refresh_s = system.now()
    live: Any = Live(shown, console=out_to, auto_refresh=False) if out_to.is_terminal else nullcontext()
    with ExitStack() as opened:
        stopped = opened.enter_context(stop_signals())
        opened.enter_context(live)
        watch = None
        if web is not None:
            watch = opened.enter_context(closing(_watch(simulation, recorder, web, clock)))
        flying = opened.enter_context(closing(simulation.fly()))
        for steps in flying:
            if stopped:
                break
            shown.update(steps)
            if watch is not None:
                watch.service(clock.now())
            if steps and speed is not None:
                system.sleep_until(started_s + simulation.now_s() / speed)
            if out_to.is_terminal:
                if system.now() >= next_refresh_s:
                    next_refresh_s = system.now() + REFRESH_S
                    live.refresh()
            elif steps and (line := shown.line()) is not None:
                print(line)
        if out_to.is_terminal:
            live.refresh()
    wall_s = system.now() - started_s
    summary = summarise(simulation.flight, scenario.name, seed) | drawn
    show.print_table(out_to, summary)
    times = summary["duration_s"] / wall_s
    held = "" if speed is None else f", limited to {speed:g}"
    print(f"{summary['duration_s']:.1f} s of flight in {wall_s:.1f} s: {times:.0f} times real time{held}")
    if simulation.transport.last_error is not None:
        print(f"link {link}: {simulation.transport.last_error}")
    if out is not None:
        summary["wall"] = {"seconds": round(wall_s, 3), "times_real_time": round(times, 1)}
        (out / SCENARIO).write_bytes(scenario_text)
        write_results(out, summary, simulation.flight, f"{scenario.name}, seed {seed}{number}")
        print(f"     link: {out / TLOG}")
    if recorder is not None:
        recorder.close()
        print(f"recording: {recorder.path}")


def _watch(simulation: Simulation, recorder: Recorder | None, web: str, clock: Clock) -> Watch:
    """The page of a flight."""
    try:
        return Watch(
            simulation.bridge,
            simulation.transport,
            recorder,
            Outputs(None, own_socket(), web),
            clock.now(),
            Log("text"),
        )
    except FeedError as error:
        raise ConfigError(f"--web: {error}") from None
