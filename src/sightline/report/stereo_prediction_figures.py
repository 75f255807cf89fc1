"""Figures of what a stereo plan would give: sigma against each quantity, and what would better it.

Not here: the bounds (``applications/stereo_prediction.py``), the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.applications.stereo_prediction import Improvement, SigmaTable
from sightline.geometry.units import ARCSEC
from sightline.report.figure import Figure, Panel
from sightline.report.marks import Bars, Line, Rules
from sightline.report.style import AXES, AXIS_COLOURS, wrapped

_WEAKEST = "#8a5fa8"
_METHODS = {
    "ml-track": ("points tracked through all shots", "solid"),
    "ml-pair": ("points new in every shot", "dash"),
}


def prediction_figure(tables: Sequence[SigmaTable]) -> Figure:
    """Bounds against each quantity, a panel each: roll, pitch, yaw of the camera known least."""
    tables = [table for table in tables if len(table.values) > 1]
    figure = Figure(max(-(-len(tables) // 2), 1), 2, height=190, shared=False)
    for panel, table in zip(figure.panels, tables, strict=False):
        _draw(panel, table)
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


def _draw(panel: Panel, table: SigmaTable) -> None:
    """One panel: three axes by two estimators, the weakest direction, and where the plan is."""
    unit, scale = _shown(table)
    x = table.values * scale
    for m, method in enumerate(table.methods):
        words, dash = _METHODS[method]
        sigmas = table.sigmas[m].reshape(len(x), -1, 3).max(axis=1) / ARCSEC
        curves = [*zip(AXES, sigmas.T, AXIS_COLOURS, strict=True)]
        curves.append(("weakest direction", table.weakest[m] / ARCSEC, _WEAKEST))
        for name, y, colour in curves:
            y = np.where(np.isfinite(y), y, np.nan)
            panel.add(
                Line(x=x, y=y, name=f"{name}, {words}", colour=colour, dash=dash, width=1.8, dotted=5.0)
            )
    panel.add(Rules(x=[table.planned * scale], name="as planned"))
    panel.title = _title(table)
    panel.x.title, panel.x.log = f"{table.quantity} ({unit})" if unit else f"number of {table.quantity}", True
    panel.x.ticks = [(float(value), _number(value)) for value in x]
    panel.y.title, panel.y.log = "sigma (arcsec)", True


def _number(value: float) -> str:
    """Three digits, and all those before the point."""
    return f"{value:.0f}" if value >= 1000.0 else f"{value:.3g}"


def improvements_figure(improvements: Sequence[Improvement]) -> Figure:
    """Bounds after each change relative to those without, as bars; the camera known least."""
    figure = Figure(height=46 * max(len(improvements), 1) + 10)
    panel, place = figure[0], np.arange(len(improvements), dtype=np.float64)
    for k, (axis, colour) in enumerate(zip(AXES, AXIS_COLOURS, strict=True)):
        ratio = np.array([_worst(found.ratio[k::3]) for found in improvements])
        sigma = [float(found.sigmas[k::3].max()) / ARCSEC for found in improvements]
        texts = [f"{value:.3g}\u2033" if np.isfinite(value) else "" for value in sigma]
        at = place + 0.27 * (k - 1)
        panel.add(Bars(place=at, length=ratio, thick=0.25, level=True, name=axis, colour=colour, texts=texts))
    panel.add(Rules(x=[1.0], name="now"))
    panel.x.title, panel.x.from_zero = "sigma relative to now (its value beside the bar)", True
    panel.x.tight = False
    panel.y.ticks = [(float(k), wrapped(found.change)) for k, found in enumerate(improvements)]
    panel.y.downward, panel.y.grid = True, False
    panel.y.low, panel.y.high = -0.6, len(improvements) - 0.4
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
