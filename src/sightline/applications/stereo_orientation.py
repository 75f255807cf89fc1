"""S2: constant attitude errors of cameras that image one scene together, and what cannot be told of them.

Not here: reading the problem (``io/stereo.py``), finding conjugate points in images
(``stereo_matching.py``), what a plan would give (``stereo_prediction.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.geometry.checks import Array, ReadOnlyArrays
from sightline.geometry.instrument import AreaDetector
from sightline.photogrammetry.bundle import adjust
from sightline.photogrammetry.observability import Observability
from sightline.photogrammetry.point_priors import ControlPoints, HeightPrior, PointPriors
from sightline.photogrammetry.pose_noise import PoseNoise
from sightline.photogrammetry.sightings import Images, Tracks, sight_frames
from sightline.photogrammetry.triangulate import triangulate

#: Names of the estimators, best first.
METHODS = ("ml-track", "ml-pair", "epipolar", "plane")


@dataclass(frozen=True, eq=False)
class StereoProblem(ReadOnlyArrays):
    """What a STEREO.toml says, as objects.

    Attributes
    ----------
    cameras : tuple of str
        Names of the cameras, in the order of all results.
    images : Images
        Planned poses; `shot` counts the shots in order of time.
    shot_names : (K,)
        Number of each shot as the user gave it.
    detectors : tuple of AreaDetector
        One per camera.
    mounts : tuple of Rotation
        body_from_camera, one per camera.
    tracks : Tracks
        Conjugate points.
    point_names : (n,)
        Number of each point as the user gave it.
    noise : PoseNoise
    radii : (float, float) or None
        Of the ellipsoid whose normals are the verticals; None where the world is flat, z up.
    heights : HeightPrior or None
    control : ControlPoints or None
    focal_sigma : tuple of float or None
        Per camera, 1-sigma of the relative error of its focal length; inf: estimate it freely, 0: keep it.
    epoch : str or None
        UTC, ISO 8601: the instant t = 0.
    warnings : tuple of str
        What was noticed while reading.
    """

    cameras: tuple[str, ...]
    images: Images
    shot_names: Array
    detectors: tuple[AreaDetector, ...]
    mounts: tuple[Rotation, ...]
    tracks: Tracks
    point_names: Array
    noise: PoseNoise
    radii: tuple[float, float] | None
    heights: HeightPrior | None = None
    control: ControlPoints | None = None
    focal_sigma: tuple[float, ...] | None = None
    epoch: str | None = None
    warnings: tuple[str, ...] = field(default=())


@dataclass(frozen=True, eq=False)
class StereoOrientation(ReadOnlyArrays):
    """Constant attitude errors of cameras.

    Attributes
    ----------
    method : str
    cameras : tuple of str
    angles : (C, 3)
        rad; NaN where not observable.
    covariance : (3 C, 3 C)
        rad^2; inf and NaN where not observable.
    observability : Observability
    residual_px : (N, 2)
        px.
    rejected : (N,) bool
    points : (n, 3)
        m.
    point_covariance : (n, 3, 3) or None
        m^2.
    warnings : tuple of str
    solve_seconds : float
        s.
    degrees_of_freedom : int
    cost : float
    rates : (C, 3) or None
    focal : (C,) or None
    """

    method: str
    cameras: tuple[str, ...]
    angles: Array
    covariance: Array
    observability: Observability
    residual_px: Array
    rejected: NDArray[np.bool_]
    points: Array
    point_covariance: Array | None
    warnings: tuple[str, ...]
    solve_seconds: float
    degrees_of_freedom: int
    cost: float
    rates: Array | None = None
    focal: Array | None = None


def orient(
    problem: StereoProblem, method: str = "ml-track", *, raw: bool = False, drift: bool = False
) -> StereoOrientation:
    """Orientation of a problem."""
    sightings = sight_frames(problem.images, problem.detectors, problem.mounts, problem.tracks)
    priors = PointPriors(problem.heights, problem.control)
    found = adjust(
        sightings, problem.noise, priors=priors, new_points_per_shot=method != "ml-track", drift=drift
    )
    t = triangulate(sightings, np.nan_to_num(found.angles), used=~found.rejected)
    return StereoOrientation(
        method,
        problem.cameras,
        found.angles,
        found.covariance,
        found.observability,
        found.residual_px,
        found.rejected,
        t.position,
        t.covariance,
        (),
        found.seconds,
        found.degrees_of_freedom,
        found.cost,
    )
