"""Figures of what a stereo plan would give: sigma against each quantity, and what would better it.

Not here: the bounds (``applications/stereo_prediction.py``), the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from sightline.applications.stereo_prediction import Improvement, SigmaTable
from sightline.geometry.units import ARCSEC
from sightline.report.style import AXES, AXIS_COLOURS, INK, MUTED, TEMPLATE, wrapped

_METHODS = {
    "ml-track": ("points tracked through all shots", "solid"),
    "ml-pair": ("points new in every shot", "dash"),
}
#: px of one row of panels, and of what stands above and below.
_ROW, _ABOVE, _BELOW = 250, 84, 56


def prediction_figure(tables: Sequence[SigmaTable]) -> go.Figure:
    """Bounds against each quantity, a panel each: roll, pitch, yaw of the camera known least."""
    tables = [table for table in tables if len(table.values) > 1]
    rows = max(-(-len(tables) // 2), 1)
    gap = 86.0 / (rows * _ROW)
    figure = make_subplots(
        rows=rows, cols=2, horizontal_spacing=0.11, vertical_spacing=gap if rows > 1 else 0.0,
        subplot_titles=[_title(table) for table in tables],
    )  # fmt: skip
    height = rows * _ROW + _ABOVE + _BELOW
    figure.update_layout(template=TEMPLATE, height=height, margin_t=_ABOVE)
    figure.update_annotations(font_size=12)
    for number, table in enumerate(tables):
        _panel(figure, table, number // 2 + 1, number % 2 + 1, first=number == 0)
    figure.update_layout(legend={"y": 1.0 + 30.0 / (rows * _ROW)})
    return figure


def _shown(table: SigmaTable) -> tuple[str, float]:
    """Unit that a quantity is shown in, and how many of it the table's unit is."""
    if table.unit == "rad":
        return "arcsec", 1.0 / ARCSEC
    if table.unit == "m" and table.planned > 1e4:
        return "km", 1e-3
    return table.unit, 1.0


def _title(table: SigmaTable) -> str:
    unit, scale = _shown(table)
    return f"{table.quantity}, planned {table.planned * scale:.4g} {unit}".rstrip()


def _panel(figure: go.Figure, table: SigmaTable, row: int, col: int, *, first: bool) -> None:
    """One panel: three axes by two estimators, the weakest direction, and where the plan is."""
    unit, scale = _shown(table)
    x = table.values * scale
    drawn = []
    for m, method in enumerate(table.methods):
        words, dash = _METHODS[method]
        sigmas = table.sigmas[m].reshape(len(x), -1, 3).max(axis=1) / ARCSEC
        for k, axis in enumerate(AXES):
            y = _finite(sigmas[:, k])
            drawn.append(y)
            _line(figure, x, y, f"{axis}, {words}", AXIS_COLOURS[k], dash, row, col, first=first)
        y = _finite(table.weakest[m] / ARCSEC)
        drawn.append(y)
        _line(figure, x, y, f"weakest direction, {words}", MUTED, dash, row, col, first=first)
    figure.add_vline(
        x=table.planned * scale, line={"color": INK, "width": 1, "dash": "dot"}, row=row, col=col
    )
    name = f"{table.quantity} ({unit})" if unit else f"number of {table.quantity}"
    figure.update_xaxes(title_text=name, type="log", **_ticks(x), row=row, col=col)
    seen = np.concatenate(drawn)
    figure.update_yaxes(title_text="sigma (arcsec)", type="log", **_decades(seen), row=row, col=col)


def _finite(values: NDArray[Any]) -> NDArray[np.float64]:
    """Values with gaps where nothing is told."""
    return np.where(np.isfinite(values), values, np.nan)


def _line(
    figure: go.Figure, x: Any, y: Any, name: str, colour: str, dash: str, row: int, col: int, *, first: bool
) -> None:
    figure.add_scatter(
        x=x, y=y, mode="lines+markers", name=name, legendgroup=name, showlegend=first,
        line={"color": colour, "width": 1.8, "dash": dash}, marker={"size": 5}, row=row, col=col,
        hovertemplate="%{x:.4g}: %{y:.3g} arcsec<extra>" + name + "</extra>",
    )  # fmt: skip


def _ticks(values: NDArray[Any]) -> dict[str, Any]:
    """A tick at every value computed."""
    return {"tickvals": values, "ticktext": [_number(value) for value in values]}


def _number(value: float) -> str:
    """Three digits, and all those before the point."""
    return f"{value:.0f}" if value >= 1000.0 else f"{value:.3g}"


def _decades(values: NDArray[Any]) -> dict[str, Any]:
    """Ticks 1, 2, 5 of every decade that is drawn."""
    seen = values[np.isfinite(values)]
    if len(seen) == 0:
        return {}
    low, high = int(np.floor(np.log10(seen.min()))), int(np.ceil(np.log10(seen.max())))
    ticks = [step * 10.0**decade for decade in range(low, high + 1) for step in (1.0, 2.0, 5.0)]
    return {"tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}


def improvements_figure(improvements: Sequence[Improvement]) -> go.Figure:
    """Bounds after each change relative to those without, as bars; the camera known least."""
    height = 70 + 48 * max(len(improvements), 1) + 60
    figure = go.Figure()
    figure.update_layout(template=TEMPLATE, height=height, margin={"l": 330, "t": 50}, barmode="group")
    figure.update_layout(legend_traceorder="reversed")
    words = [wrapped(found.change) for found in improvements][::-1]
    # plotly stacks the bars of a group upwards
    for k, axis in reversed(list(enumerate(AXES))):
        ratio = [_worst(found.ratio[k::3]) for found in improvements][::-1]
        sigma = [float(found.sigmas[k::3].max()) / ARCSEC for found in improvements][::-1]
        figure.add_bar(
            y=words, x=ratio, name=axis, orientation="h", marker_color=AXIS_COLOURS[k],
            text=[f"{value:.3g}\u2033" if np.isfinite(value) else "" for value in sigma],
            textposition="outside", textfont={"size": 10, "color": INK}, cliponaxis=False,
            hovertemplate="%{y}: %{x:.2f} of now<extra>" + axis + "</extra>",
        )  # fmt: skip
    figure.add_vline(x=1.0, line={"color": INK, "width": 1, "dash": "dot"})
    figure.update_xaxes(title_text="sigma relative to now (its value beside the bar)", rangemode="tozero")
    figure.update_yaxes(tickfont={"size": 11})
    return figure


def _worst(ratio: NDArray[Any]) -> float:
    """The largest of what is known; NaN where nothing is."""
    known = ratio[np.isfinite(ratio)]
    return float(known.max()) if len(known) else float("nan")


def prediction_rows(table: SigmaTable) -> tuple[list[str], list[list[str]]]:
    """Head and rows of one quantity's table in words: roll, pitch, yaw of the camera known least, arcsec."""
    unit, scale = _shown(table)
    head = [f"{table.quantity} ({unit})" if unit else table.quantity]
    head += [f"{method} {axis}" for method in table.methods for axis in (*AXES, "weakest")]
    rows = []
    for v, value in enumerate(table.values):
        row = [_number(value * scale)]
        for m in range(len(table.methods)):
            sigmas = [*table.sigmas[m, v].reshape(-1, 3).max(axis=0), table.weakest[m, v]]
            row += [_number(sigma / ARCSEC) if np.isfinite(sigma) else "not observable" for sigma in sigmas]
        rows.append(row)
    return head, rows
