"""``msp-lab collect`` with a person at a real bench, or after real flights.

They write recordings and one table of readings. `collecting` is the same on the simulator.
"""

import signal
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from msp_lab.campaigns.bench import KernelBench
from msp_lab.campaigns.collect import Collection, collect_readings
from msp_lab.campaigns.flights import FlightArchive, collect_flights, load_flights, show_flights
from msp_lab.campaigns.terminal import Terminal, show_plan
from msp_range.bus.smbus import bus_of
from msp_range.service import stop_signals
from msp_range.terminal import PlainConsole


def collect_at_bench(collection: Collection, out: Path, bus: str, plan_only: bool) -> None:
    """Lead a person through a campaign at the bench; the parameters are the options of the command."""
    console = PlainConsole()
    campaign = collection.campaign
    bench = KernelBench(bus_of(bus), [sensor.address for sensor in campaign.sensors], campaign.thermometer)
    store = collection.store(out, bench)
    if plan_only:
        show_plan(console, collection, store)
        return
    bench.open()
    with stop_signals() as stopped:
        operator = Terminal(collection, console, _asking(console), bench.clock, lambda: bool(stopped))
        try:
            collect_readings(collection, bench, store, operator)
        finally:
            operator.close()
            store.close()
            bench.close()
    table, rows = store.write_table()
    read = f"{table}: {rows} readings" if rows else "nothing was read"
    print(f"{read}; {collection.left(store)}")


def collect_recordings(campaign_file: Path, out: Path, plan_only: bool) -> None:
    """Ask for the recording and the reference of each flight of a campaign, and keep copies of them."""
    console = PlainConsole()
    campaign = load_flights(campaign_file)
    archive = FlightArchive(out, campaign)
    if plan_only:
        show_flights(campaign, archive, console)
        return
    collect_flights(campaign, archive, console, _asking(console))
    left = sum(not archive.recordings(flight) for flight in campaign.flights)
    if left < len(campaign.flights):
        table, rows = archive.write_table()
        print(f"{table}: {rows} readings; {left} of {len(campaign.flights)} flights are left")


def _asking(console: Console) -> Callable[[str], str]:
    """Return a prompt that a signal ends; it returns q then, and at the end of the input."""

    def ask(text: str) -> str:
        handlers = {
            signum: signal.signal(signum, signal.default_int_handler) for signum in (signal.SIGINT, signal.SIGTERM)
        }
        try:
            return console.input(text)
        except (KeyboardInterrupt, EOFError):
            console.print()
            return "q"
        finally:
            for signum, handler in handlers.items():
                signal.signal(signum, handler)

    return ask
