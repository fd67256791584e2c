"""What was found in a log, on the terminal."""

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from msp_lab.logs.importing import FoundRanger, Imported
from msp_range.terminal import console, plain_table
from msp_sim.page.text import counted, listed

MANY_REPEATS = 0.3
"""A larger share of repeated readings while they change is reported: in a log with two rows a reading it is a half."""
MOST_EFFECTS = 4
"""Most names of effects in a line; dataset.json has all."""


def show(found: Sequence[Imported], out: Path | None = None) -> None:
    """Print the account of an import; with the dataset's folder also how to go on."""
    terminal = console()
    for log in found:
        _show(terminal, log)
    if out is not None:
        runs = counted(sum(len(log.runs) for log in found), "run")
        rangers = [ranger for log in found for ranger in log.rangers]
        readings = sum(ranger.readings for ranger in rangers)
        if any(ranger.with_truth for ranger in rangers):
            then = f"'msp-lab gap {out} --model MODEL.yaml --out DIR' uses it"
        else:
            then = "without a true range there is nothing that 'msp-lab gap' could compare them with"
        terminal.print(f"{out}: {readings:,} readings in {runs}; {then}", soft_wrap=True)


def _show(terminal: Console, found: Imported) -> None:
    terminal.print(f"{found.file}: {found.form}, {found.duration_s:.0f} s", style="bold", soft_wrap=True)
    rows = [(ranger.name, ranger.source, _rate(ranger.rate_hz), _readings(ranger)) for ranger in found.rangers]
    rows += [
        (series.name, series.source, _rate(series.rate_hz), f"{series.samples:,} samples") for series in found.series
    ]
    terminal.print(plain_table(("found", "in the log", "rate", ""), rows, "llrl"))
    for line in _lines(found):
        terminal.print(line)


def _lines(found: Imported) -> list[str]:
    lines = [_truth(found)]
    for ranger in found.rangers:
        lines += [f"{ranger.name}: {line}" for line in _fit(ranger, found)]
    if usable := [f"{kind} ({source})" for kind, source in found.others.items() if kind not in found.refused]:
        lines.append(f"also in the log: {', '.join(usable)}")
    lines += [f"refused: {kind}: {found.others[kind]}" for kind in found.refused]
    for missing in found.missing:
        named = listed(missing.effects, MOST_EFFECTS)
        lines.append(f"missing: {missing.column}; without {missing.what} these effects cannot be found: {named}")
    return lines + [f"note: {note}" for note in found.notes]


def _truth(found: Imported) -> str:
    if not found.truth or found.truth == "none":
        others = ", but the range finders can be compared with each other: msp-lab gap --truth others"
        return "true range: none" + (others if sum(ranger.is_down for ranger in found.rangers) > 2 else "")
    source = f" ({found.truth_source})" if found.truth_source else ""
    ground = "" if found.has_datum else ", a height over level ground, whose constant is taken off"
    return f"true range: {found.truth}{source}{ground}"


def _fit(ranger: FoundRanger, found: Imported) -> list[str]:
    lines = []
    if ranger.lag_s is not None:
        lines.append(_lag(*ranger.lag_s, is_shifted=found.is_shifted))
    elif ranger.scatter_cm is not None:
        why = _why_no_lag(ranger.no_lag, ranger.scatter_cm, ranger.reference_span_cm)
        lines.append(f"its lag cannot be seen: {why}")
    if ranger.scatter_cm is not None and ranger.offset_cm is not None:
        constant = f"{ranger.offset_cm:+.1f} cm on average, " if found.has_datum else ""
        lines.append(f"{constant}differences to the reference scatter by {ranger.scatter_cm:.1f} cm, outliers left out")
    if ranger.reference_std_cm is not None:
        std_cm, low_cm, high_cm = ranger.reference_std_cm
        interval = f" ({low_cm:.1f} to {high_cm:.1f})" if high_cm > low_cm else ""
        lines.append(f"the reference's own error is {std_cm:.1f} cm{interval}, by {ranger.reference_std_from}")
    elif ranger.scatter_cm is not None:
        lines.append("the reference's own error is not known, so its scatter counts as the range finder's")
    if ranger.repeated > MANY_REPEATS:
        lines.append(
            f"{100.0 * ranger.repeated:.0f} % of the readings repeat the one before where they change by a centimetre "
            "a row: the log has more rows than there are readings"
        )
    return lines + list(ranger.notes)


def _lag(lag_s: float, low_s: float, high_s: float, *, is_shifted: bool) -> str:
    if lag_s < 0.0:
        ends = f"{-high_s:.3f} to {-low_s:.3f}"
        what = (
            "taken off" if is_shifted else "left in: so much later than the range finder is the reference, or its clock"
        )
        return f"{-lag_s:.3f} s earlier than the reference ({ends}), {what}"
    what = "taken off" if is_shifted else "left in: it is the range finder's latency if both have one clock"
    return f"{lag_s:.3f} s later than the reference ({low_s:.3f} to {high_s:.3f}), {what}"


def _why_no_lag(why: str, scatter_cm: float, span_cm: float | None) -> str:
    if span_cm is None:
        return why
    if span_cm >= scatter_cm:
        return f"{why}; the reference changes by {span_cm:.1f} cm, the readings scatter about it by {scatter_cm:.1f} cm"
    return (
        f"the reference changes by {span_cm:.1f} cm in all, and the readings differ from it by more. If they are "
        "right, the reference is not the distance that they measure"
    )


def _readings(ranger: FoundRanger) -> str:
    words = [f"{ranger.readings:,} readings"]
    if ranger.silent:
        words.append(f"{ranger.silent:,} without an answer")
    if ranger.too_near:
        words.append(f"{ranger.too_near:,} too near")
    if ranger.no_echo:
        words.append(f"{ranger.no_echo:,} without an echo within {ranger.maximum_cm:g} cm")
    if ranger.low_cm is not None:
        words.append(f"{ranger.low_cm:g} to {ranger.high_cm:g} cm")
    words.append(f"{ranger.with_truth:,} with a true range" if ranger.with_truth else "no true range")
    if not ranger.is_down:
        words.append("does not look down")
    return ", ".join(words)


def _rate(rate_hz: float | None) -> str:
    return "" if rate_hz is None else f"{rate_hz:.3g} Hz"
