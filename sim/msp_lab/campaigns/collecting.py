"""``msp-lab collect --simulate``: a campaign on emulated sensors, with the code that reads a real bench.

The results are recordings and one table of readings.
"""

from collections.abc import Sequence
from pathlib import Path

from rich.progress import BarColumn, TextColumn, TimeRemainingColumn

from msp_lab.campaigns.collect import Collection, collect_readings
from msp_lab.campaigns.flights import FlightArchive, load_flights, show_flights
from msp_lab.campaigns.plan import Point
from msp_lab.campaigns.simulated_bench import AutoOperator, SimulatedBench, readings_of
from msp_lab.campaigns.terminal import show_plan
from msp_range.clock import SystemClock
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.service import stop_signals
from msp_range.terminal import Bar, PlainConsole
from msp_sim.flight.scenario import load_scenario
from msp_sim.flight.simulate import fly_through


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


def collect_campaign(collection: Collection, out: Path, model: Path | None, seed: int, plan_only: bool) -> None:
    """Read the points of a campaign at the bench; the parameters are the options of the command."""
    models, described = readings_of(collection.campaign, model)
    bench = SimulatedBench(collection.campaign, collection.points, models, seed, described)
    store = collection.store(out, bench)
    if plan_only:
        show_plan(PlainConsole(), collection, store)
        return
    system = SystemClock()
    started_s = system.now()
    with stop_signals() as stopped, Collecting(collection.todo(store)) as shown:
        operator = AutoOperator(shown.update, lambda: bool(stopped))
        try:
            collect_readings(collection, bench, store, operator)
        finally:
            store.close()
    table, rows = store.write_table()
    for text in operator.texts:
        print(text)
    print(
        f"{table}: {rows} readings, {operator.readings} of them now in {system.now() - started_s:.1f} s; "
        f"{operator.outliers} outliers, {operator.failed} pings without a usable answer; "
        f"{collection.left(store)}"
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
        with archive.making(flight) as path:
            fly_through(scenario, seed + number, sensor_model, path)
    table, rows = archive.write_table()
    print(f"{table}: {rows} readings of {len(scenarios)} flights")
