"""Campaigns collected by the real code from emulated sensors: complete, resumed, read again, and with faults."""

import csv
import io
import json
import os
import re
import resource
import subprocess
import sys
from collections import Counter
from contextlib import closing
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pytest

from msp_lab.campaigns.collect import TROUBLE_AFTER, Decision
from msp_range.clock import VirtualClock
from msp_range.reading import Reading, Status
from msp_range.recording.csv_form import read_csv
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import Recording
from msp_range.recording.writer import Recorder
from msp_sim.device.device import Fault
from tests.support.campaigns import Collected, ScriptedOperator, campaign, condition, written
from tests.support.programs import run
from tests.support.shipped import CONFIGS

ALWAYS_S = 1e9
CROSSTALK = condition(
    condition="crosstalk", sensors=["one", "two"], apart_cm=15.24, firing=["simultaneous", "sequential"]
)

SEVERAL = (condition(), CROSSTALK, condition(condition="fov", angles_deg=[-30, 0], targets=[{"material": "wall"}]))


def rows(table: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(table)))


def after(readings: int) -> Any:
    """Somebody who stops after so many readings."""
    seen: list[Reading] = []

    def look(reading: Reading) -> Decision:
        seen.append(reading)
        return Decision.STOP if len(seen) >= readings else Decision.GO

    return ScriptedOperator(looked=look)


def test_every_planned_reading_is_there_once(tmp_path: Path) -> None:
    collected = Collected(campaign(tmp_path, *SEVERAL), tmp_path / "out")
    collected.go()
    table = rows(collected.table())
    counts = {(point.name, name): point.readings for point in collected.points for name in point.setup.sensors}
    found: dict[tuple[str, str], int] = {}
    for row in table:
        found[row["run"], row["sensor"]] = found.get((row["run"], row["sensor"]), 0) + 1
    assert found == counts
    assert [row["run"] for row in table] == sorted(
        (row["run"] for row in table), key=[point.name for point in collected.points].index
    )
    for point in collected.points:
        of_point = [row for row in table if row["run"] == point.name]
        for name, value in point.columns.items():
            assert {row[name] for row in of_point} <= {str(value), f"{value:g}" if isinstance(value, float) else value}
    assert collected.go().readings == 0, "a complete campaign reads nothing"


def test_the_same_seed_gives_the_same_table_and_another_does_not(tmp_path: Path) -> None:
    small = campaign(tmp_path, *SEVERAL)
    tables = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        collected = Collected(small, tmp_path / name, seed=seed)
        collected.go()
        tables.append(collected.table())
    assert tables[0] == tables[1] != tables[2]


@pytest.mark.parametrize("stops", [[1], [29], [30], [31, 1, 1, 77], [100, 100, 100]])
def test_an_interruption_changes_nothing(stops: list[int], tmp_path: Path) -> None:
    small = campaign(tmp_path, *SEVERAL)
    whole = Collected(small, tmp_path / "whole")
    whole.go()
    for each in stops:
        Collected(small, tmp_path / "cut").go(after(each))
    last = Collected(small, tmp_path / "cut")
    person = last.go()
    assert last.table() == whole.table()
    assert person.readings == len(rows(whole.table())) - sum(stops), "nothing was read twice"


@pytest.mark.parametrize("kept", [0.1, 0.35, 0.6, 0.85, 0.999])
def test_a_power_cut_costs_no_more_than_a_second(kept: float, tmp_path: Path) -> None:
    small = campaign(tmp_path, *SEVERAL)
    whole = Collected(small, tmp_path / "whole")
    whole.go()
    cut = Collected(small, tmp_path / "cut")
    cut.go(after(200))
    (path,) = cut.store.recordings
    os.truncate(path, int(kept * path.stat().st_size))
    again = Collected(small, tmp_path / "cut")
    there = sum(attempt.rangings for point in again.points for attempt in again.store.attempts(point))
    person = again.go()
    assert again.table() == whole.table()
    assert person.readings == len(rows(whole.table())) - there


def test_at_a_real_bench_what_is_left_is_read_in_another_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Time does not start again there, so that times of the two sessions do not compare."""
    small = campaign(tmp_path, condition(ranges_cm=[60]))
    Collected(small, tmp_path / "out").go(after(12))
    again = Collected(small, tmp_path / "out")
    begin = again.bench.begin
    monkeypatch.setattr(again.bench, "begin", lambda *of: (begin(*of)[0], 0))
    person = ScriptedOperator()
    again.go(person)
    assert [row["run"] for row in rows(again.table())] == ["baseline-60cm"] * 12 + ["baseline-60cm+1"] * 18
    assert person.places[0].had == 12


def test_repeating_a_point_leaves_the_others_and_takes_its_place(tmp_path: Path) -> None:
    small = campaign(tmp_path, *SEVERAL)
    collected = Collected(small, tmp_path / "out")
    collected.go()
    before = rows(collected.table())
    Collected(small, tmp_path / "out").go(wanted=[], again=["baseline-120cm"])
    again = Collected(small, tmp_path / "out")
    now = rows(again.table())
    assert len(now) == len(before)
    assert [row for row in now if row["run"] != "baseline-120cm.2"] == [
        r for r in before if r["run"] != "baseline-120cm"
    ]
    assert [row["run"] for row in now[30:60]] == ["baseline-120cm.2"] * 30
    assert [row["reading_cm"] for row in now[30:60]] != [row["reading_cm"] for row in before[30:60]]
    recorded = [message["run"] for path in again.store.recordings for topic, _, message in Recording(path)
                if topic == "/campaign"]  # fmt: skip
    assert "baseline-120cm" in recorded, "what was read before stays recorded"


def test_a_repeat_that_is_interrupted_leaves_the_complete_one(tmp_path: Path) -> None:
    small = campaign(tmp_path)
    first = Collected(small, tmp_path / "out")
    first.go()
    whole = first.table()
    again = Collected(small, tmp_path / "out")
    again.go(after(7), wanted=[], again=["baseline-60cm"])
    assert again.table() == whole
    last = Collected(small, tmp_path / "out")
    person = last.go(wanted=[], again=["baseline-60cm"])
    assert person.readings == 30, "the repeat begins anew or goes on, and is whole at the end"
    assert {row["run"] for row in rows(last.table())[:30]} <= {"baseline-60cm.2", "baseline-60cm.3"}


def test_pings_that_go_out_together_are_less_than_a_millisecond_apart(tmp_path: Path) -> None:
    """And the second sensor gets the echo of the first, so that it reads short; in turn nothing of it is left."""
    collected = Collected(campaign(tmp_path, CROSSTALK), tmp_path / "out")
    collected.go()
    data = read_csv(collected.store.write_table()[0])
    for name, least_ms, most_ms in (("simultaneous", 0.1, 1.0), ("sequential", 99.0, 120.0)):
        second = data.select((data["condition"] == f"crosstalk_{name}") & (data["sensor"] == "two"))
        assert (second["neighbour_lag_ms"] > least_ms).all()
        assert (second["neighbour_lag_ms"] < most_ms).all()
        np.testing.assert_array_equal(second["neighbour_range_cm"], second["true_range_cm"])
        error_cm = float(np.median(second["reading_cm"] - second["true_range_cm"]))
        lag_cm = 34500 * float(np.median(second["neighbour_lag_ms"])) / 1000 / 2
        assert error_cm == pytest.approx(-lag_cm if name == "simultaneous" else 0.0, abs=1.0)
    first = data.select(data["sensor"] == "one")
    assert np.isnan(first["neighbour_lag_ms"][0])
    assert np.nanmin(first["neighbour_lag_ms"]) > 99.0
    assert abs(float(np.median(first["reading_cm"] - first["true_range_cm"]))) <= 1.0


def test_the_truth_of_a_moving_target_moves_with_it(tmp_path: Path) -> None:
    moving = condition(condition="moving", ranges_cm=[200], moving={"to_cm": 80, "rates_cm_s": [40]}, readings=60)
    collected = Collected(campaign(tmp_path, moving), tmp_path / "out")
    collected.go()
    data = read_csv(collected.store.write_table()[0])
    assert np.unique(data["run"]).tolist() == ["moving-200cm--40cm_s_1", "moving-200cm--40cm_s_2"]
    first = data.select(data["run"] == "moving-200cm--40cm_s_1")
    begin_s = first["time_s"][0] - (200 - first["true_range_cm"][0]) / 40
    np.testing.assert_allclose(first["true_range_cm"], 200 - 40 * (first["time_s"] - begin_s), atol=0.01)
    assert 80 <= first["true_range_cm"].min() < 90
    assert abs(float(np.median(first["reading_cm"] - first["true_range_cm"]))) < 1.5


def test_a_movement_that_was_interrupted_begins_anew(tmp_path: Path) -> None:
    moving = condition(condition="moving", ranges_cm=[200], moving={"to_cm": 80, "rates_cm_s": [40]})
    small = campaign(tmp_path, moving)
    Collected(small, tmp_path / "out").go(after(5))
    again = Collected(small, tmp_path / "out")
    again.go()
    assert {row["run"] for row in rows(again.table())} == {"moving-200cm--40cm_s_1.2"}


FAULTY = {
    "clock_fault": Status.CLOCK_FAULT,
    "impossible": Status.IMPOSSIBLE,
    "silent": Status.NO_ANSWER,
}


@pytest.mark.parametrize("kind", FAULTY)
def test_faults_are_recorded_as_what_they_are_and_asked_again(kind: str, tmp_path: Path) -> None:
    faults = {"one": [Fault(kind, 0.0, ALWAYS_S, probability=0.1)]}
    collected = Collected(campaign(tmp_path), tmp_path / "out", faults=faults)
    person = collected.go()
    table = rows(collected.table())
    answered = [row for row in table if row["reading_cm"]]
    assert len(answered) == 60
    assert person.failed == len(table) - 60 > 0
    assert all(abs(float(row["reading_cm"]) - float(row["true_range_cm"])) < 3 for row in answered)
    (path,) = collected.store.recordings
    found = {message["status"] for topic, _, message in Recording(path) if topic.startswith("/range/")}
    assert found == {"ok", FAULTY[kind].value}


@pytest.mark.parametrize("firing", ["simultaneous", "sequential"])
@pytest.mark.parametrize("kind", ["silent", "locked_up"])
def test_a_dead_sensor_is_reported_and_then_left(kind: str, firing: str, tmp_path: Path) -> None:
    both = condition(condition="crosstalk", ranges_cm=[60], sensors=["one", "two"], firing=[firing])
    faults = {"two": [Fault(kind, 0.0, ALWAYS_S)]}
    collected = Collected(campaign(tmp_path, both), tmp_path / "out", faults=faults)
    person = collected.go()
    assert "no usable answer to 20 pings: I2C" in person.texts[0]
    assert not collected.store.is_done(collected.points[0])
    assert not any(row["reading_cm"] for row in rows(collected.table()) if row["sensor"] == "two")
    # Unlike in flight it keeps its turns: who pings before whom is part of the set-up.
    pings = Counter(row["sensor"] for row in rows(collected.table()))
    assert abs(pings["one"] - pings["two"]) <= 1
    assert TROUBLE_AFTER == 20


def test_a_bus_that_comes_back_is_gone_on_with(tmp_path: Path) -> None:
    small = campaign(tmp_path, condition(ranges_cm=[60]))
    begins_s = Collected(small, tmp_path / "unused").bench.begins_s["baseline-60cm"]
    faults = {"one": [Fault("locked_up", begins_s + 1.0, begins_s + 3.5)]}
    collected = Collected(small, tmp_path / "out", faults=faults)
    person = collected.go(ScriptedOperator())
    assert len(person.texts) == 1
    assert "errno 110" in person.texts[0]
    assert sum(bool(row["reading_cm"]) for row in rows(collected.table())) == 30


def test_a_power_loss_of_the_sensor_is_no_reading(tmp_path: Path) -> None:
    """Part information looks like 300 cm, and comes sooner than an echo from there could."""
    small = campaign(tmp_path, condition(ranges_cm=[60]))
    begins_s = Collected(small, tmp_path / "unused").bench.begins_s["baseline-60cm"]
    losses = [Fault("power_cycle", begins_s + each + 0.005, begins_s + each + 0.006) for each in (0.3, 0.9, 1.7)]
    collected = Collected(small, tmp_path / "out", faults={"one": losses})
    collected.go()
    assert not [row for row in rows(collected.table()) if row["reading_cm"] == "300"]


def test_a_folder_of_another_campaign_bench_or_seed_is_refused(tmp_path: Path) -> None:
    Collected(campaign(tmp_path), tmp_path / "out").go(after(5))
    with pytest.raises(RecordingError, match=r"seed 1, and this is .* seed 2"):
        Collected(campaign(tmp_path), tmp_path / "out", seed=2)
    with pytest.raises(RecordingError, match=r"point baseline-60cm was changed \(readings 30, now 50\); continue with"):
        Collected(campaign(tmp_path, condition(readings=50)), tmp_path / "out")
    with pytest.raises(RecordingError, match="point baseline-60cm is not in it"):
        Collected(campaign(tmp_path, condition(ranges_cm=[80])), tmp_path / "out")
    # A point more is no change of what was read.
    more = Collected(campaign(tmp_path, condition(ranges_cm=[60, 120, 200])), tmp_path / "out")
    more.go()
    assert len(rows(more.table())) == 90


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"attempt": 10**9}, "found attempt 1000000000, expected 1 to 10000"),
        ({"attempt": -1}, "found attempt -1, expected 1 to 10000"),
        ({"planned": "[" * 5000}, r"the campaign has changed since: .* was changed \(what it was cannot be read\)"),
    ],
)
def test_a_crafted_sitting_is_reported(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    collected = Collected(campaign(tmp_path), tmp_path / "out")
    collected.go()
    (path,) = (tmp_path / "out").glob("*.mcap")
    begun = next(each.message for each in Recording(path) if each.topic == "/campaign")
    path.unlink()
    with closing(Recorder(path, VirtualClock(), metadata={"bench": collected.bench.description})) as recorder:
        recorder.write("/campaign", 0.0, begun | changes)
    with pytest.raises(RecordingError, match=message):
        Collected(campaign(tmp_path), tmp_path / "out")


def test_the_recording_holds_campaign_and_models(tmp_path: Path) -> None:
    collected = Collected(campaign(tmp_path), tmp_path / "out")
    collected.go()
    (path,) = collected.store.recordings
    recording = Recording(path)
    assert recording.files["campaign.yaml"] == (tmp_path / "campaign.yaml").read_text()
    assert any(name.endswith("mb1242.yaml") for name in recording.files)
    assert "simulator" in recording.metadata["bench"]
    events = [message["event"] for topic, _, message in recording if topic == "/campaign"]
    assert events == ["begin", "done"] * 2
    planned = next(json.loads(m["planned"]) for topic, _, m in recording if topic == "/campaign")
    assert planned["true_range_cm"] == 60


def test_the_command_end_to_end(tmp_path: Path) -> None:
    """The afternoon's campaign by the command: what the table says of the sensor is what its model says."""
    result = run("msp-lab collect --simulate", CONFIGS / "campaigns/afternoon.yaml", "--out", tmp_path / "out")
    assert "7260 readings" in result.output
    assert "0 of 29 points are left" in result.output
    data = read_csv(tmp_path / "out/readings.csv")
    baseline = data.select(data["condition"] == "baseline")
    error_cm = baseline["reading_cm"] - baseline["true_range_cm"]
    assert abs(float(np.median(error_cm))) < 1.5
    turned = data.select((data["condition"] == "field_of_view") & (data["true_range_cm"] == 100))
    for angle_deg, heard in ((0.0, True), (16.2, True), (-16.2, True), (21.6, False), (-21.6, False)):
        at = turned.select(turned["incidence_deg"] == angle_deg)
        missed = float(np.isin(at["reading_cm"], (765, 255)).mean())
        assert (missed < 0.2) if heard else (missed > 0.8), angle_deg
    # The far points are distinct placements, off by the ruler's uncertainty and no more.
    medians = [median(error_cm[baseline["run"] == run].tolist()) for run in np.unique(baseline["run"])]
    assert max(map(abs, medians)) < 2.0


@pytest.mark.slow
def test_a_disk_that_is_full_ends_it_with_a_line_and_it_can_be_resumed(tmp_path: Path) -> None:
    path = written(tmp_path, *SEVERAL)
    program = "from msp_lab.cli import main; main()"
    command: list[str | Path] = [sys.executable, "-c", program, "collect", path, "--simulate", "--out"]
    limit = (20_000, resource.RLIM_INFINITY)  # bytes a file, which the kernel enforces as it does the end of a disk
    full = subprocess.run(
        [*command, tmp_path / "full"],
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limit),
    )
    assert full.returncode == 3
    assert re.fullmatch(r".*/session-001\.mcap: recording stopped: File too large; .*\n", full.stderr)
    for folder in ("full", "whole"):
        subprocess.run([*command, tmp_path / folder], check=True, stdout=subprocess.DEVNULL)
    tables = [(tmp_path / folder / "readings.csv").read_text() for folder in ("full", "whole")]
    assert tables[0] == tables[1]


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--only", "basline"], "no point's name begins so; one is baseline-"),
        (["--repeat", "x"], "--repeat x: no point's name begins so"),
        (["--model", "nothing.yaml"], "nothing.yaml: no such file"),
    ],
)
def test_user_errors_are_one_line(args: list[str], message: str, tmp_path: Path) -> None:
    result = run("msp-lab collect --simulate", written(tmp_path), "--out", tmp_path / "out", *args, code=3)
    assert message in result.output
    assert len(result.output.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_only_and_repeat_by_the_command(tmp_path: Path) -> None:
    args = ["msp-lab collect --simulate", written(tmp_path, *SEVERAL), "--out", tmp_path / "out"]
    assert "120 readings, 120 of them now" in run(*args, "--only", "fov").output
    assert "120 readings, 30 of them now" in run(*args, "--repeat", "fov-60cm-+0deg").output
    assert "0 of 10 points are left" in run(*args).output
