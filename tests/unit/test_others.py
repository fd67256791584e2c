"""The other sensors as the reference of each: the smoother, the geometry, and what the reference may not depend on."""

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from msp_lab.characterise.mixture import fit_mixture
from msp_lab.characterise.points import sort_into_points
from msp_lab.gap.candidates import COMMON, candidates_of
from msp_lab.gap.findings import FoundEffect, GapFindings, Settings
from msp_lab.gap.separate import compare_sensors
from msp_lab.gap.steps import Steps
from msp_lab.readings.intake import load_readings
from msp_lab.readings.others import Mounting, side_by_side, with_others_as_reference
from msp_lab.readings.smoother import START_STD, STATES, smooth
from msp_lab.readings.vehicle import mounting_of
from msp_range.arrays import Column
from msp_range.clock import VirtualClock
from msp_range.config import load_airframe
from msp_range.correction.calibration import IDENTITY
from msp_range.fusion import Angles
from msp_range.fusion.mounting import DownwardSensor
from msp_range.geometry import Matrix, rotation_matrix
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData, write_csv
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import Recording
from msp_range.recording.writer import Recorder
from msp_sim.model.model import Model
from tests.support.shipped import CONFIGS
from tests.support.slow import slow

_Array = NDArray[np.float64]
SENSOR = load_sensor_model("configs/sensors/mb1242.yaml").model_copy(update={"effects": ()})
MODEL = Model(SENSOR)
NAMES = ("a", "b", "c", "d")


def flown(n: int, seed: int, off_cm: dict[str, float] | None = None) -> dict[str, Column]:
    """Four sensors side by side that ping in turn at 10 Hz, over a vehicle that swings."""
    rng = np.random.default_rng(seed)
    time_s = 0.1 * np.arange(n)
    true_cm = 300.0 + 80.0 * np.sin(time_s) + 60.0 * np.sin(0.23 * time_s)
    sensor = np.array([NAMES[i % 4] for i in range(n)])
    reading_cm = MODEL.sample({"true_range_cm": true_cm}, rng)
    for name, shift_cm in (off_cm or {}).items():
        reading_cm[(sensor == name) & (reading_cm < 700.0)] += shift_cm
    return {"time_s": time_s, "sensor": sensor, "reading_cm": reading_cm, "hidden_cm": true_cm}


def test_the_smoother_gives_what_a_linear_model_of_all_readings_at_once_gives() -> None:
    """The posterior of all states by one dense solution, against the recursion forwards and back."""
    rng = np.random.default_rng(1)
    n, jerk, slope = 7, 0.5, 1e-3
    time_s = np.cumsum(rng.uniform(0.05, 0.3, n))
    geometry = np.column_stack([np.ones(n), np.zeros(n), np.zeros(n), rng.normal(0, 0.3, n), rng.normal(0, 0.3, n)])
    reading_m = 3.0 + 0.02 * rng.standard_normal(n)
    variance = np.full(n, 0.02**2)
    variance[3] = np.inf
    sets = np.stack([variance, np.full(n, 0.02**2)])
    found = smooth(time_s, reading_m, geometry, sets, np.full((2, n), jerk), np.full(2, slope))
    # All states at all times as one normal vector: x_i = F_i x_(i-1) + noise.
    prior = np.zeros((n * STATES, n * STATES))
    mean = np.zeros(n * STATES)
    start = np.array([reading_m[0], 0.0, 0.0, 0.0, 0.0])
    covariance, here = np.diag(START_STD**2), start
    blocks: list[_Array] = []
    for i in range(n):
        t = 0.0 if i == 0 else float(time_s[i] - time_s[i - 1])
        move = np.eye(STATES)
        move[0, 1] = move[1, 2] = t
        move[0, 2] = t * t / 2
        noise = np.zeros((STATES, STATES))
        noise[:3, :3] = jerk * np.array(
            [[t**5 / 20, t**4 / 8, t**3 / 6], [t**4 / 8, t**3 / 3, t**2 / 2], [t**3 / 6, t**2 / 2, t]]
        )
        noise[3, 3] = noise[4, 4] = slope * t
        covariance = move @ covariance @ move.T + noise
        here = move @ here
        mean[i * STATES : (i + 1) * STATES] = here
        blocks = [move @ each for each in blocks]
        for j, each in enumerate(blocks):
            prior[i * STATES : (i + 1) * STATES, j * STATES : (j + 1) * STATES] = each
            prior[j * STATES : (j + 1) * STATES, i * STATES : (i + 1) * STATES] = each.T
        prior[i * STATES : (i + 1) * STATES, i * STATES : (i + 1) * STATES] = covariance
        blocks.append(covariance)
    for b in range(2):
        rows = np.flatnonzero(np.isfinite(sets[b]))
        of_readings = np.zeros((rows.size, n * STATES))
        for k, i in enumerate(rows.tolist()):
            of_readings[k, i * STATES : (i + 1) * STATES] = geometry[i]
        gain = prior @ of_readings.T @ np.linalg.inv(of_readings @ prior @ of_readings.T + np.diag(sets[b][rows]))
        expected = mean + gain @ (reading_m[rows] - of_readings @ mean)
        left = prior - gain @ of_readings @ prior
        np.testing.assert_allclose(found.mean[b].ravel(), expected, rtol=1e-5, atol=1e-6)
        for i in range(n):
            place = slice(i * STATES, (i + 1) * STATES)
            np.testing.assert_allclose(found.covariance[b, i], left[place, place], rtol=1e-4, atol=1e-7)


def test_the_others_know_the_range_as_well_as_they_say() -> None:
    columns = flown(800, 2)
    found = with_others_as_reference(MeasuredData(columns), MODEL, side_by_side(NAMES)).data
    known = ~np.isnan(found["true_range_cm"])
    assert known.mean() > 0.98
    off_cm = (found["true_range_cm"] - found["hidden_cm"])[known]
    std_cm = found["true_range_std_cm"][known]
    assert 0.4 < np.median(std_cm) < 1.6
    assert 0.8 < np.sqrt(np.mean((off_cm / std_cm) ** 2)) < 1.25
    slope = np.gradient(columns["hidden_cm"], columns["time_s"])
    assert np.sqrt(np.mean((found["range_rate_cm_s"] - slope)[known] ** 2)) < 6.0
    assert np.abs(found["incidence_deg"][known]).max() < 1e-6
    assert set(found["reference"].tolist()) == {"others"}


def test_a_vehicle_on_its_side_for_a_moment_leaves_the_other_readings_their_reference() -> None:
    """Before the take-off, perhaps, when it is carried: then a sensor looks past the ground."""
    columns = flown(400, 2)
    over = rotation_matrix(math.radians(88.0), 0.0, 0.0)
    level = side_by_side(NAMES)

    def rotations(time_s: _Array) -> list[Matrix | None]:
        return [over if 20.0 < each < 20.25 else None for each in time_s.tolist()]

    found, of_level = (
        with_others_as_reference(MeasuredData(columns), MODEL, each).data
        for each in (Mounting(level.sensors, rotations), level)
    )
    aside = (columns["time_s"] > 20.0) & (columns["time_s"] < 20.25)
    assert np.isnan(found["true_range_cm"][aside]).all()
    known = ~np.isnan(of_level["true_range_cm"]) & ~aside
    apart_cm = (found["true_range_cm"] - of_level["true_range_cm"])[known]
    assert not np.isnan(apart_cm).any()
    assert np.abs(apart_cm).max() < 5.0


@pytest.mark.slow
def test_a_sensor_is_no_part_of_its_own_reference_and_nor_is_the_truth() -> None:
    columns = flown(400, 3)
    plain = with_others_as_reference(MeasuredData(columns), MODEL, side_by_side(NAMES))
    informed = {**columns, "true_range_cm": columns["hidden_cm"] + 50.0, "neighbour_range_cm": np.full(400, 1.0)}
    of_informed = with_others_as_reference(MeasuredData(informed), MODEL, side_by_side(NAMES))
    np.testing.assert_array_equal(plain.data["true_range_cm"], of_informed.data["true_range_cm"])
    assert "neighbour_range_cm" not in of_informed.data
    # What a sensor reads moves the others' reference, and not its own; its mean difference is taken off.
    moved = with_others_as_reference(MeasuredData(flown(400, 3, {"a": 6.0})), MODEL, side_by_side(NAMES), ["a"])
    without = with_others_as_reference(MeasuredData(columns), MODEL, side_by_side(NAMES), ["a"])
    own = columns["sensor"] == "a"
    np.testing.assert_allclose(moved.data["true_range_cm"][~own], without.data["true_range_cm"][~own])
    shift_cm = moved.offsets_cm["a"] - without.offsets_cm["a"]
    assert shift_cm == pytest.approx(6.0, abs=0.3)
    apart_cm = moved.data["true_range_cm"][own] - without.data["true_range_cm"][own]
    np.testing.assert_allclose(apart_cm, shift_cm, atol=1e-6)


@pytest.mark.slow
def test_a_sensor_that_is_far_off_has_its_whole_offset_taken_off() -> None:
    """20 cm are beyond what counts as an outlier of the others, and each run has to get the same offset."""
    for seed in (3, 4, 5):
        found = with_others_as_reference(MeasuredData(flown(400, seed, {"a": 20.0})), MODEL, side_by_side(NAMES))
        assert found.offsets_cm["a"] == pytest.approx(20.0, abs=0.8)


@pytest.mark.slow
def test_tilt_and_position_come_from_the_vehicle() -> None:
    """A wide pallet that rolls by 8 deg over a slope: level and side by side the sensors would differ by 28 cm."""
    rng = np.random.default_rng(4)
    n, arm_m = 600, 1.0
    time_s: _Array = np.asarray(0.1 * np.arange(n), dtype=np.float64)
    places = {
        "a": (arm_m, -arm_m, 0.0),
        "b": (arm_m, arm_m, 0.0),
        "c": (-arm_m, -arm_m, 0.0),
        "d": (-arm_m, arm_m, 0.0),
    }
    sensors = {name: DownwardSensor(place, (0.0, 0.0, 1.0), "nearest") for name, place in places.items()}

    def rotations(at_s: _Array) -> Sequence[Matrix | None]:
        return [rotation_matrix(math.radians(8.0) * math.sin(t), 0.0, 0.3) for t in at_s.tolist()]

    sensor = np.array([NAMES[i % 4] for i in range(n)])
    height_m = 3.0 + 0.5 * np.sin(0.4 * time_s)
    seen = [
        sensors[name].turned(rotation).view(float(h), 0.05, -0.03)
        for name, rotation, h in zip(sensor.tolist(), rotations(time_s), height_m, strict=True)
        if rotation is not None
    ]
    true_cm = np.array([100.0 * each.expected_m for each in seen if each is not None])
    columns = {"time_s": time_s, "sensor": sensor, "reading_cm": MODEL.sample({"true_range_cm": true_cm}, rng)}
    found = with_others_as_reference(MeasuredData(columns), MODEL, Mounting(sensors, rotations)).data
    off_cm = found["true_range_cm"] - true_cm
    assert np.sqrt(np.nanmean(off_cm**2)) < 2.0
    assert np.nanstd(off_cm / found["true_range_std_cm"]) < 1.3
    # Roll of 8 deg over a slope of 3 deg.
    assert 8.0 < np.nanmax(found["incidence_deg"]) < 13.0
    level = with_others_as_reference(MeasuredData(columns), MODEL, side_by_side(NAMES)).data
    assert np.sqrt(np.nanmean((level["true_range_cm"] - true_cm) ** 2)) > 5.0


@pytest.mark.slow
def test_the_models_own_effects_agree_with_a_reference_that_has_no_offset() -> None:
    """In cold air readings are 5 % long, 10 cm between 160 and 440 cm: the model says so of every reading."""
    cold = Model.of(load_sensor_model("configs/sensors/mb1242.yaml"))
    columns = flown(1600, 9)
    columns |= {"air_temperature_c": np.full(1600, -8.0), "run": np.full(1600, "cold")}
    context = {"true_range_cm": columns["hidden_cm"], "air_temperature_c": columns["air_temperature_c"]}
    columns["reading_cm"] = cold.sample(context, np.random.default_rng(9))
    found = with_others_as_reference(MeasuredData(columns), cold, side_by_side(NAMES)).data
    for name in NAMES:
        own = found.select(np.flatnonzero((found["sensor"] == name) & ~np.isnan(found["true_range_cm"])))
        off_cm = own["reading_cm"] - cold.rows(own.columns).centre_cm
        hits = np.abs(off_cm) < 10.0
        assert hits.mean() > 0.9
        assert abs(off_cm[hits].mean()) < 0.5
        low, high = (off_cm[hits & ((own["true_range_cm"] > 300.0) == far)].mean() for far in (False, True))
        assert abs(high - low) < 1.0


def test_two_sensors_are_too_few() -> None:
    columns = {name: column[flown(80, 5)["sensor"] < "c"] for name, column in flown(80, 5).items()}
    with pytest.raises(RecordingError, match="found 1 other downward sensors to compare a with, expected at least 2"):
        with_others_as_reference(MeasuredData(columns), MODEL, side_by_side(NAMES))


@pytest.mark.slow
def test_characterise_with_the_others_gets_the_sensors_spread(tmp_path: Path) -> None:
    columns = flown(3000, 6)
    del columns["hidden_cm"]
    write_csv(tmp_path / "flight.csv", columns)
    loaded = load_readings([tmp_path / "flight.csv"], SENSOR, truth="others", sensors=["b"])
    points = sort_into_points(loaded.data, SENSOR)
    assert {point.condition for point in points} == {"baseline"}
    _, parameters = fit_mixture(points, IDENTITY, SENSOR, np.random.default_rng(1))
    assert parameters.sigma_cm == pytest.approx(SENSOR.reading_model.sigma_cm, rel=0.07)
    assert parameters.weights.missed == pytest.approx(SENSOR.reading_model.weights.missed, abs=0.012)
    assert any("cannot be seen: the air's temperature" in each for each in loaded.messages)
    assert any("on average over all runs" in each for each in loaded.messages) is False


Named = tuple[str, float]


class Compared:
    """The workflow of one sensor, with what it finds given in advance by how many sensors are no reference."""

    def __init__(self, folder: Path, found: dict[tuple[str, int], Named]) -> None:
        self.folder, self.found = folder, found

    def all(self, paths: list[Path], settings: Settings, until: str) -> GapFindings:
        assert (until, settings.of) == ("add", (self.folder.name,))
        named = self.found.get((self.folder.name, int(paths[0].stem[-1]) - 1))
        effects = (FoundEffect(named[0], "named", {}, named[1], 9.0),) if named else ()
        return GapFindings("explained", rows=100, runs=4, effects=effects)

    def show(self) -> None:
        raise AssertionError("not asked")


LARGE, SMALL = ("latency", 0.1), ("latency", 0.02)


@pytest.mark.parametrize(
    ("found", "named", "without", "doubted"),
    [
        ({}, [], [], []),
        ({("b", 0): LARGE}, ["b"], [], []),
        # What is left of b's effect in another is gone without b; one that had nothing is not asked by fewer others.
        ({("b", 0): LARGE, ("c", 0): SMALL, ("a", 1): SMALL}, ["b"], ["c"], []),
        # What has another name without b may be the fault of those that are left.
        ({("b", 0): LARGE, ("c", 0): ("bend", 0.02), ("c", 1): SMALL}, ["b", "c"], ["c"], ["c"]),
        # A second one has too few others left to compare a third with.
        (
            {("b", 0): LARGE, ("c", 0): SMALL, ("d", 0): SMALL, ("c", 1): ("latency", 0.05), ("d", 1): SMALL},
            ["b", "c", "d"],
            ["c", "d"],
            ["d"],
        ),
    ],
)
def test_the_one_that_differs_most_leaves_the_reference(
    tmp_path: Path, found: dict[tuple[str, int], Named], named: list[str], without: list[str], doubted: list[str]
) -> None:
    columns = flown(240, 8)
    del columns["hidden_cm"]
    write_csv(tmp_path / "flight.csv", columns)
    settings = Settings("configs/sensors/mb1242_bench.yaml")
    steps = cast(Callable[[Path], Steps], lambda folder: Compared(folder, found))
    gaps, messages = compare_sensors([tmp_path / "flight.csv"], settings, tmp_path / "gap", steps, draw=False)
    assert [gap.sensor for gap in gaps if gap.named] == named
    assert [gap.sensor for gap in gaps if gap.without == ("b",)] == without
    assert [gap.sensor for gap in gaps if gap.doubted] == doubted
    assert any("cannot be seen" in message for message in messages)
    assert len(list((tmp_path / "gap").glob("readings-*.csv"))) == (2 if without else 1)


def test_what_all_sensors_have_in_common_is_not_asked() -> None:
    contexts = {
        "true_range_cm": np.array([100.0, 200.0]),
        "air_temperature_c": np.array([0.0, 20.0]),
        "range_rate_cm_s": np.array([1.0, 2.0]),
        "run": np.array(["1", "2"]),
    }
    asked = {each.effect.name for each in candidates_of(MODEL, contexts)[0]}
    assert {"air_temperature", "motion_during_ping", "latency", "range_scale"} <= asked
    of_others = {each.effect.name for each in candidates_of(MODEL, {**contexts, "reference": np.full(2, "others")})[0]}
    assert of_others == asked - COMMON


def landed(seed: int, stands_cm: float) -> dict[str, Column]:
    """A flight over ground that rises to the side by 4 deg, and 20 s on its legs: what is at the minimum reads that."""
    rng = np.random.default_rng(seed)
    time_s = 0.1 * np.arange(700)
    height_cm = np.interp(time_s, [0, 2, 5, 45, 50, 70], [stands_cm, stands_cm, 300, 250, stands_cm, stands_cm])
    height_cm = height_cm + 60.0 * np.sin(time_s) * np.clip((height_cm - stands_cm) / 200.0, 0.0, 1.0)
    sensor = np.array([NAMES[i % 4] for i in range(700)])
    off_cm = np.array([{"a": -2.8, "b": 0.0, "c": 0.0, "d": 2.8}[name] for name in sensor.tolist()])
    reading_cm = np.clip(MODEL.sample({"true_range_cm": height_cm + off_cm}, rng), 20.0, None)
    return {"time_s": time_s, "sensor": sensor, "reading_cm": reading_cm, "hidden_cm": height_cm + off_cm}


@pytest.mark.parametrize("stands_cm", [8.0, *slow(40.0)])
def test_a_vehicle_on_the_ground_blames_no_sensor(stands_cm: float) -> None:
    for seed in range(3):
        columns = landed(seed, stands_cm)
        found = with_others_as_reference(MeasuredData(columns), MODEL, side_by_side(NAMES))
        true_cm = found.data["true_range_cm"]
        assert np.isnan(true_cm[columns["time_s"] > 51.0]).all()
        flies = (columns["time_s"] > 6.0) & (columns["time_s"] < 45.0)
        assert not np.isnan(true_cm[flies]).any()
        off_cm = (true_cm - columns["hidden_cm"])[flies]
        for name in NAMES:
            assert abs(off_cm[columns["sensor"][flies] == name].mean()) < 0.6


def test_a_table_that_stands_is_a_bench() -> None:
    columns = flown(400, 1)
    columns["reading_cm"] = MODEL.sample({"true_range_cm": np.full(400, 60.0)}, np.random.default_rng(1))
    found = with_others_as_reference(MeasuredData(columns), MODEL, side_by_side(NAMES)).data
    assert not np.isnan(found["true_range_cm"]).any()


def test_the_note_is_the_mean_over_the_readings_of_the_file(tmp_path: Path) -> None:
    parts = [flown(800, 1, {"a": 4.0}), flown(160, 2, {"a": 10.0})]
    for number, part in enumerate(parts):
        write_csv(tmp_path / f"{number}.csv", {name: column for name, column in part.items() if name != "hidden_cm"})
    loaded = load_readings([tmp_path / "0.csv", tmp_path / "1.csv"], SENSOR, truth="others")
    (note,) = [each for each in loaded.messages if "on average over all runs" in each]
    assert float(note.split("a +")[1].split(" cm")[0]) == pytest.approx(5.0, abs=0.4)


def test_a_recordings_attitudes_are_used_from_a_little_before_they_came(tmp_path: Path) -> None:
    """One each second, of a roll that grows by 0.1 rad: at an echo the one that comes within a tenth of a second."""
    path, vehicle = tmp_path / "flight.mcap", load_airframe(CONFIGS / "quad_pallet.yaml")
    recorder = Recorder(path, VirtualClock(0.0), files=vehicle.files)
    for i in range(5):
        recorder.write("/attitude", i + 0.05, Angles(float(i), 0.1 * i, 0.0, 0.0)._asdict())
    recorder.close()
    mounting = mounting_of(Recording(path))
    assert mounting is not None
    assert mounting.sensors.keys() == {each.name for each in vehicle.downward}
    rotations = mounting.rotations(np.array([-1.0, 2.0, 2.9, 3.0, 3.7]))
    rolls = [None if each is None else math.atan2(each[2][1], each[2][2]) for each in rotations]
    assert rolls[0] is None, "nothing has come"
    # 0.9 s after the second one nothing is known any more, and at 3.7 s neither.
    assert rolls == [None, pytest.approx(0.2), None, pytest.approx(0.3), None]
