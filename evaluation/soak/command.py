"""One bridge for many simulated hours, and for some real minutes.

In the simulated hours sensors and bus fail at random; the real minutes run while a busy process occupies each core.
Exit code 1: a distance was wrong, memory grew by more than 2 % after the first hour, or a message came later than a
slot. ``--write FILE`` writes the report. `make soak` runs it with the settings of the service's unit.
"""

import argparse
import gc
import os
import platform
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread

from evaluation.memory import memory_mb
from evaluation.soak.vehicle import Vehicle
from msp_range.clock import SystemClock, VirtualClock
from msp_range.recording.writer import Recorder

PIECE_S = 600.0
"""Time between two looks at the memory [s]."""
GROWTH_PERCENT, SLOT_MS = 2.0, 100.0
"""Goals: growth of the memory after the first hour, and the latest message after its ranging."""
BUSY = "while True: pass"
IN_MEMORY = Path("/dev/shm")
"""Where the simulated hours are recorded. A vehicle's disk has a second for a second of flight; here it has 3 ms, and
what waits for a slow disk would be minutes of flight, whose memory no vehicle needs."""


def growth_percent(samples: list[tuple[float, float]]) -> float | None:
    """Growth of the memory after the first hour, of samples (hour, MB); None for a flight that is no longer.

    The largest of the later samples over the largest of the first hour, at whose end the first file was closed and the
    second begun.
    """
    first = [mb for hour, mb in samples if hour < 1.0 + 1e-3]
    later = [mb for hour, mb in samples if hour >= 1.0 + 1e-3]
    return 100.0 * (max(later) / max(first) - 1.0) if first and later else None


def simulated(hours: float, seed: int, folder: Path) -> tuple[list[str], bool]:
    """Lines of the report on the simulated hours, and whether all goals are reached."""
    clock = VirtualClock()
    recorder = Recorder(folder / "0.mcap", clock, waits=True)
    vehicle = Vehicle(clock, seed, 3600.0 * hours, recorder)
    judge, samples = vehicle.judge, [(0.0, _memory_in_use_mb())]
    lines = ["| simulated hour | resident memory | fused distances | wrong |", "|---|---|---|---|"]
    while vehicle.now_s() < 3600.0 * hours - 1e-6:
        vehicle.fly(min(vehicle.now_s() + PIECE_S, 3600.0 * hours))
        hour = vehicle.now_s() / 3600.0
        is_full = vehicle.now_s() % 3600.0 < 1.0
        if is_full:
            # A new file, as the service begins one each hour: a file's index grows in memory while it is written.
            recorder.close()
            recorder = Recorder(folder / f"{hour:.0f}.mcap", clock, waits=True)
            vehicle.bridge.record_to(recorder)
        samples.append((hour, _memory_in_use_mb()))
        _show(f"{hour:6.2f} of {hours:g} h: {samples[-1][1]:.1f} MB, {judge.wrong} wrong")
        if is_full or hour >= hours - 1e-6:
            lines.append(f"| {hour:.1f} | {samples[-1][1]:.1f} MB | {judge.messages} | {judge.wrong} |")
    recorder.close()
    megabytes = sum([file.stat().st_size for file in folder.iterdir()]) / 1e6
    growth = growth_percent(samples)
    latest_ms = judge.delays.quantile_ms(1.0)
    lines += [
        "",
        f"{vehicle.faults} faults, one at a time; {megabytes:.0f} MB recorded, a file each hour as the service does.",
        "",
        "| figure | value | goal |",
        "|---|---|---|",
        f"| wrong distances (over 50 cm off for over 0.5 s) | {judge.wrong} | 0 |",
        f"| growth of the memory after the first hour | {_percent(growth)} | at most {GROWTH_PERCENT:g} % |",
        f"| latest message after its ranging, without a fault | {latest_ms:.1f} ms | within a slot, {SLOT_MS:g} ms |",
        f"| time between pings: median; 99 % | {vehicle.intervals.quantile_ms(0.5):.1f} ms; "
        f"{vehicle.intervals.quantile_ms(0.99):.1f} ms | 100 ms |",
        f"| longest time without a distance, without a fault | {judge.longest_gap_s:.2f} s | |",
    ]
    return lines, judge.wrong == 0 and (growth is None or growth <= GROWTH_PERCENT) and latest_ms <= SLOT_MS


def real(minutes: float, seed: int, busy: int, folder: Path) -> tuple[list[str], bool]:
    """Lines of the report on the real minutes, and whether all goals are reached.

    Objects that stay are kept from garbage collection, as `msp_range.service` does, and nothing is collected by hand:
    all objects of a process take 50 ms, and the bridge would wait for them.
    """
    clock = SystemClock()
    load = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(busy)]
    recorder = Recorder(folder / "real.mcap", clock)
    try:
        vehicle = Vehicle(clock, seed, 0.0, recorder)
        gc.collect()
        gc.freeze()
        vehicle.fly(5.0)
        first_mb = memory_mb()
        minute = 0.0
        while minute < minutes:
            minute = min(minute + 1.0, minutes)
            vehicle.fly(60.0 * minute)
            # To a file on a disk that is busy this may take a second, for which the bridge would wait.
            Thread(target=_show, args=(f"{minute:5.1f} of {minutes:g} min: {memory_mb():.1f} MB",)).start()
        last_mb = memory_mb()
    finally:
        gc.unfreeze()
        recorder.close()
        for each in load:
            each.kill()
            each.wait()
    judge = vehicle.judge
    latest_ms = judge.delays.quantile_ms(1.0)
    lines = [
        f"{minutes:g} min with recording, at the priority of an ordinary process (the service's is higher),",
        f"next to {busy} busy processes on {os.cpu_count()} cores; load average {os.getloadavg()[0]:.0f} at the end.",
        "",
        "| figure | value | goal |",
        "|---|---|---|",
        f"| fused distances; wrong | {judge.messages}; {judge.wrong} | 0 wrong |",
        f"| message after its ranging: median; 99 % | {judge.delays.quantile_ms(0.5):.1f} ms; "
        f"{judge.delays.quantile_ms(0.99):.1f} ms | |",
        f"| latest message after its ranging | {latest_ms:.1f} ms | within a slot, {SLOT_MS:g} ms |",
        f"| time between pings: median; 99 %; longest | {vehicle.intervals.quantile_ms(0.5):.1f} ms; "
        f"{vehicle.intervals.quantile_ms(0.99):.1f} ms; {vehicle.intervals.quantile_ms(1.0):.1f} ms | 100 ms |",
        f"| resident memory after 5 s; at the end | {first_mb:.1f} MB; {last_mb:.1f} MB | |",
    ]
    return lines, judge.wrong == 0 and latest_ms <= SLOT_MS


def _memory_in_use_mb() -> float:
    """After what is no longer needed has been freed."""
    gc.collect()
    return memory_mb()


def _show(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _percent(growth: float | None) -> str:
    return "no second hour" if growth is None else f"{growth:.1f} %"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--hours", type=float, default=24.0, help="simulated hours (default: %(default)s)")
    parser.add_argument("--minutes", type=float, default=20.0, help="real minutes (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: %(default)s)")
    parser.add_argument("--busy", type=int, default=os.cpu_count(), help="busy processes in the real minutes")
    parser.add_argument("--write", type=Path, help="Markdown file for the report")


def main(given: argparse.Namespace) -> int:
    """Fly both, print the report, and write it."""
    machine = f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}"
    lines = [
        "# Soak",
        "",
        "One bridge for many simulated hours, in which sensors and bus fail at random, and one in real time on a busy",
        "computer: does memory grow, does a message come late, is a distance wrong? `make soak` flies 24 simulated",
        "hours and 20 real minutes. This is the report of what was flown last, which may be less.",
        "",
        f"{given.hours:g} h and {given.minutes:g} min by seed {given.seed}, flown on {machine}, with",
        f"MALLOC_MMAP_THRESHOLD_={os.environ.get('MALLOC_MMAP_THRESHOLD_', 'unset')}; the service's unit sets it.",
        "",
        "## Simulated hours",
        "",
    ]
    with TemporaryDirectory(dir=IN_MEMORY if IN_MEMORY.is_dir() else None) as folder:
        flown, is_good = simulated(given.hours, given.seed, Path(folder))
    lines += [*flown, "", "## Real minutes", ""]
    flown, is_good_too = ["None were flown.", ""], True
    if given.minutes > 0.0:
        with TemporaryDirectory() as folder:
            flown, is_good_too = real(given.minutes, given.seed, given.busy, Path(folder))
    text = "\n".join([*lines, *flown]) + "\n"
    print(text)
    if given.write is not None:
        given.write.write_text(text, encoding="utf-8")
    return 0 if is_good and is_good_too else 1
