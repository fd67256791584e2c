"""`msp-lab import`: logs that people have, as one dataset of readings."""

import json
import shutil
import sys
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from msp_range.extras import require
from msp_range.input_file import printable
from msp_range.recording.error import RecordingError
from msp_sim.cli import Jobs, Scheduler, Seed

if TYPE_CHECKING:
    from msp_lab.logs.importing import Import, Imported
    from msp_lab.logs.truth import Truth

app = typer.Typer()


def _import(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="logs, each of which becomes a run")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="folder for the dataset")],
    truth: Annotated[str | None, typer.Option(metavar="SOURCE", help="where the true range is from; see above")] = None,
    column_map: Annotated[
        list[str] | None,
        typer.Option("--map", metavar="MAP", help="for CSV: a YAML file, or NAME=COLUMN*FACTOR, repeatable"),
    ] = None,
    sensor: Annotated[
        Path | None,
        typer.Option(metavar="SENSOR.yaml", help="model of the sensor, for --truth others and codes of CSV files"),
    ] = None,
    align: Annotated[
        bool,
        typer.Option(
            "--align",
            help="take the readings' lag behind the reference off: right where the two have different clocks; "
            "otherwise the lag is the sensor's latency, which 'gap' finds",
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="print what was found as JSON")] = False,
    seed: Seed = 1,
    jobs: Jobs = 1,
    scheduler: Scheduler = None,
) -> None:
    """Import flight logs as one dataset of readings with true range and context, for 'gap' and 'characterise'.

    Reads ArduPilot .BIN, PX4 .ulg, .tlog of ground stations, ROS 1 and 2 bags, recordings of msp-range (.mcap), and CSV
    (with --map where its columns have other names). In --out: Parquet files by run and sensor, and dataset.json with
    what was found in each log. Runs are added to a dataset that is there. A log that cannot be used is named, the
    others are imported, and the exit code is 4; with --jobs, several logs are read at the same time.

    --truth is what readings are compared with: recorded, rtk, mocap, ekf, simulator, barometer, others, none,
    sensor:NAME (another range finder of the log), or column:MESSAGE.FIELD*FACTOR (any field, in metres after the
    factor). Default: the best that a log has. 'ekf' is refused while the log shows that the range is fused into it.
    SOURCE@FILE takes the reference from another file and aligns the clocks: mocap@room.bag, column:z*0.001@room.csv.
    """
    from msp_lab.logs.show import show
    from msp_lab.logs.truth import Truth, parse_truth
    from msp_sim.workers import EXIT_SOME_FAILED

    wanted = Truth() if truth is None else parse_truth(truth)
    common = _common(out, wanted, sensor, column_map, align=align, seed=seed)
    found, failed = run_import(files, common, jobs, scheduler)
    if as_json:
        print(json.dumps([asdict(log) for log in found], indent=2))
    else:
        show(found, out)
    if failed:
        print(f"{len(failed)} of {len(files)} logs could not be imported:", file=sys.stderr)
        for why in failed.values():
            print(printable(why), file=sys.stderr)
        raise typer.Exit(EXIT_SOME_FAILED)


def _common(
    out: Path,
    truth: "Truth",
    sensor: Path | None = None,
    column_map: list[str] | None = None,
    *,
    align: bool = False,
    seed: int = 1,
) -> "Import":
    """What all logs of an import have in common, by the options of the command."""
    require("logs", "msp-lab import")
    from msp_lab.logs.importing import Import
    from msp_lab.readings.column_map import load_maps
    from msp_lab.readings.from_files import sensor_file
    from msp_range.reading_model.sensor_model import load_sensor_model

    return Import(out, truth, load_sensor_model(sensor_file(sensor)), load_maps(column_map), align, seed)


def run_import(
    files: list[Path], common: "Import", jobs: int = 1, scheduler: str | None = None
) -> "tuple[list[Imported], dict[Path, str]]":
    """Import logs with a progress bar on the terminal; also for commands that take logs as they are.

    Returns
    -------
    tuple
        What was found in each log, and why others could not be imported.

    Raises
    ------
    RecordingError
        None of the logs can be imported; or as `import_logs`.
    """
    from rich.progress import BarColumn, TaskProgressColumn, TimeRemainingColumn

    from msp_lab.logs.importing import import_logs
    from msp_range.terminal import Bar, PlainConsole
    from msp_sim.terminal import make_folder
    from msp_sim.workers import Workers, workers

    make_folder(common.out)
    columns = (BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with ExitStack() as opened:
        if jobs == 1 and scheduler is None:
            bar = opened.enter_context(Bar(*columns, total=1.0, on=PlainConsole(stderr=True)))
            where, common = Workers(), replace(common, progress=bar.show)
        else:
            where = opened.enter_context(workers(jobs, scheduler, "msp-lab import"))
        if scheduler is not None:
            # Other machines have other working folders.
            files, common = [path.resolve() for path in files], replace(common, out=common.out.resolve())
        found, failed = import_logs(files, common, where)
    if where.died:
        print(f"{where.died} worker processes died; what they read was read again", file=sys.stderr)
    if not found:
        raise RecordingError("\n".join(failed.values()))
    return found, failed


def with_logs_imported(
    measured: list[Path], truth: str, column_map: list[str], out: Path, *, is_shown: bool = True
) -> tuple[list[Path], str]:
    """For commands that compare readings: flight logs among them become a dataset in ``out`` first.

    Returns
    -------
    tuple of list of Path and str
        What to read, and whether its true range is ``recorded`` or that of the ``others``.

    Raises
    ------
    ConfigError, RecordingError
        As `import_logs`.
    """
    from msp_lab.logs.opening import is_flight_log
    from msp_lab.logs.truth import NONE, OTHERS, RECORDED, Truth, parse_truth
    from msp_lab.readings.dataset import is_dataset

    to_import = measured if truth not in (RECORDED, OTHERS) else [path for path in measured if is_flight_log(path)]
    if not to_import:
        return measured, truth
    # With the others as reference the comparison itself finds it.
    wanted = Truth() if truth == RECORDED else Truth(NONE) if truth == OTHERS else parse_truth(truth)
    if is_dataset(out):
        shutil.rmtree(out)
    imported, failed = run_import(to_import, _common(out, wanted, column_map=column_map))
    if failed:
        raise RecordingError("\n".join(failed.values()))
    if is_shown:
        from msp_lab.logs.show import show

        show(imported)
    return [*(path for path in measured if path not in to_import), out], truth if truth == OTHERS else RECORDED


app.command("import")(_import)
