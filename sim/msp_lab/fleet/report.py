"""Files of a fleet: the page with its picture, the table, and all numbers."""

from pathlib import Path

from msp_lab.fleet.findings import FleetEffect, FleetFindings
from msp_lab.fleet.pictures import draw_fleet
from msp_lab.fleet.words import left_out_line, line_of
from msp_range.input_file import making
from msp_range.yaml_file import ConfigError
from msp_sim.page.page import pictures_of, write_page
from msp_sim.page.table import PageTable
from msp_sim.page.text import p_text

NUMBERS, TABLE = "fleet.json", "fleet.csv"
CAPTION = (
    "A row for each sensor: the thin line is the 95 % interval of its own readings, point and thick line are its "
    "estimate drawn towards the fleet's mean. Grey: the fleet's mean, and two standard deviations between vehicles. "
    "Red squares are odd ones out. Of a change: the number in each session of the vehicle, and a red line where it "
    "changed."
)


def write_files(findings: FleetFindings, folder: Path) -> list[Path]:
    """Write the page, its picture, and the numbers as JSON and CSV; older files of these names are replaced.

    Raises
    ------
    ConfigError
        A file cannot be written.
    """
    pictures = pictures_of([("fleet", "", lambda: (draw_fleet(findings), CAPTION))])
    numbers = [_table(effect, k) for k, effect in enumerate(findings.shown, start=1) if not effect.sessions]
    page = write_page(
        folder,
        f"{__package__}/fleet.html",
        pictures,
        [_summary(findings), *numbers],
        findings=findings,
        lines=[line_of(effect, findings) for effect in findings.effects[: findings.found]],
        left_out=left_out_line(findings),
    )
    try:
        for name, text in ((NUMBERS, findings.as_json()), (TABLE, findings.as_csv())):
            with making(folder / name, replacing=True) as unfinished:
                unfinished.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{folder}: the findings cannot be written: {error.strerror}") from None
    return [page, folder / TABLE, folder / NUMBERS]


def _summary(findings: FleetFindings) -> PageTable:
    rows = [
        (
            effect.kind,
            effect.name.replace("_", " "),
            f"{effect.parameter}{effect.unit_label}",
            "" if effect.mean is None else f"{effect.mean:.3g} ({effect.low:.3g} to {effect.high:.3g})",
            f"{effect.tau:.3g}" if effect.mean is not None else "",
            f"{100.0 * effect.i2:.0f} %" if effect.mean is not None else "",
            ", ".join(f"{estimate.vehicle} {estimate.sensor} {estimate.value:.3g}" for estimate in effect.odd),
        )
        for effect in findings.shown
    ]
    header = ("finding", "effect", "parameter", "fleet's mean (95 %)", "between vehicles", "I²", "odd ones out")
    caption = "Mean and standard deviation between the ordinary vehicles; I² is how much of the scatter that is."
    return PageTable("summary", "What was found", header, tuple(rows), caption, align="lllr")


def _table(effect: FleetEffect, k: int) -> PageTable:
    rows = [
        (
            one.vehicle,
            one.sensor,
            "odd" if one.odd else "",
            f"{one.value:.3g} ± {one.error:.2g}",
            f"{one.shrunk:.3g} ({one.low:.3g} to {one.high:.3g})",
            p_text(one.p_value),
        )
        for one in effect.estimates
    ]
    header = ("vehicle", "sensor", "", "own readings", "with the fleet's (95 %)", "p of deviation")
    shape = "".join(f", {name} {value:g}" for name, value in effect.shape)
    title = f"{effect.name.replace('_', ' ')}: {effect.parameter}{effect.unit_label}{shape}"
    return PageTable(f"number-{k}", title, header, tuple(rows), align="lllr")
