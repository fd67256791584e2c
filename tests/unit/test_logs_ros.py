"""Bags of ROS 1 and 2, written by rosbags, as logs; cut, damaged, and with topics that are not known."""

import tracemalloc
from collections.abc import Callable
from functools import cache
from pathlib import Path
from shutil import copytree

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionMode

from msp_lab.logs import ros
from msp_lab.logs.log import LogRequest, VehicleLog
from msp_lab.logs.opening import open_log
from msp_range.recording.error import RecordingError
from tests.support.flight_logs import height_m, write_bag


def check(log: VehicleLog) -> None:
    (ranger,) = log.rangers
    assert ranger.name == "sonar_down"
    assert ranger.maximum_cm == pytest.approx(765.0, abs=1e-3)
    # Infinite is out of range; the stamp of the header counts, not when it was recorded.
    assert ranger.series.values[0] == pytest.approx(765.0, abs=1e-3)
    assert ranger.series.values[1] == pytest.approx(100.0 * height_m(-0.05), abs=1e-3)
    assert ranger.series.time_s[1] - ranger.series.time_s[0] == pytest.approx(0.05, abs=1e-6)
    mocap, own = log.references
    assert (mocap.kind, mocap.refused, own.kind) == ("mocap", "", "ekf")
    assert "does not say" in own.refused
    assert mocap.series.at(ranger.series.time_s[[40]])[0] == pytest.approx(height_m(2.0), abs=1e-6)
    # Half the angle is in the quaternion.
    assert log.context["tilt_deg"].values[3] == pytest.approx(np.degrees(0.1), 1e-6)
    assert log.context["air_temperature_c"].values[3] == 11.5


@pytest.mark.parametrize("form", ["ros1", "sqlite3", "mcap"])
def test_each_form_gives_the_same(tmp_path: Path, form: str) -> None:
    check(open_log(write_bag(tmp_path, form)))


@pytest.mark.parametrize("form", ["sqlite3", "mcap"])
def test_a_single_file_of_a_bag_is_enough(tmp_path: Path, form: str) -> None:
    folder = write_bag(tmp_path, form)
    (file,) = [each for each in folder.iterdir() if each.suffix != ".yaml"]
    check(open_log(file))


def test_any_field_of_a_topic(tmp_path: Path) -> None:
    path = write_bag(tmp_path, "ros1")
    reference = open_log(path, LogRequest(field="/vrpn/drone/pose.pose.orientation.w")).references[-1]
    assert (reference.kind, reference.series.values[0]) == ("column", pytest.approx(np.cos(0.05)))
    # One that is read anyway.
    reference = open_log(path, LogRequest(field="/vrpn/drone/pose.pose.position.z")).references[-1]
    assert reference.series.values[0] == height_m(0.0)
    with pytest.raises(RecordingError, match="orientation"):
        open_log(path, LogRequest(field="/vrpn/drone/pose.orientation.w"))


@pytest.mark.slow
def test_messages_that_are_not_read_take_no_memory(tmp_path: Path) -> None:
    """rosbags keeps 170 bytes for each message of a bag of ROS 1: 5 million small ones were 1 GB."""
    peak_bytes = []
    for others in (0, 40):
        folder = tmp_path / str(others)
        folder.mkdir()
        path = write_bag(folder, "ros1", others)
        tracemalloc.start()
        check(open_log(path))
        peak_bytes.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # A chunk at a time is in memory.
    assert peak_bytes[1] - peak_bytes[0] < 5_000_000


def test_a_range_nearer_than_the_minimum_is_no_answer() -> None:
    topic = ros._Topic("/sonar", "sensor_msgs/msg/Range", ("range", "min_range", "max_range"))
    for step, range_m in enumerate((0.1, -np.inf, 0.2, np.inf)):
        topic.add(float(step), (range_m, 0.2, 7.0), step, np.nan)
    (ranger,) = ros._rangers([topic])
    np.testing.assert_array_equal(ranger.series.values, [np.nan, np.nan, 20.0, 700.0])
    assert ranger.too_near == 2


def test_an_altitude_counts_with_a_ground_station_and_to_centimetres() -> None:
    topic = ros._Topic("/fix", "sensor_msgs/msg/NavSatFix", ros._FIELDS["sensor_msgs/msg/NavSatFix"])
    for time_s, (status, std_m) in enumerate([(2, 0.02), (2, 0.5), (0, 0.02), (2, 0.0)]):
        topic.add(time_s, (584.0, status, std_m**2), 0, np.nan)
    (rtk,) = ros._references([topic])
    assert np.isfinite(rtk.series.values).tolist() == [True, False, False, False]


Cut = Callable[[str, float], Path]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder with a bag of this form."""

    @cache
    def write(form: str) -> Path:
        folder = tmp_path_factory.mktemp(form)
        write_bag(folder, form)
        return folder

    return write


@pytest.fixture
def cut(written: Callable[[str], Path], tmp_path: Path) -> Cut:
    """A bag that ends early, as its computer lost power: without an index, and without what else is at its end."""

    def make(form: str, share: float) -> Path:
        (path,) = copytree(written(form), tmp_path / form).iterdir()
        (file,) = [each for each in (path.iterdir() if path.is_dir() else [path]) if each.suffix != ".yaml"]
        file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
        return path

    return make


@pytest.mark.parametrize("form", ["ros1", "sqlite3", "mcap"])
@pytest.mark.parametrize(("share", "least"), [(0.3, 150), (0.5, 280), (0.8, 470), (0.95, 560), (0.999, 590)])
def test_a_cut_bag_gives_what_is_whole(cut: Cut, form: str, share: float, least: int) -> None:
    log = open_log(cut(form, share))
    (ranger,) = log.rangers
    assert least <= len(ranger.series) <= 600
    heights_m = [height_m(each + 0.02 - 0.1) for each in ranger.series.time_s]
    echoed = ranger.series.values < 765.0
    np.testing.assert_allclose(ranger.series.values[echoed] / 100.0, np.array(heights_m)[echoed], atol=1e-3)
    # No message of a page that ends early, either, as SQLite fills it with zeros.
    (poses,) = [each.series for each in log.references if each.kind == "mocap"]
    np.testing.assert_allclose(poses.values, [height_m(each + 0.02) for each in poses.time_s], atol=1e-3)
    (note,) = log.notes[1:]
    assert "is cut or damaged after" in note
    assert note.endswith("those before are here.")


@pytest.mark.parametrize("form", ["ros1", "sqlite3", "mcap"])
def test_a_bag_without_a_whole_message_is_a_line(cut: Cut, form: str) -> None:
    with pytest.raises(RecordingError) as failed:
        open_log(cut(form, 0.0))
    assert len(str(failed.value).splitlines()) == 1


@pytest.mark.parametrize("form", ["sqlite3", "mcap"])
def test_a_folder_whose_metadata_are_damaged_is_read_by_its_files(tmp_path: Path, form: str) -> None:
    path = write_bag(tmp_path, form)
    (path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: 9, relative_")
    check(open_log(path))


@pytest.mark.parametrize("mode", [CompressionMode.FILE, CompressionMode.MESSAGE])
def test_a_packed_bag_is_unpacked(tmp_path: Path, mode: CompressionMode) -> None:
    check(open_log(write_bag(tmp_path, "sqlite3", packed=mode)))
