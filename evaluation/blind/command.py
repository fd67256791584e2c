"""Draw, run and score blind tables: also ``make blind N=200 SEED=1``.

Without ``--plan`` tables of all kinds are drawn, in shares. With it their numbers are given, for instance
``--plan null=300 one:6=100 one:10=100 three:10=60 unknown:10=120 confounded=200``: null is of each regime of noise, or
``null:ar1=300`` of one; after a colon stand the standard errors of what is hidden. Numbers can be raised later.
"""

import argparse
import sys
from pathlib import Path

from evaluation.blind.flight import REGIMES
from evaluation.blind.report import score
from evaluation.blind.run import Campaign, draw, draw_base, run
from evaluation.blind.tables import SHARES, Case, draw_cases, draw_plan
from evaluation.document import replace_section
from evaluation.runner import campaign_options


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    campaign_options(parser)
    parser.add_argument("--count", type=int, default=200, help="tables, of all kinds (default: %(default)s)")
    parser.add_argument("--kind", choices=list(SHARES), help="all of one kind")
    parser.add_argument("--regime", choices=REGIMES, help="all in one")
    parser.add_argument("--standard-errors", type=float, help="all of one size")
    parser.add_argument("--plan", nargs="+", metavar="KIND[:REGIME|S.E.]=COUNT", help="how many of what, instead")
    parser.add_argument("--until", choices=("name", "add", "show"), default="add", help="last step of msp-lab gap")
    parser.add_argument("--nulls-until", choices=("name", "add", "show"), default="name", help="the same for nulls")
    parser.add_argument("--step", choices=("all", "draw", "run", "score"), default="all", help="do this step alone")
    parser.add_argument("--figures", type=Path, help="write the scores into this document's section 'blind' too")


def main(given: argparse.Namespace) -> None:
    """Draw, run and score."""
    campaign = Campaign(given.out, given.seed, given.until, given.nulls_until)
    if given.step != "score":
        cases = _cases(given)
    if given.step == "draw":
        for regime in sorted({case.regime for case in cases}):
            draw_base(campaign, regime)
        for case in cases:
            draw(campaign, case)
    if given.step in ("all", "run"):
        run(campaign, cases, given.jobs)
    if given.step in ("all", "score"):
        scores = score(given.out)
        print(scores)
        if given.figures:
            arguments = " ".join(word for word in sys.argv[2:] if word != "--figures" and word != str(given.figures))
            replace_section(given.figures, "blind", f"Tables of `python -m evaluation blind {arguments}`.\n\n{scores}")


def _cases(given: argparse.Namespace) -> list[Case]:
    if not given.plan:
        return draw_cases(given.seed, given.count, given.kind, given.regime, given.standard_errors)
    try:
        return draw_plan(given.seed, given.plan)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error
