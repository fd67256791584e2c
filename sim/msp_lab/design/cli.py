"""The command of msp-lab that designs an experiment."""

from pathlib import Path
from typing import Annotated

import typer

from msp_range.extras import require

app = typer.Typer()

DESIGN = """Find out what a gap run could not decide, and what is missing to decide it.

Reads gap.json of DIR, the folder of 'msp-lab gap'. Example:

  msp-lab gap flights/*.csv --model mb1242.yaml --out gaps/june

  msp-lab design gaps/june
"""


def _design(
    gap: Annotated[Path, typer.Argument(metavar="GAP_DIR", help="folder that 'msp-lab gap' made")],
) -> None:
    require("lab", "msp-lab design")
    from msp_lab.design.questions import open_questions
    from msp_lab.design.show import print_questions
    from msp_lab.gap.findings import read_findings

    print_questions(open_questions(read_findings(gap), gap))


app.command("design", help=DESIGN)(_design)
