"""Frames that move evenly, as `follow_windows` would report them: for what is decided from motion alone."""

from __future__ import annotations

import numpy as np

from sightline.matching.follow import Followed


def steady(count: int, step: float, *, sharpness=None, breaks=()) -> Followed:
    """`count` frames, each `step` lines on; a stretch begins at each of `breaks`."""
    before = np.arange(-1, count - 1)
    motion = np.tile([step, 0.0, 0.0, 0.0], (count, 1)).astype(float)
    for k in (0, *breaks):
        before[k], motion[k] = -1, np.nan
    none = np.zeros(0)
    return Followed(
        none.astype(int), none.astype(int), none.reshape(0, 2), none, before, motion,
        np.full(count, 50), np.ones(count) if sharpness is None else np.asarray(sharpness, float),
        np.ones(count), ("",) * count,
    )  # fmt: skip
