"""The common style of all pictures: figures on their own canvas, colours for colour-blind readers, their files.

The colours are those of Okabe and Ito (2008, Color Universal Design), which can be distinguished without distinguishing
red from green. The order of `SERIES` also alternates in lightness, for prints without colour, and series differ by
marker. pyplot is not used: there is no global figure that could leak, and drawing needs no display.
"""

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import ArrayLike

from msp_range.arrays import Array

BLUE = "#0072B2"
VERMILION = "#D55E00"
GREEN = "#009E73"
ORANGE = "#E69F00"
PURPLE = "#CC79A7"
INK = "#1a1a1a"
GREY = "#767676"
PALE = "#d9d9d9"

OURS = BLUE
"""Colour of what was measured or fitted."""

REFERENCE = VERMILION
"""Colour of what it is compared with: the report's value, the truth, the expectation."""

SERIES = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (PURPLE, "D"), ("#56B4E9", "v"), (VERMILION, "P"))
"""Colour and marker of the first, second ... of several series of equal importance."""

BARS: dict[str, Any] = {"color": OURS, "alpha": 0.7}
"""Look of counts and shares, for `Axes.bar`."""

MARKED: dict[str, Any] = {
    "linestyle": "none",
    "marker": "X",
    "markersize": 7,
    "color": REFERENCE,
    "markeredgecolor": "white",
    "zorder": 6,
}
"""Look of a reference's values, for `Axes.plot`."""

DOTS: dict[str, Any] = {
    "linestyle": "none",
    "marker": "o",
    "markersize": 5.0,
    "color": INK,
    "elinewidth": 1.0,
    "zorder": 5,
}
"""Look of measured values with their intervals, for `intervals`."""

WIDTH_IN = 7.4
"""Width of a picture [in]: the text width of an A4 page, so that printing does not shrink the letters."""

# Names of runs may have letters that the font lacks. They are drawn as boxes, and the user cannot change that.
warnings.filterwarnings("ignore", "Glyph .* missing from font")

FORMATS = ("png", "svg", "pdf")
"""Formats of figures, as ``--format`` names them."""
_chosen: ContextVar[str] = ContextVar("format of figures", default="png")

_LETTER_IN, _HANDLE_IN = 0.064, 0.6
"""Approximate width of a letter, and of the symbol in front of a label, in a legend [in]; for its number of columns."""

_STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titlepad": 7.0,
    "axes.labelsize": 9.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": GREY,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.6,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "xtick.major.size": 3.0,
    "ytick.major.size": 3.0,
    "legend.fontsize": 8.0,
    "legend.framealpha": 0.9,
    "legend.edgecolor": "none",
    "legend.borderpad": 0.3,
    "legend.handlelength": 1.8,
    "errorbar.capsize": 2.5,
    "lines.markersize": 5.0,
    "path.simplify_threshold": 0.5,
    "agg.path.chunksize": 20_000,
}


@contextmanager
def style() -> Iterator[None]:
    """Use the common style for all figures, axes and texts made inside."""
    with matplotlib.rc_context(_STYLE):
        yield


def new_figure(height_in: float = 3.5, width_in: float = WIDTH_IN) -> Figure:
    """Make an empty figure of this size [in] on its own canvas."""
    figure = Figure(figsize=(width_in, height_in), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def new_axes(height_in: float, x: str = "", y: str = "") -> tuple[Figure, Axes]:
    """Make a figure with one axes, and label what is over what."""
    figure = new_figure(height_in)
    return figure, figure.subplots(subplot_kw={"xlabel": x, "ylabel": y})


def new_panels(
    height_in: float, rows: int, columns: int = 1, width_in: float = WIDTH_IN, **shared: Any
) -> tuple[Figure, list[Axes]]:
    """Make a figure of ``rows`` times ``columns`` panels, listed row by row; ``shared`` is for `Figure.subplots`."""
    figure = new_figure(height_in, width_in)
    return figure, list(figure.subplots(rows, columns, squeeze=False, **shared).flat)


def choose_format(name: str) -> None:
    """Choose the format in which all figures are kept from now on, as well as in PNG: ``--format``."""
    _chosen.set(name)


@style()
def files_of(figure: Figure, only: str = "") -> dict[str, bytes]:
    """The figure with its legend by format: PNG and what was chosen, or only one.

    The same drawing always gives the same bytes.
    """
    if not figure.legends:
        _add_legend(figure)
    for text in figure.findobj(Text):
        # A $ in a name of a target or run is not a formula. matplotlib's own formulas are added when it draws the axes.
        if "$" in text.get_text():
            text.set_parse_math(False)
    if (layout := figure.get_layout_engine()) is not None:
        # A figure that has a layout engine is drawn twice by `savefig`, the first time only for the layout.
        layout.execute(figure)
        figure.set_layout_engine(None)
    return {name: _file(figure, name) for name in ([only] if only else dict.fromkeys(("png", _chosen.get())))}


def save(figure: Figure, path: Path) -> None:
    """Write a figure: as PNG, and next to it in the chosen format; or in the format that the file's name has."""
    named = path.suffix.removeprefix(".").lower()
    for name, content in files_of(figure, named if named in ("svg", "pdf") else "").items():
        (path if name in ("png", named) else path.with_suffix(f".{name}")).write_bytes(content)


def _file(figure: Figure, name: str) -> bytes:
    """The figure in one format, without the date and version that it would contain."""
    # PNG's level 4 is twice as fast as the default 6, and a few per cent larger.
    options: dict[str, Any] = {
        "png": {"metadata": {"Software": None}, "pil_kwargs": {"compress_level": 4}},
        "svg": {"metadata": {"Date": None}},
        "pdf": {"metadata": {"CreationDate": None}},
    }
    file = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "msp-range"}):
        figure.savefig(file, format=name, **options[name])
    return file.getvalue()


def _add_legend(figure: Figure) -> None:
    """List each label once below the axes, in columns as wide as the longest; axes with a legend have their own."""
    drawn = [
        handle for axes in figure.axes if axes.get_legend() is None for handle in axes.get_legend_handles_labels()[0]
    ]
    # Of equal labels the last: a kind of mark that one panel lacks is explained by another.
    handles = {str(handle.get_label()): handle for handle in drawn}
    if handles:
        columns = int(figure.get_figwidth() / (_LETTER_IN * max(map(len, handles)) + _HANDLE_IN))
        figure.legend(handles=list(handles.values()), loc="outside lower center", ncols=max(columns, 1))


def note(axes: Axes, text: str, x: float = 0.99, y: float = 0.97) -> None:
    """Write a few words inside an axes, at a fraction of its width and height, on a white background."""
    ha, va = "right" if x > 0.5 else "left", "top" if y > 0.5 else "bottom"
    ground = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 2.0}
    axes.text(x, y, text, transform=axes.transAxes, ha=ha, va=va, fontsize=8.0, color=INK, bbox=ground, zorder=10)


def label(axes: Axes, text: str, at: tuple[float, float], offset: tuple[float, float], **look: Any) -> None:
    """Write a few words next to a place, ``offset`` points to the right of it and above."""
    axes.annotate(text, at, xytext=offset, textcoords="offset points", **{"fontsize": 8.0} | look)


def shaded(colour: str = PALE) -> dict[str, Any]:
    """Look of a range of values, for `Axes.axhspan`, `Axes.axvspan` and `Axes.fill_between`."""
    return {"color": colour, "alpha": 0.6 if colour == PALE else 0.2, "linewidth": 0}


def line_at_zero(axes: Axes) -> None:
    """Draw the line on which there is no difference."""
    axes.axhline(0.0, color=GREY, linewidth=0.9)


def intervals(
    axes: Axes, place: ArrayLike, value: ArrayLike, ends: ArrayLike, across: bool = False, **look: Any
) -> None:
    """Draw values (n,) at their places, with their intervals from the first to the second row of ``ends``, (2, n).

    They reach up and down, or to the left and right where ``across``; an end that is NaN or infinite is not drawn.
    Marks are white, or filled where the look has a colour.
    """
    reach = np.abs(np.asarray(ends, dtype=float) - value).reshape(2, -1)
    reach[~np.isfinite(reach)] = 0.0
    look = DOTS | {"markerfacecolor": look.get("color", "white")} | look
    if across:
        axes.errorbar(value, place, xerr=reach, **look)
    else:
        axes.errorbar(place, value, yerr=reach, **look)


def draw_pit_bars(axes: Axes, counts: ArrayLike, colour: str = OURS, base: float = 1.0) -> None:
    """Draw bars of the readings in each bin of a probability integral transform, as a factor of the expected number."""
    from scipy.special import bdtrik

    from msp_sim.intervals import CONFIDENCE

    counts = np.asarray(counts, dtype=float)
    expected = counts.mean()
    ends = [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2]
    low, high = np.ceil(bdtrik(ends, counts.sum(), 1.0 / counts.size)) / expected
    axes.axhspan(low, high, label="random variation (95 %)", **shaded())
    edges = np.linspace(0.0, 1.0, counts.size + 1)
    axes.stairs(counts / expected, edges, baseline=base, fill=True, color=colour, alpha=0.75)
    axes.axhline(1.0, color=GREY, linewidth=0.9)
    axes.set_ylabel("readings, relative to expected")
    axes.set_xlim(0.0, 1.0)
    axes.margins(y=0.15)
    axes.grid(visible=False, axis="x")


def edges_between(centres: Array) -> Array:
    """Bin edges half way between sorted values, (n + 1,); the outer bins are symmetric.

    Examples
    --------
    >>> edges_between(np.array([40.0, 60.0, 100.0])).tolist()
    [30.0, 50.0, 80.0, 120.0]
    """
    if centres.size == 1:
        half = max(abs(centres[0]), 1.0) / 20.0
        return np.array([centres[0] - half, centres[0] + half])
    inner = (centres[1:] + centres[:-1]) / 2.0
    return np.array([2.0 * centres[0] - inner[0], *inner, 2.0 * centres[-1] - inner[-1]])
