"""The looks that all plots share, and plots as files."""

import io
from pathlib import Path
from typing import BinaryIO

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

from quadwalk.files import open_atomic

LEG_COLORS = ("#d1495b", "#00798c", "#edae49", "#30638e")  # FR, FL, RR, RL
INK = "#22262b"
# Okabe and Ito's, which the color-blind can tell apart
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_MARKS = "os^Dv*P"


class NotebookFigure(Figure):
    """A figure that a notebook shows even if pyplot was never set up in it."""

    def _repr_png_(self) -> bytes:
        """Return the figure as PNG, which a notebook shows."""
        file = io.BytesIO()
        _write_png(self, file)
        return file.getvalue()


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, always the same bytes, or raise a `UserError`."""
    with open_atomic(path) as file:
        _write_png(figure, file)


def _write_png(figure: Figure, file: BinaryIO) -> None:
    """Write a figure as PNG, without its texts' dollar signs read as formulas."""
    for text in figure.findobj(Text):
        text.set_parse_math(False)  # a name may hold a $
    # Without the software's version, for longer.
    figure.savefig(file, format="png", metadata={"Software": None})


def make_figure(
    size: tuple[float, float], title: str = "", fontsize: int = 13, dpi: float = 100
) -> Figure:
    """Return an empty figure, `size` in inches, with its title at the upper left."""
    figure = NotebookFigure(figsize=size, dpi=dpi, layout="constrained")
    if title:
        figure.suptitle(title, fontsize=fontsize, x=0.01, ha="left")
    return figure


def get_style(place: int) -> tuple[str, str]:
    """Return color and marker of series number `place` of a plot, from 0 on; they repeat."""
    return _COLORS[place % len(_COLORS)], _MARKS[place % len(_MARKS)]


def tidy(axes: Axes, title: str, unit: str = "", fontsize: int = 11) -> None:
    """Add a title and `unit` to a panel, and the style that all panels share."""
    title = title[0].upper() + title[1:] + (f", {unit}" if unit else "")
    axes.set_title(title, loc="left", fontsize=fontsize)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.set_axisbelow(True)
