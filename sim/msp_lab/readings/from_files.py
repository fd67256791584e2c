"""Readings for programs and notebooks: files as plain columns."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, TypeAlias

from msp_lab.readings.column_map import load_maps
from msp_lab.readings.intake import load_readings
from msp_range.arrays import Column
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.sensors.table import DRIVERS
from msp_range.yaml_file import config_path

Files: TypeAlias = Path | str | Sequence[Path | str]
"""One file of readings or several: CSV, a recording (.mcap), or a dataset of ``msp-lab import``."""
Columns: TypeAlias = Mapping[str, str] | Path | str
"""Names of another table's columns: {"reading_cm": "distance_mm*0.1"}, or a map file."""


def read_readings(
    files: Files,
    sensor: Path | str = "mb1242",
    *,
    columns: Columns | None = None,
    truth: Literal["recorded", "others"] = "recorded",
) -> dict[str, Column]:
    """Read and check readings.

    Parameters
    ----------
    files
        One file or several.
    sensor
        Sensor model, whose limits show whether units are right.
    columns
        Where another table's columns are.
    truth
        The true range as it was recorded, or for each sensor what the other ones say.

    Returns
    -------
    dict
        Columns of the CSV form by name, arrays of one length: `reading_cm`, `true_range_cm`, `run` and context.

    Raises
    ------
    UserError
        A file cannot be used; in a line, with what to do.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> folder = TemporaryDirectory()
    >>> table = Path(folder.name, "ruler.csv")
    >>> lines = [f"{time_s},{cm * 10 + 10},{cm}" for time_s, cm in enumerate(range(30, 400, 10))]
    >>> _ = table.write_text("\\n".join(["seconds,millimetres,ruler", *lines]))
    >>> names = {"time_s": "seconds", "reading_cm": "millimetres*0.1", "true_range_cm": "ruler"}
    >>> readings = read_readings(table, columns=names)
    >>> print(readings["reading_cm"][:3] - readings["true_range_cm"][:3])
    [1. 1. 1.]
    >>> folder.cleanup()
    """
    mapping = load_maps(map_options(columns))
    return dict(load_readings(paths_of(files), load_sensor_model(sensor), mapping, truth=truth).data.columns)


def sensor_file(sensor: Path | None) -> Path:
    """The sensor model file that an option names; without one that of the first driver."""
    return sensor or config_path(next(iter(DRIVERS)), "sensors")


def paths_of(files: Files) -> list[Path]:
    """The files as a list."""
    return [Path(files)] if isinstance(files, Path | str) else [Path(file) for file in files]


def map_options(columns: Columns | None) -> tuple[str, ...]:
    """What ``--map`` would be given."""
    if isinstance(columns, Mapping):
        return tuple(f"{name}={place}" for name, place in columns.items())
    return () if columns is None else (str(columns),)
