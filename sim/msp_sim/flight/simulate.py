"""A simulated flight for programs and notebooks: plain numbers and arrays of a scenario."""

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from msp_range.arrays import Array, Column
from msp_range.clock import Clock, VirtualClock
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.recording.writer import Recorder
from msp_range.yaml_file import config_path
from msp_sim.flight.flight import Simulation
from msp_sim.flight.flight_log import SensorTrack
from msp_sim.flight.scenario import Scenario, load_scenario
from msp_sim.flight.summary import summarise


class SimulatedFlight(NamedTuple):
    """What a simulated flight gave."""

    summary: dict[str, Any]
    """The numbers of ``summary.json``."""
    readings: dict[str, Column]
    """Columns by name, a row for each reading. `time_s`, `sensor`, `true_range_m` (what a sensor without errors would
    read), `range_m` (as the sensor gave it), `filtered_m` (after correction and filters). NaN: none."""
    fused: dict[str, Column]
    """The same for the fused distance with `time_s`, `true_range_m`, `filtered_m`."""


def simulate_flight(
    scenario: Path | str = "demo",
    *,
    seed: int = 1,
    model: Path | str | None = None,
    recording: Path | str | None = None,
) -> SimulatedFlight:
    """Fly a scenario with the real bridge in virtual time, as ``msp-sim fly`` does.

    Parameters
    ----------
    scenario
        A scenario file, or the name of one that comes with the package.
    seed
        Random seed; the same gives the same flight.
    model
        Sensor model for all sensors, instead of the airframe's.
    recording
        File to record to (.mcap), which the laboratory's functions read; it must not exist.

    Raises
    ------
    ConfigError
        A file that cannot be used.
    RecordingError
        The recording exists already, or cannot be made.

    Examples
    --------
    >>> flight = simulate_flight("flat", seed=1)
    >>> sorted(flight.readings)
    ['filtered_m', 'range_m', 'sensor', 'time_s', 'true_range_m']
    >>> error_m = flight.fused["filtered_m"] - flight.fused["true_range_m"]
    >>> bool(np.nanstd(error_m) < 0.1)
    True
    """
    loaded = load_scenario(config_path(scenario, "scenarios"))
    sensor_model = None if model is None else load_sensor_model(model)
    with threadpool_limits(limits=1):
        flight = fly_through(loaded, seed, sensor_model, recording).flight
    return SimulatedFlight(summarise(flight, loaded.name, seed), _readings(flight.tracks), _track(flight.fused))


def recorder_of(path: Path | str, scenario: Scenario, clock: Clock, seed: int, *, waits: bool = True) -> Recorder:
    """A recorder of a scenario's flight, which names both; raises RecordingError as `Recorder`."""
    metadata = {"scenario": scenario.name, "seed": str(seed)}
    return Recorder(path, clock, files=scenario.airframe.files, metadata=metadata, waits=waits)


def fly_through(
    scenario: Scenario, seed: int, model: SensorModel | None = None, recording: Path | str | None = None
) -> Simulation:
    """Fly a scenario to its end in virtual time, and record it if a file is named; return the finished flight.

    Raises
    ------
    RecordingError
        The recording exists already, or cannot be made.
    """
    clock = VirtualClock()
    recorder = None if recording is None else recorder_of(recording, scenario, clock, seed)
    simulation = Simulation(scenario, clock, seed, model=model, recorder=recorder)
    with closing(simulation.fly()) as flying:
        for _ in flying:
            pass
    if recorder is not None:
        recorder.close()
    return simulation


def _readings(tracks: dict[str, SensorTrack]) -> dict[str, Column]:
    """The readings of all sensors, in the order of time."""
    parts = [
        {**_track(track), "range_m": _numbers(track.raw_m), "sensor": np.full(len(track.time_s), name)}
        for name, track in tracks.items()
    ]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    order = np.argsort(columns["time_s"], kind="stable")
    return {name: column[order] for name, column in columns.items()}


def _track(track: SensorTrack) -> dict[str, Column]:
    return {
        "time_s": _numbers(track.time_s),
        "true_range_m": _numbers(track.truth_m),
        "filtered_m": _numbers(track.filtered_m),
    }


def _numbers(values: Sequence[float | None]) -> Array:
    return np.array(values, dtype=np.float64)
