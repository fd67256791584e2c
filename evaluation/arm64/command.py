"""Instructions of `msp-range run` on arm64, emulated by qemu: of a start, and of a second of flight.

Four sensors are emulated behind the kernel's I2C interface (umockdev), an autopilot sends what the bridge asks it for,
and the recording is on. Counted are all instructions of the process, without those of the kernel; umockdev's part is
in them. What they mean in time depends on how many a processor executes in a cycle, for which the table has a range.
"""

import argparse
import statistics
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from evaluation import ROOT
from evaluation.arm64.computer import Arm64, instructions
from evaluation.benchmarks.bench_bridge import AIRFRAME
from evaluation.benchmarks.bench_page import Streaming
from evaluation.document import FIGURES, replace_section
from tests.support.kernel_bus import Sonar, kernel_bus
from tests.support.service import LinkEnd

START_GOAL, FLIGHT_GOAL = 1.3e9, 10e6
"""Instructions that a start and a second of flight should take at most."""
SETTLED_S = 5.0
"""Flight before the count begins [s]: the autopilot is found by then, and every sensor has answered."""
FIRST_S = 120.0
"""Time for the first distance [s]; a start takes 10 to 30 s here, more where other programs compute."""
RUN = "import sys; sys.argv[0] = 'msp-range'; import msp_range.start; from msp_range.cli import main; main()"


@dataclass(frozen=True)
class Processor:
    """A computer that flies: its clock [Hz], and instructions per cycle, from the least to the most to expect."""

    name: str
    clock_hz: float
    per_cycle: tuple[float, float]


PROCESSORS = (
    Processor("Raspberry Pi Zero 2 W (Cortex-A53)", 1.0e9, (0.4, 0.9)),
    Processor("Raspberry Pi 4 (Cortex-A72)", 1.5e9, (0.9, 1.8)),
)
"""Ranges are assumptions, docs/figures.md says on what grounds; the times of the table are proportional to them."""


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--computer", type=Path, default=ROOT / "build/arm64", help="folder of the emulated computer")
    parser.add_argument("--starts", type=int, default=3, help="starts, of which the median counts (default: 3)")
    parser.add_argument("--seconds", type=float, default=30.0, help="seconds of flight that are counted (default: 30)")
    parser.add_argument("--write", action="store_true", help="write the table to docs/figures.md")


def main(given: argparse.Namespace) -> None:
    """Count, and print or write the table."""
    computer = Arm64(given.computer)
    counted = [fly(computer, given.seconds) for _ in range(given.starts + 1)][1:]  # the first one makes bytecode
    table = as_markdown(*(statistics.median(each) for each in zip(*counted, strict=True)))
    print(table)
    if given.write:
        replace_section(FIGURES, "arm64", table)


def fly(computer: Arm64, seconds: float) -> tuple[int, float]:
    """Instructions from the start to the first DISTANCE_SENSOR, and those of a second of flight."""
    with (
        tempfile.TemporaryDirectory() as name,
        kernel_bus([Sonar(0x70 + number, [300, 301, 299]) for number in range(4)]) as testbed,
        LinkEnd(autopilot=Streaming()) as end,
    ):
        folder = Path(name)
        counts = folder / "counts"
        arguments: list[str | Path] = [
            "run",
            AIRFRAME,
            "--bus",
            "1",
            "--link",
            end.url,
            "--record",
            folder,
            "--socket",
            folder / "sock",
        ]
        command = computer.command("-c", RUN, *arguments, counts=counts)
        with testbed.popen(command, env=computer.environment, stderr=sys.stderr) as process:
            end.run_until(lambda: bool(end.distances), FIRST_S)
            start = instructions(counts)
            end.run_for(SETTLED_S)
            before, began_s = instructions(counts), time.monotonic()
            end.run_for(seconds)
            flight = (instructions(counts) - before) / (time.monotonic() - began_s)
            process.terminate()
    return start, flight


def as_markdown(start: float, flight: float) -> str:
    """The table for docs/figures.md: a start and a second of flight, in instructions and in time."""
    rows = [
        "| | a start, to the first distance | a second of flight |",
        "|---|---|---|",
        f"| instructions | {start / 1e6:.0f} million | {flight / 1e6:.1f} million |",
        f"| goal | {START_GOAL / 1e6:.0f} million | {FLIGHT_GOAL / 1e6:.0f} million |",
    ]
    for processor in PROCESSORS:
        slow, fast = (processor.clock_hz * per_cycle for per_cycle in processor.per_cycle)
        least, most = processor.per_cycle
        rows.append(
            f"| {processor.name}, {processor.clock_hz / 1e9:g} GHz, {least:g} to {most:g} instructions per cycle "
            f"| {start / fast:.2f} to {start / slow:.2f} s | {100 * flight / fast:.1f} to {100 * flight / slow:.1f} % "
            "of one core |"
        )
    return "\n".join(rows)
