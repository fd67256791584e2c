"""`msp-lab fleet` on small drawn fleets."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from evaluation.fleet import score
from evaluation.fleet.generator import fleet
from msp_lab.fleet.terms import BASE
from msp_lab.readings.dataset import record_runs, write_tables
from msp_range.recording.csv_form import MeasuredData
from msp_sim.model.model import load_model
from tests.support.programs import run
from tests.support.waiting import LIMIT_S, until

MODEL = "configs/sensors/mb1242.yaml"
STARTED_S = 1
"""Processor time of a worker after which it is killed [s]: on a fast computer it computes by then, and ends half a
second later; on a slow one it still imports, which is as good a moment."""


def make_dataset(folder: Path, vehicles: int, late_ms: dict[int, float], readings: int = 150) -> Path:
    """Vehicles of four sessions each, some of which read late."""
    rng = np.random.default_rng(4)
    for k in range(vehicles):
        model = load_model(MODEL).adding("latency", delay_ms=late_ms.get(k, 0.0))
        for session in range(4):
            time_s = 0.1 * np.arange(readings)
            phase = rng.uniform(0.0, 6.0)
            contexts = {
                "time_s": time_s,
                "true_range_cm": 250.0 + 80.0 * np.sin(0.8 * time_s + phase),
                "range_rate_cm_s": 64.0 * np.cos(0.8 * time_s + phase),
            }
            table = MeasuredData({**contexts, "reading_cm": model.sample(contexts, rng)})
            add_run(folder, f"V{k + 1}/{session + 1}", table)
    return folder


def add_run(folder: Path, name: str, table: MeasuredData) -> None:
    """One more run of the sensor 'down', from a log in a folder of its vehicle."""
    write_tables(folder, name, {"down": table})
    record_runs(folder, {name: {"file": f"logs/{name}.csv"}})


@pytest.mark.slow
def test_the_late_vehicle_is_named_on_the_page_in_the_table_and_on_the_terminal(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path / "set", 6, {2: 200.0})
    # A vehicle whose readings are too few is left out, with the reason.
    table = MeasuredData({"time_s": np.arange(5.0), "reading_cm": np.full(5, 99.0), "true_range_cm": np.full(5, 99.0)})
    add_run(dataset, "V9/1", table)
    out = tmp_path / "out"
    result = run("msp-lab fleet", dataset, "--model", MODEL, "--out", out)
    assert max(map(len, result.stdout.splitlines())) <= 80
    flat = " ".join(result.stdout.split())
    assert "1 of 6 vehicles differs" in flat
    assert "V3" in flat
    assert "5 % of such findings are expected to be false" in flat
    assert "Left out: V9 down" in flat
    assert "found 5 readings with a true range" in flat
    findings = json.loads((out / "fleet.json").read_text())
    odd = [each for each in findings["effects"] if each["kind"] == "odd"]
    assert [each["name"] for each in odd] == ["latency"]
    (late,) = [each for each in odd[0]["estimates"] if each["odd"]]
    assert late["vehicle"] == "V3"
    assert late["low"] < 200.0 < late["high"]
    rows = (out / "fleet.csv").read_text()
    assert "latency,delay_ms,ms,V3,down,,yes" in rows
    # What nothing was found in is there too, for near misses.
    assert [rows.count(f"compared,{number},value,") for number in BASE] == [6] * len(BASE)
    assert "V3" in (out / "report.html").read_text()


@pytest.mark.slow
def test_three_odd_vehicles_of_a_drawn_fleet_are_found_and_no_others(tmp_path: Path) -> None:
    outcome = score.run("odd:slant_axis", 1, fleet("odd:slant_axis", 1, vehicles=10), tmp_path)
    assert outcome.crash == ""
    assert (outcome.found, outcome.false) == (3, ())


def test_three_vehicles_are_no_fleet(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path / "set", 3, {}, readings=5)
    arguments = ["msp-lab fleet", dataset, "--model", MODEL, "--out", tmp_path / "out"]
    assert "logs of 3 vehicles (V1, V2, V3), and a fleet is at least 4" in run(*arguments, code=3).stderr
    assert "fits neither the run 'V1/1' nor its log" in run(*arguments, "--vehicle", "X", code=3).stderr
    assert "no regular expression" in run(*arguments, "--vehicle", "(", code=3).stderr


@pytest.mark.slow
def test_two_processes_of_which_one_is_killed_find_the_same_to_the_last_digit(tmp_path: Path) -> None:
    dataset = make_dataset(tmp_path / "set", 4, {2: 200.0}, readings=1000)
    arguments = ["fleet", str(dataset), "--model", MODEL, "--out"]
    run("msp-lab", *arguments, tmp_path / "one")
    command = [str(Path(sys.executable).with_name("msp-lab")), *arguments, str(tmp_path / "two"), "--jobs", "2"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as program:
        killed = killed_worker(program)
        output = program.communicate()[0]
    assert program.returncode == 0, output
    assert killed
    assert "1 worker processes died" in " ".join(output.split())
    for name in ("fleet.json", "fleet.csv"):
        assert (tmp_path / "two" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()


def killed_worker(program: "subprocess.Popen[str]") -> bool:
    """Kill a worker of a program as soon as it computes; False if the program ended before."""
    killed: list[int] = []

    def is_over() -> bool:
        with suppress(OSError):  # It has ended.
            threads = Path(f"/proc/{program.pid}/task").glob("*/children")
            for child in (each for thread in threads for each in thread.read_text().split()):
                used = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[11:13]
                is_worker = "spawn_main" in Path(f"/proc/{child}/cmdline").read_text()
                if not killed and is_worker and sum(map(int, used)) >= STARTED_S * os.sysconf("SC_CLK_TCK"):
                    os.kill(int(child), signal.SIGKILL)
                    killed.append(int(child))
        return bool(killed) or program.poll() is not None

    until(is_over, 5 * LIMIT_S)
    return bool(killed)
