"""Figures become SVG that stands inside a page: small, the same every time, ids of its own.

Two figures on one page share one space of ids, so every id gets its figure's name.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INK, MUTED, GRID = "#1d2733", "#5d6975", "#e4e8ec"
_STYLE: dict[str, object] = {
    "svg.fonttype": "none",  # text stays text: readable by search and by screen readers
    "svg.hashsalt": "hilcell",
    "text.parse_math": False,  # a dollar sign is a dollar sign
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "text.color": INK,
    "axes.edgecolor": MUTED,
    "axes.labelcolor": INK,
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 7.5,
    "lines.linewidth": 1.2,
}


@contextmanager
def house_style() -> Iterator[None]:
    """Draw with these settings, independent of the user's matplotlib."""
    import matplotlib

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        settings: Any = matplotlib.rcParams  # typed key by key, which a table of ours is not
        settings.update(_STYLE)
        yield


def axes_sheet(
    height_in: float, rows: int = 1, columns: int = 1, **more: Any
) -> tuple[Figure, Any]:
    """Return a figure whose axes stand at the same places in every report."""
    from matplotlib.figure import Figure

    width_in = 7.1  # the printable width of A4
    figure = Figure(figsize=(width_in, height_in))
    axes = figure.subplots(rows, columns, squeeze=False, **more)
    figure.subplots_adjust(
        left=0.64 / width_in,
        right=1 - 0.42 / width_in,
        bottom=0.42 / height_in,
        top=1 - 0.28 / height_in,
        wspace=0.34 if columns > 2 else 0.1,
        hspace=0.36,
    )
    return figure, axes


def svg_of(figure: Figure, name: str) -> str:
    """Return the figure as an ``svg`` element whose ids begin with ``name``."""
    file = io.StringIO()
    figure.savefig(file, format="svg", metadata={"Date": None})
    text = file.getvalue()
    return compact(text[text.index("<svg") :], name)


def compact(svg: str, name: str) -> str:
    """Return ``svg`` without parts that no page needs; 0.01 pt is finer than any printer."""
    dropped = re.compile(r"<metadata>.*?</metadata>|<!--.*?-->|\n\s*", re.DOTALL)
    svg = dropped.sub(" ", svg)
    link = re.compile(r'(url\(#|href="#)([^")]+)')
    linked = {found[1] for found in link.findall(svg)}

    def one_id(found: re.Match[str]) -> str:
        return f' id="{name}-{found[1]}"' if found[1] in linked else ""

    long_number = re.compile(r"-?\d+\.\d{3,}")

    id_of = re.compile(r' id="([^"]+)"')

    def one_tag(found: re.Match[str]) -> str:
        tag = id_of.sub(one_id, found[0])
        tag = link.sub(rf"\g<1>{name}-\g<2>", tag).replace("xlink:href", "href")
        tag = re.sub(r' xmlns(:xlink)?="[^"]*"', "", tag)
        return long_number.sub(lambda number: f"{float(number[0]):.2f}", tag)

    a_tag = re.compile(r"<[^>]+>")
    return a_tag.sub(one_tag, svg).strip()
