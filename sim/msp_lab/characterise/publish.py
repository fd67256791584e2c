"""The files of a characterisation next to the sensor model: all its numbers, and the page.

Findings enter, files leave; none is overwritten.
"""

from pathlib import Path

from msp_lab.characterise.findings import Findings, as_json
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData
from msp_range.yaml_file import ConfigError

NUMBERS = "findings.json"
PAGE = "report.html"


def check_free(out: Path, folder: Path | None) -> None:
    """Check before the analysis that its files can be written.

    Raises
    ------
    ConfigError
        One of the files exists, its folder cannot be created, or is the model file.
    """
    if folder is not None and out in (folder, *folder.parents):
        raise ConfigError(f"--report {folder}: {out} is to be the model file, expected another name for the folder")
    taken = [out, *([] if folder is None else [folder / NUMBERS, folder / PAGE])]
    for path in taken:
        if path.exists():
            there = "folder" if path.is_dir() else "file"
            raise ConfigError(f"{path}: there is a {there} already, and none is overwritten")
        for parent in path.parents:
            if parent.exists() and not parent.is_dir():
                raise ConfigError(f"{path}: {parent} is a file, expected a folder")


def publish_findings(findings: Findings, data: MeasuredData, model: SensorModel, folder: Path) -> Path:
    """Write the numbers and the page, and return the page.

    Raises
    ------
    ConfigError
        The folder cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / NUMBERS).open("x", encoding="utf-8") as file:
            file.write(as_json(findings))
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written: {error.strerror}") from None
    from msp_lab.characterise.page.write import write_report

    return write_report(findings, data, model, folder)
