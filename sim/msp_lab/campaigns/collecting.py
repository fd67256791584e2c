"""``msp-lab collect --simulate``: a campaign on emulated sensors, with the code that reads a real bench.

A campaign's file and the command's options enter; recordings and one table of readings leave.
"""

from collections.abc import Sequence
from pathlib import Path

from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

from msp_lab.campaigns.campaign import load_campaign
from msp_lab.campaigns.collect import chosen, collect_readings
from msp_lab.campaigns.flights import FlightArchive, load_flights, show_flights
from msp_lab.campaigns.plan import Point, make_plan
from msp_lab.campaigns.simulated_bench import AutoOperator, SimulatedBench, readings_of
from msp_lab.campaigns.store import Store
from msp_lab.campaigns.terminal import show_plan
from msp_range.clock import SystemClock, VirtualClock
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.writer import Recorder
from msp_range.service import stop_signals
from msp_range.terminal import Bar, PlainConsole
from msp_sim.flight.flight import Simulation
from msp_sim.flight.scenario import load_scenario


class Collecting(Bar):
    """A campaign's progress: a bar on a terminal, and elsewhere a line for each question."""

    def __init__(self, todo: Sequence[Point]) -> None:
        self._total = sum(point.readings * len(point.setup.sensors) for point in todo)
        columns = (
            BarColumn(),
            TextColumn("{task.completed:.0f} of {task.total:.0f} readings"),
            TimeRemainingColumn(),
        )
        super().__init__(*columns, total=self._total)
        self._question = ""

    def update(self, point: Point, readings: int) -> None:
        """Show the progress of the collection."""
        if self.is_shown:
            self.show(point.condition, readings)
        elif point.question != self._question:
            self._question = point.question
            print(f"{readings} of {self._total} readings; now {point.condition}: {point.question}")


def collect_campaign(
    campaign_file: Path,
    out: Path,
    model: Path | None,
    seed: int,
    only: list[str],
    repeat: list[str],
    plan_only: bool,
) -> None:
    """Read the points of a campaign at the bench; the parameters are the options of the command."""
    campaign = load_campaign(campaign_file)
    points = make_plan(campaign)
    again = chosen(points, repeat, "--repeat")
    # --repeat alone reads nothing else.
    wanted = chosen(points, only or ([] if repeat else [""]), "--only")
    models, described = readings_of(campaign, model)
    bench = SimulatedBench(campaign, points, models, seed, described)
    store = Store(out, points, bench.description, bench.clock, campaign.files)
    if plan_only:
        listed = [point for point in points if point.name in wanted | again]
        show_plan(PlainConsole(), campaign, listed, store.is_done)
        return
    system = SystemClock()
    started_s = system.now()
    todo = [point for point in points if point.name in again or (point.name in wanted and not store.is_done(point))]
    with stop_signals() as stopped, Collecting(todo) as shown:
        operator = AutoOperator(shown.update, lambda: bool(stopped))
        try:
            collect_readings(campaign, points, bench, store, operator, wanted, again)
        finally:
            store.close()
    table, rows = store.write_table()
    for text in operator.texts:
        print(text)
    left = sum(not store.is_done(point) for point in points)
    print(
        f"{table}: {rows} readings, {operator.readings} of them now in {system.now() - started_s:.1f} s; "
        f"{operator.outliers} outliers, {operator.failed} pings without a usable answer; "
        f"{left} of {len(points)} points are left"
    )


def fly_flights(campaign_file: Path, out: Path, model: Path | None, seed: int, plan_only: bool) -> None:
    """Fly a campaign's flights, those that are not recorded yet; the parameters are the options of the command."""
    campaign = load_flights(campaign_file)
    archive = FlightArchive(out, campaign)
    if plan_only:
        show_flights(campaign, archive, PlainConsole())
        return
    sensor_model = load_sensor_model(model) if model is not None else None
    scenarios = {
        flight.flight: load_scenario(campaign_file.parent / flight.scenario)
        for flight in campaign.flights
        if flight.scenario is not None
    }
    for number, flight in enumerate(campaign.flights, start=1):
        scenario = scenarios.get(flight.flight)
        if scenario is None or archive.recordings(flight):
            continue
        print(f"{number} of {len(campaign.flights)}: {flight.flight}, {scenario.duration_s:g} s of {scenario.name}")
        clock = VirtualClock()
        with archive.making(flight) as path:
            files = scenario.airframe.files
            recorder = Recorder(path, clock, files=files, metadata={"scenario": scenario.name, "seed": str(seed)})
            simulation = Simulation(scenario, clock, seed + number, model=sensor_model, recorder=recorder)
            for _ in simulation.fly():
                pass
            recorder.close()
    table, rows = archive.write_table()
    print(f"{table}: {rows} readings of {len(scenarios)} flights")
