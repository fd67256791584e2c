"""A scripted person at the terminal of `msp-lab collect`: what they are shown, and what their answers do."""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from msp_lab.campaigns.collect import Collection
from msp_lab.campaigns.terminal import Terminal
from msp_sim.device.device import Fault
from tests.support.campaigns import Collected, campaign, condition, written
from tests.support.programs import run
from tests.support.shipped import CONFIGS


class Bench:
    """A campaign on emulated sensors with somebody who types ``answers`` in turn, and then nothing but Enter."""

    def __init__(
        self,
        folder: Path,
        *conditions: dict[str, Any],
        answers: Sequence[str] = (),
        terminal: bool = False,
        **more: Any,
    ) -> None:
        faults = more.pop("faults", None)
        draw = more.pop("draw", None)
        self.collected = Collected(campaign(folder, *conditions, **more), folder / "out", faults=faults, draw=draw)
        self.screen = io.StringIO()
        self.asked: list[str] = []
        self._answers = list(answers)
        self.stopped = False
        self.person = Terminal(
            Collection(self.collected.campaign, self.collected.points, ()),
            Console(file=self.screen, width=150, force_terminal=terminal),
            self._ask,
            self.collected.bench.clock,
            lambda: self.stopped,
        )

    def _ask(self, text: str) -> str:
        self.asked.append(text)
        return self._answers.pop(0) if self._answers else ""

    def go(self, **options: Any) -> list[dict[str, str]]:
        """Collect; returns the table's rows."""
        self.collected.go(self.person, **options)
        assert not self._answers, "every answer was asked for"
        return list(csv.DictReader(io.StringIO(self.collected.table())))

    def done(self) -> list[bool]:
        """Of each point, whether it is complete."""
        return [self.collected.store.is_done(point) for point in self.collected.points]


def values(rows: list[dict[str, str]], name: str, run: str | None = None) -> set[str]:
    return {row[name] for row in rows if run is None or row["run"] == run}


def test_one_who_only_presses_enter_gets_the_plan(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    rows = bench.go()
    assert bench.done() == [True, True]
    assert values(rows, "air_temperature_c") == {"22.5"}
    shown = bench.screen.getvalue()
    assert "1 of 2: baseline-60cm" in shown
    assert "Move the target to 120 cm (it was at 60 cm)." in shown
    assert "30 of 30 readings" in shown
    assert "min left" in shown
    # Air once, and one Enter for each point; nothing was odd, so nothing more.
    assert ["thermometer" in text for text in bench.asked] == [True, False, False]


def test_what_is_measured_otherwise_holds_until_the_plan_changes(tmp_path: Path) -> None:
    bench = Bench(
        tmp_path,
        condition(ranges_cm=[60, 90, 120]),
        condition(condition="shaken", ranges_cm=[120], vibrations_hz=[60]),
        answers=["19.5", "range=60.4", "", "range=119.7 humidity=45", "air=20.5"],
    )
    rows = bench.go()
    assert values(rows, "true_range_cm", "baseline-60cm") == {"60.4"}
    assert values(rows, "true_range_cm", "baseline-90cm") == {"90.0"}, "it has moved, and the plan is believed again"
    assert values(rows, "true_range_cm", "baseline-120cm") == {"119.7"}
    assert values(rows, "true_range_cm", "shaken-120cm") == {"119.7"}, "the target has not moved"
    assert values(rows, "air_temperature_c", "baseline-60cm") == {"19.5"}
    assert values(rows, "target_temperature_c", "baseline-60cm") == {"19.5"}, "even air is even as it is"
    assert values(rows, "air_temperature_c", "shaken-120cm") == {"20.5"}
    assert values(rows, "humidity_pct", "baseline-60cm") == {""}
    assert values(rows, "humidity_pct", "shaken-120cm") == {"45"}


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("rang=60", "expected one of range=, air=, far=, humidity=, angle=, or Enter, s, r, q"),
        ("range=far", "expected a number after range="),
        ("range=", "expected a number after range="),
        ("air=200", "expected -40 to 65"),
        ("range=60.4 what", "'what'"),
    ],
)
def test_a_wrong_answer_is_reported_and_asked_again(answer: str, message: str, tmp_path: Path) -> None:
    bench = Bench(tmp_path, condition(ranges_cm=[60]), answers=["", answer])
    rows = bench.go()
    assert message in bench.screen.getvalue()
    assert values(rows, "true_range_cm") == {"60"}
    assert bench.done() == [True]


def outlying(readings_cm: dict[int, int]) -> Callable[[Any], int]:
    """Readings of the true range, but for the pings (counted from 1) that are named."""
    count = 0

    def draw(columns: Mapping[str, float]) -> int:
        nonlocal count
        count += 1
        return readings_cm.get(count, round(columns["true_range_cm"]))

    return draw


def test_outliers_are_flagged_and_the_point_read_again(tmp_path: Path) -> None:
    one = condition(ranges_cm=[120])
    bench = Bench(tmp_path, one, draw=outlying({20: 187, 40: 120}), answers=["", "", "r", ""])
    rows = bench.go()
    shown = bench.screen.getvalue()
    assert "one reading 20: 187 cm, 67 cm longer than the others" in shown
    assert "1 outliers among 30 readings (187)" in shown
    assert values(rows, "run") == {"baseline-120cm.2"}
    assert "187" not in values(rows, "reading_cm")


def test_a_wrong_set_up_is_doubted(tmp_path: Path) -> None:
    bench = Bench(tmp_path, condition(ranges_cm=[120]), draw=lambda columns: 95)
    bench.go()
    assert "one reads 95 cm, and the reference is 120 cm" in bench.screen.getvalue()


@pytest.mark.parametrize("reads_cm", [200, 261])
def test_at_an_angle_both_the_nearest_point_and_the_slant_range_are_expected(reads_cm: int, tmp_path: Path) -> None:
    bench = Bench(tmp_path, condition(ranges_cm=[200], angles_deg=[40]), draw=lambda columns: reads_cm)
    bench.go()
    assert "is the target" not in bench.screen.getvalue()


def test_the_point_before_can_be_read_again(tmp_path: Path) -> None:
    bench = Bench(tmp_path, answers=["", "", "r"])
    rows = bench.go()
    assert list(dict.fromkeys(row["run"] for row in rows)) == ["baseline-60cm.2", "baseline-120cm"]


def test_what_is_left_for_later_comes_at_the_end(tmp_path: Path) -> None:
    bench = Bench(tmp_path, answers=["", "s"])
    bench.go()
    assert bench.done() == [True, True]
    assert bench.screen.getvalue().count("1 of 2: baseline-60cm") == 2


def test_stopping_keeps_what_is_read_and_reports_it_the_next_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = Bench(tmp_path, answers=["", "", "q"])
    first.go()
    assert first.done() == [True, False]
    interrupted = Bench(tmp_path)
    look = interrupted.person.on_reading

    def stops_at_ten(*seen: Any) -> Any:
        interrupted.stopped = next(iter(seen[1].values())).read >= 10
        return look(*seen)

    monkeypatch.setattr(interrupted.person, "on_reading", stops_at_ten)
    assert len(interrupted.go()) == 40
    last = Bench(tmp_path)
    assert len(last.go()) == 60
    assert "10 of its 30 readings are recorded already" in last.screen.getvalue()


def test_a_sensor_that_does_not_answer_is_reported_and_waited_for(tmp_path: Path) -> None:
    dead = {"one": [Fault("silent", 0.0, 1e9)]}
    bench = Bench(tmp_path, condition(ranges_cm=[60]), faults=dead, answers=["", "", "", "s", "q"])
    bench.go()
    shown = bench.screen.getvalue()
    assert shown.count("no usable answer to 20 pings: I2C write at address 0x70 failed: errno 121") == 2
    assert "Check power, the two bus wires and the address" in shown
    assert bench.done() == [False]


def test_a_thermometer_speaks_for_itself(tmp_path: Path) -> None:
    thermometer = {"source": "file", "path": "/sys/none"}
    bench = Bench(tmp_path, condition(ranges_cm=[60]), thermometer=thermometer)
    bench.collected.bench.air_c = lambda now_s: 18.25  # type: ignore[method-assign]
    rows = bench.go()
    assert not any("thermometer" in text for text in bench.asked)
    assert values(rows, "air_temperature_c") == {"18.25"}
    assert values(rows, "target_temperature_c") == {"18.25"}


def test_nothing_is_asked_where_nothing_is_to_be_changed(tmp_path: Path) -> None:
    both = condition(ranges_cm=[60], sensors=["one", "two"], firing=["sequential", "simultaneous"])
    bench = Bench(tmp_path, both)
    bench.go()
    assert bench.done() == [True, True]
    assert sum("set up as planned" in text for text in bench.asked) == 1


def test_on_a_terminal_the_histogram_is_live(tmp_path: Path) -> None:
    bench = Bench(tmp_path, condition(ranges_cm=[120]), terminal=True)
    bench.go()
    assert bench.screen.getvalue().count("120 cm") > 5
    assert "█" in bench.screen.getvalue()


def test_the_plan_can_be_looked_at_without_a_bench(tmp_path: Path) -> None:
    args = ["msp-lab collect --plan", CONFIGS / "campaigns/table_4_1.yaml", "--out", tmp_path / "out"]
    result = run(*args)
    assert "316  field_of_view" in result.output
    assert "50500 readings are left; estimated time" in result.output
    assert not (tmp_path / "out").exists()
    assert "2400 readings are left" in run(*args, "--only", "baseline").output


def test_a_bench_of_emulated_sensors_is_no_bench(tmp_path: Path) -> None:
    """What the simulator collected is not resumed on real sensors."""
    Collected(campaign(tmp_path), tmp_path / "out").go()
    result = run("msp-lab collect", written(tmp_path), "--out", tmp_path / "out", code=3)
    assert "collected from the simulator" in result.output
    assert len(result.output.strip().splitlines()) == 1


def test_without_a_bus_nobody_sets_anything_up(tmp_path: Path) -> None:
    args = [written(tmp_path), "--out", tmp_path / "out", "--bus", tmp_path / "i2c-1"]
    result = run("msp-lab collect", *args, code=3)
    assert "i2c-1: cannot be opened: No such file or directory" in result.output
    assert not (tmp_path / "out").exists()


def test_a_table_that_was_not_collected_here_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/readings.csv").write_text("mine", encoding="utf-8")
    result = run("msp-lab collect", written(tmp_path), "--out", tmp_path / "out", code=3)
    assert "not collected here" in result.output
    assert (tmp_path / "out/readings.csv").read_text(encoding="utf-8") == "mine"


def test_before_the_first_point_there_is_none_to_read_again(tmp_path: Path) -> None:
    bench = Bench(tmp_path, condition(ranges_cm=[60]), answers=["", "r", "q"])
    bench.collected.go(bench.person)
    assert "no point was read before this" in bench.screen.getvalue()
    assert bench.done() == [False]
    assert not bench.collected.store.recordings


def test_stopping_at_the_question_for_the_air_stops(tmp_path: Path) -> None:
    bench = Bench(tmp_path, condition(ranges_cm=[60]), answers=["q"])
    bench.collected.go(bench.person)
    assert len(bench.asked) == 1
    assert not bench.collected.store.recordings


def test_the_plan_of_flights_asks_nothing(tmp_path: Path) -> None:
    result = run("msp-lab collect --plan", CONFIGS / "campaigns/flight.yaml", "--out", tmp_path / "out")
    assert "The recording" not in result.output
    assert "The reference" in result.output
