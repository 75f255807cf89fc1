"""Whether planned poses and conjugate points can belong together: said before anything is solved.

Rays of the planned poses miss each other by little more than the errors that are sought. Where they miss by
degrees, axes, quaternions, columns or cameras are exchanged.

Not here: what can be observed (``photogrammetry/block/observability.py``).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import EstimationError, FormatError, GeometryError
from sightline.photogrammetry.block.point_priors import ControlPoints
from sightline.photogrammetry.sightings import Images, Tracks
from sightline.photogrammetry.triangulate import Meeting, group_sums, meet_rays

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: rad by which conjugate rays miss each other that no attitude error explains.
FAR = np.radians(5.0)
#: rad beyond which linearised estimators lose digits: worth a warning.
LARGE = np.radians(0.1)
#: Sigmas of position, and m, within which two cameras are at the same place.
SAME_PLACE, SAME_PLACE_M = 3.0, 1e-3
#: px, and sigmas of points, within which points lie on one line.
ON_A_LINE, ON_A_LINE_PX = 5.0, 1.0


def check_baseline(path: Path, names: Sequence[str], images: Images, sigma: float) -> None:
    """Refuse cameras that are at the same place in every shot."""
    least = max(SAME_PLACE * sigma, SAME_PLACE_M)
    if len(names) == 1:
        largest = float(np.linalg.norm(np.ptp(images.position, axis=0)))
        who = f"camera {names[0]} moves by"
    else:
        largest, who = _largest_baseline(names, images)
    if largest <= least:
        raise FormatError(
            f"{path}: no baseline: {who} {largest:.4g} m at most, within the noise of positions "
            f"({sigma:g} m, 1-sigma); attitude errors of cameras at one place cannot be distinguished: check "
            'x, y, z (m; degrees with [world] frame = "lonlat" alone), '
            "and that rows of one camera are not given twice"
        )


def _largest_baseline(names: Sequence[str], images: Images) -> tuple[float, str]:
    """Largest distance (m) of two images of one shot, else of two images of different cameras; in words."""
    largest, who = -1.0, ""
    for a in range(len(names)):
        for b in range(a + 1, len(names)):
            in_a, in_b = np.flatnonzero(images.camera == a), np.flatnonzero(images.camera == b)
            _, of_a, of_b = np.intersect1d(images.shot[in_a], images.shot[in_b], return_indices=True)
            if not len(of_a):
                continue
            apart = np.linalg.norm(images.position[in_a[of_a]] - images.position[in_b[of_b]], axis=1).max()
            if apart > largest:
                largest, who = float(apart), f"cameras {names[a]} and {names[b]} are apart by"
    if largest < 0.0:
        largest, who = float(np.linalg.norm(np.ptp(images.position, axis=0))), "images are apart by"
    return largest, who


def check_directions(path: Path, names: Sequence[str], camera: Index, meeting: Meeting) -> tuple[str, ...]:
    """Refuse cameras that do not look at the same ground; gives warnings about large errors.

    Raises
    ------
    GeometryError
        Names the camera.
    """
    miss = meeting.miss
    if not np.isfinite(miss).any():
        raise GeometryError(
            f"{path}: rays of conjugate points are parallel in all images: there is no parallax, and no "
            "point "
            "can be placed; check that both cameras look at the same ground from different places"
        )
    middles = [
        float(np.nanmedian(miss[camera == k])) if (camera == k).any() else 0.0 for k in range(len(names))
    ]
    worst = int(np.argmax(middles))
    if middles[worst] > FAR:
        raise GeometryError(
            f"{path}: camera {names[worst]} looks away from where the others look: rays of conjugate "
            "points miss "
            f"each other by {np.degrees(middles[worst]):.3g} degrees; check its attitudes (quaternions "
            "qx,qy,qz,qw "
            "of world_from_body, scalar last), its mount, and that line and column, or cameras 1 and 2, "
            "are not "
            "exchanged"
        )
    if middles[worst] > LARGE:
        return (
            f"rays of conjugate points miss each other by {np.degrees(middles[worst]):.2g} degrees with the "
            f"planned attitudes (camera {names[worst]}): errors so large are at the end of what is linear; "
            "are attitudes and mount right?",
        )
    return ()


def check_enough(
    path: Path, cameras: int, tracks: Tracks, points: int, *, control: int = 0, heights: bool = False
) -> None:
    """Refuse fewer points than there are angles to estimate.

    Raises
    ------
    EstimationError
        Each point gives two numbers per sighting less the three of its place; with a height prior one more,
        with known coordinates three more.
    """
    equations = 2 * len(tracks) - 3 * points + 3 * control + (points if heights else 0)
    if equations < 3 * cameras:
        raise EstimationError(
            f"{path}: too few points: {points} points in {len(tracks)} sightings give {max(equations, 0)} "
            "equations "
            f"for the {3 * cameras} angles of {cameras} camera{'s' if cameras > 1 else ''}; give more "
            "points: 6 "
            "pairs of conjugate points at least, over the whole frame, and shots that span time"
        )


def check_spread(path: Path, camera: Index, tracks: Tracks) -> None:
    """Refuse points that lie on one line in all images.

    Raises
    ------
    EstimationError
        Names the spread across the line.
    """
    counts = np.bincount(tracks.image)
    # two points always lie on a line: where images have no more, those of all shots are taken together
    group = tracks.image if (counts >= 3).any() else camera
    groups = int(group.max()) + 1
    seen = np.bincount(group, minlength=groups)
    kept = seen >= 3
    if not kept.any():
        return
    mean = group_sums(tracks.pixels, group, groups) / np.maximum(seen, 1)[:, None]
    off = tracks.pixels - mean[group]
    scatter = group_sums(np.einsum("ni,nj->nij", off, off).reshape(-1, 4), group, groups).reshape(-1, 2, 2)
    across = np.sqrt(np.maximum(np.linalg.eigvalsh(scatter[kept])[:, 0] / seen[kept], 0.0))
    least = ON_A_LINE * float(np.median(tracks.sigma_px)) + ON_A_LINE_PX
    if across.max() < least:
        raise EstimationError(
            f"{path}: all points lie on one line in the images, to {across.max():.2g} px: turning about it "
            "cannot "
            "be distinguished from a turn of the camera; give points over the whole frame, in both directions"
        )


def check_in_front(
    where: str, control: ControlPoints, names: Array, tracks: Tracks, origins: Array, looks: Array
) -> None:
    """Refuse control points that lie behind a camera that is said to see them.

    Parameters
    ----------
    where : str
        The table of control points, named in the message.
    control : ControlPoints
    names : (n,)
        Number of each point as the user gave it.
    tracks : Tracks
    origins, looks : (N, 3)
        m and unit vectors, world axes: ray of each sighting by the planned poses.
    """
    row = np.full(len(names), -1, dtype=np.intp)
    row[control.point] = np.arange(len(control.point))
    seen = np.flatnonzero(row[tracks.point] >= 0)
    ahead = ((control.position[row[tracks.point[seen]]] - origins[seen]) * looks[seen]).sum(axis=1)
    behind = np.flatnonzero(~(ahead > 0.0))
    if len(behind):
        n = int(seen[behind[0]])
        place = ", ".join(f"{v:.7g}" for v in control.position[row[tracks.point[n]]])
        raise FormatError(
            f"{where}: control point {names[tracks.point[n]]:g} at ({place}) m lies "
            f"{-ahead[behind[0]]:.4g} m behind a camera that sees it, by the planned poses; check "
            "x, y, z, what z is above, and [world] frame"
        )


def boresights(images: Images, mounts: Sequence[Rotation]) -> Array:
    """Directions (M, 3), world axes, of the optical axes by the planned poses."""
    z = np.stack([mount.as_matrix()[:, 2] for mount in mounts])
    return np.asarray(images.world_from_body.apply(z[images.camera]))


def aim_of(path: Path, images: Images, mounts: Sequence[Rotation]) -> Array:
    """Point (3,) nearest to all planned boresights; GeometryError where they do not converge."""
    looks = boresights(images, mounts)
    meeting = meet_rays(images.position, looks, np.zeros(len(images), dtype=np.intp), 1)
    if not np.isfinite(meeting.points).all():
        raise GeometryError(
            f"{path}: planned boresights are parallel: they have no common aim point; give [noise] "
            "aim_point, or "
            'attitude_knowledge = "independent"'
        )
    return meeting.points[0]


def check_aim(
    path: Path, names: Sequence[str], images: Images, mounts: Sequence[Rotation], aim: Array
) -> None:
    """Refuse a camera that does not look at the aim point.

    Raises
    ------
    GeometryError
        Names the camera.
    """
    to = aim - images.position
    distance = np.linalg.norm(to, axis=1)
    if distance.min() <= 0.0:
        raise GeometryError(
            f"{path}: a camera is at the aim point itself; check [noise] aim_point and x, y, z"
        )
    cosine = np.einsum("mi,mi->m", to, boresights(images, mounts)) / distance
    off = np.arccos(np.clip(cosine, -1.0, 1.0))
    middles = [float(np.median(off[images.camera == k])) for k in range(len(names))]
    worst = int(np.argmax(middles))
    if middles[worst] > FAR:
        raise GeometryError(
            f"{path}: camera {names[worst]} looks {np.degrees(middles[worst]):.3g} degrees past the common "
            "aim point, "
            'which attitude_knowledge = "from-position" takes it to look at; check its attitudes and [noise] '
            'aim_point, or say attitude_knowledge = "independent"'
        )
