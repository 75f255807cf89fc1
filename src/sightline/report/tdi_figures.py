"""Figures of a TDI choice: its maps, MTF and SNR along the columns, the merit's landscape, what others lose.

Not here: how it was chosen (``tdi/``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.applications.tdi_choice import TdiResult
from sightline.report.figure import Figure
from sightline.report.marks import Line, Map, Points, Spans
from sightline.report.style import AXIS_COLOURS, MUTED
from sightline.report.words import digits
from sightline.tdi.choose import LIMITS

#: Columns drawn of a map at most.
DRAWN = 600
#: Columns that are all named on an axis.
FEW_COLUMNS = 12
#: Widths of lines that may lie on one another, px: each is seen beside the thinner one on top of it.
WIDTHS = (5.0, 2.8, 1.2)
#: Where no setting meets all limits: the ground of a map, strokes over it, and what the key says.
NOTHING, UNSERVED = "#c3c9d0", "#b00020"
NO_SETTING = "no setting meets all limits; the safest one is used"
#: One colour per limit, in the order of `LIMITS`; pale where the limit decides, dark red to violet where no
#: setting meets it.
LIMIT_COLOURS = (
    "#eef1f4", "#f2c9a0", "#f3e08b", "#a8c8e8", "#b5d8b0", "#b00020", "#8a3d00", "#6a1b6f", "#5c1038",
)  # fmt: skip


def _drawn(result: TdiResult) -> NDArray[np.intp]:
    """Columns that are drawn, counted from the first."""
    count = len(result.problem.columns)
    return np.unique(np.linspace(0, count - 1, min(count, DRAWN)).round().astype(np.intp))


def electrons(signal: float) -> str:
    """A signal of one line in words."""
    return f"{float(digits(signal, 3)):,.10g} electrons a line"


def settings_figure(result: TdiResult) -> Figure:
    """Maps of the chosen stages and integration ratios over column and signal."""
    choice, some = result.choice, _drawn(result)
    figure = _maps(result, 2)
    unserved = infeasible(result)[some].T
    for panel, values, title, log in (
        (figure[0], choice.stages[some], "TDI stages", True),
        (figure[1], choice.integration_ratio[some], "integration ratio Kt", False),
    ):
        low, high = float(values.min()), float(values.max())
        spread = (low, high) if high > low else (0.8 * low, 1.25 * high)
        panel.title = {True: "Chosen number of TDI stages", False: "Chosen integration ratio Kt"}[log]
        x, y = choice.columns.column[some], choice.signals
        panel.add(Map(x=x, y=y, z=values.T, low=spread[0], high=spread[1], log=log, bar=title))
        if unserved.any():
            panel.add(Map(x=x, y=y, z=unserved, hatch=True, colour=UNSERVED, name=NO_SETTING))
    return figure


def infeasible(result: TdiResult) -> NDArray[np.bool_]:
    """(columns, signals): where no setting keeps all limits."""
    codes = [code for code, name in enumerate(LIMITS) if name.startswith("infeasible")]
    return np.isin(result.choice.limit, codes)


def _maps(result: TdiResult, rows: int = 1) -> Figure:
    """Empty maps over column and signal."""
    columns, signals = result.choice.columns.column, result.choice.signals
    figure = Figure(rows, height=235)
    for panel in figure.panels:
        panel.y.title, panel.y.tight, panel.y.log = "signal of one line (e-)", True, len(signals) > 1
    _column_axis(figure, columns)
    return figure


def _column_axis(figure: Figure, columns: NDArray[Any]) -> None:
    """Numbers of columns, of which there are no halves."""
    figure[0].x.title = "column"
    if len(columns) <= FEW_COLUMNS:
        figure[0].x.ticks = [(float(column), f"{column:g}") for column in columns]


def quality_figure(result: TdiResult) -> Figure:
    """MTF and SNR of the choice along the columns, for a low, a middle and a high signal."""
    choice, some = result.choice, _drawn(result)
    x = choice.columns.column[some]
    shown = sorted({len(choice.signals) // 10, len(choice.signals) // 2, (len(choice.signals) - 1) * 9 // 10})
    fx, fy = choice.rules.frequencies
    titles = (
        f"MTF across the columns of the chosen settings, at {fx:g} cycles per pixel",
        f"MTF along the columns of the chosen settings, at {fy:g} cycles per pixel",
        "SNR of the sum of the chosen lines",
    )
    figure, one = Figure(3, height=175), len(x) == 1
    series = (choice.mtf[..., 0], choice.mtf[..., 1], choice.snr)
    for row, (panel, values, title) in enumerate(zip(figure.panels, series, titles, strict=True)):
        panel.title = title
        for s, colour, width in zip(shown, AXIS_COLOURS, WIDTHS, strict=False):
            dots = 6.0 + 2.0 * width if one else 0.0
            name = electrons(choice.signals[s])
            panel.add(Line(x=x, y=values[some, s], name=name, colour=colour, width=width, dotted=dots))
        if row < 2:
            rest = choice.columns.static_mtf[some, row]
            look: dict[str, Any] = {"colour": MUTED, "width": 1.2, "dash": "dot", "dotted": 5.0 * one}
            panel.add(Line(x=x, y=rest, name="scene at rest", **look))
        panel.y.title, panel.y.from_zero = ("MTF", True) if row < 2 else ("SNR", False)
    figure[2].y.log = bool(choice.snr[some][:, shown].min() > 0.0)
    _column_axis(figure, choice.columns.column)
    return figure


def merit_figure(result: TdiResult) -> Figure:
    """Merit over stages and integration ratio for the first, the middle and the last column."""
    view, choice = result.landscape, result.choice
    figure, grid = Figure(1, len(view.columns), height=280), result.choice.grid
    for k, c in enumerate(view.columns):
        panel, best = figure[0, k], float(view.merit[k].max())
        panel.title = f"column {choice.columns.column[c]:.0f}"
        ratio = choice.integration_ratio[[c], view.signal]
        place: dict[str, Any] = {"x": choice.stages[[c], view.signal], "y": ratio}
        bar = "merit over the best" if k == len(view.columns) - 1 else ""
        panel.add(
            Map(x=grid.stages, y=grid.ratios, z=view.merit[k].T / (best or 1.0), bar=bar),
            Points(**place, symbol="cross", size=13.0, width=5.0, colour="#ffffff"),
            Points(**place, symbol="cross", size=12.0, width=2.5, colour="#c1502e", name="chosen"),
        )
        panel.x.title, panel.y.tight = "TDI stages", True
    figure[0].y.title = "integration ratio Kt"
    return figure


def stages_figure(result: TdiResult) -> Figure:
    """Merit along the stages, at the integration ratio chosen, for the columns of `merit_figure`."""
    view, choice = result.landscape, result.choice
    stages, figure = choice.grid.stages, Figure(height=250)
    panel = figure[0]
    for k, (c, colour) in enumerate(zip(view.columns, AXIS_COLOURS, strict=False)):
        chosen, ratio = choice.stages[c, view.signal], choice.integration_ratio[c, view.signal]
        merit = view.merit[k][:, int(np.searchsorted(choice.grid.ratios, ratio))]
        share = merit / (view.merit[k].max() or 1.0)
        name = f"column {choice.columns.column[c]:.0f}, Kt {ratio:.3g}"
        cross: dict[str, Any] = {"symbol": "cross", "size": 11.0, "colour": colour, "key": False}
        panel.add(
            Line(x=stages, y=share, name=name, colour=colour, width=1.6),
            Points(x=[chosen], y=share[stages == chosen], name=f"chosen for {name}", **cross),
        )
    panel.x.title, panel.y.title, panel.y.from_zero = "TDI stages", "merit over the column's best", True
    return figure


def limit_figure(result: TdiResult) -> Figure:
    """Map of what decided, over column and signal."""
    choice, some = result.choice, _drawn(result)
    there = np.unique(choice.limit)
    figure = _maps(result)
    figure[0].add(
        Map(
            x=choice.columns.column[some],
            y=choice.signals,
            z=np.searchsorted(there, choice.limit[some]).T,
            names=[(LIMITS[code], LIMIT_COLOURS[code]) for code in there],
        )
    )
    return figure


def table_figure(result: TdiResult) -> Figure:
    """Merit that the table loses, over the columns and signals at which it was judged."""
    found, figure = result.table_loss, _maps(result)
    columns = Map.edges(result.choice.columns.column[found.columns])
    if np.isnan(found.loss).any():
        span = (float(columns[0]), float(columns[-1]))
        figure[0].add(Spans(spans=[span], opacity=1.0, colour=NOTHING, name="no setting meets all limits"))
    figure[0].add(
        Map(
            x=result.choice.columns.column[found.columns],
            y=found.signals,
            z=100.0 * found.loss.T,
            palette="heat",
            high=100.0 * result.certificate.max_loss,
            bar="merit lost (%)",
        )
    )
    return figure


def others_figure(result: TdiResult) -> Figure:
    """Merit that other ways of choosing lose, along the columns, averaged over the signals."""
    figure = Figure(height=230)
    panel = figure[0]
    for way, colour in zip((result.one_setting, result.one_signal, result.patent), AXIS_COLOURS, strict=True):
        x, y = result.choice.columns.column[way.columns], 100.0 * way.loss.mean(axis=1)
        name = f"{way.name} (mean {100.0 * way.loss.mean():.3g} %)"
        panel.add(Line(x=x, y=y, name=name, colour=colour, width=1.6, dotted=7.0 if len(x) == 1 else 0.0))
    panel.y.title, panel.y.from_zero = "merit lost, mean over the signals (%)", True
    _column_axis(figure, result.choice.columns.column)
    return figure
