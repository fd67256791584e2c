"""Picture of the calibration and its linearity."""

from collections.abc import Iterator

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.draw.accuracy import draw_linearity
from msp_lab.characterise.page.picture_data import Absent, Drawn, Entry, PictureData
from msp_lab.characterise.page.text import interval, sentence


def entries() -> Iterator[Entry]:
    """Yield the picture."""
    yield "calibration", "Calibration and linearity", _calibration


def _calibration(findings: Findings, rows: PictureData) -> Drawn:
    found = findings.calibration
    if found is None or not found.true_cm:
        raise Absent(sentence(findings.absent.get("calibration", "the readings were not compared with a reference")))
    caption = f"Mean error {interval(found.bias)}"
    if found.offset is not None and found.scale is not None:
        caption += f"; straight line: offset {interval(found.offset)}, scale {interval(found.scale)}"
    if found.linearity is not None:
        caption += f"; farthest from it {interval(found.linearity)}"
        if found.linearity_noise_floor_cm is not None:
            caption += f" (noise floor {found.linearity_noise_floor_cm:.2f} cm)"
    caption += f". Spread {interval(found.spread)}; resolution {found.resolution.value:g} cm. {sentence(found.reason)}"
    return Drawn(draw_linearity(found), caption, "Mean error over true range with the calibration.")
