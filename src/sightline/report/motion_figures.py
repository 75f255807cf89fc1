"""Figures of the motion against time: attitude with its sigma, a closer look, the sigma itself.

Not here: its spectrum (``spectrum_figures.py``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from sightline.applications.results import LineOfSight
from sightline.evaluation.score import remove_directions
from sightline.report.reduce import cell_edges, cell_means, envelope_rows, runs
from sightline.report.style import AXES, AXIS_COLOURS, AXIS_UNITS, BLIND, MUTED, faint, panels

Array = NDArray[np.float64]

#: Fewer epochs than this (frames of a matrix instrument) are drawn one by one, with error bars.
FEW_EPOCHS = 60
#: Largest over smallest sigma below which a linear scale has more ticks than a log one, and below which a log
#: scale needs one at every digit.
LINEAR_BELOW, DIGITS_BELOW = 3.0, 8.0
#: Lines of the closer look.
CLOSE_LINES = 160


def visible_motion_px(result: LineOfSight) -> Array:
    """The motion in px (yaw: px at the field edge), (N, 3), less what the images cannot see."""
    hidden_px = result.hidden / result.scale[:, None]
    return remove_directions(result.motion.angles / result.scale, hidden_px)


def attitude_figure(result: LineOfSight) -> go.Figure:
    """Roll, pitch and yaw against time with their 1-sigma band, in px and as angles."""
    everything = slice(0, len(result.motion.t))
    return _attitude(result, visible_motion_px(result), everything, height=640)


def close_figure(result: LineOfSight) -> go.Figure | None:
    """The same over some lines where the motion is at its fastest; None where there are too few."""
    n = len(result.motion.t)
    if n < 2 * CLOSE_LINES:
        return None
    motion = visible_motion_px(result)
    speed = np.abs(np.diff(motion[:, :2], axis=0)).sum(axis=1)
    moving = np.convolve(speed, np.ones(CLOSE_LINES), mode="valid")
    first = int(np.argmax(moving))
    return _attitude(result, motion, slice(first, first + CLOSE_LINES), height=560, markers=True)


def sigma_figure(result: LineOfSight) -> go.Figure:
    """1-sigma of each axis against time, px, log scale: its rms over short pieces."""
    figure = panels(1, 330)
    t = result.motion.t
    edges = cell_edges(len(t))
    instants = cell_means(t[:, None], edges)[:, 0]
    for axis, name in enumerate(AXES):
        label, colour = f"{name} ({AXIS_UNITS[axis]})", AXIS_COLOURS[axis]
        for sigma, words, dash in (
            (result.sigma, label, "solid"),
            (result.absolute_sigma, f"{label}, hidden part included", "dot"),
        ):
            if np.isfinite(sigma[:, axis]).all():
                typical = np.sqrt(cell_means(sigma[:, axis, None] ** 2, edges)[:, 0]) / result.scale[axis]
                line = {"color": colour, "dash": dash, "width": 1.5}
                figure.add_scatter(x=instants, y=typical, name=words, mode=_mode(len(t)), line=line)
    _shade_unseen(figure, result, slice(0, len(t)))
    figure.update_xaxes(title_text="time from the epoch (s)")
    drawn = np.concatenate([np.asarray(curve.y, dtype=float) for curve in figure.data])
    figure.update_yaxes(title_text="1-sigma (px)", tickformat=".3~g", **_sigma_scale(drawn))
    return figure


def _sigma_scale(drawn: Array) -> dict[str, Any]:
    """A log scale with ticks at 1, 2, 5, or at every digit; a linear one where these are too few."""
    ratio = float(drawn.max() / drawn.min())
    if ratio < LINEAR_BELOW:
        return {"type": "linear"}
    return {
        "type": "log",
        "exponentformat": "power",
        "minor_ticks": "",
        "dtick": "D1" if ratio < DIGITS_BELOW else "D2",
    }


def _attitude(
    result: LineOfSight, motion: Array, part: slice, *, height: int, markers: bool = False
) -> go.Figure:
    figure = panels(3, height, shared_xaxes=True, specs=[[{"secondary_y": True}]] * 3)
    t = result.motion.t[part]
    few = len(result.motion.t) < FEW_EPOCHS
    for axis, name in enumerate(AXES):
        values, sigma = motion[part, axis], result.sigma[part, axis] / result.scale[axis]
        colour = AXIS_COLOURS[axis]
        row: dict[str, Any] = {"row": axis + 1, "col": 1}
        if few:
            bars = {"type": "data", "array": sigma, "thickness": 1.2}
            figure.add_scatter(
                x=t,
                y=values,
                error_y=bars,
                mode="markers",
                marker_color=colour,
                name=f"{name} ± 1 sigma",
                **row,
            )
        else:
            rows = envelope_rows(values)
            _add_band(figure, t[rows], values[rows], sigma[rows], colour, name, row)
            mode = "lines+markers" if markers else "lines"
            line, marker = {"color": colour, "width": 1.2}, {"size": 3.5, "color": colour}
            figure.add_scatter(
                x=t[rows], y=values[rows], mode=mode, line=line, marker=marker, name=name, **row
            )
        _add_angle_scale(figure, t, values, sigma, float(result.scale[axis]), axis)
    _shade_unseen(figure, result, part)
    margin = 0.02 * (t[-1] - t[0]) if few else 0.0
    figure.update_xaxes(range=[t[0] - margin, t[-1] + margin])
    figure.update_xaxes(title_text="time from the epoch (s)", row=3)
    return figure


def _add_band(
    figure: go.Figure, t: Array, values: Array, sigma: Array, colour: str, name: str, row: dict[str, Any]
) -> None:
    """The band between value - sigma and value + sigma."""
    figure.add_scatter(
        x=np.concatenate([t, t[::-1]]),
        y=np.concatenate([values + sigma, (values - sigma)[::-1]]),
        mode="lines",
        fill="toself",
        fillcolor=faint(colour, 0.30),
        line={"width": 0},
        hoverinfo="skip",
        name=f"{name} ± 1 sigma",
        **row,
    )


def _add_angle_scale(
    figure: go.Figure, t: Array, values: Array, sigma: Array, scale: float, axis: int
) -> None:
    """Ordinate in px on the left, as an angle on the right; only time can be zoomed, so both stay true."""
    low, high = float((values - sigma).min()), float((values + sigma).max())
    margin = 0.06 * max(high - low, 1e-12)
    low, high = low - margin, high + margin
    factor, unit = (1e6, "µrad") if scale * max(-low, high) < 1e-3 else (1e3, "mrad")
    figure.add_scatter(
        x=[t[0]],
        y=[None],
        mode="lines",
        showlegend=False,
        hoverinfo="skip",
        row=axis + 1,
        col=1,
        secondary_y=True,
    )
    left = f"{AXES[axis]} ({AXIS_UNITS[axis]})"
    figure.update_yaxes(title_text=left, range=[low, high], fixedrange=True, row=axis + 1, secondary_y=False)
    figure.update_yaxes(
        title={"text": unit, "font": {"color": MUTED}},
        range=[low * scale * factor, high * scale * factor],
        tickmode="auto",
        nticks=5,
        fixedrange=True,
        showgrid=False,
        row=axis + 1,
        secondary_y=True,
    )


def _shade_unseen(figure: go.Figure, result: LineOfSight, part: slice) -> None:
    """Shade where no match speaks."""
    t = result.motion.t[part]
    gaps = [(t[first], t[last]) for first, last in runs(~result.observed[part])]
    for start, stop in gaps:
        figure.add_vrect(x0=start, x1=stop, fillcolor=BLIND, line_width=0, layer="below")
    if gaps:
        key = {"size": 11, "symbol": "square", "color": BLIND}
        figure.add_scatter(x=[None], y=[None], mode="markers", marker=key, name="seen by no match")


def _mode(epochs: int) -> str:
    return "lines+markers" if epochs < FEW_EPOCHS else "lines"
