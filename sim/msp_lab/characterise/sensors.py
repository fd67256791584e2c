"""A model from the readings of a sensor, or one for each of several, on one processor or several (`--each sensor`).

Each sensor's readings are read where its model is made: the workers of a cluster need the files, and the folders that
they write to, under the same path.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from numpy.random import default_rng

from msp_lab.characterise.analysis import characterise
from msp_lab.characterise.findings import Findings, as_json
from msp_lab.characterise.model_file import changed, commented, write_new
from msp_lab.characterise.points import PointReadings
from msp_lab.readings.column_map import load_maps
from msp_lab.readings.intake import load_readings, sensors_in, without_impossible
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.yaml_file import ConfigError

NUMBERS, PAGE, TABLE = "findings.json", "report.html", "sensors.csv"


@dataclass(frozen=True)
class Characterisation:
    """What a model is made from, and how."""

    data: tuple[Path, ...]
    start: Path
    """Files of readings, and of the starting model."""
    column_map: tuple[str, ...]
    truth: Literal["recorded", "others"]
    """Options ``--map`` and ``--truth``."""
    date: str
    seed: int
    """Date to record, and random seed of the goodness-of-fit test."""
    reference_std_cm: float | None = None
    set_up_std_cm: float | None = None
    """As for `msp_lab.characterise.analysis.characterise`."""

    def sensors(self) -> list[str]:
        """Names of the sensors in the readings."""
        return sensors_in(self.data, load_sensor_model(self.start), load_maps(self.column_map), truth=self.truth)


@dataclass(frozen=True)
class SensorResult:
    """A model, what was found, which fields of the starting model (its file's name) were changed, and its points."""

    model: SensorModel
    findings: Findings
    changes: Mapping[str, Any]
    points: Sequence[PointReadings]
    start: str

    def write(self, path: Path) -> None:
        """Write the model file; RecordingError if there is a file already, or it cannot be written."""
        write_new(path, commented(self.model, self.findings, self.changes, self.start))

    def publish(self, folder: Path) -> Path:
        """Write all numbers and the page, and return the page; UserError if they cannot be written."""
        write_new(folder / NUMBERS, as_json(self.findings))
        from msp_lab.characterise.page.picture_data import PictureData
        from msp_lab.characterise.page.write import write_report

        return write_report(PictureData(self.findings, self.points, self.model), folder)


def check_free(out: Path, folder: Path | None) -> None:
    """Check before the analysis that its model file, and in the folder numbers and page, can be written.

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
) -> SensorResult:
    """Make a model from the readings of these sensors (none: all); UserError if they cannot be used."""
    start = load_sensor_model(how.start)
    loaded = load_readings(how.data, start, load_maps(how.column_map), sensors=sensors, truth=how.truth)
    loaded = without_impossible(loaded, start)
    findings, changes, points = characterise(
        loaded,
        start,
        date=how.date,
        rng=default_rng(how.seed),
        reference_std_cm=how.reference_std_cm,
        set_up_std_cm=how.set_up_std_cm,
        progress=progress,
    )
    return SensorResult(changed(start, findings, changes), findings, changes, points, how.start.name)


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
    """Make and write one sensor's model, as the first says, to a file in the first folder and a page in the second."""
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
