"""Rough poses of the frames of a sequence, and how rough they are.

A frame for which nothing is said gets a pose between its neighbours', and sigmas that are infinite.

Not here: what tables and photographs say (``positions.py``, ``attitudes.py``), which
frames there are (``frames.py``), the ground (``load.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from sightline.errors import FormatError
from sightline.io.acquisition.acquired import InputFolder
from sightline.io.sequence.attitudes import given_attitudes
from sightline.io.sequence.frames import FrameList
from sightline.io.sequence.matched_rows import GivenRows, along, radii_of, slerp_along
from sightline.io.sequence.models import GivenPoses, given_poses
from sightline.io.sequence.positions import given_positions
from sightline.io.sequence.schema import SequenceFile
from sightline.photogrammetry.block.point_priors import ControlPoints, level_axes
from sightline.photogrammetry.flight.path import stretches
from sightline.photogrammetry.flight.poses import RoughPoses
from sightline.photogrammetry.sightings import Images

Array = NDArray[np.float64]

#: Sigmas of positions by which the places that give a heading are apart.
_HEADING_SIGMAS = 10.0
#: m; height of a camera of which nothing is known above the ground.
_ANY_HEIGHT = 100.0
#: Ways to give where frames were taken.
_PLACES = "positions = FILE, geo = FILE, poses = PATH or photographs with GPS"


@dataclass(frozen=True, eq=False)
class StartingPoses:
    """Rough poses of all frames in the axes of computation.

    Attributes
    ----------
    images : Images
    known : RoughPoses
    warnings : tuple of str
    """

    images: Images
    known: RoughPoses
    warnings: tuple[str, ...]


def starting_poses(
    file: SequenceFile, files: InputFolder, frames: FrameList, mount: Rotation
) -> StartingPoses:
    """Rough poses of all frames; FormatError where a table is wrong or nothing is known at all."""
    warnings: list[str] = []
    model = given_poses(file, files, frames, mount, warnings)
    placed = given_positions(file, files, frames, model, warnings)
    radii = radii_of(file)
    count = len(frames.names)
    if placed is None:
        position, position_sigma = _anywhere(file, count), np.full((count, 3), np.inf)
        if radii is not None:
            raise FormatError(
                f"{files.toml}: no frame has a position: give {_PLACES}; "
                'of control points alone, [world] frame = "local" is needed'
            )
        warnings.append("no positions: control points alone give where the path lies, and how large it is")
    else:
        position, position_sigma = along(frames.t, placed), _sigma_of(placed, count)
        _say_how_many(warnings, position_sigma, "position")
    turned = given_attitudes(file, files, frames, mount, position, model, warnings)
    guess = track_attitude(frames.t, position, position_sigma, radii)
    if turned is None:
        attitude, attitude_sigma = guess, np.full((count, 3), np.inf)
        warnings.append("no attitudes: taken as straight down, nose along the track")
    else:
        attitude, attitude_sigma = slerp_along(frames.t, turned), _sigma_of(turned, count)
        _say_how_many(warnings, attitude_sigma, "attitude")
    arm = np.array(file.first_camera.lever_arm)
    if arm.any():
        _refuse_arm(files.toml, placed, turned, model)
        position = position - attitude.apply(arm)
        # what a wrong attitude moves the camera by, about any axis
        swing = np.linalg.norm(arm) * np.nan_to_num(attitude_sigma, posinf=0.0).max(axis=1, keepdims=True)
        position_sigma = np.hypot(position_sigma, swing)
    order = np.arange(count)
    return StartingPoses(
        Images(np.zeros(count, dtype=np.intp), order, frames.t, position, attitude),
        RoughPoses(
            position_sigma,
            attitude_sigma,
            _bias_sigma(file.position_bias_sigma, placed),
            _bias_sigma(file.attitude_bias_sigma, turned),
            _axes_of(placed, count),
        ),
        tuple(warnings),
    )


def _refuse_arm(
    path: Path, placed: GivenRows | None, turned: GivenRows | None, model: GivenPoses | None
) -> None:
    """FormatError where a lever arm has nothing that it could move, or nothing says where it points."""
    if model is not None:
        raise FormatError(
            f"{path}: [camera] lever_arm is of positions of an antenna; those of a model of another program "
            "are the camera's own: leave it out"
        )
    if placed is None or turned is None:
        lacks = "positions" if placed is None else "attitudes"
        raise FormatError(f"{path}: [camera] lever_arm needs {lacks}, and there are none; give them")


def check_places(path: Path, known: RoughPoses, control: ControlPoints | None, height_sigma: float) -> None:
    """What gives the place and the size of a path must be there.

    Parameters
    ----------
    path : Path
        Of SEQUENCE.toml, for the words.
    known : RoughPoses
    control : ControlPoints or None
    height_sigma : float
        m, of the ground; 0: not known.

    Raises
    ------
    FormatError
        If nothing has a place; if a single frame or control point has, and no height gives the size.
    """
    frames = int(np.isfinite(known.position).any(axis=1).sum())
    places = frames + (0 if control is None else len(control.point))
    if places == 0:
        raise FormatError(
            f"{path}: no frame has a position, and there are no control points: place and size of the "
            f"path are not observable from frames alone; give {_PLACES}, or control points"
        )
    if places == 1 and not height_sigma > 0.0:
        raise FormatError(
            f"{path}: a single {'frame has a position' if frames else 'control point is given'}: that does "
            f"not give the size of the path; give two or more ({_PLACES}, or control points), or [surface] "
            "height_sigma of a ground whose height is known"
        )


def _bias_sigma(given: float | None, rows: GivenRows | None) -> float:
    """1-sigma of a constant error: as given; else as large as the rows' own where their errors are common."""
    if given is not None:
        return given
    if rows is None or not rows.common:
        return 0.0
    return float(np.median(rows.sigma.max(axis=1)))


def _say_how_many(warnings: list[str], sigma: Array, what: str) -> None:
    none = int((~np.isfinite(sigma).all(axis=1)).sum())
    if none:
        warnings.append(
            f"{none} of {len(sigma)} frames have no {what} of their own: interpolated, sigma infinite"
        )


def _anywhere(file: SequenceFile, count: int) -> Array:
    """Positions of cameras of which nothing is known: one place above the ground."""
    return np.tile([0.0, 0.0, file.surface.height + _ANY_HEIGHT], (count, 1))


def _sigma_of(given: GivenRows, count: int) -> Array:
    sigma = np.full((count, 3), np.inf)
    own = given.frame >= 0
    sigma[given.frame[own]] = given.sigma[own]
    return sigma


def _axes_of(given: GivenRows | None, count: int) -> Array | None:
    """Axes (M, 3, 3) of the sigmas of all frames; of those without a row it does not matter."""
    if given is None or given.axes is None:
        return None
    axes = np.tile(np.eye(3), (count, 1, 1))
    own = given.frame >= 0
    axes[given.frame[own]] = given.axes[own]
    return axes


def track_attitude(t: Array, position: Array, sigma: Array, radii: tuple[float, float] | None) -> Rotation:
    """Attitudes that look straight down, nose along the track of each stretch, by places apart beyond noise.

    Parameters
    ----------
    t : (M,)
        s.
    position : (M, 3)
        m, world axes.
    sigma : (M, 3)
        m, their 1-sigma.
    radii : (float, float) or None
        Of the ellipsoid; None where the world is flat.

    Returns
    -------
    Rotation
        M of them; to the north where nothing moves.
    """
    up, _, north = level_axes(position, radii)
    number = stretches(t)
    first, last = (np.searchsorted(number, number, side=side) for side in ("left", "right"))
    count, at = len(t), np.arange(len(t))
    known = sigma[np.isfinite(sigma)]
    apart = _HEADING_SIGMAS * float(np.median(known)) if len(known) else 0.0
    # the way from the end of one line to the beginning of the next is no track; bursts have none of their
    # own, lines half as long as that do
    gone = np.linalg.norm(position - position[first], axis=1)
    own = np.maximum.reduceat(gone, np.unique(first))[number] > 0.5 * apart
    first, last = np.where(own, first, 0), np.where(own, last, count)
    half = 1
    while True:
        move = position[np.minimum(at + half, last - 1)] - position[np.maximum(at - half, first)]
        level = move - np.einsum("ni,ni->n", move, up)[:, None] * up
        length = np.linalg.norm(level, axis=1)
        if float(np.median(length)) > apart or half >= count:
            break
        half *= 2
    still = length <= 0.0
    forward = np.where(still[:, None], north, level / np.where(still, 1.0, length)[:, None])
    return Rotation.from_matrix(np.stack([forward, np.cross(-up, forward), -up], axis=-1))
