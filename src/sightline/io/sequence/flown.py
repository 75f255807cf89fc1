"""Poses of frames by a trajectory of many records a second (SBET), at the times of the frames.

Not here: the format (``io/formats/sbet.py``), when frames were exposed (``frames.py``).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from sightline.errors import FormatError
from sightline.io.formats.sbet import SmoothedTrajectory, read_sbet
from sightline.io.sequence.frames import FrameList
from sightline.io.sequence.matched_rows import is_local
from sightline.io.sequence.schema import SequenceFile

Array = NDArray[np.float64]


def flown_at_frames(
    file: SequenceFile, path: Path, frames: FrameList, warnings: list[str]
) -> tuple[Array, Rotation]:
    """Positions (M, 3), m, and world_from_body of all frames, Earth-fixed.

    Parameters
    ----------
    file : SequenceFile
    path : Path
        Of the SBET.
    frames : FrameList
    warnings : list of str
        What was understood is added.

    Raises
    ------
    FormatError
        In a flat world, and where frames lie outside of the trajectory.
    """
    if is_local(file):
        raise FormatError(
            f"{path}: a SBET holds places on the Earth, and [world] is flat; give [world] an origin, or "
            'frame = "earth-fixed"'
        )
    span = float(frames.t[0]), float(frames.t[-1])
    flown = read_sbet(path, frames.epoch, span)
    _refuse_outside(path, frames, flown)
    words = f"{path.name}: {flown.words}"
    # both tables may be one file
    warnings += [each for each in (words, flown.doubt) if each and each not in warnings]
    position = np.column_stack([np.interp(frames.t, flown.t, axis) for axis in flown.position.T])
    return position, Slerp(flown.t, flown.fixed_from_body)(frames.t)


def _refuse_outside(path: Path, frames: FrameList, flown: SmoothedTrajectory) -> None:
    outside = np.flatnonzero((frames.t < flown.t[0]) | (frames.t > flown.t[-1]))
    if len(outside):
        k = int(outside[0])
        raise FormatError(
            f"{path}: {len(outside)} of {len(frames.t)} frames were exposed outside of it: the first, "
            f"{frames.names[k]}, at t = {frames.t[k]:.6g} s, it goes from {flown.t[0]:.6g} to "
            f"{flown.t[-1]:.6g} s; check the epoch (UTC of t = 0; its times are GPS seconds of the week) and "
            "the times of the frames, or leave those frames out"
        )
