"""Figures of a solved sequence along time: residuals, six parameters, their sigmas.

Not here: the trajectory (``sequence_trajectory_figure.py``), what frames share
(``sequence_overlap_figure.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.report.figure import Figure, Panel
from sightline.report.marks import Between, Line, Note, Points, Rules, broken
from sightline.report.sequence_view import PARAMETERS, SequenceView
from sightline.report.style import AXIS_COLOURS, BEFORE, DOUBT, INK, MUTED

Array = NDArray[np.float64]
Index = NDArray[np.intp]
#: Colour and name of how a pose came about, in the order of `sequence_view.KINDS`.
KIND_COLOURS = ("#c1502e", "#2f6ca3", DOUBT)
KIND_NAMES = ("solved (subset)", "estimated", "interpolated: no image evidence")
GIVEN = BEFORE
BAND_NAME = "95 % interval of the absolute value"
#: Sigmas that hold one number 95 times in 100.
SIGMA_95 = 1.96
#: Dots of one cloud at most: a page of many thousand frames stays small.
CLOUD_POINTS = 400
#: Length of a pause as drawn over what was flown; ticks along time; pauses up to which each has a rule.
_GAP, _TICKS, MOST_RULES = 0.03, 8, 30
#: Largest over smallest value that a logarithmic axis shows at least.
_LEAST_RANGE = 4.0
#: As frames without evidence are marked.
IDLE: dict[str, Any] = {"size": 9.0, "colour": KIND_COLOURS[2], "symbol": "cross"}
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


def by_stretch(view: SequenceView, values: Array) -> Array:
    """Values of frames as one curve that breaks between stretches."""
    return broken(*(values[rows] for rows in view.of_stretches()))


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


def _draw_axis(figure: Figure, axis: TimeAxis) -> None:
    """The same times under all panels, and a rule in every pause."""
    rim = 0.015 * (float(np.ptp(axis.x)) or 1.0)
    for panel in figure.panels:
        panel.x.title, panel.x.ticks = axis.title, list(zip(axis.ticks, axis.labels, strict=True))
        panel.x.low, panel.x.high = float(axis.x.min()) - rim, float(axis.x.max()) + rim
        if axis.breaks and len(axis.breaks) <= MOST_RULES:
            panel.marks.insert(0, Rules(x=axis.breaks, colour=MUTED))


def _line(
    panel: Panel, view: SequenceView, axis: TimeAxis, values: Array, name: str, colour: str, **look: Any
) -> None:
    """A curve against time, broken between stretches."""
    panel.add(Line(x=by_stretch(view, axis.x), y=by_stretch(view, values), name=name, colour=colour, **look))


def _dots(
    panel: Panel, view: SequenceView, axis: TimeAxis, which: Index, values: Array, name: str, **look: Any
) -> None:
    """Some frames as dots against time."""
    rows = thinned(which[np.isfinite(values[which])])
    if len(rows):
        says = [f"frame no. {row}, t = {view.t[row]:.6g} s" for row in rows]
        panel.add(Points(x=axis.x[rows], y=values[rows], name=name, says=says, **look))


def frame_residual_figure(view: SequenceView, epoch: str | None) -> Figure:
    """Reprojection error, good sightings and share rejected of every frame."""
    figure = Figure(3, height=150)
    every, axis = np.arange(len(view.t)), time_axis(view, epoch)
    tried = view.rejected + view.sightings
    share = np.where(tried > 0, 100.0 * view.rejected / np.maximum(tried, 1), np.nan)
    subset = {"size": dot_size(view.in_subset), "colour": KIND_COLOURS[0]}
    for panel, values, unit, title in zip(
        figure.panels,
        (view.rms_px, view.sightings.astype(np.float64), share),
        ("px", "number", "%"),
        (
            "Reprojection error of the sightings kept, rms per coordinate of each frame",
            "Sightings kept in each frame",
            "Share of the sightings rejected as gross errors",
        ),
        strict=True,
    ):
        _line(panel, view, axis, values, "all frames", KIND_COLOURS[1])
        _dots(panel, view, axis, every[view.in_subset], values, KIND_NAMES[0], **subset)
        _dots(panel, view, axis, every[view.kind == 2], np.nan_to_num(values), KIND_NAMES[2], **IDLE)
        panel.title, panel.y.title, panel.y.from_zero = title, unit, True
        if not np.nanmax(values, initial=0.0) > 0.0:
            panel.y.high = 1.0
    noise = "matching noise, as the matcher states it"
    _line(figure[0], view, axis, view.noise_px, noise, MUTED, dash="dot")
    _draw_axis(figure, axis)
    return figure


def departure_figure(view: SequenceView, epoch: str | None) -> Figure:
    """Six parameters less an even path: beside what tables gave of them, with 95 % bands; and enlarged."""
    figure = Figure(6, 2, height=130)
    every, axis = np.arange(len(view.t)), time_axis(view, epoch)
    for k, name in enumerate(PARAMETERS):
        values, colour = view.departure[:, k], AXIS_COLOURS[k % 3]
        first, second = figure[k, 0], figure[k, 1]
        first.title, second.title = f"{_LONG_NAMES[name]}, from an even path", "the line by itself"
        _dots(
            first,
            view,
            axis,
            every,
            view.given_departure[:, k],
            "given by the tables",
            size=4.0,
            colour=GIVEN,
        )
        half = np.where(np.isfinite(view.sigma[:, k]), SIGMA_95 * view.sigma[:, k], np.nan)
        x, low, high = (by_stretch(view, v) for v in (axis.x, values - half, values + half))
        first.add(Between(x=x, low=low, high=high, colour=colour, opacity=0.2, name=BAND_NAME, key=k == 0))
        for panel in (first, second):
            _line(panel, view, axis, values, "found", colour)
            _dots(panel, view, axis, every[view.kind == 2], values, KIND_NAMES[2], **IDLE)
            panel.y.title = "m" if k < 3 else "deg"
    _draw_axis(figure, axis)
    return figure


def pose_sigma_figure(view: SequenceView, epoch: str | None) -> Figure:
    """1-sigma of six parameters and of the ground under each frame, against time, logarithmic."""
    figure, axis = Figure(3, height=185), time_axis(view, epoch)
    worst, best = view.ground_sigma_px.T
    for k, name in enumerate(PARAMETERS):
        panel, colour = figure[k // 3], AXIS_COLOURS[k % 3]
        # curves of one value lie on each other: the lower ones look out
        _line(panel, view, axis, view.sigma[:, k], name, colour, width=(4.2, 2.6, 1.2)[k % 3])
        if np.isfinite(view.given_sigma[:, k]).any():
            words, given = f"{name}, a single row of the tables", view.given_sigma[:, k]
            _line(panel, view, axis, given, words, colour, dash="dot", key=False)
    if np.isfinite(view.given_sigma).any():
        figure[0].add(Line(x=[], y=[], name="dotted: a single row of the tables", colour=MUTED, dash="dot"))
    _line(figure[2], view, axis, worst, "ground, worst direction", INK)
    _line(figure[2], view, axis, best, "ground, best direction", MUTED)
    idle = np.flatnonzero(view.kind == 2)
    ground = "1-sigma of where the middle of each frame meets the ground"
    titles = "1-sigma of the position", "1-sigma of the angles", ground
    first = (view.sigma[:, 0], view.sigma[:, 3], worst)
    for panel, title, unit, values in zip(figure.panels, titles, ("m", "deg", "px"), first, strict=True):
        _dots(panel, view, axis, idle, values, KIND_NAMES[2], **IDLE)
        panel.title, panel.y.title, panel.y.log = title, f"{unit} (logarithmic)", True
        low, high = panel.y_range()
        spread = max(_LEAST_RANGE / (high / low), 1.0) ** 0.5
        panel.y.low, panel.y.high = low / spread, high * spread
        drawn = np.concatenate([v for mark in panel.marks for v in mark.extent()[1]])
        if not np.isfinite(drawn).any():
            panel.add(Note(words="not known: nothing ties it"))
    _draw_axis(figure, axis)
    return figure
