"""Figures of a choice of layouts: information, places, what a longer span brings, what remains unknown.

Not here: how the layouts were found (``motion/layout/search.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sightline.applications.focal_plane import (
    BALANCED,
    BEST,
    FULL_SPAN,
    LEAST_SIGMA,
    JudgedLayout,
    LayoutChoice,
)
from sightline.motion.layout.sigma import posterior_psd
from sightline.report.figure import Figure
from sightline.report.marks import Line, Points, Spans
from sightline.report.style import AXIS_COLOURS, MUTED, short_label

#: One colour and dash per layout that stands out; the user's and the published ones have their own.
_LOOK = {
    BEST: (AXIS_COLOURS[0], "solid"),
    BALANCED: (AXIS_COLOURS[2], "solid"),
    FULL_SPAN: ("#8a5fa8", "solid"),
    LEAST_SIGMA: ("#a87a08", "solid"),
}
_YOURS = (AXIS_COLOURS[1], "#b8623f", "#7a3b22")
_PUBLISHED = ("#57606a", "#1f8a7d", "#b05fa2")
_POINTS = 2000


def standing_out(choice: LayoutChoice) -> list[JudgedLayout]:
    """The ranked layouts that have a name, then the user's."""
    return [*(x for x in choice.ranked if x.name), *(x for x in choice.compared if x.source == "yours")]


def information_figure(choice: LayoutChoice) -> Figure:
    """Information against frequency, a panel per layout; the band shaded and its worst frequency marked."""
    low, high = choice.passband
    start, top = max(0.0, low - 0.3 * (high - low)), min(choice.highest, high + 0.3 * (high - low))
    shown = [*standing_out(choice), *(x for x in choice.compared if x.source == "published")]
    figure, f = Figure(len(shown), height=95), np.linspace(start, top, _POINTS)
    for panel, layout in zip(figure.panels, shown, strict=True):
        name, count = short_label(layout.name), len(layout.positions)
        worth = layout.information(f) / float(layout.noise.weights.mean())
        panel.title = f"{name} ({count} detectors)"
        panel.add(
            Spans(spans=[(low, high)], colour=AXIS_COLOURS[0], opacity=0.08, name="pass-band"),
            Line(x=f, y=worth, name=name, key=False, colour=_line(choice, layout)["colour"]),
            Points(
                x=[layout.worst_frequency], y=[layout.worst_images], size=8, symbol="ring", right=True,
                name="worst in the band", texts=[f"{layout.worst_images:.2f} at "
                                                 f"{layout.worst_frequency:.4g} Hz"],
            ),
        )  # fmt: skip
        panel.y.low, panel.y.high = -0.04 * count, 1.08 * count
    figure[(len(shown) - 1) // 2].y.title = "information (images' worth)"
    axis = figure[0].x
    axis.title, axis.low, axis.high = "frequency (Hz)", start, top
    return figure


def places_figure(choice: LayoutChoice) -> Figure:
    """Where the detectors of each layout stand along the track."""
    reach = max(x.span for x in choice.ranked)
    shown = [*standing_out(choice), *(x for x in choice.compared if x.source == "published")]
    shown = [x for x in shown if x.span <= 3.0 * reach]
    figure = Figure(height=30 * len(shown) + 20)
    panel = figure[0]
    for k, layout in enumerate(shown):
        look = _line(choice, layout)
        x, y = 1e3 * layout.positions, np.full(len(layout.positions), float(k))
        panel.add(
            Line(x=x, y=y, colour=look["colour"], width=1.0, hover=False),
            Points(
                x=x,
                y=y,
                colour=look["colour"],
                symbol="tick",
                size=18,
                name=short_label(layout.name),
                key=False,
            ),
        )
    panel.y.ticks, panel.y.downward = [(float(k), short_label(x.name)) for k, x in enumerate(shown)], True
    panel.y.low, panel.y.high = -0.6, len(shown) - 0.4
    panel.x.title, panel.x.tight = "time at which each detector sees the ground, after the first (ms)", False
    return figure


def span_figure(choice: LayoutChoice) -> Figure:
    """The best worst case of every span, and what the same layouts know of the whole motion."""
    figure = Figure(2, height=200)
    weight, x = float(choice.best.noise.weights.mean()), 1e3 * choice.spans
    figure[0].add(
        Line(x=x, y=choice.worst_by_span / weight, colour=MUTED, name="best worst case of each span")
    )
    figure[1].add(Line(x=x, y=choice.sigma_by_span, colour=MUTED, name="its sigma", key=False))
    for layout in standing_out(choice):
        if layout.span > 1.05 * float(choice.spans.max()):
            continue
        for panel, value in zip(figure.panels, (layout.worst_images, layout.harmonic_sigma_px), strict=True):
            mark = {"colour": _line(choice, layout)["colour"], "name": short_label(layout.name), "size": 10.0}
            panel.add(Points(x=[1e3 * layout.span], y=[value], **mark))
    figure[0].y.title, figure[0].y.from_zero = "worst case in the band (images' worth)", True
    figure[1].y.title, figure[1].y.log = "posterior sigma (px)", True
    figure[0].x.title, figure[0].x.tight = "span from the first to the last detector (ms)", False
    return figure


def remaining_figure(choice: LayoutChoice) -> Figure:
    """Spectrum of what remains unknown with each layout, beside that of the motion expected."""
    f = np.geomspace(0.2 / choice.duration, choice.highest, 1500)
    figure, motion = Figure(height=360), choice.prior.psd(f)
    panel = figure[0]
    panel.add(Line(x=f, y=motion, name="motion expected", dash="dot"))
    lowest = [float(motion.min())]
    for layout in standing_out(choice):
        left = posterior_psd(f, layout.positions, layout.noise, choice.prior)
        lowest.append(float(left.min()))
        panel.add(Line(x=f, y=left, name=short_label(layout.name), **_line(choice, layout)))
    panel.add(Spans(spans=[choice.passband], colour=AXIS_COLOURS[0], opacity=0.08, name="pass-band"))
    panel.y.title, panel.y.log = "unknown motion (px²/Hz)", True
    panel.y.low, panel.y.high = 0.5 * min(lowest), 2.5 * float(motion.max())
    panel.x.title, panel.x.log = "frequency (Hz)", True
    return figure


def _line(choice: LayoutChoice, layout: JudgedLayout) -> dict[str, Any]:
    """Colour, dash and width of a layout's curves."""
    if layout.source == "found":
        colour, dash = _LOOK.get(layout.name, (MUTED, "solid"))
        return {"colour": colour, "dash": dash, "width": 2.2 if layout.name == BEST else 1.4}
    same = [x.name for x in choice.compared if x.source == layout.source]
    colours: Sequence[str] = _YOURS if layout.source == "yours" else _PUBLISHED
    dash = "dash" if layout.source == "yours" else "solid"
    return {"colour": colours[same.index(layout.name) % len(colours)], "dash": dash, "width": 1.4}
