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
from sightline.report.words import digits
from sightline.tdi.choose import LIMITS

#: Columns drawn of a map at most.
DRAWN = 600
#: Columns that are all named on an axis.
FEW_COLUMNS = 12
SEQUENTIAL = "Viridis"
#: Widths of lines that may lie on one another, px: each is seen beside the thinner one on top of it.
WIDTHS = (5.0, 2.8, 1.2)
#: What no setting serves.
NOTHING = "#c3c9d0"
#: One colour per limit, in the order of `LIMITS`; paler where the limit decides, darker where none keeps it.
LIMIT_COLOURS = (
    "#eef1f4", "#f2b8a0", "#f3d98b", "#a8c8e8", "#b5d8b0", "#a03015", "#a37800", "#1f4e86", "#2f6d3a",
)  # fmt: skip


def _drawn(result: TdiResult) -> NDArray[np.intp]:
    """Columns that are drawn, counted from the first."""
    count = len(result.problem.columns)
    return np.unique(np.linspace(0, count - 1, min(count, DRAWN)).round().astype(np.intp))


def electrons(signal: float) -> str:
    """A signal of one line in words."""
    return f"{float(digits(signal, 3)):,.10g} electrons a line"


def _round_numbers(low: float, high: float) -> NDArray[np.float64]:
    """Numbers to write beside a logarithmic scale: decades, with others between where decades are few."""
    between = (
        [1.0] if high > 2e3 * low else [1.0, 2.0, 5.0] if high > 5.0 * low else np.arange(1.0, 10.0, 0.5)
    )
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1.0)
    return np.sort([d * 10.0**k for k in decades for d in between])


def _log_ticks(low: float, high: float) -> dict[str, Any]:
    """Ticks of a logarithmic axis with every number in full; plotly writes bare digits between decades."""
    values = _round_numbers(low, high)
    return {"tickvals": values, "ticktext": [f"{v:,.10g}" for v in values]}


def _bar(title: str, row: int, rows: int) -> dict[str, Any]:
    """Scale beside the panel `row` of `rows`."""
    return {
        "title": {"text": title, "side": "right", "font": {"size": 11}},
        "len": 0.92 / rows, "y": 1.0 - (row - 0.5) / rows, "thickness": 12, "outlinewidth": 0,
    }  # fmt: skip


def _colour_scale(values: NDArray[Any], *, logarithmic: bool) -> dict[str, Any]:
    """Range of colours, and numbers beside them; one number where all values are alike."""
    low, high = float(values.min()), float(values.max())
    to = np.log10 if logarithmic else np.asarray
    if low == high:
        level = float(to(low))
        return {"zmin": level - 0.5, "zmax": level + 0.5, "tickvals": [level], "ticktext": [f"{low:g}"]}
    inner = _round_numbers(low, high) if logarithmic else np.linspace(low, high, 5)
    # the ends are always written: round numbers close to them would lie on them
    room = 0.07 * float(to(high) - to(low))
    inner = inner[(to(inner) > to(low) + room) & (to(inner) < to(high) - room)]
    shown = np.array([low, *inner, high])
    return {
        "zmin": float(to(low)), "zmax": float(to(high)),
        "tickvals": to(shown), "ticktext": [f"{value:.3g}" for value in shown],
    }  # fmt: skip


def settings_figure(result: TdiResult) -> go.Figure:
    """Maps of the chosen stages and integration ratios over column and signal."""
    choice, some = result.choice, _drawn(result)
    titles = ["Chosen number of TDI stages", "Chosen integration time, as a share of the line period"]
    figure = panels(2, 640, gap_px=52.0, top=30, shared_xaxes=True, subplot_titles=titles)
    for row, (values, name, logarithmic) in enumerate(
        ((choice.stages[some], "stages", True), (choice.integration_ratio[some], "integration ratio", False)),
        1,
    ):
        scale = _colour_scale(values, logarithmic=logarithmic)
        figure.add_heatmap(
            x=choice.columns.column[some], y=choice.signals, row=row, col=1, colorscale=SEQUENTIAL,
            z=(np.log10(values) if logarithmic else values).T, zmin=scale.pop("zmin"), zmax=scale.pop("zmax"),
            customdata=values.T, colorbar=_bar(name, row, 2) | scale,
            hovertemplate="column %{x:.0f}, %{y:.4g} e-: %{customdata:g}<extra></extra>",
        )  # fmt: skip
        _signal_axis(figure, choice.signals, row)
    _column_axis(figure, choice.columns.column, 2)
    return figure


def _column_axis(figure: go.Figure, columns: NDArray[Any], row: int) -> None:
    """Numbers of columns, of which there are no halves."""
    figure.update_xaxes(title_text="column", row=row)
    if len(columns) <= FEW_COLUMNS:
        figure.update_xaxes(tickvals=columns, row=row)


def _signal_axis(figure: go.Figure, signals: NDArray[np.float64], row: int) -> None:
    figure.update_yaxes(title_text="signal of one line (e-)", row=row)
    if len(signals) > 1:
        figure.update_yaxes(type="log", row=row, **_log_ticks(signals[0], signals[-1]))
    else:
        figure.update_yaxes(tickvals=signals, row=row)


def quality_figure(result: TdiResult) -> go.Figure:
    """MTF and SNR of the choice along the columns, for a low, a middle and a high signal."""
    choice, some = result.choice, _drawn(result)
    x = choice.columns.column[some]
    shown = sorted({len(choice.signals) // 10, len(choice.signals) // 2, (len(choice.signals) - 1) * 9 // 10})
    fx, fy = choice.rules.frequencies
    titles = [
        f"MTF across the columns of the chosen settings, at {fx:g} cycles per pixel",
        f"MTF along the columns of the chosen settings, at {fy:g} cycles per pixel",
        "SNR of the sum of the chosen lines",
    ]
    figure = panels(3, 680, gap_px=44.0, top=46, shared_xaxes=True, subplot_titles=titles)
    mode = "lines" if len(x) > 1 else "markers"
    series = (choice.mtf[..., 0], choice.mtf[..., 1], choice.snr)
    for row, values in enumerate(series, 1):
        for s, colour, width in zip(shown, AXIS_COLOURS, WIDTHS, strict=False):
            name = electrons(choice.signals[s])
            figure.add_scatter(
                x=x, y=values[some, s], mode=mode, name=name, line={"color": colour, "width": width},
                marker={"size": 6.0 + 2.0 * width}, legendgroup=name, showlegend=row == 1, row=row, col=1,
            )  # fmt: skip
    for axis in (0, 1):
        figure.add_scatter(
            x=x, y=choice.columns.static_mtf[some, axis], mode=mode, name="scene at rest", legendgroup="rest",
            line={"color": MUTED, "width": 1.2, "dash": "dot"}, showlegend=axis == 0, row=axis + 1, col=1,
        )  # fmt: skip
        figure.update_yaxes(title_text="MTF", rangemode="tozero", row=axis + 1)
    drawn = choice.snr[some][:, shown]
    low, high = float(drawn.min()), float(drawn.max())
    figure.update_yaxes(title_text="SNR", type="log", row=3, **(_log_ticks(low, high) if low > 0.0 else {}))
    _column_axis(figure, choice.columns.column, 3)
    return figure


def _whole(values: NDArray[Any]) -> list[float]:
    """Range of an axis over a grid, and no more; half a unit beside a single value."""
    low, high = float(values[0]), float(values[-1])
    return [low, high] if high > low else [low - 0.5, high + 0.5]


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
            name="chosen", showlegend=k == 0, cliponaxis=False, row=1, col=k + 1,
        )  # fmt: skip
        figure.update_xaxes(title_text="TDI stages", range=_whole(grid.stages), row=1, col=k + 1)
        figure.update_yaxes(range=_whole(grid.ratios), row=1, col=k + 1)
    figure.update_yaxes(title_text="integration time over line period", row=1, col=1)
    figure.update_layout(legend={"y": 1.06})
    return figure


def stages_figure(result: TdiResult) -> go.Figure:
    """Merit along the stages, at the integration ratio chosen, for the columns of `merit_figure`."""
    view, choice = result.landscape, result.choice
    stages = choice.grid.stages
    figure = panels(1, 360, top=64)
    for k, (c, colour) in enumerate(zip(view.columns, AXIS_COLOURS, strict=False)):
        chosen, ratio = choice.stages[c, view.signal], choice.integration_ratio[c, view.signal]
        merit = view.merit[k][:, int(np.searchsorted(choice.grid.ratios, ratio))]
        share = merit / (view.merit[k].max() or 1.0)
        name = f"column {choice.columns.column[c]:.0f}, integration ratio {ratio:.3g}"
        figure.add_scatter(
            x=stages, y=share, mode="lines", name=name, legendgroup=name, line={"color": colour, "width": 1.6}
        )
        figure.add_scatter(
            x=[chosen], y=share[stages == chosen], mode="markers", showlegend=False, legendgroup=name,
            marker={"symbol": "x", "size": 11, "color": colour}, cliponaxis=False,
        )  # fmt: skip
    figure.update_xaxes(title_text="TDI stages", range=_whole(stages))
    figure.update_yaxes(title_text="merit over the column's best", rangemode="tozero")
    return figure


def limit_figure(result: TdiResult) -> go.Figure:
    """Map of what decided, over column and signal."""
    choice, some = result.choice, _drawn(result)
    there = np.unique(choice.limit)
    count = len(there)
    number = np.searchsorted(there, choice.limit[some])
    steps = [(edge / count, LIMIT_COLOURS[code]) for k, code in enumerate(there) for edge in (k, k + 1)]
    figure = panels(1, 380, top=24)
    figure.add_heatmap(
        x=choice.columns.column[some], y=choice.signals, z=number.T, zmin=-0.5, zmax=count - 0.5,
        colorscale=steps, customdata=np.array(LIMITS)[choice.limit[some]].T,
        colorbar=_bar("what decided", 1, 1)
        | {"tickvals": list(range(count)), "ticktext": [LIMITS[code] for code in there]},
        hovertemplate="column %{x:.0f}, %{y:.4g} e-: %{customdata}<extra></extra>",
    )  # fmt: skip
    _signal_axis(figure, choice.signals, 1)
    _column_axis(figure, choice.columns.column, 1)
    return figure


def table_figure(result: TdiResult) -> go.Figure:
    """Merit that the table loses over column and signal; grey where no setting keeps all limits."""
    found, columns = result.table_loss, result.choice.columns.column
    figure = panels(1, 380, top=24)
    figure.add_heatmap(
        x=columns[found.columns], y=found.signals, z=100.0 * found.loss.T, colorscale="YlOrRd", zmin=0.0,
        zmax=100.0 * result.certificate.max_loss, colorbar=_bar("merit lost (%)", 1, 1),
        hovertemplate="column %{x:.0f}, %{y:.4g} e-: %{z:.3f} %<extra></extra>",
    )  # fmt: skip
    _signal_axis(figure, found.signals, 1)
    figure.update_layout(plot_bgcolor=NOTHING)
    figure.update_xaxes(showgrid=False)
    figure.update_yaxes(showgrid=False)
    _column_axis(figure, columns, 1)
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
    _column_axis(figure, result.choice.columns.column, 1)
    return figure
