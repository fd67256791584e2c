"""The command ``msp-sim monte-carlo``: fly a scenario many times with random parameters, and show what happened.

It makes a folder with a table, a summary and a picture, and prints lines on the terminal.
"""

import hashlib
import json
import shlex
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import typer
import yaml

from msp_range.extras import missing
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.terminal import PlainConsole, console, plain_table
from msp_range.yaml_file import config_path
from msp_sim.flight.sampled import Sampled
from msp_sim.flight.scenario import load_scenario
from msp_sim.monte_carlo.outcome import DRAWN, FLOWN, Flights, draw_sample, fly_sample
from msp_sim.monte_carlo.store import FLIGHTS, NUMBER, PICTURE, SUMMARY, FlightStore
from msp_sim.monte_carlo.summary import QUANTILES, Distribution, Share, Summary, summarise
from msp_sim.workers import EXIT_SOME_FAILED, Workers, fingerprint

WIDTH = 80
"""Width of the summary [characters], also without a terminal: it fits into every terminal and mail."""
SHOWN_FAILURES = 5
"""Flights that could not be flown, of which the reason is printed; summary.json has all."""


@dataclass(frozen=True)
class FlightOptions:
    """The options that ``msp-sim monte-carlo`` shares with ``msp-sim fly``."""

    scenario_file: Path
    seed: int
    model: Path | None
    effects: Sequence[Path]

    @property
    def again(self) -> str:
        """The command that flies one flight again, without the flight's number."""
        words = ["msp-sim", "fly", str(self.scenario_file), "--seed", str(self.seed)]
        words += ["--model", str(self.model)] if self.model is not None else []
        for path in self.effects:
            words += ["--effects", str(path)]
        return shlex.join([*words, "--sample"])


def fly_monte_carlo(
    options: FlightOptions, flights: int, out: Path, model_only: bool, cluster: AbstractContextManager[Workers]
) -> None:
    """Fly many samples of a scenario; the parameters are the options of the command, and where it computes."""
    path, seed = config_path(options.scenario_file, "scenarios"), options.seed
    sampled = Sampled(load_scenario(path), str(path))
    sensor_model = load_sensor_model(options.model) if options.model is not None else None
    settings = {
        "scenario": sampled.scenario.name,
        "files": _sha256(sampled, sensor_model),
        "seed": seed,
        "model_only": model_only,
        "version": fingerprint(),
    }
    if sampled.scenario.vary is None:
        _print_variation(sampled)
    store = FlightStore(out, [*(DRAWN if model_only else FLOWN), "refused", *sampled.vary.parameters], settings)
    wanted = sorted({*range(flights)} - {row[NUMBER] for row in store.rows})
    if store.rows:
        print(f"{out}: {len(store.rows)} flights are here already; {len(wanted)} are to be flown")
    failed: dict[int, str] = {}
    try:
        with cluster as where:
            shared = Flights(sampled, seed, sensor_model, tuple(path.resolve() for path in options.effects))
            for outcome in where.map(draw_sample if model_only else fly_sample, wanted, shared, what="flights"):
                if outcome.value is None:
                    failed[wanted[outcome.index]] = outcome.error or ""
                else:
                    store.add(wanted[outcome.index], outcome.value)
    except KeyboardInterrupt:
        print(f"{out}: {len(store.rows)} of {flights} flights are kept; the same command flies the others")
        raise
    finally:
        store.close()
    rows = [row for row in store.rows if row[NUMBER] < flights]
    summary = summarise(rows, failed)
    content = {**settings, **asdict(summary)}
    content["worst"] = [{**row, "fly_again": f"{options.again} {row[NUMBER]}"} for row in summary.worst]
    (out / SUMMARY).write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    _print(summary, options.again, where)
    print(f"every flight: {out / FLIGHTS}")
    print(f"     numbers: {out / SUMMARY}")
    if rows and (absent := missing("sim")) is None:
        from msp_sim.monte_carlo.picture import draw

        draw(rows, summary, out / PICTURE, f"{sampled.scenario.name}: {len(rows)} flights, seed {seed}")
        print(f"     picture: {out / PICTURE}")
    elif rows:
        print(f"no picture is drawn without {absent}")
    if failed:
        raise typer.Exit(EXIT_SOME_FAILED)


def _sha256(sampled: Sampled, model: Any) -> str:
    """Hash of the scenario, of what varies, and of the files that it names."""
    scenario = sampled.scenario
    what = [
        scenario.model_dump_json(exclude={"airframe", "vary"}),
        sampled.vary.model_dump_json(),
        json.dumps(scenario.airframe.files, sort_keys=True),
        model.model_dump_json() if model is not None else "",
    ]
    return hashlib.sha256("\n".join(what).encode()).hexdigest()


def _print_variation(sampled: Sampled) -> None:
    """Print what varies if the scenario file does not say it, as it would be written there."""
    print("The scenario has no section 'vary'; this one is used:\n")
    content = {"vary": sampled.vary.model_dump(exclude_defaults=True, mode="json")}
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=WIDTH)
    print("".join(f"    {line}\n" for line in text.splitlines()))


def _print(summary: Summary, again: str, where: Workers) -> None:
    """Print the summary, within 80 columns."""
    found = console()
    shown = found if found.is_terminal and found.width <= WIDTH else PlainConsole(width=WIDTH)
    for line in _lines(summary, where):
        shown.print(line)
    if summary.shares:
        header = [f"share of {summary.flights} flights with", "flights", "%", "95 % interval"]
        shown.print(plain_table(header, [_share(share) for share in summary.shares]))
    if summary.distributions:
        header = ["with interval, below in", *(f"{share:.0%} of flights" for share in QUANTILES)]
        shown.print(plain_table(header, [_distribution(distribution) for distribution in summary.distributions]))
    if summary.worst:
        columns = [name for name in summary.worst[0] if name in _WORST_COLUMNS]
        faults = "faults" if "faults" in summary.worst[0] else ""
        header = ["worst", *(_WORST_COLUMNS[name] for name in columns), faults]
        rows = [
            (str(row[NUMBER]), *(_shown(row[name]) for name in columns), row.get("faults", "")) for row in summary.worst
        ]
        shown.print(plain_table(header, rows, f"l{'r' * len(columns)}l"))
        print(f"fly the worst again: {again} {summary.worst[0][NUMBER]}")


_WORST_COLUMNS = {
    "wrong_s": "wrong s",
    "longest_silence_s": "silent s",
    "wrong_share": "wrong",
    "missed_share": "missed",
    "error_p95_cm": "95 % cm",
    "error_worst_cm": "worst cm",
}
"""Columns of the list of the worst flights, with short headings."""


def _share(share: Share) -> tuple[str, ...]:
    percent = f"{100 * share.flights / share.of:.2f}" if share.of else "-"
    return share.what, str(share.flights), percent, f"{100 * share.low:.2f} to {100 * share.high:.2f}"


def _distribution(distribution: Distribution) -> list[str]:
    factor = 100.0 if distribution.what.endswith("[%]") else 1.0
    cells = [distribution.what]
    for found in distribution.quantiles:
        value, low, high = (
            "?" if one is None else f"{factor * one:.3g}" for one in (found.value, found.low, found.high)
        )
        cells.append(f"{value} ({low}–{high})")
    return cells


def _shown(value: Any) -> str:
    return "-" if value is None else f"{value:.4g}"


def _lines(summary: Summary, where: Workers) -> Iterator[str]:
    """What went wrong with the run itself."""
    if where.died:
        yield f"{where.died} worker processes died; their flights were flown again."
    if summary.failed:
        yield f"{len(summary.failed)} flights could not be flown:"
        for number, why in list(summary.failed.items())[:SHOWN_FAILURES]:
            yield f"  flight {number}: {why}"
