"""The measured sets as the commands get them: files, sensor model, column map, and what is characterised first."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evaluation import CONFIGS
from evaluation.csv_form import cells_of, write_form
from evaluation.real.columns import FloatArray, read_table, read_tilt, read_words
from evaluation.real.regress import smooth_rate

OWN_MAPS = Path(__file__).parent / "maps"


@dataclass(frozen=True)
class MeasuredSet:
    """One comparison of readings with a model."""

    name: str
    """As in `names.csv`."""
    readings: tuple[str, ...]
    """Files below the folder of measured data that `msp-lab gap` gets."""
    sensor: str
    """Shipped sensor model: what the readings are compared with, or what `characterise` starts from."""
    column_map: Path | None
    """Map file; None: the workflow gets what `prepare` writes, with columns that no map can name."""
    prepare: Callable[[Path, Path], list[Path]]
    """Writes the same readings in the CSV form, without the product's reader of maps."""
    bench: tuple[str, ...] = ()
    """Files that `msp-lab characterise` gets first; empty: the shipped model is used as it is."""


Columns = dict[str, FloatArray | NDArray[np.str_]]


def write(path: Path, columns: Columns) -> Path:
    """Write the project's CSV form, for one sensor; NaN is an empty cell."""
    cells = {name: cells_of(column, 7) for name, column in columns.items()}
    return write_form(path, {"sensor": ["ranger"] * len(cells["reading_cm"])} | cells)


def prepare_robot(sonar: str, no_echo_cm: float) -> Callable[[Path, Path], list[Path]]:
    """One of the robot's sonars; its codes for no echo become the model's longest range."""

    def prepare(data: Path, out: Path) -> list[Path]:
        table = read_table(data / "enmt482" / "training1.csv")
        reading = 100.0 * table[sonar]
        if sonar == "sonar1":
            reading = np.where((reading < 1.001) | (reading == 800.0), no_echo_cm, reading)
        columns: Columns = {
            "time_s": table["time"],
            "reading_cm": reading,
            "true_range_cm": 100.0 * table["range"],
            "range_rate_cm_s": 100.0 * table["velocity_command"],
        }
        return [write(out / "training1.csv", columns)]

    return prepare


def prepare_drone(*flights: str, own_columns: bool = False) -> Callable[[Path, Path], list[Path]]:
    """Flights of the drone; with columns of its own: the rate of the truth, the place and the attitude."""

    def prepare(data: Path, out: Path) -> list[Path]:
        paths = []
        for flight in flights:
            table = read_table(data / flight)
            z = 100.0 * table["mocap_z_m"]
            columns: Columns = {
                "time_s": table["t_s"],
                "reading_cm": 100.0 * table["range_m"],
                "true_range_cm": z,
                "incidence_deg": np.degrees(np.arccos(np.clip(table["cos_tilt"], -1.0, 1.0))),
            }
            if own_columns:
                columns["range_rate_cm_s"] = smooth_rate(z, table["t_s"])
                columns |= {name: table[name] for name in ("mocap_x_m", "mocap_y_m", "roll_rad", "pitch_rad")}
            paths.append(write(out / f"{Path(flight).stem}.csv", columns))
        return paths

    return prepare


def prepare_ruler(data: Path, out: Path) -> list[Path]:
    """The HC-SR04 at ruler distances; each file of the author's is a run."""
    path = data / "hcsr04-ccu" / "readings.csv"
    table = read_table(path)
    columns: Columns = {
        "run": read_words(path, "file"),
        "time_s": np.arange(float(table["measured_cm"].size)),
        "reading_cm": table["measured_cm"],
        "true_range_cm": table["actual_cm"],
        "air_temperature_c": table["temp1_C"],
    }
    return [write(out / "readings.csv", columns)]


def prepare_tilt(data: Path, out: Path) -> list[Path]:
    """The turned plate; 0 is no answer."""
    tables = read_tilt(data / "hcsr04-tilt" / "Misure_prove.csv")
    reading = np.concatenate([each[3] for each in tables])
    columns: Columns = {
        "run": np.concatenate([np.full(each[2].size, each[0].split()[0]) for each in tables]),
        "time_s": np.arange(float(reading.size)),
        "reading_cm": np.where(reading == 0.0, np.nan, reading),
        "true_range_cm": np.concatenate([np.full(each[2].size, each[1]) for each in tables]),
        "incidence_deg": np.concatenate([each[2] for each in tables]),
    }
    return [write(out / "Misure_prove.csv", columns)]


def prepare_lidar(data: Path, out: Path) -> list[Path]:
    """Beams of the museum; 51.05 and 51.1 m are nothing seen."""
    table = read_table(data / "carmen-fhw" / "fhw-pairs-derived.csv.gz")
    measured = table["measured_m"]
    columns: Columns = {
        "time_s": np.arange(float(measured.size)),
        "reading_cm": np.where(measured > 51.04, 5110.0, np.round(100.0 * measured, 6)),
        "true_range_cm": 100.0 * table["expected_m"],
    }
    return [write(out / "fhw.csv", columns)]


def prepare_terrain(own_columns: bool) -> Callable[[Path, Path], list[Path]]:
    """The flight over boxes; with columns of its own: its place and the rate of its height."""

    def prepare(data: Path, out: Path) -> list[Path]:
        table = read_table(data / "crazyflie-terrain" / "log07.csv")
        z = 100.0 * table["est_z_m"]
        columns: Columns = {
            "time_s": table["t_s"],
            "reading_cm": 100.0 * table["range_m"],
            "true_range_cm": z,
        }
        if own_columns:
            columns["range_rate_cm_s"] = smooth_rate(z, table["t_s"])
            columns |= {name: table[name] for name in ("est_x_m", "est_y_m")}
        return [write(out / "log07.csv", columns)]

    return prepare


_MAPS = CONFIGS / "maps"
_TRAINING, _CALIBRATION = ("enmt482/training1.csv",), ("enmt482/calibration.csv",)
_0425, _0607 = "util-uwb/0425__TDOA2__0425-traj1.csv", "util-uwb/0607__tdoa2-obs-log1.csv"
_RULER, _TERRAIN = ("hcsr04-ccu/readings.csv",), ("crazyflie-terrain/log07.csv",)
_SONAR1, _SONAR2 = prepare_robot("sonar1", 400.0), prepare_robot("sonar2", 500.0)
_MB1433_MAP, _DRONE_MAP, _RULER_MAP = (_MAPS / f"{name}.yaml" for name in ("enmt482-sonar2", "util-uwb", "hcsr04-ccu"))
_LIDAR = ("carmen-fhw/fhw-pairs-derived.csv.gz",)
_PLATE = ("hcsr04-tilt/Misure_prove.csv",)

SETS = (
    MeasuredSet("robot_hcsr04", _TRAINING, "hcsr04", _MAPS / "enmt482-sonar1.yaml", _SONAR1, _CALIBRATION),
    MeasuredSet("robot_mb1433", _TRAINING, "mb1433", _MB1433_MAP, _SONAR2),
    MeasuredSet("robot_mb1433_bench", _TRAINING, "mb1433", _MB1433_MAP, _SONAR2, _CALIBRATION),
    MeasuredSet("drone_0607", (_0607,), "tof_ranger", _DRONE_MAP, prepare_drone(_0607)),
    MeasuredSet("drone_0425", (_0425,), "tof_ranger", _DRONE_MAP, prepare_drone(_0425)),
    MeasuredSet("drone_both", (_0425, _0607), "tof_ranger", _DRONE_MAP, prepare_drone(_0425, _0607)),
    MeasuredSet("drone_columns", (_0425, _0607), "tof_ranger", None, prepare_drone(_0425, _0607, own_columns=True)),
    MeasuredSet("ruler", _RULER, "hcsr04", _RULER_MAP, prepare_ruler),
    MeasuredSet("ruler_bench", _RULER, "hcsr04", _RULER_MAP, prepare_ruler, _RULER),
    MeasuredSet("tilted_plate", _PLATE, "hcsr04", _MAPS / "hcsr04-tilt.yaml", prepare_tilt),
    MeasuredSet("museum_lidar", _LIDAR, "lidar_sick", _MAPS / "carmen-fhw.yaml", prepare_lidar),
    MeasuredSet("terrain", _TERRAIN, "tof_ranger", OWN_MAPS / "terrain.yaml", prepare_terrain(own_columns=False)),
    MeasuredSet("terrain_columns", _TERRAIN, "tof_ranger", None, prepare_terrain(own_columns=True)),
)
