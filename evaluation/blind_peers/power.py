"""The smallest bias that is found, in tables with a bias of each size.

A size is the root mean square of the bias over a table's readings, in standard deviations of a hit, its mean taken off;
its form is one of ten mechanisms in turn. Every method has 2000 readings, those of half of the runs, and may be wrong
in 5 of 100 tables in which nothing is hidden: how often it was stands alongside. What the gap workflow
reports in the end has also to hold on the other half of the runs.
"""

import argparse
import json
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from evaluation.blind.run import Campaign
from evaluation.blind.run import run as run_gap
from evaluation.blind.tables import ROWS, RUNS, TOGETHER, Case
from evaluation.blind_peers.command import ALPHA, ask
from evaluation.runner import run_cases
from evaluation.shares import wilson

SIZES = (0.05, 0.07, 0.1, 0.14, 0.2)
"""Root mean square of the bias, in standard deviations of a hit."""
HIT_SHARE = 0.95
"""Of the readings, that are hits."""
NULLS_FOR_EACH = 3
"""So many times as many tables with nothing hidden as of a size."""
POWER = 0.8
BIASES = (*TOGETHER["bias"], *TOGETHER["bias too"])
DETECTORS = ("KS by slice", "energy distance, pairs swapped", "classifier, boosted trees")
SCREEN = "gap workflow: its first screen, p < 0.05"
CHOSEN = "gap workflow: chooses something, before the held-out runs decide"
REPORTED = "gap workflow: names something or calls it unknown"
DROPPED = re.compile(r"(.+) was tried and dropped: ")
CALIBRATION = "heavy_tails"
"""An effect that is of the base."""
CLOSE = 0.1
"""So near to a size, in proportion, a table counts as of it."""
DRAWS = 1000
"""Of the bootstrap."""


def cases(count: int, seed: int) -> list[Case]:
    """Tables with nothing hidden, and of each size; mixed, so that a part of them is like the whole."""
    drawn = []
    for k in range(count):
        drawn += [Case(0, seed, "null", "iid") for _ in range(NULLS_FOR_EACH)]
        for size in SIZES:
            errors = round(size * (HIT_SHARE * RUNS * ROWS / 2) ** 0.5, 2)
            drawn.append(Case(0, seed, "one", "iid", ((BIASES[k % len(BIASES)], errors),)))
    return [Case(number, each.seed, each.kind, each.regime, each.hidden) for number, each in enumerate(drawn)]


def found(out: Path) -> dict[str, dict[float, list[bool]]]:
    """Whether each method reported that something is there, by the size of what is; size 0 is nothing."""
    reported: dict[str, dict[float, list[bool]]] = defaultdict(lambda: defaultdict(list))
    for path in sorted((out / "answers").glob("*.json")):
        answer = json.loads(path.read_text(encoding="utf-8"))
        has = max((each["standard_errors"] for each in answer["hidden"]), default=0.0)
        size = has / (HIT_SHARE * RUNS * ROWS / 2) ** 0.5
        known = min((0.0, *SIZES), key=lambda each: abs(each - size))
        if abs(size - known) > CLOSE * known:
            # A mechanism cannot be made larger than is physical.
            continue
        table = out / "tables" / path.stem
        result, peers = table / "gap" / "gap.json", table / "peers.json"
        if result.exists():
            gap = json.loads(result.read_text(encoding="utf-8"))
            found_any = bool(gap["effects"] or gap["unknown"])
            dropped = {match[1] for message in gap["messages"] if (match := DROPPED.match(message))}
            reported[REPORTED][known].append(found_any)
            reported[CHOSEN][known].append(found_any or bool(dropped - {CALIBRATION}))
            if gap.get("p_value") is not None:
                reported[SCREEN][known].append(gap["p_value"] < ALPHA)
        if peers.exists():
            for name, each in json.loads(peers.read_text(encoding="utf-8")).items():
                if "p_value" in each:
                    reported[name][known].append(each["p_value"] < ALPHA)
    return reported


def size_at(power: float, sizes: Sequence[float], shares: Sequence[float]) -> float:
    """Where the share crosses the power for good, straight between two sizes; infinite where it does not.

    Examples
    --------
    >>> print(round(size_at(0.8, (0.05, 0.1, 0.2), (0.2, 0.7, 0.9)), 3))
    0.15
    >>> print(size_at(0.8, (0.05, 0.1), (0.2, 0.7)))
    inf
    """
    below = [k for k, share in enumerate(shares) if share < power]
    if not below:
        return sizes[0]
    last = below[-1]
    if last + 1 == len(sizes):
        return float("inf")
    share = (power - shares[last]) / (shares[last + 1] - shares[last])
    return sizes[last] + share * (sizes[last + 1] - sizes[last])


def _size_with_interval(by_size: Mapping[float, list[bool]]) -> tuple[float, float, float]:
    rng = np.random.default_rng(0)
    sizes = [size for size in SIZES if by_size.get(size)]
    outcomes = [np.array(by_size[size], dtype=float) for size in sizes]
    drawn = [size_at(POWER, sizes, [rng.choice(each, each.size).mean() for each in outcomes]) for _ in range(DRAWS)]
    low, high = np.quantile(drawn, (0.025, 0.975), method="inverted_cdf")
    return size_at(POWER, sizes, [each.mean() for each in outcomes]), float(low), float(high)


def show(reported: Mapping[str, Mapping[float, list[bool]]]) -> str:
    """The curves in Markdown, with the size at 80 %."""
    sizes = [size for size in SIZES if any(each.get(size) for each in reported.values())]
    heads = ["nothing hidden", *(f"{size:g} sigma" for size in sizes), f"found in {POWER:.0%}"]
    of = {size: max(len(each.get(size, ())) for each in reported.values()) for size in (0.0, *sizes)}
    lines = [f"Tables: {of[0.0]} with nothing hidden, {', '.join(f'{of[size]} of {size:g}' for size in sizes)}", ""]
    lines += ["| | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
    for name in (SCREEN, CHOSEN, REPORTED, *DETECTORS):
        if name not in reported:
            continue
        by_size: Mapping[float, list[bool]] = reported[name]
        null = by_size.get(0.0, [])
        low, high = wilson(sum(null), len(null))
        cells = [f"{np.mean(null):.3f} ({low:.3f} to {high:.3f})" if null else ""]
        cells += [f"{np.mean(by_size[size]):.2f}" if by_size.get(size) else "" for size in sizes]
        middle, least, most = _size_with_interval(by_size)
        cells.append(f"{_sigma(middle)} ({_sigma(least)} to {_sigma(most)})")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _sigma(size: float) -> str:
    return f"{size:.3f}" if np.isfinite(size) else f"> {SIZES[-1]:g}"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("count", type=int, help=f"tables of each size, and {NULLS_FOR_EACH} times as many nulls")
    parser.add_argument("seed", type=int, help="random seed")
    parser.add_argument("--out", type=Path, help="folder; build/blind-power-SEED unless given; the count can be raised")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--step", choices=("all", "show"), default="all", help="only show what is there")


def main(given: argparse.Namespace) -> None:
    """Run what is not there yet, and print the table."""
    out = given.out or Path("build") / f"blind-power-{given.seed}"
    if given.step == "all":
        campaign, wanted = Campaign(out, given.seed, until="name"), cases(given.count, given.seed)
        run_gap(campaign, wanted, given.jobs)
        tables = {str(case.number): (given.seed, campaign.table(case), (), DETECTORS) for case in wanted}
        run_cases(tables, ask, given.jobs)
    print(show(found(out)))
