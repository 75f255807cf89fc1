"""Two images laid on each other in red and cyan, by the nominal cameras and by the recovered ones.

Where they fit, the overlay is grey; where they do not, edges show a red and a cyan rim.

Not here: registered bands as a product.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sightline.io.acquisition.acquired import Acquisition
from sightline.motion.measure.laid_strips import laid_on
from sightline.motion.results import LineOfSight
from sightline.report.raster import data_png

Array = NDArray[np.float64]
Pixels = NDArray[np.uint8]

#: Lines and columns of the crop.
CROP = (130, 176)
#: Part of the pixels left black and left white by the stretch, percent.
CLIPPED = 1.0
#: Bits of a tone that are kept: nobody sees the others, and a page is a quarter smaller without them.
TONES = 0xFC
#: Where one of the images has no value: a light grey, so that it is taken neither for misfit nor for ground.
MISSING = 225


@dataclass(frozen=True)
class Composite:
    """A crop of two images overlaid, before and after, as ``data:`` addresses of PNG pictures.

    Attributes
    ----------
    hub, partner : str
        Names: the hub is red, the partner green and blue.
    first_line, first_column, lines, columns : int
        Of the crop, in the hub.
    before, after : str
    """

    hub: str
    partner: str
    first_line: int
    first_column: int
    lines: int
    columns: int
    before: str
    after: str


def composite(result: LineOfSight, acquisition: Acquisition) -> Composite | None:
    """Overlay of the pair that fitted worst before, where its matches moved most; None without any match."""
    chosen = _worst_pair(result)
    if chosen is None:
        return None
    index, k = chosen
    star = result.records[index].star
    hub, partner = star.hub, star.images[k]
    shape = acquisition.images[hub].shape
    size = (min(CROP[0], shape[0]), min(CROP[1], shape[1]))
    centre = _busiest_place(result, index, k, shape, size)
    lines, columns = ((c, c + s) for c, s in zip(centre, size, strict=True))
    own = acquisition.images[hub].read(lines, columns).astype(np.float64)
    pictures = []
    for cameras in (acquisition.cameras, result.cameras):
        laid = laid_on(acquisition.images, cameras, acquisition.surface, hub, partner).read(lines, columns)
        pictures.append(colours([own, laid.astype(np.float64)]))
    return Composite(
        result.image_names[hub],
        result.image_names[partner],
        *centre,
        *size,
        data_png(pictures[0]),
        data_png(pictures[1]),
    )


def _worst_pair(result: LineOfSight) -> tuple[int, int] | None:
    """Star and partner whose kept matches were furthest off before."""
    worst, chosen = -1.0, None
    for index, (record, before) in enumerate(zip(result.records, result.before_px, strict=True)):
        for k in range(len(record.star.images)):
            kept = record.star.present[:, k]
            if kept.sum() >= 20:
                size = float(np.mean(before[kept, k] ** 2)) * np.sqrt(kept.sum())
                if size > worst:
                    worst, chosen = size, (index, k)
    return chosen


def _busiest_place(
    result: LineOfSight, index: int, k: int, shape: tuple[int, int], size: tuple[int, int]
) -> tuple[int, int]:
    """First line and column of a crop around the kept windows that moved most, well inside the image."""
    star = result.records[index].star
    kept = star.present[:, k]
    moved = np.linalg.norm(result.before_px[index][kept, k], axis=1)
    pixels = star.pixels[kept]
    inside = np.ones(len(pixels), dtype=bool)
    for axis in (0, 1):
        low, high = size[axis] / 2, shape[axis] - 1 - size[axis] / 2
        near = (pixels[:, axis] >= low) & (pixels[:, axis] <= high)
        inside &= near if near.any() else True
    moved = np.where(inside, moved, 0.0)
    typical = np.argsort(moved)[int(0.97 * (len(moved) - 1))]
    first = [
        int(np.clip(round(pixels[typical, axis] - size[axis] / 2), 0, shape[axis] - size[axis]))
        for axis in (0, 1)
    ]
    return first[0], first[1]


def colours(bands: Sequence[Array]) -> Pixels:
    """Two images in complementary colours, or three in red, green and blue.

    Parameters
    ----------
    bands : sequence of (lines, columns)
        Two or three; each is stretched by itself; light grey where any is NaN.

    Returns
    -------
    (lines, columns, 3) uint8
    """
    out = np.zeros((*bands[0].shape, 3), dtype=np.uint8)
    channels = ([0], [1, 2]) if len(bands) == 2 else ([0], [1], [2])
    for values, own in zip(bands, channels, strict=True):
        finite = values[np.isfinite(values)]
        if not len(finite):
            continue
        low, high = np.percentile(finite, [CLIPPED, 100.0 - CLIPPED])
        grey = np.nan_to_num(255.0 * np.clip((values - low) / max(high - low, 1e-9), 0.0, 1.0))
        for channel in own:
            out[..., channel] = grey.astype(np.uint8) & TONES
    out[~np.isfinite(bands).all(axis=0)] = MISSING
    return out
