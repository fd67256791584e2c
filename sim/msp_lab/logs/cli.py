"""`msp-lab import`: logs that people have, as one dataset of readings."""

import json
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from msp_range.extras import require

if TYPE_CHECKING:
    from msp_lab.logs.importing import Imported
    from msp_lab.logs.truth import Truth

app = typer.Typer()

IMPORT = """Import flight logs as one dataset of readings with true range and context, for 'gap' and 'characterise'.

Reads ArduPilot .BIN, PX4 .ulg, .tlog of ground stations, ROS 1 and 2 bags, recordings of msp-range (.mcap), and CSV
(with --map where its columns have other names). In --out: Parquet files by run and sensor, and dataset.json with what
was found in each log. Runs are added to a dataset that is there.

--truth is what readings are compared with: recorded, rtk, mocap, ekf, simulator, barometer, others, none, sensor:NAME
(another range finder of the log), or column:MESSAGE.FIELD*FACTOR (any field, in metres after the factor). Default: the
best that a log has. 'ekf' is refused while the log shows that the range is fused into it. SOURCE@FILE takes the
reference from another file and aligns the clocks: mocap@room.bag, column:z*0.001@room.csv.
"""


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
    seed: Annotated[int, typer.Option(min=0, help="random seed of the intervals")] = 1,
) -> None:
    from msp_lab.logs.show import show

    found = run_import(files, out, truth, sensor=sensor, column_map=column_map, align=align, seed=seed)
    if as_json:
        print(json.dumps([asdict(each) for each in found], indent=2))
    else:
        show(found, out)


def run_import(
    files: list[Path],
    out: Path,
    truth: "str | Truth | None",
    *,
    sensor: Path | None = None,
    column_map: list[str] | None = None,
    align: bool = False,
    seed: int = 1,
) -> "list[Imported]":
    """Import logs with a progress bar on the terminal; also for commands that take logs as they are."""
    require("logs", "msp-lab import")
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn

    from msp_lab.logs.importing import import_logs
    from msp_lab.logs.truth import Truth, parse_truth
    from msp_lab.readings.column_map import load_map
    from msp_range.reading_model.sensor_model import load_sensor_model
    from msp_range.sensors.table import DRIVERS
    from msp_range.terminal import PlainConsole
    from msp_range.yaml_file import config_path
    from msp_sim.terminal import Bar, make_folder

    wanted = Truth() if truth is None else parse_truth(truth) if isinstance(truth, str) else truth
    model = load_sensor_model(sensor or config_path(next(iter(DRIVERS)), "sensors"))
    mapping = load_map(column_map) if column_map else None
    make_folder(out)
    text = TextColumn("{task.description}", markup=False)
    columns = (text, BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Bar(*columns, total=1.0, on=PlainConsole(stderr=True)) as bar:
        return import_logs(files, out, wanted, model, column_map=mapping, shift=align, seed=seed, progress=bar.show)


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
    from msp_lab.logs.show import show
    from msp_lab.logs.truth import NONE, OTHERS, RECORDED, Truth
    from msp_lab.readings.dataset import is_dataset

    logs = [path for path in measured if is_flight_log(path)]
    if truth in (RECORDED, OTHERS) and not logs:
        return measured, truth
    # With the others as reference the comparison itself finds it.
    wanted = Truth() if truth == RECORDED else Truth(NONE) if truth == OTHERS else truth
    as_they_are = [path for path in measured if path not in logs] if truth in (RECORDED, OTHERS) else []
    if is_dataset(out):
        shutil.rmtree(out)
    imported = run_import([path for path in measured if path not in as_they_are], out, wanted, column_map=column_map)
    if is_shown:
        show(imported)
    return [*as_they_are, out], truth if truth == OTHERS else RECORDED


app.command("import", help=IMPORT)(_import)
