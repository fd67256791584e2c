"""The command ``msp-sim sitl``: fly with an autopilot's own simulator, and write the results.

Input are the command's options, output are lines on the terminal and files in the folder for results.
"""

from contextlib import ExitStack
from pathlib import Path

from msp_range.clock import SystemClock
from msp_range.config import load_airframe
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.transport import open_transport
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.service import flight_recorder, stop_signals
from msp_range.terminal import console
from msp_range.yaml_file import ConfigError
from msp_sim.flight import show
from msp_sim.flight.results import make_ready, write_results
from msp_sim.flight.scenario import load_scenario
from msp_sim.flight.summary import summarise
from msp_sim.sitl.sitl import Sitl, start_line, status_line
from msp_sim.world.surfaces import GroundSection
from msp_sim.world.world import AirSection, World

REFRESH_S = 0.1
"""Wall time between two updates of the status line on a terminal [s]."""
LOG_PERIOD_S = 5.0
"""Wall time between two status lines if the output is not a terminal [s]."""


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
        make_ready(out, force)
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
            scenario.world() if scenario is not None else World(GroundSection(), AirSection()),
            seed,
            model=sensor_model,
            clearance_m=ground_clearance,
            start_m=scenario.flight.track.start_m if scenario is not None else (0.0, 0.0),
            faults=faults,
            recorder=recorder,
            report=lambda severity, text: out_to.print(f"{severity.name.lower()}: {text}"),
        )
        status = opened.enter_context(out_to.status("")) if out_to.is_terminal else None
        next_status_s = 0.0
        source: str | None = None
        start: str | None = None
        while not stopped and (duration is None or simulation.now_s() < duration):
            simulation.step()
            if simulation.vehicle.source != source:
                source = simulation.vehicle.source
                out_to.print(f"pose from {source}")
            if start_line(simulation.vehicle) != start:
                start = start_line(simulation.vehicle)
                out_to.print(start, soft_wrap=True)
            if simulation.now_s() < next_status_s:
                continue
            if status is not None:
                next_status_s = simulation.now_s() + REFRESH_S
                status.update(status_line(simulation))
            else:
                next_status_s = simulation.now_s() + LOG_PERIOD_S
                out_to.print(status_line(simulation), soft_wrap=True)
    flight = simulation.finish()
    summary = summarise(flight, airframe.vehicle, seed)
    summary["poses"] = dict(simulation.vehicle.poses_received)
    show.print_table(out_to, summary)
    poses = ", ".join(f"{count} poses in {name}" for name, count in simulation.vehicle.poses_received.items())
    print(f"link: {airframe.link.url}; {poses or 'no pose was received'}")
    if out is not None:
        write_results(out, summary, flight, f"{airframe.vehicle} on its autopilot's simulator, seed {seed}")
