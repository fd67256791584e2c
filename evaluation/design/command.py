"""Blind pairs of effects that look alike, and the table of promises and how they were kept.

Cases that are in OUT are kept, so that an interrupted run is resumed, and a larger number adds cases.
For instance ``--pairs 18 --seed 31 --out build/design-31``.
"""

import argparse
from collections.abc import Sequence

from evaluation.design.campaign import Outcome, run_case
from evaluation.design.oracle import ENOUGH_NATS
from evaluation.runner import Row, as_objects, campaign_options, publish, run_cases
from evaluation.shares import wilson

OUTCOMES = ("right", "wrong", "not promised", "same", "no question", "not asked", "crash")


def table(found: Sequence[Outcome]) -> str:
    """Outcomes by pair, and how often a promise was kept."""
    lines = [f"| pair | {' | '.join(OUTCOMES)} |", "|---" * (len(OUTCOMES) + 1) + "|"]
    for title in dict.fromkeys(each.pair for each in found):
        counts = [sum(each.pair == title and each.outcome == what for each in found) for what in OUTCOMES]
        lines.append(f"| {title} | {' | '.join(map(str, counts))} |")
    lines.append(f"| all | {' | '.join(str(sum(each.outcome == what for each in found)) for what in OUTCOMES)} |")
    for about, of in ((True, "about the pair"), (False, "about what was not recorded")):
        own = [each for each in found if each.about_pair == about]
        kept, broken = (sum(each.outcome == what for each in own) for what in ("right", "wrong"))
        lines.append(f"\nPromises kept, questions {of}: {_share(kept, kept + broken)}")
    same = [each for each in found if each.about_pair and each.outcome == "same"]
    wrongly = sum(each.decidable_nats >= ENOUGH_NATS for each in same)
    lines.append(f"\nCalled the same although an experiment would decide: {_share(wrongly, len(same))}")
    return "\n".join(lines)


def _share(count: int, of: int) -> str:
    """Counts with Wilson's 95 % interval."""
    low, high = wilson(count, of)
    return f"{count} of {of} (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    campaign_options(parser, "build/design")
    parser.add_argument("--pairs", type=int, default=21, help="cases (default: %(default)s)")
    parser.add_argument("--power", type=float, default=0.95, help="wanted of a session (default: %(default)s)")
    parser.add_argument("--sessions", type=int, default=0, help="sessions that the command simulates; 0: none")


def main(given: argparse.Namespace) -> None:
    """Run what is not there yet, and print the table."""
    cases = {
        f"{given.seed}:{number}:{given.power:g}:{given.sessions}": (
            given.out,
            given.seed,
            number,
            given.power,
            given.sessions,
        )
        for number in range(given.pairs)
    }
    rows = run_cases(cases, run_case, given.jobs, given.out / "cases.jsonl", line=_lines)
    publish(table([Outcome(**each) for row in rows for each in row["outcomes"]]), given.out)


def _lines(row: Row) -> str:
    lines = []
    for each in as_objects(Outcome, row["outcomes"]):
        detail = each.detail + (f"; {each.decidable_nats:.0f} nats by an oracle" if each.outcome == "same" else "")
        lines.append(f"{each.number} {each.pair}, {each.hidden} {each.size:.3g}: {each.outcome} ({detail})")
    return "\n".join(lines)
