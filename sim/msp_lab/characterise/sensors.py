"""A model for each of several sensors, on one processor or several: `msp-lab characterise --each sensor`.

Readings of many sensors enter; a model file for each leaves, with a page and its numbers if they are wanted, and a
table. Each sensor's readings are read where its model is made: the workers of a cluster need the files, and the folders
that they write to, under the same path.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal
from urllib.parse import quote

from numpy.random import default_rng

from msp_lab.characterise.analysis import characterise
from msp_lab.characterise.findings import Findings
from msp_lab.characterise.model_file import Changes, changed, write_model
from msp_lab.characterise.publish import check_free, publish_findings
from msp_lab.readings.column_map import load_map
from msp_lab.readings.dataset import is_dataset, sensors_of
from msp_lab.readings.intake import load_readings, without_impossible
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.recording.csv_form import MeasuredData
from msp_sim.workers import Workers, write_rows

TABLE = "sensors.csv"


@dataclass(frozen=True)
class Characterisation:
    """What a model is made from, and how."""

    data: tuple[Path, ...]
    """Files of readings."""
    start: Path
    """File of the starting model."""
    column_map: tuple[str, ...]
    """Options ``--map``."""
    truth: Literal["recorded", "others"]
    """What the true range is."""
    date: str
    seed: int
    """Date to record, and random seed of the goodness-of-fit test."""
    reference_std_cm: float | None = None
    set_up_std_cm: float | None = None
    """As for `msp_lab.characterise.analysis.characterise`."""


@dataclass(frozen=True)
class SensorResult:
    """A model, what it was made from, and what was found."""

    model: SensorModel
    findings: Findings
    changes: Changes
    data: MeasuredData


def characterised(
    how: Characterisation, sensors: Sequence[str] = (), progress: Callable[[str], None] = lambda what: None
) -> SensorResult:
    """Make a model from the readings of these sensors (none: all).

    Raises
    ------
    ConfigError, RecordingError
        The readings cannot be used.
    """
    start = load_sensor_model(how.start)
    column_map = load_map(how.column_map) if how.column_map else None
    loaded = without_impossible(load_readings(how.data, start, column_map, sensors=sensors, truth=how.truth), start)
    findings, changes = characterise(
        loaded,
        start,
        date=how.date,
        rng=default_rng(how.seed),
        reference_std_cm=how.reference_std_cm,
        set_up_std_cm=how.set_up_std_cm,
        progress=progress,
    )
    return SensorResult(changed(start, findings, changes), findings, changes, loaded.data)


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


@dataclass(frozen=True)
class EachSensor:
    """What the models of several sensors have in common: how they are made, and the folders of models and pages."""

    how: Characterisation
    out: Path
    report: Path | None


def sensors_in(how: Characterisation) -> list[str]:
    """Names of the sensors in the readings."""
    if all(map(is_dataset, how.data)):
        return sorted({name for path in how.data for name in sensors_of(path)})
    column_map = load_map(how.column_map) if how.column_map else None
    data = load_readings(how.data, load_sensor_model(how.start), column_map, truth=how.truth).data
    return sorted(set(data["sensor"].tolist()))


def characterise_sensor(common: EachSensor, sensor: str) -> OfSensor:
    """Make and write one sensor's model."""
    name = quote(sensor, safe="")
    path = common.out / f"{name}.yaml"
    report = common.report / name if common.report is not None else None
    check_free(path, report)
    made = characterised(common.how, [sensor])
    write_model(path, made.model, made.findings, made.changes, common.how.start.name)
    if report is not None:
        publish_findings(made.findings, made.data, made.model, report)
    mixture = made.model.reading_model
    shares = mixture.weights
    return OfSensor(sensor, len(made.data), mixture.sigma_cm, shares.short, shares.missed, shares.random, str(path))


def characterise_sensors(common: EachSensor, sensors: Sequence[str], where: Workers) -> list[OfSensor]:
    """Make each sensor's model, and write the table."""
    outcomes = where.map(characterise_sensor, sensors, common, what="sensors")
    return list(write_rows(common.out / TABLE, OfSensor, sensors, outcomes))
