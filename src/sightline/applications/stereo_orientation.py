"""S2: constant attitude errors of cameras that image one scene together, and which are not observable.

Not here: reading the problem (``io/stereo/load.py``), finding conjugate points in images
(``photogrammetry/pair/match_problem.py``), what a plan would give (``stereo_prediction.py``).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sightline.errors import EstimationError, InputError, computes
from sightline.execution import one_blas_thread
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.checks import Array, ReadOnlyArrays, frozen
from sightline.photogrammetry.block.bundle import Adjustment, adjust, bound, load_kernels
from sightline.photogrammetry.block.control_weights import AdjustedPlaces, weighed_control
from sightline.photogrammetry.block.observability import Observability, observability
from sightline.photogrammetry.block.point_priors import ControlPoints, PointPriors, level_axes
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.pair.epipolar import epipolar_outliers, noise_ratios, orient_by_epipolar
from sightline.photogrammetry.pair.pairs import PairOrientation, SightingPairs, pair_sightings
from sightline.photogrammetry.pair.plane import common_aim, orient_by_plane
from sightline.photogrammetry.pair.problem import StereoProblem
from sightline.photogrammetry.sightings import Sightings, Tracks, sight_pushbroom
from sightline.photogrammetry.triangulate import triangulate
from sightline.result import Result, makes_result

#: Names of the estimators, best first.
METHODS = ("ml-track", "ml-pair", "epipolar", "plane")
#: Size of residuals over the stated one beyond which an adjustment is no answer: stated noise may be a few
#: times too small, and its sigmas are then by as much; tables of other images miss by hundreds.
WORST_FIT = 10.0


@dataclass(frozen=True, eq=False, repr=False)
class StereoOrientation(Result, ReadOnlyArrays):
    """Result of S2: the constant attitude error of each camera over the series.

    Attributes
    ----------
    method : str
        One of `METHODS`.
    cameras : tuple of str
        Names, in the order of all that follows.
    angles : (C, 3)
        rad; roll, pitch, yaw as of `Motion.angles`: actual attitude = planned * from_rotvec(angles). NaN
        where they are not observable.
    covariance : (3 C, 3 C)
        rad^2, in that order; inf on the diagonal and NaN beside it where they are not observable.
    observability : Observability
        Principal directions of the angles, weakest first.
    residual_px : (N,)
        px; size of the residual of each sighting. Of ml methods that of its reprojection; of epipolar and
        plane half (in squares) of its pair's.
    rejected : (N,) bool
        Sightings that were left out as gross errors, or because nothing could be learnt from them.
    unchecked : float
        Share of the used sightings that others could contradict in one direction only: a mismatch along the
        epipolar line of such a pair is not found.
    points : (n, 3)
        m, world axes; NaN where not found.
    point_covariance : (n, 3, 3)
        m^2, all errors in it.
    drift : (C, 3) or None
        rad/s, of the angles, which hold in the middle of the times.
    drift_sigma : (C, 3) or None
    stretch, stretch_sigma : (C,) or None
        Relative error of each focal length; NaN and inf where it is not observable.
    attitude : (M, 3) or None
        rad, body axes: departure of each image beyond the constant angles.
    position : (M, 3) or None
        m, world axes: departure of each position.
    bias : (C, 3) or None
        rad; of the epipolar estimate: what noise times noise adds to it, taken out unless raw.
    cost : float or None
        Chi-square of an adjustment, and its degrees of freedom.
    degrees_of_freedom : int or None
    scale : float or None
        Robust size of residuals over the stated one.
    iterations : int
    solve_seconds : float
        s, to the angles and their covariance; compiled code was loaded before.
    warnings : tuple of str
    """

    method: str
    cameras: tuple[str, ...]
    angles: Array
    covariance: Array
    observability: Observability
    residual_px: Array
    rejected: NDArray[np.bool_]
    unchecked: float
    points: Array
    point_covariance: Array
    solve_seconds: float
    iterations: int = 1
    drift: Array | None = None
    drift_sigma: Array | None = None
    stretch: Array | None = None
    stretch_sigma: Array | None = None
    attitude: Array | None = None
    position: Array | None = None
    bias: Array | None = None
    cost: float | None = None
    degrees_of_freedom: int | None = None
    scale: float | None = None
    warnings: tuple[str, ...] = ()

    @property
    def sigma(self) -> Array:
        """(C, 3) rad, 1-sigma of the angles; inf where they are not observable."""
        return np.sqrt(np.diag(self.covariance)).reshape(-1, 3)


@makes_result
@one_blas_thread
@computes("the orientation")
def orient(
    problem: StereoProblem,
    method: str = "ml-track",
    *,
    raw: bool = False,
    drift: bool = False,
    robust: bool = True,
) -> StereoOrientation:
    """Constant attitude errors of all cameras of a block.

    Parameters
    ----------
    problem : StereoProblem
    method : str
        "ml-track": maximum likelihood with each point one point in all shots. "ml-pair": a point is new in
        every shot. "epipolar": S2's equation 13, "plane": S2's equation 8, corrected; both for two cameras.
    raw : bool
        epipolar: leave the bias in that noise times noise gives it.
    drift : bool
        ml: angles drift evenly with time.
    robust : bool
        Find gross mismatches and leave them out; weigh down control points that do not go with the others.

    Returns
    -------
    StereoOrientation

    Raises
    ------
    InputError
        An unknown method, or one that does not fit the problem; too few points.
    EstimationError
        If the data cannot give any angle.
    """
    if method not in METHODS:
        raise InputError(f"unknown method: got {method!r}; allowed are {', '.join(METHODS)}")
    sightings = problem.sightings()
    if method in ("epipolar", "plane"):
        _check_linear(problem, method, drift)
        return _orient_linear(problem, sightings, method, raw=raw, robust=robust)
    load_kernels()
    if raw:
        raise InputError(f"`raw` is for the method epipolar only, got {method!r}; leave it out")
    pairs_only = method == "ml-pair"
    if pairs_only and not _simultaneous(sightings):
        raise InputError(
            "ml-pair needs shots in which two cameras or more see the same points; no shot has them: use "
            "ml-track"
        )
    words: tuple[str, ...] = ()
    adjustment = _adjusted(problem, sightings, pairs_only=pairs_only, drift=drift, robust=robust)
    if problem.control is not None and robust:

        def adjusted(control: ControlPoints) -> Adjustment:
            given = replace(problem, control=control)
            return _adjusted(given, sightings, pairs_only=False, drift=False, robust=True)

        control, words = _weighed(
            sightings, problem.control, problem.point_names, problem.noise, adjustment, adjusted,
            tracked=not pairs_only,
        )  # fmt: skip
        if words:
            problem = replace(problem, control=control)
            adjustment = _adjusted(problem, sightings, pairs_only=pairs_only, drift=drift, robust=robust)
    found = _result(
        method, problem.cameras, sightings, adjustment, problem.noise, problem.priors, problem.focal_sigma
    )
    return replace(found, warnings=(*words, *found.warnings))


def _adjusted(
    problem: StereoProblem, sightings: Sightings, *, pairs_only: bool, drift: bool, robust: bool
) -> Adjustment:
    """The adjustment of a problem of frames.

    Where planned poses are off by degrees, points start so far from the surface that they are to lie on that
    no step leads on; what the rays alone say of the angles is then the place to start from.
    """

    suspect = _suspects(sightings, problem.noise) if pairs_only and robust else None

    def solve(priors: PointPriors | None, start: Array | None = None) -> Adjustment:
        return adjust(
            sightings,
            problem.noise,
            priors=priors,
            new_points_per_shot=pairs_only,
            drift=drift,
            focal_sigma=problem.focal_sigma,
            robust=robust,
            start=start,
            suspect=suspect,
        )

    try:
        return solve(problem.priors)
    except EstimationError:
        if problem.priors is None:
            raise
        alone = solve(None).angles
        return solve(problem.priors, np.where(np.isfinite(alone), alone, 0.0))


@makes_result
@one_blas_thread
def orient_pushbroom(
    cameras: Sequence[PushbroomCamera],
    tracks: Tracks,
    noise: PoseNoise,
    *,
    names: Sequence[str] | None = None,
    priors: PointPriors | None = None,
    robust: bool = True,
    point_names: Array | None = None,
) -> StereoOrientation:
    """Constant attitude errors of pushbroom cameras whose images show the same ground.

    Parameters
    ----------
    cameras : sequence of PushbroomCamera
        With fixed mounts; their trajectories are as planned.
    tracks : Tracks
        Conjugate points; `image` counts the cameras.
    noise : PoseNoise
        A constant error of the position, and of the attitude, of each image beyond the angles sought.
    names : sequence of str, optional
        Of the cameras; "1", "2", ... otherwise.
    priors : PointPriors, optional
        Known heights or control points; without these two images alone leave their common turns weak.
    robust : bool
        Find gross mismatches and leave them out; weigh down control points that do not go with the others.
    point_names : (n,), optional
        Numbers by which points are named; 1, 2, ... otherwise.

    Returns
    -------
    StereoOrientation
    """
    sightings = sight_pushbroom(cameras, tracks)
    labels = tuple(names) if names is not None else tuple(str(k + 1) for k in range(len(cameras)))
    adjustment, words = adjust(sightings, noise, priors=priors, robust=robust), tuple[str, ...]()
    if priors is not None and priors.control is not None and robust:
        heights = priors.heights

        def adjusted(control: ControlPoints) -> Adjustment:
            return adjust(sightings, noise, priors=PointPriors(heights, control))

        numbers = np.arange(1.0, sightings.points + 1.0) if point_names is None else point_names
        control, words = _weighed(sightings, priors.control, numbers, noise, adjustment, adjusted)
        if words:
            priors, adjustment = PointPriors(heights, control), adjusted(control)
    found = _result("ml-track", labels, sightings, adjustment, noise, priors, None)
    return replace(found, warnings=(*words, *found.warnings))


def _simultaneous(sightings: Sightings) -> bool:
    """Whether some shot shows a point twice."""
    shot = sightings.shot[sightings.image].astype(np.int64)
    return len(np.unique(shot * max(sightings.points, 1) + sightings.point)) < len(sightings)


def _check_fit(found: Adjustment) -> None:
    """EstimationError where residuals have nothing to do with the sigmas: then the angles mean nothing."""
    if found.degrees_of_freedom <= 0:
        return
    ratio = float(np.sqrt(found.cost / found.degrees_of_freedom))
    if ratio > WORST_FIT:
        raise EstimationError(
            f"residuals are {ratio:.3g} times as large as the sigmas say, {WORST_FIT:g} times is the most "
            "that an orientation is given with: check that points and poses are of one set of images, that "
            "line and column are not exchanged or the same twice, and sigma_px, sigma_position and "
            "sigma_attitude of [noise]"
        )


def _result(
    method: str,
    cameras: tuple[str, ...],
    sightings: Sightings,
    found: Adjustment,
    noise: PoseNoise,
    priors: PointPriors | None,
    focal_sigma: tuple[float, ...] | None,
) -> StereoOrientation:
    """An adjustment as the result of S2."""
    _check_fit(found)
    points, covariance = _points(sightings, found, noise, tracked=method == "ml-track")
    sigma = np.sqrt(np.diag(found.global_covariance))
    names = found.unknowns.names
    drifts = [k for k, name in enumerate(names) if "_drift_" in name]
    stretch, stretch_sigma = _stretches(found, len(cameras))
    total = np.hypot(*found.residual_px.T)
    common = np.nan_to_num(found.angles)[sightings.camera]
    used = ~found.rejected
    return StereoOrientation(
        method,
        cameras,
        found.angles,
        found.covariance,
        found.observability,
        frozen(total),
        found.rejected,
        float(np.mean(~found.checked[used])) if used.any() else 0.0,
        points,
        covariance,
        found.seconds,
        found.iterations,
        frozen(found.common[drifts].reshape(-1, 3) / found.time[1]) if drifts else None,
        frozen(sigma[drifts].reshape(-1, 3) / found.time[1]) if drifts else None,
        stretch,
        stretch_sigma,
        frozen(found.departures[:, :3] - common),
        frozen(found.departures[:, 3:6]),
        None,
        found.cost,
        found.degrees_of_freedom,
        found.scale,
        _adjustment_warnings(method, found, priors, stretch_sigma, focal_sigma),
    )


def _points(
    sightings: Sightings, found: Adjustment, noise: PoseNoise, *, tracked: bool
) -> tuple[Array, Array]:
    """Points (n, 3) and covariances (n, 3, 3): the adjusted ones, or where the rays of adjusted poses meet.

    Where the adjustment keeps no covariance of points, that of rays from poses as noisy as declared is given,
    which is somewhat larger.
    """
    if tracked and found.point_covariance is not None:
        return found.points, frozen(found.point_covariance)
    position, covariance = triangulated(
        sightings, found.angles, found.covariance, found.rejected, noise, found.departures
    )
    return (found.points if tracked and np.isfinite(found.angles).all() else position), covariance


def _places(sightings: Sightings, found: Adjustment, noise: PoseNoise, *, tracked: bool) -> AdjustedPlaces:
    """As of `_points`."""
    held = tracked and found.point_covariance is not None
    return AdjustedPlaces(*_points(sightings, found, noise, tracked=tracked), held)


def _weighed(
    sightings: Sightings,
    control: ControlPoints,
    names: Array,
    noise: PoseNoise,
    first: Adjustment,
    adjusted: Callable[[ControlPoints], Adjustment],
    *,
    tracked: bool = True,
) -> tuple[ControlPoints, tuple[str, ...]]:
    """As of `weighed_control`, from a first adjustment and along whole tracks with other control points."""

    def places(given: ControlPoints) -> AdjustedPlaces:
        return _places(sightings, adjusted(given), noise, tracked=True)

    return weighed_control(
        sightings, control, names, _places(sightings, first, noise, tracked=tracked), places
    )


def triangulated(
    sightings: Sightings,
    angles: Array,
    covariance: Array,
    rejected: NDArray[np.bool_],
    noise: PoseNoise,
    departures: Array | None = None,
) -> tuple[Array, Array]:
    """Points (n, 3) and covariances (n, 3, 3) by the rays of all shots; NaN where angles are.

    `departures` (M, 6): of each image from its plan (turn, move), the angles in them.
    """
    if not np.isfinite(angles).all():
        count = sightings.points
        return frozen(np.full((count, 3), np.nan)), frozen(np.full((count, 3, 3), np.nan))
    met = triangulate(
        sightings,
        angles if departures is None else None,
        attitude=None if departures is None else departures[:, :3],
        position=None if departures is None else departures[:, 3:6],
        used=~rejected,
        noise=noise,
        angle_covariance=covariance,
    )
    return met.position, met.covariance


def _stretches(found: Adjustment, cameras: int) -> tuple[Array | None, Array | None]:
    """Relative errors (C,) of focal lengths and their sigmas; 0 where they were not sought."""
    names = found.unknowns.names
    places = {
        int(name.rpartition("_")[2]) - 1: k for k, name in enumerate(names) if name.startswith("stretch")
    }
    if not places:
        return None, None
    value, sigma = np.zeros(cameras), np.zeros(cameras)
    for camera, k in places.items():
        value[camera], sigma[camera] = found.common[k], np.sqrt(found.global_covariance[k, k])
    return frozen(value), frozen(sigma)


#: Relative sigma from which on a focal length that is sought freely counts as not observable; share of the
#: sigma known beforehand from which on the data added nothing.
_LOOSE_FOCAL, _UNOBSERVABLE_SHARE = 0.02, 0.5
#: Departure of chi-square per degree of freedom from 1 that is spoken of, in its own sigmas, and at least.
CHI_SIGMAS, CHI_SHARE = 3.0, 0.1
#: The same of the size of the poses' own errors.
_POSE_SIGMAS, _POSE_SHARE = 4.0, 0.15


def focal_length_seen(sigma: float, before: float) -> bool:
    """Whether the data give a focal length, by its relative sigma now and before (inf: sought freely)."""
    return bool(sigma <= (_UNOBSERVABLE_SHARE * before if np.isfinite(before) else _LOOSE_FOCAL))


def _adjustment_warnings(
    method: str,
    found: Adjustment,
    priors: PointPriors | None,
    stretch_sigma: Array | None,
    focal_sigma: tuple[float, ...] | None,
) -> tuple[str, ...]:
    """What a user should know before trusting the numbers."""
    said = []
    freedom = max(found.degrees_of_freedom, 1)
    ratio, spread = found.cost / freedom, np.sqrt(2.0 / freedom)
    if abs(ratio - 1.0) > max(CHI_SIGMAS * spread, CHI_SHARE):
        said.append(
            f"residuals are {np.sqrt(ratio):.3g} times what sigma_px and [noise] say (chi-square "
            f"{found.cost:.4g} for {freedom} degrees of freedom): the sigmas of the angles are as wrong as "
            "these; correct them"
        )
    excess, sigma = found.pose_scale - 1.0, 1.0 / np.sqrt(2.0 * max(found.pose_freedom, 1.0))
    if excess > max(_POSE_SIGMAS * sigma, _POSE_SHARE):
        said.append(
            f"poses are off by {found.pose_scale:.3g} times what sigma_position and sigma_attitude say: the "
            "sigmas of the angles are too small, by up to as much; enlarge these, or let the angles drift "
            "(--drift)"
        )
    if method == "ml-pair" and priors is not None:
        said.append(
            "ml-pair takes a point of every shot as new, and with it the error of its known height or place: "
            "where points are tracked through the shots its sigmas are too small; use ml-track"
        )
    if stretch_sigma is not None:
        for camera, sigma in enumerate(stretch_sigma):
            prior = (focal_sigma or ())[camera]
            if prior > 0.0 and not focal_length_seen(sigma, prior):
                said.append(
                    f"the focal length of camera {camera + 1} is not observable: its sigma is "
                    f"{100 * sigma:.2g} % after the adjustment; keep it fixed, or give control points spread "
                    "over the frame"
                )
    return tuple(said)


def _check_linear(problem: StereoProblem, method: str, drift: bool) -> None:
    """Refuse what S2's linear estimators do not know."""
    if len(problem.cameras) != 2:
        raise InputError(
            f"{method} is for two cameras, {len(problem.cameras)} are given; use ml-track or ml-pair"
        )
    others = {
        "a drift": drift,
        "the focal length": any(sigma > 0.0 for sigma in problem.focal_sigma or ()),
    }
    for what, asked in others.items():
        if asked:
            raise InputError(f"{method} cannot estimate {what}; use ml-track or ml-pair")


def _suspects(sightings: Sightings, noise: PoseNoise) -> NDArray[np.bool_] | None:
    """Sightings (N,) of pairs that miss each other by the epipolar estimate; None where it cannot say.

    An adjustment of pairs has one condition for each: it needs a start without gross errors more than one of
    tracks does.
    """
    if sightings.cameras != 2 or len(sightings.position) != len(sightings.camera):
        return None
    pairs = pair_sightings(sightings)
    if len(pairs) < _SUSPECTED:
        return None
    out = np.zeros(len(sightings), dtype=bool)
    out[pairs.rows[:, epipolar_outliers(pairs, noise)].ravel()] = True
    return out if out.any() else None


#: Fewest pairs that are searched for gross errors before an adjustment.
_SUSPECTED = 100
#: rad; larger angles are beyond what S2's linear estimators hold for.
_LARGE = 0.03
#: Ratio of measured to declared variances of noise from which on the measured ones serve, and fewest shots.
_MISDECLARED, _SHOTS = 4.0, 8
#: Pairs per shot below which the covariance of S2's linear estimators is known to be small.
_SCARCE = 10


def _orient_linear(
    problem: StereoProblem, sightings: Sightings, method: str, *, raw: bool, robust: bool
) -> StereoOrientation:
    """S2's own estimators on the pairs of a problem."""
    begun = time.perf_counter()
    pairs = pair_sightings(sightings)
    gross = np.zeros(len(pairs), dtype=bool)
    if robust:
        gross = epipolar_outliers(pairs, problem.noise)
    kept = pairs.kept(~gross) if gross.any() else pairs
    said: list[str] = []
    if method == "epipolar":
        found = orient_by_epipolar(kept, problem.noise, raw=raw)
        if not raw:
            found, said = _by_measured_noise(found, kept, problem.noise)
    else:
        aim = problem.noise.aim_point if problem.noise.aim_point is not None else common_aim(sightings)
        up = level_axes(aim[None], problem.radii)[0][0]
        found = orient_by_plane(kept, problem.noise, aim_point=aim, vertical=up)
    seconds = time.perf_counter() - begun
    residual, rejected = np.full(len(sightings), np.nan), np.ones(len(sightings), dtype=bool)
    for rows in kept.rows:
        residual[rows], rejected[rows] = np.abs(found.residual_px) / np.sqrt(2.0), False
    known = observability(
        _observable_information(found.information, sightings, problem.noise), _angle_names()
    )
    angles, of_angles = _observable_angles(found.angles, found.covariance, known)
    if known.hidden.any() and float(np.nanmax(np.abs(angles), initial=0.0)) > _LARGE:
        # noise in the coefficients, nothing else, is left of what the hidden direction spoilt
        angles, of_angles = np.full((2, 3), np.nan), np.full((6, 6), np.nan)
        np.fill_diagonal(of_angles, np.inf)
    said += _linear_warnings(method, problem, kept, found, angles, raw=raw)
    points, covariance = triangulated(sightings, angles, of_angles, rejected, problem.noise)
    return StereoOrientation(
        method,
        problem.cameras,
        frozen(angles),
        frozen(of_angles),
        known,
        frozen(residual),
        rejected,
        1.0,
        points,
        covariance,
        seconds,
        bias=frozen(found.bias) if method == "epipolar" else None,
        warnings=tuple(said),
    )


def _by_measured_noise(
    found: PairOrientation, pairs: SightingPairs, noise: PoseNoise
) -> tuple[PairOrientation, list[str]]:
    """The epipolar estimate with the bias of the noise that there is, where that is far from the declared."""
    angles = np.nan_to_num(found.angles)
    image, pose = noise_ratios(pairs, noise, angles)
    ratios = np.array([image, pose if len(pairs.starts) > _SHOTS else 1.0])
    wrong = (ratios > _MISDECLARED) | (ratios < 1.0 / _MISDECLARED)
    if not wrong.any() or not np.isfinite(found.angles).all():
        return found, []
    by_image, by_pose = np.where(wrong, np.sqrt(np.maximum(ratios, 1e-12)), 1.0)
    measured = PoseNoise(noise.position * by_pose, noise.attitude * by_pose, noise.aim_point)
    sightings = replace(pairs.sightings, sigma_px=frozen(pairs.sightings.sigma_px * by_image))
    return orient_by_epipolar(replace(pairs, sightings=sightings), measured), [
        f"points scatter {np.sqrt(image):.2g} times and poses {np.sqrt(pose):.2g} times what [noise] says: "
        "the measured scatter is used for the bias and the sigmas"
    ]


def _observable_information(information: Array, sightings: Sightings, noise: PoseNoise) -> Array:
    """Information of a linear estimate without directions that no pair of rays makes observable.

    Noise in its coefficients looks like information along them.
    """
    points = np.array(triangulate(sightings).position)
    known = np.isfinite(points).all(axis=1)
    if not known.any():
        return information
    points[~known] = points[known].mean(axis=0)
    pairs, _ = bound(sightings, noise, points, new_points_per_shot=True)
    left = np.eye(len(information))
    for direction in pairs.directions[pairs.hidden]:
        left -= np.outer(direction, direction)
    return np.asarray(left @ information @ left)


def _linear_warnings(
    method: str,
    problem: StereoProblem,
    pairs: SightingPairs,
    found: PairOrientation,
    angles: Array,
    *,
    raw: bool,
) -> list[str]:
    """What a user of S2's own estimators should know; refuses angles beyond what is linear."""
    largest = float(np.nanmax(np.abs(angles), initial=0.0))
    if largest > _LARGE:
        raise EstimationError(
            f"{method} finds an angle of {np.degrees(largest):.3g} degrees, beyond the "
            f"{np.degrees(_LARGE):.2g} that a linear estimate holds for: points and planned poses do not "
            "belong together (check which camera is the first of the matches, (line, column) order, mount); "
            "or use ml-track"
        )
    said = []
    if problem.priors is not None:
        said.append(f"{method} makes no use of known heights or control points")
    if raw:
        worst = np.degrees(np.abs(found.bias).max()) * 3600.0
        said.append(
            f"the bias of noise times noise, {worst:.2g} arcsec, is in the angles and not in their sigmas"
        )
    scarce = len(pairs) / max(len(pairs.starts) - 1, 1)
    if scarce < _SCARCE:
        said.append(
            f"{scarce:.2g} pairs per shot: the sigmas of {method} are too small with so few; use ml-track"
        )
    return said


def _observable_angles(angles: Array, covariance: Array, known: Observability) -> tuple[Array, Array]:
    """Angles (C, 3) and covariance with NaN and inf for those that take part in a hidden direction."""
    hidden = known.touched
    spread = np.where(hidden[:, None] | hidden[None, :], np.nan, covariance)
    spread[hidden, hidden] = np.inf
    return np.where(hidden.reshape(angles.shape), np.nan, angles), spread


def _angle_names() -> tuple[str, ...]:
    return tuple(f"{axis}_{camera}" for camera in (1, 2) for axis in ("roll", "pitch", "yaw"))
