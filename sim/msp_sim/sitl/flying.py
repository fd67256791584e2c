"""The command ``msp-sim sitl``: fly with an autopilot's own simulator, and write the results.

It prints lines on the terminal, and writes files into the folder for results.
"""

from collections.abc import Sequence
from contextlib import ExitStack, closing, nullcontext
from pathlib import Path

from msp_range.clock import SystemClock
from msp_range.config import Airframe
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.service import flight_recorder, stop_signals
from msp_range.terminal import console
from msp_range.yaml_file import ConfigError
from msp_sim.flight import show
from msp_sim.flight.results import Results
from msp_sim.flight.scenario import load_scenario
from msp_sim.flight.summary import summarise
from msp_sim.sitl.sitl import Scene, Sitl, landed_clearance_m, start_line, status_line
from msp_sim.world.surfaces import GroundSection
from msp_sim.world.world import AirSection, World

LOG_PERIOD_S = 5.0
"""Wall time between two status lines if the output is not a terminal [s]."""


def load_scene(ground: Path | None, clearance_m: float | None, airframe: Airframe, airframe_file: Path) -> Scene:
    """The ground, air and faults of a scenario file, or flat ground without faults.

    Parameters
    ----------
    clearance_m
        Height of the vehicle's reference point above the ground when landed [m]; None: such that the lowest sensor
        reads its minimum.

    Raises
    ------
    ConfigError
        The file cannot be used, or it has a fault of a sensor that the airframe does not have.
    """
    if clearance_m is None:
        clearance_m = landed_clearance_m(airframe)
    if ground is None:
        return Scene(World(GroundSection(), AirSection()), clearance_m)
    scenario = load_scenario(ground)
    faults = scenario.device_faults()
    names = [sensor.name for sensor in airframe.sensors]
    for name in faults:
        if name not in names:
            raise ConfigError(
                f"{ground}: faults: found sensor {name!r}; expected one of {airframe_file}: {', '.join(names)}"
            )
    return Scene(scenario.world(), clearance_m, scenario.flight.track.start_m, faults)


def fly_sitl(
    airframe: Airframe,
    scene: Scene,
    model: Path | None,
    seed: int,
    duration: float | None,
    record: Path | None,
    results: Results | None,
) -> None:
    """Fly with an autopilot's own simulator; the parameters are the options of the command."""
    sensor_model = load_sensor_model(model) if model is not None else None
    if results is not None:
        results.make_ready()
    clock = SystemClock()
    with ExitStack() as opened:
        stopped = opened.enter_context(stop_signals())
        recorder = None
        if record is not None:
            recorder = flight_recorder(airframe, record, clock, lambda path: print(f"recording: {path}"), print)
        if recorder is not None:
            opened.callback(recorder.close)
        simulation = opened.enter_context(closing(Sitl(airframe, clock, scene, seed, sensor_model, recorder)))
        _fly_shown(simulation, duration, stopped)
    flight = simulation.finish()
    summary = summarise(flight, airframe.vehicle, seed)
    summary["poses"] = dict(simulation.vehicle.poses_received)
    show.print_table(console(), summary)
    poses = ", ".join(f"{count} poses in {name}" for name, count in simulation.vehicle.poses_received.items())
    print(f"link: {airframe.link.url}; {poses or 'no pose was received'}")
    if results is not None:
        results.write(summary, flight, f"{airframe.vehicle} on its autopilot's simulator, seed {seed}")


def _fly_shown(simulation: Sitl, duration_s: float | None, stopped: Sequence[int]) -> None:
    """Fly for a time or to a signal, with a status line on a terminal, and lines of what changes."""
    out_to = console()
    with out_to.status("") if out_to.is_terminal else nullcontext() as status:
        period_s = LOG_PERIOD_S if status is None else show.REFRESH_S
        next_status_s = 0.0
        source: str | None = None
        start: str | None = None
        texts = 0
        while not stopped and (duration_s is None or simulation.now_s() < duration_s):
            simulation.step()
            for _, severity, text in simulation.flight.texts[texts:]:
                out_to.print(f"{severity}: {text}")
            texts = len(simulation.flight.texts)
            if simulation.vehicle.source != source:
                source = simulation.vehicle.source
                out_to.print(f"pose from {source}")
            if start_line(simulation.vehicle) != start:
                start = start_line(simulation.vehicle)
                out_to.print(start, soft_wrap=True)
            if simulation.now_s() < next_status_s:
                continue
            next_status_s = simulation.now_s() + period_s
            if status is None:
                out_to.print(status_line(simulation), soft_wrap=True)
            else:
                status.update(status_line(simulation))
