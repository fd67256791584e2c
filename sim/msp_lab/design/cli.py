"""The command of msp-lab that designs an experiment."""

from pathlib import Path
from typing import Annotated

import typer

from msp_range.extras import require
from msp_sim.cli import OwnEffects, Seed

app = typer.Typer()


def _design(
    gap: Annotated[Path, typer.Argument(metavar="GAP_DIR", help="folder that 'msp-lab gap' made")],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="folder for the files; default: GAP_DIR/design")
    ] = None,
    bench: Annotated[
        bool | None,
        typer.Option("--bench/--flight", help="only at a bench, or only in flight; default: the cheaper one"),
    ] = None,
    max_minutes: Annotated[
        float, typer.Option(min=1.0, help="longest session, setting up and waiting for other weather included")
    ] = 240.0,
    power: Annotated[
        float, typer.Option(min=0.5, max=0.999, help="probability that the right answer is named, whichever it is")
    ] = 0.95,
    sessions: Annotated[int, typer.Option(min=0, max=10_000, help="sessions to simulate per question; 0: none")] = 20,
    airframe: Annotated[str, typer.Option(metavar="AIRFRAME.yaml", help="vehicle that flies")] = "quad_pallet",
    seed: Seed = 1,
    force: Annotated[bool, typer.Option("--force", help="replace an earlier design in --out")] = False,
    effects: OwnEffects = None,
) -> None:
    """Design the cheapest bench or flight session that decides what a gap run left open.

    Reads GAP_DIR, the folder of 'msp-lab gap', and the readings and the model that it names. For each open question it
    says which contexts to vary, in how many runs of how many readings, how long that takes, and how probable it is that
    the right answer is found; then the simulator holds the session and 'gap' names what it finds. Example:

      msp-lab gap flights/*.csv --model mb1242.yaml --out gaps/june

      msp-lab design gaps/june --bench --max-minutes 90

    In --out: a folder for each question with campaign.yaml for 'msp-lab collect', scenario files for 'msp-sim fly', and
    session.png; design.json has all numbers. The last two lines of each question are the commands that collect the
    readings and that put them in with the old ones.
    """
    require("lab", "msp-lab design")
    from msp_lab.design.designing import Options, plan_sessions
    from msp_lab.design.files import prepare_folder, write_plans
    from msp_lab.design.show import print_plans
    from msp_lab.gap.findings_file import read_findings
    from msp_lab.gap.terminal import ProgressBar

    out = out or gap / "design"
    read_findings(gap)  # An error in it comes before a folder is made.
    prepare_folder(out, force)
    with ProgressBar() as progress:
        options = Options(bench, max_minutes, power, sessions, seed, airframe)
        findings, plans = plan_sessions(gap, options, progress.clock, progress.report)
    print_plans(plans, findings, out)
    write_plans(plans, findings, out)


app.command("design")(_design)
