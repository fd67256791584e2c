"""Compares what the workflow named with what was hidden.

An outcome is a word: ``exact`` (each hidden effect is held by the class of one named effect, a name and those that the
workflow cannot separate from it, and nothing else is named), ``calibrated`` (an effect that the base mixture has too is
reported as a change of the base's number, and nothing else is named), ``nothing``, ``missing`` (some, and nothing
wrong), ``wrong name``, ``crash``; for nulls ``clean`` or ``wrong name``; for unknown effects ``exact`` (a curve of the
right channel over the right column, and no name), ``other curve``, ``nothing``, ``wrong name``.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np

from evaluation.shares import share_of

BASE_NUMBERS = {
    "spread_with_range": "sigma_growth_cm_per_m",
    "missed_with_range": "missed_growth_per_m",
    "range_scale": "calibration.scale",
}
"""Effects that the base mixture has too, and its number, as `msp-lab effects` lists them."""

TIME_COLUMNS = frozenset({"time_s", "elapsed_s", "time_in_run_s"})
"""Columns that are the time in the run; what a curve over one of them is called is the workflow's choice."""


def outcome(truth: dict[str, Any], found: dict[str, Any]) -> str:
    """Score one case.

    Parameters
    ----------
    truth
        What `generator.case` hid.
    found
        What `workflow.run_case` read from the workflow's files.
    """
    if found["crash"]:
        return "crash"
    named = names_of(found)
    if not truth["effects"]:
        return "wrong name" if named else "clean" if not found["curves"] else "other curve"
    if truth["kind"].startswith("unknown"):
        return _unknown(truth["effects"][0], named, found["curves"])
    wanted = [set(effect["names"]) for effect in truth["effects"]]
    right = matched(wanted, named)
    if right < len(named):
        return "wrong name"
    if right == len(wanted):
        return "exact" if not found["curves"] else "other curve"
    if right:
        return "missing"
    changed = {number for item in found["calibration"] for number in BASE_NUMBERS.values() if number in item}
    equal = {BASE_NUMBERS[name] for names in wanted for name in names if name in BASE_NUMBERS}
    if len(wanted) == 1 and equal & changed:
        return "calibrated"
    return "other curve" if found["curves"] else "nothing"


def names_of(found: dict[str, Any]) -> list[set[str]]:
    """The class of each named effect: its name, and those that the workflow cannot separate from it."""
    return [{each["name"], *each["alternatives"]} for each in found["effects"]]


def in_words(found: dict[str, Any]) -> list[str]:
    """Named effects and curves, as words."""
    return [" or ".join([each["name"], *each["alternatives"]]) for each in found["effects"]] + [
        f"curve of {each['channel']} over {' '.join(each['variables'])}" for each in found["curves"]
    ]


def all_in_words(found: dict[str, Any]) -> str:
    """All that the workflow found, or what ended it, as words."""
    words = in_words(found) + [f"calibration: {each}" for each in found["calibration"]]
    return "; ".join([*words, *filter(None, [found["crash"]])]) or "nothing"


def matched(wanted: list[set[str]], named: list[set[str]]) -> int:
    """Most hidden effects that can each be given a named one of their own (there are three at most)."""
    if not wanted:
        return 0
    first, rest = wanted[0], wanted[1:]
    best = matched(rest, named)
    for index, names in enumerate(named):
        if names & first:
            best = max(best, 1 + matched(rest, named[:index] + named[index + 1 :]))
    return best


def _unknown(effect: dict[str, Any], named: list[set[str]], curves: list[dict[str, Any]]) -> str:
    if named:
        return "wrong name"
    for curve in curves:
        columns = set(curve["variables"])
        right = columns & TIME_COLUMNS if effect["variable"] == "time_s" else columns & {effect["variable"]}
        channel = curve["channel"] == effect["channel"] or (
            curve["channel"] == "time" and effect["variable"] == "time_s"
        )
        if right and channel:
            return "exact"
    return "other curve" if curves else "nothing"


def table(results: Iterable[dict[str, Any]]) -> str:
    """A Markdown table of the outcomes by kind, and what was hidden and found where it was not right.

    Effects that vary between runs only have rows of their own.
    """
    rows: dict[str, list[dict[str, Any]]] = {}
    for result in results:
        effects = result["truth"]["effects"]
        own = " (between runs)" if any(effect["between_runs"] for effect in effects) else ""
        rows.setdefault(result["truth"]["kind"] + own, []).append(result)
    lines = [
        "| kind | cases | right | share (95 %) | wrong name (95 %) | calibrated | missing or nothing | other curve "
        "| crash | mean class |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for kind, each in sorted(rows.items()):
        words = [outcome(result["truth"], result["found"]) for result in each]
        count = len(words)
        right = sum(word in ("exact", "clean") for word in words)
        wrong = words.count("wrong name")
        sizes = [1 + len(effect["alternatives"]) for result in each for effect in result["found"]["effects"]]
        lines.append(
            f"| {kind} | {count} | {right} | {share_of(right, count)} | {share_of(wrong, count)} "
            f"| {words.count('calibrated')} "
            f"| {words.count('missing') + words.count('nothing')} | {words.count('other curve')} "
            f"| {words.count('crash')} | {np.mean(sizes) if sizes else 0:.1f} |"
        )
    return "\n".join(lines)


def failures(results: Iterable[dict[str, Any]]) -> str:
    """One line for each case that is not right: what was hidden, and what the workflow reported."""
    lines = []
    for result in results:
        truth, found = result["truth"], result["found"]
        word = outcome(truth, found)
        if word in ("exact", "clean"):
            continue
        hidden = ", ".join(f"{effect['title']} {effect['size']:.3g}" for effect in truth["effects"]) or "nothing"
        base = f"correlation {truth['base']['correlation']:.2f}, {truth['runs']} runs"
        lines.append(
            f"{truth['kind']} {truth['seed']}: {word}; hidden {hidden}; "
            f"{base}; found {all_in_words(found)}; {found['verdict']}"
        )
    return "\n".join(lines)
