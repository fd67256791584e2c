"""Names of runs: each file's runs are kept apart from those of the other files.

A run is what was recorded in one go; times of different runs do not compare, and for the gap workflow the run is the
unit of evidence. Tables get a column `run` by the names of their files.
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from msp_range.arrays import Texts
from msp_range.recording.csv_form import MeasuredData
from msp_range.yaml_file import ConfigError


def file_names(paths: Sequence[Path]) -> list[str]:
    """Return a name for each file: its own, with as many of its folders as it takes to distinguish it.

    Examples
    --------
    >>> file_names([Path("/flights/1/flight.mcap"), Path("/flights/2/flight.mcap")])
    ['1/flight', '2/flight']
    """
    parts = [(*path.resolve().parts[1:-1], path.name.split(".")[0]) for path in paths]
    for depth in range(1, max((len(part) for part in parts), default=0) + 1):
        names = ["/".join(part[-depth:]) for part in parts]
        if len(set(names)) == len(names):
            return names
    return [path.name for path in paths]


def runs_of(
    tables: Sequence[MeasuredData], paths: Sequence[Path], run_column: str | None = None
) -> tuple[list[Texts], list[str]]:
    """Return the run of each row, table by table, and messages about runs that were renamed.

    Rows without a run, and those whose run has the file's own name, are a run with the name from `file_names`. A name
    that occurs in several files is a run in each of them: recordings that were exported are all called after their
    recording, often ``flight``.

    Parameters
    ----------
    tables, paths
        What each file holds, and where it is.
    run_column
        The column that distinguishes runs, across all files; None: `run`.

    Raises
    ------
    ConfigError
        There is no such column.
    """
    if run_column is not None:
        return [_words_of(table, path, run_column) for table, path in zip(tables, paths, strict=True)], []
    files = file_names(paths)
    runs = [_own_runs(table, path, name) for table, path, name in zip(tables, paths, files, strict=True)]
    counts = Counter(run for column in runs for run in np.unique(column).tolist())
    shared = [run for run, count in counts.items() if count > 1]
    if shared:
        runs = [
            np.where(np.isin(column, shared), np.char.add(f"{name}/", column), column)
            for column, name in zip(runs, files, strict=True)
        ]
    messages = [f"The run {run!r} is in {counts[run]} files and counts as {counts[run]} runs." for run in shared[:5]]
    if len(shared) > 5:
        messages.append(f"So do {len(shared) - 5} more names of runs.")
    return runs, messages


def _own_runs(table: MeasuredData, path: Path, name: str) -> Texts:
    if "run" not in table:
        return np.full(len(table), name)
    # A recording calls its run by its file's name.
    of_file = (table["run"] == "") | (table["run"] == path.name.split(".")[0])
    return np.where(of_file, name, table["run"])


def _words_of(table: MeasuredData, path: Path, run_column: str) -> Texts:
    if run_column not in table:
        raise ConfigError(f"--run-column {run_column}: {path} has the columns {', '.join(table.columns)}")
    column = table[run_column]
    return np.array([f"{value:g}" for value in column.tolist()]) if column.dtype.kind in "fiub" else column
