"""The wiring of docs/flying.md: four MB1242 and a thermometer on the I2C bus of a Raspberry Pi."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from msp_sim.page.style import BLUE, GREEN, GREY, INK, PALE, VERMILION, new_figure, save, style

WIRES = {"3.3 V": (VERMILION, 1), "GND": (INK, 6), "SDA": (BLUE, 3), "SCL": (GREEN, 5)}
"""Colour of each wire, and its pin of the Raspberry Pi's header."""
SENSORS = ("0x70", "0x71", "0x72", "0x73")
LEVEL = {"3.3 V": 4.4, "SDA": 3.8, "SCL": 3.2, "GND": 2.6}
"""Height of each wire in the picture."""
TOP = 1.6
"""Upper edge of the sensors in the picture."""


def draw_wiring(path: Path) -> None:
    """Power through 100 ohm with 100 uF at each sensor, one bus for all, pull-ups in the Raspberry Pi, addresses."""
    with style():
        figure = new_figure(4.0)
        axes = figure.subplots()
        axes.set(xlim=(-0.1, 11.6), ylim=(-0.1, 5.2), aspect="equal")
        axes.axis("off")
        _box(axes, 0.0, 1.5, 1.9, 3.6, "")
        axes.text(0.95, 4.85, "Raspberry Pi", ha="center", va="center")
        axes.text(0.95, 1.95, "pull-ups of\n1.8 kohm to 3.3 V\non its board", ha="center", va="center", fontsize=7.0)
        for name, (colour, pin) in WIRES.items():
            axes.text(1.82, LEVEL[name], f"{name}, pin {pin}", ha="right", va="center", color=colour, fontsize=7.5)
            axes.plot([1.9, 11.2], [LEVEL[name]] * 2, color=colour)
        for i, address in enumerate(SENSORS):
            _sensor(axes, 2.5 + 1.85 * i, address)
        _thermometer(axes, 9.95)
        save(figure, path)


def _sensor(axes: Axes, left: float, address: str) -> None:
    _box(axes, left, 0.0, 1.55, TOP - 0.45, f"MB1242\n{address}")
    supply, ground, low = left + 0.2, left + 0.72, TOP - 0.45
    for name, x in (("3.3 V", supply), ("GND", ground), ("SDA", left + 1.08), ("SCL", left + 1.36)):
        _down(axes, name, x, low)
    axes.add_patch(Rectangle((supply - 0.09, 1.85), 0.18, 0.5, facecolor="white", edgecolor=VERMILION, zorder=3))
    axes.text(supply - 0.13, 2.1, "100 ohm", fontsize=6.0, va="center", ha="right", rotation=90)
    for x in (supply + 0.22, supply + 0.30):
        axes.plot([x, x], [1.38, 1.62], color=INK, linewidth=1.4)
    axes.plot([supply, supply + 0.22], [1.5, 1.5], color=VERMILION, linewidth=1.2)
    axes.plot([supply + 0.30, ground], [1.5, 1.5], color=INK, linewidth=1.2)
    axes.plot([supply, ground], [1.5, 1.5], ".", color=INK, markersize=4)
    axes.text(supply + 0.26, 1.28, "100 uF", fontsize=6.0, va="center", ha="center")


def _thermometer(axes: Axes, left: float) -> None:
    _box(axes, left, 0.0, 1.5, TOP, "thermometer\n(SHT4x)\n0x44\nin outside air,\nin the shade")
    for name, x in (("3.3 V", 0.2), ("GND", 0.55), ("SDA", 0.9), ("SCL", 1.25)):
        _down(axes, name, left + x, TOP)


def _down(axes: Axes, name: str, x: float, end: float) -> None:
    colour = WIRES[name][0]
    axes.plot([x, x], [LEVEL[name], end], color=colour, linewidth=1.2)
    axes.plot([x], [LEVEL[name]], ".", color=colour, markersize=6)


def _box(axes: Axes, left: float, low: float, width: float, height: float, text: str) -> None:
    axes.add_patch(Rectangle((left, low), width, height, facecolor=PALE, edgecolor=GREY))
    axes.text(left + width / 2, low + height / 2, text, ha="center", va="center", fontsize=8.0)
