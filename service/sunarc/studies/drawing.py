"""Sheets, colours and lettering of the figures; nothing here touches matplotlib's global state."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

BLUE, VERMILLION, GREEN, ORANGE, GREY, INK = "#0072B2", "#D55E00", "#009E73", "#E69F00", "#8A8A8A", "#222222"
"""Okabe and Ito's colours, which people with any colour vision tell apart."""

LETTERING_PT = 10.0
TITLE_PT = 12.0

Location = Literal["best", "upper left", "upper right", "lower left", "lower right"]

_DPI = 100


def new_sheet(*, width_px: int, height_px: int) -> Figure:
    """Return an empty figure of a size in px, with room made for all labels when it is drawn."""
    figure = Figure(figsize=(width_px / _DPI, height_px / _DPI), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def letter(axes: Axes, *, x: str, y: str, title: str = "") -> None:
    """Name the axes, with units, and give them a light grid."""
    axes.set_xlabel(x, fontsize=LETTERING_PT)
    axes.set_ylabel(y, fontsize=LETTERING_PT)
    axes.tick_params(labelsize=LETTERING_PT - 1.0)
    axes.grid(visible=True, color="#DDDDDD", linewidth=0.6)
    axes.set_axisbelow(True)
    if title:
        axes.set_title(title, fontsize=TITLE_PT, loc="left")


def key(axes: Axes, *, location: Location = "best", columns: int = 1) -> None:
    """Draw the key of what was drawn with a label, if anything was."""
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc=location, ncols=columns, fontsize=LETTERING_PT - 1.0, framealpha=0.9, markerscale=1.6)


def save_png(figure: Figure, path: Path) -> Path:
    """Write a sheet as PNG and return where."""
    figure.savefig(path, format="png", dpi=_DPI, metadata={"Software": "sunarc"})
    return path
