"""False findings of the sensor watch in drawn hours, and how soon faults are found.

The hours are shared by ten kinds of ground. Each fault is drawn ``--flights`` times, five minutes into a flight.
For instance ``--hours 1000 --flights 100 --seed 2026``.
"""

import argparse
from statistics import median

import numpy as np
from numpy.random import Generator, default_rng

from evaluation.sensor_watch.drawn import Fault, Ground, draw, feed, watch_of

GROUNDS = {
    "level": Ground(),
    "rough, 3 cm, fast flight": Ground(rough_m=0.03),
    "rough, 3 cm, slow flight": Ground(rough_m=0.03, rough_lasts=0.8),
    "rough, 3 cm, hover": Ground(rough_m=0.03, rough_lasts=0.98),
    "slope of 6 deg": Ground(slope=0.1),
    "slope of 6 deg, a turn in 20 s, rough": Ground(slope=0.1, turn_s=20.0, rough_m=0.03, rough_lasts=0.8),
    "errors with a correlation of 0.5": Ground(correlation=0.5),
    "errors with a correlation of 0.9": Ground(correlation=0.9),
    "errors with a correlation of 0.9, rough": Ground(correlation=0.9, rough_m=0.03, rough_lasts=0.9),
    "all ranges 4 % too long": Ground(scale=1.04),
}
FROM_S = 300.0
FAULTS = {
    "10 % short": Fault(FROM_S, short=0.10),
    "20 % short": Fault(FROM_S, short=0.20),
    "20 % missed": Fault(FROM_S, missed=0.20),
    "deviation doubled": Fault(FROM_S, wider=2.0),
    "12 cm too long": Fault(FROM_S, shift_m=0.12),
}
PIECE_H = 2.0
"""Hours drawn at a time, for memory."""


def false_findings(draws: Generator, ground: Ground, hours: float) -> list[str]:
    """Texts of what is found of sensors in order."""
    watch = watch_of()
    texts = []
    for start_h in np.arange(0.0, hours, PIECE_H):
        piece = draw(draws, min(PIECE_H, hours - start_h), ground, start_s=3600.0 * start_h)
        texts += [finding.text for _, finding in feed(watch, piece)]
    return texts


def delays_s(draws: Generator, fault: Fault, flights: int) -> list[float]:
    """Times from the beginning of a fault to the first finding of its sensor [s]; infinity: none in five minutes."""
    found = []
    for _ in range(flights):
        flight = feed(watch_of(), draw(draws, 2.0 * FROM_S / 3600.0, Ground(), fault))
        times_s = [time_s - fault.from_s for time_s, finding in flight if finding.sensor == "a"]
        found.append(min([each for each in times_s if each >= 0.0], default=float("inf")))
    return found


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--hours", type=float, default=10.0, help="hours in all (default: %(default)s)")
    parser.add_argument("--flights", type=int, default=100, help="flights with each fault (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: %(default)s)")


def main(given: argparse.Namespace) -> None:
    """Draw, watch and print."""
    draws = default_rng(given.seed)
    print("| ground | hours | false findings |\n|---|---|---|")
    for name, ground in GROUNDS.items():
        hours = given.hours / len(GROUNDS)
        texts = false_findings(draws, ground, hours)
        print(f"| {name} | {hours:g} | {len(texts)} {', '.join(texts)} |", flush=True)
    print("\n| fault of one sensor | median time to a finding | 10 % to 90 % |\n|---|---|---|")
    for name, fault in FAULTS.items():
        delays = delays_s(draws, fault, given.flights)
        early_s, late_s = np.quantile(delays, [0.1, 0.9])
        print(f"| {name} | {median(delays):.0f} s | {early_s:.0f} to {late_s:.0f} s |", flush=True)
