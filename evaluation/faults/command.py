"""Fly a fault campaign: also ``make faults``.

Prints a table of all groups, the goals, and the worst flights, which OUT/tables.md holds too; OUT/flights.jsonl has a
line for each flight. A flight that is named there, such as 1:42, is flown again with everything about it written by
``--again 1:42 --out FOLDER``.
"""

import argparse
import json
import re
from itertools import count, islice

from rich.console import Console

from evaluation.faults.campaign import BELIEVE, fly_all, fly_plan, other_constants
from evaluation.faults.families import FAMILIES, FIRST
from evaluation.faults.plans import SHARES, draw_plan, group_of, row_of
from evaluation.faults.report import (
    coverage_table,
    edges_table,
    families_table,
    goals_table,
    groups_table,
    markdown,
    probability_table,
    shown,
    worst_table,
)
from evaluation.runner import campaign_options
from msp_range.clock import SystemClock

WIDTH = 260
"""Of the tables where there is no terminal [characters]: no heading is wrapped."""


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--flights", type=int, default=700, help="how many (default: %(default)s)")
    campaign_options(parser, "build/faults")
    parser.add_argument("--hostile", action="store_true", help="fly the hostile families instead of the groups")
    parser.add_argument(
        "--only",
        nargs="+",
        metavar="GROUP",
        help=f"groups or rows: {', '.join(SHARES)}, 'one: stuck'; or hostile families: {', '.join(FAMILIES)}",
    )
    parser.add_argument(
        "--without-motion", action="store_true", help="the autopilot sends neither accelerations nor pressures"
    )
    parser.add_argument(
        "--set",
        type=_constant,
        nargs="+",
        default=[],
        metavar="NAME=VALUE",
        help="other values of constants of the belief, to see what one is for: ODD=1e9 (none is odd), COMMON=1e-4",
    )
    parser.add_argument("--again", metavar="SEED:INDEX", help="fly one flight again and write all of it to OUT")


def _constant(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    known = {key: type(each) for module in BELIEVE for key, each in vars(module).items() if type(each) in (float, int)}
    if name not in known:
        raise argparse.ArgumentTypeError(f"found {name!r}; expected one of: {', '.join(sorted(known))}")
    try:
        number = float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"found {text!r}; expected {name}=NUMBER, such as {name}=1e9") from None
    if known[name] is int and not number.is_integer():
        raise argparse.ArgumentTypeError(f"found {text!r}; expected a whole number")
    return name, known[name](number)


def main(given: argparse.Namespace) -> None:
    """Fly a campaign, or one flight again."""
    if given.again is not None:
        if not re.fullmatch(r"\d+:\d+", given.again):
            raise argparse.ArgumentTypeError(f"--again: found {given.again!r}; expected SEED:INDEX, such as 1:42")
        seed, index = map(int, given.again.split(":"))
        with other_constants(dict(given.set)):
            print(json.dumps(fly_plan(draw_plan(seed, index, not given.without_motion), given.out), indent=2))
        return
    only = given.only or []
    first = FIRST if given.hostile or set(only) & _names_from(FIRST) else 0
    for name in only:
        if name not in _names_from(first):
            names = "; ".join(sorted(_names_from(first)))
            raise argparse.ArgumentTypeError(f"--only: found {name!r}; expected some of: {names}")
    wanted = (index for index in count(first) if not only or {group_of(index), row_of(index)} & set(only))
    indices = list(islice(wanted, given.flights))
    clock = SystemClock()
    started_s = clock.now()
    file, sends_motion = given.out / "flights.jsonl", not given.without_motion
    lines = fly_all(given.seed, indices, given.jobs, sends_motion, file, dict(given.set))
    flown_s = sum(line["verdict"]["flown_s"] for line in lines)
    print(f"{len(lines)} flights, {flown_s:,.0f} s flown in {clock.now() - started_s:.0f} s\n")
    console = Console()
    console = console if console.is_terminal else Console(width=WIDTH)
    tables = [families_table(lines), edges_table(lines)] if first else [groups_table(lines), goals_table(lines)]
    tables += [coverage_table(lines), probability_table(lines), worst_table(lines)]
    for table in tables:
        console.print(shown(table))
    (given.out / "tables.md").write_text("\n".join(map(markdown, tables)), encoding="utf-8")
    print(f"tables: {given.out / 'tables.md'}\nevery flight: {given.out / 'flights.jsonl'}")


def _names_from(first: int) -> set[str]:
    """Groups, or families, and rows of a campaign that begins with an index."""
    return {name for index in range(first, first + 2000) for name in (group_of(index), row_of(index))}
