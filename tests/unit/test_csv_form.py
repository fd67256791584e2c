"""The one CSV form: what goes in comes out, and mistakes are told with file, line and column."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from msp_range.recording.csv_form import BASE_COLUMNS, CONTEXT_COLUMNS, MeasuredData, read_csv, write_csv
from msp_range.recording.error import RecordingError


def written(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


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


_NUMBERS = st.floats(allow_infinity=False) | st.integers(-(2**60), 2**60).map(float)
_WORDS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0\r"))
_NAMES = _WORDS.filter(lambda word: word != "")


@st.composite
def measured(draw: st.DrawFn) -> MeasuredData:
    rows = draw(st.integers(0, 8))

    def column(cells: st.SearchStrategy[object], dtype: type) -> np.ndarray:
        return np.array(draw(st.lists(cells, min_size=rows, max_size=rows)), dtype=dtype)

    columns = {
        "time_s": column(st.floats(allow_infinity=False, allow_nan=False), float),
        "sensor": column(_NAMES, str),
        "reading_cm": column(_NUMBERS, float),
    }
    for name in draw(st.lists(st.sampled_from(["run", "target", "throttle", "uptime_s"]), unique=True)):
        columns[name] = column(_WORDS, str) if name in {"run", "target"} else column(_NUMBERS, float)
    for name in draw(st.lists(st.sampled_from(["battery_v", "größe, oben", 'a "b"']), unique=True)):
        columns[name] = column(_NUMBERS, float)
    return MeasuredData(columns)


@settings(max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
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
    assert list(BASE_COLUMNS) == ["time_s", "sensor", "run", "reading_cm", "true_range_cm"]
    assert list(CONTEXT_COLUMNS) == [
        "condition", "air_temperature_c", "target_temperature_c", "humidity_pct", "incidence_deg", "range_rate_cm_s",
        "throttle", "vibration_hz", "uptime_s", "target", "target_size_cm", "neighbour_lag_ms", "neighbour_range_cm",
        "external_level_db", "external_duty", "external_distance_cm", "external_frequency_khz",
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
        ("time_s;sensor;reading_cm\n", "the column 'time_s' is missing. Columns are told apart by commas."),
        ("time_s,sensor,reading_cm,\n", "a.csv:1: column 4 has no name"),
        ("time_s,sensor,reading_cm,sensor\n", "a.csv:1: the column 'sensor' is there twice"),
        (HEADER + "1,a,2,\n1,a,2\n", "a.csv:3: found 3 cells, expected 4 as in the header"),
        (
            HEADER + '1,a,2,"two\nlines"\n\n2,a,x,\n',
            "a.csv:5: column 'reading_cm': found 'x', expected a number, or nothing where it is unknown",
        ),
        (HEADER + "1,a,inf,\n", "a.csv:2: column 'reading_cm': found 'inf', expected a number"),
        (HEADER + "1,a,2,\n,a,2,\n", "a.csv:3: column 'time_s': found nothing, expected a number"),
        (HEADER + "1,a,2,\n1,,2,\n", "a.csv:3: column 'sensor': found nothing, expected a name"),
        (HEADER + '1,a,2,"open\n', "not CSV: unexpected end of data"),
    ],
)
def test_mistakes_are_told_where_they_are(tmp_path: Path, text: str, message: str) -> None:
    path = written(tmp_path / "a.csv", text)
    with pytest.raises(RecordingError) as told:
        read_csv(path)
    assert message in str(told.value)
    assert str(path) in str(told.value)


def test_files_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"b\.csv: cannot be read: No such file"):
        read_csv(tmp_path / "b.csv")
    (tmp_path / "a.csv").write_bytes(b"time_s,sensor,reading_cm\n1,M\xf6we,3\n")
    with pytest.raises(RecordingError, match=r"a\.csv: not UTF-8"):
        read_csv(tmp_path / "a.csv")
    with pytest.raises(RecordingError, match="cannot be written: No such file"):
        write_csv(tmp_path / "no folder" / "a.csv", {"time_s": np.array([1.0])})
    with pytest.raises(ValueError, match="'reading_cm': found an infinite number at row 1"):
        write_csv(tmp_path / "c.csv", {"reading_cm": np.array([1.0, np.inf])})
    with pytest.raises(ValueError, match="'target': found a carriage return"):
        write_csv(tmp_path / "c.csv", {"target": np.array(["a", "b\r"])})
    with pytest.raises(ValueError, match="different lengths"):
        write_csv(tmp_path / "c.csv", {"time_s": np.array([1.0]), "reading_cm": np.array([1.0, 2.0])})
    assert not (tmp_path / "c.csv").exists()
