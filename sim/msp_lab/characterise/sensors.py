"""A model from the readings of a sensor, or one for each of several, on one processor or several (`--each sensor`).

Each sensor's readings are read where its model is made: the workers of a cluster need the files, and the folders that
they write to, under the same path.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from msp_lab.characterise.analysis import NUMBERS, PAGE, Characterisation, Characterised, characterise
from msp_lab.readings.column_map import load_maps
from msp_lab.readings.intake import load_readings, without_impossible
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.yaml_file import ConfigError

TABLE = "sensors.csv"


def check_free(out: Path, folder: Path | None) -> None:
    """Check, before the analysis, that the model file can be written, and numbers and page into the folder.

    ConfigError if one of the files exists, or its folder cannot be created or is the model file.
    """
    if folder is not None and out in (folder, *folder.parents):
        raise ConfigError(f"--report {folder}: {out} is to be the model file, expected another name for the folder")
    for path in [out] if folder is None else [out, folder / NUMBERS, folder / PAGE]:
        if path.exists():
            there = "folder" if path.is_dir() else "file"
            raise ConfigError(f"{path}: there is a {there} already, and none is overwritten")
        for parent in path.parents:
            if parent.exists() and not parent.is_dir():
                raise ConfigError(f"{path}: {parent} is a file, expected a folder")


def characterised(
    how: Characterisation, sensors: Sequence[str] = (), progress: Callable[[str], None] = lambda what: None
) -> Characterised:
    """Make a model from the readings of these sensors (none: all); UserError if they cannot be used."""
    start = load_sensor_model(how.start)
    loaded = load_readings(how.data, start, load_maps(how.column_map), sensors=sensors, truth=how.truth)
    return characterise(without_impossible(loaded, start), start, how, progress)


@dataclass(frozen=True)
class OfSensor:
    """A row of the table: the spread of a sensor's hits [cm], the shares of its readings, and its model file.

    ``error`` is why no model could be made; empty: one was.
    """

    sensor: str
    readings: int = 0
    sigma_cm: float | None = None
    short: float | None = None
    missed: float | None = None
    random: float | None = None
    model: str = ""
    error: str = ""


def characterise_sensor(common: tuple[Characterisation, Path, Path | None], sensor: str) -> OfSensor:
    """Make one sensor's model and write it; ``common`` has the options, the folder of the models, and that of the pages
    or None."""
    how, models, pages = common
    name = quote(sensor, safe="")
    path, report = models / f"{name}.yaml", pages / name if pages is not None else None
    check_free(path, report)
    made = characterised(how, [sensor])
    made.write(path)
    if report is not None:
        made.publish(report)
    sigma_cm, shares = made.model.reading_model.sigma_cm, made.model.reading_model.weights
    return OfSensor(sensor, made.findings.readings, sigma_cm, shares.short, shares.missed, shares.random, str(path))
