"""The path of a flight: its stretches, how smooth it is, and what ties neighbours together because of it.

Between neighbours of one stretch the path is as smooth as it was found to be over all steps.

Not here: the poses along it (``poses.py``), the motion within frames (``rolling_shutter.py``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.checks import Array
from sightline.photogrammetry.sightings import Images

#: rad, m: units of the unknowns; any of the size of the corrections keeps numbers near one.
UNITS = np.array([1e-3, 1e-3, 1e-3, 0.1, 0.1, 0.1])
#: Times the usual step between frames from which on it is a pause.
_PAUSE = 10.0
#: Bends end to end that show how rough a path is over a step.
_LEAST_BENDS = 4
#: Share of them that counts where two or fewer show it (three or four frames). One over a chi-square of one
#: or two has no mean: the variance is taken as ten times the mean square (three bends: three times), which it
#: exceeds in a quarter of cases of one bend and a tenth of two; tables say more of so few than smoothness.
_LEAST_COUNT = 0.1


def stretches(t: Array) -> NDArray[np.intp]:
    """Which stretch (M,) of the flight each frame is of: a new one begins after a pause.

    Parameters
    ----------
    t : (M,)
        s, increasing.
    """
    step = np.diff(t)
    pause = step > _PAUSE * np.median(step) if len(step) else np.zeros(0, dtype=bool)
    return np.concatenate([[0], np.cumsum(pause)]).astype(np.intp)


def path_turns(images: Images, stretch: NDArray[np.intp]) -> Array:
    """Poses as a path (M, 6): turns (rad, body axes) from the mean of the stretch, and places (m)."""
    out = np.empty((len(images), 6))
    out[:, 3:] = images.position - images.position.mean(axis=0)
    for number in np.unique(stretch):
        rows = np.flatnonzero(stretch == number)
        attitude = images.world_from_body[rows]
        out[rows, :3] = (attitude.mean().inv() * attitude).as_rotvec()
    return out


def path_precision(row: Array, at: NDArray[np.intp], strength: Array, rank: NDArray[np.intp]) -> Array:
    """Prior precision (M, 1 + s, 6, 6) that ties each frame to the two before it.

    Parameters
    ----------
    row, at, strength
        As of `bends`.
    rank : (M,) int
        Row of the precision that each frame has.

    Returns
    -------
    (M, 1 + s, 6, 6)
        As `PoseUnknowns.precision`. Straight and even motion costs nothing.
    """
    places = rank[at[:, None] + np.arange(-2, 1)]
    reach = int(np.abs(places[:, :, None] - places[:, None, :]).max()) if len(at) else 0
    out = np.zeros((len(rank), 1 + reach, 6, 6))
    axis = np.arange(6)
    for i in range(3):
        for j in range(3):
            # each pair once: the block below the diagonal
            low = places[:, i] >= places[:, j]
            first, second = places[low, i], places[low, j]
            value = (row[low, i] * row[low, j])[:, None] * strength[low]
            np.add.at(out, (first[:, None], (first - second)[:, None], axis, axis), value)
    return out


def bends(t: Array, roughness: Array, stretch: NDArray[np.intp]) -> tuple[Array, NDArray[np.intp], Array]:
    """Bends of a path over three frames in a row.

    Parameters
    ----------
    t : (M,)
        s, increasing.
    roughness : (6,)
        Spectral density of the second derivative of each unknown, unit^2 / s^3.
    stretch : (M,) int
        Frames of different stretches are not tied.

    Returns
    -------
    weights : (n, 3)
        1/s, of the three frames.
    last : (n,) int
        The last of them.
    strength : (n, 6)
        1 / variance.

    Notes
    -----
    With white acceleration the bend (x3 - x2)/h2 - (x2 - x1)/h1 has variance roughness (h1 + h2)/3; that
    neighbouring bends go together is left out.
    """
    h = np.diff(t)
    first, last = 1.0 / h[:-1], 1.0 / h[1:]
    row = np.stack([first, -(first + last), last], axis=1)
    kept = np.flatnonzero(stretch[2:] == stretch[:-2])
    strength = 3.0 / ((h[:-1] + h[1:])[:, None] * roughness)
    return row[kept], kept + 2, strength[kept]


def path_roughness(t: Array, path: Array, seen: Array) -> Array:
    """Roughness (6,) of a path, by its bends over steps from one frame to a good part of the flight.

    Parameters
    ----------
    t : (M,)
        s, increasing.
    path : (M, 6)
    seen : (M,)
        Sightings of each frame: bends between well seen frames count (all, if there are none).

    Notes
    -----
    The bend over two steps of h has the variance 2 h / 3 times the roughness where acceleration is white. A
    flight's is not: it sways for seconds. By bends of neighbours alone the path would be taken to be far
    straighter than it is; the largest roughness of all steps holds for each. Over gaps longer than the
    steps that were seen, bends may go on in one sense. That of turns is one for all axes: what smoothness
    says must not depend on how the axes of the body lie.
    """
    stretch, good = stretches(t), seen >= 4.0
    out = np.zeros(6)
    step = longest = 1
    while step == 1 or _LEAST_BENDS * 2 * step <= len(t):
        first, middle, last = (slice(k * step, len(t) - (2 - k) * step) for k in range(3))
        h1, h2 = t[middle] - t[first], t[last] - t[middle]
        bend = (path[last] - path[middle]) / h2[:, None] - (path[middle] - path[first]) / h1[:, None]
        size = bend**2 * (3.0 / (h1 + h2))[:, None]
        tied = stretch[first] == stretch[last]
        clear = tied & good[first] & good[middle] & good[last]
        used = size[clear] if clear.any() else size[tied]
        if len(used):
            # of few bends the mean may be small by chance: what a variance is on the mean, given n squares
            count = max(len(used) - 2.0, _LEAST_COUNT * len(used))
            out, longest = np.maximum(out, used.sum(axis=0) / count), step
        step *= 2
    out[:3] = out[:3].max()
    return np.maximum(out, 1e-12 * UNITS**2) * max(_longest_gap(good) / longest, 1.0)


def _longest_gap(good: NDArray[np.bool_]) -> int:
    """Most frames in a row that are not good; 0 where none are."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], ~good, [False]]).astype(np.int8)))
    return int((edges[1::2] - edges[::2]).max(initial=0)) if good.any() else 0


def trend_forms(t: Array, width: int = 6) -> Array:
    """Weights (M, D, 3 S) of departures that give the even trend of each angle over each of S stretches.

    Parameters
    ----------
    t : (M,)
        s, increasing. The trend is its rms over the stretch, rad; 0 of a single frame.
    width : int
        D, numbers of a departure; angles are the first three.
    """
    stretch = stretches(t)
    out = np.zeros((len(t), width, int(stretch[-1]) + 1, 3))
    for number in range(out.shape[2]):
        rows = np.flatnonzero(stretch == number)
        place = t[rows] - t[rows].mean()
        size = float(np.sqrt((place**2).mean()))
        if size > 0.0:
            for axis in range(3):
                out[rows, axis, number, axis] = place / (len(rows) * size)
    return out.reshape(len(t), width, -1)


def scale_form(position: Array, width: int = 6) -> Array:
    """Weights (M, D, 1) of departures that give the relative change of size of a flight.

    Parameters
    ----------
    position : (M, 3)
        m; about their middle, departures are projected on them. All 0 where they lie in one place.
    width : int
        D, numbers of a departure; moves are the fourth to the sixth.
    """
    out = np.zeros((len(position), width, 1))
    about = position - position.mean(axis=0)
    size = float((about**2).sum())
    if size > 0.0:
        out[:, 3:6, 0] = about / size
    return out
