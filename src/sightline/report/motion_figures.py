"""Figures of the motion against time: attitude with its sigma, a closer look, the sigma itself.

Not here: its spectrum (``spectrum_figures.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.evaluation.score import remove_directions
from sightline.io.formats.tables import MotionTable
from sightline.motion.results import LineOfSight
from sightline.report.figure import Figure, Panel
from sightline.report.marks import Between, Line, Points, Spans
from sightline.report.reduce import cell_edges, cell_means, runs
from sightline.report.style import AXES, AXIS_COLOURS, AXIS_UNITS, BLIND, INK

Array = NDArray[np.float64]
#: Fewer epochs than this (frames of a matrix instrument) are drawn one by one, with error bars.
FEW_EPOCHS = 60
#: Largest over smallest sigma below which a linear scale has more ticks than a log one.
LINEAR_BELOW = 3.0
#: Lines of the closer look.
CLOSE_LINES = 160


def visible_motion_px(result: LineOfSight, motion: MotionTable | None = None) -> Array:
    """A motion in px (yaw: px at the field edge), (N, 3), less what the images cannot see.

    Parameters
    ----------
    result : LineOfSight
    motion : MotionTable, optional
        Over the span of the result, at whose times it is taken; its own where none is given.
    """
    t, angles = result.motion.t, result.motion.angles
    if motion is not None:
        angles = np.stack([np.interp(t, motion.t, own) for own in motion.angles.T], axis=1)
    return remove_directions(angles / result.scale, result.hidden, result.scale)


def attitude_figure(result: LineOfSight, truth: MotionTable | None = None) -> Figure:
    """Roll, pitch and yaw against time with their 1-sigma band, in px and as angles; the truth over them."""
    return _attitude(result, truth, slice(0, len(result.motion.t)))


def close_figure(result: LineOfSight, truth: MotionTable | None = None) -> Figure | None:
    """The same over some lines where the motion is at its fastest; None where there are too few."""
    if len(result.motion.t) < 2 * CLOSE_LINES:
        return None
    speed = np.abs(np.diff(visible_motion_px(result)[:, :2], axis=0)).sum(axis=1)
    first = int(np.argmax(np.convolve(speed, np.ones(CLOSE_LINES), mode="valid")))
    return _attitude(result, truth, slice(first, first + CLOSE_LINES), dotted=3.5)


def sigma_figure(result: LineOfSight) -> Figure:
    """1-sigma of each axis against time, px: its rms over short pieces."""
    figure, t = Figure(height=240), result.motion.t
    panel, edges = figure[0], cell_edges(len(t))
    instants = cell_means(t[:, None], edges)[:, 0]
    drawn = []
    for axis, name in enumerate(AXES):
        label = f"{name} ({AXIS_UNITS[axis]})"
        for sigma, words, dash in (
            (result.sigma, label, "solid"),
            (result.absolute_sigma, f"{label}, unobservable part included", "dot"),
        ):
            if np.isfinite(sigma[:, axis]).all():
                y = np.sqrt(cell_means(sigma[:, axis, None] ** 2, edges)[:, 0]) / result.scale[axis]
                drawn.append(y)
                dots = 5.0 if len(t) < FEW_EPOCHS else 0.0
                panel.add(
                    Line(x=instants, y=y, name=words, colour=AXIS_COLOURS[axis], dash=dash, dotted=dots)
                )
    _shade_unseen(panel, result, slice(0, len(t)))
    panel.x.title, panel.y.title = "time from the epoch (s)", "1-sigma (px)"
    every = np.concatenate(drawn)
    panel.y.log = bool(every.min() > 0.0 and every.max() >= LINEAR_BELOW * every.min())
    return figure


def _attitude(result: LineOfSight, truth: MotionTable | None, part: slice, dotted: float = 0.0) -> Figure:
    figure, t = Figure(3, height=175), result.motion.t[part]
    few = len(result.motion.t) < FEW_EPOCHS
    motion = visible_motion_px(result)
    true = None if truth is None else visible_motion_px(result, truth)
    for axis, (name, colour) in enumerate(zip(AXES, AXIS_COLOURS, strict=True)):
        panel, scale = figure[axis], float(result.scale[axis])
        values, sigma = motion[part, axis], result.sigma[part, axis] / scale
        words = f"{name} ± 1 sigma"
        if few:
            panel.add(Points(x=t, y=values, sigma=sigma, name=words, colour=colour))
        else:
            panel.add(
                Between(
                    x=t, low=values - sigma, high=values + sigma, name=words, colour=colour, opacity=0.30
                ),
                Line(x=t, y=values, name=name, colour=colour, width=1.2, dotted=dotted),
            )
        if true is not None:
            panel.add(Line(x=t, y=true[part, axis], name="truth", colour=INK, dash="dash", width=1.1))
        _shade_unseen(panel, result, part)
        micro = scale * float(np.abs(values).max() + sigma.max()) < 1e-3
        panel.right = (1e6 * scale, "µrad") if micro else (1e3 * scale, "mrad")
        panel.y.title = f"{name} ({AXIS_UNITS[axis]})"
    figure[0].x.title, figure[0].x.tight = "time from the epoch (s)", not few
    return figure


def _shade_unseen(panel: Panel, result: LineOfSight, part: slice) -> None:
    """Shade where no match speaks."""
    t = result.motion.t[part]
    gaps = [(t[first], t[last]) for first, last in runs(~result.observed[part])]
    if gaps:
        panel.add(Spans(spans=gaps, name="seen by no match", colour=BLIND))
