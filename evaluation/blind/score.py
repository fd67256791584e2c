"""What a gap workflow reported of one blind table, against what was hidden.

A `gap.json` and an answer enter, an outcome leaves. Nothing but the answer and `names.csv` is asked: which name stands
for which mechanism was written down before any table was scored.
"""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

NAMES = Path(__file__).parent / "names.csv"

IN_THE_BASE = {
    "spread_with_range": "sigma_growth_cm_per_m",
    "missed_with_range": "missed_growth_per_m",
    "range_scale": "calibration.scale",
}
"""Names that the base model has a parameter for: reported as a calibration, they are reported."""


def accepted_names(path: Path = NAMES) -> dict[str, frozenset[str]]:
    """Catalogue names by mechanism."""
    with path.open(encoding="utf-8", newline="") as file:
        return {row["mechanism"]: frozenset(row["names"].split()) for row in csv.DictReader(file)}


SEPARABLE = 3.0
"""Standard errors between two names: from there on they must be separated."""


@dataclass(frozen=True)
class Closed:
    """Share of the gap in nats per reading that is closed on the held-out runs."""

    over_floor: float | None
    """Of the excess over the noise floor (which 95 % of simulated replicates stay below); None where the gap was below
    it to begin with."""
    of_all: float | None
    """Of the whole gap. Random variation is subtracted in the mean only: on 2000 readings it scatters by about 0.003
    nats, and what is left by that scatter counts as not closed. None where there was no gap."""


@dataclass(frozen=True)
class Outcome:
    """How one table went."""

    exact: bool
    """All that was hidden is named, and nothing else is reported. A class of names counts if it holds the right one and
    none that the data could separate from it."""
    named: bool
    """Something from the catalogue is named."""
    unknown: bool
    """Something is called unknown."""
    wrong: tuple[str, ...]
    """Names that stand for nothing hidden."""
    met: tuple[bool, ...]
    """For each thing hidden, in order: it is named."""
    separable: tuple[str, ...]
    """Alternatives in a class with a right name that stand `SEPARABLE` standard errors or more from it."""
    found_unknown: bool
    """Called unknown, with the right channel and variable, and no wrong name with it."""
    resolved_wrongly: bool
    """Names are given, and what is hidden is among none of them. A wrong name next to the right one is `wrong`."""
    both: bool
    """Of a confounded pair: both are in one class, and the experiment that would separate them is named."""
    class_sizes: tuple[int, ...]
    """Of the names given: how many each stands with."""
    reported: tuple[str, ...]
    """All that was reported, as words."""
    closed: Closed | None = None
    """Of the gap; None where nothing was added."""


def judge(answer: Mapping[str, Any], gap: Mapping[str, Any], names: Mapping[str, frozenset[str]]) -> Outcome:
    """Compare one answer with one `gap.json`."""
    reported = [each for each in gap.get("effects", ()) if each.get("verdict") in ("named", "indistinguishable")]
    classes = [_class(each) for each in reported]
    calibrated = " ".join(_words(gap.get("calibration", ())))
    unknown = list(gap.get("unknown", ()))
    wanted = [names.get(each["mechanism"], frozenset()) for each in answer["hidden"]]
    free = list(range(len(classes)))
    met, in_base, separable = [], [], []
    for hidden, accepted in zip(answer["hidden"], wanted, strict=True):
        match = next((k for k in free if classes[k] & accepted), None)
        if match is not None:
            free.remove(match)
            separable += _separable(reported[match], accepted, _standard_errors(hidden))
        elif any(words := [word for name in accepted if (word := IN_THE_BASE.get(name, "-")) in calibrated]):
            in_base += words
        met.append(match is not None or any(IN_THE_BASE.get(name, "-") in in_base for name in accepted))
    wrong = tuple(sorted(str(reported[k]["name"]) for k in free))
    found_unknown = any(_fits(each, entry) for each in answer["hidden"] for entry in unknown)
    pair = [names[each] for each in answer.get("pair", ())]
    both = any(
        each.get("experiment") and pair and all(one & accepted for accepted in pair)
        for one, each in zip(classes, reported, strict=True)
    )
    return Outcome(
        exact=all(met) and all(wanted) and not wrong and not unknown and not separable,
        named=bool(reported),
        unknown=bool(unknown),
        wrong=wrong,
        met=tuple(met),
        separable=tuple(separable),
        found_unknown=found_unknown and not wrong,
        resolved_wrongly=bool(classes) and not any(each & accepted for accepted in wanted for each in classes),
        both=both,
        class_sizes=tuple(len(each) for each in classes),
        reported=(
            *(
                "/".join([str(each["name"]), *sorted(one - {each["name"]})])
                for one, each in zip(classes, reported, strict=True)
            ),
            *(f"unknown {each.get('channel')} of {' and '.join(each.get('variables', ()))}" for each in unknown),
            *sorted(set(in_base)),
        ),
        closed=_closed(gap),
    )


def _separable(effect: Mapping[str, Any], accepted: frozenset[str], standard_errors: float) -> list[str]:
    """Alternatives too far from the name to be in a class with it, as is one without a reported correlation.

    How large the effect is, is the answer's; the correlation is what the workflow reports.
    """
    if effect.get("verdict") != "indistinguishable":
        return []
    return [
        str(each["name"])
        for each in effect.get("alternatives", ())
        if not {each["name"], effect["name"]} <= accepted
        and standard_errors * math.sqrt(max(1.0 - (each.get("correlation") or 0.0) ** 2, 0.0)) >= SEPARABLE
    ]


def _standard_errors(hidden: Mapping[str, Any]) -> float:
    """Of what is hidden; 0, with which nothing must be separated, where the answer does not state it."""
    return float(hidden.get("standard_errors", hidden.get("wanted", 0.0)))


def _closed(gap: Mapping[str, Any]) -> Closed | None:
    nats = (gap.get("gap") or {}).get("nats_per_reading") or {}
    before, after, floor = (nats.get(key) for key in ("before", "after", "noise_floor"))
    if before is None or after is None or floor is None:
        return None
    return Closed(
        1.0 - max(after - floor, 0.0) / (before - floor) if before > floor else None,
        1.0 - max(after, 0.0) / before if before > 0.0 else None,
    )


def _class(effect: Mapping[str, Any]) -> frozenset[str]:
    alternatives = [each["name"] for each in effect.get("alternatives", ())]
    return frozenset(
        {effect["name"], *alternatives} if effect.get("verdict") == "indistinguishable" else {effect["name"]}
    )


def _fits(hidden: Mapping[str, Any], entry: Mapping[str, Any]) -> bool:
    """The right channel, and a variable of those that it depends on; all of them where it takes two."""
    variables = set(entry.get("variables", ()))
    return (
        bool(hidden.get("channel"))
        and hidden["channel"] == entry.get("channel")
        and set(hidden["variables"]) <= variables
    )


def _words(values: Any) -> Iterable[str]:
    if isinstance(values, str):
        yield values
    elif isinstance(values, Mapping):
        for key, value in values.items():
            yield str(key)
            yield from _words(value)
    elif isinstance(values, Sequence):
        for value in values:
            yield from _words(value)
