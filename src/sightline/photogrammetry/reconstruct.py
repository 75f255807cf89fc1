"""Photogrammetry on a subset of frames by pycolmap (extra ``sfm``), for flights whose attitudes nobody told.

Features, matches of chosen pairs, mapping with positions as priors; the model is brought to the world by the
positions told. It is where the adjustment of all frames starts, not its result.

Not here: which frames (``frame_subset.py``), the adjustment (``frame_poses.py``).
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError, InputError
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.geometry.instrument import AreaDetector
from sightline.imaging.source import ImageSource, read_padded
from sightline.matching.follow import Followed
from sightline.photogrammetry.frame_subset import chained
from sightline.photogrammetry.point_priors import level_axes
from sightline.photogrammetry.sightings import Index, as_index

#: nm; ground is not compared in wavelengths further apart, neighbours excepted.
_ALIKE_NM = 200.0
#: Share of the lines by which two frames of a pair may have moved.
_FAR = 0.6
#: Features per frame; more cost time and tell no more.
_FEATURES = 2000


@dataclass(frozen=True, eq=False)
class Reconstruction(ReadOnlyArrays):
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
    """

    frames: Index
    position: Array
    world_from_body: Rotation
    points: Array


def filter_pairs(frames: Index, followed: Followed, detector: AreaDetector) -> list[tuple[int, int]]:
    """Pairs of frames that overlap and show it in like wavelengths.

    Parameters
    ----------
    frames : (K,) int
        Of the subset.
    followed : Followed
        How all frames moved.
    detector : AreaDetector

    Returns
    -------
    list of (int, int)
        Neighbours always; others by how far lines of one ground are apart. Frames of different stretches are
        all paired: nothing is known of them yet.
    """
    nm = detector.wavelength_nm
    per_line = 0.0 if nm is None else float(np.ptp(nm)) / max(detector.shape[0] - 1, 1)
    steps = [_between(followed, *pair) for pair in pairwise(frames.tolist())]
    out = []
    for n, first in enumerate(frames[:-1]):
        motion: Array | None = np.zeros(4)
        for m in range(n + 1, len(frames)):
            step = steps[m - 1]
            motion = None if motion is None or step is None else chained(motion, step)
            if motion is None:
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


def reconstruct(
    sources: Sequence[ImageSource],
    frames: Index,
    pairs: Sequence[tuple[int, int]],
    detector: AreaDetector,
    mount: Rotation,
    position: Array,
    sigma: Array,
    radii: tuple[float, float] | None = None,
) -> Reconstruction:
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
        m, as told.
    sigma : (M,)
        m, of each; inf where none was told.
    radii : (float, float), optional
        Of the ellipsoid whose normals are the verticals; z is up otherwise.

    Raises
    ------
    InputError
        If pycolmap is not installed, or fewer than three positions are told.
    EstimationError
        If no model of three frames comes about.
    """
    try:
        import pycolmap
    except ImportError:
        raise InputError(
            "photogrammetry on a subset needs pycolmap, which is not installed; install the extra `sfm`: "
            "pip install 'sightline[sfm]'"
        ) from None
    if np.isfinite(sigma[frames]).sum() < 3:
        raise InputError("a model is brought to the world by three positions or more; give a positions table")
    with tempfile.TemporaryDirectory() as folder:
        model = _mapped(pycolmap, Path(folder), sources, frames, pairs, detector, position, sigma)
    if model is None or model.num_reg_images() < 3:
        raise EstimationError(
            f"photogrammetry on {len(frames)} frames gave no model: they are too little alike; "
            "raise `overlap`, or give attitudes"
        )
    up = level_axes(position[frames], radii)[0].mean(axis=0)
    return _in_world(model, detector, mount, position, sigma, -up / np.linalg.norm(up))


def _mapped(
    pycolmap: Any,
    folder: Path,
    sources: Sequence[ImageSource],
    frames: Index,
    pairs: Sequence[tuple[int, int]],
    detector: AreaDetector,
    position: Array,
    sigma: Array,
) -> Any:
    """The largest model, or None."""
    names = {int(k): f"{k:06d}.png" for k in frames}
    for k, name in names.items():
        pixels = read_padded(sources[k], (0, detector.shape[0]), (0, detector.shape[1]))[0]
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
    listed = folder / "pairs.txt"
    listed.write_text("".join(f"{names[i]} {names[j]}\n" for i, j in pairs))
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = 1
    pycolmap.match_image_pairs(database, matching, pairing, device=pycolmap.Device.cpu)
    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = options.ba_refine_principal_point = options.ba_refine_extra_params = (
        False
    )
    options.multiple_models = False
    options.min_model_size = 3
    options.num_threads = 1
    options.random_seed = 0
    options.extract_colors = False
    models = pycolmap.incremental_mapping(database, folder, folder, options)
    return max(models.values(), key=lambda m: m.num_reg_images(), default=None)


def _in_world(
    model: Any, detector: AreaDetector, mount: Rotation, position: Array, sigma: Array, down: Array
) -> Reconstruction:
    """A model brought to the world by the positions told: scale, turn and move that fit them best."""
    images = sorted((image for image in model.images.values() if image.has_pose), key=lambda i: i.name)
    frames = np.array([int(image.name[:6]) for image in images])
    centre = np.array([image.projection_center() for image in images])
    camera = Rotation.from_matrix([image.cam_from_world().rotation.matrix().T for image in images])
    told = np.isfinite(sigma[frames])
    scale, turn, moved = similarity(centre[told], position[frames][told], camera[told], down)
    # columns, lines, depth in our camera's axes
    middle = np.array([detector.principal_point_px])
    steps = detector.directions(middle + np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0]]))
    axes = np.column_stack([steps[1] - steps[0], steps[2] - steps[0], steps[0]])
    ours = Rotation.from_matrix(axes / np.linalg.norm(axes, axis=0))
    points = np.array([p.xyz for p in model.points3D.values()]).reshape(-1, 3)
    return Reconstruction(
        as_index(frames, "frames"),
        frozen(scale * turn.apply(centre) + moved),
        turn * camera * ours.inv() * mount.inv(),
        frozen(scale * turn.apply(points) + moved),
    )


def similarity(places: Array, wanted: Array, camera: Rotation, down: Array) -> tuple[float, Rotation, Array]:
    """Scale, turn and move from a model to the world, by places (N, 3) in both.

    A single flight line leaves the turn about it open; cameras that look `down` on the whole close it.
    """
    a, b = places - places.mean(axis=0), wanted - wanted.mean(axis=0)
    size = float(np.sqrt((b**2).sum() / max((a**2).sum(), 1e-30)))
    view = camera.apply([0.0, 0.0, 1.0])
    # what cameras see is given a share of the flight's length: enough to decide, too little to bend
    lever = 0.05 * np.sqrt((b**2).sum() / len(b))
    from_, to = np.vstack([size * a, lever * view]), np.vstack([b, np.tile(lever * down, (len(b), 1))])
    turn, _ = Rotation.align_vectors(to, from_)
    return size, turn, wanted.mean(axis=0) - size * turn.apply(places.mean(axis=0))
