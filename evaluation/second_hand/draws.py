"""Runs the workflow on each case with several draws of the splits, and prints how often it names the same."""

import argparse
import json
import multiprocessing
import os
import tempfile
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from rich.progress import Progress

from evaluation.second_hand.generator import FINAL_SEED, case
from evaluation.second_hand.results import result_file
from evaluation.second_hand.score import matched
from evaluation.second_hand.workflow import run_case

KINDS = ("null:0.5=20", "null:0.8=20", "one:6=20", "one:10=20", "one:20=20")


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), metavar="KIND=CASES", help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first case; the others follow")
    parser.add_argument("--draws", type=int, default=5, help="random seeds of the splits, from 1 on")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder for one JSON file a case and draw")


def main(given: argparse.Namespace) -> None:
    """Run what is not there yet, and print the table."""
    wanted = [
        (kind, given.seed + number, draw)
        for kind, count in (each.split("=") for each in given.kinds)
        for number in range(int(count))
        for draw in range(1, given.draws + 1)
    ]
    if max(seed for _, seed, _ in wanted) >= FINAL_SEED:
        raise argparse.ArgumentTypeError(f"seeds from {FINAL_SEED} on are kept for a final run")
    todo = [each for each in wanted if not _file(given.out, *each).exists()]
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
    with Progress() as progress, ProcessPoolExecutor(given.jobs, multiprocessing.get_context("spawn")) as pool:
        bar = progress.add_task("draws", total=len(wanted), completed=len(wanted) - len(todo))
        for done in as_completed([pool.submit(_find, given.out, *each) for each in todo]):
            done.result()
            progress.advance(bar)
    print(table(given.out, wanted))


def table(out: Path, wanted: list[tuple[str, int, int]]) -> str:
    """For each kind the share of cases with the same names and curves in all draws, and of draws as the first one."""
    found: dict[str, dict[int, list[dict[str, Any]]]] = defaultdict(lambda: defaultdict(list))
    for kind, seed, draw in wanted:
        found[kind][seed].append(json.loads(_file(out, kind, seed, draw).read_text(encoding="utf-8")))
    lines = ["| kind | cases | the same in all draws | draws that say what most say |", "|---|---|---|---|"]
    others = []
    for kind, cases in found.items():
        alike = {
            seed: [max(sum(same(a, b) for b in drawn) for a in drawn), len(drawn)] for seed, drawn in cases.items()
        }
        whole = sum(most == count for most, count in alike.values())
        share = sum(most for most, _ in alike.values()) / sum(count for _, count in alike.values())
        lines.append(f"| {kind} | {len(cases)} | {whole / len(cases):.2f} | {share:.2f} |")
        others += [
            f"{kind} {seed}: " + "; ".join(_said(each) for each in cases[seed])
            for seed, (most, count) in alike.items()
            if most < count
        ]
    return "\n".join([*lines, "", *others])


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two draws name as many effects, each with a name that the other has too, and the same curves."""
    first, second = ([{each["name"], *each["alternatives"]} for each in found["effects"]] for found in (one, other))
    curves = [sorted((each["channel"], *each["variables"]) for each in found["curves"]) for found in (one, other)]
    return len(first) == len(second) == matched(first, second) and curves[0] == curves[1]


def _find(out: Path, kind: str, seed: int, draw: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = run_case(case(kind, seed), Path(folder), draw)
    path = _file(out, kind, seed, draw)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    unfinished.write_text(json.dumps(found, indent=1), encoding="utf-8")
    unfinished.rename(path)


def _file(out: Path, kind: str, seed: int, draw: int) -> Path:
    return result_file(out / str(draw), kind, seed)


def _said(found: dict[str, Any]) -> str:
    curves = [f"curve of {each['channel']} over {' and '.join(each['variables'])}" for each in found["curves"]]
    return ", ".join([*(each["name"] for each in found["effects"]), *curves]) or "nothing"
