"""Figures of a solved sequence along time: residuals, six parameters, their sigmas.

Not here: the trajectory (``sequence_trajectory_figure.py``), what frames share
(``sequence_overlap_figure.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots

from sightline.report.reduce import envelope_rows
from sightline.report.sequence_view import PARAMETERS, SequenceView
from sightline.report.style import AXIS_COLOURS, INK, MUTED, TEMPLATE, faint, panels, rules

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
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
#: Length of a pause as drawn over what was flown; ticks along time; pauses up to which each has a rule.
_GAP, _TICKS, MOST_RULES = 0.03, 8, 30
#: Largest over smallest value that a logarithmic axis shows at least.
_LEAST_RANGE = 4.0
_IDLE = {"size": 8, "color": KIND_COLOURS[2], "symbol": "x"}
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


def dot_size(marked: NDArray[np.bool_]) -> float:
    """px of marks that are so many that large ones would hide the curve."""
    return 6.0 if marked.sum() <= 60 else 3.0


def small(values: Array) -> Array32:
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


def at(values: Array, rows: Index) -> Array32:
    """Values of rows, NaN for rows of -1 and where they are not finite."""
    out = np.where(rows >= 0, values[rows], np.nan)
    return small(np.where(np.isfinite(out), out, np.nan))


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """Time as it is drawn: pauses between stretches shortened.

    Attributes
    ----------
    x : (M,)
        s; place of each frame.
    breaks : tuple of float
        Middles of the pauses.
    ticks, labels : tuple
        Places, and the times there.
    title : str
    """

    x: Array
    breaks: tuple[float, ...]
    ticks: tuple[float, ...]
    labels: tuple[str, ...]
    title: str


def time_axis(view: SequenceView, epoch: str | None) -> TimeAxis:
    """Time of a flight whose pauses would leave little room for what was flown."""
    groups = view.of_stretches()
    flown = sum(float(np.ptp(view.t[rows])) for rows in groups) or 1.0
    gap, x, start = _GAP * flown, np.array(view.t), float(view.t[0])
    breaks, ticks, labels = [], [], []
    step = _nice(flown / _TICKS)
    for number, rows in enumerate(groups):
        first, last = float(view.t[rows[0]]), float(view.t[rows[-1]])
        x[rows] = start + view.t[rows] - first
        own = step * np.arange(np.ceil(first / step - 1e-9), np.floor(last / step + 1e-9) + 1)
        own = own if len(own) else np.array([first])
        if len(groups) <= _TICKS or number % -(-len(groups) // _TICKS) == 0:
            shown = own if len(groups) <= 4 else own[:1]
            ticks += (start + shown - first).tolist()
            labels += [f"{value:.10g}" for value in np.round(shown, 9) + 0.0]
        start += last - first + gap
        breaks.append(start - 0.5 * gap)
    title = f"time (s from {epoch})" if epoch else "time (s)"
    if len(groups) > 1:
        title += ", pauses between stretches shortened"
    return TimeAxis(x, tuple(breaks[:-1]), tuple(ticks), tuple(labels), title)


def _nice(value: float) -> float:
    """1, 2 or 5 of some decade, not less than value."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(next(m * decade for m in (1.0, 2.0, 5.0, 10.0) if m * decade >= value * (1.0 - 1e-9)))


def _draw_axis(figure: go.Figure, axis: TimeAxis, rows: int, columns: int = 1) -> None:
    """The same times under all panels, and a rule in every pause."""
    rim = 0.015 * (float(np.ptp(axis.x)) or 1.0)
    figure.update_xaxes(
        range=[float(axis.x.min()) - rim, float(axis.x.max()) + rim], tickvals=axis.ticks,
        ticktext=axis.labels, showticklabels=False,
    )  # fmt: skip
    for column in range(1, columns + 1):
        figure.update_xaxes(title_text=axis.title, showticklabels=True, row=rows, col=column)
    if len(axis.breaks) <= MOST_RULES:
        rules(figure, axis.breaks)


def _line(
    figure: go.Figure, view: SequenceView, axis: TimeAxis, values: Array, row: int, name: str, colour: str,
    unit: str, **options: Any,
) -> None:  # fmt: skip
    """A curve against time, broken between stretches."""
    rows = line_rows(view, values)
    group, width = options.pop("group", name), options.pop("width", 1.4)
    figure.add_scatter(
        x=at(axis.x, rows), y=at(values, rows), row=row, col=options.pop("col", 1), mode="lines", name=name,
        line={"color": colour, "width": width, "dash": options.pop("dash", "solid")}, legendgroup=group,
        hovertemplate=f"{name}: %{{y:.3g}} {unit}<extra></extra>", **options,
    )  # fmt: skip


def _dots(
    figure: go.Figure, view: SequenceView, axis: TimeAxis, which: Index, values: Array, row: int, name: str,
    **options: Any,
) -> None:  # fmt: skip
    """Some frames as dots against time."""
    rows = thinned(which[np.isfinite(values[which])])
    if not len(rows):
        return
    unit = options.pop("unit")
    figure.add_scatter(
        x=small(axis.x[rows]), y=small(values[rows]), row=row, col=options.pop("col", 1), mode="markers",
        name=name, legendgroup=name, marker=options.pop("marker"),
        customdata=np.column_stack([rows, small(view.t[rows])]),
        hovertemplate=f"{name}<br>frame no. %{{customdata[0]:.0f}}, t = %{{customdata[1]:.6g}} s: "
        f"%{{y:.3g}} {unit}<extra></extra>",
        **options,
    )  # fmt: skip


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
    every, axis = np.arange(len(view.t)), time_axis(view, epoch)
    tried = view.rejected + view.sightings
    share = np.where(tried > 0, 100.0 * view.rejected / np.maximum(tried, 1), np.nan)
    curves = ((view.rms_px, "px"), (view.sightings.astype(np.float64), "sightings"), (share, "%"))
    for row, (values, unit) in enumerate(curves, 1):
        first = row == 1
        _line(figure, view, axis, values, row, "all frames", KIND_COLOURS[1], unit, showlegend=first)
        _dots(
            figure, view, axis, every[view.in_subset], values, row, KIND_NAMES[0], showlegend=first,
            unit=unit, marker={"size": dot_size(view.in_subset), "color": KIND_COLOURS[0]},
        )  # fmt: skip
        _dots(
            figure, view, axis, every[view.kind == 2], np.nan_to_num(values), row, KIND_NAMES[2],
            showlegend=first, unit=unit, marker=_IDLE, cliponaxis=False,
        )  # fmt: skip
        figure.update_yaxes(title_text=unit if row != 2 else "number", row=row)
        top = float(np.nanmax(values)) if np.isfinite(values).any() else 1.0
        if row == 1 and np.isfinite(view.noise_px).any():
            top = max(top, float(np.nanmax(view.noise_px)))
        figure.update_yaxes(range=[0.0, 1.08 * top if top > 0.0 else 1.0], row=row)
    _line(
        figure, view, axis, view.noise_px, 1, "matching noise, as the matcher states it", MUTED, "px",
        dash="dot",
    )  # fmt: skip
    _draw_axis(figure, axis, 3)
    return figure


def departure_figure(view: SequenceView, epoch: str | None) -> go.Figure:
    """Six parameters less an even path: beside what tables told of them, with 95 % bands; and enlarged."""
    titles = [
        text
        for name in PARAMETERS
        for text in (f"{_LONG_NAMES[name]}, from an even path", "the line by itself")
    ]
    height, gap = 1180, 36.0
    figure = make_subplots(
        6, 2, horizontal_spacing=0.1, vertical_spacing=gap / (height - 130), subplot_titles=titles
    )
    figure.update_layout(template=TEMPLATE, height=height, margin_t=_TOP, legend_y=1.02)
    figure.update_annotations(font_size=12)
    every, axis = np.arange(len(view.t)), time_axis(view, epoch)
    for k in range(6):
        unit, colour, first = ("m" if k < 3 else "deg"), AXIS_COLOURS[k % 3], k == 0
        values = view.departure[:, k]
        _dots(
            figure, view, axis, every, view.told_departure[:, k], k + 1, "told by the tables",
            showlegend=first, unit=unit, marker={"size": 4, "color": TOLD, "opacity": 0.8},
        )  # fmt: skip
        rows = line_rows(view, values)
        _band(figure, at(axis.x, rows), at(values, rows), at(view.sigma[:, k], rows), k + 1, colour)
        for column in (1, 2):
            shown = first and column == 1
            _line(figure, view, axis, values, k + 1, "found", colour, unit, showlegend=shown, col=column)
            _dots(
                figure, view, axis, every[view.kind == 2], values, k + 1, KIND_NAMES[2], showlegend=shown,
                unit=unit, marker=_IDLE, col=column,
            )  # fmt: skip
        figure.update_yaxes(
            title_text=unit, row=k + 1, zeroline=True, zerolinecolor="#d8dee4", exponentformat="power"
        )
    figure.add_scatter(
        x=[None], y=[None], mode="lines", line={"color": faint(AXIS_COLOURS[0], 0.35), "width": 10},
        name="95 % interval of the absolute value",
    )  # fmt: skip
    _draw_axis(figure, axis, 6, 2)
    return figure


def _band(
    figure: go.Figure, x: Array32, y: Array32, sigma: Array32,
    row: int, colour: str,
) -> None:  # fmt: skip
    """95 % of a curve, one polygon per unbroken piece."""
    good = np.isfinite(x) & np.isfinite(y) & np.isfinite(sigma)
    ends = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.int8), [0]])))
    outline_x: list[Array32] = []
    outline_y: list[Array32] = []
    gap = np.full(1, np.nan, dtype=np.float32)
    for start, stop in zip(ends[::2], ends[1::2], strict=True):
        piece = slice(start, stop)
        half = SIGMA_95 * sigma[piece]
        outline_x += [x[piece], x[piece][::-1], gap]
        outline_y += [y[piece] + half, (y[piece] - half)[::-1], gap]
    if outline_x:
        figure.add_scatter(
            x=np.concatenate(outline_x), y=np.concatenate(outline_y), row=row, col=1, mode="lines",
            line={"width": 0}, fill="toself", fillcolor=faint(colour, 0.18), hoverinfo="skip",
            showlegend=False,
        )  # fmt: skip


def sigma_figure(view: SequenceView, epoch: str | None) -> go.Figure:
    """1-sigma of six parameters and of the ground under each frame, against time, logarithmic."""
    figure = panels(
        3, 760, gap_px=46.0, top=_TOP + 20, shared_xaxes=True,
        subplot_titles=[
            "1-sigma of the position", "1-sigma of the angles",
            "1-sigma of where the middle of each frame meets the ground",
        ],
    )  # fmt: skip
    axis = time_axis(view, epoch)
    worst, best = view.ground_sigma_px.T
    drawn: list[list[Array]] = [[], [], [worst, best]]
    for k, name in enumerate(PARAMETERS):
        row, unit, group = (
            1 + k // 3,
            "m" if k < 3 else "deg",
            f"{PARAMETERS[k % 3]}, {PARAMETERS[k % 3 + 3]}",
        )
        colour = AXIS_COLOURS[k % 3]
        # curves of one value lie on each other: the lower ones look out
        options = {"group": group, "showlegend": False, "width": (4.2, 2.6, 1.2)[k % 3]}
        _line(figure, view, axis, view.sigma[:, k], row, name, colour, unit, **options)
        drawn[row - 1].append(view.sigma[:, k])
        if np.isfinite(view.told_sigma[:, k]).any():
            label = f"{name}, a single row of the tables"
            _line(
                figure, view, axis, view.told_sigma[:, k], row, label, faint(colour, 0.7), unit, dash="dot",
                **(options | {"width": 1.4}),
            )  # fmt: skip
            drawn[row - 1].append(view.told_sigma[:, k])
        if k < 3:
            _key(figure, group, colour, group=group)
    for values, name, colour in (
        (worst, "ground, worst direction", INK),
        (best, "ground, best direction", MUTED),
    ):
        _line(figure, view, axis, values, 3, name, colour, "px")
    if np.isfinite(view.told_sigma).any():
        _key(figure, "dotted: a single row of the tables", MUTED, dash="dot")
    idle = np.flatnonzero(view.kind == 2)
    for row, marked in enumerate([*drawn[:2], [worst]], 1):
        _dots(
            figure, view, axis, idle, marked[0], row, KIND_NAMES[2], unit="", marker=_IDLE,
            showlegend=row == 3,
        )  # fmt: skip
    for row, (unit, values) in enumerate(zip(("m", "deg", "px"), drawn, strict=True), 1):
        _log_axis(figure, row, unit, values)
    _draw_axis(figure, axis, 3)
    return figure


def _key(figure: go.Figure, name: str, colour: str, dash: str = "solid", group: str = "") -> None:
    """An entry of the legend without a curve of its own."""
    figure.add_scatter(
        x=[None], y=[None], mode="lines", line={"color": colour, "dash": dash, "width": 1.6}, name=name,
        legendgroup=group or name,
    )  # fmt: skip


def _log_axis(figure: go.Figure, row: int, unit: str, values: list[Array]) -> None:
    """Logarithmic ordinate of half a decade at least; 1, 2 and 5 of each decade where they are few."""
    whole = np.concatenate(values)
    finite = whole[np.isfinite(whole) & (whole > 0.0)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.1, 1.0)
    spread = max(_LEAST_RANGE / (high / low), 1.0) ** 0.5 * 1.15
    low, high = low / spread, high * spread
    ticks = [m * 10.0**k for k in range(-9, 10) for m in (1, 2, 5)]
    ticks = ticks[::3] if high > 300.0 * low else ticks
    figure.update_yaxes(
        type="log", title_text=f"{unit} (logarithmic)", row=row, tickvals=ticks,
        ticktext=[f"{tick:.15g}" for tick in ticks], range=[np.log10(low), np.log10(high)],
    )  # fmt: skip
    if not len(finite):
        figure.add_annotation(
            text="not known: nothing ties it", showarrow=False, xref="x domain",
            yref=f"y{row if row > 1 else ''} domain", x=0.5, y=0.5, font={"color": MUTED, "size": 13},
        )  # fmt: skip
