"""A sensor model for programs and notebooks: files of readings give findings and the model as dictionaries."""

import json
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from msp_lab.characterise.analysis import Characterisation
from msp_lab.characterise.findings import as_json
from msp_lab.characterise.sensors import characterised
from msp_lab.readings.from_files import Columns, Files, map_options, paths_of
from msp_range.clock import SystemClock, date_of
from msp_range.yaml_file import config_path


def characterise(
    files: Files,
    sensor: Path | str = "mb1242",
    *,
    columns: Columns | None = None,
    out: Path | str | None = None,
    seed: int = 1,
) -> dict[str, Any]:
    """Make a sensor model from readings at known ranges, as ``msp-lab characterise`` does.

    Parameters
    ----------
    files
        Readings with true ranges.
    sensor
        The model to start from: limits, codes, and what the readings do not determine.
    columns
        Where another table's columns are.
    out
        File for the new sensor model, which must not exist; None: none is written.
    seed
        Random seed of the goodness-of-fit test.

    Returns
    -------
    dict
        ``findings``: what was found, as in the findings.json of a report; ``model``: the new sensor model.

    Raises
    ------
    UserError
        The readings or files cannot be used; in a line, with what to do.

    Examples
    --------
    >>> import numpy as np
    >>> from tempfile import TemporaryDirectory
    >>> from msp_range.recording.csv_form import write_csv
    >>> rng = np.random.default_rng(1)
    >>> true_cm = np.repeat([50.0, 150.0, 250.0, 350.0], 40)
    >>> reading_cm = np.round(true_cm + 2.0 + rng.normal(0.0, 1.0, true_cm.size))
    >>> folder = TemporaryDirectory()
    >>> table = Path(folder.name, "bench.csv")
    >>> columns = {"time_s": np.arange(160.0), "sensor": np.full(160, "mine")}
    >>> write_csv(table, {**columns, "reading_cm": reading_cm, "true_range_cm": true_cm})
    >>> found = characterise(table)
    >>> round(found["model"]["reading_model"]["sigma_cm"])
    1
    >>> folder.cleanup()
    """
    start, today = config_path(sensor, "sensors"), date_of(SystemClock().utc())
    how = Characterisation(tuple(paths_of(files)), start, map_options(columns), "recorded", today, seed)
    with threadpool_limits(limits=1):
        made = characterised(how)
    if out is not None:
        made.write(Path(out))
    return {"findings": json.loads(as_json(made.findings)), "model": made.model.model_dump(mode="json")}
