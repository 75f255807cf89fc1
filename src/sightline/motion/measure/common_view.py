"""Which columns of an image another image shows too, and which images need each other matched.

Detectors of one focal plane need not cover the same field: staggered CCDs share a few dozen columns, a
small dedicated detector sees a hundred of a thousand. Windows are laid where both images look.

Not here: the windows themselves (``windows.py``), which of them are matched (``plan.py``).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.geometry.surface import Surface
from sightline.motion.measure.predict import MovingCamera
from sightline.motion.measure.windows import image_shape

Array = NDArray[np.float64]

#: Columns of one image that another shows: first and last, by the numbers of the two images.
Views = Mapping[tuple[int, int], tuple[int, int]]

#: Lines of an image, ends left out, at which it is asked what the other shows.
_LINES = 9
#: Columns beside the edge of the partner that are not used: what the kernel that lays one image on the other
#: reads (4), and how far the partner may lie from where it is predicted.
EDGE = 5
#: Views that hold at least this share of a detector's columns are laid out as if they held all.
MOST = 0.75
#: Views whose ends differ by less than this (px) share their windows.
ALIKE = 16
#: Fewest columns in which anything is matched.
LEAST_COLUMNS = 16


def common_views(
    cameras: Sequence[MovingCamera],
    surface: Surface,
    pairs: Collection[tuple[int, int]] | None = None,
) -> dict[tuple[int, int], tuple[int, int]]:
    """Columns of every image that each other image shows too.

    Parameters
    ----------
    cameras : sequence of cameras
        Nominal ones do: views differ by pixels only.
    surface : Surface
        What the lines of sight meet.
    pairs : collection of (int, int), optional
        Pairs that may be matched, either way round; all by default.

    Returns
    -------
    dict
        (image, other) to (first, last) column of the image; pairs that share less than LEAST_COLUMNS columns,
        or may not be matched, are left out.
    """
    allowed = None if pairs is None else {frozenset(pair) for pair in pairs}
    out = {}
    for a, camera in enumerate(cameras):
        lines, columns = image_shape(camera)
        others = [
            b for b in range(len(cameras)) if a != b and (allowed is None or frozenset((a, b)) in allowed)
        ]
        shown = np.zeros((len(others), columns), dtype=np.bool_)
        # line by line: detectors of a hundred thousand columns are wide enough
        for place in np.linspace(0.0, lines - 1.0, _LINES + 2)[1:-1] if others else ():
            pixels = np.column_stack([np.full(columns, place), np.arange(float(columns))])
            ground = camera.locate(pixels, surface)
            for row, b in enumerate(others):
                there = cameras[b].project(ground)[:, 1]
                with np.errstate(invalid="ignore"):
                    shown[row] |= (there >= 0) & (there <= image_shape(cameras[b])[1] - 1)
        for row, b in enumerate(others):
            seen = np.flatnonzero(shown[row])
            if len(seen) >= LEAST_COLUMNS:
                out[a, b] = int(seen[0]), int(seen[-1])
    return out


@dataclass(frozen=True)
class Partners:
    """Images in which the windows of one hub are to be found.

    Attributes
    ----------
    images : tuple of int
    columns : (int, int) or None
        Of the hub, where all of them look; None: its whole line.
    earlier : tuple of int
        Earlier hubs whose windows tell of these pairs already, wherever they look.
    """

    images: tuple[int, ...]
    columns: tuple[int, int] | None
    earlier: tuple[int, ...]


def partners_of(
    views: Views, order: Sequence[int], place: int, columns: int, grains: Sequence[int] | None = None
) -> list[Partners]:
    """The later images of `order` that hub ``order[place]``, of so many columns, is matched with.

    Images that look at the same columns of the hub stand together: their pairs share its error.

    Parameters
    ----------
    views, order, place
        As above.
    columns : int
        Of the hub.
    grains : sequence of int, optional
        Of each image, the number of its group of like pixels; all alike by default. What images of finer
        pixels have in common they are asked on their own grid, and a coarser hub has nothing to add: of those
        that look at the same columns it takes the first.
    """
    hub = order[place]
    grain = grains if grains is not None else [0] * (max(order) + 1)
    groups: list[Partners] = []
    taken: list[int] = []
    for image in order[place + 1 :]:
        if (hub, image) not in views:
            continue
        if grain[image] != grain[hub]:
            if any(_covers(views, hub, finer, image) for finer in taken):
                continue
            taken.append(image)
        earlier = tuple(
            e for e in order[:place]
            if grain[e] == grain[hub] and (hub, e) in views and (image, e) in views
        )  # fmt: skip
        here = usable(views[hub, image], columns)
        for k, group in enumerate(groups):
            if group.earlier == earlier and _alike(group.columns, here):
                groups[k] = Partners((*group.images, image), _shared(group.columns, here), earlier)
                break
        else:
            groups.append(Partners((image,), here, earlier))
    return groups


def _covers(views: Views, hub: int, image: int, other: int) -> bool:
    """Whether `image` sees most of what `other` sees of the hub, and the two can be matched."""
    if (image, other) not in views:
        return False
    (first, last), (low, high) = views[hub, image], views[hub, other]
    return min(last, high) - max(first, low) + 1 >= MOST * (high - low + 1)


def usable(view: tuple[int, int], columns: int) -> tuple[int, int] | None:
    """Columns in which windows are laid; None where that is a detector's whole line of so many columns."""
    if view[1] - view[0] + 1 >= MOST * columns:
        return None
    first = view[0] + EDGE if view[0] > 0 else 0
    last = view[1] - EDGE if view[1] < columns - 1 else columns - 1
    return first, last


def _alike(a: tuple[int, int] | None, b: tuple[int, int] | None) -> bool:
    """Whether two views begin and end at about the same columns."""
    if a is None or b is None:
        return a is b
    return abs(a[0] - b[0]) <= ALIKE and abs(a[1] - b[1]) <= ALIKE


def _shared(a: tuple[int, int] | None, b: tuple[int, int] | None) -> tuple[int, int] | None:
    """Columns that two views alike have in common."""
    return None if a is None or b is None else (max(a[0], b[0]), min(a[1], b[1]))
