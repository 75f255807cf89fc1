"""Windows found in frames that overlap by some half, by features first (pycolmap, extra ``sfm``).

Frames far apart look alike in places only, and turned, tilted and larger or smaller. Features that fit one
geometry say where each place of a frame lies in another; windows are then found there to a fraction of a
pixel, as everywhere else. The result has the form of windows followed from frame to frame.

Not here: frames that overlap nearly whole (``matching/follow.py``); a model (``reconstruct.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError, SightlineError
from sightline.execution import signals_kept
from sightline.geometry.checks import Array, frozen
from sightline.imaging.reduce import ReducedImage, pattern_means, whole_pixels
from sightline.imaging.source import ArrayImage, ImageSource, read_padded
from sightline.matching.displacement import DisplacementField
from sightline.matching.follow import NOTHING, Followed, FollowPlan, FollowState, follow_windows
from sightline.matching.on_geometry import PairOnGeometry
from sightline.matching.select import spread_subset
from sightline.matching.whitening import gradient_filter
from sightline.writing import scratch_folder

__all__ = ["WidePlan", "link_widely", "wide_pairs"]

Index = NDArray[np.intp]
_InPartner = tuple[Index, Array, Array]

#: px; longest side that features are sought at: finer ones take long and are distinguished no better.
_LONGEST_SIDE = 1600
#: Features of a frame; pairs of features of two frames that must fit one geometry.
_FEATURES, _LEAST_FEATURES = 4000, 20
#: Points of a pair that must be found for the pair to count.
_LEAST_WINDOWS = 10
#: Cells along each side that share windows evenly.
_CELLS = 8
#: px; how far a window may lie from where features say, and from where those around it say.
_SEARCH, _APART = 2, 4.0
#: px; by how much two views of one place differ as the views do; error of a feature, where none is estimated.
_FLOOR, _LOOSE = 0.1, 0.7
#: Frames before and after each that are tried; all pairs are where there are few frames.
_NEIGHBOURS, _FEW = 4, 24
#: px; half the step over which the local geometry between two frames is taken.
_STEP = 8.0
#: Share of the frames that must have been followed from another for features not to be tried; and frames from
#: which on a sequence that was followed in parts is not looked at again.
_FOLLOWED, _MANY = 0.65, 300
#: Share of the frames that features must link beyond those followed.
_MORE = 0.1


@dataclass(frozen=True)
class WidePlan:
    """How windows are sought.

    Attributes
    ----------
    points : int
        Windows of each frame that are sought in the others.
    window : int
        px, side of a window.
    min_score : float
        Lowest normalised correlation of two windows.
    reduction : int
        Pixels are averaged in squares of a side that is a multiple of this: the period of a mosaic filter.
    """

    points: int = 250
    window: int = 21
    min_score: float = 0.5
    reduction: int = 1

    def __post_init__(self) -> None:
        """Check."""
        if self.points < _LEAST_WINDOWS or self.window < 9 or self.window % 2 == 0:
            raise InputError(
                f"points must be {_LEAST_WINDOWS} or more, window odd and 9 px or more; got {self.points} "
                f"and {self.window}"
            )
        if not 0.0 < self.min_score < 1.0:
            raise InputError(f"min_score must be between 0 and 1, got {self.min_score}")


def wide_pairs(frames: Index, position: Array, sigma: Array) -> list[tuple[int, int]]:
    """Pairs of frames that may show the same ground.

    Parameters
    ----------
    frames : (K,) int
        Those that have an image, in the order of their times.
    position : (M, 3)
        m, of all frames.
    sigma : (M, 3)
        m; inf where none was given.

    Returns
    -------
    list of (int, int)
        All pairs of few frames; of many those near each other in time, and those nearest by their positions.
    """
    if len(frames) <= _FEW:
        return [(int(i), int(j)) for n, i in enumerate(frames) for j in frames[n + 1 :]]
    pairs = {(int(i), int(j)) for n, i in enumerate(frames) for j in frames[n + 1 : n + 1 + _NEIGHBOURS]}
    given = frames[np.isfinite(sigma[frames]).all(axis=1)]
    if len(given) > 2 * _NEIGHBOURS:
        from scipy.spatial import cKDTree

        near = cKDTree(position[given]).query(position[given], k=2 * _NEIGHBOURS + 1)[1]
        for i, others in zip(given, given[near], strict=True):
            pairs |= {(min(int(i), int(j)), max(int(i), int(j))) for j in others if j != i}
    return sorted(pairs)


def link_widely(
    sources: Sequence[ImageSource | None],
    pairs: Sequence[tuple[int, int]],
    plan: WidePlan | None = None,
    *,
    progress: Callable[[int], None] | None = None,
) -> Followed:
    """Windows of frames found in the frames that overlap them by some half.

    Parameters
    ----------
    sources : sequence of ImageSource or None
        M frames of one size; None where there is none.
    pairs : sequence of (int, int)
        Frames that are compared, the earlier first.
    plan : WidePlan, optional
    progress : callable, optional
        Called with the number of frames done.

    Returns
    -------
    Followed
        Every frame is linked to the nearest one before it that shows the same ground.

    Raises
    ------
    InputError
        If pycolmap is not installed.
    EstimationError
        If no two frames show the same ground.
    """
    plan = plan or WidePlan()
    frames = {
        k: frame
        for k in sorted({k for pair in pairs for k in pair})
        if (frame := _read(sources[k], plan.reduction))
    }
    usable = [pair for pair in pairs if pair[0] in frames and pair[1] in frames]
    features = _verified(frames, usable) if usable else {}
    found = _Found(len(sources))
    for number, i in enumerate(frames):
        partners = {j: matched for (first, j), matched in features.items() if first == i}
        if partners:
            found.add_hub(frames[i], i, *_windows_of(frames, i, partners, plan))
        if progress is not None:
            progress(number + 1)
    return found.assembled(frames, sources)


@dataclass(frozen=True, eq=False)
class _Frame:
    """A frame as it is looked at."""

    small: ArrayImage
    factor: int

    def whole(self, pixels: Array) -> Array:
        """Pixels of the reduced frame in the frame."""
        return whole_pixels(pixels, self.factor)


def _read(source: ImageSource | None, reduction: int) -> _Frame | None:
    if source is None:
        return None
    coarser = -(-max(source.shape) // (_LONGEST_SIDE * reduction))
    factor = reduction * coarser
    try:
        plain = source if reduction == 1 else pattern_means(source, reduction)
        reduced = plain if coarser == 1 else ReducedImage(plain, coarser)
        return _Frame(ArrayImage(*read_padded(reduced, (0, reduced.shape[0]), (0, reduced.shape[1]))), factor)
    except (SightlineError, OSError):
        return None


def _verified(
    frames: dict[int, _Frame], pairs: Sequence[tuple[int, int]]
) -> dict[tuple[int, int], tuple[Array, Array]]:
    """Of each pair that shows the same ground, features (N, 2) in both, pixels of the reduced frames."""
    try:
        with signals_kept():
            import pycolmap
    except ImportError:
        raise InputError(
            "too few windows could be followed from frame to frame (little overlap, or steps or turns too "
            "large), and features need pycolmap, which is not installed; run "
            "`pip install pycolmap`"
        ) from None
    names = {k: f"{k:06d}.png" for k in frames}
    with scratch_folder() as path:
        for k, frame in frames.items():
            shape = frame.small.shape
            pixels = frame.small.read((0, shape[0]), (0, shape[1]))
            low, high = np.quantile(pixels[::4, ::4], [0.005, 0.995])
            levels = np.clip(255.0 * (pixels - low) / max(float(high - low), 1e-9), 0.0, 255.0)
            pycolmap.Bitmap.from_array(levels.astype(np.uint8)).write(str(path / names[k]))
        _compare(pycolmap, path, [(names[i], names[j]) for i, j in pairs], list(names.values()))
        return _read_matches(pycolmap, path, names, pairs)


def _compare(pycolmap: Any, folder: Path, pairs: list[tuple[str, str]], names: list[str]) -> None:
    """Features of images and their matches, in ``database.db``."""
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.sift.max_num_features = _FEATURES
    extraction.num_threads = 1
    pycolmap.logging.minloglevel = 3
    pycolmap.set_random_seed(0)
    database = folder / "database.db"
    pycolmap.extract_features(
        database, folder, names, pycolmap.CameraMode.SINGLE, extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )  # fmt: skip
    listed = folder / "pairs.txt"
    listed.write_text("".join(f"{i} {j}\n" for i, j in pairs))
    pairing, matching = pycolmap.ImportedPairingOptions(), pycolmap.FeatureMatchingOptions()
    pairing.match_list_path = listed
    matching.num_threads = 1
    verification = pycolmap.TwoViewGeometryOptions()
    verification.min_num_inliers = _LEAST_FEATURES
    verification.ransac.random_seed = 0
    pycolmap.match_image_pairs(database, matching, pairing, verification, device=pycolmap.Device.cpu)


def _read_matches(
    pycolmap: Any, folder: Path, names: dict[int, str], pairs: Sequence[tuple[int, int]]
) -> dict[tuple[int, int], tuple[Array, Array]]:
    """Matches that fit one geometry."""
    out = {}
    database = pycolmap.Database.open(folder / "database.db")
    try:
        number = {k: database.read_image_with_name(name).image_id for k, name in names.items()}
        # columns first, counted from the corner of the first pixel
        places = {k: database.read_keypoints(n)[:, 1::-1] - 0.5 for k, n in number.items()}
        for i, j in pairs:
            if not database.exists_two_view_geometry(number[i], number[j]):
                continue
            rows = database.read_two_view_geometry(number[i], number[j]).inlier_matches
            if len(rows) >= _LEAST_FEATURES:
                a, b = places[i][rows[:, 0]], places[j][rows[:, 1]]
                out[i, j] = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    finally:
        database.close()
    return out


class _View:
    """Where places of one frame lie in another, by features in both."""

    def __init__(self, a: Array, b: Array) -> None:
        self.linear = fit_affine(a, b)
        self.field = DisplacementField(a, b - _affine(self.linear, a))

    def __call__(self, pixels: Array, height: float = 0.0, /) -> Array:
        """The `PixelMap` of the pair; heights are what features themselves have shown."""
        return _affine(self.linear, pixels) + self.field.at(pixels)


def fit_affine(a: Array, b: Array) -> Array:
    """Rows (3, 2): b = [1, a] @ rows for most of the points (N, 2), whatever the others say."""
    rows = np.column_stack([np.ones(len(a)), a])
    weight = np.ones(len(a))
    for _ in range(20):
        root = np.sqrt(weight)[:, None]
        found = np.linalg.lstsq(root * rows, root * b, rcond=None)[0]
        miss = np.linalg.norm(rows @ found - b, axis=1)
        weight = 1.0 / np.maximum(miss, max(float(np.median(miss)), 0.1))
    return np.asarray(found)


def _affine(rows: Array, places: Array) -> Array:
    return np.asarray(rows[0] + places @ rows[1:])


def fit_similarity(a: Array, b: Array, middle: Array) -> Array:
    """Motion (4,) as of `Followed.motion` that carries points a to b, turns of any size.

    Parameters
    ----------
    a, b : (N, 2)
        (line, column), px; most of them right.
    middle : (2,)
    """
    rows = fit_affine(a - middle, b)
    c, s = 0.5 * (rows[1, 0] + rows[2, 1]), 0.5 * (rows[1, 1] - rows[2, 0])
    return np.array([*(rows[0] - middle), np.arctan2(s, c), np.hypot(c, s) - 1.0])


def _windows_of(
    frames: dict[int, _Frame], i: int, partners: dict[int, tuple[Array, Array]], plan: WidePlan
) -> tuple[Array, dict[int, _InPartner]]:
    """Windows of a frame, and of each partner the rows, pixels and variances of those found there.

    Pixels of the reduced frames. Windows lie on features: what else there is seldom looks alike from afar.
    """
    hub = frames[i].small
    points, number = np.unique(np.concatenate([a for a, _ in partners.values()]), axis=0, return_inverse=True)
    seen = np.bincount(number.reshape(-1)).astype(np.float64)
    margin = 0.5 * plan.window + 1.0
    seen[((points < margin) | (points > np.array(hub.shape) - 1.0 - margin)).any(axis=1)] = np.nan
    chosen = spread_subset(points, seen, plan.points, (_CELLS, _CELLS))
    row_of = np.full(len(points), -1, dtype=np.intp)
    row_of[chosen] = np.arange(len(chosen))
    out, first = {}, 0
    for j, (a, b) in partners.items():
        row = row_of[number.reshape(-1)[first : first + len(a)]]
        first += len(a)
        sought = np.full((len(chosen), 2), np.nan)
        sought[row[row >= 0]] = b[row >= 0]
        pair = PairOnGeometry(hub, frames[j].small, _View(a, b), step=_STEP)
        found = _in_partner(pair, points[chosen], sought, plan)
        if found is not None:
            out[j] = found
    return points[chosen], out


def _in_partner(pair: PairOnGeometry, points: Array, sought: Array, plan: WidePlan) -> _InPartner | None:
    """Rows, pixels and variances (hub's and own share, (2, n)) of windows found; None if too few.

    `sought` (N, 2): where features put points, NaN where they do not.
    """
    place = pair.where(points)
    # a feature that does not go with those around it fits the geometry by chance
    by_feature = np.linalg.norm(np.nan_to_num(sought, nan=np.inf) - place, axis=1) < _APART
    found = pair.found(
        points, at=np.where(by_feature[:, None], sought, place), window=(plan.window, plan.window),
        search_px=(_SEARCH, _SEARCH), whitening=gradient_filter(), min_score=plan.min_score, threads=1,
    )  # fmt: skip
    matches = found.matches
    by_window = matches.kept & (np.linalg.norm(np.nan_to_num(matches.b, nan=np.inf) - place, axis=1) < _APART)
    if (by_feature | by_window).sum() < _LEAST_WINDOWS:
        return None
    variance = np.stack(found.variances()[::-1]) + _FLOOR**2
    both = by_feature & by_window
    # how well features are placed is estimated from those whose windows were found too
    miss = np.median(np.abs((matches.b - sought)[both])) / 0.6745 if both.sum() >= _LEAST_WINDOWS else _LOOSE
    variance[:, ~by_window] = 0.5 * max(float(miss), _FLOOR) ** 2 + _FLOOR**2
    rows = np.flatnonzero(by_feature | by_window)
    return rows, np.where(by_window[:, None], matches.b, sought)[rows], variance[:, rows]


class _Found:
    """Sightings as they come."""

    def __init__(self, count: int) -> None:
        self.count, self.names = count, 0
        self.parts: list[tuple[Index, Index, Array, Array]] = []
        self.links: dict[tuple[int, int], Array] = {}

    def add_hub(self, frame: _Frame, hub: int, points: Array, found: dict[int, _InPartner]) -> None:
        """Windows of a frame that were found in others, pixels as they were looked at."""
        if not found:
            return
        own = np.full(len(points), np.inf)
        for rows, _, variance in found.values():
            own[rows] = np.minimum(own[rows], variance[0])
        seen = np.flatnonzero(np.isfinite(own))
        own *= frame.factor**2
        points = frame.whole(points)
        self._write(hub, seen, points[seen], own[seen])
        for j, (rows, pixels, variance) in found.items():
            there = frame.whole(pixels)
            self._write(j, rows, there, variance[1] * frame.factor**2)
            self.links[hub, j] = np.concatenate([points[rows], there], axis=1)
        self.names += len(points)

    def _write(self, image: int, rows: Index, pixels: Array, variance: Array) -> None:
        self.parts.append((np.full(len(rows), image), self.names + rows, pixels, variance))

    def assembled(self, frames: dict[int, _Frame], sources: Sequence[ImageSource | None]) -> Followed:
        """All sightings, and how frames moved."""
        if not self.parts:
            raise EstimationError(NOTHING)
        image, point, pixels, variance = (np.concatenate(p) for p in zip(*self.parts, strict=True))
        order = np.lexsort((image, point))
        before, motion = np.full(self.count, -1, dtype=np.intp), np.full((self.count, 4), np.nan)
        for i, j in sorted(self.links):
            middle = frames[i].whole(0.5 * (np.array(frames[i].small.shape) - 1.0))
            places = self.links[i, j]
            before[j], motion[j] = i, fit_similarity(places[:, :2], places[:, 2:], middle)
        windows = np.bincount(image, minlength=self.count)
        sharpness, contrast = np.full(self.count, np.nan), np.full(self.count, np.nan)
        reason = [""] * self.count
        for k, source in enumerate(sources):
            if k in frames:
                sharpness[k], contrast[k] = _sharpness(frames[k].small)
                reason[k] = "" if windows[k] else "shows nothing that another frame shows"
            elif source is not None:
                reason[k] = "the image cannot be read"
        return Followed(
            image[order].astype(np.intp), np.unique(point[order], return_inverse=True)[1].astype(np.intp),
            frozen(pixels[order]), frozen(np.sqrt(variance[order])), before, frozen(motion), windows,
            frozen(sharpness), frozen(contrast), tuple(reason), True,
        )  # fmt: skip


def _sharpness(image: ArrayImage) -> tuple[float, float]:
    """Fine over coarse contrast, and contrast over brightness, as of `Followed`."""
    pixels = image.read((0, image.shape[0]), (0, image.shape[1]))
    fine = pixels[1:, 1:] - 0.5 * (pixels[:-1, 1:] + pixels[1:, :-1])
    lines, columns = (size // 8 for size in image.shape)
    small = pixels[: 8 * lines, : 8 * columns].reshape(lines, 8, columns, 8).mean(axis=(1, 3))
    coarse = small[1:, 1:] - 0.5 * (small[:-1, 1:] + small[1:, :-1])
    contrast = float(fine.std())
    return contrast / max(float(coarse.std()), 1e-9), contrast / max(abs(float(pixels.mean())), 1e-6)


def followed_or_linked(
    sources: Sequence[ImageSource | None],
    plan: FollowPlan,
    position: Array,
    sigma: Array,
    *,
    progress: Callable[[int], None] | None = None,
    keep: Callable[[FollowState], None] | None = None,
    states: Sequence[FollowState] = (),
) -> Followed:
    """Windows followed from frame to frame; where most neighbours overlap too little for it, by features.

    Parameters
    ----------
    sources : sequence of ImageSource or None
        M frames.
    plan : FollowPlan
    position, sigma : (M, 3)
        m, as given, inf where not: they show which frames of a long flight may overlap.
    progress : callable, optional
        Called with the number of frames done.
    keep, states
        As of `follow_windows`.

    Raises
    ------
    EstimationError
        If no two frames are alike, near or far.
    """
    frames = np.array([k for k, source in enumerate(sources) if source is not None], dtype=np.intp)
    followed, failed = None, None
    try:
        followed = follow_windows(sources, plan, progress=progress, keep=keep, states=states)
    except EstimationError as error:
        failed = error
    links = 0 if followed is None else int((followed.before >= 0).sum())
    enough = _FOLLOWED * (len(frames) - 1)
    if followed is not None and (links >= enough or len(frames) > _MANY):
        return followed
    try:
        pairs, wide_plan = wide_pairs(frames, position, sigma), WidePlan(reduction=plan.reduction)
        wide = link_widely(sources, pairs, wide_plan, progress=progress)
    except (EstimationError, InputError) as error:
        if followed is not None:
            return followed
        raise (failed if isinstance(error, EstimationError) and failed is not None else error) from None
    # what features link beyond may be but a frame that is hardly seen
    more = int((wide.before >= 0).sum()) - links
    return wide if followed is None or more > max(1.0, _MORE * len(frames)) else followed
