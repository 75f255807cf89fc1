"""Photogrammetry on a subset of frames by pycolmap (extra ``sfm``), for flights without given attitudes.

Features, matches of chosen pairs, mapping with positions as priors; the model is brought to the world by the
given positions, and adjusted once more with all that tables say, which gives it a covariance. It is where the
adjustment of all frames starts, not its result.

Not here: which frames (``subset.py``), the adjustment (``poses.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError, InputError
from sightline.execution import signals_kept
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.geometry.instrument import AreaDetector
from sightline.imaging.source import ImageSource, read_padded
from sightline.matching.follow import Followed
from sightline.photogrammetry.block.descent import DivergedError
from sightline.photogrammetry.block.point_priors import HeightPrior, PointPriors, level_axes
from sightline.photogrammetry.flight.poses import FramePoses, RoughPoses, adjust_frames
from sightline.photogrammetry.flight.subset import chained
from sightline.photogrammetry.flight.track_noise import with_drift
from sightline.photogrammetry.sightings import Images, Index, Tracks, as_index, sight_frames
from sightline.writing import scratch_folder

#: nm; ground is not compared in wavelengths further apart, neighbours excepted.
_ALIKE_NM = 200.0
#: Share of the lines by which two frames of a pair may have moved.
_FAR = 0.6
#: Features per frame; more cost time and add no more.
_FEATURES = 2000
#: px; frames whose shorter side is at least this are searched for features as they are. Smaller ones are
#: searched at twice their size: it finds what they would lack, at five times the cost.
_LARGE = 500
#: px; noise of a feature before residuals show it.
_SIGMA_PX = 0.5
#: Sightings per frame that the model is adjusted with: the points seen most often.
_ADJUSTED = 250
#: rad; mapping's least angles between rays to a point are for fields of this, or wider.
_WIDE = 1.0
#: Points that a frame of a model shows at least: three give its pose, as many more say whether it is right.
_LEAST_POINTS = 6
#: rad; cameras of which no attitude is given look down on the whole within this.
_DOWN = 0.2
#: rad; attitudes of a model, of each frame and of all: what a first solution is held by.
_HELD, _HELD_ALL = 0.01, 0.02


@dataclass(frozen=True, eq=False)
class FrameModel(ReadOnlyArrays):
    """A model made of some frames.

    Attributes
    ----------
    frames : (K,) int
        Those it holds.
    position : (K, 3)
        m, world axes.
    world_from_body : Rotation
        K.
    points : (n, 3)
        m
    tracks : Tracks
        Where they were seen: `image` counts `frames`, `point` counts `points`.
    """

    frames: Index
    position: Array
    world_from_body: Rotation
    points: Array
    tracks: Tracks


def filter_pairs(
    frames: Index,
    followed: Followed,
    detector: AreaDetector,
    position: Array | None = None,
    reach: Array | None = None,
) -> list[tuple[int, int]]:
    """Pairs of frames that overlap and show it in like wavelengths.

    Parameters
    ----------
    frames : (K,) int
        Of the subset.
    followed : Followed
        How all frames moved.
    detector : AreaDetector
    position : (M, 3), optional
        m, as well as it is known.
    reach : (M,), optional
        m; the ground that a frame shows lies within this of its place, errors of the place included. inf
        where nothing is given.

    Returns
    -------
    list of (int, int)
        Neighbours always; others by how far lines of one ground are apart. Nothing is known of how frames of
        different stretches moved: they are paired where they may show the same ground.
    """
    nm = detector.wavelength_nm
    per_line = 0.0 if nm is None else float(np.ptp(nm)) / max(detector.shape[0] - 1, 1)
    steps = [_between(followed, *pair) for pair in pairwise(frames.tolist())]
    out = []
    for n, first in enumerate(frames[:-1]):
        apart = _may_meet(int(first), frames, position, reach)
        motion: Array | None = np.zeros(4)
        for m in range(n + 1, len(frames)):
            step = steps[m - 1]
            motion = None if motion is None or step is None else chained(motion, step)
            if motion is None:
                if apart[m]:
                    out.append((int(first), int(frames[m])))
                continue
            lines = abs(float(motion[0]))
            alike = lines * per_line <= _ALIKE_NM and lines <= _FAR * detector.shape[0]
            if m == n + 1 or alike:
                out.append((int(first), int(frames[m])))
    return out


def _between(followed: Followed, first: int, last: int) -> Array | None:
    """How frames moved from one to another after it; None where a stretch begins between them."""
    motion = np.zeros(4)
    for k in range(first + 1, last + 1):
        if np.isfinite(followed.motion[k]).all():
            motion = chained(motion, followed.motion[k])
        elif followed.windows[k]:
            return None
    return motion


def _may_meet(first: int, frames: Index, position: Array | None, reach: Array | None) -> NDArray[np.bool_]:
    """Which frames (K,) of the subset may show ground that `first` shows, by where they were taken."""
    if position is None or reach is None:
        return np.ones(len(frames), dtype=np.bool_)
    far = np.linalg.norm(position[frames] - position[first], axis=1)
    return np.asarray(far <= reach[frames] + reach[first])


def check_positions(sigma: Array) -> None:
    """InputError where fewer than three positions are given; `sigma` as of `check_modelling`."""
    given = int(np.isfinite(sigma.sum(axis=1)).sum())
    if given < 3:
        raise InputError(
            f"a model of the frames is brought to the world by three positions or more, {given} are given; "
            "give positions or attitudes of the frames"
        )


def check_modelling(sigma: Array) -> Any:
    """pycolmap, if a model can be made and brought to the world.

    Parameters
    ----------
    sigma : (M, 3)
        m, of the positions of frames; inf where none is given.

    Raises
    ------
    InputError
        If pycolmap is not installed, or fewer than three positions are given.
    """
    check_positions(sigma)
    try:
        with signals_kept():
            import pycolmap
    except ImportError:
        raise InputError(
            "photogrammetry on a subset needs pycolmap, which is not installed; run "
            "`pip install pycolmap`, or give attitudes"
        ) from None
    return pycolmap


def reconstruct(
    sources: Sequence[ImageSource],
    frames: Index,
    pairs: Sequence[tuple[int, int]],
    detector: AreaDetector,
    mount: Rotation,
    position: Array,
    sigma: Array,
    radii: tuple[float, float] | None = None,
    *,
    enlarged: bool | None = None,
    at_first_line: Callable[[Index, Array], Array] | None = None,
) -> FrameModel:
    """A model of the frames of a subset.

    Parameters
    ----------
    sources : sequence of ImageSource
        M frames.
    frames : (K,) int
        Of the subset.
    pairs : sequence of (int, int)
        Frames that are compared.
    detector, mount
        Of all frames. Tangential distortion is left out: the adjustment knows it.
    position : (M, 3)
        m, as given.
    sigma : (M, 3)
        m, of each axis; inf where none was given.
    radii : (float, float), optional
        Of the ellipsoid whose normals are the verticals; z is up otherwise.
    enlarged : bool, optional
        Search features at twice the size of frames, as pycolmap does: more of them, at five times the cost.
        Small frames are, large ones not, otherwise.
    at_first_line : callable, optional
        Pixels (N, 2) of frames (N,) as if all lines were exposed with the first: of a rolling shutter.
        Mapping knows none, and would take its stretch and shear for other heights and views.

    Raises
    ------
    InputError
        If pycolmap is not installed, or fewer than three positions are given.
    EstimationError
        If no model of three frames comes about.
    """
    pycolmap = check_modelling(sigma[frames])
    enlarged = min(detector.shape) < _LARGE if enlarged is None else enlarged
    with scratch_folder() as folder:
        model = _mapped(
            pycolmap, folder, sources, frames, pairs, detector, position, sigma, enlarged, at_first_line
        )
    placed = 0 if model is None else len(_placed(model))
    if placed < 3:
        raise EstimationError(
            f"photogrammetry on {len(frames)} frames gave no model: {placed} of them share {_LEAST_POINTS} "
            "points or more with depth, 3 are needed; they are too little alike, show too little, or see too "
            f"narrow a field for depth {_field_words(detector)}; raise `overlap`, or give attitudes"
        )
    up = level_axes(position[frames], radii)[0].mean(axis=0)
    return _in_world(model, detector, mount, position, sigma, -up / np.linalg.norm(up))


def _field_words(detector: AreaDetector) -> str:
    """Field of view in words, (lines x columns)."""
    lines, columns = np.degrees(2.0 * np.arctan(0.5 * np.array(detector.shape) / detector.focal_length_px))
    return f"({lines:.2g} x {columns:.2g} degrees)"


def _mapped(
    pycolmap: Any,
    folder: Path,
    sources: Sequence[ImageSource],
    frames: Index,
    pairs: Sequence[tuple[int, int]],
    detector: AreaDetector,
    position: Array,
    sigma: Array,
    enlarged: bool,
    at_first_line: Callable[[Index, Array], Array] | None,
) -> Any:
    """The largest model, or None."""
    names = {int(k): f"{k:06d}.png" for k in frames}
    gain = _line_gain(sources, frames, detector)
    for k, name in names.items():
        pixels = read_padded(sources[k], (0, detector.shape[0]), (0, detector.shape[1]))[0] / gain
        low, high = np.quantile(pixels[::4, ::4], [0.005, 0.995])
        bytes_ = np.clip(255.0 * (pixels - low) / max(float(high - low), 1e-9), 0.0, 255.0).astype(np.uint8)
        pycolmap.Bitmap.from_array(bytes_).write(str(folder / name))
    database = folder / "database.db"
    reader, extraction = pycolmap.ImageReaderOptions(), pycolmap.FeatureExtractionOptions()
    reader.camera_model = "FULL_OPENCV"
    f, (line, column) = detector.focal_length_px, detector.principal_point_px
    k1, k2, _, _, k3 = (*detector.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
    # their pixels are counted from the corner of the first
    numbers = [f, f, column + 0.5, line + 0.5, k1, k2, 0.0, 0.0, k3, 0.0, 0.0, 0.0]
    reader.camera_params = ",".join(map(str, numbers))
    extraction.sift.max_num_features = _FEATURES
    extraction.sift.first_octave = -1 if enlarged else 0
    extraction.num_threads = 1
    pycolmap.logging.minloglevel = 3
    pycolmap.extract_features(
        database,
        folder,
        list(names.values()),
        pycolmap.CameraMode.SINGLE,
        reader,
        extraction,
        pycolmap.Device.cpu,
    )
    if at_first_line is not None:
        _move_features(pycolmap, database, names, at_first_line)
    listed = folder / "pairs.txt"
    listed.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in pairs))
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = 1
    pycolmap.match_image_pairs(database, matching, pairing, device=pycolmap.Device.cpu)
    _write_priors(pycolmap, database, names, position, sigma)
    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = options.ba_refine_principal_point = options.ba_refine_extra_params = (
        False
    )
    options.multiple_models = False
    options.min_model_size = 3
    options.num_threads = 1
    options.random_seed = 0
    options.extract_colors = False
    options.use_prior_position = True
    # of a narrow field all points are seen at angles that are taken for none in a wide one
    narrow, mapper = min(1.0, min(detector.shape) / detector.focal_length_px / _WIDE), options.mapper
    mapper.init_min_tri_angle *= narrow
    mapper.ba_local_min_tri_angle *= narrow
    mapper.filter_min_tri_angle *= narrow
    options.triangulation.min_angle *= narrow
    models = pycolmap.incremental_mapping(database, folder, folder, options)
    return max(models.values(), key=lambda m: m.num_reg_images(), default=None)


def _move_features(
    pycolmap: Any, database: Path, names: dict[int, str], moved: Callable[[Index, Array], Array]
) -> None:
    """Features of all frames at `moved` pixels."""
    with pycolmap.Database.open(str(database)) as store:
        images = [store.read_image_with_name(name).image_id for name in names.values()]
        features = [store.read_keypoints(image) for image in images]
        rows = np.repeat(np.array(list(names)), [len(each) for each in features])
        # theirs are (column, line), counted from the corner of the first
        pixels = moved(rows, np.concatenate(features)[:, 1::-1].astype(np.float64) - 0.5)
        ends = np.cumsum([len(each) for each in features])[:-1]
        for image, each, own in zip(images, features, np.split(pixels, ends), strict=True):
            each[:, :2] = own[:, ::-1] + 0.5
            store.update_keypoints(image, each)


def _line_gain(sources: Sequence[ImageSource], frames: Index, detector: AreaDetector) -> NDArray[np.float32]:
    """(lines, 1): brightness of each line over that of all.

    A filter whose brightness changes along the lines draws every blob towards the brighter side, by more
    where it changes faster: errors that go with the line.
    """
    whole = (0, detector.shape[0]), (0, detector.shape[1])
    lines = [read_padded(sources[k], *whole)[0].mean(axis=1) for k in frames]
    gain = np.mean([line / max(float(line.mean()), 1e-6) for line in lines], axis=0)
    return np.asarray(np.maximum(gain, 0.05), dtype=np.float32)[:, None]


def _write_priors(
    pycolmap: Any, database: Path, names: dict[int, str], position: Array, sigma: Array
) -> None:
    """Given positions, about their middle: what mapping holds places to."""
    given = [k for k in names if np.isfinite(sigma[k]).all()]
    middle = position[given].mean(axis=0)
    with pycolmap.Database.open(str(database)) as store:
        for k in given:
            prior = pycolmap.PosePrior(
                corr_data_id=store.read_image_with_name(names[k]).data_id,
                position=position[k] - middle,
                position_covariance=np.diag(sigma[k] ** 2),
                coordinate_system=pycolmap.PosePriorCoordinateSystem.CARTESIAN,
            )
            store.write_pose_prior(prior)


def _in_world(
    model: Any, detector: AreaDetector, mount: Rotation, position: Array, sigma: Array, down: Array
) -> FrameModel:
    """A model brought to the world by the given positions: scale, turn and move that fit them best."""
    images = _placed(model)
    frames = np.array([int(image.name[:6]) for image in images])
    centre = np.array([image.projection_center() for image in images])
    camera = Rotation.from_matrix([image.cam_from_world().rotation.matrix().T for image in images])
    given = np.isfinite(sigma.sum(axis=1))
    known = given[frames]
    if known.sum() < 3:
        raise EstimationError(
            f"the model holds {len(frames)} frames, and positions of {known.sum()} are given"
        )
    loose = float(np.median(sigma[frames][known]))
    scale, turn, moved = similarity(centre[known], position[frames][known], camera[known], down, loose)
    # rays that are nearly parallel show ground and its mirror image, seen from below, alike
    if (turn * camera).apply([0.0, 0.0, 1.0]).mean(axis=0) @ down < 0.0:
        raise EstimationError(
            f"photogrammetry gave a model of {len(frames)} frames that sees the ground from below: their "
            f"field is too narrow for depth {_field_words(detector)}, or axes of the positions are "
            "exchanged; check [world], raise `overlap`, or give attitudes"
        )
    # columns, lines, depth in our camera's axes
    middle = np.array([detector.principal_point_px])
    steps = detector.directions(middle + np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]]))
    axes = np.column_stack([steps[1] - steps[0], steps[2] - steps[0], steps[0]])
    ours = Rotation.from_matrix(axes / np.linalg.norm(axes, axis=0))
    points = np.array([p.xyz for p in model.points3D.values()]).reshape(-1, 3)
    tracks = _tracks(model, images)
    return FrameModel(
        as_index(frames, "frames"),
        frozen(scale * turn.apply(centre) + moved),
        turn * camera * ours.inv() * mount.inv(),
        frozen(scale * turn.apply(points) + moved),
        tracks,
    )


def _placed(model: Any) -> list[Any]:
    """Images of a model in the order of its frames, whose poses points of it give.

    Mapping keeps images whose points it has all taken back, such as for too little parallax.
    """
    seen = (i for i in model.images.values() if i.has_pose and i.num_points3D >= _LEAST_POINTS)
    return sorted(seen, key=lambda image: image.name)


def _tracks(model: Any, images: Sequence[Any]) -> Tracks:
    """Where the points of a model were seen; `images` in the order of its frames."""
    row = {point: n for n, point in enumerate(model.points3D)}
    image, point, pixels = [], [], []
    for n, seen in enumerate(images):
        for spot in seen.get_observation_points2D():
            image.append(n)
            point.append(row[spot.point3D_id])
            pixels.append((spot.xy[1] - 0.5, spot.xy[0] - 0.5))
    return Tracks(np.array(image), np.array(point), np.array(pixels), np.array(_SIGMA_PX))


@dataclass(frozen=True, eq=False)
class RefinedModel(ReadOnlyArrays):
    """Poses of the frames of a model, adjusted.

    Attributes
    ----------
    frames : (K,) int
    poses : FramePoses
        K, with covariance; `bow` says by how much each stretch may be bent.
    """

    frames: Index
    poses: FramePoses


def looking_down(known: RoughPoses) -> RoughPoses:
    """What is known where neither attitudes nor heights are given: that cameras look down on the whole.

    They do so as the model has it, to 0.2 rad. A single flight line may be turned about itself otherwise,
    with all ground under it. Frames of a narrow field, which tell little of where they look, are led astray
    over ground of known height too.
    """
    if np.isfinite(known.attitude).any():
        return known
    return replace(known, attitude=np.full_like(known.attitude, _DOWN), attitude_bias=_DOWN)


def held(known: RoughPoses) -> RoughPoses:
    """What is known, and attitudes of a model where none are given: for a first solution only.

    A strip that may hardly be known to turn about itself would be turned by half a radian in its first step,
    and not come back.
    """
    none = ~np.isfinite(known.attitude)
    if not none.any():
        return known
    attitude = np.where(none, _HELD, known.attitude)
    return replace(known, attitude=attitude, attitude_bias=max(known.attitude_bias, _HELD_ALL))


def refined(
    model: FrameModel,
    images: Images,
    known: RoughPoses,
    detector: AreaDetector,
    mount: Rotation,
    heights: HeightPrior | None = None,
) -> RefinedModel:
    """A model adjusted with all that tables say of its frames: places, attitudes, their constant errors.

    Parameters
    ----------
    model : Reconstruction
    images : Images
        M frames as the tables have them.
    known : RoughPoses
        How rough they are.
    detector, mount
        Of all frames.
    heights : HeightPrior, optional
        What is known of the height of the ground in each frame, once; without it and without attitudes,
        cameras look down on the whole (`looking_down`).

    Returns
    -------
    RefinedModel

    Raises
    ------
    EstimationError
        If the model and the tables contradict each other.
    """
    rows = model.frames
    count = as_index(np.zeros(len(rows)), "camera"), as_index(np.arange(len(rows)), "shot"), images.t[rows]
    near = Images(*count, model.position, model.world_from_body)
    place, turn = (np.isfinite(sigma[rows].sum(axis=1)) for sigma in (known.position, known.attitude))
    given = Images(
        *count,
        np.where(place[:, None], images.position[rows], model.position),
        Rotation.from_quat(
            np.where(turn[:, None], images.world_from_body[rows].as_quat(), model.world_from_body.as_quat())
        ),
    )
    rough = known[rows]
    tracks, points = _seen_most(model)
    priors, first = None, held(rough)
    if heights is None:
        rough = looking_down(rough)
    else:
        # a surface is wrong over a whole frame alike: all points in it together give its height once
        each = heights.sigma * np.sqrt(len(tracks) / len(rows))
        priors = PointPriors(HeightPrior(heights.surface, each, heights.radii), None)
    # their noise is not known beforehand: residuals of a first solution show it, and how it drifts
    for known_now in (first, rough):
        sightings = sight_frames(given, [detector], [mount], tracks)
        adjusted = partial(adjust_frames, given, sightings, priors=priors, points=points, start=near)
        try:
            poses = adjusted(known_now)
        except DivergedError:
            if known_now is first or looking_down(rough) is rough:
                raise
            poses = adjusted(looking_down(rough))
        tracks = with_drift(tracks, poses.residual_px, ~poses.rejected)
        near = Images(*count, poses.position, poses.world_from_body)
        points = np.where(np.isfinite(poses.points), poses.points, points)
    return RefinedModel(rows, poses)


def _seen_most(model: FrameModel) -> tuple[Tracks, Array]:
    """The sightings of the points seen most often, and these points."""
    tracks = model.tracks
    seen = np.bincount(tracks.point, minlength=len(model.points))
    order = np.argsort(-seen, kind="stable")
    enough = int(np.searchsorted(np.cumsum(seen[order]), _ADJUSTED * len(model.frames))) + 1
    kept = np.sort(order[:enough])
    name = np.full(len(seen), -1)
    name[kept] = np.arange(len(kept))
    rows = np.flatnonzero(name[tracks.point] >= 0)
    return (
        Tracks(tracks.image[rows], name[tracks.point[rows]], tracks.pixels[rows], tracks.sigma_px[rows]),
        model.points[kept],
    )


def similarity(
    places: Array, wanted: Array, camera: Rotation, down: Array, sigma: float
) -> tuple[float, Rotation, Array]:
    """Scale, turn and move from a model to the world, by places (N, 3) in both.

    A single flight line leaves the turn about it open; cameras that look `down` on the whole, to some
    degrees, close it. `sigma` (m) is that of the places wanted.
    """
    a, b = places - places.mean(axis=0), wanted - wanted.mean(axis=0)
    size = float(np.sqrt((b**2).sum() / max((a**2).sum(), 1e-30)))
    view = camera.apply([0.0, 0.0, 1.0])
    # all views together give the turn to _DOWN, each place its own to sigma / distance
    lever = max(sigma, 1e-6 * size) / (_DOWN * np.sqrt(len(b)))
    from_, to = np.vstack([size * a, lever * view]), np.vstack([b, np.tile(lever * down, (len(b), 1))])
    turn, _ = Rotation.align_vectors(to, from_)
    return size, turn, wanted.mean(axis=0) - size * turn.apply(places.mean(axis=0))
