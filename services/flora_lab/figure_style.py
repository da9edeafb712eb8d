"""How the lab's figures look: colours, one per meaning, and PNG bytes that are the same for the same figure."""

from __future__ import annotations

import io
from typing import Final

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font

from flora_common.runs import Light

BLUE: Final = "#0072B2"
ORANGE: Final = "#D55E00"
COLOURS: Final = (BLUE, ORANGE, "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""Okabe and Ito's, which people with any colour vision tell apart."""
GREY: Final = "#7a7a7a"
GRID: Final = "#dddddd"
LAMP_COLOURS: Final[dict[Light, str]] = {"left": "#3b6fd4", "right": "#e0a100", "both": "#7aa37a", "dark": "#444444"}
OBSTACLE: Final = "#9a9a9a"
TARGET: Final = "#c8372d"
DPI: Final = 110


def new_figure(wide_in: float, high_in: float, *, dpi: int = DPI) -> Figure:
    """An empty figure of this size in inches, which matplotlib keeps no list of."""
    figure = Figure(figsize=(wide_in, high_in), dpi=dpi, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def png(figure: Figure) -> bytes:
    """The figure as PNG, its axes open at the top and to the right."""
    for ax in figure.axes:
        ax.spines[["top", "right"]].set_visible(False)
    data = io.BytesIO()
    # without the version of matplotlib, so that the same figure gives the same bytes
    figure.savefig(data, format="png", dpi=figure.dpi, metadata={"Software": None})
    return data.getvalue()


def drawable(text: str, longest: int = 60) -> str:
    """A text from a file as a figure can show it: not too long, and with a box for each sign that the font lacks.

    Draw it with ``parse_math=False``, or dollar signs in it are read as formulas.
    """
    font = get_font(findfont(FontProperties()))
    shown = text if len(text) <= longest else text[: longest - 1] + "…"
    return "".join(sign if font.get_char_index(ord(sign)) else "\N{WHITE SQUARE}" for sign in shown)
