"""How one strip is laid on another: pixels of unlike size, lines that stand unevenly, detectors in steps.

Frames and maps are laid as a whole by a smooth map (``matching/on_geometry.py``); strips line by line, since
each line has a motion of its own.

Not here: the windows that are then matched (``plan.py``), what they say (``stars.py``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.conjugate import predict_match
from sightline.geometry.surface import Dem, Surface
from sightline.geometry.trajectory import Motion
from sightline.imaging.reduce import Mapping, averaged
from sightline.imaging.source import ImageSource
from sightline.imaging.warp import STRAIGHT, WarpedImage
from sightline.motion.measure.predict import MovingCamera, ground_of_column
from sightline.motion.measure.windows import WindowGrid
from sightline.writing import scratch_array

Array = NDArray[np.float64]

#: Columns between the places where the map of two images is evaluated: over relief; over smooth surfaces, at
#: most and, where a line bends, at least.
RELIEF_SPACING, SMOOTH_SPACING, BENT_SPACING = 16, 64, 4
#: Columns over which it is seen how much a line bends.
BEND_COLUMNS = 32
#: Lines at which the columns are sought where the CCDs of a line meet in steps, and its bends.
STEP_LINES = 5
#: Lines over which their spacing on the ground is averaged, and departures of one from the next (lines) up to
#: which lines pass for even.
PLACE_MEAN, EVEN = 17, 1e-3
#: Pixels that differ by more than this factor, along or across, are unlike.
UNLIKE = 1.25
#: Pixels that differ by more cannot be matched.
MOST_UNLIKE = 6.0
#: Parts of a pixel may be this much further apart than pixels of the image they are taken from.
_PART_SLACK = 1.05
#: Parts of an exposure over which the motion is averaged.
EXPOSURE_PARTS = 5


def pixel_sizes(cameras: Sequence[MovingCamera]) -> Array:
    """(K, 2) s between lines and tangent between columns of line detectors; ones of area detectors."""
    return np.array(
        [
            (c.detector.line_period, c.detector.pixel_step) if isinstance(c, PushbroomCamera) else (1.0, 1.0)
            for c in cameras
        ]
    )


def groups_of_pixels(cameras: Sequence[MovingCamera]) -> tuple[int, ...]:
    """Number of each image's group of like pixels, the coarsest 0: a group's first hub is of its own size."""
    sizes = pixel_sizes(cameras)
    leaders: list[int] = []
    group = [0] * len(sizes)
    for image in np.argsort(-sizes.prod(axis=1), kind="stable"):
        ratios = [np.exp(np.abs(np.log(sizes[image] / sizes[leader])).max()) for leader in leaders]
        if not ratios or min(ratios) > UNLIKE:
            leaders.append(int(image))
            group[image] = len(leaders) - 1
        else:
            group[image] = int(np.argmin(ratios))
    return tuple(group)


def ratio_to_finest(cameras: Sequence[MovingCamera], image: int) -> tuple[float, float]:
    """Pixels of an image over those of the finest group, (along, across); 1 where they are like."""
    sizes, groups = pixel_sizes(cameras), groups_of_pixels(cameras)
    if groups[image] == max(groups):
        return 1.0, 1.0
    finest = sizes[np.array(groups) == max(groups)].min(axis=0)
    along, across = np.maximum(sizes[image] / finest, 1.0)
    return float(along), float(across)


def finest_view(cameras: Sequence[MovingCamera], surface: Surface, hub: int, grid: WindowGrid) -> int | None:
    """The image of the finest pixels in which most windows of a coarser hub lie; None for a hub of these."""
    groups = groups_of_pixels(cameras)
    finest = [image for image, group in enumerate(groups) if group == max(groups)]
    if hub in finest:
        return None
    ground = cameras[hub].locate(grid.centres, surface)
    seen = [np.isfinite(cameras[image].project(ground)).all(axis=1).sum() for image in finest]
    return finest[int(np.argmax(seen))] if max(seen) else None


def parts_of_pixel(cameras: Sequence[MovingCamera], hub: int, partner: int) -> tuple[int, int]:
    """Parts (along, across) of a hub's pixel over which a finer partner is averaged; 1 if they are like."""
    sizes = pixel_sizes(cameras)
    lines, columns = (
        math.ceil(ratio / _PART_SLACK) if ratio > UNLIKE else 1 for ratio in sizes[hub] / sizes[partner]
    )
    return lines, columns


def size_in_partner(
    cameras: Sequence[MovingCamera], hub: int, partner: int, window: tuple[int, int]
) -> tuple[float, float]:
    """Lines and columns of a partner that a window of a hub fills."""
    if parts_of_pixel(cameras, hub, partner) == (1, 1):
        return window
    sizes = pixel_sizes(cameras)
    along, across = sizes[hub] / sizes[partner]
    return window[0] * along, window[1] * across


def fineness(cameras: Sequence[MovingCamera], hub: int, partners: Sequence[int]) -> tuple[float, ...]:
    """Pixels of each partner, across, to one of the hub: 1 where they are like."""
    across = pixel_sizes(cameras)[:, 1]
    ratios = (across[hub] / across[image] for image in partners)
    return tuple(float(ratio) if ratio > UNLIKE else 1.0 for ratio in ratios)


def exposed(camera: MovingCamera) -> MovingCamera:
    """A line camera whose motion is its mean over the exposure of a line.

    Two images of coarse lines are laid on one another line by line: each line shows where it looked on
    average. (An image of finer lines is averaged over the parts of an exposure, each with its own motion.)
    """
    motion = camera.trajectory.motion
    if motion is None or not isinstance(camera, PushbroomCamera) or camera.stages is not None:
        return camera  # its stages are averaged over already
    parts = (np.arange(EXPOSURE_PARTS) + 0.5) / EXPOSURE_PARTS - 0.5
    instants = motion.t[:, None] + camera.detector.line_period * parts
    inside = np.clip(instants, motion.t[0], motion.t[-1])
    angles = motion.at(inside.ravel()).reshape(*inside.shape, 3).mean(axis=1)
    return camera.with_trajectory(camera.trajectory.with_motion(Motion(motion.t, angles)))


def laid_on(
    images: Sequence[ImageSource],
    cameras: Sequence[MovingCamera],
    surface: Surface,
    hub: int,
    partner: int,
    *,
    moved: tuple[float, float] = (0.0, 0.0),
) -> ImageSource:
    """The partner's image in the geometry of the hub, as far as the cameras know it.

    A partner of finer pixels is averaged over the pixels of the hub and their exposure. `moved`: (lines,
    columns) px of the hub by which it is taken further on.
    """
    source, target = cameras[hub], cameras[partner]

    def mapping(lines: Array, columns: Array) -> Array:
        places = np.meshgrid(lines + moved[0], columns + moved[1], indexing="ij")
        pixels = np.stack(places, axis=-1).reshape(-1, 2)
        return predict_match(source, target, surface, pixels).reshape(len(lines), len(columns), 2)

    parts = parts_of_pixel(cameras, hub, partner)
    rough = _rough_columns(source, target, mapping, images[hub].shape)
    smooth = not isinstance(surface, Dem)
    spacing = _spacing_over_bends(mapping, images[hub].shape, rough) if smooth else RELIEF_SPACING
    places = line_places(target, surface)

    def laid(mapping: Mapping, shape: tuple[int, int]) -> WarpedImage:
        return WarpedImage(images[partner], mapping, shape, spacing, places, tuple(rough * parts[1]), smooth)

    return averaged(laid, mapping, images[hub].shape, parts)


def _rough_columns(
    source: MovingCamera, target: MovingCamera, mapping: Mapping, shape: tuple[int, int]
) -> Array:
    """Columns of the source at which the line of either camera is not smooth."""
    own, other = (
        c.rough_columns if isinstance(c, PushbroomCamera) else np.empty(0) for c in (source, target)
    )
    if not len(other):
        return own
    columns = np.arange(shape[1], dtype=np.float64)
    seen = mapping(np.linspace(0.0, shape[0] - 1.0, STEP_LINES + 2)[1:-1], columns)[..., 1]
    # whether any of `other`, which rises, lies from one column to the next, both included; none beside NaN
    low, high = np.minimum(seen[:, :-1], seen[:, 1:]), np.maximum(seen[:, :-1], seen[:, 1:])
    between = np.searchsorted(other, high, "right") > np.searchsorted(other, low, "left")
    return np.union1d(own, np.flatnonzero(between.any(axis=0)) + 0.5)


def _spacing_over_bends(mapping: Mapping, shape: tuple[int, int], rough: Array) -> int:
    """Columns apart at which a map is evaluated so that it is straight between them, where lines bend too."""
    step = max(min(BEND_COLUMNS, (shape[1] - 1) // 8), 1)
    columns = np.arange(0.0, shape[1], step)
    smooth = np.ones(max(len(columns) - 2, 0), dtype=bool)
    for column in rough:  # steps are no bends: about them the map is evaluated often anyway
        smooth &= np.abs(columns[1:-1] - column) > step
    seen = mapping(np.linspace(0.0, shape[0] - 1.0, STEP_LINES + 2)[1:-1], columns)
    bend = np.abs(np.diff(seen, 2, axis=1))[:, smooth] / step**2  # px per column^2
    most = float(np.max(bend, where=np.isfinite(bend), initial=0.0))
    # a parabola departs from its chord by an eighth of its second derivative times the square of its length
    return int(np.clip(np.sqrt(8.0 * STRAIGHT / max(most, 1e-12)), BENT_SPACING, SMOOTH_SPACING))


def line_places(camera: MovingCamera, surface: Surface) -> Array | None:
    """Where the lines of a camera stand along its track on the ground, (lines, 2), for `WarpedImage`.

    At its first and its last column, in lines of the spacing that they have about there on average; None
    where all are even.
    """
    if not isinstance(camera, PushbroomCamera) or camera.lines <= PLACE_MEAN:
        return None
    mean = np.hanning(PLACE_MEAN + 2)[1:-1]
    out = scratch_array((camera.lines, 2))
    for side, column in enumerate((0.0, camera.columns - 1.0)):
        steps = np.diff(ground_of_column(camera, surface, column), axis=0)
        known = np.isfinite(steps).all(axis=1)
        steps[~known] = 0.0
        track = np.stack([np.convolve(part, mean, "same") for part in steps.T], axis=1)
        # along the mean step, in units of it
        count = np.convolve(known, mean, "same")  # of lines, by their weight
        square = np.einsum("ni,ni->n", track, track)
        usual = np.einsum("ni,ni->n", steps, track) * count / np.where(square > 0.0, square, 1.0)
        out[:, side] = np.append(0.0, np.cumsum(np.where(known & (square > 0.0), usual, 1.0)))
    return out if np.abs(np.diff(out, 2, axis=0)).max() > EVEN else None
