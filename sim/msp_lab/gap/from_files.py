"""The gap workflow for programs and notebooks: files of readings give the content of ``gap.json``."""

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from threadpoolctl import threadpool_limits

from msp_lab.gap.findings import LastStep, Settings
from msp_lab.gap.findings_file import as_json
from msp_lab.gap.steps import Steps
from msp_lab.readings.from_files import Columns, Files, map_options, paths_of
from msp_range.clock import SystemClock
from msp_range.yaml_file import config_path


def find_gap(
    files: Files,
    model: Path | str = "mb1242",
    *,
    columns: Columns | None = None,
    out: Path | str | None = None,
    until: LastStep = "add",
    seed: int = 1,
) -> dict[str, Any]:
    """Find where readings and a sensor model disagree and what the model is missing, as ``msp-lab gap`` does.

    Parameters
    ----------
    files
        Readings with true ranges, best of four runs or more.
    model
        The sensor model to compare with.
    columns
        Where another table's columns are.
    out
        Folder for ``gap.json``, the extended model.yaml and with ``until="show"`` the page; None: nothing is kept.
    until
        The last step: compare, name what is missing, add it to the model, show it as a page with pictures.
    seed
        Random seed.

    Returns
    -------
    dict
        The content of ``gap.json``: `gap` in its measures, `effects` that were named, `plain` sentences.

    Raises
    ------
    UserError
        The readings or files cannot be used; in a line, with what to do.

    Examples
    --------
    >>> import numpy as np
    >>> from msp_range import ReadingModel
    >>> from msp_range.recording.csv_form import write_csv
    >>> sensor = ReadingModel.of("mb1242")
    >>> rng = np.random.default_rng(1)
    >>> true_cm = rng.uniform(40.0, 400.0, 2000)
    >>> reading_cm = sensor.sample({"true_range_cm": true_cm}, rng) + 4.0
    >>> folder = TemporaryDirectory()
    >>> table = Path(folder.name, "readings.csv")
    >>> columns = {"time_s": np.arange(2000.0), "sensor": np.full(2000, "mine"), "run": np.repeat([*"abcdefgh"], 250)}
    >>> write_csv(table, {**columns, "reading_cm": reading_cm, "true_range_cm": true_cm})
    >>> found = find_gap(table, until="compare")
    >>> found["gap"]["bias_cm"]["before"] > 3.0
    True
    >>> folder.cleanup()
    """
    settings = Settings(str(config_path(model, "sensors")), seed=seed, map=map_options(columns))
    with TemporaryDirectory() as kept_nowhere, threadpool_limits(limits=1):
        steps = Steps(Path(kept_nowhere if out is None else out), SystemClock(), lambda what, share: None)
        return dict(json.loads(as_json(steps.all(paths_of(files), settings, until))))
