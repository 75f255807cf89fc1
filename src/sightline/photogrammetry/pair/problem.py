"""A pass of cameras over one scene whose constant attitude errors are asked for, as a STEREO.toml gives it.

Not here: reading it (``io/stereo/load.py``), solving it (``applications/stereo_orientation.py``).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from scipy.spatial.transform import Rotation

from sightline.geometry.checks import Array, ReadOnlyArrays
from sightline.geometry.instrument import AreaDetector
from sightline.photogrammetry.block.point_priors import ControlPoints, HeightPrior, PointPriors
from sightline.photogrammetry.block.pose_noise import PoseNoise
from sightline.photogrammetry.sightings import Images, Sightings, Tracks, sight_frames
from sightline.result import one_line


@dataclass(frozen=True, eq=False, repr=False)
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
    sigma_px : float or None
        px; expected 1-sigma of each coordinate of points that are not found yet; None where nobody says.
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
    sigma_px: float | None = None

    def __repr__(self) -> str:
        """One line."""
        facts = {
            "cameras": f"{len(self.cameras)} ({', '.join(self.cameras[:4])})",
            "images": str(len(self.images)),
            "shots": str(len(self.shot_names)),
            "points": f"{len(self.point_names)} in {len(self.tracks)} sightings",
        }
        return one_line(type(self).__name__, facts)

    def sightings(self) -> Sightings:
        """The points as sighted, free of lens and mount."""
        return sight_frames(self.images, self.detectors, self.mounts, self.tracks)

    @property
    def priors(self) -> PointPriors | None:
        """What is known of the points beforehand."""
        return PointPriors.of(self.heights, self.control)
