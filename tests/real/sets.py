"""The measured sets as the commands get them: files, sensor model, column map, and what is characterised first."""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.real.columns import FloatArray, read_table

ROOT = Path(__file__).resolve().parents[2]
CONFIGS = ROOT / "configs"
OWN_MAPS = Path(__file__).parent / "maps"


@dataclass(frozen=True)
class MeasuredSet:
    """One comparison of readings with a model.

    Attributes
    ----------
    name
        As in `names.csv`.
    readings
        Files below the folder of measured data that `msp-lab gap` gets.
    sensor
        Shipped sensor model: what the readings are compared with, or what `characterise` starts from.
    column_map
        Map file; None where `prepare` writes the CSV form.
    bench
        Files that `msp-lab characterise` gets first; empty: the shipped model is used as it is.
    prepare
        Writes tables in the CSV form with columns of its own, which no map can name.
    """

    name: str
    readings: tuple[str, ...]
    sensor: str
    column_map: Path | None
    bench: tuple[str, ...] = ()
    prepare: Callable[[Path, Path], list[Path]] | None = None


def write_form(path: Path, columns: dict[str, FloatArray]) -> Path:
    """Write the project's CSV form, for one sensor."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["sensor", *columns])
        writer.writerows(["ranger", *(f"{each:.6g}" for each in row)] for row in zip(*columns.values(), strict=True))
    return path


def prepare_drone(data: Path, out: Path) -> list[Path]:
    """Both flights of the drone with the rate of the truth, the place and the attitude."""
    paths = []
    for name in ("0425__TDOA2__0425-traj1", "0607__tdoa2-obs-log1"):
        table = read_table(data / "util-uwb" / f"{name}.csv")
        z = 100.0 * table["mocap_z_m"]
        columns = {
            "time_s": table["t_s"],
            "reading_cm": 100.0 * table["range_m"],
            "true_range_cm": z,
            "incidence_deg": np.degrees(np.arccos(np.clip(table["cos_tilt"], -1.0, 1.0))),
            "range_rate_cm_s": smooth_rate(z, table["t_s"]),
        }
        for own in ("mocap_x_m", "mocap_y_m", "roll_rad", "pitch_rad"):
            columns[own] = table[own]
        paths.append(write_form(out / f"{name[:4]}.csv", columns))
    return paths


def prepare_terrain(data: Path, out: Path) -> list[Path]:
    """The flight over boxes with its place and the rate of its height."""
    table = read_table(data / "crazyflie-terrain" / "log07.csv")
    z = 100.0 * table["est_z_m"]
    columns = {
        "time_s": table["t_s"],
        "reading_cm": 100.0 * table["range_m"],
        "true_range_cm": z,
        "range_rate_cm_s": smooth_rate(z, table["t_s"]),
        "est_x_m": table["est_x_m"],
        "est_y_m": table["est_y_m"],
    }
    return [write_form(out / "log07.csv", columns)]


def smooth_rate(z: FloatArray, t: FloatArray) -> FloatArray:
    """Rate of the truth [cm/s], smoothed over five rows."""
    return np.asarray(np.gradient(np.convolve(np.pad(z, 2, mode="edge"), np.ones(5) / 5.0, "valid"), t))


_MAPS = CONFIGS / "maps"
_TRAINING, _CALIBRATION = ("enmt482/training1.csv",), ("enmt482/calibration.csv",)
_0425, _0607 = "util-uwb/0425__TDOA2__0425-traj1.csv", "util-uwb/0607__tdoa2-obs-log1.csv"
_RULER = ("hcsr04-ccu/readings.csv",)

SETS = (
    MeasuredSet("robot_hcsr04", _TRAINING, "hcsr04", _MAPS / "enmt482-sonar1.yaml", _CALIBRATION),
    MeasuredSet("robot_mb1433", _TRAINING, "mb1433", _MAPS / "enmt482-sonar2.yaml"),
    MeasuredSet("robot_mb1433_bench", _TRAINING, "mb1433", _MAPS / "enmt482-sonar2.yaml", _CALIBRATION),
    MeasuredSet("drone_0607", (_0607,), "tof_ranger", _MAPS / "util-uwb.yaml"),
    MeasuredSet("drone_0425", (_0425,), "tof_ranger", _MAPS / "util-uwb.yaml"),
    MeasuredSet("drone_both", (_0425, _0607), "tof_ranger", _MAPS / "util-uwb.yaml"),
    MeasuredSet("drone_columns", (_0425, _0607), "tof_ranger", None, prepare=prepare_drone),
    MeasuredSet("ruler", _RULER, "hcsr04", _MAPS / "hcsr04-ccu.yaml"),
    MeasuredSet("ruler_bench", _RULER, "hcsr04", _MAPS / "hcsr04-ccu.yaml", _RULER),
    MeasuredSet("tilted_plate", ("hcsr04-tilt/Misure_prove.csv",), "hcsr04", _MAPS / "hcsr04-tilt.yaml"),
    MeasuredSet("museum_lidar", ("carmen-fhw/fhw-pairs-derived.csv.gz",), "lidar_sick", _MAPS / "carmen-fhw.yaml"),
    MeasuredSet("terrain", ("crazyflie-terrain/log07.csv",), "tof_ranger", OWN_MAPS / "terrain.yaml"),
    MeasuredSet("terrain_columns", ("crazyflie-terrain/log07.csv",), "tof_ranger", None, prepare=prepare_terrain),
)
