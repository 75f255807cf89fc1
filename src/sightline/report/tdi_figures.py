"""Figures of a TDI choice: its maps, MTF and SNR along the columns, the merit's landscape, what others lose.

Not here: how it was chosen (``tdi/``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from sightline.applications.tdi_choice import TdiResult
from sightline.report.style import AXIS_COLOURS, INK, MUTED, TEMPLATE, panels

#: Columns drawn of a map at most.
DRAWN = 600
SEQUENTIAL = "Viridis"


def _drawn(result: TdiResult) -> NDArray[np.intp]:
    """Columns that are drawn, counted from the first."""
    count = len(result.problem.columns)
    return np.unique(np.linspace(0, count - 1, min(count, DRAWN)).round().astype(np.intp))


def _bar(title: str, row: int, rows: int) -> dict[str, Any]:
    """Scale beside the panel `row` of `rows`."""
    return {
        "title": {"text": title, "side": "right", "font": {"size": 11}},
        "len": 0.92 / rows, "y": 1.0 - (row - 0.5) / rows, "thickness": 12, "outlinewidth": 0,
    }  # fmt: skip


def settings_figure(result: TdiResult) -> go.Figure:
    """Maps of the chosen stages and integration ratios over column and signal."""
    choice, some = result.choice, _drawn(result)
    x = choice.columns.column[some]
    titles = ["number of TDI stages", "integration time over line period"]
    figure = panels(2, 640, gap_px=52.0, top=30, shared_xaxes=True, subplot_titles=titles)
    for row, (values, name) in enumerate(
        ((choice.stages, "stages"), (choice.integration_ratio, "integration ratio")), 1
    ):
        figure.add_heatmap(
            x=x, y=choice.signals, z=values[some].T, colorscale=SEQUENTIAL, row=row, col=1,
            colorbar=_bar(name, row, 2),
            hovertemplate="column %{x:.0f}, %{y:.4g} e-: %{z:g}<extra></extra>",
        )  # fmt: skip
        _signal_axis(figure, choice.signals, row)
    figure.update_xaxes(title_text="column", row=2)
    return figure


def _signal_axis(figure: go.Figure, signals: NDArray[np.float64], row: int) -> None:
    figure.update_yaxes(
        title_text="signal of one line (e-)", row=row, type="log" if len(signals) > 1 else "linear",
        exponentformat="none", dtick=1 if len(signals) > 1 and signals[-1] > 10.0 * signals[0] else None,
    )  # fmt: skip


def quality_figure(result: TdiResult) -> go.Figure:
    """MTF and SNR of the choice along the columns, for a low, a middle and a high signal."""
    choice, some = result.choice, _drawn(result)
    x = choice.columns.column[some]
    shown = sorted({len(choice.signals) // 10, len(choice.signals) // 2, (len(choice.signals) - 1) * 9 // 10})
    fx, fy = choice.rules.frequencies
    titles = [
        f"MTF across the columns at {fx:g} cycles per pixel",
        f"MTF along them at {fy:g} cycles per pixel",
        "SNR of the sum",
    ]
    figure = panels(3, 660, gap_px=40.0, top=46, shared_xaxes=True, subplot_titles=titles)
    series = (choice.mtf[..., 0], choice.mtf[..., 1], choice.snr)
    for row, values in enumerate(series, 1):
        for s, colour in zip(shown, AXIS_COLOURS, strict=False):
            name = f"{choice.signals[s]:.3g} electrons a line"
            figure.add_scatter(
                x=x, y=values[some, s], mode="lines" if len(x) > 1 else "markers", name=name,
                line={"color": colour, "width": 1.4}, legendgroup=name, showlegend=row == 1, row=row, col=1,
            )  # fmt: skip
    figure.add_scatter(
        x=x, y=choice.columns.static_mtf[some, 0], mode="lines", name="without motion, across",
        line={"color": MUTED, "width": 1.0, "dash": "dot"}, row=1, col=1,
    )  # fmt: skip
    for row in (1, 2):
        figure.update_yaxes(title_text="MTF", rangemode="tozero", row=row)
    figure.update_yaxes(title_text="SNR", type="log", row=3)
    figure.update_xaxes(title_text="column", row=3)
    return figure


def merit_figure(result: TdiResult) -> go.Figure:
    """Merit over stages and integration ratio for the first, the middle and the last column."""
    from plotly.subplots import make_subplots

    view, choice = result.landscape, result.choice
    names = [f"column {choice.columns.column[c]:.0f}" for c in view.columns]
    figure = make_subplots(
        rows=1, cols=len(names), shared_yaxes=True, horizontal_spacing=0.05, subplot_titles=names
    )
    figure.update_layout(template=TEMPLATE, height=390, margin_t=58)
    figure.update_annotations(font_size=12)
    grid = choice.grid
    for k, c in enumerate(view.columns):
        best = float(view.merit[k].max())
        figure.add_contour(
            x=grid.stages, y=grid.ratios, z=view.merit[k].T / best if best > 0.0 else view.merit[k].T,
            zmin=0.0, zmax=1.0, colorscale=SEQUENTIAL, contours={"start": 0.1, "end": 0.95, "size": 0.05},
            line={"width": 0.4, "color": "white"}, row=1, col=k + 1, showscale=k == 0,
            colorbar={"title": {"text": "merit over the best", "side": "right"}, "thickness": 12},
            hovertemplate="%{x} stages, ratio %{y:.3g}: %{z:.3f} of the best<extra></extra>",
        )  # fmt: skip
        figure.add_scatter(
            x=[choice.stages[c, view.signal]], y=[choice.integration_ratio[c, view.signal]], mode="markers",
            marker={"symbol": "x", "size": 11, "color": "#ffffff", "line": {"width": 1, "color": INK}},
            name="chosen", showlegend=k == 0, row=1, col=k + 1,
        )  # fmt: skip
        figure.update_xaxes(title_text="TDI stages", row=1, col=k + 1)
    figure.update_yaxes(title_text="integration time over line period", row=1, col=1)
    figure.update_layout(legend={"y": 1.06})
    return figure


def table_figure(result: TdiResult) -> go.Figure:
    """Merit that the table loses over column and signal."""
    found, columns = result.table_loss, result.choice.columns.column
    figure = panels(1, 380, top=24)
    figure.add_heatmap(
        x=columns[found.columns], y=found.signals, z=100.0 * found.loss.T, colorscale="YlOrRd", zmin=0.0,
        zmax=100.0 * result.certificate.max_loss, colorbar=_bar("merit lost (%)", 1, 1),
        hovertemplate="column %{x:.0f}, %{y:.4g} e-: %{z:.3f} %<extra></extra>",
    )  # fmt: skip
    _signal_axis(figure, found.signals, 1)
    figure.update_xaxes(title_text="column")
    return figure


def others_figure(result: TdiResult) -> go.Figure:
    """Merit that other ways of choosing lose, along the columns, averaged over the signals."""
    figure = panels(1, 360, top=64)
    for way, colour in zip((result.one_setting, result.one_signal, result.patent), AXIS_COLOURS, strict=True):
        figure.add_scatter(
            x=result.choice.columns.column[way.columns], y=100.0 * way.loss.mean(axis=1),
            mode="lines" if len(way.columns) > 1 else "markers",
            name=f"{way.name} (mean {100.0 * way.loss.mean():.3g} %)", line={"color": colour, "width": 1.6},
        )  # fmt: skip
    figure.update_yaxes(title_text="merit lost, mean over the signals (%)", rangemode="tozero")
    figure.update_xaxes(title_text="column")
    return figure
