"""The readings that a model is held against: files and recordings enter, checked readings and what was noticed leave.

Whatever makes a comparison impossible is told here in a line, before any work: another unit, no reference, hardly any
readings. What only narrows it is told too, and goes on: what has no answer or no reference is left out, readings off
the model's grid are rounded, point masses that the model does not declare are set aside as calibration.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap.findings import Calibration, Source
from msp_lab.gap.units import numbered
from msp_lab.readings.column_map import ColumnMap
from msp_lab.readings.gather import check_comparable, joined, read_table, sha256
from msp_range.reading_model.sensor_model import SATURATED_CM
from msp_range.recording.csv_form import Column, MeasuredData
from msp_range.recording.error import RecordingError
from msp_range.yaml_file import ConfigError
from msp_sim.model.model import Model

_Words = NDArray[np.str_]

PREVIOUS = "previous_reading_cm"
FEW_RUNS = 4
"""With fewer runs, what differs from run to run cannot be told from what differs inside them."""
POINT_MASS_SHARE = 0.001
"""Of all readings; a rarer value is no code."""
POINT_MASS_TIMES = 8.0
"""How many times as frequent as the values beside it a point mass is, among readings that are no hits."""
NARROW_TIMES = 30.0
"""And than the more frequent of the two next to it: what stands in the beam is narrow, and no point."""
FAR_SIGMAS = 6.0
RELATIVE = 1e-9
"""Of a number: what differs by less does not differ."""


@dataclass(frozen=True)
class Readings:
    """What is compared.

    Attributes
    ----------
    data
        Rows with a reading and a true range; `run` is there, and `previous_reading_cm`.
    sources
        The files.
    calibration
        What belongs to the model's grid and codes.
    messages
        What was left out or noticed, a sentence each.
    constant
        Context columns that never change, with their value.
    """

    data: MeasuredData
    sources: tuple[Source, ...]
    calibration: tuple[Calibration, ...] = ()
    messages: tuple[str, ...] = ()
    constant: tuple[tuple[str, str], ...] = ()


def read_readings(
    paths: Sequence[Path], model: Model, column_map: ColumnMap | None = None, run_column: str | None = None
) -> Readings:
    """Read and check all files.

    Parameters
    ----------
    paths
        CSV files in the one form, recordings with a reference, or with a map other people's tables.
    model
        What they are to be held against.
    column_map
        Names and units of the columns.
    run_column
        The column that tells runs apart; None: `run`, and where there is none each file is one.

    Raises
    ------
    RecordingError
        A file cannot be read or compared; in a line, with what to do.
    ConfigError
        There is no such column.
    """
    tables: list[MeasuredData] = []
    sources: list[Source] = []
    notes = [column_map.note] if column_map is not None and column_map.note else []
    for path, name in zip(paths, _names(paths), strict=True):
        table = read_table(path, model.sensor, column_map, notes)
        digest = sha256(path)
        same = next((each.path for each in sources if each.sha256 == digest), None)
        if same is not None:
            raise RecordingError(f"{path}: has the same content as {same}; each reading may count once")
        tables.append(_with_run(table, path, name, run_column))
        sources.append(Source(str(path), digest, len(table)))
    columns = dict(joined(tables).columns)
    del table, tables
    check_comparable(", ".join(str(path) for path in paths), _within(columns), model.sensor)
    _settle(columns)
    messages = _clean(columns)
    data = MeasuredData(columns)
    data, calibration = _on_grid(data, model)
    data, codes = _without_codes(data, model)
    constant = _constant(data)
    messages = [*notes, *messages, *_about_contexts(constant), *_about_runs(data["run"])]
    return Readings(data, tuple(sources), (*calibration, *codes), tuple(messages), constant)


def _names(paths: Sequence[Path]) -> list[str]:
    """A name for each file: its own, with as many of its folders before it as tell it from the others."""
    parts = [(*path.resolve().parts[1:-1], path.name.split(".")[0]) for path in paths]
    for depth in range(1, max((len(each) for each in parts), default=0) + 1):
        names = ["/".join(each[-depth:]) for each in parts]
        if len(set(names)) == len(names):
            return names
    return [path.name for path in paths]


def _with_run(table: MeasuredData, path: Path, name: str, run_column: str | None) -> MeasuredData:
    columns = dict(table.columns)
    if run_column is not None:
        if run_column not in table:
            raise ConfigError(f"--run-column {run_column}: {path} has the columns {', '.join(table.columns)}")
        named = table[run_column]
        numbers = named.dtype.kind in "fiub"
        columns["run"] = np.array([f"{each:g}" for each in named.tolist()]) if numbers else named
    elif "run" not in table:
        columns["run"] = np.full(len(table), name)
    else:
        # A recording calls its run by its file's name.
        of_file = (table["run"] == "") | (table["run"] == path.name.split(".")[0])
        columns["run"] = np.where(of_file, name, table["run"])
    return MeasuredData(columns)


def _within(columns: Mapping[str, Column]) -> MeasuredData:
    """Without codes that no distance can be, so that units are judged by distances."""
    reading_cm = columns["reading_cm"]
    return MeasuredData({**columns, "reading_cm": np.where(reading_cm >= 32768.0, np.nan, reading_cm)})


def _settle(columns: dict[str, Column]) -> None:
    """Take off what arithmetic adds to a number that never changes: 100.00000000000142 is 100."""
    for name, column in columns.items():
        if column.dtype.kind == "f" and np.isfinite(column).any():
            low, high = float(np.nanmin(column)), float(np.nanmax(column))
            if low < high <= low + RELATIVE * max(abs(low), abs(high)):
                columns[name] = np.where(np.isnan(column), np.nan, float(f"{low:.9g}"))


def _keep(columns: dict[str, Column], rows: NDArray[Any]) -> None:
    """Some of the rows, column by column: many readings are there once, and not twice."""
    for name in columns:
        columns[name] = columns[name][rows]


def _clean(columns: dict[str, Column]) -> list[str]:
    """Keep the rows that can be compared, in the order in which they were made, each with the reading before it."""
    messages = []
    order = np.lexsort((columns["time_s"], numbered(columns["sensor"]), numbered(columns["run"])))
    if (order[1:] < order[:-1]).any():
        _keep(columns, order)
    same = np.zeros(order.size, dtype=bool)
    first = _changes(columns["sensor"]) | _changes(columns["run"])
    same[1:] = (columns["time_s"][1:] == columns["time_s"][:-1]) & ~first[1:]
    if same.any():
        twice = same.copy()
        for column in columns.values():
            both = column[1:] == column[:-1]
            if column.dtype.kind == "f":
                both |= np.isnan(column[1:]) & np.isnan(column[:-1])
            twice[1:] &= both
        if twice.any():
            _keep(columns, ~twice)
            first = first[~twice]
            messages.append(f"{twice.sum()} rows are there twice, and count once.")
        if (same & ~twice).any():
            messages.append(
                f"{int((same & ~twice).sum())} readings of one sensor have the time of the one before: their order is "
                "that of the file."
            )
    reading_cm = columns["reading_cm"]
    # What was sorted by run and sensor has a new series where either changes.
    columns[PREVIOUS] = np.where(first, np.nan, np.concatenate([[np.nan], reading_cm[:-1]]))
    silent, lost = np.isnan(reading_cm), np.isnan(columns["true_range_cm"])
    if silent.any():
        messages.append(f"{silent.sum()} rows have no reading (no answer) and are left out.")
    if (lost & ~silent).any():
        messages.append(f"{(lost & ~silent).sum()} readings have no true range and are left out.")
    kept = ~(silent | lost)
    if not kept.all():
        _keep(columns, kept)
    return messages


def _changes(words: NDArray[Any]) -> NDArray[np.bool_]:
    changed = np.ones(words.size, dtype=bool)
    changed[1:] = words[1:] != words[:-1]
    return changed


def _on_grid(data: MeasuredData, model: Model) -> tuple[MeasuredData, list[Calibration]]:
    reading_cm = data["reading_cm"]
    whole = np.rint(reading_cm)
    off = reading_cm != whole
    if not off.any():
        return data, _coarse(reading_cm, model)
    step = _step_cm(reading_cm)
    finding = (
        f"{100.0 * off.mean():.3g} % of the readings are no whole centimetres"
        + ("" if step is None else f" (their step is {step:g} cm)")
        + f", which is what {model.sensor.name} is said to read; they are rounded before they are compared, and what "
        "is below a centimetre is not seen"
    )
    columns = {**data.columns, "reading_cm": whole, PREVIOUS: np.rint(data[PREVIOUS])}
    return MeasuredData(columns), [Calibration("resolution", finding, before=1.0, after=step, unit="cm")]


def _step_cm(reading_cm: NDArray[Any]) -> float | None:
    """The step of readings that are finer than a centimetre, where it is a usual one."""
    for step in (0.5, 0.254, 0.2, 0.1, 0.05, 0.01):
        if np.allclose(reading_cm[:2000] / step, np.rint(reading_cm[:2000] / step), atol=1e-6):
            return step
    return None


def _coarse(reading_cm: NDArray[Any], model: Model) -> list[Calibration]:
    """Readings on a coarser grid than the model's."""
    usual = reading_cm[(reading_cm > model.sensor.minimum_cm) & (reading_cm < model.sensor.maximum_cm)]
    for step in (10, 5, 4, 3, 2):
        if usual.size >= 50 and np.unique(usual).size > 5 and (np.mod(usual, step) == 0).mean() > 0.99:
            text = f"the readings come in steps of {step} cm, and the model's in steps of 1 cm"
            return [Calibration("resolution", text, before=1.0, after=float(step), unit="cm")]
    return []


def _without_codes(data: MeasuredData, model: Model) -> tuple[MeasuredData, list[Calibration]]:
    """Set aside the values that come again and again whatever the range is, and that the model has no code for."""
    reading_cm, sensor = data["reading_cm"], model.sensor
    centre = model.base.calibration.forward(data["true_range_cm"])
    far = np.abs(reading_cm - centre) > FAR_SIGMAS * sensor.reading_model.sigma_cm + 0.03 * centre + 2.0
    values, counts = np.unique(reading_cm[far], return_counts=True)
    declared = {float(sensor.minimum_cm), float(sensor.maximum_cm), float(SATURATED_CM)}
    codes = []
    for value, count in zip(values.tolist(), counts.tolist(), strict=True):
        # An offset or a fault of the code is an effect's business: a point mass comes at ranges that differ.
        if value in declared or count < max(5.0, POINT_MASS_SHARE * reading_cm.size):
            continue
        beside = counts[(np.abs(values - value) <= 3.0) & (values != value)].sum() / 6.0
        next_to = counts[np.abs(values - value) == 1.0].max(initial=0)
        here = data["true_range_cm"][reading_cm == value]
        alone = count > max(POINT_MASS_TIMES * (beside + 1.0), NARROW_TIMES * next_to)
        if alone and np.ptp(here) > 0.2 * max(np.ptp(data["true_range_cm"]), 1.0):
            codes.append(value)
    if not codes:
        return data, []
    is_code = np.isin(reading_cm, codes)
    if is_code.mean() > 0.9:
        return data, []
    found = [
        Calibration(
            "code",
            f"{value:g} cm comes in {100.0 * np.mean(reading_cm == value):.3g} % of the readings, at true ranges of "
            f"{data['true_range_cm'][reading_cm == value].min():.0f} to "
            f"{data['true_range_cm'][reading_cm == value].max():.0f} cm: a code that the model does not declare; "
            "these readings are set aside",
            before=0.0,
            after=float(np.mean(reading_cm == value)),
            unit="1",
        )
        for value in codes
    ]
    return data.select(~is_code), found


def _constant(data: MeasuredData) -> tuple[tuple[str, str], ...]:
    found = []
    for name, column in data.columns.items():
        if name in ("reading_cm", "time_s", PREVIOUS, "run", "sensor"):
            continue
        known = column[~np.isnan(column)] if column.dtype.kind == "f" else column[column != ""]
        if known.size and (known == known[0]).all():
            found.append((name, f"{known[0]:g}" if column.dtype.kind == "f" else str(known[0])))
    return tuple(found)


def _about_contexts(constant: Sequence[tuple[str, str]]) -> list[str]:
    found = []
    for name, value in constant:
        if name == "true_range_cm":
            found.append(
                f"All readings are at one true range ({value} cm): what grows with range cannot be told from an offset."
            )
        else:
            found.append(f"{name} is {value} throughout: what depends on it cannot be told from what does not.")
    return found


def _about_runs(run: _Words) -> list[str]:
    runs = np.unique(run).size
    if runs >= FEW_RUNS:
        return []
    what = "1 run" if runs == 1 else f"{runs} runs"
    return [
        f"Found {what}: what is constant in a run but differs between runs (an offset of a session, a thermometer) "
        "cannot be judged; blocks of readings stand in for runs."
    ]
