"""Blind tables from the draw to what the tools report of them, on all cores at once.

Cases enter; a folder of bases, tables and answers leaves. The tools under test are called as a user calls them, by
their commands, in processes that have them loaded. Answers lie in a folder of their own, which no command is given.
What is there is not made again, so that a campaign can be stopped at any time and gone on with.
"""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from evaluation.blind.flight import Columns, Regime
from evaluation.blind.mechanisms import MECHANISMS
from evaluation.blind.sound import Array
from evaluation.blind.tables import CONFOUNDED, Case, fly_base, fly_case

SENSOR = Path(__file__).parent / "sensor.yaml"
PROGRESS_EACH_S = 30.0
"""Between two lines on the progress where nobody looks: the output goes into a file."""

Until = Literal["name", "add", "show"]


@dataclass(frozen=True)
class Campaign:
    """Where tables lie and how they are looked at.

    Attributes
    ----------
    out
        Folder of bases, tables and answers.
    seed
        Of bases and tools.
    until
        Step of the workflow after which it stops; pictures are for people.
    nulls_until
        The same where nothing is hidden: there is nothing to add if nothing is named.
    """

    out: Path
    seed: int
    until: Until = "add"
    nulls_until: Until = "name"

    def base(self, regime: Regime) -> Path:
        """Readings that are characterised for a regime."""
        return self.out / "bases" / f"{regime}.csv"

    def table(self, case: Case) -> Path:
        """Folder of a table."""
        return self.out / "tables" / f"{case.number:04d}"

    def answer(self, case: Case) -> Path:
        """What is hidden in it."""
        return self.out / "answers" / f"{case.number:04d}.json"

    def findings(self, case: Case) -> Path:
        """The workflow's findings of it."""
        return self.table(case) / "gap" / "gap.json"


def write(path: Path, columns: Columns, reading_cm: Array) -> None:
    """A CSV file in the one form; an empty cell is unknown."""
    names = [*columns, "reading_cm"]
    cells = [
        [("" if v != v else f"{v:.6g}") for v in column.tolist()] if column.dtype.kind == "f" else column.tolist()
        for column in (*(np.asarray(each) for each in columns.values()), reading_cm)
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    begun = path.with_suffix(".part")
    with begun.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(zip(*cells, strict=True))
    begun.replace(path)


def draw_base(campaign: Campaign, regime: Regime) -> None:
    """Fly what a user characterises."""
    if not campaign.base(regime).exists():
        write(campaign.base(regime), *fly_base(campaign.seed, regime))


def draw(campaign: Campaign, case: Case) -> None:
    """Fly a table, and write it and its answer."""
    table, answer = campaign.table(case), campaign.answer(case)
    if (table / "measured.csv").exists():
        return
    columns, reading_cm, hidden = fly_case(case)
    for each in hidden:
        mechanism = MECHANISMS[str(each["mechanism"])]
        each |= {"channel": mechanism.channel, "variables": list(mechanism.variables)}
    pair = CONFOUNDED[case.twist][0] if case.twist else ()
    content = {"kind": case.kind, "regime": case.regime, "twist": case.twist, "pair": pair, "hidden": hidden}
    answer.parent.mkdir(parents=True, exist_ok=True)
    answer.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    table.mkdir(parents=True, exist_ok=True)
    (table / "base").write_text(case.regime, encoding="utf-8")
    write(table / "measured.csv", columns, reading_cm)


class Tools:
    """The commands of the product, in a process that has them loaded."""

    def __init__(self) -> None:
        # In a session of its own, so that Ctrl-C lets it finish what it is at.
        command = [sys.executable, "-m", "evaluation.warm_cli"]
        one_thread = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env=os.environ | one_thread,
        )

    def call(self, *command: object) -> str:
        """Run a command, and return what was wrong with it, or nothing."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([str(each) for each in command]) + "\n")
        self._process.stdin.flush()
        code, output = json.loads(self._process.stdout.readline())
        return "" if code == 0 else f"{' '.join(str(each) for each in command[:2])}: exit code {code}: {output}"


_tools: Tools


def _begin() -> None:
    """In each process of the pool."""
    global _tools
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _tools = Tools()


def _do_base(campaign: Campaign, regime: Regime) -> str:
    draw_base(campaign, regime)
    base = campaign.base(regime)
    model = base.with_suffix(".yaml")
    if model.exists():
        return ""
    # The lift's heights are true to a hair: what its runs differ by is the sensor's and the vehicle's.
    given = ("--sensor", SENSOR, "--set-up-std-cm", 0.02, "--seed", campaign.seed)
    return _tools.call("msp-lab", "characterise", base, *given, "--out", model)


def _do_table(campaign: Campaign, case: Case) -> str:
    draw(campaign, case)
    table, to = campaign.table(case), campaign.findings(case).parent
    model = campaign.base(case.regime).with_suffix(".yaml")
    until = campaign.until if case.hidden else campaign.nulls_until
    # Made next to its place, so that what is in it is finished.
    begun = table / "gap.part"
    wrong = _tools.call(
        "msp-lab", "gap", table / "measured.csv", "--model", model, "--out", begun, "--seed", campaign.seed,
        "--until", until,
    )  # fmt: skip
    if not wrong:
        begun.rename(to)
    return f"table {case.number}: {wrong}" if wrong else ""


def run(campaign: Campaign, cases: Sequence[Case], at_once: int) -> None:
    """Draw what is not there, and look for the gap in it, table by table.

    Ctrl-C finishes what is begun and leaves the rest.
    """
    left = [case for case in cases if not campaign.findings(case).exists()]
    progress = _Progress(cases, left)
    with ProcessPoolExecutor(at_once, initializer=_begin) as pool:
        regimes = sorted({case.regime for case in left})
        try:
            for wrong in pool.map(_do_base, [campaign] * len(regimes), regimes):
                progress.wrong(wrong)
            waiting: dict[Future[str], Case] = {}
            for case in left:
                if len(waiting) > 2 * at_once:
                    progress.add(_first_of(waiting))
                waiting[pool.submit(_do_table, campaign, case)] = case
            while waiting:
                progress.add(_first_of(waiting))
        except KeyboardInterrupt:
            print("\nstopping; the same command goes on", file=sys.stderr)
            pool.shutdown(cancel_futures=True)
            raise


def _first_of(waiting: dict[Future[str], Case]) -> list[tuple[Case, str]]:
    done, _ = wait(waiting, return_when=FIRST_COMPLETED)
    return [(waiting.pop(each), each.result()) for each in done]


class _Progress:
    """The progress, on standard error: a line that changes on a terminal, and else one now and then."""

    def __init__(self, cases: Sequence[Case], left: Sequence[Case]) -> None:
        self._wanted = Counter(case.kind for case in cases)
        self._done = self._wanted - Counter(case.kind for case in left)
        self._left, self._made = len(left), 0
        self._start_s = self._shown_s = time.monotonic()

    def add(self, finished: Sequence[tuple[Case, str]]) -> None:
        for case, wrong in finished:
            self._made += 1
            self._done[case.kind] += 1
            self.wrong(wrong)
        now_s = time.monotonic()
        if not sys.stderr.isatty() and now_s - self._shown_s < PROGRESS_EACH_S and self._made < self._left:
            return
        self._shown_s = now_s
        per_s = self._made / (now_s - self._start_s)
        counts = ", ".join(f"{kind} {self._done[kind]} of {of}" for kind, of in self._wanted.items())
        minutes = (self._left - self._made) / max(per_s, 1e-9) / 60.0
        start, end = ("\r", "\x1b[K") if sys.stderr.isatty() else ("", "\n")
        text = f"{start}{counts}; {60.0 * per_s:.0f} a minute, {minutes:.0f} min left"
        print(text, end=end if self._made < self._left else "\n", file=sys.stderr, flush=True)

    def wrong(self, what: str) -> None:
        if what:
            print(what, file=sys.stderr, flush=True)
