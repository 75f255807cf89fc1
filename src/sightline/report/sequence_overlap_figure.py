"""Which frames of a sequence see the same points: a graph in plan, and the same as a matrix.

Not here: how points were found (``matching/follow.py``, ``photogrammetry/flight/cross_links.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix

from sightline.applications.sequence_poses import SequencePoses
from sightline.report.figure import Figure, Panel
from sightline.report.marks import Line, Map, Points
from sightline.report.sequence_figures import KIND_COLOURS, thinned
from sightline.report.sequence_view import SequenceView

Array = NDArray[np.float64]
Index = NDArray[np.intp]
#: Frames up to which each is a node of its own; nodes at most.
FEW_FRAMES, NODES = 40, 120
#: Points shared from which on an edge has the next width.
CLASSES = ((1, 0.6), (10, 1.3), (100, 2.4), (1000, 4.0))
#: Strongest edges that are drawn.
EDGES = 1500
#: Height of an arc over its length; points along it.
_ARC, _ARC_POINTS = 0.22, 9
_ACROSS = "#c1502e"


@dataclass(frozen=True, eq=False)
class Shared:
    """Points that groups of frames have in common.

    Attributes
    ----------
    frames : (K,) int
        The frame in the middle of each group, by whose place it is drawn.
    size : (K,) int
        Frames in each.
    points : (K, K) int
        Points of both groups; on the diagonal those of each.
    """

    frames: Index
    size: Index
    points: Index


def shared_points(view: SequenceView, found: SequencePoses) -> Shared:
    """Frames in groups, each about a frame of the subset, and the points any two groups share."""
    count = len(view.t)
    nodes = np.arange(count) if count <= FEW_FRAMES else thinned(np.flatnonzero(view.in_subset), NODES)
    group = np.full(count, -1, dtype=np.intp)
    for rows in view.of_stretches():
        own = np.flatnonzero(np.isin(nodes, rows))
        if len(own):
            near = np.abs(view.t[rows][:, None] - view.t[nodes[own]]).argmin(axis=1)
            group[rows] = own[near]
    tracks = found.tracks
    kept = ~np.asarray(found.poses.rejected) & (group[tracks.image] >= 0)
    point, node = tracks.point[kept], group[tracks.image[kept]]
    shape = (int(point.max(initial=0)) + 1, len(nodes))
    seen = coo_matrix((np.ones(len(point)), (point, node)), shape=shape).tocsr()
    seen.data[:] = 1.0
    points = (seen.T @ seen).toarray().astype(np.intp)
    return Shared(nodes, np.bincount(group[group >= 0], minlength=len(nodes)).astype(np.intp), points)


def overlap_figure(view: SequenceView, shared: Shared) -> Figure:
    """Graph in plan, and matrix."""
    figure = Figure(1, 2, height=400, shared=False)
    _graph(figure[0, 0], view, shared)
    _matrix(figure[0, 1], shared)
    return figure


def _graph(panel: Panel, view: SequenceView, shared: Shared) -> None:
    """Nodes, and edges as arcs (those of one stretch) or straight."""
    place = view.place[shared.frames, :2]
    span = np.maximum(np.ptp(place, axis=0), 1e-9)
    slim = bool(span.max() > 5.0 * span.min())
    unit, scale = ("km", 1e-3) if span.max() > 2e4 else ("m", 1.0)
    # arcs are bent as they look, not as they lie
    shown = np.maximum(1.5 * span, 0.1 * span.max()) if slim else np.full(2, span.max())
    size = np.array([400.0, 400.0]) / shown
    first, second = np.nonzero(np.triu(shared.points, 1))
    number = shared.points[first, second]
    order = np.argsort(-number)[:EDGES]
    first, second, number = first[order], second[order], number[order]
    across = view.stretch[shared.frames[first]] != view.stretch[shared.frames[second]]
    for least, width in CLASSES:
        most = next((c for c, _ in CLASSES if c > least), np.inf)
        for which, colour, what in ((~across, KIND_COLOURS[1], ""), (across, _ACROSS, ", between stretches")):
            rows = np.flatnonzero((number >= least) & (number < most) & which)
            if len(rows):
                x, y = _arcs(place[first[rows]] * size, place[second[rows]] * size, 0.0 if what else _ARC)
                name = f"{least}{f' to {most - 1:.0f}' if np.isfinite(most) else ' or more'} points{what}"
                look: dict[str, Any] = {
                    "colour": colour,
                    "width": width,
                    "opacity": 0.75,
                    "hover": False,
                    "name": name,
                }
                panel.add(Line(x=scale * x / size[0], y=scale * y / size[1], **look))
    says = [
        f"about frame no. {frame}: {frames} frames, {points} points"
        for frame, frames, points in zip(shared.frames, shared.size, np.diag(shared.points), strict=True)
    ]
    panel.add(Points(x=scale * place[:, 0], y=scale * place[:, 1], name="group of frames", says=says))
    panel.title = "Groups in plan, linked by the points they share"
    panel.x.title, panel.y.title, panel.equal = f"east ({unit})", f"north ({unit})", not slim
    if slim:
        panel.title += " (axes of different scale)"
        narrow = int(np.argmin(span))
        middle = 0.5 * (place[:, narrow].min() + place[:, narrow].max())
        half = 0.5 * float(shown[narrow])
        axis = (panel.x, panel.y)[narrow]
        axis.low, axis.high = scale * (middle - half), scale * (middle + half)


def _arcs(start: Array, end: Array, bend: float) -> tuple[Array, Array]:
    """Arcs from (n, 2) to (n, 2) as one broken line."""
    step = end - start
    s = np.linspace(0.0, 1.0, _ARC_POINTS if bend else 2)
    lifted = bend * 4.0 * s * (1.0 - s)
    side = np.stack([-step[:, 1], step[:, 0]], axis=1)
    line = start[:, :, None] + step[:, :, None] * s + side[:, :, None] * lifted
    line = np.concatenate([line, np.full((len(start), 2, 1), np.nan)], axis=2)
    return line[:, 0].ravel(), line[:, 1].ravel()


def _matrix(panel: Panel, shared: Shared) -> None:
    """Shared points as colours, logarithmic; white where there are none."""
    k = np.arange(len(shared.frames))
    most = max(float(shared.points.max(initial=0)), 2.0)
    panel.add(Map(x=k, y=k, z=shared.points, palette="depth", low=1.0, high=most, log=True, bar="points"))
    panel.title, panel.equal = "Points shared by any two groups", True
    for axis in (panel.x, panel.y):
        axis.title, axis.tight = "group, by its frame (no.)", True
        axis.ticks = [(float(n), f"{shared.frames[n]}") for n in thinned(k, 9)]
    panel.y.downward = True
