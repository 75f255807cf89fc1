"""The trajectory of a sequence in plan and in profile, with the ellipses of some of its frames.

Not here: its numbers (``sequence_view.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.report.figure import Figure, Panel
from sightline.report.marks import Line, Points, Rules
from sightline.report.sequence_figures import (
    GIVEN,
    IDLE,
    KIND_COLOURS,
    KIND_NAMES,
    MOST_RULES,
    by_stretch,
    dot_size,
    thinned,
)
from sightline.report.sequence_view import SequenceView
from sightline.report.style import MUTED

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Radius in sigmas of the ellipse that holds two numbers 95 times in 100.
SIGMA_95 = 2.4477
#: Ellipses that are drawn at most.
ELLIPSES = 20
#: px: size of the panels, and the half axis that a typical ellipse needs to be seen.
PANEL, SEEN_PX = (440, 400), 7.0
#: How much longer than wide a path is before the two directions are drawn at different scales.
SLIM = 5.0
#: Size of a panel over what is in it.
_ROOM = 1.08
#: As it is seen, in the legend too: no line so thin and no opacity that would make it another there.
_ELLIPSE = "#9a74bd"


@dataclass(frozen=True, eq=False)
class Drawn:
    """A panel: places (M, 2), `given` ones (M, 2), control (n, 2), covariances (M, 2, 2), its axes."""

    place: Array
    given: Array
    control: Array
    covariance: Array
    axes: tuple[str, str]
    equal: bool

    def limits(self, grown: float = 0.0) -> Array:
        """(2, 2) least and most of each axis, with ellipses `grown` times as large as they are."""
        given = self.given[np.isfinite(self.given).all(axis=1)]
        known = np.asarray(np.isfinite(self.covariance).all(axis=(1, 2)))[:, None]
        half = SIGMA_95 * grown * np.sqrt(np.where(known, np.einsum("kii->ki", self.covariance), 0.0))
        every = np.concatenate([self.place - half, self.place + half, given, self.control])
        low, high = every.min(axis=0), every.max(axis=0)
        return np.stack([low, np.maximum(high, low + 1e-9)])

    @property
    def true_to_scale(self) -> bool:
        """Whether both axes have one scale."""
        span = np.ptp(self.limits(), axis=0)
        return self.equal and bool(span.max() < SLIM * span.min())

    def px_per_unit(self, grown: float = 0.0) -> Array:
        """(2,) px of each axis for a unit."""
        span = np.ptp(self.limits(grown), axis=0) * _ROOM
        size = np.array(PANEL) / span
        return np.full(2, size.min()) if self.true_to_scale else np.asarray(size)

    @cached_property
    def enlarged(self) -> float:
        """How many times as large ellipses are drawn: 1, 2, 5, 10 ..., so that a typical one can be seen."""
        known = np.isfinite(self.covariance).all(axis=(1, 2))
        if not known.any():
            return 1.0
        half = SIGMA_95 * np.sqrt(np.einsum("kii->ki", self.covariance[known]))
        typical = float(np.median((half * self.px_per_unit()).max(axis=1)))
        steps = [m * 10.0**k for k in range(7) for m in (1.0, 2.0, 5.0)]
        return next((s for s in steps if s * typical >= SEEN_PX), 1.0) if typical > 0.0 else 1.0


def trajectory_figure(view: SequenceView, control: Array) -> Figure:
    """Plan and profile side by side.

    Parameters
    ----------
    view : SequenceView
    control : (n, 3)
        m, points of control in the axes of the view's places.
    """
    unit, scale = ("km", 1e-3) if max(np.ptp(view.place, axis=0)) > 2e4 else ("m", 1.0)
    heading = _heading(view)
    plan = Drawn(
        view.place[:, :2] * scale, view.given[:, :2] * scale, control[:, :2] * scale,
        view.covariance[:, :2, :2] * scale**2, (f"east ({unit})", f"north ({unit})"), True,
    )  # fmt: skip
    turned = np.stack([heading, np.broadcast_to([0.0, 0.0, 1.0], heading.shape)], axis=1)
    with np.errstate(invalid="ignore"):
        covariance = turned @ view.covariance[:, :3, :3] @ turned.transpose(0, 2, 1)
    forward = view.along + ((view.given - view.place) * heading).sum(axis=1)
    profile = Drawn(
        np.stack([view.along, view.place[:, 2]], axis=1) * scale,
        np.stack([forward, view.given[:, 2]], axis=1) * scale, np.zeros((0, 2)), covariance * scale**2,
        (f"distance flown ({unit})", f"height ({unit})" if view.origin is None else f"up ({unit})"), False,
    )  # fmt: skip
    figure = Figure(1, 2, height=PANEL[1], shared=False)
    for panel, drawn, name in zip(figure.panels, (plan, profile), ("Plan", "Profile"), strict=True):
        panel.title = _title(name, drawn)
        _draw(panel, view, drawn)
    ends = np.flatnonzero(np.diff(view.stretch))
    if 0 < len(ends) <= MOST_RULES:
        places = [float(profile.place[k : k + 2, 0].mean()) for k in ends]
        figure[0, 1].marks.insert(0, Rules(x=places, colour=MUTED))
    return figure


def _heading(view: SequenceView) -> Array:
    """(M, 3) level unit vectors along the path."""
    out = np.zeros((len(view.t), 3))
    for rows in view.of_stretches():
        if len(rows) > 1:
            out[rows, :2] = np.gradient(view.place[rows, :2], axis=0)
    size = np.linalg.norm(out, axis=1)
    out[size == 0.0] = [0.0, 1.0, 0.0]
    return np.asarray(out / np.where(size > 0.0, size, 1.0)[:, None])


def _title(name: str, panel: Drawn) -> str:
    """What a panel shows, and what in it is larger than it is."""
    said = []
    if not panel.true_to_scale:
        px = panel.px_per_unit(panel.enlarged)
        times = max(px) / min(px)
        if times > 1.05:
            larger = int(np.argmax(px))
            names = [axis.split(" (")[0] for axis in panel.axes]
            said.append(f"{names[larger]} drawn about {_round(times)} × as large as {names[1 - larger]}")
    if not np.isfinite(panel.covariance).all(axis=(1, 2)).any():
        said.append("no ellipses: positions are not tied")
    elif panel.enlarged > 1.0:
        said.append(f"ellipses {panel.enlarged:g} × too large")
    listed = ", ".join(said)
    return f"{name}: {listed}" if said else f"{name}, true to scale, ellipses too"


def _round(value: float) -> str:
    """Two figures."""
    return f"{float(f'{value:.2g}'):g}"


def _draw(panel: Panel, view: SequenceView, drawn: Drawn) -> None:
    """Path, given places, marks, ellipses and control of one panel."""
    rows = thinned(np.flatnonzero(np.isfinite(drawn.given).all(axis=1)))
    if len(rows):
        x, y = drawn.given[rows].T
        panel.add(Points(x=x, y=y, size=4.5, colour=GIVEN, opacity=0.8, name="given by the tables"))
    _ellipses(panel, view, drawn)
    x, y = (by_stretch(view, drawn.place[:, k]) for k in (0, 1))
    panel.add(Line(x=x, y=y, name="path found", colour=KIND_COLOURS[1], width=1.8, hover=False))
    subset: dict[str, Any] = {"size": dot_size(view.in_subset), "colour": KIND_COLOURS[0]}
    for which, kind, look in ((view.in_subset, 0, subset), (view.kind == 2, 2, IDLE)):
        rows = thinned(np.flatnonzero(which))
        if len(rows):
            x, y = drawn.place[rows].T
            panel.add(
                Points(x=x, y=y, name=KIND_NAMES[kind], says=[f"frame no. {row}" for row in rows], **look)
            )
    if len(drawn.control):
        x, y = drawn.control.T
        panel.add(Points(x=x, y=y, size=9.0, symbol="triangle", name="control points"))
    low, high = drawn.limits(drawn.enlarged)
    rim = 0.5 * (_ROOM - 1.0) * (high - low)
    for axis, k in ((panel.x, 0), (panel.y, 1)):
        axis.title, axis.low, axis.high = drawn.axes[k], float(low[k] - rim[k]), float(high[k] + rim[k])
    panel.equal = drawn.true_to_scale


def _readable(view: SequenceView, panel: Drawn, known: Index) -> int:
    """How many ellipses lie beside each other along the path without hiding it."""
    scale = panel.px_per_unit(panel.enlarged)
    covariance = panel.covariance[known] * panel.enlarged**2
    step = np.diff(panel.place, axis=0) * (np.diff(view.stretch) == 0)[:, None]
    length = float(np.linalg.norm(step * scale, axis=1).sum())
    # the half axis that lies along the path on the whole
    along = np.linalg.norm(step, axis=0)
    along = along / max(float(np.linalg.norm(along)), 1e-12)
    half = SIGMA_95 * np.sqrt(np.einsum("i,kij,j->k", along, covariance, along))
    size = 2.0 * float(np.median(half)) * float(scale @ along)
    return int(np.clip(1.5 * length / max(size, 1e-9), 5, ELLIPSES))


def _ellipses(panel: Panel, view: SequenceView, drawn: Drawn) -> None:
    """95 % ellipses of some frames, all as one broken line."""
    known = np.flatnonzero(np.isfinite(drawn.covariance).all(axis=(1, 2)))
    if not len(known):
        return
    times = drawn.enlarged
    rows = thinned(known, _readable(view, drawn, known))
    turn = np.linspace(0.0, 2.0 * np.pi, 49)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    values, vectors = np.linalg.eigh(drawn.covariance[rows])
    ring = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :] @ circle
    ring = drawn.place[rows][:, :, None] + SIGMA_95 * times * ring
    ring = np.concatenate([ring, np.full((len(rows), 2, 1), np.nan)], axis=2)
    name = "95 % ellipses of the absolute position of some frames"
    x, y = ring[:, 0].ravel(), ring[:, 1].ravel()
    panel.add(Line(x=x, y=y, name=name, colour=_ELLIPSE, width=1.5, hover=False))
