"""Figures of a choice of layouts: information, places, what a longer span brings, what remains unknown.

Not here: how the layouts were found (``motion/layout_search.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go

from sightline.applications.focal_plane import (
    BALANCED,
    BEST,
    FULL_SPAN,
    LEAST_SIGMA,
    JudgedLayout,
    LayoutChoice,
)
from sightline.motion.layout_sigma import posterior_psd
from sightline.report.style import AXIS_COLOURS, INK, MUTED, label, panels

#: One colour and dash per layout that stands out; the user's and the published ones have their own.
_LOOK = {
    BEST: (AXIS_COLOURS[0], "solid"),
    BALANCED: (AXIS_COLOURS[2], "solid"),
    FULL_SPAN: ("#8a5fa8", "solid"),
    LEAST_SIGMA: ("#b8860b", "solid"),
}
_YOURS = (AXIS_COLOURS[1], "#d98a6f", "#7a3b22")
_PUBLISHED = ("#57606a", "#2a9d8f", "#c77dba")
_POINTS = 3000
_BAND = "rgba(47, 108, 163, 0.08)"


def standing_out(choice: LayoutChoice) -> list[JudgedLayout]:
    """The ranked layouts that have a name, then the user's."""
    return [*(x for x in choice.ranked if x.name), *(x for x in choice.compared if x.source == "yours")]


def information_figure(choice: LayoutChoice) -> go.Figure:
    """Information against frequency, a panel per layout; the band shaded and its worst frequency marked."""
    low, high = choice.passband
    start, top = max(0.0, low - 0.3 * (high - low)), min(choice.highest, high + 0.3 * (high - low))
    shown = [*standing_out(choice), *(x for x in choice.compared if x.source == "published")]
    titles = [f"{label(x.name)} ({len(x.positions)} detectors)" for x in shown]
    figure = panels(
        len(shown), 90 + 128 * len(shown), gap_px=34, top=30, shared_xaxes=True, subplot_titles=titles
    )
    for row, layout in enumerate(shown, 1):
        f = np.linspace(start, top, _POINTS)
        colour = _line(choice, layout)["color"]
        worth = layout.information(f) / float(layout.noise.weights.mean())
        place: dict[str, Any] = {"row": row, "col": 1}
        figure.add_scatter(
            x=f, y=worth, mode="lines", line={"color": colour, "width": 1.4}, showlegend=False,
            name=label(layout.name), **place,
        )  # fmt: skip
        figure.add_scatter(
            x=[layout.worst_frequency], y=[layout.worst_images], mode="markers+text", showlegend=False,
            name="worst in the band", cliponaxis=False,
            marker={"size": 8, "color": INK, "symbol": "circle-open"}, textposition="middle right",
            text=[f"{layout.worst_images:.2f} at {layout.worst_frequency:.4g} Hz"], **place,
        )  # fmt: skip
        figure.add_vrect(x0=low, x1=high, fillcolor=_BAND, line_width=0, layer="below", **place)
        count = len(layout.positions)
        figure.update_yaxes(range=[-0.04 * count, 1.08 * count], dtick=2, **place)
    figure.update_yaxes(title_text="information (images' worth)", row=(len(shown) + 1) // 2)
    figure.update_xaxes(range=[start, top])
    figure.update_xaxes(title_text="frequency (Hz)", row=len(shown))
    return figure


def places_figure(choice: LayoutChoice) -> go.Figure:
    """Where the detectors of each layout stand along the track."""
    reach = max(x.span for x in choice.ranked)
    shown = [*standing_out(choice), *(x for x in choice.compared if x.source == "published")]
    shown = [x for x in shown if x.span <= 3.0 * reach][::-1]
    figure = panels(1, 120 + 34 * len(shown), top=16)
    for layout in shown:
        colour = _line(choice, layout)["color"]
        figure.add_scatter(
            x=1e3 * layout.positions, y=[label(layout.name)] * len(layout.positions), mode="lines+markers",
            line={"color": colour, "width": 1}, showlegend=False, name=label(layout.name),
            marker={"symbol": "line-ns-open", "size": 18, "color": colour, "line": {"width": 3}},
        )  # fmt: skip
    figure.update_xaxes(title_text="time at which each detector sees the ground, after the first (ms)")
    figure.update_layout(margin_l=150)
    return figure


def span_figure(choice: LayoutChoice) -> go.Figure:
    """The best worst case of every span, and what the same layouts know of the whole motion."""
    figure = panels(2, 560, shared_xaxes=True)
    weight = float(choice.best.noise.weights.mean())
    curve: dict[str, Any] = {"mode": "lines", "line": {"color": MUTED, "width": 1.6}, "col": 1}
    x = 1e3 * choice.spans
    figure.add_scatter(
        x=x, y=choice.worst_by_span / weight, name="best worst case of each span", row=1, **curve
    )
    figure.add_scatter(x=x, y=choice.sigma_by_span, showlegend=False, name="its sigma", row=2, **curve)
    for layout in standing_out(choice):
        if layout.span > 1.05 * float(choice.spans.max()):
            continue
        mark = {"size": 10, "color": _line(choice, layout)["color"]}
        values = (layout.worst_images, layout.harmonic_sigma_px)
        for row, value in enumerate(values, 1):
            figure.add_scatter(
                x=[1e3 * layout.span], y=[value], mode="markers", marker=mark, name=label(layout.name),
                legendgroup=layout.name, showlegend=row == 1, row=row, col=1,
            )  # fmt: skip
    figure.update_yaxes(title_text="worst case in the band (images' worth)", rangemode="tozero", row=1)
    figure.update_yaxes(title_text="posterior sigma (px)", type="log", dtick=1, minor_showgrid=True, row=2)
    figure.update_xaxes(title_text="span from the first to the last detector (ms)", row=2)
    return figure


def remaining_figure(choice: LayoutChoice) -> go.Figure:
    """Spectrum of what remains unknown with each layout, beside that of the motion expected."""
    top = choice.highest
    f = np.geomspace(0.2 / choice.duration, top, 2500)
    figure = panels(1, 460)
    motion = choice.prior.psd(f)
    figure.add_scatter(
        x=f, y=motion, name="motion expected", mode="lines", line={"color": INK, "width": 1.4, "dash": "dot"}
    )
    lowest = [float(motion.min())]
    for layout in standing_out(choice):
        left = posterior_psd(f, layout.positions, layout.noise, choice.prior)
        lowest.append(float(left.min()))
        figure.add_scatter(x=f, y=left, name=label(layout.name), line=_line(choice, layout), mode="lines")
    figure.add_vrect(*choice.passband, fillcolor=_BAND, line_width=0, layer="below")
    figure.update_yaxes(
        type="log", exponentformat="power", title_text="unknown motion (px²/Hz)", dtick=1,
        range=[np.log10(min(lowest)) - 0.3, np.log10(float(motion.max())) + 0.4],
    )  # fmt: skip
    figure.update_xaxes(type="log", title_text="frequency (Hz)", dtick=1)
    return figure


def _line(choice: LayoutChoice, layout: JudgedLayout) -> dict[str, Any]:
    """Colour, dash and width of a layout's curves."""
    if layout.source == "found":
        colour, dash = _LOOK.get(layout.name, (MUTED, "solid"))
        return {"color": colour, "dash": dash, "width": 2.2 if layout.name == BEST else 1.4}
    same = [x.name for x in choice.compared if x.source == layout.source]
    colours: Sequence[str] = _YOURS if layout.source == "yours" else _PUBLISHED
    dash = "dash" if layout.source == "yours" else "solid"
    return {"color": colours[same.index(layout.name) % len(colours)], "dash": dash, "width": 1.4}
