"""Draw the pictures of the README and of docs/: ``.venv/bin/python docs/images/draw.py [NAME ...]``.

Without names all are drawn, in some two minutes. The pallet is drawn here, from its airframe file and the sensor's
measured beam; the others are pictures that the product's own commands make, copied under their names in the documents.
"""

import math
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from draw_wiring import draw_wiring
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Polygon, Rectangle

from msp_range.config import load_airframe
from msp_sim.page.style import BLUE, GREY, INK, ORANGE, PALE, new_figure, save, style

IMAGES = Path(__file__).parent
ROOT = IMAGES.parent.parent
BIN = ROOT / ".venv/bin"
HEIGHT_M = 2.0
"""Height of the pallet's sensors above the ground in the picture [m]."""
BOX_M = (0.42, 0.80, 0.40)
"""The box in the picture: from and to, forward of the vehicle's middle, and its height [m]."""


def main() -> None:
    """Draw what the command line names, or everything."""
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name](IMAGES / f"{name}.png")
        print(f"written: {IMAGES / name}.png")


def draw_pallet(path: Path) -> None:
    """The four sensors under a pallet with their beams: from the side, and as circles on the ground."""
    airframe = load_airframe(ROOT / "configs/quad_pallet.yaml")
    beam = airframe.sensors[0].sensor_model.beam
    with style():
        figure = new_figure(3.7)
        side, below = figure.subplots(1, 2, width_ratios=(1.5, 1))
        _draw_vehicle(side)
        ranges_m = np.linspace(0.02, HEIGHT_M, 60)
        reach_m = ranges_m * np.tan(beam.half_angle_rad(ranges_m))
        for forward_m, colour in ((0.25, ORANGE), (-0.25, BLUE)):
            left = [(forward_m - wide, HEIGHT_M - far) for far, wide in zip(ranges_m, reach_m, strict=True)]
            right = [(forward_m + wide, HEIGHT_M - far) for far, wide in zip(ranges_m, reach_m, strict=True)]
            side.add_patch(Polygon(left + right[::-1], color=colour, alpha=0.25, linewidth=0))
            side.plot([forward_m], [HEIGHT_M], "v", color=colour, markersize=7)
        start_m, end_m, height_m = BOX_M
        side.add_patch(Rectangle((start_m, 0), end_m - start_m, height_m, facecolor=PALE, edgecolor=GREY, zorder=2))
        side.text((start_m + end_m) / 2, height_m / 2, "box", ha="center", va="center")
        side.axhline(0.0, color=INK, linewidth=1.5)
        side.annotate("", (0.0, 0.0), (0.0, HEIGHT_M), arrowprops={"arrowstyle": "<->", "color": INK})
        side.text(-0.06, 0.9, "one fused\ndistance to\nthe ground", ha="right", va="center")
        side.annotate(
            "only the front sensors\nsee the box: reported\nas an object",
            ((start_m + end_m) / 2, height_m),
            (1.28, 1.15),
            ha="center",
            va="center",
            arrowprops={"arrowstyle": "->", "color": GREY},
        )
        side.set(xlim=(-0.95, 1.85), ylim=(-0.1, 2.75), xlabel="forward [m]", ylabel="above the ground [m]")
        side.set_title("from the side")
        side.set_aspect("equal")
        below.add_patch(
            Rectangle((-0.3, -0.3), 0.6, 0.6, facecolor="none", edgecolor=INK, linewidth=1.5, label="pallet")
        )
        spot_m = HEIGHT_M * math.tan(float(beam.half_angle_rad(HEIGHT_M)))
        for sensor in airframe.sensors:
            forward_m, right_m, _ = sensor.position_m
            colour = ORANGE if forward_m > 0 else BLUE
            below.add_patch(Circle((right_m, forward_m), spot_m, facecolor=colour, alpha=0.22, linewidth=0))
            below.add_patch(Circle((right_m, forward_m), spot_m, facecolor="none", edgecolor=colour))
            below.plot([right_m], [forward_m], "v", color=colour, markersize=7)
        below.set(xticks=(-0.5, 0, 0.5), xlim=(-0.85, 0.85), ylim=(-0.9, 0.9), xlabel="right [m]", ylabel="forward [m]")
        below.set_title(f"beams on the ground, {HEIGHT_M:g} m below")
        below.set_aspect("equal")
        for colour, which in ((ORANGE, "front"), (BLUE, "rear")):
            below.plot([], [], "v", color=colour, label=f"{which} sensors and beams")
        save(figure, path)


def _draw_vehicle(axes: Axes) -> None:
    """A quadcopter from the side: pallet, legs, body, and two rotors."""
    top_m = HEIGHT_M + 0.06
    axes.add_patch(Rectangle((-0.3, top_m - 0.03), 0.6, 0.05, color=GREY))
    for forward_m in (-0.2, 0.2):
        axes.plot([forward_m, forward_m / 2], [top_m, top_m + 0.28], color=GREY, linewidth=2)
    axes.add_patch(Rectangle((-0.18, top_m + 0.26), 0.36, 0.12, color=INK))
    axes.plot([-0.5, 0.5], [top_m + 0.34, top_m + 0.34], color=INK, linewidth=3)
    for forward_m in (-0.5, 0.5):
        axes.plot([forward_m, forward_m], [top_m + 0.34, top_m + 0.44], color=INK, linewidth=2)
        axes.plot([forward_m - 0.27, forward_m + 0.27], [top_m + 0.44, top_m + 0.44], color=GREY, linewidth=2)
    axes.text(0.36, HEIGHT_M + 0.03, "pallet with 4 sensors", va="center", color=INK)


def made_by(picture: str, *commands: str) -> Callable[[Path], None]:
    """What draws a picture that the product's own commands leave in a folder, which stands for OUT in them."""

    def draw(path: Path) -> None:
        with tempfile.TemporaryDirectory() as folder:
            for command in commands:
                program, *arguments = command.replace("OUT", folder).split()
                subprocess.run([BIN / program, *arguments], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
            shutil.copy(f"{folder}/{picture}", path)

    return draw


CAMPAIGN = (
    "msp-lab collect configs/campaigns/table_4_1.yaml --simulate --out OUT/campaign",
    "msp-lab characterise OUT/campaign/readings.csv --out OUT/model.yaml --report OUT/report",
)
"""The report's campaign on the simulator, and the page that `msp-lab characterise` makes of it."""

PICTURES: dict[str, Callable[[Path], None]] = {
    "pallet": draw_pallet,
    "wiring": draw_wiring,
    # The flight of ``make demo``.
    "flight": made_by("flight/flight.png", "msp-sim fly configs/scenarios/demo.yaml --out OUT/flight"),
    "boxes": made_by("flight/flight.png", "msp-sim fly configs/scenarios/boxes.yaml --out OUT/flight"),
    # Readings against the model, before and after the effects that the demonstration hides were added.
    "gap": made_by("demo/gap/residuals.png", "msp-lab demo --out OUT/demo"),
    "field_of_view_100cm": made_by("report/field_of_view_100cm.png", *CAMPAIGN),
    "questions": made_by("report/questions.png", *CAMPAIGN),
    # The Kalman filters and the changepoint filter in the filter study.
    "kalman_and_changepoint": made_by("study/figure_5_15.png", "msp-lab filters --out OUT/study"),
}

if __name__ == "__main__":
    main()
