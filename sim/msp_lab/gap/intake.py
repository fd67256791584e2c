"""What a model is compared with: the readings of the laboratory's one intake, put onto their own grid, and split.

The rows of files that can be compared are kept, with what was noticed: rows without an answer or a true range are left
out, readings and model are put onto the grid of the readings, and point masses that the model does not declare are set
aside as calibration. Runs are split before anything is looked at.

Readings whose context is unknown are left out where an effect needs it. A blank temperature is neither the one of the
row before nor 22.5 C: what the air did to that reading is unknown, and to count it as nothing hides the effect in the
others.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.cells import Partition, partitions, varying
from msp_lab.gap.findings import CalibrationFinding, ReadingsFile, Settings
from msp_lab.gap.measures import HeldOutReadings, usable
from msp_lab.gap.runs import NO_CONTEXT, Splits, draw_splits, known_values, places_in, sample, taken
from msp_lab.mixture_fit.parameters import MIN_WEIGHT, with_floors
from msp_lab.readings.column_map import ColumnMap
from msp_lab.readings.intake import PREVIOUS, Which, load_readings, time_order
from msp_lab.readings.resolution import TOLERANCE, constants_cm, runs_and_sensors, step_of, step_with, to_step
from msp_lab.readings.suspicious import suspicious
from msp_range.arrays import Array, Column, Flags, Indices, Texts, numbered
from msp_range.reading_model.kernel import is_on_grid
from msp_range.reading_model.sensor_model import SATURATED_CM
from msp_range.recording.csv_form import MeasuredData
from msp_sim.effects.base import PATH, REFERENCE, REFERENCE_STD, Scene
from msp_sim.effects.path import ReferencePath, with_path
from msp_sim.model.model import Model
from msp_sim.page.text import counted, listed

NO_SLICES = NO_CONTEXT | {REFERENCE_STD, PATH}
SAME_CM = 1e-6
"""Readings that differ by less are the same: it is above the rounding of metres and below any resolution [cm]."""
SHOWN_RUNS = 3
"""Of runs that are left out, so many are named."""
BLANK_IS_NONE = frozenset(
    {
        "neighbour_lag_ms",
        "neighbour_range_cm",
        "external_level_db",
        "external_duty",
        "external_distance_cm",
        "external_frequency_khz",
        "condition",
        PREVIOUS,
        REFERENCE_STD,
    }
)
"""Columns in which a blank cell says that there is none: no other sensor, no source, no reading before."""


@dataclass(frozen=True)
class Readings:
    """Readings that can be compared with a model."""

    data: MeasuredData
    """Rows with a reading and a true range; they have the columns `run` and `previous_reading_cm`."""
    sources: tuple[ReadingsFile, ...]
    """The files."""
    calibration: tuple[CalibrationFinding, ...] = ()
    """What belongs to the model's grid and codes."""
    messages: tuple[str, ...] = ()
    """What was left out or noticed, a sentence each."""
    step_cm: float | None = None
    """The readings are compared in this step; None: in that of the model."""

    def in_step(self, model: Model) -> Model:
        """The model in the step of the readings."""
        return model if self.step_cm is None else model.with_step(self.step_cm)


def read_readings(
    paths: Sequence[Path], model: Model, column_map: ColumnMap | None = None, **which: Unpack[Which]
) -> Readings:
    """Read and check all files that are to be compared with a model; parameters and errors as of `load_readings`."""
    loaded = load_readings(paths, model.sensor, column_map, **which)
    # By name, so that nothing depends on the order in which the files are given.
    data = loaded.data.select(time_order(loaded.data.columns))
    # Before any row is left out: the path is known wherever the reference is.
    data = MeasuredData(with_path(data.columns))
    smoothed = _about_noise(data.columns.get(PATH))
    sources = tuple(
        ReadingsFile(str(path), source.sha256, source.rows) for path, source in zip(paths, loaded.sources, strict=True)
    )
    data, left_out = _compared_rows(data)
    data, copies = _without_copies(data)
    step_cm = step_with(data, model)
    data, calibration = _on_grid(data, model, step_cm)
    data, codes = _without_codes(data, model.with_step(step_cm))
    messages = (*loaded.messages, *smoothed, *left_out, *copies, *suspicious(loaded.data))
    messages = (*messages, *_about_contexts(data), *_about_runs(data["run"], data["time_s"]))
    return Readings(data, sources, (*calibration, *codes), messages, step_cm)


@dataclass(frozen=True)
class Comparison:
    """Readings and the model that they are compared with."""

    model: Model
    """The given model in the step of the readings, without kinds of reading at a share of 0."""
    data: Mapping[str, Column]
    """All columns of all readings, by name."""
    splits: Splits
    """Splits of the runs."""
    held_out: HeldOutReadings
    """The held-out readings that are measured on; the model can give all of them."""
    partitions: list[Partition]
    """Slices of the held-out readings."""
    impossible: float
    """Share of the held-out readings that the model cannot give."""
    settings: Settings
    readings: Readings
    """What was asked for, and the readings as they were read."""
    messages: tuple[str, ...]
    """What was noticed."""

    @classmethod
    def of(cls, readings: Readings, model: Model, settings: Settings) -> "Comparison":
        """Split the runs, and take the held-out readings to measure on.

        Parameters
        ----------
        readings
            From `read_readings`.
        model
            The given model.
        settings
            With the random seed.
        """
        model, messages = with_least_weights(readings.in_step(model))
        data = dict(with_path(readings.data.columns))
        parts = draw_splits(data, np.random.default_rng([settings.seed, 0]))
        rows = np.flatnonzero(parts.held_out)
        rows = sample(data, rows, rules.MAX_MEASURED, np.random.default_rng([settings.seed, 3]))
        contexts = taken(data, rows)
        held_out = HeldOutReadings(data["reading_cm"][rows], contexts, _units(parts.runs[rows]))
        can = usable(model, held_out)
        held_out = held_out.take(can)
        names = [name for name in varying(held_out.contexts) if name not in NO_SLICES]
        return cls(
            model,
            data,
            parts,
            held_out,
            partitions(held_out.contexts, names),
            float(1.0 - can.mean()),
            settings,
            readings,
            (*readings.messages, *messages, *parts.messages),
        )

    def known_to(self, model: Model) -> "Comparison":
        """The comparison on those held-out readings of which the columns are known that a model's effects need."""
        contexts = self.held_out.contexts
        rows = KnownRows.of(model, self.data).needed(model, contexts).rows
        if rows.all():
            return self
        return replace(
            self, held_out=self.held_out.take(rows), partitions=[part.take(rows) for part in self.partitions]
        )


def with_least_weights(model: Model) -> tuple[Model, list[str]]:
    """The model with no kind of reading at a share of 0, and a message if that changed it."""
    mixture, missing = with_floors(model.sensor.reading_model, saturates=False)
    if not missing:
        return model, []
    text = (
        f"The model gives {' and '.join(missing)} readings a share of 0; {MIN_WEIGHT:g} is used, since a reading "
        "of probability 0 would decide the comparison alone."
    )
    return replace(model, sensor=model.sensor.model_copy(update={"reading_model": mixture})), [text]


def _about_noise(path: Column | None) -> list[str]:
    """That noise was taken off the reference, if so."""
    if not isinstance(path, ReferencePath) or path.knots is None or path.knots.smoothed_cm2 == 0.0:
        return []
    noise_cm = math.sqrt(path.knots.smoothed_cm2)
    return [f"true_range_cm differs from row to row by {noise_cm:.2g} cm of noise, which is smoothed."]


def _compared_rows(data: MeasuredData) -> tuple[MeasuredData, list[str]]:
    """Rows with a reading and a true range, and how many are left out."""
    messages = []
    silent, lost = np.isnan(data["reading_cm"]), np.isnan(data["true_range_cm"])
    for rows, what in (
        (silent, "rows have no reading (no answer) and are left out"),
        (lost & ~silent, "readings have no true range and are left out"),
    ):
        if rows.any():
            messages.append(f"{rows.sum():,} {what}{_whole_runs(data['run'], rows)}.")
    kept = ~(silent | lost)
    return (data if kept.all() else data.select(kept)), messages


def _whole_runs(run: Texts, left_out: Flags) -> str:
    """Which runs are left out with all of their rows, as the end of a sentence; empty where none is."""
    gone = np.setdiff1d(run[left_out], run[~left_out]).tolist()
    if not gone:
        return ""
    return f"; nothing else is in {counted(len(gone), 'run')}: {listed(gone, SHOWN_RUNS)}"


def _without_copies(data: MeasuredData) -> tuple[MeasuredData, list[str]]:
    """Leave out runs whose readings and true ranges are all those of another run: they would validate themselves."""
    first: dict[bytes, str] = {}
    messages, kept = [], np.ones(len(data), dtype=bool)
    for run in np.unique(data["run"]).tolist():
        rows = np.flatnonzero(data["run"] == run)
        content = data["reading_cm"][rows].tobytes() + data["true_range_cm"][rows].tobytes()
        if rows.size >= rules.MIN_COPIED and content in first:
            kept[rows] = False
            messages.append(f"Run {run} has the readings of run {first[content]} and is left out.")
        first.setdefault(content, run)
    return (data if kept.all() else data.select(kept)), messages


def _previous_on_grid(reading_cm: Array, previous_cm: Array, step_cm: float) -> Array:
    """Previous readings in the step, equal to the rounded readings only where they repeat exactly.

    Where nearly all repeats are exact, all count (`rules.EXACT_REPEATS`).
    """
    rounded = to_step(previous_cm, step_cm)
    repeats = to_step(reading_cm, step_cm) == rounded
    differs = repeats & (np.abs(reading_cm - previous_cm) > SAME_CM)
    if differs.sum() <= (1.0 - rules.EXACT_REPEATS) * repeats.sum():
        return rounded
    return to_step(rounded + np.where(differs, np.where(previous_cm < reading_cm, -step_cm, step_cm), 0.0), step_cm)


def _on_grid(data: MeasuredData, model: Model, step_cm: float) -> tuple[MeasuredData, list[CalibrationFinding]]:
    """The readings as multiples of the step, and what was changed for it."""
    reading_cm = data["reading_cm"]
    if step_cm == model.sensor.resolution_cm and is_on_grid(reading_cm, step_cm).all():
        return data, _coarse(reading_cm, model)
    limits_cm = model.sensor.minimum_cm, model.sensor.maximum_cm
    constant_cm = constants_cm(reading_cm, runs_and_sensors(data), step_cm, limits_cm)
    reading_cm, previous_cm = reading_cm - constant_cm, data[PREVIOUS] - constant_cm
    rounded = to_step(reading_cm, step_cm)
    off = np.abs(reading_cm - rounded) > TOLERANCE * step_cm
    columns = {**data.columns, "reading_cm": rounded, PREVIOUS: _previous_on_grid(reading_cm, previous_cm, step_cm)}
    columns["true_range_cm"] = data["true_range_cm"] - constant_cm
    added_cm, model_cm = np.unique(np.round(constant_cm[constant_cm != 0.0], 4)), model.sensor.resolution_cm
    if not off.any() and not added_cm.size and step_cm == model_cm:
        return MeasuredData(columns), _coarse(rounded, model)
    texts = []
    if step_cm != model_cm:
        texts.append(f"the readings are compared in steps of {step_cm:g} cm, and the model's are {model_cm:g} cm")
    if added_cm.size:
        values = f"{added_cm[0]:g}" + (f" to {added_cm[-1]:g}" if added_cm.size > 1 else "")
        share = f"{100.0 * (constant_cm != 0.0).mean():.3g} %"
        texts.append(
            f"{values} cm is added to the multiples of {step_cm:g} cm in {share} of the readings; it is taken off "
            "these and their true ranges, which leaves their errors as they are"
        )
    own_cm: float | None = step_cm
    if off.any():
        own_cm = step_of(reading_cm) or None
        share = f"{100.0 * off.mean():.3g} % of the readings are no multiples of {step_cm:g} cm"
        step = "" if own_cm is None else f" (their step is {own_cm:g} cm)"
        texts.append(f"{share}{step}; they are rounded first, so less than that is not visible")
    finding = "; ".join(texts)
    return MeasuredData(columns), [CalibrationFinding("resolution", finding, before=model_cm, after=own_cm, unit="cm")]


def _coarse(reading_cm: Column, model: Model) -> list[CalibrationFinding]:
    """Whole centimetres on a coarser grid."""
    if model.sensor.resolution_cm != 1.0:
        return []
    usual = reading_cm[(reading_cm > model.sensor.minimum_cm) & (reading_cm < model.sensor.maximum_cm)]
    for step in (10, 5, 4, 3, 2):
        if usual.size >= 50 and np.unique(usual).size > 5 and (np.mod(usual, step) == 0).mean() > rules.COARSE_SHARE:
            text = f"the readings come in steps of {step} cm, and the model's in steps of 1 cm"
            return [CalibrationFinding("resolution", text, before=1.0, after=float(step), unit="cm")]
    return []


def _without_codes(data: MeasuredData, model: Model) -> tuple[MeasuredData, list[CalibrationFinding]]:
    """Set aside values that repeat whatever the range is, and that the model does not declare as codes."""
    reading_cm, sensor = data["reading_cm"], model.sensor
    centre = model.base.calibration.forward(data["true_range_cm"])
    sigmas, share, far_cm = rules.CODE_FAR
    far = np.abs(reading_cm - centre) > sigmas * sensor.reading_model.sigma_cm + share * centre + far_cm
    values, counts = np.unique(reading_cm[far], return_counts=True)
    declared = {float(sensor.minimum_cm), float(sensor.maximum_cm), float(SATURATED_CM)}
    is_code, found = np.zeros(len(data), dtype=bool), []
    for value, count in zip(values.tolist(), counts.tolist(), strict=True):
        # What an effect explains comes at one range; a code comes at ranges that differ.
        if value in declared or count < max(rules.FEW_READINGS, rules.CODE_SHARE * reading_cm.size):
            continue
        steps = np.rint(np.abs(values - value) / sensor.resolution_cm)
        near = counts[(steps <= 3.0) & (steps > 0.0)].sum() / 6.0
        next_to = counts[steps == 1.0].max(initial=0)
        same = reading_cm == value
        here = data["true_range_cm"][same]
        alone = count > max(rules.CODE_TIMES_NEIGHBOURS * (near + 1.0), rules.CODE_TIMES_NEXT * next_to)
        if alone and np.ptp(here) > rules.CODE_SPAN * max(np.ptp(data["true_range_cm"]), 1.0):
            is_code |= same
            text = (
                f"{value:g} cm comes in {100.0 * same.mean():.3g} % of the readings, at true ranges of "
                f"{here.min():.0f} to {here.max():.0f} cm: a code that the model does not declare; these "
                f"{same.sum():,} readings are set aside{_whole_runs(data['run'], same)}"
            )
            found.append(CalibrationFinding("code", text, before=0.0, after=float(same.mean()), unit="1"))
    if not is_code.any() or is_code.all():
        return data, []
    return data.select(~is_code), found


def _about_contexts(data: MeasuredData) -> Iterator[str]:
    """A sentence on each column that never changes."""
    for name, column in data.columns.items():
        if name in (*NO_SLICES, "run", "sensor", REFERENCE):
            continue
        known = known_values(column)
        if known.size and (known == known[0]).all():
            value = f"{known[0]:g}" if column.dtype.kind == "f" else known[0]
            if name == "true_range_cm":
                yield f"All readings are at one true range ({value} cm), so what grows with range is not identifiable."
            else:
                yield f"{name} is constant ({value}), so its effects are not identifiable."


def _about_runs(run: Texts, time_s: Array) -> list[str]:
    runs = np.unique(run).size
    if runs >= rules.MIN_RUNS:
        return []
    what = "1 run" if runs == 1 else f"{runs} runs"
    order = np.lexsort((time_s, numbered(run)))
    pauses = int(np.sum((np.diff(time_s[order]) > rules.PAUSE_S) & (run[order][1:] == run[order][:-1])))
    hint = (
        f" There are {pauses} pauses of over {rules.PAUSE_S:g} s: if flights lie between them, number them in a column"
    )
    return [
        f"Found {what}: what is constant in a run but differs between runs (an offset of a session, a thermometer) "
        "is not identifiable; blocks of readings are used in place of runs."
        + (f"{hint} and give it as --map run=COLUMN." if pauses else "")
    ]


def _units(runs: Texts) -> Indices:
    """Runs, or where they are few, blocks of consecutive readings of them."""
    unit = numbered(runs)
    if int(unit.max()) + 1 >= rules.WARN_RUNS:
        return unit
    length = max(int(np.ceil(runs.size / rules.UNIT_BLOCKS)), rules.MIN_BLOCK_READINGS)
    return numbered(unit * runs.size + places_in(unit) // length)


@dataclass(frozen=True)
class KnownRows:
    """Readings of which the columns that are known in most of them are known."""

    rows: Flags
    """Which readings these are, (n,)."""
    columns: tuple[str, ...]
    """Columns with blank cells that are known in all of them."""
    unasked: tuple[str, ...]
    """Columns with so many blank cells that nothing is asked of them."""

    @classmethod
    def of(cls, model: Model, contexts: Mapping[str, Any]) -> "KnownRows":
        """The readings on which all that can be asked is asked; columns with the fewest blank cells come first."""
        scene = Scene(model.sensor, contexts)
        known = {name: scene.known(name) for name in contexts if name not in BLANK_IS_NONE}
        partly = {name: flags for name, flags in known.items() if isinstance(flags, np.ndarray) and flags.any()}
        rows = np.ones(scene.range_cm.size, dtype=bool)
        columns, unasked = [], []
        for name in sorted(partly, key=lambda name: -int(partly[name].sum())):
            if (rows & partly[name]).mean() >= rules.MIN_KNOWN_SHARE:
                rows = rows & partly[name]
                columns.append(name)
            else:
                unasked.append(name)
        return cls(rows, tuple(columns), tuple(unasked))

    def needed(self, model: Model, contexts: Mapping[str, Any]) -> "KnownRows":
        """The readings of which those columns are known that the model's effects need."""
        required = {name for term in model.effects for name in term.effect.requires}
        columns = tuple(name for name in self.columns if name in required)
        scene = Scene(model.sensor, contexts)
        rows = np.ones(scene.range_cm.size, dtype=bool)
        for name in columns:
            rows &= scene.known(name)
        return KnownRows(rows, columns, self.unasked)

    @property
    def message(self) -> str:
        """What is left out, in a sentence; empty where nothing is."""
        if not self.columns:
            return ""
        left_out = int((~self.rows).sum())
        return f"{' and '.join(self.columns)}: {left_out} readings without it are left out, since an effect needs it."
