"""Gap closed, in per cent, by a classifier and by KS: held-out readings against what `msp-sim sample` draws.

A table of readings, a model before and a model after enter. Simulated readings at the measured contexts are drawn by
the command, and what two draws of the model after differ by is the noise floor that is taken off.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from evaluation.closure.measures import ks_by_slice, separability
from evaluation.closure.table import Table, comparable, step_of, table_of
from evaluation.csv_form import read_form, write_form
from evaluation.real.commands import run_command

DRAWS = 3
"""Of each model. The noise floor is their scatter among themselves; with three its mean is known to a third or so."""

SURE = 4.0
"""A gap before counts if it is so many times the scatter of the noise floor above it: below that a per cent of it means
nothing."""

LEAST_NATS, LEAST_KS = 0.002, 0.0005
"""And at least so large: 0.002 nats are a bias of 0.1 sigma, as a classifier that knew all would see it."""


@dataclass(frozen=True)
class OneMeasure:
    """One measure before and after, the noise floor taken off."""

    before: float
    after: float
    """Nats per reading, or mean square KS distance."""
    floor: float
    """What two draws of one model differ by."""
    closed_pct: float | None
    """Per cent of `before` that is gone; None where `before` does not stand out of the noise floor."""


@dataclass(frozen=True)
class Closure:
    """Gap closed by both measures."""

    rows: int
    held_out: bool
    """Readings that were compared; whether they are those of held-out runs, or all."""
    step_cm: float
    """Both are compared on this step, the coarser of theirs; 0 is none."""
    classifier: OneMeasure
    ks: OneMeasure
    """The two measures."""
    auc_before: float
    auc_after: float
    """Of the classifier."""

    @property
    def closed_pct(self) -> float | None:
        """Gap closed: the smaller of the two measures' figures; None where neither saw a gap before."""
        both = [each.closed_pct for each in (self.classifier, self.ks) if each.closed_pct is not None]
        return min(both, default=None)


def gap_closed(
    readings: Sequence[Path], before: Path, after: Path, held_out_runs: Sequence[str] = (), seed: int = 1
) -> Closure:
    """Compare measured readings with draws of two models.

    Parameters
    ----------
    readings
        Tables in the CSV form.
    before, after
        Model files: as given, and extended.
    held_out_runs
        Runs to compare on. Where no row is of them (blocks stood in for runs), all rows are compared.
    seed
        Of draws, folds and classifier.

    Raises
    ------
    RuntimeError
        `msp-sim sample` failed.
    """
    tables = [comparable(read_form(path), path.stem) for path in readings]
    cells = {name: [cell for table in tables for cell in table[name]] for name in tables[0]}
    kept = np.isin(cells["run"], list(held_out_runs))
    held_out = bool(kept.any())
    if held_out:
        cells = {
            name: [cell for cell, keep in zip(column, kept, strict=True) if keep] for name, column in cells.items()
        }
    measured = table_of(cells)
    with TemporaryDirectory() as folder:
        draws_before = draw(cells, before, Path(folder), [100 * seed + k for k in range(DRAWS)])
        draws_after = draw(cells, after, Path(folder), [100 * seed + 50 + k for k in range(DRAWS)])
    step = max(step_of(measured.reading_cm), *(step_of(each.reading_cm) for each in (*draws_before, *draws_after)))
    measured = measured.of_step(step)
    draws_before, draws_after = ([each.of_step(step) for each in draws] for draws in (draws_before, draws_after))
    separable_before = [separability(measured, each, seed) for each in draws_before]
    separable_after = [separability(measured, each, seed) for each in draws_after]
    pairs = [(draws_after[k], draws_after[(k + 1) % DRAWS]) for k in range(DRAWS)]
    classifier = one_measure(
        [each.nats for each in separable_before],
        [each.nats for each in separable_after],
        [separability(*pair, seed).nats for pair in pairs],
        LEAST_NATS,
    )
    ks = one_measure(
        [ks_by_slice(measured, each) for each in draws_before],
        [ks_by_slice(measured, each) for each in draws_after],
        [ks_by_slice(*pair) for pair in pairs],
        LEAST_KS,
    )
    auc_before, auc_after = (
        float(np.mean([each.auc for each in results])) for results in (separable_before, separable_after)
    )
    return Closure(measured.reading_cm.size, held_out, step, classifier, ks, auc_before, auc_after)


def draw(cells: dict[str, list[str]], model: Path, folder: Path, seeds: Sequence[int]) -> list[Table]:
    """Readings of a model at measured contexts, by `msp-sim sample`."""
    contexts = folder / "contexts.csv"
    write_form(contexts, {name: column for name, column in cells.items() if name != "reading_cm"})
    drawn = []
    for seed in seeds:
        out = folder / f"{model.stem}-{seed}.csv"
        done = run_command("msp-sim", "sample", model, "--contexts", contexts, "--out", out, "--seed", seed)
        if done.returncode != 0:
            raise RuntimeError(f"msp-sim sample {model}: {done.stderr.strip()[-300:]}")
        drawn.append(table_of(cells | {"reading_cm": read_form(out)["reading_cm"]}))
    return drawn


def one_measure(before: Sequence[float], after: Sequence[float], floor: Sequence[float], least: float) -> OneMeasure:
    """Take the noise floor off, and report how much is gone.

    Examples
    --------
    >>> one_measure([0.11, 0.11], [0.02, 0.02], [0.01, 0.01], 0.002).closed_pct
    90.0
    >>> one_measure([0.011, 0.01], [0.01, 0.01], [0.01, 0.01], 0.002).closed_pct is None
    True
    """
    level = float(np.mean(floor))
    sure = max(least, SURE * float(np.std(floor)))
    gap = float(np.mean(before)) - level
    left = max(float(np.mean(after)) - level, 0.0)
    return OneMeasure(gap, left, level, round(100.0 * (1.0 - left / gap), 6) if gap > sure else None)


def case_closed(folder: Path, before: Path, seed: int = 1) -> Closure:
    """The same for a folder with `measured.csv` and the workflow's `gap`, such as a case of the blind tables.

    Parameters
    ----------
    folder
        Of the case; `gap` was run at least to its step `add`.
    before
        Model that the workflow was given.
    seed
        As above.
    """
    gap = json.loads((folder / "gap" / "gap.json").read_text(encoding="utf-8"))
    return gap_closed([folder / "measured.csv"], before, folder / "gap" / "model.yaml", gap["held_out_runs"], seed)


def describe(found: Closure) -> str:
    """A line of text."""

    def line(one: OneMeasure) -> str:
        return f"{one.before:.4f} to {one.after:.4f} ({percent(one.closed_pct)})"

    def percent(value: float | None) -> str:
        return "no gap before" if value is None else f"{value:.0f} %"

    rows = f"{found.rows} {'held-out ' if found.held_out else ''}readings, step {found.step_cm:g} cm"
    return (
        f"gap closed {percent(found.closed_pct)} ({rows}); classifier {line(found.classifier)}, "
        f"AUC {found.auc_before:.3f} to {found.auc_after:.3f}; KS {line(found.ks)}"
    )
