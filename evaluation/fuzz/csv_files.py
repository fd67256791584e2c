"""CSV: tables of readings and of other people, changed in their bytes, cells, rows and columns, and packed tables."""

import gzip
import shutil
from collections import deque
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from evaluation.fuzz import base, mutate, played
from msp_lab.filter_study.table import REPORT, read_table
from msp_lab.gap.intake import read_readings
from msp_lab.readings.column_map import load_map, read_mapped
from msp_lab.readings.intake import load_readings, without_impossible
from msp_range.config import load_airframe
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.columns import CONTEXT_COLUMNS
from msp_range.recording.csv_form import csv_rows, read_csv, write_csv
from msp_range.recording.error import RecordingError
from msp_range.recording.pings import read_recorded
from msp_range.yaml_file import ConfigError
from msp_sim.model.model import load_model

LONGEST_MESSAGE = 5000
"""Characters of what is reported of one file."""
SENSORS = ("front_left", "front_right", "rear_left", "rear_right")


def fuzz(seconds: float, seed: int) -> base.FuzzResult:
    """Read changed tables for so long [s]."""
    return base.run("csv", seconds, seed, _case, prepare)


def prepare(folder: Path) -> base.Check:
    """The check: read a case by one of the readers; only an error of the project in plain lines may come of it."""
    shutil.copytree("configs", folder / "configs")
    airframe = load_airframe(folder / "configs/quad_pallet.yaml")
    sensor = load_sensor_model("configs/sensors/mb1242.yaml")
    model = load_model("configs/sensors/mb1242.yaml")
    maps = [load_map([str(path)]) for path in sorted(Path("configs/maps").glob("*.yaml"))]
    maps += [load_map(["reading_cm=reading_cm*100", "true_range_cm=true_range_cm"])]
    copy = folder / "copy.csv"

    def read(path: Path) -> None:
        data = read_csv(path)
        copy.unlink(missing_ok=True)
        write_csv(copy, data)
        again = read_csv(copy)
        assert set(again.columns) == set(data.columns)
        for name, column in data.columns.items():
            # A column without rows has no type of its own.
            assert not len(data) or np.array_equal(column, again[name], equal_nan=column.dtype.kind == "f"), name

    def replayed(path: Path) -> None:
        played.play(airframe, read_recorded(path), path)

    def mapped(path: Path) -> None:
        read_mapped(path, maps[path.stat().st_size % len(maps)], 765)

    readers: dict[str, Callable[[Path], Any]] = {
        "read": read,
        "replay": replayed,
        "map": mapped,
        "gather": lambda path: without_impossible(load_readings([path], sensor), sensor),
        "gap": lambda path: read_readings([path], model),
        "study": read_table,
        "packed": lambda path: deque(csv_rows(path), maxlen=0),
    }

    def check(data: bytes) -> None:
        kind, _, content = data.partition(b"\n")
        path = folder / ("fuzzed.csv.gz" if kind == b"packed" else "fuzzed.csv")
        path.write_bytes(content)
        try:
            readers[kind.decode()](path)
        except (RecordingError, ConfigError) as error:
            base.check_message(str(error), folder, LONGEST_MESSAGE)

    for kind in KINDS:
        check(kind.encode() + b"\n" + _text(kind, Random(1)).encode())
    return check


KINDS = ("read", "replay", "map", "gather", "gap", "study")


def _text(kind: str, rng: Random) -> str:
    """A good table."""
    if kind == "study":
        return REPORT
    if kind == "map" and rng.random() < 0.5:
        rows = [f"{rng.random()},{rng.random()},{i},{rng.randrange(60)}" for i in range(rng.randrange(60))]
        return "\n".join(["measured_m,expected_m,angle,cm", *rows])
    contexts = rng.sample(sorted(CONTEXT_COLUMNS), rng.choice((0, 0, 1, 3, 8)))
    more = rng.sample(("pilot", "battery_v", "größe, in cm"), rng.choice((0, 0, 1)))
    names = ["time_s", "sensor", "run", "reading_cm", "true_range_cm", *contexts, *more]
    lines = [",".join(f'"{name}"' if "," in name else name for name in names)]
    true_cm = rng.uniform(30, 700)
    for i in range(rng.choice((0, 1, 40, 40, 200))):
        true_cm = min(max(true_cm + rng.gauss(0, 3), 20), 760)
        cells = [
            f"{i / 10:g}",
            SENSORS[i % 4],
            f"run{i // 50}",
            f"{round(true_cm + rng.gauss(0, 1))}",
            f"{true_cm:.1f}",
        ]
        cells += ["word" if name in ("condition", "target") else f"{rng.random():.3g}" for name in contexts]
        cells += ["Ann" if name == "pilot" else "12.5" for name in more]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def _case(rng: Random) -> bytes:
    if rng.random() < 0.05:
        return b"packed\n" + _packed(rng)
    kind = rng.choice(KINDS)
    text = _text(kind, rng)
    how = rng.randrange(10)
    if how < 3:
        content = mutate.of_bytes(text.encode(), rng)
    elif how < 8:
        content = mutate.encoded(_in_cells(text, rng), rng)
    elif how < 9:
        content = mutate.encoded(_crafted(text, rng), rng)
    else:
        content = text.encode()
    return kind.encode() + b"\n" + content


def _in_cells(text: str, rng: Random) -> str:
    """Cells, rows and columns replaced, moved, doubled and left out."""
    rows = [line.split(",") for line in text.split("\n")]
    for _ in range(rng.choice((1, 1, 2, 5))):
        at = rng.choice((0, 1, rng.randrange(len(rows)))) % len(rows)
        row = rows[at]
        column = rng.randrange(max(len(row), 1))
        how = rng.randrange(8)
        if how < 3:
            odd = mutate.pick(rng, mutate.NUMBERS, mutate.WORDS, ('"', '"a"b', '"a\n', "1e9", "1e12", "-3599"))
            row[column : column + 1] = [odd]
        elif how == 3:
            rows.insert(rng.randrange(len(rows)), list(row))
        elif how == 4:
            rows[at] = row[:column]
        elif how == 5:
            value = mutate.pick(rng, mutate.NUMBERS, mutate.WORDS)
            for each in rows[1:]:
                each[column:column] = [value]
            rows[0][column:column] = [rng.choice((*CONTEXT_COLUMNS, "more"))]
        elif how == 6:
            for each in rows:
                del each[column : column + 1]
        else:
            rng.shuffle(rows)
    return rng.choice(("\n", "\n", "\n", "\r\n", "\r")).join(",".join(row) for row in rows)


def _crafted(text: str, rng: Random) -> str:
    """What is made to cost much: long lines and cells, many columns, no ends."""
    count = rng.choice((10, 1000, 100_000, 1_500_000))
    return rng.choice(
        (
            "," * count,
            text.split("\n")[0] + "," * count + "\n",
            text.split("\n")[0] + "\n" + "," * count,
            '"' * count,
            text + '"' + "x\n" * count,
            "a" * count,
            text + "0.1," + "x" * count + ",run,100,100\n",
            text + "\n" * count,
            text + "9" * count + ",a,b,1,1\n",
            "time_s,sensor,reading_cm," + ",".join(f"c{i}" for i in range(min(count, 2000))) + "\n",
            text * min(count, 200),
            "".join(f"{line},{'y' * min(count, 5000)}\n" for line in text.split("\n")),
            "\x00" * count,
            "",
            "\ufeff\ufeff" + text,
        )
    )


def _packed(rng: Random) -> bytes:
    count = rng.choice((10, 100_000, 3_000_000))
    content = rng.choice((_text("read", rng).encode(), b"1,2\n" * count, bytes(count), b"a" * count))
    packed = gzip.compress(content, mtime=0)
    return rng.choice((packed, mutate.of_bytes(packed, rng), packed * 3, packed[: len(packed) // 2], b""))
