"""The one CSV form: what goes in comes out, and user errors are reported with file, line and column."""

import gzip
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msp_lab.logs.elsewhere import _column
from msp_lab.logs.truth import Truth
from msp_lab.readings.column_map import load_map, read_mapped
from msp_range.input_file import CONTROL
from msp_range.recording.columns import BASE_COLUMNS, CONTEXT_COLUMNS
from msp_range.recording.csv_form import MeasuredData, read_csv, short_list, write_csv
from msp_range.recording.error import RecordingError


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_a_packed_file_is_read_and_one_that_is_damaged_is_refused_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "a.csv.gz"
    packed = gzip.compress(b"time_s,sensor,reading_cm\n0.5,left,120\n")
    path.write_bytes(packed)
    assert read_csv(path)["reading_cm"].tolist() == [120.0]
    for damaged in (packed[:-9], b"no gzip", packed[:10] + b"\xff" + packed[11:]):
        path.write_bytes(damaged)
        with pytest.raises(RecordingError, match=r"a\.csv\.gz: cannot be unpacked"):
            read_csv(path)


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_text_in_utf_16_is_said_to_be_that(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes("\ufefftime_s,sensor,reading_cm\n".encode(encoding))
    with pytest.raises(RecordingError, match="1: found UTF-16, expected text in UTF-8"):
        read_csv(path)


def test_a_column_of_numbers_that_has_a_word_further_on_is_words_as_they_were_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("msp_range.recording.csv_form.BLOCK", 2)
    rows = "".join(f"0.5,left,120,{note}\n" for note in ("1", "02", "3.50", "gust"))
    path = written(tmp_path / "a.csv", f"time_s,sensor,reading_cm,note\n{rows}")
    assert read_csv(path)["note"].tolist() == ["1", "02", "3.50", "gust"]


def test_of_many_columns_the_first_ones_are_named() -> None:
    names = [f"c{number}" for number in range(25)]
    assert short_list(names) == ", ".join(names[:20]) + " and 5 more"
    assert short_list(names[:20]) == ", ".join(names[:20])


def test_a_file_that_ends_within_a_character_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(b"time_s,reading_cm,sensor\n0.5,120,caf\xc3")
    with pytest.raises(RecordingError, match=r"a\.csv:2: found the byte 0xc3, expected text in UTF-8"):
        read_csv(path)


def test_reads_numbers_words_and_what_is_unknown(tmp_path: Path) -> None:
    path = written(
        tmp_path / "a.csv",
        "time_s,sensor,run,reading_cm,true_range_cm,throttle,target,battery_v,pilot\n"
        "0.5,left,1,120,118.5,0.25,grass,12.6,Ann\n"
        "0.6,right,1,,,,,,\n",
    )
    data = read_csv(path)
    assert len(data) == 2
    assert list(data.columns) == [
        "time_s", "sensor", "run", "reading_cm", "true_range_cm", "throttle", "target", "battery_v", "pilot",
    ]  # fmt: skip
    np.testing.assert_array_equal(data["reading_cm"], [120.0, np.nan])
    np.testing.assert_array_equal(data["throttle"], [0.25, np.nan])
    np.testing.assert_array_equal(data["battery_v"], [12.6, np.nan])
    assert data["run"].tolist() == ["1", "1"]
    assert data["target"].tolist() == ["grass", ""]
    assert data["pilot"].tolist() == ["Ann", ""]
    assert "humidity_pct" not in data


_NUMBERS = st.floats(-1e30, 1e30) | st.just(float("nan")) | st.integers(-(2**60), 2**60).map(float)
_WORDS = st.text(st.characters().filter(lambda character: CONTROL.search(character) is None))
_NAMES = _WORDS.filter(lambda word: word != "")


@st.composite
def measured(draw: st.DrawFn) -> MeasuredData:
    rows = draw(st.integers(0, 8))

    def column(cells: st.SearchStrategy[object], dtype: type) -> np.ndarray:
        return np.array(draw(st.lists(cells, min_size=rows, max_size=rows)), dtype=dtype)

    columns = {
        "time_s": column(st.floats(-1e30, 1e30), float),
        "sensor": column(_NAMES, str),
        "reading_cm": column(_NUMBERS, float),
    }
    for name in draw(st.lists(st.sampled_from(["run", "target", "throttle", "uptime_s"]), unique=True)):
        columns[name] = column(_WORDS, str) if name in {"run", "target"} else column(_NUMBERS, float)
    for name in draw(st.lists(st.sampled_from(["battery_v", "größe, oben", 'a "b"']), unique=True)):
        columns[name] = column(_NUMBERS, float)
    return MeasuredData(columns)


@pytest.mark.slow
@settings(max_examples=100)
@given(data=measured())
def test_what_was_written_is_read(tmp_path: Path, data: MeasuredData) -> None:
    (tmp_path / "a.csv").unlink(missing_ok=True)
    write_csv(tmp_path / "a.csv", data)
    back = read_csv(tmp_path / "a.csv")
    assert set(back.columns) == set(data.columns)
    for name in data.columns:
        assert back[name].dtype.kind == data[name].dtype.kind, name
        np.testing.assert_array_equal(back[name], data[name])


def test_writes_the_known_columns_first_and_whole_numbers_whole(tmp_path: Path) -> None:
    columns = {
        "pilot": np.array(["Ann", ""]),
        "throttle": np.array([0.5, np.nan]),
        "reading_cm": np.array([120.0, np.nan]),
        "sensor": np.array(["left", "right"]),
        "time_s": np.array([0.125, 0.1 + 0.2]),
    }
    write_csv(tmp_path / "a.csv", columns)
    assert (tmp_path / "a.csv").read_text() == (
        "time_s,sensor,reading_cm,throttle,pilot\n0.125,left,120,0.5,Ann\n0.30000000000000004,right,,,\n"
    )


def test_the_columns_are_those_that_were_agreed() -> None:
    assert list(BASE_COLUMNS) == ["time_s", "sensor", "run", "reading_cm", "true_range_cm", "true_range_std_cm"]
    assert list(CONTEXT_COLUMNS) == [
        "condition", "air_temperature_c", "target_temperature_c", "humidity_pct", "incidence_deg",
        "range_rate_cm_s", "throttle", "vibration_hz", "uptime_s", "time_in_run_s", "time_of_day_h", "target",
        "target_size_cm", "neighbour_lag_ms", "neighbour_range_cm", "external_level_db", "external_duty",
        "external_distance_cm", "external_frequency_khz", "reference",
    ]  # fmt: skip


def test_files_of_spreadsheets(tmp_path: Path) -> None:
    """A byte order mark, CRLF, blanks in the header, empty lines, and nan for nothing, as other programs write."""
    (tmp_path / "a.csv").write_bytes(b"\xef\xbb\xbftime_s, sensor , reading_cm\r\n\r\n1,left,nan\r\n2,left,3\r\n\r\n")
    data = read_csv(tmp_path / "a.csv")
    np.testing.assert_array_equal(data["reading_cm"], [np.nan, 3.0])


def test_other_columns_can_be_required(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", "true_range_cm,throttle\n100,0.5\n")
    assert read_csv(path, required=["true_range_cm"])["throttle"].tolist() == [0.5]
    with pytest.raises(RecordingError, match="'time_s' is missing"):
        read_csv(path)


HEADER = "time_s,sensor,reading_cm,target\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a.csv: empty, expected a header with the columns time_s, sensor, reading_cm"),
        ("time_s,sensor,reading\n", "a.csv:1: the column 'reading_cm' is missing. Is it 'reading'?"),
        ("time_s;sensor;reading_cm\n", "the column 'time_s' is missing. Columns are separated by commas."),
        ("time_s,sensor,reading_cm,\n", "a.csv:1: column 4 has no name"),
        ("time_s,sensor,reading_cm,sensor\n", "a.csv:1: the column 'sensor' is there twice"),
        (HEADER + "1,a,2,\n1,a,2\n", "a.csv:3: found 3 cells, expected 4 as in the header"),
        (HEADER + "1,a,2,,7\n", "a.csv:2: found 5 cells, expected 4 as in the header"),
        (
            HEADER + '1,a,2,"two\nlines"\n\n2,a,x,\n',
            "a.csv:5: column 'reading_cm': found 'x', expected a number, or nothing where it is unknown",
        ),
        (HEADER + "1,a,inf,\n", "a.csv:2: column 'reading_cm': found 'inf', expected a number"),
        (HEADER + "1,a,2,\n,a,2,\n", "a.csv:3: column 'time_s': found nothing, expected a number"),
        (HEADER + "1,a,2,\n1,,2,\n", "a.csv:3: column 'sensor': found nothing, expected a name"),
        (HEADER + '1,a,2,"open\n', "not CSV: unexpected end of data"),
        (HEADER + "1,a,1e300,\n", "a.csv:2: column 'reading_cm': found '1e300', expected a number"),
        (HEADER + "1,a,2,b\x00c\n", "a.csv:2: found the control character '\\x00', expected text"),
        (HEADER + "1,a,2,\x1b[31m\n", "a.csv:2: found the control character '\\x1b', expected text"),
        (HEADER + f"1,a,2,{'x' * 300}\n", "column 'target': found a word of 300 characters, expected at most 200"),
        (HEADER + f"1,a,2,{'x' * 200_000}\n", "a.csv:2: not CSV: field larger than field limit (131072)"),
        ("x" * 10_000_000, "a.csv:1: found a line of more than 262144 characters"),
        ("a" + "," * 2000, "a.csv:1: found 2001 columns, expected at most 1000"),
        ("a" + "," * 2_000_000, "a.csv:1: found a line of more than 262144 characters"),
        (
            ",".join(f"c{i}" for i in range(900)),
            "Found: c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11, c12, c13, c14",
        ),
    ],
)
def test_user_errors_are_reported_with_their_place(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path / "a.csv", text)
    with pytest.raises(RecordingError) as raised:
        read_csv(path)
    assert message in str(raised.value)
    assert str(path) in str(raised.value)
    assert len(str(raised.value)) < 1000


@pytest.mark.slow
def test_many_rows_of_long_words_would_take_too_much_memory(tmp_path: Path) -> None:
    path = written(tmp_path / "a.csv", HEADER + f"1,a,2,{'x' * 200}\n" + "1,a,2,x\n" * 400_000)
    with pytest.raises(RecordingError, match="'target': found a word of 200 characters in a table of 400001 rows, exp"):
        read_csv(path)


def test_what_is_no_table_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.csv")
    with pytest.raises(RecordingError, match=r"pipe\.csv: cannot be read: found a pipe, expected a file"):
        read_csv(tmp_path / "pipe.csv")
    with pytest.raises(RecordingError, match="/dev/zero: cannot be read: found a device, expected a file"):
        read_csv("/dev/zero")
    with pytest.raises(RecordingError, match="cannot be read: found a directory, expected a file"):
        read_csv(tmp_path)
    with (tmp_path / "sparse.csv").open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(RecordingError, match=r"sparse\.csv: cannot be read: found 1099511.6 MB, expected at most 536"):
        read_csv(tmp_path / "sparse.csv")
    # Text in pieces: a letter of two bytes across their border, and a wrong one after it.
    content = HEADER.encode() + b"1,a,2,x\n" * 8188
    (tmp_path / "b.csv").write_bytes(content + "1,a,2,ö\n".encode() * 10 + b"1,a,2,\xff\n")
    with pytest.raises(RecordingError, match=r"b\.csv:8200: found the byte 0xff, expected text in UTF-8"):
        read_csv(tmp_path / "b.csv")


def test_a_table_that_cannot_be_written_whole_is_not_there(tmp_path: Path) -> None:
    (tmp_path / "a.csv").mkdir()
    with pytest.raises(RecordingError, match="there is a file already"):
        write_csv(tmp_path / "a.csv", {"time_s": np.array([1.0])})
    with pytest.raises(RecordingError, match=r"cannot be written: File name too long"):
        write_csv(tmp_path / ("b" * 300), {"time_s": np.array([1.0])})
    assert os.listdir(tmp_path) == ["a.csv"]


def test_files_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"b\.csv: cannot be read: No such file"):
        read_csv(tmp_path / "b.csv")
    (tmp_path / "a.csv").write_bytes(b"time_s,sensor,reading_cm\n1,M\xf6we,3\n")
    with pytest.raises(RecordingError, match=r"a\.csv:2: found the byte 0xf6, expected text in UTF-8"):
        read_csv(tmp_path / "a.csv")
    with pytest.raises(RecordingError, match="cannot be written: No such file"):
        write_csv(tmp_path / "no folder" / "a.csv", {"time_s": np.array([1.0])})
    with pytest.raises(ValueError, match=r"'reading_cm': found inf at row 1, expected at most 1e\+30"):
        write_csv(tmp_path / "c.csv", {"reading_cm": np.array([1.0, np.inf])})
    with pytest.raises(ValueError, match="'target': found a control character in"):
        write_csv(tmp_path / "c.csv", {"target": np.array(["a", "b\r"])})
    with pytest.raises(ValueError, match="different lengths"):
        write_csv(tmp_path / "c.csv", {"time_s": np.array([1.0]), "reading_cm": np.array([1.0, 2.0])})
    assert not (tmp_path / "c.csv").exists()


@pytest.mark.parametrize("cell", ["1_0", "١٢", "１２"])
def test_what_only_python_takes_for_a_number_is_none(tmp_path: Path, cell: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(f"time_s,sensor,reading_cm,true_range_cm\n1,a,{cell},2\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"a\.csv:2: column 'reading_cm': found .*, expected a number"):
        read_csv(path)
    path.write_text(f"dist\n{cell}\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"a\.csv:2: column 'dist': found .*, expected a number"):
        read_mapped(path, load_map(["reading_cm=dist"]), 765.0)
    path.write_text(f"t,z\n{cell},1\n", encoding="utf-8")
    with pytest.raises(RecordingError, match=r"a\.csv:2: column 't': found .*, expected a number"):
        _column(path, Truth("column", "z"))
    # In a column of one's own it is a word.
    path.write_text(f"time_s,sensor,reading_cm,own\n1,a,3,{cell}\n", encoding="utf-8")
    assert read_csv(path)["own"].tolist() == [cell]
