"""An ArduPilot log as pymavlink itself reads it, in pieces, cut, damaged, and as none."""

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.DFReader import DFReader_binary

from msp_lab.logs import ardupilot
from msp_lab.logs.ardupilot import WANTED, _barometer, _ranger, _version, flight_of, read_ardupilot, read_messages
from msp_lab.logs.log import LogRequest, MessageColumns, Ranger, ignored
from msp_range.recording.error import RecordingError

LOG = Path(__file__).parents[1] / "data" / "logs" / "arducopter.BIN"


ASKED = LogRequest()


def ranger_of(number: int, range_m: list[float], status: list[float] | None, parameters: dict[str, float]) -> Ranger:
    values = {"Dist": range_m} | ({} if status is None else {"Stat": status})
    messages = MessageColumns("RFND", values, np.arange(len(range_m), dtype=float))
    return _ranger(number, messages, ("Dist", "Orient"), parameters)


def test_values_are_those_of_pymavlink() -> None:
    found, lost = read_messages(LOG, WANTED, ignored)
    rows: dict[str, list[dict[str, Any]]] = {}
    with contextlib.closing(DFReader_binary(str(LOG))) as peer:
        while (message := peer.recv_match(type=list(WANTED))) is not None:
            rows.setdefault(message.get_type(), []).append(message.to_dict())
    assert lost == ""
    assert set(found) == set(rows)
    for name, fields in found.items():
        for field, values in fields.items():
            if values.dtype.kind == "f":
                # pymavlink multiplies by 0.01 in another order: the last bit differs.
                np.testing.assert_allclose(values, [row[field] for row in rows[name]], rtol=1e-14, err_msg=name)
    assert {len(fields["TimeUS"]) for name, fields in found.items() if name == "RFND"} == {890}


def test_pieces_give_what_the_whole_file_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, _ = read_messages(LOG, WANTED, ignored)
    monkeypatch.setattr(ardupilot, "PIECE_BYTES", 20_011)
    shares: list[float] = []
    pieces, lost = read_messages(LOG, WANTED, shares.append)
    assert lost == ""
    assert len(shares) > 10
    assert shares[-1] == 1.0
    for name, fields in whole.items():
        for field, values in fields.items():
            np.testing.assert_array_equal(values, pieces[name][field])


def test_two_rows_of_one_range_finder_and_time_both_stay(tmp_path: Path) -> None:
    with contextlib.closing(DFReader_binary(str(LOG))) as peer:
        form = peer.formats[peer.name_to_id["RFND"]]
        at = peer.offsets[peer.name_to_id["RFND"]][500]
    content = LOG.read_bytes()
    row = bytearray(content[at : at + form.len])
    (tmp_path / "a.bin").write_bytes(content[:at] + row + content[at:])
    (whole,), (twice,) = (read_ardupilot(path, ASKED).rangers for path in (LOG, tmp_path / "a.bin"))
    expected = np.insert(whole.series.values, 500, whole.series.values[500])
    np.testing.assert_array_equal(twice.series.values, expected)


def test_a_cut_and_damaged_log_gives_what_is_whole(tmp_path: Path) -> None:
    content = bytearray(LOG.read_bytes())
    content[150_000:150_600] = bytes(600)
    (tmp_path / "cut.bin").write_bytes(content[:-1000])
    log = read_ardupilot(tmp_path / "cut.bin", ASKED)
    assert 850 < len(log.rangers[0].series) < 890
    (note,) = log.notes
    lost = int(note.split()[0])
    assert note.endswith("bytes that belong to no message are left out.")
    assert 500 < lost < 900


@pytest.mark.parametrize(
    "content", [b"\xa3\x95", b"\xa3\x95" + bytes(3_000_000), b"not a log" * 1000, LOG.read_bytes()[:80]]
)
def test_what_is_no_log_is_a_line(tmp_path: Path, content: bytes, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bad.bin"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"bad\.bin: no dataflash log"):
        read_ardupilot(path, ASKED)
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    "parameters",
    [
        {"RNGFND1_MAX": 7.0, "RNGFND1_MAX_CM": 9.0, "RNGFND1_MIN": 0.2, "RNGFND1_MIN_CM": 1.0},
        {"RNGFND1_MAX_CM": 700.0, "RNGFND2_MAX_CM": 90.0, "RNGFND1_MIN_CM": 20.0, "RNGFND2_MIN_CM": 500.0},
        {"RNGFND_MAX_CM": 700.0, "RNGFND2_MAX_CM": 90.0, "RNGFND_MIN_CM": 20.0, "RNGFND2_MIN_CM": 500.0},
    ],
)
def test_beyond_the_maximum_is_no_echo_and_too_near_or_no_data_is_no_answer(parameters: dict[str, float]) -> None:
    """By the names of 4.7, of 4.0 to 4.6, and of versions before, which log no status."""
    ranger = ranger_of(1, [2.0, 0.0, 1.0, 0.1], [4.0, 3.0, 1.0, 2.0], parameters)
    np.testing.assert_array_equal(ranger.series.values, [200.0, 700.0, np.nan, np.nan])
    assert (ranger.maximum_cm, ranger.too_near) == (700.0, 1)
    without = ranger_of(1, [0.2, 7.5, 0.1], None, parameters)
    np.testing.assert_array_equal(without.series.values, [20.0, 700.0, np.nan])
    assert without.too_near == 1


def test_a_maximum_with_the_rounding_of_32_bits_is_the_reading_of_no_echo() -> None:
    """Of 7.6 as a 32-bit number, 759.9999905 cm, and of another that is rounded downwards."""
    for maximum_m in (np.float64(np.float32(7.6)), 7.6000001):
        ranger = ranger_of(1, [9.0, 8.0], [4.0, 3.0], {"RNGFND1_MAX": float(maximum_m)})
        assert ranger.series.values.tolist() == [ranger.maximum_cm] * 2 == [760.0, 760.0]


def test_plane_logs_the_throttle_in_per_cent(tmp_path: Path) -> None:
    (tmp_path / "plane.bin").write_bytes(LOG.read_bytes().replace(b"ArduCopter V4", b"ArduPlane V44"))
    copter, plane = (read_ardupilot(path, ASKED).context["throttle"] for path in (LOG, tmp_path / "plane.bin"))
    np.testing.assert_allclose(100.0 * plane.values, copter.values)


def test_the_second_range_finder_of_an_old_log_has_no_maximum_of_the_first() -> None:
    ranger = ranger_of(2, [8.0], None, {"RNGFND_MAX_CM": 700.0})
    assert ranger.series.values.tolist() == [800.0]


def test_the_barometer_is_the_one_that_the_autopilot_uses() -> None:
    """Of an ArduSub, the first one is in the hull."""
    rows = {
        "TimeUS": np.array([0.0, 0.0, 1e6, 1e6]),
        "I": np.array([0.0, 1.0] * 2),
        "Alt": np.array([9.0, 1.0, 9.5, 2.0]),
    }
    for parameters, expected in (
        ({}, [9.0, 9.5]),
        ({"BARO_PRIMARY": 1.0}, [1.0, 2.0]),
        ({"BARO_PRIMARY": 2.0}, [9.0, 9.5]),
    ):
        found = _barometer(flight_of({"BARO": rows}), parameters)
        assert found is not None
        assert found.values.tolist() == expected
        assert found.source == ("BARO[1].Alt" if expected[0] == 1.0 else "BARO.Alt")
    old = {name: {"TimeUS": np.arange(2.0), "Alt": np.full(2, alt)} for name, alt in (("BARO", 9.0), ("BAR2", 1.0))}
    for parameters, source in (
        ({"GND_PRIMARY": 1.0}, "BAR2.Alt"),
        ({"GND_PRIMARY": 0.0}, "BARO.Alt"),
        ({}, "BARO.Alt"),
    ):
        found = _barometer(flight_of(old), parameters)
        assert found is not None
        assert found.source == source


def test_the_version_of_old_logs_too() -> None:
    for text in ("APM:Copter V3.4.6 (e707341b)", "ArduSub V4.2.0-dev (18999a8b)"):
        assert _version({"MSG": {"Message": np.array([b"Frame: QUAD", text.encode()])}}) == text
    assert _version({"MSG": {"Message": np.array([b"PX4: de6b667d NuttX: 8c965992"])}}) == "unknown version"
