"""Which frames of a sequence see the same points: a graph in plan, and the same as a matrix.

Not here: how points were found (``matching/follow.py``, ``photogrammetry/cross_links.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots
from scipy.sparse import coo_matrix

from sightline.applications.sequence_poses import SequencePoses
from sightline.report.sequence_figures import KIND_COLOURS, small, thinned
from sightline.report.sequence_view import SequenceView
from sightline.report.style import INK, TEMPLATE

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


def overlap_figure(view: SequenceView, shared: Shared) -> go.Figure:
    """Graph in plan, and matrix."""
    figure = make_subplots(
        1, 2, horizontal_spacing=0.12,
        subplot_titles=["Groups in plan, linked by the points they share", "Points shared by any two groups"],
    )  # fmt: skip
    figure.update_layout(template=TEMPLATE, height=560, margin_t=92, legend_y=1.09)
    figure.update_annotations(font_size=12)
    _graph(figure, view, shared)
    _matrix(figure, shared)
    return figure


def _graph(figure: go.Figure, view: SequenceView, shared: Shared) -> None:
    """Nodes, and edges as arcs (those of one stretch) or straight."""
    place = view.place[shared.frames, :2]
    span = np.maximum(np.ptp(place, axis=0), 1e-9)
    slim = bool(span.max() > 5.0 * span.min())
    unit, scale = ("km", 1e-3) if span.max() > 2e4 else ("m", 1.0)
    # arcs are bent as they look, not as they lie
    shown = np.maximum(1.5 * span, 0.1 * span.max()) if slim else np.full(2, span.max())
    size = np.array([450.0, 430.0]) / shown
    first, second = np.nonzero(np.triu(shared.points, 1))
    number = shared.points[first, second]
    order = np.argsort(-number)[:EDGES]
    first, second, number = first[order], second[order], number[order]
    across = view.stretch[shared.frames[first]] != view.stretch[shared.frames[second]]
    for least, width in CLASSES:
        most = next((c for c, _ in CLASSES if c > least), np.inf)
        for which, colour, what in (
            (~across, KIND_COLOURS[1], ""), (across, _ACROSS, ", between stretches"),
        ):  # fmt: skip
            rows = np.flatnonzero((number >= least) & (number < most) & which)
            if not len(rows):
                continue
            bend = 0.0 if what else _ARC
            x, y = _arcs(place[first[rows]] * size, place[second[rows]] * size, bend)
            figure.add_scatter(
                x=small(scale * x / size[0]), y=small(scale * y / size[1]), row=1, col=1, mode="lines",
                line={"color": colour, "width": width}, opacity=0.75, hoverinfo="skip",
                name=f"{least}{f' to {most - 1:.0f}' if np.isfinite(most) else ' or more'} points{what}",
            )  # fmt: skip
    figure.add_scatter(
        x=scale * place[:, 0], y=scale * place[:, 1], row=1, col=1, mode="markers",
        marker={"size": 6, "color": INK}, name="group of frames", showlegend=True,
        customdata=np.column_stack([shared.frames, shared.size, np.diag(shared.points)]),
        hovertemplate="about frame no. %{customdata[0]}: %{customdata[1]} frames, %{customdata[2]} points"
        "<extra></extra>",
    )  # fmt: skip
    figure.update_xaxes(title_text=f"east ({unit})", row=1, col=1)
    options = {} if slim else {"scaleanchor": "x", "constrain": "domain", "constraintoward": "top"}
    figure.update_yaxes(title_text=f"north ({unit})", row=1, col=1, tickformat=".6~g", **options)
    if slim:
        figure.layout.annotations[0].text += " (axes of different scale)"
        middle = 0.5 * (place[:, int(np.argmin(span))].min() + place[:, int(np.argmin(span))].max())
        half = 0.5 * float(shown[int(np.argmin(span))])
        narrow = figure.update_xaxes if np.argmin(span) == 0 else figure.update_yaxes
        narrow(range=[scale * (middle - half), scale * (middle + half)], row=1, col=1)


def _arcs(start: Array, end: Array, bend: float) -> tuple[Array, Array]:
    """Arcs from (n, 2) to (n, 2) as one broken line."""
    step = end - start
    s = np.linspace(0.0, 1.0, _ARC_POINTS if bend else 2)
    lifted = bend * 4.0 * s * (1.0 - s)
    side = np.stack([-step[:, 1], step[:, 0]], axis=1)
    line = start[:, :, None] + step[:, :, None] * s + side[:, :, None] * lifted
    line = np.concatenate([line, np.full((len(start), 2, 1), np.nan)], axis=2)
    return line[:, 0].ravel(), line[:, 1].ravel()


def _matrix(figure: go.Figure, shared: Shared) -> None:
    """Shared points as colours, logarithmic; white where there are none."""
    with np.errstate(divide="ignore"):
        logs = np.where(shared.points > 0, np.log10(shared.points), np.nan)
    top = float(np.nanmax(logs)) if np.isfinite(logs).any() else 1.0
    ticks = [t for t in (1, 3, 10, 30, 100, 300, 1000, 3000, 10000, 30000) if np.log10(t) <= top + 1e-9]
    labels = [f"{frame}" for frame in shared.frames]
    k = np.arange(len(labels))
    figure.add_heatmap(
        x=k, y=k, z=small(logs), row=1, col=2, colorscale="Viridis_r", zmin=0.0, zmax=max(top, 0.1),
        customdata=shared.points,
        colorbar={
            "title": {"text": "points", "side": "right"}, "tickvals": np.log10(ticks), "thickness": 12,
            "ticktext": [f"{t:,}" for t in ticks], "len": 0.9, "outlinewidth": 0,
        },
        hovertemplate="groups about frames no. %{x} and %{y}: %{customdata} points<extra></extra>",
    )  # fmt: skip
    ticked = thinned(k, 9)
    names = [labels[n] for n in ticked]
    figure.update_xaxes(title_text="group, by its frame (no.)", tickvals=ticked, ticktext=names, row=1, col=2)
    figure.update_yaxes(
        title_text="group, by its frame (no.)", tickvals=ticked, ticktext=names, autorange="reversed",
        scaleanchor="x2", constrain="domain", constraintoward="top", row=1, col=2,
    )  # fmt: skip
    figure.update_xaxes(constrain="domain", row=1, col=2)
