"""Frames of a block as cameras: what projects a point into them, and what a pixel sees.

Not here: sightings of points (``sightings.py``).
"""

from __future__ import annotations

from collections.abc import Sequence

from scipy.spatial.transform import Rotation

from sightline.geometry.camera import FrameCamera
from sightline.geometry.instrument import AreaDetector
from sightline.geometry.pointing import FixedMount
from sightline.geometry.trajectory import Trajectory
from sightline.photogrammetry.sightings import Images


def frame_cameras(
    images: Images, detectors: Sequence[AreaDetector], mounts: Sequence[Rotation]
) -> tuple[FrameCamera, ...]:
    """The camera of each image, with the pose that the images have.

    Parameters
    ----------
    images : Images
    detectors, mounts : sequence
        One detector and one body_from_camera per camera.
    """
    out = []
    for row in range(len(images)):
        camera = int(images.camera[row])
        t = images.t[row : row + 1]
        path = Trajectory(t, images.position[row : row + 1], t, images.world_from_body[row : row + 1])
        out.append(FrameCamera(detectors[camera], path, FixedMount(mounts[camera]), float(t[0])))
    return tuple(out)
