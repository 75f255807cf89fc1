"""S1, claim 11: bands laid on one of them by the recovered line of sight, and how well they then fit.

Not here: resampling (``products/``), files (``io/``), the page (``report/``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from sightline.errors import InputError, computes
from sightline.execution import Step, no_step, stepped
from sightline.geometry.camera import PushbroomCamera
from sightline.geometry.surface import Surface
from sightline.geometry.trajectory import Motion
from sightline.imaging.reduce import averaged
from sightline.imaging.source import ImageSource
from sightline.motion.band import Band
from sightline.motion.measure.laid_strips import parts_of_pixel
from sightline.motion.measure.windows import exposure_times, field_positions
from sightline.motion.statics import recovered_cameras
from sightline.motion.strip.relief import RowRelief
from sightline.products.band_fit import BandFit, fit_bands
from sightline.products.register_bands import RaisedGround, RegisteredImage, band_map
from sightline.result import Result, makes_result
from sightline.stages import Stages

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, repr=False)
class Registration(Result):
    """Bands on the grid of one of them, by two sets of cameras.

    Attributes
    ----------
    reference : int
        The band whose grid it is.
    before, after : tuple of ImageSource
        All bands, by the nominal and by the recovered cameras; the reference is its own image in both. Bands
        of finer pixels are averaged over its own.
    coarse : tuple of int
        Pixels of the grid that a pixel of each band fills along a side; empty: 1 of all.
    """

    reference: int
    before: tuple[ImageSource, ...]
    after: tuple[ImageSource, ...]
    coarse: tuple[int, ...] = ()


@makes_result
@computes("bands laid on one another")
def register_bands(
    bands: Sequence[Band],
    surface: Surface,
    motion: Motion,
    statics: Mapping[str, float] | None = None,
    *,
    relief: RowRelief | None = None,
    onto: str | None = None,
) -> Registration:
    """Bands of one strip on the grid of one of them; nothing is read before its pixels are asked for.

    Parameters
    ----------
    bands : sequence of Band
    surface : Surface
        What the lines of sight meet; a DEM takes the parallax of relief out.
    motion : Motion
        As recovered.
    statics : mapping, optional
        Offsets, rotations and scales of the bands as recovered, by name.
    relief : RowRelief, optional
        Ground that was found beside the motion: with it, as with the motion, bands fit.
    onto : str, optional
        Name of the band whose grid is wanted; the first by default.

    Returns
    -------
    Registration

    Raises
    ------
    InputError
        No band of that name.
    """
    names = [band.name for band in bands]
    if onto is not None and onto not in names:
        raise InputError(f"no band is called {onto!r}: the bands are {', '.join(names)}; name one of them")
    reference = 0 if onto is None else names.index(onto)
    nominal = tuple(band.camera for band in bands)
    refined = recovered_cameras(bands, motion, statics or {})

    def laid(
        cameras: Sequence[PushbroomCamera], raised: RaisedGround | None = None
    ) -> tuple[ImageSource, ...]:
        return tuple(
            band.image
            if k == reference
            else averaged(
                partial(RegisteredImage, band.image),
                band_map(cameras[reference], cameras[k], surface, raised),
                bands[reference].image.shape,
                parts_of_pixel(nominal, reference, k),
            )
            for k, band in enumerate(bands)
        )

    raised = None if relief is None else partial(heights_of_rows, relief, refined[relief.image])
    coarse = tuple(max(parts_of_pixel(nominal, k, reference)) for k in range(len(bands)))
    return Registration(reference, laid(nominal), laid(refined, raised), coarse)


def heights_of_rows(relief: RowRelief, camera: PushbroomCamera, places: Array) -> Array:
    """Heights (N,) m that were found at places (N, 3) of the surface, by where `camera` sees them.

    Before and after its image those of the first and the last row go on.
    """
    pixels = camera.project(places, line_margin=float(camera.lines))
    return relief.at(exposure_times(camera, pixels), field_positions(pixels[:, 1], camera.columns))


def fit_every_pair(
    images: Sequence[ImageSource],
    *,
    search_px: tuple[int, int] = (8, 8),
    coarse: Sequence[int] = (),
    step: Step = no_step,
    stages: Stages | None = None,
    name: str = "fit",
) -> list[BandFit]:
    """How every pair of images of one grid fits (`products.band_fit.fit_bands`), pairs counted by `step`.

    `coarse` is as in `Registration`; a pair is a stage of `stages`, by the `name` of all.
    """
    kept, factor = stages or Stages(), coarse or (1,) * len(images)

    def fit(a: int, b: int) -> BandFit:
        return fit_bands(images[a], images[b], (a, b), search_px=search_px, factor=max(factor[a], factor[b]))

    return [
        kept.once(f"{name}-{a}-{b}", BandFit, partial(fit, a, b))
        for a, b in stepped(list(combinations(range(len(images)), 2)), step)
    ]
