"""The vehicles of a dataset: which runs are of which vehicle, and in which order they were flown.

Each sensor of each vehicle is a `Unit`. Nothing but the list of files is read.
"""

import re
from hashlib import sha256
from pathlib import Path, PurePath

from msp_lab.fleet.unit import Unit
from msp_lab.readings.dataset import is_dataset, origin, sensors_by_run
from msp_range.recording.error import RecordingError
from msp_range.yaml_file import ConfigError

MIN_VEHICLES = 4
"""A fleet has at least this many vehicles: when one is left out, mean and spread of the others are from three. Fewer:
of two nobody can say which is the odd one."""


def units_of(dataset: Path, pattern: str | None, seed: int) -> list[Unit]:
    """Every sensor of every vehicle, by name.

    Parameters
    ----------
    dataset
        Its folder.
    pattern
        Regular expression, of which the first match in a run's name, or else in its log's path, is the vehicle's name;
        None: the folder in which the log was.
    seed
        Random seed.

    Raises
    ------
    RecordingError
        This is no dataset, or it holds too few vehicles.
    ConfigError
        The expression is none, or fits no name.
    """
    if not is_dataset(dataset):
        raise RecordingError(f"{dataset}: no dataset of readings; 'msp-lab import LOGS... --out {dataset}' makes one")
    runs = origin(dataset)
    vehicle_of = {run: _vehicle(run, str(about.get("file", "")), pattern) for run, about in runs.items()}
    vehicles = sorted(set(vehicle_of.values()), key=natural)
    if len(vehicles) < MIN_VEHICLES:
        names = ", ".join(vehicles[:MIN_VEHICLES])
        raise RecordingError(
            f"{dataset}: logs of {len(vehicles)} vehicle{'s' * (len(vehicles) != 1)} ({names}), and a fleet is at "
            f"least {MIN_VEHICLES}. A vehicle is called after the folder of its logs; --vehicle 'V[0-9]+' finds its "
            "name in that of the run or log"
        )
    sessions: dict[tuple[str, str], list[str]] = {}
    for run, sensors in sensors_by_run(dataset).items():
        for sensor in sensors:
            sessions.setdefault((vehicle_of[run], sensor), []).append(run)
    version = _version(dataset)
    return [
        Unit(dataset, vehicle, sensor, tuple(sorted(sessions[vehicle, sensor], key=natural)), seed, version)
        for vehicle, sensor in sorted(sessions, key=lambda place: (natural(place[0]), natural(place[1])))
    ]


def natural(name: str) -> list[tuple[int, int | str]]:
    """Key that sorts names as people count: flight 2 before flight 10.

    Examples
    --------
    >>> sorted(["V10/2", "V9/10", "V9/2"], key=natural)
    ['V9/2', 'V9/10', 'V10/2']
    """
    parts = re.findall(r"\d+|\D+", name)
    return [(0, int(part)) if part.isdigit() else (1, part) for part in parts]


def _version(dataset: Path) -> str:
    """Hash that changes whenever a file of the dataset does."""
    about = [(str(path), path.stat()) for path in sorted(dataset.rglob("*"))]
    return sha256(repr([(name, status.st_size, status.st_mtime_ns) for name, status in about]).encode()).hexdigest()


def _vehicle(run: str, file: str, pattern: str | None) -> str:
    if pattern is None:
        return PurePath(file).parent.name or PurePath(run).parent.name or "the folder without a name"
    try:
        found = re.search(pattern, run) or re.search(pattern, file)
    except re.error as error:
        raise ConfigError(f"--vehicle {pattern}: no regular expression: {error}") from None
    if found is None:
        raise ConfigError(f"--vehicle {pattern}: fits neither the run {run!r} nor its log {file!r}")
    return found.group(0)
