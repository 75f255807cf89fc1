"""A solved sequence as its page shows it: level axes, metres and degrees, one row per frame.

Not here: figures and words (the other ``sequence_*`` files).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.applications.sequence_poses import ESTIMATED, INTERPOLATED, SOLVED, SequencePoses
from sightline.geometry.checks import read_only
from sightline.geometry.earth import local_axes, to_geodetic
from sightline.photogrammetry.flight.path import path_turns, stretches
from sightline.photogrammetry.flight.poses import FramePoses
from sightline.photogrammetry.flight.problem import SequenceProblem
from sightline.photogrammetry.sightings import Images

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

#: Names and units of the six parameters, in the order of the covariance.
PARAMETERS = ("east", "north", "up", "roll", "pitch", "yaw")
UNITS = ("m", "m", "m", "deg", "deg", "deg")
#: How poses came about, in the order of `SequenceView.kind`.
KINDS = (SOLVED, ESTIMATED, INTERPOLATED)
#: Degrees of the even path that departures are counted from: of positions, of angles.
_EVEN = (2, 1)


@dataclass(frozen=True, eq=False)
class SequenceView:
    """One row per frame, M in all.

    Attributes
    ----------
    t : (M,)
        s from the epoch.
    place, given : (M, 3)
        m, east, north, up about `origin`; given is NaN where no table has the frame.
    origin : (float, float) or None
        Longitude and latitude (degrees) of the middle of the path; None where the world is flat, whose x, y
        and z are then east, north and up.
    along : (M,)
        m flown until then, pauses left out.
    covariance : (M, 6, 6)
        m^2, m deg, deg^2 of `PARAMETERS`.
    departure, given_departure : (M, 6)
        Of `PARAMETERS` from an even path of each stretch: found, and given (NaN where it is not).
    given_sigma : (M, 6)
        Of the tables, inf where there are none.
    depth : (M,)
        m from the frame to its ground, along the line of sight of its middle.
    gsd : (M,)
        m on the ground that a pixel spans.
    ground_sigma_px : (M, 2)
        px, 1-sigma of where the middle of the frame meets the ground: worst direction, best direction.
    rms_px, noise_px : (M,)
        px per coordinate: of the residuals of good sightings, and as the matcher states their noise, without
        the drift of windows; NaN without any.
    sightings, rejected : (M,) int
        Good ones, and those left out.
    kind : (M,) int
        Of `KINDS`.
    in_subset : (M,) bool
    stretch : (M,) int
        Of the flight, between pauses.
    step_sigma : (M - 1, 2)
        m and deg, 1-sigma per axis of each frame against the one before it; NaN where it is not known.
    """

    t: Array
    place: Array
    given: Array
    origin: tuple[float, float] | None
    along: Array
    covariance: Array
    departure: Array
    given_departure: Array
    given_sigma: Array
    depth: Array
    gsd: Array
    ground_sigma_px: Array
    rms_px: Array
    noise_px: Array
    sightings: NDArray[np.intp]
    rejected: NDArray[np.intp]
    kind: NDArray[np.intp]
    in_subset: Flags
    stretch: NDArray[np.intp]
    step_sigma: Array

    @property
    def sigma(self) -> Array:
        """(M, 6) m and deg, of `PARAMETERS`."""
        with np.errstate(invalid="ignore"):
            return np.asarray(np.sqrt(np.einsum("kii->ki", self.covariance)))

    def of_stretches(self) -> list[NDArray[np.intp]]:
        """Frames of each stretch."""
        return [np.flatnonzero(self.stretch == number) for number in np.unique(self.stretch)]

    def typical(self, values: Array) -> float:
        """Median of the finite values; inf where there is none."""
        finite = values[np.isfinite(values)]
        return float(np.median(finite)) if len(finite) else float("inf")


def sequence_view(problem: SequenceProblem, found: SequencePoses) -> SequenceView:
    """What a page shows of a solved sequence."""
    poses = found.poses
    problem = replace(problem, detector=poses.detector(problem.detector))
    level, middle, origin = _level(problem, poses.position)
    place = (poses.position - middle) @ level.T
    stretch = stretches(problem.t)
    step = np.linalg.norm(np.diff(place, axis=0), axis=1) * (np.diff(stretch) == 0)
    has_place = _any_known(problem.known.position)
    given = np.where(has_place, (problem.images.position - middle) @ level.T, np.nan)
    known = np.concatenate(
        [_turned_sigma(problem.known.along_world(), level), problem.known.attitude], axis=1
    )
    departure = _departures(problem, found, place, stretch)
    depth = _depths(problem, found)
    gsd = depth / problem.detector.focal_length_px
    rms, noise, rejected = _residuals(found, len(problem))
    return SequenceView(
        t=np.asarray(problem.t),
        place=place,
        given=given,
        origin=origin,
        along=np.concatenate([[0.0], np.cumsum(step)]),
        covariance=_levelled(poses.covariance, level),
        departure=departure,
        given_departure=departure + _given_less_found(problem, found, given - place),
        given_sigma=known * np.repeat([1.0, np.degrees(1.0)], 3),
        depth=depth,
        gsd=gsd,
        ground_sigma_px=_ground_sigma(problem, found, depth, level) / gsd[:, None],
        rms_px=rms,
        noise_px=noise,
        sightings=np.asarray(poses.sightings),
        rejected=rejected,
        kind=np.array([KINDS.index(source) for source in found.source], dtype=np.intp),
        in_subset=np.isin(np.arange(len(problem)), found.subset.frames),
        stretch=stretch,
        step_sigma=_step_sigma(poses, stretch),
    )


def _step_sigma(poses: FramePoses, stretch: NDArray[np.intp]) -> Array:
    """(M - 1, 2): of positions (m) and of angles (deg), rms over the axes; NaN between stretches."""
    both = poses.next_covariance
    with np.errstate(invalid="ignore"):
        step = poses.covariance[1:] + poses.covariance[:-1] - both - np.swapaxes(both, 1, 2)
        variance = np.einsum("kii->ki", step)
        parts = [np.sqrt(variance[:, k : k + 3].mean(axis=1)) for k in (0, 3)]
    sigma = np.column_stack([parts[0], np.degrees(parts[1])])
    sigma[np.diff(stretch) != 0] = np.nan
    return np.asarray(sigma)


def control_places(problem: SequenceProblem, found: SequencePoses) -> Array:
    """Points of control (n, 3) m in the axes of `SequenceView.place`."""
    if problem.control is None:
        return np.zeros((0, 3))
    level, middle, _ = _level(problem, found.poses.position)
    return np.asarray((problem.control.position - middle) @ level.T)


def _level(problem: SequenceProblem, position: Array) -> tuple[Array, Array, tuple[float, float] | None]:
    """local_from_world (3, 3), its origin (3,) m, and where that is, degrees."""
    if problem.radii is None:
        return np.eye(3), np.zeros(3), None
    middle = position.mean(axis=0)
    longitude, latitude, _ = to_geodetic(middle[None], problem.radii)[0]
    axes = local_axes(longitude, latitude).as_matrix().reshape(3, 3).T
    return axes, middle, (float(np.degrees(longitude)), float(np.degrees(latitude)))


def _any_known(sigma: Array) -> Flags:
    """Which rows (M, 1) of a table have any finite sigma."""
    return np.asarray(np.isfinite(sigma).any(axis=1))[:, None]


def _levelled(covariance: Array, level: Array) -> Array:
    """Covariance (M, 6, 6) along level axes and in degrees; what is not known stays so."""
    to_level = np.zeros((6, 6))
    to_level[:3, :3], to_level[3:, 3:] = level, np.degrees(np.eye(3))
    out = to_level @ np.where(np.isfinite(covariance), covariance, 0.0) @ to_level.T
    unknown = ~np.isfinite(np.einsum("kii->ki", covariance)) @ (np.abs(to_level) > 1e-12).T
    out[unknown[:, :, None] | unknown[:, None, :]] = np.nan
    frame, axis = np.nonzero(unknown)
    out[frame, axis, axis] = np.inf
    return np.asarray(out)


def _turned_sigma(sigma: Array, axes: Array) -> Array:
    """Sigmas (M, 3) along other axes; inf where any is."""
    if np.array_equal(axes, np.eye(3)):
        return sigma
    known = np.asarray(np.isfinite(sigma).all(axis=1))[:, None]
    turned = np.sqrt(np.where(known, sigma, 0.0) ** 2 @ (axes**2).T)
    return np.where(known, turned, np.inf)


def _departures(
    problem: SequenceProblem, found: SequencePoses, place: Array, stretch: NDArray[np.intp]
) -> Array:
    """(M, 6) m, deg: of the poses found from an even path of their stretch."""
    poses = found.poses
    images = Images(
        problem.images.camera, problem.images.shot, problem.t, poses.position, poses.world_from_body
    )
    turn = np.degrees(path_turns(images, stretch)[:, :3])
    out = np.concatenate([place, turn], axis=1)
    for number in np.unique(stretch):
        rows = np.flatnonzero(stretch == number)
        x = problem.t[rows] - problem.t[rows].mean()
        x = x / max(float(np.abs(x).max()), 1e-12)
        for part, degree in ((slice(0, 3), _EVEN[0]), (slice(3, 6), _EVEN[1])):
            # two frames to spare: fewer would leave nothing to depart
            table = np.vander(x, max(min(degree, len(rows) - 2), 0) + 1)
            out[rows, part] -= table @ np.linalg.lstsq(table, out[rows, part], rcond=None)[0]
    return out


def _given_less_found(problem: SequenceProblem, found: SequencePoses, moved: Array) -> Array:
    """(M, 6) m, deg; NaN where a table has no such frame."""
    turn = (found.poses.world_from_body.inv() * problem.images.world_from_body).as_rotvec(degrees=True)
    given = _any_known(problem.known.attitude)
    return np.concatenate([moved, np.where(given, turn, np.nan)], axis=1)


def _axes_of_sight(problem: SequenceProblem, found: SequencePoses) -> tuple[Array, Array]:
    """Directions (3,) in body axes and (M, 3) in the world of the middle of the frames."""
    middle = 0.5 * (np.array([problem.detector.shape]) - 1.0)
    body = problem.mount.apply(problem.detector.directions(read_only(middle)))[0]
    return body, np.asarray(found.poses.world_from_body.apply(body))


def _depths(problem: SequenceProblem, found: SequencePoses) -> Array:
    """m (M,) to the ground of each frame: mean over its points; as of frames near by where it has none."""
    poses, tracks = found.poses, found.tracks
    _, axis = _axes_of_sight(problem, found)
    to = poses.points[tracks.point] - poses.position[tracks.image]
    depth = np.einsum("ni,ni->n", to, axis[tracks.image])
    good = np.isfinite(depth) & ~poses.rejected
    count = np.bincount(tracks.image[good], minlength=len(problem))
    total = np.bincount(tracks.image[good], depth[good], minlength=len(problem))
    seen = np.flatnonzero(count)
    if not len(seen):
        return np.full(len(problem), np.nan)
    return np.interp(problem.t, problem.t[seen], total[seen] / count[seen])


def _ground_sigma(problem: SequenceProblem, found: SequencePoses, depth: Array, level: Array) -> Array:
    """m (M, 2), worst and best direction: where the middle of a frame meets level ground at its distance."""
    body, axis = _axes_of_sight(problem, found)
    turned = found.poses.world_from_body.as_matrix()
    # a turn w about body axes moves the far end of the line of sight by depth * R (w x b)
    lever = depth[:, None, None] * turned @ np.cross(np.eye(3), body).T
    moved = np.concatenate([np.broadcast_to(np.eye(3), lever.shape), lever], axis=2)
    up = level[2]
    # what moves up or down slides along the line of sight back to its height
    slid = np.eye(3) - axis[:, :, None] * up / (axis @ up)[:, None, None]
    with np.errstate(invalid="ignore"):
        by_pose = level[:2] @ slid @ moved
        covariance = by_pose @ found.poses.covariance @ by_pose.transpose(0, 2, 1)
    known = np.isfinite(covariance).all(axis=(1, 2))
    out = np.full((len(depth), 2), np.inf)
    out[known] = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance[known])[:, ::-1], 0.0))
    return out


def _residuals(found: SequencePoses, count: int) -> tuple[Array, Array, NDArray[np.intp]]:
    """Per frame: rms (M,) px per coordinate, what sigmas say of it, number rejected."""
    tracks, rejected = found.tracks, np.asarray(found.poses.rejected)
    image = tracks.image[~rejected]
    number = np.bincount(image, minlength=count)
    sigma = np.array(tracks.sigma_px)
    own = found.followed
    first = slice(0, len(own.sigma_px))
    # windows followed come first where all of them count; the noise of the solution has their drift in it
    if np.array_equal(tracks.image[first], own.image) and np.array_equal(tracks.point[first], own.point):
        sigma[first] = own.sigma_px
    sums = [
        np.bincount(image, square[~rejected], minlength=count)
        for square in (0.5 * (found.poses.residual_px**2).sum(axis=1), sigma**2)
    ]
    rms, noise = (np.sqrt(np.where(number, total, np.nan) / np.maximum(number, 1)) for total in sums)
    out = np.bincount(tracks.image[rejected], minlength=count)
    return np.asarray(rms), np.asarray(noise), out.astype(np.intp)
