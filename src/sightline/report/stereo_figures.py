"""Figures of a stereo orientation: ellipses, weak directions, residuals.

Not here: how it was found (``photogrammetry/``); heights (``stereo_height_figure.py``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray
from plotly.subplots import make_subplots
from scipy.spatial.transform import Rotation

from sightline.applications.stereo_orientation import StereoOrientation, StereoProblem
from sightline.evaluation.direction_words import AXES
from sightline.geometry.units import ARCSEC
from sightline.io.stereo import Stereo
from sightline.io.stereo_strips import StripProblem
from sightline.report.style import INK, MUTED, RULE, TEMPLATE, labels, panels, wrapped
from sightline.report.words import digits

Array = NDArray[np.float64]

#: One colour per camera, the same in every figure.
CAMERA_COLOURS = ("#2f6ca3", "#c1502e", "#3f8a5a", "#8a5a9e", "#a3812f", "#4a8f9e")
#: Radii of the ellipse in sigmas that hold 39 and 95 % of two numbers.
ONE_SIGMA, SIGMA_95 = 1.0, 2.4477
#: Cameras that are drawn at most, cells of a frame along its larger side.
DRAWN_CAMERAS, CELLS = 6, 10
#: Shots up to which each has a tick, decades up to which 2 and 5 have one too.
TICKED_SHOTS, FINE_DECADES = 12, 2.0
#: Sightings of a cell whose mean is drawn.
FEW = 5
PAIRS = ((0, 1), (0, 2), (1, 2))


def colour(camera: int) -> str:
    """Of a camera."""
    return CAMERA_COLOURS[camera % len(CAMERA_COLOURS)]


def panel_grid(rows: int, columns: int, height: int, titles: list[str], **options: Any) -> go.Figure:
    """Panels in rows and columns with titles at their left."""
    figure = make_subplots(rows=rows, cols=columns, subplot_titles=titles, **options)
    figure.update_layout(template=TEMPLATE, height=height, margin_t=64)
    figure.update_annotations(font_size=12)
    return figure


def ellipse_figure(result: StereoOrientation) -> go.Figure | None:
    """Where the true angles lie about the estimated ones; None where no two are known."""
    covariance = np.asarray(result.covariance) / ARCSEC**2
    shown = range(min(len(result.cameras), DRAWN_CAMERAS))
    two = len(result.cameras) == 2
    names = labels(result.cameras)
    titles = [f"{AXES[a]} and {AXES[b]} of each camera" for a, b in PAIRS]
    titles += [f"{axis} of both cameras" for axis in AXES] if two else []
    figure = panel_grid(1 + two, 3, 400 + 350 * two, titles, horizontal_spacing=0.09, vertical_spacing=0.16)
    drawn = False
    for panel, (a, b) in enumerate(PAIRS, 1):
        for camera in shown:
            pair = [3 * camera + a, 3 * camera + b]
            name = f"camera {names[camera]}"
            drawn |= _ellipses(figure, covariance, pair, colour(camera), name, 3.6 / (camera + 1), 1, panel)
        _equal(figure, 1, panel, f"error of {AXES[a]} (arcsec)", f"error of {AXES[b]} (arcsec)")
    for k in range(3 if two else 0):
        drawn |= _ellipses(figure, covariance, [k, 3 + k], INK, "both cameras", 1.8, 2, k + 1)
        first, second = names
        _equal(figure, 2, k + 1, f"{AXES[k]} of camera {first} (arcsec)", f"of camera {second} (arcsec)")
    figure.update_layout(legend={"y": 1.09 if two else 1.16})
    return figure if drawn else None


def _ellipses(
    figure: go.Figure,
    covariance: Array,
    pair: list[int],
    ink: str,
    name: str,
    width: float,
    row: int,
    col: int,
) -> bool:
    """Ellipses of two angles (solid: 1 sigma, dotted: 95 %); False where they are not known."""
    block = covariance[np.ix_(pair, pair)]
    if not np.isfinite(block).all():
        return False
    values, vectors = np.linalg.eigh(block)
    turn = np.linspace(0.0, 2.0 * np.pi, 91)
    ring = vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * np.stack([np.cos(turn), np.sin(turn)]))
    for size, dash, what in ((ONE_SIGMA, "solid", "1 sigma of each"), (SIGMA_95, "dot", "95 %")):
        x, y = size * ring
        figure.add_scatter(
            x=x, y=y, row=row, col=col, mode="lines", line={"color": ink, "width": width, "dash": dash},
            name=f"{name}: {what}", legendgroup=f"{name}{dash}", showlegend=col == 1,
            hovertemplate=f"{name}, {what}<br>%{{x:.3g}}, %{{y:.3g}} arcsec<extra></extra>",
        )  # fmt: skip
    return True


def _equal(figure: go.Figure, row: int, col: int, x: str, y: str) -> None:
    figure.update_xaxes(title_text=x, row=row, col=col, zeroline=True, zerolinecolor=RULE)
    figure.update_yaxes(title_text=y, row=row, col=col, zeroline=True, zerolinecolor=RULE)


def direction_figure(entries: list[dict[str, Any]]) -> go.Figure:
    """Sigma of every principal direction, weakest first."""
    sigma = np.array([entry["sigma"] for entry in entries], dtype=np.float64) / ARCSEC
    known = np.isfinite(sigma)
    longest = 10.0 * sigma[known].max() if known.any() else 1.0
    words = [f"{k}. {wrapped(entry['words'])}" for k, entry in enumerate(entries, 1)]
    figure = panels(1, 90 + 44 * len(entries), top=20)
    for which, name, ink in ((known, "seen", "#2f6ca3"), (~known, "not observable", "#d69e2e")):
        if which.any():
            figure.add_bar(
                y=[word for word, yes in zip(words, which, strict=True) if yes],
                x=np.where(known, sigma, longest)[which], orientation="h", marker_color=ink, name=name,
                text=[digits(s, 3) if np.isfinite(s) else "not observable" for s in sigma[which]],
                textposition="outside", cliponaxis=False,
                hovertemplate="%{y}: %{text} arcsec<extra></extra>",
            )  # fmt: skip
    low = 0.5 * sigma[known].min() if known.any() else 0.1
    high = 4.0 * longest if (~known).any() else 0.4 * longest
    figure.update_xaxes(
        type="log", title_text="1 sigma, arcsec (logarithmic)", **_ticks(low, high),
        range=[np.log10(low), np.log10(high)],
    )  # fmt: skip
    figure.update_yaxes(autorange="reversed", automargin=True, categoryorder="array", categoryarray=words)
    figure.update_layout(showlegend=False, margin_r=120)
    return figure


def _ticks(low: float, high: float) -> dict[str, Any]:
    """Ticks of a logarithmic axis: whole decades, and 2 and 5 of each where there are few of them."""
    steps = (1, 2, 5) if np.log10(high / low) <= FINE_DECADES else (1,)
    ticks = [m * 10.0**k for k in range(-4, 7) for m in steps]
    return {"tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}


#: What residuals are, by the method: title of the panel, and of how far they are from good ones.
RESIDUALS = {
    "epipolar": "Distance of each image's kept points from the epipolar lines (each image's half), rms",
    "plane": "Miss of the kept points on the plane (each image's half), rms; relief is in it",
}


def image_noise(problem: StereoProblem, method: str) -> float | None:
    """px; rms of residuals by the noise of sightings alone; None where others rule them."""
    if method == "plane":
        return None
    # both coordinates of a sighting, or half in squares of the one number that a pair has
    share = 0.5 if method == "epipolar" else 2.0
    return float(np.sqrt(share * np.mean(problem.tracks.sigma_px**2)))


def residual_figure(stereo: Stereo, result: StereoOrientation) -> go.Figure:
    """Residual rms and share rejected of every image, shot by shot."""
    problem = stereo.problem
    size, rejected = result.residual_px, result.rejected
    image, images = problem.tracks.image, problem.images
    kept = ~rejected & np.isfinite(size)
    count = np.bincount(image[kept], minlength=len(images))
    square = np.bincount(image[kept], size[kept] ** 2, minlength=len(images))
    rms = np.sqrt(np.where(count, square, np.nan) / np.maximum(count, 1))
    every = np.bincount(image, minlength=len(images))
    share = 100.0 * np.bincount(image, rejected, len(images)) / np.maximum(every, 1)
    figure = panels(
        2, 460, gap_px=44.0, top=52, shared_xaxes=True,
        subplot_titles=[
            RESIDUALS.get(result.method, "Residual of the kept points of each image, rms"), "Points rejected",
        ],
    )  # fmt: skip
    cameras = labels(problem.cameras)
    mode = "lines+markers" if len(problem.shot_names) <= 200 else "lines"
    for camera in range(min(len(problem.cameras), DRAWN_CAMERAS)):
        rows = np.flatnonzero(images.camera == camera)
        rows = rows[np.argsort(images.shot[rows])]
        x = problem.shot_names[images.shot[rows]]
        for row, values, unit in ((1, rms, "px"), (2, share, "%")):
            figure.add_scatter(
                x=x, y=values[rows], row=row, col=1, mode=mode, marker_size=5,
                line={"color": colour(camera), "width": 1.4}, name=f"camera {cameras[camera]}",
                legendgroup=str(camera), showlegend=row == 1,
                hovertemplate=f"shot %{{x:.0f}}: %{{y:.3g}} {unit}<extra></extra>",
            )  # fmt: skip
    expected, names = image_noise(problem, result.method), problem.shot_names
    if expected is not None:
        figure.add_scatter(
            x=[names.min() - 0.5, names.max() + 0.5], y=[expected, expected], row=1, col=1, mode="lines",
            line={"color": MUTED, "dash": "dot", "width": 1.4}, name="as sigma_px says", hoverinfo="skip",
        )  # fmt: skip
    figure.update_yaxes(title_text="px", rangemode="tozero", row=1)
    figure.update_yaxes(title_text="%", rangemode="tozero", row=2)
    figure.update_xaxes(title_text="shot", row=2)
    figure.update_xaxes(tickformat="d", dtick=1 if np.ptp(names) < TICKED_SHOTS else None)
    return figure


def residual_vectors(problem: StereoProblem, result: StereoOrientation) -> Array | None:
    """Residuals (N, 2) px, measured less predicted (line, column); None where points were not adjusted."""
    # a strip has a pose for every sighting: the arrays of its images do not stand for them
    one_pose = not isinstance(problem, StripProblem)
    if not one_pose or result.method != "ml-track" or result.attitude is None or result.position is None:
        return None
    s, image = problem.sightings(), problem.tracks.image
    camera = problem.images.camera
    turned = Rotation.from_rotvec(np.nan_to_num(result.angles)[camera] + result.attitude).as_matrix()
    attitude = s.world_from_body @ turned @ s.body_from_camera[camera]
    to = result.points[problem.tracks.point] - (s.position + result.position)[image]
    seen = np.einsum("nji,nj->ni", attitude[image], to)
    longer = 0.0 if result.stretch is None else np.nan_to_num(result.stretch)[camera][image, None]
    miss = s.tangents - (1.0 + longer) * seen[:, :2] / seen[:, 2:]
    return np.asarray(np.einsum("nij,nj->ni", s.px_per_tangent, miss))


def image_plane_figure(stereo: Stereo, result: StereoOrientation) -> go.Figure | None:
    """Mean residual in cells of each camera's frame as arrows; None where residuals have no direction."""
    residual = residual_vectors(stereo.problem, result)
    if residual is None:
        return None
    problem = stereo.problem
    shown = range(min(len(problem.cameras), DRAWN_CAMERAS))
    cells = [_cells(problem, residual, result.rejected, camera) for camera in shown]
    largest = max((float(np.hypot(*c[1].T).max()) for c in cells if len(c[0])), default=0.0)
    if largest == 0.0:
        return None
    names = [f"Camera {name}" for name in labels(problem.cameras)[: len(shown)]]
    columns = min(len(names), 2)
    rows = -(-len(names) // columns)
    figure = panel_grid(rows, columns, 60 + 420 * rows, names, horizontal_spacing=0.1)
    for camera in shown:
        centre, mean, number = cells[camera]
        lines, width = problem.detectors[camera].shape
        scale = 0.9 * max(lines, width) / CELLS / largest
        row, col = camera // columns + 1, camera % columns + 1
        end = centre + scale * mean
        gap = np.full(len(centre), np.nan)
        figure.add_scatter(
            x=np.column_stack([centre[:, 1], end[:, 1], gap]).ravel(),
            y=np.column_stack([centre[:, 0], end[:, 0], gap]).ravel(),
            row=row, col=col, mode="lines", line={"color": colour(camera), "width": 2}, hoverinfo="skip",
        )  # fmt: skip
        figure.add_scatter(
            x=centre[:, 1], y=centre[:, 0], row=row, col=col, mode="markers",
            marker={"size": 4, "color": colour(camera)}, customdata=np.column_stack([mean, number]),
            hovertemplate="line %{customdata[0]:.3g}, column %{customdata[1]:.3g} px, "
            "%{customdata[2]:.0f} points<extra></extra>",
        )  # fmt: skip
        figure.update_xaxes(title_text="column (px)", range=[0, width], row=row, col=col)
        figure.update_yaxes(
            title_text="line (px)", range=[lines, 0], row=row, col=col,
            scaleanchor=f"x{camera + 1 if camera else ''}", constrain="domain",
        )  # fmt: skip
    figure.update_layout(showlegend=False, meta={"largest": largest})
    return figure


def _cells(
    problem: StereoProblem, residual: Array, rejected: NDArray[np.bool_], camera: int
) -> tuple[Array, Array, Array]:
    """Centres (n, 2), mean residuals (n, 2) and numbers (n,) of the cells of a frame with enough points."""
    tracks = problem.tracks
    rows = (problem.images.camera[tracks.image] == camera) & ~rejected & np.isfinite(residual).all(axis=1)
    lines, columns = problem.detectors[camera].shape
    side = max(lines, columns) / CELLS
    cell = np.floor(tracks.pixels[rows] / side).astype(np.intp).clip(0, CELLS - 1)
    number = cell[:, 0] * CELLS + cell[:, 1]
    count = np.bincount(number, minlength=CELLS**2)
    mean = np.stack([np.bincount(number, r, CELLS**2) for r in residual[rows].T], axis=1)
    full = np.flatnonzero(count >= FEW)
    centre = np.asarray((np.stack([full // CELLS, full % CELLS], axis=1) + 0.5) * side, dtype=np.float64)
    return centre, mean[full] / count[full, None], count[full].astype(np.float64)
