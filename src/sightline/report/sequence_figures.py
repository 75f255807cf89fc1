"""Figures of a solved sequence along time: residuals, six parameters, their sigmas.

Not here: the trajectory (``sequence_trajectory_figure.py``), what frames share
(``sequence_overlap_figure.py``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from sightline.report.reduce import envelope_rows
from sightline.report.sequence_view import PARAMETERS, SequenceView
from sightline.report.style import AXIS_COLOURS, INK, MUTED, faint, panels

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Colour and name of how a pose came about, in the order of `sequence_view.KINDS`.
KIND_COLOURS = ("#c1502e", "#2f6ca3", "#d69e2e")
KIND_NAMES = ("solved (subset)", "estimated", "interpolated: no image evidence")
TOLD = "#9aa4ae"
#: Sigmas that hold one number 95 times in 100.
SIGMA_95 = 1.96
#: Most points of one curve, dots of one cloud: a page of many thousand frames stays small.
CURVE_POINTS, CLOUD_POINTS = 1600, 800
#: A first panel's title and the legend above it.
_TOP = 76
_LONG_NAMES = {
    "east": "East", "north": "North", "up": "Up",
    "roll": "Roll (about body x, forward)", "pitch": "Pitch (about body y, right)",
    "yaw": "Yaw (about body z, down)",
}  # fmt: skip


def thinned(rows: Index, most: int = CLOUD_POINTS) -> Index:
    """At most so many of the rows, evenly."""
    if len(rows) <= most:
        return rows
    return np.asarray(rows[np.unique(np.linspace(0, len(rows) - 1, most).astype(np.intp))])


def small(values: Array) -> NDArray[np.float32]:
    """Numbers of a curve in half the room."""
    return np.asarray(values, dtype=np.float32)


def line_rows(view: SequenceView, values: Array, points: int = CURVE_POINTS) -> Index:
    """Frames that keep the outline of a curve, -1 where its line breaks between stretches."""
    groups = view.of_stretches()
    share = max(points // len(groups), 8)
    parts: list[Index] = []
    for rows in groups:
        # extremes among what is finite; the rest breaks the line where it is
        shown = np.where(np.isfinite(values[rows]), values[rows], np.inf)
        kept = rows[envelope_rows(shown, share)]
        parts += [kept, np.array([-1])]
    return np.concatenate(parts[:-1])


def at(values: Array, rows: Index) -> NDArray[np.float32]:
    """Values of rows, NaN for rows of -1 and where they are not finite."""
    out = np.where(rows >= 0, values[rows], np.nan)
    return small(np.where(np.isfinite(out), out, np.nan))


def _line(
    figure: go.Figure, view: SequenceView, values: Array, row: int, name: str, colour: str,
    unit: str, **options: Any,
) -> None:  # fmt: skip
    """A curve against time, broken between stretches."""
    rows = line_rows(view, values)
    figure.add_scatter(
        x=at(view.t, rows), y=at(values, rows), row=row, col=1, mode="lines", name=name, legendgroup=name,
        line={"color": colour, "width": 1.4, "dash": options.pop("dash", "solid")},
        hovertemplate=f"{name}<br>t = %{{x:.5g}} s: %{{y:.3g}} {unit}<extra></extra>", **options,
    )  # fmt: skip


def _dots(
    figure: go.Figure, view: SequenceView, which: Index, values: Array, row: int, name: str,
    **options: Any,
) -> None:  # fmt: skip
    """Some frames as dots against time."""
    rows = thinned(which[np.isfinite(values[which])])
    if not len(rows):
        return
    unit = options.pop("unit")
    figure.add_scatter(
        x=small(view.t[rows]), y=small(values[rows]), row=row, col=1, mode="markers", name=name,
        legendgroup=name, marker=options.pop("marker"), customdata=rows,
        hovertemplate=f"{name}<br>frame no. %{{customdata}}, t = %{{x:.5g}} s: %{{y:.3g}} {unit}"
        "<extra></extra>",
        **options,
    )  # fmt: skip


def _time_axis(figure: go.Figure, row: int, epoch: str | None) -> None:
    """Name the abscissa of the lowest panel."""
    figure.update_xaxes(title_text=f"time (s from {epoch})" if epoch else "time (s)", row=row)


def residual_figure(view: SequenceView, epoch: str | None) -> go.Figure:
    """Reprojection error, good sightings and share rejected of every frame."""
    figure = panels(
        3, 640, gap_px=46.0, top=_TOP, shared_xaxes=True,
        subplot_titles=[
            "Reprojection error of the sightings kept, rms per coordinate of each frame",
            "Sightings kept in each frame",
            "Share of the sightings rejected as gross errors",
        ],
    )  # fmt: skip
    every = np.arange(len(view.t))
    share = 100.0 * view.rejected / np.maximum(view.rejected + view.sightings, 1)
    share = np.where(view.rejected + view.sightings > 0, share, np.nan)
    curves = ((view.rms_px, "px"), (view.sightings.astype(np.float64), "sightings"), (share, "%"))
    for row, (values, unit) in enumerate(curves, 1):
        _line(figure, view, values, row, "all frames", KIND_COLOURS[1], unit, showlegend=row == 1)
        _dots(
            figure, view, every[view.in_subset], values, row, KIND_NAMES[0], showlegend=row == 1, unit=unit,
            marker={"size": 6, "color": KIND_COLOURS[0]},
        )  # fmt: skip
        _dots(
            figure, view, every[view.kind == 2], np.nan_to_num(values), row, KIND_NAMES[2],
            showlegend=row == 1, unit=unit, marker={"size": 8, "color": KIND_COLOURS[2], "symbol": "x"},
        )  # fmt: skip
        figure.update_yaxes(title_text=f"{unit}" if row != 2 else "number", rangemode="tozero", row=row)
    _line(figure, view, view.noise_px, 1, "as the sightings' stated sigmas say", MUTED, "px", dash="dot")
    _time_axis(figure, 3, epoch)
    return figure


def departure_figure(view: SequenceView, epoch: str | None) -> go.Figure:
    """Six parameters less an even path, with their 95 % bands, and what tables told of them."""
    titles = [f"{_LONG_NAMES[name]}, less an even path of each stretch" for name in PARAMETERS]
    figure = panels(6, 1180, gap_px=42.0, top=_TOP, shared_xaxes=True, subplot_titles=titles)
    every = np.arange(len(view.t))
    for k in range(6):
        unit = "m" if k < 3 else "deg"
        colour = AXIS_COLOURS[k % 3]
        values, first = view.departure[:, k], k == 0
        _dots(
            figure, view, every, view.told_departure[:, k], k + 1, "told by the tables", showlegend=first,
            unit=unit, marker={"size": 3.5, "color": TOLD, "opacity": 0.55},
        )  # fmt: skip
        rows = line_rows(view, values)
        _band(figure, at(view.t, rows), at(values, rows), at(view.sigma[:, k], rows), k + 1, colour)
        _line(figure, view, values, k + 1, "found", colour, unit, showlegend=first)
        _dots(
            figure, view, every[view.kind == 2], values, k + 1, KIND_NAMES[2], showlegend=first, unit=unit,
            marker={"size": 8, "color": KIND_COLOURS[2], "symbol": "x"},
        )  # fmt: skip
        figure.update_yaxes(title_text=unit, row=k + 1, zeroline=True, zerolinecolor="#d8dee4")
    figure.add_scatter(
        x=[None], y=[None], mode="lines", line={"color": faint(AXIS_COLOURS[0], 0.35), "width": 10},
        name="95 % interval of the absolute value",
    )  # fmt: skip
    _time_axis(figure, 6, epoch)
    return figure


def _band(
    figure: go.Figure, x: NDArray[np.float32], y: NDArray[np.float32], sigma: NDArray[np.float32],
    row: int, colour: str,
) -> None:  # fmt: skip
    """95 % of a curve, one polygon per unbroken piece."""
    good = np.isfinite(x) & np.isfinite(y) & np.isfinite(sigma)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.int8), [0]])))
    for start, stop in zip(ends[::2], ends[1::2], strict=True):
        piece = slice(start, stop)
        half = SIGMA_95 * sigma[piece]
        figure.add_scatter(
            x=np.concatenate([x[piece], x[piece][::-1]]),
            y=np.concatenate([y[piece] + half, (y[piece] - half)[::-1]]),
            row=row, col=1, mode="lines", line={"width": 0}, fill="toself", fillcolor=faint(colour, 0.18),
            hoverinfo="skip", showlegend=False,
        )  # fmt: skip


def sigma_figure(view: SequenceView, epoch: str | None) -> go.Figure:
    """1-sigma of six parameters and of the ground under each frame, against time, logarithmic."""
    figure = panels(
        3, 760, gap_px=46.0, top=_TOP, shared_xaxes=True,
        subplot_titles=[
            "1-sigma of the position", "1-sigma of the angles",
            "1-sigma of where the middle of each frame meets the ground",
        ],
    )  # fmt: skip
    curves: list[tuple[int, str, Array, str, str]] = []
    for k, name in enumerate(PARAMETERS):
        curves.append((1 + k // 3, name, view.sigma[:, k], AXIS_COLOURS[k % 3], "m" if k < 3 else "deg"))
    worst, best = view.ground_sigma_px.T
    curves += [(3, "ground, worst direction", worst, INK, "px")]
    curves += [(3, "ground, best direction", best, MUTED, "px")]
    marked = np.flatnonzero(view.kind == 2)
    shown = False
    for row, name, values, colour, unit in curves:
        _line(figure, view, values, row, name, colour, unit)
        known = marked[np.isfinite(values[marked])]
        _dots(
            figure, view, known, values, row, KIND_NAMES[2], unit=unit, showlegend=not shown and len(known) > 0,
            marker={"size": 7, "color": KIND_COLOURS[2], "symbol": "x"},
        )  # fmt: skip
        shown |= len(known) > 0
    for k in range(6):
        told = view.told_sigma[:, k]
        if np.isfinite(told).any():
            _line(
                figure, view, told, 1 + k // 3, f"{PARAMETERS[k]}, single row of the tables",
                faint(AXIS_COLOURS[k % 3], 0.7), "m" if k < 3 else "deg", dash="dot", showlegend=False,
            )  # fmt: skip
    if np.isfinite(view.told_sigma).any():
        figure.add_scatter(
            x=[None], y=[None], mode="lines", line={"color": MUTED, "dash": "dot", "width": 1.4},
            name="dotted: noise of a single row of the tables",
        )  # fmt: skip
    for row, unit in ((1, "m"), (2, "deg"), (3, "px")):
        _log_axis(figure, row, unit, [c[2] for c in curves if c[0] == row])
    _time_axis(figure, 3, epoch)
    return figure


def _log_axis(figure: go.Figure, row: int, unit: str, values: list[Array]) -> None:
    """Logarithmic ordinate of at least a decade, 1, 2 and 5 of each decade where they are few."""
    whole = np.concatenate(values)
    finite = whole[np.isfinite(whole) & (whole > 0.0)]
    ticks = [m * 10.0**k for k in range(-9, 10) for m in (1, 2, 5)]
    if len(finite) and finite.max() > 300.0 * finite.min():
        ticks = ticks[::3]
    figure.update_yaxes(
        type="log", title_text=f"{unit} (logarithmic)", row=row, tickvals=ticks,
        ticktext=[f"{tick:.15g}" for tick in ticks],
    )  # fmt: skip
    if not len(finite):
        figure.add_annotation(
            text="not known: nothing ties it", showarrow=False, xref="x domain", yref=f"y{row} domain",
            x=0.5, y=0.5, font={"color": MUTED, "size": 13},
        )  # fmt: skip
