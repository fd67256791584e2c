"""The one command line of all that judges the product: ``python -m evaluation NAME [options]``.

Without a name it lists what there is. An evaluation is a module with ``options(parser)``, which adds its options,
``main(given)``, which runs it and returns the exit code or None, and a docstring, which is its help.
"""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

EVALUATIONS = {
    "arm64": ("arm64.command", "instructions of a start and of a flight on arm64, into docs/figures.md"),
    "bench": ("benchmarks.command", "times, memory and figures of the product, into docs/figures.md"),
    "benchmark": ("benchmark.command", "frozen tables with hidden effects, for this and other methods"),
    "blind": ("blind.command", "tables computed from sound, with hidden effects, for the gap workflow"),
    "blind_peers": ("blind_peers.command", "the same tables for other methods that detect or name effects"),
    "closure": ("closure.command", "how much of a gap is closed in blind tables, by a classifier and by KS"),
    "days": ("days.command", "tables of slow data, day by day, and of flights with words, for the gap workflow"),
    "delay": ("delay.command", "tables of readings that are late or early, with all that clocks do"),
    "design": ("design.command", "pairs of effects that look alike, and the session that tells them apart"),
    "faults": ("faults.command", "flights with faults, judged by what the autopilot receives"),
    "fit_coverage": ("benchmarks.bench_fit_coverage", "how often intervals of the mixture's fit hold the truth"),
    "fleet": ("fleet.command", "fleets with odd vehicles, for msp-lab fleet"),
    "fuzz": ("fuzz.command", "damaged files and link bytes, for every reader"),
    "gap_cost": ("benchmarks.bench_gap", "seconds and memory of msp-lab gap on many readings"),
    "gap_coverage": ("benchmarks.bench_gap_coverage", "how often intervals of named effects hold the truth"),
    "install": ("install.command", "install.sh and the service on a Debian that boots in a container"),
    "monte_carlo": ("benchmarks.bench_monte_carlo", "many flights and many gaps, on one worker and on two"),
    "others": ("others.command", "flights of four sensors with an effect on one, and the truth hidden"),
    "package": ("install.package", "the Debian package on Debians that boot in a container"),
    "power": ("blind_peers.power", "the smallest bias that each method finds"),
    "real": ("real.run", "other people's measured readings, through the gap workflow"),
    "real_analysis": ("real.analysis", "what is in those readings, by an analysis of its own"),
    "real_names": ("real.names", "the table of names that the gap workflow has to find in them"),
    "second_hand": ("second_hand.command", "tables of a second generator with hidden effects, for the gap workflow"),
    "sensor_watch": ("sensor_watch.command", "false findings and delays of the sensor watch, in drawn flights"),
    "soak": ("soak.command", "one bridge for many hours with random faults, and in real time on a busy computer"),
    "splits": ("second_hand.draws", "how often the gap workflow names the same with other splits of the runs"),
}
"""Name on the command line -> module in this package, and a line of help."""


def main(words: Sequence[str]) -> int:
    """Run the evaluation that the command line names; return the exit code."""
    if not words or words[0] in ("-h", "--help"):
        print(listing())
        return 0
    name, *rest = words
    if name not in EVALUATIONS:
        print(f"no evaluation is called {name!r}\n\n{listing()}", file=sys.stderr)
        return 2
    module = import_module(f"evaluation.{EVALUATIONS[name][0]}")
    parser = argparse.ArgumentParser(
        prog=f"python -m evaluation {name}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    module.options(parser)
    try:
        return module.main(parser.parse_args(rest)) or 0
    except argparse.ArgumentTypeError as error:
        parser.error(str(error))
    except KeyboardInterrupt:
        return 130


def listing() -> str:
    """All evaluations with a line each."""
    lines = [f"  {name:14}{line}" for name, (_, line) in EVALUATIONS.items()]
    usage = "usage: python -m evaluation NAME [options]; NAME --help explains one\n"
    return "\n".join([usage, *lines])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
