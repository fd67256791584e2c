"""Logs into a dataset of readings, one after the other, with an account of what was found.

Logs become a dataset, and an `Imported` for each. The account is kept in the dataset too.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from msp_lab.logs.alignment import Interval
from msp_lab.logs.elsewhere import reference_of
from msp_lab.logs.join import Joined, join
from msp_lab.logs.log import LogRequest, Ranger, TruthSource, VehicleLog
from msp_lab.logs.opening import RECORDING, format_of, open_log
from msp_lab.logs.truth import OTHERS, RECORDED, Truth, choose, is_same
from msp_lab.readings.column_map import ColumnMap
from msp_lab.readings.dataset import check_new, record_runs, write_tables
from msp_lab.readings.intake import sha256
from msp_lab.readings.no_echo import NO_ECHO, in_code_of
from msp_lab.readings.runs import file_names
from msp_lab.readings.vehicle import others_as_reference
from msp_range.arrays import Array
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData, join_tables
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import Recording
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import REFERENCE_STD, TRUE_RANGE
from msp_sim.model.derived import derived_columns
from msp_sim.model.model import Model
from msp_sim.workers import Workers

Progress = Callable[[str, float], None]

REPEATS_ROWS = 10
"""Repeats are counted where the range changes by more than a centimetre a row over this many rows: there a sensor of
whole centimetres repeats none. Longer: short climbs are left out; shorter: outliers count as a change."""
OBTAINABLE = {
    TRUE_RANGE: "a true range: --truth, or a log with RTK, motion capture or a second range finder",
    "range_rate_cm_s": "a vertical speed",
    "incidence_deg": "the attitude",
    "air_temperature_c": "a thermometer in the air (the autopilot's barometer is warmed by its board)",
    "humidity_pct": "a hygrometer",
    "throttle": "the throttle",
    "neighbour_lag_ms": "the readings of the other range finders",
}
"""Columns that a log of a flight can have, and what gives them."""


@dataclass(frozen=True)
class FoundSeries:
    """A series of a log: the column that it is for, where the log has it, its rate [Hz] and its number of samples."""

    name: str
    source: str
    rate_hz: float | None
    samples: int


@dataclass(frozen=True)
class FoundRanger:
    """A range finder of a log."""

    name: str
    source: str
    rate_hz: float | None
    readings: int
    """Its name, its source in the log, its rate, and the number of its readings."""
    silent: int
    """Readings without an answer."""
    too_near: int
    """Readings nearer than the minimum that the log states; they are empty in the dataset."""
    no_echo: int
    """Readings at or beyond the maximum that the log states."""
    maximum_cm: float | None
    """That maximum; None: the log states none."""
    low_cm: float | None
    high_cm: float | None
    """Smallest and largest of the other readings."""
    is_down: bool
    """Whether it looks down."""
    with_truth: int
    """Readings with a true range."""
    repeated: float
    """Share of the readings that are the one before them, where they change by a centimetre from one to the next."""
    lag_s: Interval | None = None
    """Time by which the readings lag behind the reference [s]; None: it cannot be determined."""
    offset_cm: float | None = None
    """Median of readings minus reference; subtracted where the reference does not know the ground's height."""
    scatter_cm: float | None = None
    """Standard deviation of the differences, without outliers."""
    reference_span_cm: float | None = None
    """How much the reference changes over the log, between its 2.5 and 97.5 % points; None: there is none."""
    reference_std_cm: Interval | None = None
    """Standard deviation of the reference's error; None: not known."""
    reference_std_from: str = ""
    """Source of that standard deviation, in words."""
    notes: tuple[str, ...] = ()
    """Why readings have no true range, or what is worth knowing of it."""
    no_lag: str = ""
    """Why the lag cannot be determined; empty: it is, or there is no reference."""


@dataclass(frozen=True)
class Missing:
    """A column that the log does not give, what would, and the effects that can therefore not be found."""

    column: str
    what: str
    effects: tuple[str, ...]


@dataclass(frozen=True)
class Imported:
    """What was found in a log, and became a run of the dataset."""

    runs: tuple[str, ...]
    """Names of its runs: one, but of a bench's table or recording with several."""
    file: str
    sha256: str
    form: str
    """Path and SHA-256 of the log, and its format in words."""
    duration_s: float
    """Time from the first to the last reading [s]."""
    rangers: tuple[FoundRanger, ...]
    """Its range finders."""
    series: tuple[FoundSeries, ...]
    """What is known of the flight."""
    truth: str
    """Kind of the reference; empty: none."""
    truth_source: str
    """Source of the reference in the log."""
    has_datum: bool
    """Whether the reference knows the ground's height."""
    is_shifted: bool
    """Whether the readings' lag was taken off."""
    others: Mapping[str, str]
    """References that the log has too, with their source, or the reason for which they are refused."""
    refused: tuple[str, ...]
    """The references among ``others`` that are refused."""
    missing: tuple[Missing, ...]
    """Columns that the log lacks, with the effects that cannot be found without them."""
    notes: tuple[str, ...]
    """What was lost, or is worth knowing."""


@dataclass(frozen=True)
class Import:
    """What all logs of an import have in common."""

    out: Path
    """The dataset; runs are added to one that is there."""
    truth: Truth
    """The reference that ``--truth`` asks for."""
    sensor: SensorModel
    """Its maximum is the reading of no echo in CSV files; its biases are taken off where the others are the
    reference."""
    column_map: ColumnMap | None = None
    """The map of ``--map``, for CSV files."""
    shift: bool = False
    """Whether the readings' lag is taken off; it always is where the reference is in another file."""
    seed: int = 1
    """Random seed of the intervals."""
    progress: Progress | None = None
    """Called with what is being done and the share of all logs that is done; None: not called."""


@dataclass(frozen=True)
class NamedLog:
    """A log, the name of its run, and its place among all logs (from 0, and how many)."""

    path: Path
    run: str
    place: tuple[int, int]


def import_logs(paths: Sequence[Path], common: Import, where: Workers) -> tuple[list[Imported], dict[Path, str]]:
    """Import logs into a dataset.

    Parameters
    ----------
    paths
        The logs.
    common
        How.
    where
        Where the logs are read, and the readings written.

    Returns
    -------
    tuple
        What was found in each log, and the logs that cannot be used, with the reason.

    Raises
    ------
    RecordingError
        The dataset has a run of this name already; nothing is imported.
    """
    failed: dict[Path, str] = {}
    for path in paths:
        try:
            format_of(path)
        except RecordingError as error:
            failed[path] = str(error)
    paths = [path for path in paths if path not in failed]
    names = file_names(paths)
    check_new(common.out, names)
    logs = [NamedLog(path, run, (i, len(paths))) for i, (path, run) in enumerate(zip(paths, names, strict=True))]
    found: list[Imported] = []
    for outcome in where.map(import_log, logs, common, what="logs"):
        if outcome.value is None:
            failed[paths[outcome.index]] = outcome.error or ""
            continue
        record_runs(common.out, {run: asdict(each) for each in outcome.value for run in each.runs})
        found += outcome.value
    return found, failed


def import_log(common: Import, named: NamedLog) -> list[Imported]:
    """Read a log and write its readings, as runs that the dataset does not list yet: one, or one after each step of its
    clock.

    Raises
    ------
    RecordingError
        The log cannot be used.
    """
    path, truth = named.path, common.truth

    def share(of_file: float) -> None:
        if common.progress is not None:
            common.progress(f"reading {path.name}", (named.place[0] + of_file) / named.place[1])

    share(0.0)
    field = "" if truth.file else truth.field
    log = open_log(path, LogRequest(share, field, common.column_map, common.sensor.maximum_cm))
    if not log.rangers:
        raise RecordingError(f"{path}: no readings of a range finder in this {log.form}")
    if truth.kind == RECORDED and not any(TRUE_RANGE in ranger.columns for ranger in log.rangers):
        raise RecordingError(f"{path}: --truth recorded: this {log.form} has no {TRUE_RANGE} next to its readings")
    if truth.kind not in ("", RECORDED):
        # What is asked for takes the place of what the file has.
        log = replace(log, rangers=tuple(_without_truth(ranger) for ranger in log.rangers))
    digest = sha256(path)
    found: list[Imported] = []
    failed: list[str] = []
    for number, part in enumerate(log.runs(), start=1):
        run = named.run if number == 1 else f"{named.run}/{number}"
        try:
            if part.rangers:
                found.append(_import_run(common, part, run, digest))
        except RecordingError as error:
            failed.append(f"{run}: {error}" if log.clock else str(error))
    if not found:
        raise RecordingError(failed[0])
    return [replace(found[0], notes=(*found[0].notes, *(f"Not imported: {why}" for why in failed))), *found[1:]]


def _import_run(common: Import, log: VehicleLog, run: str, digest: str) -> Imported:
    """Write the readings of a log whose clock does not step; ``digest`` is the SHA-256 of the log."""
    path, truth = log.path, common.truth
    notes: list[str] = []
    if truth.file is None:
        reference = choose(log, truth)
    else:
        reference, difference_s = reference_of(truth.file, truth, log, common.sensor.maximum_cm)
        notes.append(f"The clock of {truth.file.name} differs by {difference_s:.2f} s, apart from the lag above.")
    joined = join(log, reference, np.random.default_rng(common.seed), shift=common.shift or truth.file is not None)
    if reference is not None and not any(TRUE_RANGE in ranger.data for ranger in joined):
        if truth.kind:
            raise RecordingError(f"{path}: --truth {truth.kind}: {_why_no_truth(joined)}")
        reference = None
    if truth.kind == OTHERS:
        joined, notes = _others(path, joined, common.sensor)
    runs = _by_run(run, joined)
    for name, tables in runs.items():
        write_tables(common.out, name, tables)
    return _account(tuple(runs), log, digest, reference, joined, notes, truth)


def _without_truth(ranger: Ranger) -> Ranger:
    kept = {name: column for name, column in ranger.columns.items() if name not in (TRUE_RANGE, REFERENCE_STD)}
    return replace(ranger, columns=kept)


def _why_no_truth(joined: Sequence[Joined]) -> str:
    """Why no reading of a log has the reference that it was compared with."""
    reasons = [f"{one.ranger.name}: {note}" for one in joined for note in one.notes]
    if not any(each.ranger.is_down for each in joined):
        reasons = ["no range finder looks down, and of others a height says nothing"]
    return "; ".join(reasons) or "no reading has it"


def _by_run(name: str, joined: Sequence[Joined]) -> dict[str, dict[str, MeasuredData]]:
    """Tables by run and sensor: a CSV file or a recording of a bench may have several runs."""
    found: dict[str, dict[str, MeasuredData]] = {}
    for each in joined:
        words = each.data.column("run")
        for word in dict.fromkeys(words.tolist()):
            own = Path(name).name
            run = name if word in ("", own) else f"{name}/{word.removeprefix(f'{own}/')}"
            rows = words == word
            # Most logs are one run, and copies of two million readings take 270 MB.
            found.setdefault(run, {})[each.ranger.name] = each.data if rows.all() else each.data.select(rows)
    return found


def _others(path: Path, joined: Sequence[Joined], sensor: SensorModel) -> tuple[list[Joined], list[str]]:
    """The same readings with the other range finders as reference."""
    down = [each for each in joined if each.ranger.is_down]
    if not down:
        raise RecordingError(f"{path}: no range finder that looks down, to compare with others")
    recording = Recording(path) if format_of(path) is RECORDING else None
    whole, _ = in_code_of(sensor, join_tables([each.data for each in down]))
    data, runs = others_as_reference(path, whole, recording, Model.of(sensor), ())
    found = [
        replace(each, data=data.select(np.flatnonzero(data["sensor"] == each.ranger.name)), alignment=None, error=None)
        for each in down
    ]
    listed = ", ".join(f"{name} {value:+.1f} cm" for run in runs for name, value in run.offsets_cm.items())
    return found, [f"Each sensor reads more than the others by, and this is taken off: {listed}."]


def _account(
    runs: tuple[str, ...],
    log: VehicleLog,
    digest: str,
    reference: TruthSource | None,
    joined: Sequence[Joined],
    notes: Iterable[str],
    truth: Truth,
) -> Imported:
    times = [each.data["time_s"] for each in joined if len(each.data)]
    recorded = any(TRUE_RANGE in each.ranger.columns for each in joined)
    kind = reference.kind if reference is not None else truth.kind or ("recorded" if recorded else "")
    others = {
        each.kind: each.refused or each.series.source
        for each in log.references
        if each.refused or reference is None or not is_same(each.series, reference.series)
    }
    return Imported(
        runs,
        str(log.path),
        digest,
        log.form,
        max(float(time[-1]) for time in times) - min(float(time[0]) for time in times),
        tuple(_found(each) for each in joined),
        tuple(FoundSeries(name, each.source, _or_none(each.rate_hz), len(each)) for name, each in log.context.items()),
        kind,
        reference.series.source if reference is not None else "",
        reference.has_datum if reference is not None else True,
        any(each.is_shifted for each in joined),
        others,
        tuple(each.kind for each in log.references if each.refused),
        _missing(joined),
        (*log.notes, *notes),
    )


def _found(joined: Joined) -> FoundRanger:
    reading_cm, ranger, alignment, error = joined.data["reading_cm"], joined.ranger, joined.alignment, joined.error
    answered = np.isfinite(reading_cm)
    is_no_echo = answered & (reading_cm == joined.data[NO_ECHO] if NO_ECHO in joined.data else False)
    known = reading_cm[answered & ~is_no_echo]
    true_cm = joined.data.column(TRUE_RANGE)
    found = FoundRanger(
        ranger.name,
        ranger.series.source,
        _or_none(ranger.series.rate_hz),
        reading_cm.size,
        int(reading_cm.size - answered.sum()) - ranger.too_near,
        ranger.too_near,
        int(is_no_echo.sum()),
        _or_none(ranger.maximum_cm),
        float(known.min()) if known.size else None,
        float(known.max()) if known.size else None,
        ranger.is_down,
        int(np.isfinite(true_cm).sum()),
        _repeated(reading_cm[answered]),
        reference_span_cm=_span(true_cm),
        notes=joined.notes,
    )
    if alignment is not None:
        found = replace(found, **vars(alignment))  # its fields have these names
    if error is not None:
        found = replace(found, reference_std_cm=error.std_cm, reference_std_from=error.source)
    return found


def _span(values: Array) -> float | None:
    """Between the 2.5 and 97.5 % points of what is known; None: nothing is."""
    known = values[np.isfinite(values)]
    return float(np.ptp(np.quantile(known, (0.025, 0.975)))) if known.size else None


def _repeated(reading_cm: Array) -> float:
    """As `FoundRanger.repeated`, of those with an answer."""
    around = REPEATS_ROWS // 2
    change_cm = np.abs(reading_cm[REPEATS_ROWS:] - reading_cm[:-REPEATS_ROWS])
    moving = np.flatnonzero((change_cm > REPEATS_ROWS) & (change_cm < 10.0 * REPEATS_ROWS)) + around
    return float(np.mean(reading_cm[moving] == reading_cm[moving - 1])) if moving.size > 3 * REPEATS_ROWS else 0.0


def _missing(joined: Sequence[Joined]) -> tuple[Missing, ...]:
    """Columns that no range finder has and that follow from no others, with the effects that require them."""
    there = {
        name for each in joined for name in [*each.data.columns, *derived_columns(OBTAINABLE, each.data.columns)[0]]
    }
    found = []
    for column, what in OBTAINABLE.items():
        if column not in there:
            effects = tuple(sorted(effect.name for effect in CATALOGUE.values() if column in effect.requires))
            found.append(Missing(column, what, effects))
    return tuple(found)


def _or_none(number: float) -> float | None:
    return float(number) if np.isfinite(number) else None
