"""Figures of a stereo orientation: ellipses, weak directions, residuals.

Not here: how it was found (``photogrammetry/``); heights (``stereo_height_figure.py``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.applications.stereo_orientation import StereoOrientation
from sightline.evaluation.direction_words import AXES
from sightline.geometry.units import ARCSEC
from sightline.io.stereo.load import Stereo
from sightline.io.stereo.strips import StripProblem
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.report.figure import Figure
from sightline.report.marks import Bars, Line, Points, Rules
from sightline.report.style import DOUBT, INK, MUTED, labels, wrapped
from sightline.report.words import digits

Array = NDArray[np.float64]
#: One colour per camera, the same in every figure.
CAMERA_COLOURS = ("#2f6ca3", "#c1502e", "#38805a", "#8a5a9e", "#8f6f1f", "#2f7f90")
#: Radii of the ellipse in sigmas that hold 39 and 95 % of two numbers.
ONE_SIGMA, SIGMA_95 = 1.0, 2.4477
#: Cameras that are drawn at most, cells of a frame along its larger side.
DRAWN_CAMERAS, CELLS = 6, 10
#: Shots up to which each has a tick.
TICKED_SHOTS = 12
#: Sightings of a cell whose mean is drawn.
FEW = 5
PAIRS = ((0, 1), (0, 2), (1, 2))


def colour(camera: int) -> str:
    """Of a camera."""
    return CAMERA_COLOURS[camera % len(CAMERA_COLOURS)]


def ellipse_figure(result: StereoOrientation) -> Figure | None:
    """Where the true angles lie about the estimated ones; None where no two are known."""
    covariance = np.asarray(result.covariance) / ARCSEC**2
    shown = range(min(len(result.cameras), DRAWN_CAMERAS))
    two = len(result.cameras) == 2
    names = labels(result.cameras)
    figure = Figure(1 + two, 3, height=270, shared=False)
    for column, (a, b) in enumerate(PAIRS):
        panel = figure[0, column]
        panel.title = f"{AXES[a]} and {AXES[b]} of each camera"
        panel.x.title, panel.y.title = f"error of {AXES[a]} (arcsec)", f"error of {AXES[b]} (arcsec)"
        for camera in shown:
            pair = [3 * camera + a, 3 * camera + b]
            name, width = f"camera {names[camera]}", 3.6 / (camera + 1)
            panel.add(*_ellipses(covariance, pair, colour(camera), name, width))
    for k in range(3 if two else 0):
        panel = figure[1, k]
        panel.title = f"{AXES[k]} of both cameras"
        panel.x.title, panel.y.title = (f"{AXES[k]} of camera {name} (arcsec)" for name in names)
        panel.add(*_ellipses(covariance, [k, 3 + k], INK, "both cameras", 1.8))
    return figure if figure.marks else None


def _ellipses(covariance: Array, pair: list[int], ink: str, name: str, width: float) -> list[Line]:
    """Ellipses of two angles (solid: 1 sigma, dotted: 95 %); none where they are not known."""
    block = covariance[np.ix_(pair, pair)]
    if not np.isfinite(block).all():
        return []
    values, vectors = np.linalg.eigh(block)
    turn = np.linspace(0.0, 2.0 * np.pi, 91)
    ring = vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * np.stack([np.cos(turn), np.sin(turn)]))
    return [
        Line(x=size * ring[0], y=size * ring[1], name=f"{name}: {what}", colour=ink, width=width, dash=dash)
        for size, dash, what in ((ONE_SIGMA, "solid", "1 sigma of each"), (SIGMA_95, "dash", "95 %"))
    ]


def direction_figure(entries: list[dict[str, Any]]) -> Figure:
    """Sigma of every principal direction, weakest first."""
    sigma = np.array([entry["sigma"] for entry in entries], dtype=np.float64) / ARCSEC
    known = np.isfinite(sigma)
    longest = 10.0 * sigma[known].max() if known.any() else 1.0
    figure = Figure(height=42 * len(entries) + 10)
    panel, place = figure[0], np.arange(len(entries), dtype=np.float64)
    for which, name, ink in ((known, "observable", "#2f6ca3"), (~known, "not observable", DOUBT)):
        if which.any():
            texts = [digits(s, 3) if np.isfinite(s) else "not observable" for s in sigma[which]]
            length = np.where(known, sigma, longest)[which]
            panel.add(
                Bars(
                    place=place[which],
                    length=length,
                    thick=0.7,
                    level=True,
                    colour=ink,
                    name=name,
                    texts=texts,
                )
            )
    panel.x.low = 0.5 * sigma[known].min() if known.any() else 0.1
    panel.x.high = 4.0 * longest if (~known).any() else 0.4 * longest
    panel.x.title, panel.x.log = "1 sigma, arcsec (logarithmic)", True
    panel.y.ticks = [(float(k), f"{k + 1}. {wrapped(entry['words'])}") for k, entry in enumerate(entries)]
    panel.y.downward, panel.y.grid = True, False
    panel.y.low, panel.y.high = -0.6, len(entries) - 0.4
    return figure


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


def residual_figure(stereo: Stereo, result: StereoOrientation) -> Figure:
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
    figure = Figure(2, height=[190, 130])
    titles = RESIDUALS.get(result.method, "Residual of the kept points of each image, rms"), "Points rejected"
    for panel, title, unit in zip(figure.panels, titles, ("px", "%"), strict=True):
        panel.title, panel.y.title, panel.y.from_zero = title, unit, True
    cameras, names = labels(problem.cameras), problem.shot_names
    dots = 5.0 if len(names) <= 200 else 0.0
    for camera in range(min(len(problem.cameras), DRAWN_CAMERAS)):
        rows = np.flatnonzero(images.camera == camera)
        rows = rows[np.argsort(images.shot[rows])]
        x, name = names[images.shot[rows]], f"camera {cameras[camera]}"
        for panel, values in zip(figure.panels, (rms, share), strict=True):
            panel.add(Line(x=x, y=values[rows], name=name, colour=colour(camera), dotted=dots))
    expected = image_noise(problem, result.method)
    if expected is not None:
        figure[0].add(Rules(y=[expected], colour=MUTED, name="as sigma_px says", width=1.4))
    axis = figure[0].x
    axis.title, axis.low, axis.high = "shot", float(names.min()) - 0.5, float(names.max()) + 0.5
    if np.ptp(names) < TICKED_SHOTS:
        axis.ticks = [(float(k), f"{k:g}") for k in np.unique(names)]
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


def image_plane_figure(stereo: Stereo, result: StereoOrientation) -> tuple[Figure, float] | None:
    """Mean residual in cells of each frame as strokes, the longest in px; None without directions."""
    residual = residual_vectors(stereo.problem, result)
    if residual is None:
        return None
    problem = stereo.problem
    shown = range(min(len(problem.cameras), DRAWN_CAMERAS))
    cells = [_cells(problem, residual, result.rejected, camera) for camera in shown]
    largest = max((float(np.hypot(*c[1].T).max()) for c in cells if len(c[0])), default=0.0)
    if largest == 0.0:
        return None
    names = labels(problem.cameras)
    columns = min(len(shown), 2)
    figure = Figure(-(-len(shown) // columns), columns, height=380, shared=False)
    for panel, camera in zip(figure.panels, shown, strict=False):
        centre, mean, count = cells[camera]
        lines, width = problem.detectors[camera].shape
        end = centre + 0.9 * max(lines, width) / CELLS / largest * mean
        strokes = np.stack([centre, end, np.full_like(centre, np.nan)], axis=1).reshape(-1, 2)
        says = [
            f"line {a:.3g}, column {b:.3g} px, {n:.0f} points" for (a, b), n in zip(mean, count, strict=True)
        ]
        name = f"camera {names[camera]}"
        look: dict[str, Any] = {"colour": colour(camera), "name": name, "key": False}
        panel.add(
            Line(x=strokes[:, 1], y=strokes[:, 0], width=2.0, hover=False, **look),
            Points(x=centre[:, 1], y=centre[:, 0], size=4.0, says=says, **look),
        )
        panel.title, panel.equal, panel.y.downward = f"Camera {names[camera]}", True, True
        panel.x.title, panel.x.low, panel.x.high = "column (px)", 0.0, float(width)
        panel.y.title, panel.y.low, panel.y.high = "line (px)", 0.0, float(lines)
    return figure, largest


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
