"""Public logs of real vehicles, where somebody has fetched them: docs/logs.md says from where. Nothing is committed."""

import json
import os
import threading
from collections.abc import Iterator
from functools import partial
from hashlib import sha256
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from tests.peers.fetch_flights import FLIGHTS, Flight, fetch, main
from tests.support.programs import run
from tests.support.shipped import ROOT

FOLDER = os.environ.get("MSP_RANGE_FLIGHTS", "")
"""A folder with the logs."""


def fetched(name: str) -> Path:
    """A log of the folder, the same as in the document; skips the test where it is absent."""
    path = Path(FOLDER) / name
    if not FOLDER or not path.exists():
        pytest.skip(f"no log {name}: docs/logs.md says where it is; MSP_RANGE_FLIGHTS names the folder")
    (flight,) = (each for each in FLIGHTS if each.name == name)
    assert sha256(path.read_bytes()).hexdigest() == flight.sha256
    return path


def imported(path: Path, out: Path, *options: str) -> dict[str, Any]:
    done = run("msp-lab import --json", path, "--out", out, *options)
    (found,) = json.loads(done.stdout)
    assert isinstance(found, dict)
    return found


def gap(dataset: Path, model: str, out: Path) -> dict[str, Any]:
    """The findings of `msp-lab gap`, without pictures."""
    sensor = ROOT / "configs" / "sensors" / model
    run("msp-lab gap --until add", dataset, "--model", sensor, "--out", out)
    found = json.loads((out / "gap.json").read_text())
    assert isinstance(found, dict)
    return found


def test_the_document_has_what_is_fetched() -> None:
    text = (ROOT / "docs" / "logs.md").read_text(encoding="utf-8")
    for flight in FLIGHTS:
        for each in (flight.repository, flight.commit, flight.path, f"{flight.size:,}", flight.sha256):
            assert each in text, f"{flight.name}: {each}"


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    """A server of tmp_path/served on the loopback interface."""
    (tmp_path / "served").mkdir()

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: Any) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path / "served"))) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_a_log_is_fetched_and_checked(tmp_path: Path, address: str) -> None:
    content = b"a flight"
    flight = Flight("who/what", "abc", "some logs/1 2.bin", len(content), sha256(content).hexdigest())
    assert "404" in fetch(flight, tmp_path / "new", address)
    place = tmp_path / "served" / "who" / "what" / "abc" / "some logs" / "1 2.bin"
    place.parent.mkdir(parents=True)
    place.write_bytes(b"another flight")
    assert f"expected {flight.sha256}" in fetch(flight, tmp_path / "new", address)
    assert not (tmp_path / "new").exists()
    place.write_bytes(content)
    assert fetch(flight, tmp_path / "new", address) == ""
    assert (tmp_path / "new" / "1 2.bin").read_bytes() == content
    place.unlink()
    assert fetch(flight, tmp_path / "new", address) == ""


def test_without_a_network_each_log_that_is_missing_is_a_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """As 'python -m tests.peers.fetch_flights flights/public' does it, which needs the internet."""
    assert main([str(tmp_path / "public")], "http://127.0.0.1:1") == 1
    lines = capfd.readouterr().err.splitlines()
    assert [line.split(": ")[0] for line in lines] == [flight.name for flight in FLIGHTS]
    assert all("refused" in line for line in lines)
    assert main([]) == 2


def test_a_sonar_under_an_ardusub_that_was_not_moved(tmp_path: Path) -> None:
    found = imported(fetched("2023-04-18 11-03-34.tlog"), tmp_path / "set")
    (sonar,) = found["rangers"]
    assert (sonar["readings"], sonar["silent"], sonar["low_cm"], sonar["high_cm"]) == (919, 0, 2865.0, 4102.0)
    # Its height is the barometer's, and says that it stood: no true range for readings that differ by 12 m.
    assert found["truth"] == "ekf"
    assert sonar["lag_s"] is None
    assert sonar["reference_span_cm"] < 2.0


def test_a_sonar_under_an_ardusub_that_dives(tmp_path: Path) -> None:
    """7 to 10 m of water, of which the autopilot takes 7 m; the depth is that of a pressure sensor in the water."""
    path = fetched("00000014.BIN")
    found = imported(path, tmp_path / "set")
    (sonar,) = found["rangers"]
    assert (found["form"], found["truth"], found["truth_source"]) == (
        "ArduPilot dataflash log, ArduSub V4.2.0-dev (18999a8b)",
        "ekf",
        "XKF1.PD",
    )
    assert found["others"]["barometer"] == "BARO[1].Alt"
    assert (sonar["readings"], sonar["no_echo"], sonar["maximum_cm"]) == (4399, 3216, 700.0)
    lag_s, low_s, high_s = sonar["lag_s"]
    assert 0.4 < low_s < lag_s < high_s < 1.3
    assert 5.0 < sonar["scatter_cm"] < 10.0
    assert any(note.startswith("no true range and no incidence_deg for 1 reading at a tilt") for note in sonar["notes"])
    # The pressure sensor in the hull is another reference, which is off by a metre.
    hull = imported(path, tmp_path / "hull", "--truth", "column:BARO.Alt")["rangers"][0]
    assert hull["reference_std_from"].startswith("its differences to BARO[1].Alt")
    assert hull["reference_std_cm"][0] > 50.0
    # Next to a model of another sonar what the import says of the lag is the finding.
    findings = gap(tmp_path / "set", "mb1242.yaml", tmp_path / "gap")
    assert "latency" in {each["name"] for each in findings["effects"]}
    assert findings["messages"][0].startswith("No echo is 700 cm in the log and 765 cm in the model: 3216 readings.")


def test_a_lidar_under_a_copter_that_crashes(tmp_path: Path) -> None:
    found = imported(fetched("log_11_2026-6-3-09-17-42.bin"), tmp_path / "set")
    down = found["rangers"][1]
    assert [each["is_down"] for each in found["rangers"]] == [False, True, False, False, False]
    counts = (down["readings"], down["silent"], down["too_near"], down["no_echo"], down["low_cm"], down["high_cm"])
    assert counts == (697, 8, 442, 132, 52.0, 736.0)
    overturned, steep = down["notes"]
    assert overturned.startswith("no true range and no incidence_deg for 3 readings at a tilt of 90 deg or more")
    assert "at tilts above 45 deg" in steep
    # 115 distances over a climb of 15 m and a fall: too few to see the lag.
    assert down["lag_s"] is None
    assert down["no_lag"].startswith("its 95 % interval is")
    # Without an echo, at true ranges beyond the reach of the model; 442 readings on the ground are too near.
    findings = gap(tmp_path / "set", "tof_ranger.yaml", tmp_path / "gap")
    assert findings["messages"][0].startswith("No echo is 800 cm in the log and 400 cm in the model: 743 readings.")
    assert findings["rows"] == 244


def test_a_lidar_under_a_copter_with_the_altitude_of_gnss(tmp_path: Path) -> None:
    path = fetched("esc_status_log.ulg")
    found = imported(path, tmp_path / "none")
    assert found["truth"] == ""
    assert found["others"]["ekf"].startswith(
        "bit 10 of estimator_status.control_mode_flags is set for 97 % of the time"
    )
    assert "actuator_controls_0.control[3]" in {each["source"] for each in found["series"]}
    found = imported(path, tmp_path / "set", "--truth", "column:vehicle_gps_position.alt*0.001")
    (lidar,) = found["rangers"]
    counts = (lidar["readings"], lidar["with_truth"], lidar["low_cm"], lidar["high_cm"])
    assert counts == (361, 358, 44.0, 1271.0)
    # GNSS comes half a second after the lidar.
    lag_s, low_s, high_s = lidar["lag_s"]
    assert -1.0 < low_s < lag_s < high_s < -0.1
    assert lidar["reference_std_from"].startswith("its differences to vehicle_air_data.baro_alt_meter")
    assert 10.0 < lidar["reference_std_cm"][0] < 60.0
    # The barometer is logged with holes of up to 2.2 s.
    (baro,) = imported(path, tmp_path / "baro", "--truth", "barometer")["rangers"]
    assert baro["notes"] == [
        "no true range for 98 readings: 1 before the reference begins or after it ends, 97 in holes of the reference "
        "of more than 1 s"
    ]
    assert gap(tmp_path / "set", "lidar_lite_v3.yaml", tmp_path / "gap")["rows"] == 358


def test_a_log_with_too_few_readings_for_a_height(tmp_path: Path) -> None:
    path = fetched("log_82_2022-12-1-15-26-52.ulg")
    found = imported(path, tmp_path / "set")
    assert found["truth"] == ""
    assert "cs_rng_hgt is set for 31 % of the time" in found["others"]["ekf"]
    done = run("msp-lab import --truth barometer", path, "--out", tmp_path / "baro", code=3)
    assert "found 46 readings with an echo and vehicle_air_data.baro_alt_meter, expected at least 50" in done.output
