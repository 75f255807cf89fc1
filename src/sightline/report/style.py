"""How every figure of a report looks: colours, fonts, axes, and how it becomes HTML.

Not here: what is drawn (``motion_figures.py``, ``spectrum_figures.py``, ``match_figures.py``).
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from sightline.errors import printable, shortened
from sightline.io.names import numbered

AXES = ("roll", "pitch", "yaw")

#: One colour per axis, in every figure.
AXIS_COLOURS = ("#2f6ca3", "#c1502e", "#3f8a5a")
#: What one pixel of each axis means, for the titles of ordinates.
AXIS_UNITS = ("px", "px", "px at field edge")
INK, MUTED, RULE = "#24292f", "#6e7781", "#d8dee4"
#: Frequencies that cannot be seen, and lines that no match sees.
BLIND = "rgba(214, 158, 46, 0.22)"
#: Before and after the estimate.
BEFORE, AFTER = "#9aa4ae", "#2f6ca3"
#: Characters of a name in a figure; of words that hold names, and of each of their lines.
LABEL, _WORDS, _LINE = 28, 140, 52
FONT = "system-ui, -apple-system, 'Segoe UI', 'DejaVu Sans', Arial, sans-serif"

_AXIS: dict[str, Any] = {
    "showline": True,
    "linecolor": RULE,
    "gridcolor": "#eef1f4",
    "zeroline": False,
    "ticks": "outside",
    "tickcolor": RULE,
    "ticklen": 4,
    "title": {"standoff": 8, "font": {"size": 12}},
}

TEMPLATE = go.layout.Template(
    layout={
        "font": {"family": FONT, "size": 12, "color": INK},
        "paper_bgcolor": "white",
        "plot_bgcolor": "white",
        "margin": {"l": 78, "r": 78, "t": 42, "b": 52},
        "xaxis": _AXIS,
        "yaxis": _AXIS,
        "hovermode": "closest",
        "legend": {"orientation": "h", "x": 0.0, "y": 1.0, "yanchor": "bottom", "xanchor": "left"},
        "colorway": list(AXIS_COLOURS),
    }
)

CONFIG: dict[str, Any] = {
    "displaylogo": False,
    "responsive": True,
    "modeBarButtonsToRemove": ["select2d", "lasso2d", "toImage", "autoScale2d"],
}


def panels(rows: int, height: int, *, gap_px: float = 26.0, top: int = 42, **options: Any) -> go.Figure:
    """An empty figure of `rows` panels, one above the other.

    Parameters
    ----------
    rows, height : int
        Panels, and px of the whole figure.
    gap_px : float
        Between panels.
    top : int
        px above the first panel, where the legend is, and its title if there are titles.
    **options
        As of plotly's ``make_subplots``.
    """
    inner = height - top - TEMPLATE.layout.margin.b
    spacing = gap_px / inner if rows > 1 else 0.0
    figure = make_subplots(rows=rows, cols=1, vertical_spacing=spacing, **options)
    figure.update_layout(template=TEMPLATE, height=height, margin_t=top)
    if "subplot_titles" in options:
        figure.update_annotations(x=0.0, xanchor="left", font_size=12)
        figure.update_layout(legend_y=1.0 + 20.0 / inner)
    return figure


def rules(figure: go.Figure, places: Sequence[float], numbers: Sequence[int] | None = None) -> None:
    """Dotted upright lines at places of the abscissa, in every panel or in those of the given numbers.

    Plotly's own ``add_vline`` takes seconds for some dozens of them.
    """
    count = len([key for key in figure.layout.to_plotly_json() if key.startswith("xaxis")])
    drawn = [
        {
            "type": "line", "x0": place, "x1": place, "y0": 0.0, "y1": 1.0, "layer": "below",
            "xref": f"x{number if number > 1 else ''}", "yref": f"y{number if number > 1 else ''} domain",
            "line": {"color": "#b8c0c8", "width": 1, "dash": "dot"},
        }
        for number in numbers or range(1, count + 1)
        for place in places
    ]  # fmt: skip
    figure.update_layout(shapes=drawn)


def labels(names: Iterable[str], longest: int = LABEL) -> list[str]:
    """Names of the user as texts of a figure: literal, on one line, none too long, no two alike.

    Plotly takes tags, entities and places of a template out of any text; those of a name are none.
    """
    short = numbered((shortened(printable(name), longest) for name in names), str)
    return [escape(name, quote=False).replace("%", "&#37;") for name in short]


def label(name: str, longest: int = LABEL) -> str:
    """One name as `labels` has it."""
    return labels([name], longest)[0]


def wrapped(words: str) -> str:
    """Words that may hold names, as a text of a figure of few short lines."""
    lines = textwrap.wrap(shortened(printable(words), _WORDS), _LINE)
    return "<br>".join(label(line, _LINE) for line in lines)


def as_html(figure: go.Figure, name: str) -> str:
    """The figure as a piece of HTML named `name`; the page brings the drawing library."""
    drawn = figure.to_html(full_html=False, include_plotlyjs=False, config=CONFIG, div_id=name)
    return f'<div class="figure">{drawn}</div>'


def faint(colour: str, opacity: float) -> str:
    """A ``#rrggbb`` colour made translucent."""
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return f"rgba({red}, {green}, {blue}, {opacity})"
